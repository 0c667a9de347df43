"""A text made to be searched for long, in a cell, a name, a line or a file, costs time that goes with its length.

A regular expression that can split a run of equal characters in several ways tries them all where the text does not
match in the end: a cell of a hundred thousand digits and a letter took minutes, a bracket and ten thousand blanks in a
column's name an hour.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import pytest

from highside.codec.delimited import _number
from highside.errors import HighsideError
from highside.importing.core.words import meaning
from highside.importing.forms.delimited import _EDGES, _column
from highside.link.detect import score_bytes
from highside.reading.dbc import check_dbc

N = 60_000
LONGEST_S = 1.5
"""of the processor; what goes with the square of the length takes 15 s and more"""


@pytest.mark.parametrize(
    ("look", "text"),
    [
        pytest.param(_number, "9" * N + "x", id="number of a line from the wire"),
        pytest.param(lambda text: _column("x", (text, text), False, 2, "a"), "9" * N + "x", id="cell"),
        pytest.param(lambda text: _column("x", (text, text), True, 2, "a"), "9" * N + "x", id="cell, decimal comma"),
        pytest.param(lambda text: score_bytes(b"%s,%s\r\n" % (text, text) * 2), b"9" * N + b"x", id="unknown line"),
        pytest.param(lambda text: meaning(text, None, frozenset()), "(" + " " * N, id="name of a column"),
        pytest.param(lambda text: meaning(text, None, frozenset()), "<" * N, id="name of brackets"),
        pytest.param(lambda text: _EDGES.sub(b"", text), b"1" + b"\t" * N + b"x", id="blanks within a line"),
        pytest.param(lambda text: check_dbc(text, where="a"), "/" * N, id="comment of a DBC file without an end"),
        pytest.param(lambda text: check_dbc(text, where="a"), ("9" * 399 + " " * 999) * (N // 200), id="sizes of DBC"),
    ],
)
def test_what_is_made_to_be_searched_for_long_takes_no_longer_than_other_texts(
    look: Callable[[Any], Any], text: str | bytes
) -> None:
    before = time.process_time()
    with contextlib.suppress(HighsideError, ValueError):
        look(text)
    assert time.process_time() - before < LONGEST_S
