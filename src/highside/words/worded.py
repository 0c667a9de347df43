"""Templates that know the words of all languages."""

from __future__ import annotations

from functools import cache

from jinja2 import Environment

from highside.shown.card import templates
from highside.words.catalogue import _, several, told


@cache
def worded(package: str = "highside.web", *, keep_trailing_newline: bool = False) -> Environment:
    """The templates of a package with `_` and its plural for what they say, and `told` for what others have said."""
    found = templates(package, keep_trailing_newline=keep_trailing_newline)
    found.add_extension("jinja2.ext.i18n")
    found.install_gettext_callables(_, several, newstyle=True)  # type: ignore[attr-defined]
    found.filters["told"] = told
    return found
