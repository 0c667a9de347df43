"""What programs put around or before the lines of a table, taken off so that each line keeps its number."""

from __future__ import annotations

import re

_LVM_BEGINS = "LabVIEW Measurement"
_LVM_ENDS = "***End_of_Header***"
_LVM_TIME = "X_Value"
_MONITOR = re.compile(r"(\d\d:\d\d:\d\d\.\d{3}) -> ")
"""the serial monitor of the Arduino IDE, with "Show timestamp\""""
_SEPARATORS = ("\t", ";", ",")


def in_plain_lines(text: str) -> tuple[str, dict[str, str]]:
    """The text with nothing but lines of a table from the header on, and what its columns are by the program itself."""
    if text.startswith(_LVM_BEGINS):
        return _without_header(text)
    if _MONITOR.match(text):
        return _with_times_as_cells(text), {}
    return text, {}


def _without_header(text: str) -> tuple[str, dict[str, str]]:
    """LabVIEW's header in two parts becomes blank lines; `X_Value` is in seconds by definition."""
    lines = text.split("\n")
    ends = [place for place, line in enumerate(lines) if line.startswith(_LVM_ENDS)]
    if not ends or ends[-1] + 1 >= len(lines):
        return text, {}
    hints = {"t_s": _LVM_TIME} if lines[ends[-1] + 1].startswith(_LVM_TIME) else {}
    return "\n".join([*[""] * (ends[-1] + 1), *lines[ends[-1] + 1 :]]), hints


def _with_times_as_cells(text: str) -> str:
    lines = text.split("\n")
    if not all(_MONITOR.match(line) for line in lines if line.strip()):
        return text
    separator = next((mark for mark in _SEPARATORS if mark in lines[0]), " ")
    return "\n".join(_MONITOR.sub(rf"\1{separator}", line, count=1) for line in lines)
