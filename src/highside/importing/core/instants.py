"""Dates and times of day written as text, to whole nanoseconds: ISO 8601, `31.12.2026 23:59:58,5`, `12/31/2026 ...`.

Which of two numbers is the day is decided by the column as a whole: one above 12 decides it; where none is and the date
never changes it does not matter for the steps of time; else it stays open.
"""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DAY_NS = 86_400_000_000_000
_CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<fraction>\d{1,9}))?)?"
_ZONE = r"(?:\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2}|[+-]\d{2}))?"
_HALF = r"(?:\s*(?P<half>[AaPp][Mm]))?"
_ISO = re.compile(rf"(?P<a>\d{{4}})[-/](?P<b>\d{{1,2}})[-/](?P<c>\d{{1,2}})[T ]\s*{_CLOCK}{_ZONE}")
_PLAIN = r"(?:19|20)\d\d-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:\.\d{1,9})?"
_PLAIN_ISO = re.compile(rf"{_PLAIN}(?P<end>Z|\+00:00|)")
_LOCAL = re.compile(
    rf"(?P<a>\d{{1,2}})(?P<mark>[./-])(?P<b>\d{{1,2}})[./-](?P<c>\d{{4}})[T ,]\s*{_CLOCK}{_HALF}{_ZONE}"
)
_TIME = re.compile(rf"{_CLOCK}{_HALF}")
_ANY = (_ISO, _LOCAL, _TIME)


def is_instant(cell: str) -> bool:
    """Whether a text is a date with a time, or a time of day."""
    return any(pattern.fullmatch(cell.strip().strip('"')) for pattern in _ANY)


@dataclass(frozen=True, slots=True)
class Instants:
    """Nanoseconds (N,) since 1970, or since midnight for times of day alone; the written form; what is open."""

    ns: NDArray[np.int64]
    written: str
    of_day: bool = False
    doubt: str | None = None


def instants(cells: tuple[str, ...], order: str | None = None) -> Instants | None:
    """The times of a column of texts, or None where one of them is no date or time of day.

    `order`: `day.month.year` or `month/day/year` where it was said.
    """
    if not cells:
        return None
    at_once = _iso_at_once(cells)
    if at_once is not None:
        return at_once
    first = cells[0].strip().strip('"')
    for pattern, written in ((_ISO, "ISO 8601"), (_LOCAL, "local date"), (_TIME, "time of day")):
        if pattern.fullmatch(first):
            found = [pattern.fullmatch(cell.strip()) for cell in cells]
            if all(found):
                return _counted([match for match in found if match], written, order)
    return None


def _iso_at_once(cells: tuple[str, ...]) -> Instants | None:
    """ISO 8601 in UTC or without a zone as NumPy reads it, which takes a twentieth of the time; None for all others."""
    found = _PLAIN_ISO.match(cells[0])
    if found is None:
        return None
    end = len(found["end"])
    if not all(map(_PLAIN_ISO.fullmatch, cells)) or (end and "\n".join(cells).count(found["end"]) != len(cells)):
        return None
    try:
        ns = np.array([cell[: len(cell) - end] for cell in cells] if end else cells, dtype="datetime64[ns]")
    except ValueError:
        return None
    return Instants(ns.astype(np.int64), "ISO 8601")


def _counted(found: list[re.Match[str]], written: str, order: str | None) -> Instants | None:
    clock = np.array([_of_day(match) for match in found], dtype=np.int64)
    if (clock < 0).any():
        return None
    if written == "time of day":
        return Instants(clock, written, of_day=True)
    dates = [(match["a"], match["b"], match["c"]) for match in found]
    different = set(dates)
    doubt = None
    day_first = True
    if written == "local date":
        day_first, doubt = _day_first(different, {match["mark"] for match in found})
        if order is not None:
            day_first, doubt = order == "day.month.year", None
        written = "day.month.year" if day_first else "month/day/year"
    days: dict[tuple[str, str, str], int] = {}
    for date in different:
        year, month, day = (
            map(int, date)
            if written == "ISO 8601"
            else map(int, (date[2], date[1 if day_first else 0], date[0 if day_first else 1]))
        )
        try:
            days[date] = min(max(datetime.date(year, month, day).toordinal() - _EPOCH, -_DAYS), _DAYS)
        except ValueError:
            return None
    day_ns = np.array([days[date] - 1 for date in dates], dtype=np.int64) * DAY_NS
    return Instants(day_ns + clock, written, doubt=doubt)


_EPOCH = datetime.date(1970, 1, 1).toordinal()
_DAYS = 100_000
"""from 1970: nanoseconds of more days are no whole number of 64 bits"""


def _of_day(match: re.Match[str]) -> int:
    """Nanoseconds since midnight UTC (of the written zone where there is one); -1 for what no clock shows."""
    parts = match.groupdict()
    hour, minute, second = int(parts["hour"]), int(parts["minute"]), int(parts["second"] or 0)
    half = parts.get("half")
    if half:
        if not 1 <= hour <= 12:
            return -1
        hour = hour % 12 + (12 if half.lower() == "pm" else 0)
    if hour > 23 or minute > 59 or second > 60:
        return -1
    nanoseconds = int((parts["fraction"] or "0").ljust(9, "0"))
    total = (hour * 3600 + minute * 60 + second) * 1_000_000_000 + nanoseconds
    zone = parts.get("zone")
    if zone and zone[0] in "+-":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        shift = (int(digits[:2]) * 3600 + int(digits[2:]) * 60) * 1_000_000_000
        total += -shift if zone[0] == "+" else shift
    # moved by a day where a zone may be written, so that -1 stays free; `_counted` takes it off
    return total + (DAY_NS if "zone" in parts else 0)


def _day_first(dates: set[tuple[str, str, str]], marks: set[str]) -> tuple[bool, str | None]:
    firsts, seconds = {int(a) for a, _, _ in dates}, {int(b) for _, b, _ in dates}
    if max(firsts) > 12 or marks == {"."}:
        return True, None
    if max(seconds) > 12:
        return False, None
    if len(dates) == 1:
        return True, None
    a, b, c = sorted(dates)[0]
    return True, f"{a}/{b}/{c} may be day/month or month/day, and the date changes"
