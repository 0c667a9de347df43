"""Lines of delimited text, set up by parameters: which lines are readings, which column is what.

A line ends with a line feed. It is
- a reading (`framed`), if it has the configured columns, every one that is used is a plain decimal number, it passes
the
  checksum where one is configured, and it is selected (its `select` column holds the configured text);
- bad, if it is selected but is damaged: too few or too many columns, a cell that is not a number, a wrong checksum;
- ignored, if it is a line of the same form that is not selected (another sensor on the same line);
- text, if it is readable and has another form (boot text, NMEA sentences, a line without any delimiter);
- junk otherwise (unprintable bytes, a line longer than `max_line_bytes`).

Whoever connects while a line is being sent sees its end first, and the end of a line may look like a reading with wrong
numbers. So without a checksum everything before the first line feed is passed over, after the start and after each
interruption.
"""

from __future__ import annotations

import math
import re
from functools import reduce
from operator import xor
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from highside.codec.frame import FRAME_COLUMNS, NAN, Counts, Frame
from highside.codec.registry import CodecTable, only_measured
from highside.reading.config_table import ConfigTable

_NUMBER = re.compile(r"\s*[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?\s*")


class ColumnConfig(ConfigTable):
    """A quantity in a line of text: the number in a column, times `scale`, plus `offset`."""

    column: int = Field(ge=0, le=255, description="Number of the column, from 0.")
    scale: float = Field(default=1.0, allow_inf_nan=False, description="Unit of the Recording per count.")
    offset: float = Field(default=0.0, allow_inf_nan=False, description="Added after scaling.")


class TimeConfig(ConfigTable):
    """A part of the device's time; all parts are added up."""

    column: int = Field(ge=0, le=255, description="Number of the column, from 0.")
    scale: float = Field(default=1.0, allow_inf_nan=False, description="Seconds per count.")
    divide_by_column: int | None = Field(default=None, ge=0, le=255, description="Column to divide by, if any.")


class SelectConfig(ConfigTable):
    """Which lines are ours."""

    column: int = Field(ge=0, le=255, description="Number of the column, from 0.")
    equals: str = Field(description="The text in that column.")


class DelimitedCodecConfig(CodecTable):
    """Lines of delimited text. `fields` gives the columns of a Recording (`ax_g`, `temp_c`, ...) and any others."""

    name: Literal["delimited"]
    delimiter: str = Field(default=",", min_length=1, max_length=4, description="What stands between two columns.")
    prefix: str = Field(default="", max_length=64, description="A reading begins with this; removed before cutting.")
    columns: int | None = Field(default=None, ge=2, le=256, description="Exact number of columns of a reading.")
    select: SelectConfig | None = Field(default=None, description="Take only lines with this text in this column.")
    time: tuple[TimeConfig, ...] = Field(default=(), description="Columns that add up to the device's time in s.")
    time_wrap_s: float | None = Field(default=None, gt=0, description="The device's time starts anew after this.")
    seq_column: int | None = Field(default=None, ge=0, le=255, description="Column of the device's frame counter.")
    seq_modulus: int | None = Field(default=None, ge=2, description="Period of that counter.")
    checksum: Literal["nmea"] | None = Field(
        default=None, description="`*HH` at the end of a line: the XOR of all before the `*`, but for a leading `$`."
    )
    max_line_bytes: int = Field(default=512, ge=16, le=65536, description="A longer line is junk.")
    fields: dict[str, ColumnConfig] = Field(min_length=1, description="Quantity -> column, scale, offset.")

    @field_validator("fields")
    @classmethod
    def _fields(cls, fields: dict[str, ColumnConfig]) -> dict[str, ColumnConfig]:
        only_measured(fields)
        return fields

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.seq_column is None) != (self.seq_modulus is None):
            raise ValueError("give seq_column and seq_modulus together")
        used = {f"fields.{name}": column.column for name, column in self.fields.items()}
        used |= {f"time[{i}]": max(t.column, t.divide_by_column or 0) for i, t in enumerate(self.time)}
        if self.seq_column is not None:
            used["seq_column"] = self.seq_column
        if self.select is not None:
            used["select"] = self.select.column
        for name, index in used.items():
            if self.columns is not None and index >= self.columns:
                raise ValueError(f"{name}: column {index} is beyond the {self.columns} columns (counted from 0)")
        return self

    def build(self) -> DelimitedCodec:
        return DelimitedCodec(self)


