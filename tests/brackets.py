"""A language in which each message of the catalogue stands in brackets: what is seen outside of them escapes it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po

from highside.words import LANGUAGES
from highside.words.catalogue import LOCALE

VALUE = re.compile(r"%\(\w+\)s")
BESIDE = r"⟧\g<0>⟦"


def put_in_brackets(folder: Path, *, values: bool = True) -> None:
    """Catalogues in which each message stands in brackets, in place of those of all languages. `values`: with what it
    says of its values; else these stand outside, and a sentence that passed for a value is seen."""
    for language in set(LANGUAGES) - {"en"}:
        inside = Path(language) / "LC_MESSAGES"
        (folder / inside).mkdir(parents=True)
        with (LOCALE / inside / "highside.po").open("rb") as file:
            known = read_po(file, locale=language)
        for message in known:
            if message.id:
                both = message.id if message.pluralizable else (message.id,)
                marked = tuple(f"⟦{one if values else VALUE.sub(BESIDE, one)}⟧" for one in both)
                message.string = marked if message.pluralizable else marked[0]
        with (folder / inside / "highside.mo").open("wb") as file:
            write_mo(file, known)


def outside(text: str, between: str = "") -> str:
    """What stands outside of all brackets; `between` in the place of each."""
    while (shorter := re.sub("⟦[^⟦⟧]*⟧", between, text)) != text:
        text = shorter
    return text


def written(node: ast.expr) -> str | None:
    """A text of the sources, with a number in the place of each value."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "7" for part in node.values)
    return None
