"""Looks words up. The language is that of whom the answer being made is for: it follows into what is called, tasks and
threads included. Sentences that come ready made, from a session or a service, are told by their pattern (`told`)."""

from __future__ import annotations

import gettext
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from highside.words.said import Said
from highside.words.sentences import SENTENCES
from highside.words.sentences_of_commands import COMMANDS
from highside.words.sentences_of_diagnosis import DIAGNOSIS
from highside.words.sentences_of_importing import IMPORTING
from highside.words.sentences_of_refusals import REFUSALS
from highside.words.sentences_of_rotation import ROTATION
from highside.words.sentences_of_settings import SETTINGS
from highside.words.sentences_of_watch import WATCH

LANGUAGES = {"en": "English", "de": "Deutsch", "nb": "Norsk", "es": "Español"}
"""by their ISO 639 codes, each in its own word"""
DOMAIN = "highside"
LOCALE = Path(os.environ.get("HIGHSIDE_LOCALE") or Path(__file__).parent / "locale")
"""`HIGHSIDE_LOCALE`: the catalogues of somebody who translates"""
_CURRENT: ContextVar[str] = ContextVar("language", default="en")


def language() -> str:
    """The present reader's."""
    return _CURRENT.get()


def speak(code: str) -> None:
    """From here on, in this task and what it starts, words are in that language."""
    _CURRENT.set(code)


@contextmanager
def in_language(code: str) -> Iterator[None]:
    """Within, words are in that language, whoever is answered."""
    before = _CURRENT.set(code)
    try:
        yield
    finally:
        _CURRENT.reset(before)


def _(message: str, /, **fields: Any) -> str:
    """A message in the language of the present reader, with the values that it names, where it names any."""
    found = catalogue(language()).gettext(message)
    return found % fields if fields else found


def from_to(low: str, high: str) -> str:
    """A range, its ends as they are written."""
    return _("%(low)s to %(high)s", low=low, high=high)


def several(one: str, many: str, count: int) -> str:
    """The same for a number of things."""
    return catalogue(language()).ngettext(one, many, count)


@cache
def catalogue(code: str) -> gettext.NullTranslations:
    """The catalogue of a language; English has none."""
    return gettext.translation(DOMAIN, LOCALE, [code], fallback=code == "en")


TOLD_KEPT = 4000
"""Sentences whose translation is remembered."""
TOLD_MAX = 1000
"""Letters of what is looked up: no sentence of ours is as long."""
NESTED_MAX = 5
"""Sentences within sentences: why a line of a file is none, of a file, of a command."""
JOINED_MAX = 16
"""Parts of what was joined: of more none is told by itself."""
_FIELD = re.compile(r"%\((\w+)\)s")


def told(text: str, of: str = "") -> str:
    """A sentence that others have made in English, in the language of the present reader: by what it was made of
    (`Said`), as a word of the catalogue, or as one of `SENTENCES`; as it is where none fits. `of`: of which lists more
    sentences are known (`LISTS`), of which several may be joined; what people write must not be looked up there, for
    some are short."""
    if isinstance(text, Said):
        return _(text.message) % {name: _value(value) for name, value in text.fields.items()}
    return text if len(text) > TOLD_MAX else _told(text, language(), NESTED_MAX, of)


LISTS = {
    "": (),
    "commands": (*IMPORTING, *SETTINGS, *REFUSALS, *ROTATION, *DIAGNOSIS, *WATCH, *COMMANDS),
    "diagnosis": DIAGNOSIS,
    "importing": IMPORTING,
    "refusals": (*IMPORTING, *SETTINGS, *REFUSALS),
    "rotation": ROTATION,
    "settings": SETTINGS,
    "watch": WATCH,
}
"""Sentences that are known beside `SENTENCES`, by what is told."""
NAMES = frozenset({"column", "columns"})
"""Fields that are names out of somebody's file: a column called `time` is not told as that word."""
_JOINTS = ("; ", ": ", " and ", ", ")
"""Between the sentences, and in the listings, of those that `LISTS` names."""


def _value(value: Any) -> Any:
    return told(value) if isinstance(value, Said) else value


@lru_cache(maxsize=TOLD_KEPT)
def _told(text: str, language: str, depth: int, of: str = "") -> str:
    known = catalogue(language)
    if language == "en" or not text or depth == 0:
        return text
    # with the sign of a share doubled where the message has values beside it, else as it is
    for written in (text, text.replace("%", "%%")):
        if (same := known.gettext(written)) != written:
            return same.replace("%%", "%")
    for pattern, message in _patterns(of):
        if (found := pattern.fullmatch(text)) is not None:
            fields = {
                name: value if name in NAMES else _told(value, language, depth - 1, of)
                for name, value in found.groupdict().items()
            }
            return known.gettext(message) % fields
    # several sentences, one after the other, or one with what was found out in brackets
    parts = re.split(r"(?<=[.?!]) +(?=[A-Z])", text, maxsplit=8)
    if len(parts) > 1:
        return " ".join(_told(part, language, depth - 1, of) for part in parts)
    return _joined(text, language, depth, of) if of else text


def _joined(text: str, language: str, depth: int, of: str) -> str:
    """What was joined of several, each told: the longest beginnings that are known, and what is known of the rest."""
    for joint in _JOINTS:
        parts = text.split(joint)
        if not 1 < len(parts) <= JOINED_MAX:
            continue
        told: list[str] = []
        while parts:
            for count in range(len(parts), 0, -1):
                whole = joint.join(parts[:count])
                # the text as a whole is known not to be known
                one = whole if whole == text else _told(whole, language, depth - 1, of)
                if one != whole or count == 1:
                    told.append(one)
                    parts = parts[count:]
                    break
        between = catalogue(language).gettext(joint) if joint == " and " else joint
        if (whole := between.join(told)) != text:
            return whole
    return text


@cache
def _patterns(of: str = "") -> list[tuple[re.Pattern[str], str]]:
    """Those with fields, the longest first: it says most of what it fits."""
    every = (*SENTENCES, *LISTS[of])
    ordered = sorted((one for one in every if _FIELD.search(one)), key=lambda one: -len(_FIELD.sub("", one)))
    return [(re.compile(_as_pattern(one)), one) for one in ordered]


def _as_pattern(message: str) -> str:
    parts = _FIELD.split(message)
    return "".join(
        f"(?P<{part}>.+?)" if place % 2 else re.escape(part.replace("%%", "%")) for place, part in enumerate(parts)
    )
