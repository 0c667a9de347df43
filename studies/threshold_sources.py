"""Into the policies of a diagnosis, where a value of judgement has no other source, what `studies.thresholds` found.

    python -m studies.threshold_sources

Reads the tables of `studies/thresholds.md` and replaces `Chosen in COMMIT; no run is recorded.` in the docstring of a
field by `Source: studies.thresholds, LOW to HIGH.`: the values between which no answer of the recordings that read the
field changes. A field whose value is not that of the table any more keeps what it says.
"""

from __future__ import annotations

import ast
import re
import textwrap
from pathlib import Path

import highside.diagnosis
from studies.thresholds import policies

ROOT = Path(highside.diagnosis.__file__).parent
TABLES = Path(__file__).with_name("thresholds.md")
JUDGED = re.compile(r"Chosen in [0-9a-f]{7}; no run is recorded\.")
ROW = re.compile(r"\| `([\w.:\[\]]+)` \| (\S+) \| [^|]+ \| ([^|]+) \| ([^|]+) \|$")
TRIED = re.compile(r"(\d+) \((\S+)\)")
WIDTH = 120

Place = tuple[str, str]
"""class and field"""


def ranges() -> dict[Place, str]:
    """Of each field in the tables with its present value, from where to where no answer changes."""
    rows = {row[1]: row.groups()[1:] for line in TABLES.read_text().splitlines() if (row := ROW.match(line))}
    found: dict[Place, dict[int | None, set[str]]] = {}
    for field in policies():
        place = (type(field.owner).__name__, field.attribute)
        value, *tried = rows.get(field.name, ("", "", ""))
        if value == f"{field.value:.4g}":
            low, high = (end(cell, value) for cell in tried)
            found.setdefault(place, {}).setdefault(field.index, set()).add(f"{low} to {high}")
        elif field.index is not None:
            # a tuple has the ranges of all of its numbers or none
            found.setdefault(place, {}).setdefault(field.index, set())
    # of a class that is there several times with other values no range is everybody's
    return {
        place: ", ".join(one for several in numbers.values() for one in several)
        for place, numbers in found.items()
        if all(len(several) == 1 for several in numbers.values())
    }


def end(cell: str, value: str) -> str:
    """The farthest value in a cell of the table that changed no answer, else the present one."""
    return next((tried[2] for tried in TRIED.finditer(cell) if not int(tried[1])), value)


def judged() -> set[Place]:
    """The fields that have no source but the commit that put them there."""
    texts = [path.read_text() for path in ROOT.rglob("*policy.py")]
    return {place for text in texts for place, _, words in documented(text) if JUDGED.search(words)}


def documented(text: str) -> list[tuple[Place, ast.Expr, str]]:
    """The fields of the policies in a module's `text` with their docstrings: node and words."""
    found = []
    for policy in (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)):
        for field, words in zip(policy.body, policy.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                assert isinstance(words, ast.Expr)
                assert isinstance(words.value, ast.Constant)
                found.append(((policy.name, field.target.id), words, " ".join(str(words.value.value).split())))
    return found


def rewritten(text: str, known: dict[Place, str]) -> str:
    """A module's text with the ranges in place of judgements."""
    lines = text.splitlines()
    for place, node, words in reversed(documented(text)):
        if place in known and JUDGED.search(words):
            said = JUDGED.sub(f"Source: studies.thresholds, {known[place]}.", words)
            filled = textwrap.wrap(
                f'"""{said}"""', WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
            )
            lines[node.lineno - 1 : node.end_lineno] = filled
    return "\n".join(lines) + "\n"


def main() -> None:
    known = ranges()
    for path in sorted(ROOT.rglob("*policy.py")):
        path.write_text(rewritten(path.read_text(), known))


if __name__ == "__main__":
    main()
