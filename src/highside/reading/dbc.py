"""What a DBC file may say, looked at before its parser sees it.

The parser believes every number: a signal of four thousand million bits is built as a mask of as many bits, a range of
multiplexer values as a list of all of them, an attribute of 1e99999999 as an integer with all its digits. One wrong
digit of a file takes all memory. So sizes are held against what a CAN bus can carry before anything is built of them.
"""

from __future__ import annotations

import math
import re

from highside.errors import InputError
from highside.reading.files import in_words
from highside.reading.texts import at_line

MAX_DBC_BYTES = 8 << 20
"""Longest DBC text: the largest public ones have 2 MB; the parser needs about 3 s for one."""
CLASSIC_BYTES, CLASSIC_BITS = 8, 64
"""payload of a CAN frame"""
MAX_MESSAGE_BYTES = 1785
"""Longest message: a frame of CAN FD has 64 bytes, what J1939 sends in pieces at most 1,785."""
MAX_NUMBER_CHARACTERS = 400
"""The largest number that a double holds, written out, has 309 digits."""
MAX_MULTIPLEXER_VALUES = 1 << 16
"""Values of a multiplexer: one of 16 bits has as many."""

# as the parser sees them: comments and texts give way, blanks and line ends may stand anywhere
_PASSED_OVER = re.compile(r"//.*?(?:\n|\Z)|\"(?:\\\"|[^\"])*?\"")
_NUMBER = re.compile(r"\d[\d.]*(?:[eE][+-]?\d+)?")
_SIZE = re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(?P<bytes>-?\d+)|(?<!\d)(?P<start>-?\d+)\s*\|\s*(?P<bits>-?\d+)\s*@")
_MULTIPLEXED = re.compile(r"\bSG_MUL_VAL_\s*(?=[-+\d])([^;]*)")
_RANGES = re.compile(r"\d+\s+\w+\s+\w+\s+(?P<ranges>\d+\s*-\s*\d+(?:\s*,\s*\d+\s*-\s*\d+)*)\s*")
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")
_SHOWN = 40


def check_dbc(text: str, *, where: str) -> None:
    """Raises InputError that names the line of a size that no CAN bus has, or of a number without bounds."""
    if len(text) > MAX_DBC_BYTES:
        raise InputError(f"is longer than {in_words(MAX_DBC_BYTES)}", where=where, remedy="give the right file")
    # lines keep their numbers
    bare = _PASSED_OVER.sub(lambda found: " " + "\n" * found[0].count("\n"), text)
    for found in _NUMBER.finditer(bare):
        if not _bounded(found[0]):
            shown = found[0] if len(found[0]) <= _SHOWN else f"{found[0][:_SHOWN]}..."
            raise _bad(f"the number {shown} is too large", bare, found.start(), where)
    _check_sizes(bare, where)
    _check_ranges(bare, where)


def _check_ranges(bare: str, where: str) -> None:
    values = 0
    for statement in _MULTIPLEXED.finditer(bare):
        # the parser takes a sign, and two numbers without a dash, too: what is then a range may have any length
        match = _RANGES.fullmatch(statement[1])
        if match is None:
            raise _bad("SG_MUL_VAL_ without message, signal, multiplexer and ranges", bare, statement.start(), where)
        for found in _RANGE.finditer(match["ranges"]):
            values += max(int(found[2]) - int(found[1]), 0)
            if values > MAX_MULTIPLEXER_VALUES:
                raise _bad(f"the range {found[0]} has too many values", bare, statement.start(), where)


def _check_sizes(bare: str, where: str) -> None:
    most = CLASSIC_BITS
    for found in _SIZE.finditer(bare):
        if found["bytes"] is not None:
            message_bytes = int(found["bytes"])
            if not 0 <= message_bytes <= MAX_MESSAGE_BYTES:
                what = f"a message of {message_bytes} bytes, a CAN bus carries at most {MAX_MESSAGE_BYTES}"
                raise _bad(what, bare, found.start(), where)
            most = max(CLASSIC_BITS, 8 * message_bytes)
            continue
        start, bits = int(found["start"]), int(found["bits"])
        if not (0 < bits <= most and 0 <= start < 8 * MAX_MESSAGE_BYTES):
            what = f"that begins at bit {start}" if 0 < bits <= most else f"of {bits} bits"
            raise _bad(f"a signal {what}, its message has at most {most}", bare, found.start(), where)


def _bounded(number: str) -> bool:
    if len(number) > MAX_NUMBER_CHARACTERS:
        return False
    try:
        return math.isfinite(float(number))
    except ValueError:
        return True  # "1.2.3" is for the parser to refuse


def _bad(what: str, text: str, position: int, where: str) -> InputError:
    return InputError(what, where=at_line(where, text.count("\n", 0, position) + 1), remedy="correct that line")
