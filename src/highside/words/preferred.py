"""The language of whoever sits at a terminal, as its environment says."""

from __future__ import annotations

import os
from collections.abc import Mapping

from highside.words.catalogue import LANGUAGES

OWN = "HIGHSIDE_LANGUAGE"
LOCALES = ("LC_ALL", "LC_MESSAGES", "LANG")
"""What POSIX names the language of messages by: the first that is set counts."""
NORWEGIAN = {"no": "nb", "nn": "nb"}
"""who asks for Norwegian, or for Nynorsk, which we do not have, reads Bokmål"""


def preferred_language(environment: Mapping[str, str] | None = None) -> str:
    """`HIGHSIDE_LANGUAGE` (de), else the first of ours that `LANGUAGE` lists, else that of the locale (de_AT.UTF-8);
    English where none of them is ours. As with gettext, `LANGUAGE` counts for nothing in the locale C."""
    environment = os.environ if environment is None else environment
    if own := environment.get(OWN):
        return code_of(own) or "en"
    locale = next((value for name in LOCALES if (value := environment.get(name))), "C")
    if locale.partition(".")[0] in ("C", "POSIX"):
        return "en"
    wished = [*environment.get("LANGUAGE", "").split(":"), locale]
    return next((code for one in wished if (code := code_of(one))), "en")


def code_of(locale: str) -> str | None:
    """Of `de_AT.UTF-8@euro` de; None for a language that is not ours."""
    code = locale.replace("-", "_").partition(".")[0].partition("@")[0].partition("_")[0].lower()
    code = NORWEGIAN.get(code, code)
    return code if code in LANGUAGES else None
