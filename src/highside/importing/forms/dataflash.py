"""Logs of ArduPilot: dataflash as the autopilot writes it (`.bin`), and the text that ground stations make of it.

A log describes itself: messages `FMT` name the fields of each type and how they are packed (ArduPilot, AP_Logger,
LogStructure.h). Types that repeat for several sensors have a field `I`; each of them is a table of its own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from highside.errors import InputError
from highside.importing.core.source import SourceColumn, SourceTable, number_column
from highside.importing.forms.missing import damaged
from highside.reading import decode_foreign

HEAD = b"\xa3\x95"
"""of each message"""
_FMT = 128
_FMT_BYTES = 89
_PACKED = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4",
    "L": "<i4", "M": "u1", "a": "S64",
}  # fmt: skip
"""LogStructure.h: letters of a format"""
_HUNDREDTHS = frozenset("cCeE")
_TEXT = re.compile(r"(?m)^FMT, *\d+, *\d+, *\w+, *\w+,")
_UNITS = {
    "TimeUS": "us", "SampleUS": "us", "TimeMS": "ms", "AccX": "m/s2", "AccY": "m/s2", "AccZ": "m/s2",
    "GyrX": "rad/s", "GyrY": "rad/s", "GyrZ": "rad/s", "temperature": "C",
}  # fmt: skip
"""fields of the types below, in the units of LogStructure.h"""
_INERTIAL = frozenset({"IMU", "IMU2", "IMU3", "ACC", "GYR", "ACC1", "ACC2", "ACC3", "GYR1", "GYR2", "GYR3", "IMT"})
_OURS = {"AccX": "ax_g", "AccY": "ay_g", "AccZ": "az_g", "GyrX": "gx_dps", "GyrY": "gy_dps", "GyrZ": "gz_dps"}
_RENAMED = {"T": "temperature"}
"""a field whose name says something else elsewhere"""
_MOST_SENSORS = 64
"""of one type: flight controllers have up to six"""
_LEAST = 3
"""messages of a type that make a table"""


@dataclass(frozen=True, slots=True)
class _Kind:
    name: str
    letters: str
    labels: tuple[str, ...]
    length: int

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Packed, as it is written: the head of a message, and its fields by their number."""
        fields = [("head", "S3"), *((str(k), _PACKED[letter]) for k, letter in enumerate(self.letters))]
        return np.dtype(fields)


def is_dataflash(data: bytes) -> bool:
    """Whether it begins as a binary log: with the description of the descriptions."""
    return data[:3] == HEAD + bytes([_FMT])


def is_dataflash_text(data: bytes) -> bool:
    """Whether one of the first lines describes a type of message."""
    return b"FMT," in data[:4096] and _TEXT.search(data[:4096].decode("utf-8", "replace")) is not None


