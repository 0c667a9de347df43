"""The manual pages (`man highside-diagnose`), made from the commands themselves.

`python -m highside.cli.manual FOLDER` writes `highside.1` and a page for each command and sub-command. They are for
packages of a distribution; whoever installed with pip has `--help`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from highside.errors import InputError
from highside.version import __version__

STATUS = (
    ("0", "The work was done."),
    ("1", "The work was done and the answer is bad news."),
    ("2", "Wrong usage or input; one line says what."),
    ("70", "A defect of highside."),
)
_MARK_UP = re.compile(r"\*\*|`|\[/?[a-z ]+\]")


def pages(command: Any, words: tuple[str, ...] = ("highside",)) -> Iterator[tuple[str, str]]:
    """Name and text (roff) of the page of a command and of all below it."""
    below: dict[str, Any] = dict(sorted(getattr(command, "commands", {}).items()))
    below = {name: one for name, one in below.items() if not one.hidden}
    yield "-".join(words), "\n".join(_page(command, words, below)) + "\n"
    for name, one in below.items():
        yield from pages(one, (*words, name))


def _page(command: Any, words: tuple[str, ...], below: dict[str, Any]) -> Iterator[str]:
    name = "-".join(words)
    text = _paragraphs(command.help or "")
    options = [one for one in command.params if one.param_type_name == "option" and not one.hidden]
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    yield f'.TH {_roff(name.upper())} 1 "" "highside {__version__}" "highside"'
    yield ".SH NAME"
    yield _roff(f"{name} - {text[0].split('. ')[0].rstrip('.') if text else name}")
    yield ".SH SYNOPSIS"
    usage = ["[OPTION]...", *(_of_argument(one) for one in arguments), *(["COMMAND"] if below else [])]
    yield f".B {_roff(' '.join(words))}\n{_roff(' '.join(usage))}"
    yield ".SH DESCRIPTION"
    for n, paragraph in enumerate(text):
        yield f"{'.PP' + chr(10) if n else ''}{_roff(paragraph)}"
    if below:
        yield ".SH COMMANDS"
        for other, one in below.items():
            said = _paragraphs(one.help or "")
            yield f".TP\n.BR {_roff(f'{name}-{other}')} (1)\n{_roff(said[0] if said else other)}"
    # what the help of the command line says of each
    context = typer.Context(command, info_name=words[-1])
    for title, ones in (("ARGUMENTS", arguments), ("OPTIONS", options)):
        records = [record for one in ones if (record := one.get_help_record(context)) is not None]
        if records:
            yield f".SH {title}"
        for what, said_of in records:
            yield f".TP\n.B {_roff(what)}\n{_roff(_plain(said_of))}"
    if not options:
        yield ".SH OPTIONS"
    yield ".TP\n.B \\-\\-help\nShow the usage and exit."
    if command.epilog:
        yield f".SH EXAMPLE\n.nf\n{_roff(_plain(command.epilog).removeprefix('Example: '))}\n.fi"
    yield ".SH EXIT STATUS"
    for number, meaning in STATUS:
        yield f".TP\n.B {number}\n{meaning}"
    if len(words) > 1:
        yield f".SH SEE ALSO\n.BR {_roff('-'.join(words[:-1]))} (1)"


def _of_argument(one: Any) -> str:
    name = str(one.metavar or one.name).upper()
    name = f"{name}..." if one.nargs == -1 else name
    return name if one.required else f"[{name}]"


def _paragraphs(text: str) -> list[str]:
    return [" ".join(_plain(part).split()) for part in re.split(r"\n\s*\n", text.strip()) if part.strip()]


def _plain(text: str) -> str:
    return _MARK_UP.sub("", text)


def _roff(text: str) -> str:
    """Text in which nothing is taken for a request; a minus sign is one, that can be copied into a shell."""
    text = " ".join(text.split()).replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{text}" if text[:1] in (".", "'") else text


def write(folder: Path) -> list[Path]:
    """Write all pages; the files."""
    from highside.cli.main import app
    from highside.recording.files import make_directory, write_whole

    make_directory(folder)
    written = []
    for name, text in pages(typer.main.get_command(app)):
        written.append(folder / f"{name}.1")
        write_whole(written[-1], text.encode())
    return written


def main() -> None:
    """Entry point of `python -m highside.cli.manual`."""
    if len(sys.argv) != 2:
        raise SystemExit("usage: python -m highside.cli.manual FOLDER")
    try:
        write(Path(sys.argv[1]))
    except (InputError, OSError) as error:
        raise SystemExit(f"highside: {error}") from None


if __name__ == "__main__":
    main()
