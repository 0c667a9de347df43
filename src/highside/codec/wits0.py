"""WITS level 0, the rig's way to exchange readings: records of four-digit items between `&&` and `!!`.

    &&
    071334.27
    0717151.3
    !!

Each line is an item's code (two digits of the record type, two of the item) and its value as text, ended by CR LF.
The format follows the public description of the Wellsite Information Transfer Specification, level 0.
"""

from __future__ import annotations

from collections.abc import Iterable

from highside.errors import InputError

BEGIN = b"&&"
END = b"!!"
NEWLINE = b"\r\n"
MAX_LINE = 256
"""A longer line is no item."""
MAX_ITEMS = 512

Items = tuple[tuple[str, str], ...]
"""Pairs of code and value, in the order of the record."""


def encode(items: Iterable[tuple[str, str]]) -> bytes:
    """One record. Raises InputError for a code that is not four digits, or a value that would break the record."""
    lines = [BEGIN]
    for code, value in items:
        if len(code) != 4 or not (code.isascii() and code.isdigit()):
            raise InputError("is not an item code", field=code, remedy="four digits, such as 0713")
        if not value.isprintable() or not value.isascii() or value != value.strip():
            raise InputError("is not a value of a WITS item", field=code, remedy="printable ASCII on one line")
        lines.append(f"{code}{value}".encode("ascii"))
    lines.append(END)
    return NEWLINE.join(lines) + NEWLINE


class Parser:
    """Takes bytes in any pieces and gives the complete records in them.

    What is not part of a record is skipped; a line inside a record that is no item is counted in `bad_lines` and left
    out. A record that begins anew before its end was lost half-way and is counted in `broken`.
    """

    def __init__(self) -> None:
        self.records = 0
        self.bad_lines = 0
        self.broken = 0
        self._tail = b""
        self._items: list[tuple[str, str]] | None = None
        self._skipping = False

    def receive(self, data: bytes) -> list[Items]:
        """The records that `data` completes."""
        found: list[Items] = []
        *lines, self._tail = (self._tail + data).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if self._skipping:
                self._skipping = False
                continue
            record = self._line(line.strip())
            if record is not None:
                found.append(record)
        if len(self._tail) > MAX_LINE:
            # no line is that long: forget it, and what is still to come of it
            self._tail, self._skipping = b"", True
        return found

    def _line(self, line: bytes) -> Items | None:
        if not line:
            return None
        if line == BEGIN:
            if self._items is not None:
                self.broken += 1
            self._items = []
            return None
        if self._items is None:
            return None
        if line == END:
            record, self._items = tuple(self._items), None
            self.records += 1
            return record
        text = line.decode("ascii", errors="replace")
        if (
            len(line) > MAX_LINE
            or not (text[:4].isascii() and text[:4].isdigit() and len(text) >= 4)
            or not text.isprintable()
            or not text.isascii()
            or len(self._items) >= MAX_ITEMS
        ):
            self.bad_lines += 1
            return None
        self._items.append((text[:4], text[4:].strip()))
        return None