class DelimitedCodec:
    """Decoder of lines of delimited text."""

    name = "delimited"

    def __init__(self, layout: DelimitedCodecConfig) -> None:
        self.counts = Counts()
        self.seq_modulus = layout.seq_modulus
        self.extra_columns = tuple(name for name in layout.fields if name not in FRAME_COLUMNS)
        self._layout = layout
        where = {name: (column.column, column.scale, column.offset) for name, column in layout.fields.items()}
        self._known = [where.get(name) for name in FRAME_COLUMNS]
        self._extra = [where[name] for name in self.extra_columns]
        used = [column.column for column in layout.fields.values()]
        used += [index for term in layout.time for index in (term.column, term.divide_by_column) if index is not None]
        used += [] if layout.seq_column is None else [layout.seq_column]
        used += [] if layout.select is None else [layout.select.column]
        self._needed = max(used) + 1
        axes = layout.axis_map()
        self._axes = None if axes.identity else axes
        self._tail = b""
        self._too_long = False
        self._in_step = layout.checksum is not None
        self._days = 0.0
        self._last_t: float | None = None

    def receive(self, data: bytes, t_mono: float = 0.0) -> list[Frame]:
        counts = self.counts
        counts.bytes_in += len(data)
        *lines, tail = (self._tail + data).split(b"\n")
        out: list[Frame] = []
        for line in lines:
            if self._too_long:
                counts.bytes_junk += len(line) + 1
                self._too_long = False
                self._in_step = True
            else:
                self._line(line, t_mono, out)
        if len(tail) > self._layout.max_line_bytes or self._too_long:
            counts.bytes_junk += len(tail)
            self._too_long = True
            tail = b""
        self._tail = tail
        counts.bytes_pending = len(tail)
        return out

    def reset(self) -> None:
        self.counts.bytes_junk += len(self._tail)
        self.counts.bytes_pending = 0
        self._tail = b""
        self._too_long = False
        self._in_step = self._layout.checksum is not None

    def flush(self) -> list[Frame]:
        # a line without its end may lack digits: it is not used
        self.reset()
        return []

    def _line(self, line: bytes, t_mono: float, out: list[Frame]) -> None:
        """Decide what a line is and count it with its line feed."""
        counts, layout = self.counts, self._layout
        size = len(line) + 1
        if size > layout.max_line_bytes + 1:
            counts.bytes_junk += size
            self._in_step = True
            return
        try:
            text = line.decode("ascii").rstrip("\r")
        except UnicodeDecodeError:
            text = "\0"
        if not text.replace("\t", " ").isprintable():
            counts.bytes_junk += size
            self._in_step = True
            return
        if not self._in_step:
            self._in_step = True
            counts.bytes_text += size
            return
        kind, frame = self._parse(text, t_mono)
        if kind == "good" and frame is not None:
            counts.frames_good += 1
            counts.bytes_framed += size
            out.append(frame)
        elif kind == "bad":
            counts.frames_bad += 1
            counts.bytes_bad += size
        elif kind == "ignored":
            counts.frames_ignored += 1
            counts.bytes_ignored += size
        else:
            counts.bytes_text += size

    def _parse(self, text: str, t_mono: float) -> tuple[str, Frame | None]:
        layout = self._layout
        if layout.prefix and not text.startswith(layout.prefix):
            return "text", None
        body = text
        summed = True
        if layout.checksum is not None:
            body, star, digits = text.rpartition("*")
            checked = body.removeprefix("$").encode("ascii")
            summed = star == "*" and digits.upper() == f"{reduce(xor, checked, 0):02X}"
            if not star:
                body = text
        if layout.prefix:
            body = body[len(layout.prefix) :]
        cells = body.split(layout.delimiter)
        if len(cells) < 2:
            return "text", None
        whole = len(cells) == layout.columns if layout.columns is not None else len(cells) >= self._needed
        if layout.select is not None:
            index = layout.select.column
            if index >= len(cells) or cells[index].strip() != layout.select.equals:
                return ("ignored" if whole and summed else "text"), None
        if not whole or not summed:
            return "bad", None
        frame = self._frame(cells, t_mono)
        return ("good", frame) if frame is not None else ("bad", None)

    def _frame(self, cells: list[str], t_mono: float) -> Frame | None:
        layout = self._layout
        try:
            known = [_value(cells, column) for column in self._known]
            extra = tuple(_required(cells, column) for column in self._extra)
            seq = _whole(cells[layout.seq_column]) if layout.seq_column is not None else None
            t_s = self._time(cells) if layout.time else None
        except (ValueError, ZeroDivisionError, OverflowError):
            return None
        ax, ay, az, gx, gy, gz, temp_c, rotor_deg, rotor_rate_dps = known
        if self._axes is not None:
            ax, ay, az = self._axes.apply(ax, ay, az)
            gx, gy, gz = self._axes.apply(gx, gy, gz)
        return Frame(
            seq,
            t_s,
            t_mono,
            NAN if ax is None else ax,
            NAN if ay is None else ay,
            NAN if az is None else az,
            gx,
            gy,
            gz,
            temp_c,
            rotor_deg,
            rotor_rate_dps,
            extra or None,
        )

    def _time(self, cells: list[str]) -> float:
        """Device time in s, unwrapped. Only a line that is good in everything else may move the clock."""
        t = 0.0
        for term in self._layout.time:
            part = _number(cells[term.column]) * term.scale
            t += part / _number(cells[term.divide_by_column]) if term.divide_by_column is not None else part
        if not math.isfinite(t):
            raise ValueError("time is not finite")
        wrap = self._layout.time_wrap_s
        if wrap is not None:
            if not 0.0 <= t <= wrap:
                raise ValueError("time is beyond its period")
            if self._last_t is not None:
                self._days += -wrap * round((t - self._last_t) / wrap)
            self._last_t = t
        return t + self._days


def _number(cell: str) -> float:
    """A plain decimal number; `nan`, `inf`, `1_000` and hexadecimal are none."""
    if not _NUMBER.fullmatch(cell):
        raise ValueError("not a number")
    value = float(cell)
    if not math.isfinite(value):
        raise ValueError("not finite")
    return value


def _whole(cell: str) -> int:
    value = _number(cell)
    if not value.is_integer():
        raise ValueError("not a whole number")
    return int(value)


def _required(cells: list[str], where: tuple[int, float, float]) -> float:
    column, scale, offset = where
    return _number(cells[column]) * scale + offset


def _value(cells: list[str], where: tuple[int, float, float] | None) -> float | None:
    return None if where is None else _required(cells, where)


CODEC = DelimitedCodecConfig
