"""What a page may refuse, by the sources, where each message of the catalogue stands in brackets: all is known."""

from __future__ import annotations

import re

import pytest

from highside.calibration.record import RecordError, RecordReason
from highside.errors import InputError, Refused
from highside.words import in_language, told
from highside.words.errors import error_told
from tests.brackets import outside
from tests.refusals import refusals

ON_PAGES = (
    "web/benches", "web/diagnosis", "web/records", "web/settings", "web/signin", "web/tools", "web/server.py",
    "web/documents.py", "bench/driver.py", "bench/journal_file.py", "bench/photographs.py", "bench/setup.py",
    "bench/session/journal.py", "bench/session/plans.py", "bench/session/verdict.py", "calibration/record.py",
    "config/bench.py", "config/certificate.py", "diagnosis", "importing/core", "importing/files.py", "importing/forms",
    "reading", "recording/calibration_store.py", "recording/files.py", "recording/table.py",
)  # fmt: skip
"""What raises an error while a page is answered, or in the child whose last line it shows."""
NAMES = re.compile(
    r"--\S+|map (?=\w+=)|\w+=\S*|\b\w+_\w+\b|pip install \S+|chmod \S+|7/reply|highside|CSV|COLUMN:ms|UNIT|units 7"
)
"""Options, fields, topics and commands, which are the same in every language."""
TYPED = re.compile(r"highside (decode|users add) .*")
"""Remedies that are typed as they stand"""


def unknown(text: str) -> bool:
    """Whether a part of it is not told; remarks may be told one by one."""
    # what is added at times
    text = text.removesuffix("7") if text.endswith("axes)7") else text
    parts = (told(text, "refusals"), "; ".join(told(part, "refusals") for part in text.split("; ")))
    return all(re.search(r"[^\W\d_]{3,}", NAMES.sub("", outside(part))) for part in parts)


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("brackets", [False], indirect=True)
def test_all_that_a_page_may_refuse_is_known() -> None:
    found = refusals(*ON_PAGES)
    assert len(found) > 250
    with in_language("de"):
        left = {text: where for text, where in found.items() if not TYPED.fullmatch(text) and unknown(text)}
    assert left == {}, "mark them by `said`, or list them in words.sentences_of_refusals; make words, then translate"


def in_german(error: InputError | Refused) -> str:
    with in_language("de"):
        return error_told(error, "refusals")


def test_a_refusal_is_told_with_its_values() -> None:
    assert in_german(Refused("too many attempts: try again in 3 min")) == (
        "zu viele Versuche: versuchen Sie es in 3 min wieder"
    )
    wrong = InputError("has 3 cells where the header has 4", where="my; file.csv: line 2", remedy="correct that line")
    assert in_german(wrong).startswith("my; file.csv: line 2: ") and "correct" not in in_german(wrong)
    unsigned = "record 0123 is signed with the key ab (A. Lab), which is not trusted here"
    assert in_german(RecordError(RecordReason.UNTRUSTED, unsigned)) == (
        "Kalibrierung abgelehnt (untrusted): das Protokoll 0123 ist mit dem Schlüssel ab (A. Lab) signiert,"
        " dem hier nicht vertraut wird"
    )
