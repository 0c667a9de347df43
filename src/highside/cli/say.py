"""What a command prints. Names, notes and texts out of files may stand in it: nothing of them reaches the terminal as a
control sequence or reverses its reading order."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from highside.printable import printable

if TYPE_CHECKING:
    from highside.plugins import Plugin


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print lines for people, on stdout or stderr; line ends and tabs stay, what no line may hold is escaped."""
    import typer

    typer.echo("\n".join("\t".join(map(printable, line.split("\t"))) for line in text.split("\n")), err=err, nl=nl)


def echo_version(version: str) -> None:
    """Print what `--version` asks for; nothing is loaded for it."""
    sys.stdout.write(version + "\n")


def echo_json(document: str) -> None:
    """Print a JSON document: the same values, with characters that a terminal would obey as JSON's own escapes."""
    import typer

    typer.echo("".join(c if c.isprintable() or c in "\n\t" else _escaped(c) for c in document))


def report_omitted(kind: str, faults: Mapping[str, Plugin]) -> None:
    """A line on stderr for each `kind` ("codec") that another package adds and that cannot be used."""
    for plugin in faults.values():
        echo(f"note: the {kind} {plugin} is omitted: {plugin.fault}", err=True)


def _escaped(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[k]:02x}{units[k + 1]:02x}" for k in range(0, len(units), 2))
