"""What a diagnosis says of one recording, in the reader's language: hints, why something was not tested, what it needs.

The diagnosis makes these sentences in English and with ids of effects in them, which is what its files hold. A report
tells them (`words.sentences_of_diagnosis`), and names effects by their titles.
"""

from __future__ import annotations

import re
from functools import cache

from markupsafe import Markup

from highside.physics.effects import all_effects
from highside.report.diagnosis_claims import LAW, title_of_any
from highside.report.diagnosis_words import AXIS_NAMES
from highside.words import _, language, said_later, told

CHECKS = {
    "clock_drift": said_later("the clock drifts"),
    "clock_step": said_later("the clock steps"),
    "constant_channel": said_later("a channel that does not change"),
    "duplicated_frames": said_later("duplicated frames"),
    "exchanged_poses": said_later("two poses whose angles were exchanged"),
    "impulses": said_later("impulses"),
    "inverted_axis": said_later("an axis with its sign turned"),
    "missing_column": said_later("a missing column"),
    "missing_values": said_later("missing values"),
    "not_gravity": said_later("not gravity"),
    "outlying_pose": said_later("a pose that contradicts the others"),
    "reordered_frames": said_later("frames out of order"),
    "reversed_time": said_later("time that runs backwards"),
    "swapped_axis": said_later("swapped axes"),
    "within_pose": said_later("readings that move within a pose"),
    "wrong_unit": said_later("a wrong unit"),
}
"""Faults of the data; those that are an effect of the library have its title."""
CELLS = {
    "d_inc_mean_deg": said_later("mean error of inclination"),
    "d_inc_pp_deg": said_later("peak-to-peak error of inclination"),
    "d_tf_mean_deg": said_later("mean error of toolface"),
    "d_tf_pp_deg": said_later("peak-to-peak error of toolface"),
}
"""Columns of a table of errors."""


def check_name(check: str) -> str:
    """A fault of the data in words."""
    return _(CHECKS[check]) if check in CHECKS else title_of_any(check)


def hint(text: str) -> Markup | str:
    """A sentence of a diagnosis in the reader's language, or marked as the English that it is; effects by title."""
    known = told(text, "diagnosis")
    named = _ids().sub(lambda found: _named(found[0]), known)
    if "column" not in text:
        named = _axes().sub(lambda found: _(AXIS_NAMES[found[0]]).partition(",")[0].partition(" (")[0], named)
    if language() != "en" and known == text and any(letter.isalpha() for letter in text) and text not in all_effects():
        return Markup('<span lang="en">{}</span>').format(named)
    return named


def _named(name: str) -> str:
    return _(CELLS[name]) if name in CELLS else title_of_any(name)


@cache
def _every_id(*, one_word: bool) -> re.Pattern[str]:
    names = [name for name in all_effects() if one_word or "_" in name]
    longest_first = sorted([*map(re.escape, names), *CELLS], key=len, reverse=True)
    return re.compile(rf"{LAW}:\w+|(?<![\w.])(?:{'|'.join(longest_first)})(?!\w)")


def _ids() -> re.Pattern[str]:
    """Ids within a sentence: one that is a word of English is left in English, where it may be just that."""
    return _every_id(one_word=language() != "en")


@cache
def _axes() -> re.Pattern[str]:
    return re.compile(rf"\b(?:{'|'.join(AXIS_NAMES)})\b")
