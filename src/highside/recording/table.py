"""Tables that commands exchange: the Recording (one row a frame) and the pose table (one row a pose), as CSV.

A file has a header row and one row of numbers after the other; names that end in `.gz` are gzipped. Numbers are
written with the shortest digits that read back exactly. An empty cell (or `nan`) is a value that is missing; infinite
values are refused. Columns that highside does not know are kept where they are and ignored; they may hold text.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from highside.codec.frame import ADDED_COLUMNS, FRAME_COLUMNS, Frame
from highside.errors import InputError
from highside.reading import csv_header, csv_rows, decode_text, read_bytes
from highside.reading.columnar import MCAP_MAGIC, PARQUET_MAGIC, mcap_json_columns, parquet_columns
from highside.reading.large import LARGE_BYTES, columns_at_once
from highside.reading.table import MAX_HEADER_CHARACTERS, numbers_at_once
from highside.recording.columns import Column, expected_in
from highside.recording.files import write_whole
from highside.recording.of_another import import_hint, of_another

if TYPE_CHECKING:
    from highside.shown.plot import Plot

RECORDING_COLUMNS = ("t_s", *FRAME_COLUMNS, *ADDED_COLUMNS)
POSE_COLUMNS = ("inc_ref_deg", "tf_ref_deg", "ax", "ay", "az", "n", "std_ax", "std_ay", "std_az", "temp_c")
SUMMARY_COLUMNS = ("inc_ref_deg", "d_inc_mean_deg", "d_inc_pp_deg", "d_tf_mean_deg", "d_tf_pp_deg")
_WHOLE = frozenset({"seq", "pose", "direction", "n"})
_CELL_SHOWN = 40
_ROWS_AT_ONCE = 16_384
"""rows that are written as text at a time"""


@dataclass(slots=True)
class Table:
    """Columns of equal length by name, in the order of the file. `source` names the file in errors.

    `columns` holds numbers (NaN where missing), `texts` the unknown columns that are no numbers, `order` all names.
    """

    columns: dict[str, Column]
    texts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    order: tuple[str, ...] = ()
    source: str | None = None

    mandatory: ClassVar[tuple[str, ...]] = ()
    known: ClassVar[tuple[str, ...]] = ()
    rows_are: ClassVar[str] = "rows"

    def __post_init__(self) -> None:
        self.columns = {name: np.ascontiguousarray(column, dtype=np.float64) for name, column in self.columns.items()}
        present = (*self.columns, *self.texts)
        if not self.order or set(self.order) != set(present):
            self.order = (
                *(name for name in self.order if name in present),
                *(n for n in present if n not in self.order),
            )
        sizes = {name: column.size for name, column in self.columns.items()}
        sizes |= {name: len(texts) for name, texts in self.texts.items()}
        if any(column.ndim != 1 for column in self.columns.values()) or len(set(sizes.values())) > 1:
            raise ValueError(f"columns of unequal length: {sizes}")
        self.require(*self.mandatory)

    @property
    def n(self) -> int:
        """Number of rows."""
        return next((column.size for column in self.columns.values()), 0)

    def __getitem__(self, name: str) -> Column:
        """The column of that name, (N,). Raises InputError where it is absent or holds no number."""
        return self.require(name)[0]

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame` of all columns. Raises InputError where pandas is not installed."""
        from highside.recording.as_frames import as_pandas

        return as_pandas(self)

    def to_polars(self) -> Any:
        """A `polars.DataFrame` of all columns, missing values null. Raises InputError where polars is not installed."""
        from highside.recording.as_frames import as_polars

        return as_polars(self)

    def to_arrow(self) -> Any:
        """A `pyarrow.Table` of all columns, missing values null. Raises InputError where pyarrow is not installed."""
        from highside.recording.as_frames import as_arrow

        return as_arrow(self)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The Arrow PyCapsule interface: `polars.DataFrame(table)`, `pyarrow.table(table)` and others take it so."""
        from highside.recording.as_frames import arrow_stream

        return arrow_stream(self, requested_schema)

    def _repr_html_(self) -> str:
        """What a notebook shows: the first and the last rows."""
        from highside.recording.shown import html_of

        return html_of(self)

    def plot(self, *names: str) -> Plot:
        """Columns over time (over the row where there is no `t_s`), those of one unit in one panel.

        `names`: which columns; all numbers where none is named. Raises InputError for a column that is absent.
        """
        from highside.recording.shown import chart_of

        return chart_of(self, names)

    def has(self, *names: str) -> bool:
        """Whether all these columns are there as numbers."""
        return all(name in self.columns for name in names)

    def require(self, *names: str) -> tuple[Column, ...]:
        """The named columns. Raises InputError that names those that are absent, or that hold no number at all."""
        absent = [name for name in names if name not in self.columns]
        for name in absent:
            if name in self.texts:
                line, cell = _first_text(self.texts[name])
                raise _no_number(cell, self.place(line - 2), name)
        if absent:
            raise InputError(
                f"lacks the column{'s' if len(absent) > 1 else ''} {', '.join(absent)}",
                where=self.source,
                remedy=f"it has: {', '.join(self.order) or 'none'}{import_hint(self.source, absent)}",
            )
        empty = [name for name in names if self.n and bool(np.all(np.isnan(self.columns[name])))]
        if empty:
            raise InputError("holds no number in any row", where=self.source, field=empty[0])
        return tuple(self.columns[name] for name in names)

    def complete(self, *names: str) -> NDArray[np.float64]:
        """The named columns as (len(names), N), every value there. Raises InputError that names the first gap."""
        block = np.vstack(self.require(*names))
        gaps = np.argwhere(np.isnan(block).T)
        if gaps.size:
            row, column = gaps[0]
            raise InputError(
                "is missing", where=self.place(int(row)), field=names[column], remedy="fill it in or leave the row out"
            )
        return block

    def rows_without(self, *names: str) -> int:
        """Number of rows in which a value of these columns is missing."""
        return int(np.isnan(np.vstack([self.columns[name] for name in names])).any(axis=0).sum()) if names else 0

    def place(self, row: int) -> str:
        """Where a row (from 0) stands, for an error: the line of the file, or the row of a table that is of no file."""
        return f"table: row {row}" if self.source is None else f"{self.source}: line {row + 2}"

    def with_columns(self, columns: Mapping[str, Column], texts: Mapping[str, Sequence[str]] | None = None) -> Self:
        """A copy with columns (N,) added (or replaced) behind the others, and columns of text last."""
        if not texts:
            return replace(self, columns={**self.columns, **columns})
        numbers = {name: values for name, values in {**self.columns, **columns}.items() if name not in texts}
        order = (*(name for name in (*self.order, *columns) if name not in texts), *texts)
        words = self.texts | {name: tuple(values) for name, values in texts.items()}
        return replace(self, columns=numbers, texts=words, order=tuple(dict.fromkeys(order)))

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        """A copy with some rows: a mask (N,) or row numbers."""
        numbers = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        texts = {name: tuple(values[i] for i in numbers) for name, values in self.texts.items()}
        return replace(self, columns={name: column[numbers] for name, column in self.columns.items()}, texts=texts)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file. Raises InputError with file, line and column for whatever is wrong with it."""
        with of_another(str(path), tables_alone=cls.known == POSE_COLUMNS or cls.known == SUMMARY_COLUMNS):
            return cls._read(path)

    @classmethod
    def _read(cls, path: str | os.PathLike[str]) -> Self:
        where = str(path)
        data = read_bytes(Path(path))
        if not data.strip():
            raise InputError("is empty", where=where)
        if data.startswith((PARQUET_MAGIC, MCAP_MAGIC)):
            return cls._of_columns(data, where)
        large = cls._at_once(data, where) if len(data) > LARGE_BYTES else None
        if large is not None:
            return large
        text = decode_text(data, where=where, expected="CSV file")
        header, _, body = text.partition("\n")
        names = csv_header(header.removesuffix("\r"), where=where)
        lines = body.split("\n")
        while lines and not lines[-1].strip("\r"):
            lines.pop()
        if not lines:
            raise InputError(f"has a header but no {cls.rows_are}", where=where)
        fast = None if '"' in body or "_" in body else numbers_at_once(lines, len(names))
        if fast is not None:
            return cls(dict(zip(names, fast, strict=True)), order=names, source=where)
        columns, texts = _cell_by_cell(lines, names, cls.known, where)
        return cls(columns, texts, names, where)

    @classmethod
    def _at_once(cls, data: bytes, where: str) -> Self | None:
        """A large CSV by pyarrow's parser; None for what the reader below has to say something of."""
        begin = data.find(b"\n") + 1
        if not 0 < begin <= MAX_HEADER_CHARACTERS:
            return None
        names = csv_header(decode_text(data[:begin], where=where, expected="CSV file").rstrip("\r\n"), where=where)
        found = columns_at_once(data, names, begin=begin)
        if found is None or any(column.texts is not None and column.name in cls.known for column in found):
            return None
        columns = {column.name: column.numbers for column in found if column.numbers is not None}
        texts = {column.name: column.texts for column in found if column.texts is not None}
        timed = not np.isnan(columns.get("t_s", 0.0)).any() and all(cell.strip() for cell in texts.get("t_s", ()))
        read = timed and all(_first_text(cells)[1] for cells in texts.values())
        return cls(columns, texts, names, where) if read else None

    @classmethod
    def _of_columns(cls, data: bytes, where: str) -> Self:
        """A Parquet or MCAP file as `export` writes them."""
        parquet = data.startswith(PARQUET_MAGIC)
        found = parquet_columns(data, where=where) if parquet else mcap_json_columns(data, where=where)
        columns, texts = {}, {}
        for column in found:
            if column.numbers is not None and not column.instant:
                _finite_where_known(column.name, column.numbers, cls.known, where)
                columns[column.name] = column.numbers
            elif column.texts is not None:
                texts[column.name] = column.texts
        if not columns and not texts:
            raise InputError(f"has no {cls.rows_are}", where=where)
        return cls(columns, texts, tuple(c.name for c in found if c.name in columns or c.name in texts), where)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a file as a whole (never half); `.gz` zips it. Raises InputError where it cannot be written."""
        write_whole(Path(path), b"".join(piece.encode("utf-8") for piece in self._csv_pieces()))

    def as_csv(self) -> str:
        """The content of the file."""
        return "".join(self._csv_pieces())

    def _csv_pieces(self) -> Iterator[str]:
        """The content in pieces of some rows: cells as texts take twenty times as much memory as the file."""
        for begin in range(0, max(self.n, 1), _ROWS_AT_ONCE):
            rows = slice(begin, begin + _ROWS_AT_ONCE)
            cells = [
                _formatted(self.columns[name][rows], name) if name in self.columns else self.texts[name][rows]
                for name in self.order
            ]
            head = [self.order] if begin == 0 else []
            if self.texts:
                out = io.StringIO(newline="")
                csv.writer(out, lineterminator="\n").writerows([*head, *zip(*cells, strict=True)])
                yield out.getvalue()
            else:
                yield "".join(",".join(row) + "\n" for row in (*head, *zip(*cells, strict=True)))


@dataclass(slots=True)
class Recording(Table):
    """One row a frame; `t_s` is mandatory, everything else optional. Units are in the names."""

    mandatory: ClassVar[tuple[str, ...]] = ("t_s",)
    known: ClassVar[tuple[str, ...]] = RECORDING_COLUMNS
    rows_are: ClassVar[str] = "frames"

    @property
    def t_s(self) -> Column:
        """Time in s, (N,)."""
        return self.columns["t_s"]

    def accel(self) -> NDArray[np.float64]:
        """Accelerations in g, (3, N). Raises InputError if a column or a value is missing."""
        return self.complete("ax_g", "ay_g", "az_g")

    def gyro(self) -> NDArray[np.float64]:
        """Angular rates in deg/s, (3, N). Raises InputError if a column or a value is missing."""
        return self.complete("gx_dps", "gy_dps", "gz_dps")


@dataclass(slots=True)
class PoseTable(Table):
    """One row a pose: where the bench says the tool was, and the raw mean of its readings there."""

    mandatory: ClassVar[tuple[str, ...]] = ("inc_ref_deg", "tf_ref_deg", "ax", "ay", "az")
    known: ClassVar[tuple[str, ...]] = POSE_COLUMNS
    rows_are: ClassVar[str] = "poses"

    def accel(self) -> NDArray[np.float64]:
        """Raw means in g, (3, N). Raises InputError if a value is missing."""
        return self.complete("ax", "ay", "az")

    def reference_deg(self) -> NDArray[np.float64]:
        """Reference inclination and toolface in deg, (2, N). Raises InputError if a value is missing."""
        return self.complete("inc_ref_deg", "tf_ref_deg")

    def std(self) -> NDArray[np.float64] | None:
        """Standard deviation of one reading in g, (3, N), or None if the table does not give it."""
        names = ("std_ax", "std_ay", "std_az")
        return np.vstack([self.columns[name] for name in names]) if self.has(*names) else None


class Readings(Table):
    """Readings to be corrected: rows of a Recording or of a pose table; which columns are needed, the request says."""

    known: ClassVar[tuple[str, ...]] = (*RECORDING_COLUMNS, *POSE_COLUMNS)


class SolverTable(Table):
    """A pose table to be solved: which columns are needed depends on what is known of the poses."""

    known: ClassVar[tuple[str, ...]] = POSE_COLUMNS


class SummaryTable(Table):
    """A published or summarised error table: one row an inclination, mean and peak-to-peak over a revolution in deg."""

    mandatory: ClassVar[tuple[str, ...]] = SUMMARY_COLUMNS
    known: ClassVar[tuple[str, ...]] = SUMMARY_COLUMNS
    rows_are: ClassVar[str] = "inclinations"


def read_recording(path: Path) -> Recording:
    """Read a Recording; see `Table.read`."""
    return Recording.read(path)


def write_recording(path: Path, recording: Recording) -> None:
    """Write a Recording as a whole; see `Table.write`."""
    recording.write(path)


def read_poses(path: Path) -> PoseTable:
    """Read a pose table; see `Table.read`."""
    return PoseTable.read(path)


def write_poses(path: Path, poses: PoseTable) -> None:
    """Write a pose table as a whole; see `Table.write`."""
    poses.write(path)


def from_frames(frames: Sequence[Frame], t_s: Iterable[float], extra_columns: Sequence[str] = ()) -> Recording:
    """A Recording of decoded frames and their times. Columns of which no frame holds anything are omitted."""
    columns: dict[str, Column] = {"t_s": np.fromiter(t_s, np.float64, len(frames))}
    values: dict[str, list[float | None]] = {
        column: [getattr(frame, name) for frame in frames] for column, name in FRAME_COLUMNS.items()
    }
    values["seq"] = [frame.seq for frame in frames]
    for place, column in enumerate(extra_columns):
        values[column] = [frame.extra[place] if frame.extra is not None else None for frame in frames]
    for column, given in values.items():
        array = np.array(given, dtype=np.float64)
        if not np.all(np.isnan(array)):
            columns[column] = array
    return Recording(columns)


def _cell_by_cell(
    lines: list[str], names: tuple[str, ...], known: tuple[str, ...], where: str
) -> tuple[dict[str, Column], dict[str, tuple[str, ...]]]:
    """Tables with empty cells, text or errors."""
    rows: list[list[str]] = []
    for number, row in enumerate(csv_rows(lines, where=where), start=2):
        if len(row) != len(names):
            raise InputError(f"has {len(row)} cells where the header has {len(names)}", where=f"{where}: line {number}")
        rows.append(row)
    columns: dict[str, Column] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        values = np.empty(len(cells))
        for i, cell in enumerate(cells):
            stripped = cell.strip()
            try:
                values[i] = float(stripped) if stripped else np.nan
            except ValueError:
                values[i] = np.inf
            if np.isinf(values[i]) or "_" in stripped:
                if name not in known:
                    texts[name] = cells
                    break
                raise _no_number(stripped, f"{where}: line {i + 2}", name)
            if name == "t_s" and np.isnan(values[i]):
                raise InputError("every row needs its time", where=f"{where}: line {i + 2}", field=name)
        else:
            columns[name] = values
    return columns, texts


def _finite_where_known(name: str, values: Column, known: tuple[str, ...], where: str) -> None:
    """As the cells of a CSV are held to: no infinite number where one is known, no row without its time."""
    wrong = np.isinf(values) if name in known else np.zeros(0, dtype=bool)
    if wrong.any():
        at = f"{where}: row {int(np.argmax(wrong)) + 1}"
        raise InputError("is not a finite number", where=at, field=name, remedy=f"{expected_in(name)} are expected")
    if name == "t_s" and np.isnan(values).any():
        at = f"{where}: row {int(np.argmax(np.isnan(values))) + 1}"
        raise InputError("every row needs its time", where=at, field=name)


def _number(cell: str) -> float | None:
    """As Python reads it, or None for a text."""
    try:
        return float(cell)
    except ValueError:
        return None


def _first_text(cells: tuple[str, ...]) -> tuple[int, str]:
    """(line of the file, cell) of the first cell that made its column one of texts."""
    for line, cell in enumerate(cells, start=2):
        stripped = cell.strip()
        if stripped and ("_" in stripped or (value := _number(stripped)) is None or np.isinf(value)):
            return line, stripped
    return 2, ""


def _no_number(cell: str, at: str, name: str) -> InputError:
    """For a cell of a column that must hold numbers."""
    shown = cell if len(cell) <= _CELL_SHOWN else cell[:_CELL_SHOWN] + "..."
    unit = expected_in(name)
    if _number(cell) is None:
        return InputError(f"is a text ({shown!r}), {unit} are expected", where=at, field=name)
    return InputError(f"{shown!r} is not a finite number", where=at, field=name, remedy=f"{unit} are expected")


def _formatted(column: Column, name: str) -> list[str]:
    """Cells of a column: shortest exact digits, whole numbers where the column counts, nothing for NaN."""
    values = column.tolist()
    if name in _WHOLE:
        return ["" if v != v else (str(int(v)) if v.is_integer() else repr(v)) for v in values]
    if np.isnan(column).any():
        return ["" if v != v else repr(v) for v in values]
    return list(map(repr, values))