def read_dataflash(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """One table for each type of message and each sensor. Raises InputError for a file without any."""
    kinds: dict[int, _Kind] = {}
    found: dict[int, list[int]] = {}
    place = skipped = 0
    end = len(data)
    while place + 3 <= end:
        number = data[place + 2]
        if number == _FMT and data[place : place + 2] == HEAD and place + _FMT_BYTES <= end:
            kind_number, kind = _described(data[place + 3 : place + _FMT_BYTES])
            if kind is not None:
                kinds.setdefault(kind_number, kind)
            place += _FMT_BYTES
            continue
        known = kinds.get(number) if data[place : place + 2] == HEAD else None
        if known is None:
            follows = data.find(HEAD, place + 1)
            skipped += (follows if follows >= 0 else end) - place
            place = follows if follows >= 0 else end
            continue
        if place + known.length > end:
            skipped += end - place
            break
        found.setdefault(number, []).append(place)
        place += known.length
    remarks = (f"{skipped} bytes belong to no message and were passed over",) if skipped else ()
    tables: list[SourceTable] = []
    for number, places in found.items():
        kind = kinds[number]
        # only the messages themselves are copied: an index of each byte would take eight times as much
        rows = sliding_window_view(np.frombuffer(data, np.uint8), kind.length)[places].view(kind.dtype).reshape(-1)
        columns = {}
        for k, (label, letter) in enumerate(zip(kind.labels, kind.letters, strict=True)):
            values = rows[str(k)]
            if values.dtype.kind != "S":
                columns[label] = values / 100.0 if letter in _HUNDREDTHS else values
        tables += _tables(kind.name, columns, f"ArduPilot log, {kind.name}", where, remarks)
    return _at_least_one(tables, where)


def read_dataflash_text(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The same of the text. Raises InputError that names the line of what is no number."""
    text, _ = decode_foreign(data, where=where)
    labels: dict[str, tuple[str, ...]] = {}
    rows: dict[str, list[list[float]]] = {}
    torn = 0
    lines = text.split("\n")
    for line, content in enumerate(lines, 1):
        cells = [cell.strip() for cell in content.split(",")]
        name = cells[0]
        if name == "FMT" and len(cells) > 5:
            # the first counts, as in the binary form: rows of two lengths make no table
            labels.setdefault(cells[3], _distinct(cells[5:], cells[3], f"{where}: line {line}"))
            continue
        if name not in _INERTIAL or name not in labels:
            continue
        if len(cells) != len(labels[name]) + 1:
            if line < len(lines):
                raise InputError(
                    f"has {len(cells) - 1} values where {name} has {len(labels[name])}", where=f"{where}: line {line}",
                    remedy="correct that line",
                )  # fmt: skip
            torn += 1
            continue
        try:
            rows.setdefault(name, []).append([float(cell) for cell in cells[1:]])
        except ValueError:
            raise InputError("holds a text among numbers", where=f"{where}: line {line}", field=name) from None
    remarks = ("its last line is torn and was omitted",) if torn else ()
    tables: list[SourceTable] = []
    for name, block in rows.items():
        values = np.array(block)
        columns = {
            label: values[:, k].astype(np.int64) if label in ("TimeUS", "SampleUS", "I") else values[:, k]
            for k, label in enumerate(labels[name])
        }
        tables += _tables(name, columns, f"ArduPilot log as text, {name}", where, remarks)
    return _at_least_one(tables, where)


def _distinct(labels: list[str], kind: str, where: str) -> tuple[str, ...]:
    if kind in _INERTIAL and not (all(labels) and len(labels) == len(set(labels))):
        raise damaged("ArduPilot", ValueError(f"{kind} has a field without a name, or two of one name"), where)
    return tuple(labels)


def _described(content: bytes) -> tuple[int, _Kind | None]:
    """Type and description; None for one that cannot be (letters that are unknown, a length that is none, a field that
    has no name or that of another)."""
    name = content[2:6].split(b"\0")[0].decode("ascii", "replace")
    letters = content[6:22].split(b"\0")[0].decode("ascii", "replace")
    labels = tuple(content[22:86].split(b"\0")[0].decode("ascii", "replace").split(","))
    kind = _Kind(name, letters, labels, content[1])
    named = all(labels) and len(labels) == len(letters) == len(set(labels))
    fits = named and all(letter in _PACKED for letter in letters)
    return content[0], kind if fits and kind.dtype.itemsize == kind.length else None


def _tables(
    name: str, columns: Mapping[str, NDArray[np.generic]], form: str, where: str, remarks: tuple[str, ...]
) -> list[SourceTable]:
    """One table for each sensor (field `I`)."""
    sensors = columns.get("I")
    marks: list[int | None] = [None]
    if sensors is not None:
        marks = [int(mark) for mark in np.unique(sensors.astype(np.int64))]
    if len(marks) > _MOST_SENSORS and name in _INERTIAL:
        what = f"{name} numbers {len(marks)} sensors"
        raise InputError(what, where=where, field="I", remedy="the log is damaged; give the whole log")
    if len(marks) > _MOST_SENSORS:
        marks = [None]
    tables = []
    for mark in marks:
        rows = slice(None) if mark is None else np.flatnonzero(np.asarray(sensors) == mark)
        taken = {_RENAMED.get(label, label): values[rows] for label, values in columns.items() if label != "I"}
        if len(next(iter(taken.values()), [])) < _LEAST:
            continue
        inertial = name in _INERTIAL
        made: tuple[SourceColumn, ...] = tuple(
            number_column(label, values, _UNITS.get(label) if inertial or label == "TimeUS" else None)
            for label, values in taken.items()
        )
        hints = {ours: label for label, ours in _OURS.items() if inertial and label in taken}
        if "TimeUS" in taken:
            hints["t_s"] = "SampleUS" if "SampleUS" in taken else "TimeUS"
        title = name if mark is None or len(marks) == 1 else f"{name}[{mark}]"
        tables.append(SourceTable(made, form, where, title, remarks=remarks, hints=hints))
    return tables


def _at_least_one(tables: list[SourceTable], where: str) -> tuple[SourceTable, ...]:
    if not tables:
        raise InputError("holds no message of a known type", where=where, remedy="the log is empty or damaged")
    return tuple(tables)
