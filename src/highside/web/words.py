"""In which language a browser is answered: the one chosen by the switch (a cookie), else the first of its
`Accept-Language` that there is. The words themselves are `highside.words`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from highside.web.signin.people import cookie_of, header_of
from highside.words import LANGUAGES as LANGUAGES
from highside.words import _ as _
from highside.words import said as said
from highside.words import said_later as said_later
from highside.words import several as several
from highside.words import told as told

ALIASES = {"no": "nb", "nn": "nb"}
"""what a browser calls a language that we have under another code"""
COOKIE = "highside_language"
COOKIE_MAX_AGE_S = 365 * 86_400
ACCEPTED_MAX = 20
"""Entries of `Accept-Language` that are looked at."""


def language_of(scope: Mapping[str, Any]) -> str:
    """The language of a request's answer."""
    chosen = cookie_of(scope, COOKIE)
    return chosen if chosen in LANGUAGES else accepted(header_of(scope, "accept-language") or "")


def accepted(header: str) -> str:
    """The best of `Accept-Language` that there is; English where there is none."""
    found = []
    for place, entry in enumerate(header.split(",")[:ACCEPTED_MAX]):
        name, _, rest = entry.strip().partition(";")
        code = name.strip().lower().partition("-")[0]
        code = ALIASES.get(code, code)
        if code in LANGUAGES and (weight := _weight(rest)) > 0.0:
            found.append((-weight, place, code))
    return min(found)[2] if found else "en"


def _weight(text: str) -> float:
    name, _, value = text.strip().partition("=")
    if name.strip() != "q":
        return 1.0
    try:
        weight = float(value)
    except ValueError:
        return 0.0
    return weight if math.isfinite(weight) else 0.0


SAID_ELSEWHERE = (
    said_later("Tools"),
    said_later("Calibrations"),
    said_later("Bench sessions"),
    said_later("Diagnosis"),
    said_later("Bench"),
    said_later("look"),
    said_later("operate"),
    said_later("put in force"),
    said_later("begins"),
    said_later("done"),
    said_later("sign in"),
    said_later("sign out"),
    said_later("wrong name or password"),
    said_later("put a calibration in force"),
    said_later("take back a calibration"),
    said_later("make a certificate"),
    said_later("change the configuration"),
    said_later("acknowledge the departure"),
    said_later("begin the watch anew"),
    said_later("align the azimuth"),
    said_later("Take the calibration in force back?"),
    said_later("Put this calibration in force?"),
    said_later("Take it back"),
    said_later("Put it in force"),
)
"""Words that other modules give and templates translate: navigation, roles, acts of the journal, questions."""
