"""What a notebook shows of a result: a line, a table, lines below it; templates escape what they are given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["card", "templates"]


def card(header: Sequence[str], rows: Iterable[Sequence[str]], *below: str, title: str = "") -> str:
    """An HTML table with a title over it and lines below it, everything escaped."""
    template = templates().get_template("card.html")
    return template.render(title=title, header=header, rows=list(rows), below=[line for line in below if line])


@cache
def templates(package: str = "highside.shown", *, keep_trailing_newline: bool = False) -> Environment:
    """The templates of a package, in which everything is escaped and a name that is not there is an error; each is read
    once, so that an installation that is being replaced does not change the pages of a process that runs."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=keep_trailing_newline,
        auto_reload=False,
    )
    # a chart names its parts where they come first
    found.policies["json.dumps_kwargs"] = {"sort_keys": False}
    return found
