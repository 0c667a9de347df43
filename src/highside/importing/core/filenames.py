"""Which second file belongs to a recording, by what their names have in common.

Two names are divided into words, numbers and marks; what both hold in the same order, and may be of one session alone
(a run, a date, a serial number), becomes `{1}`, `{2}`, ...: of `log_2025-07-12.csv` and `bench_2025-07-12.csv` the
rule is `log_{1}.csv` and `bench_{1}.csv`. Names that have nothing in common are a fixed name beside any recording.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import SequenceMatcher

_PIECES = re.compile(r"[^\W\d_]+|\d+|[\W_]")
_ENDS = re.compile(r"(?:\.[^\W\d_][^\W_]{0,7}){0,2}$")
"""`.csv`, `.csv.gz`"""
_PLACE = re.compile(r"\{(\d)\}")
_MOST = 9
"""places in a rule"""


@dataclass(frozen=True, slots=True)
class NameRule:
    """`recording` and `second`: names with the places `{1}` to `{9}`, which hold the same in both. Without a
    `recording` the second file has that name whatever the recording is called."""

    recording: str
    second: str

    @property
    def fixed(self) -> bool:
        """Whether the second file has one name whatever the recording is called."""
        return not self.recording

    def __str__(self) -> str:
        return f"{self.second} beside any recording" if self.fixed else f"{self.recording} with {self.second}"


def rule_of(recording: str, second: str) -> NameRule:
    """The rule that leads from one name to the other."""
    end_a, end_b = (_ENDS.search(name).start() for name in (recording, second))  # type: ignore[union-attr]
    a, b = _PIECES.findall(recording[:end_a]), _PIECES.findall(second[:end_b])
    blocks = SequenceMatcher(None, a, b, autojunk=False).get_matching_blocks()
    shared = [block for block in blocks if any(piece.isalnum() for piece in a[block[0] : block[0] + block[2]])][:_MOST]
    for number, (begin_a, begin_b, size) in reversed(list(enumerate(shared, start=1))):
        left, right = _within(a[begin_a : begin_a + size])
        a[begin_a + left : begin_a + right] = b[begin_b + left : begin_b + right] = [f"{{{number}}}"]
    made = NameRule("".join(a) + recording[end_a:], "".join(b) + second[end_b:])
    # names that hold braces of their own may say something else
    leads = _PLACE.search(made.second) is not None and second_of(made, recording) == second
    return made if leads else NameRule("", second)


def second_of(rule: NameRule, recording: str) -> str | None:
    """The name of the second file of a recording; None for a recording that is not called as the rule says."""
    if rule.fixed:
        return rule.second
    names: set[str] = set()
    pattern = ""
    for place, text in enumerate(re.split(r"(\{\d\})", rule.recording)):
        if place % 2 == 0:
            pattern += re.escape(text)
        elif text in names:
            pattern += f"(?P=p{text[1]})"
        else:
            names.add(text)
            pattern += f"(?P<p{text[1]}>.+?)"
    found = re.fullmatch(pattern, recording)
    if found is None or not {f"{{{digit}}}" for digit in _PLACE.findall(rule.second)} <= names:
        return None
    return _PLACE.sub(lambda place: found[f"p{place[1]}"], rule.second)


def _within(pieces: list[str]) -> tuple[int, int]:
    """[begin, end) without the marks at both ends."""
    words = [place for place, piece in enumerate(pieces) if piece.isalnum()]
    return words[0], words[-1] + 1
