"""Tables of other libraries: pandas, polars, Arrow, or whatever offers its columns by a protocol; dicts of arrays.

What comes in is a `Table` inside and goes out as what it was: a pandas DataFrame keeps its index and the columns that
highside does not know, a polars DataFrame stays one, a dict of arrays is a dict of arrays again. A table that speaks
the Arrow PyCapsule interface (`__arrow_c_stream__`) or the DataFrame interchange protocol (`__dataframe__`), and is of
no library known here, comes back as a `pyarrow.Table`. The libraries are spoken to through narwhals (extra `frames`),
which DataFrames alone need, as Arrow needs pyarrow (extra `export`).

A missing value is NaN in a `Table`, in pandas and in a dict, null in polars and Arrow.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from highside.errors import InputError
from highside.reading import read_bytes
from highside.recording.as_frames import library, pyarrow
from highside.recording.columns import Column, expected_in
from highside.recording.table import Table

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "ArrowStream",
    "Columns",
    "File",
    "FrameT",
    "GivenTable",
    "Interchange",
    "source_of",
    "take",
]

TableT = TypeVar("TableT", bound=Table)


class ArrowStream(Protocol):
    """A table that offers its columns by the Arrow PyCapsule interface: polars, pyarrow, pandas, highside's own."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """A capsule of an Arrow stream."""


class Interchange(Protocol):
    """A table that offers its columns by the DataFrame interchange protocol."""

    def __dataframe__(self, nan_as_null: bool = False, allow_copy: bool = True) -> object:
        """The exchange object."""


File: TypeAlias = str | os.PathLike[str]
Columns: TypeAlias = "Mapping[str, ArrayLike]"
"""column by name, each (N,)"""
FrameT = TypeVar("FrameT", bound=ArrowStream | Interchange)
"""a DataFrame of any library, or a `Table` of highside"""


@dataclass(frozen=True, slots=True)
class GivenTable(Generic[TableT]):
    """A table that came from somewhere, and the way to give an answer back in the same kind."""

    table: TableT
    _given: Any
    """a narwhals DataFrame, a mapping, or None for files and Tables"""

    def with_columns(self, columns: Mapping[str, Column], texts: Mapping[str, Sequence[str]] | None = None) -> Any:
        """What was given, with columns (N,) and columns of text added or replaced behind the others."""
        texts = texts or {}
        if self._given is None:
            return self.table.with_columns(columns, texts)
        if isinstance(self._given, Mapping):
            known = self.table.columns
            own = {name: known.get(name, values) for name, values in self._given.items()}
            return own | dict(columns) | {name: np.asarray(values) for name, values in texts.items()}
        added = [_series(self._given, name, values) for name, values in columns.items()]
        added += [_series(self._given, name, values) for name, values in texts.items()]
        return self._given.with_columns(*added).to_native()

    def new(self, table: Table) -> Any:
        """Another table, of any number of rows, in the kind that was given."""
        if self._given is None:
            return table
        cells: dict[str, Any] = {name: table.columns.get(name, table.texts.get(name)) for name in table.order}
        if isinstance(self._given, Mapping):
            return {name: np.asarray(values) for name, values in cells.items()}
        import narwhals as nw

        made = {name: _series(self._given, name, values) for name, values in cells.items()}
        return nw.from_dict(made, backend=self._given.implementation).to_native()


def take(data: File | Columns | ArrowStream | Interchange, kind: type[TableT]) -> GivenTable[TableT]:
    """Take a file, a Table, a dict of arrays or a DataFrame as a Table of this kind.

    Raises InputError for a file or table that is not in order (it names column and row), and for what is no table.
    """
    if isinstance(data, str | os.PathLike):
        return GivenTable(kind.read(Path(data)), None)
    if isinstance(data, Table):
        return GivenTable(kind(data.columns, data.texts, data.order, data.source), None)
    if isinstance(data, Mapping):
        return GivenTable(_of_mapping(data, kind), data)
    frame = _frame(data)
    columns: dict[str, Column] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for name in frame.columns:
        values = _cells(frame[name], name, kind)
        if isinstance(values, tuple):
            texts[name] = values
        elif values is not None:
            columns[name] = values
    _require_finite(columns, kind)
    return GivenTable(kind(columns, texts), frame)


def source_of(data: object, table: Table) -> tuple[str, str]:
    """Name and SHA-256 of what a table was taken from: of a file its bytes, else of the CSV that the table would be."""
    if isinstance(data, str | os.PathLike):
        return Path(data).name, hashlib.sha256(read_bytes(Path(data))).hexdigest()
    name = "table" if table.source is None else Path(table.source).name
    return name, hashlib.sha256(table.as_csv().encode()).hexdigest()


# --- in ------------------------------------------------------------------------------------------------------


def _of_mapping(data: Mapping[str, Any], kind: type[TableT]) -> TableT:
    columns: dict[str, Column] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for name, given in data.items():
        values = np.asarray(given)
        if values.ndim != 1:
            raise InputError(f"has the shape {values.shape}", field=name, remedy="a column is one row of numbers, (N,)")
        if values.dtype.kind in "biuf":
            columns[name] = values.astype(np.float64)
            continue
        numbers = _as_numbers(values.tolist())
        if numbers is not None:
            columns[name] = numbers
        else:
            texts[name] = _as_texts(values.tolist(), name, kind)
    lengths = {name: len(values) for name, values in (*columns.items(), *texts.items())}
    if len(set(lengths.values())) > 1:
        shortest, longest = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        raise InputError(
            f"has {lengths[shortest]} rows where {longest} has {lengths[longest]}",
            field=shortest,
            remedy="all columns of a table are of one length",
        )
    _require_finite(columns, kind)
    return kind(columns, texts)


def _frame(data: object) -> Any:
    """The DataFrame as narwhals sees it. Raises InputError for what is none, or where a library is missing."""
    if not any(hasattr(data, way) for way in ("__arrow_c_stream__", "__dataframe__", "collect_schema")):
        raise InputError(
            f"a {type(data).__name__} is no table", remedy="give a file, a DataFrame, or a dict of columns"
        )
    nw = _narwhals()
    found = nw.from_native(data, eager_only=True, pass_through=True)
    if isinstance(found, nw.DataFrame):
        return found
    if hasattr(data, "__arrow_c_stream__"):
        return nw.from_native(pyarrow().table(data), eager_only=True)
    if hasattr(data, "__dataframe__"):
        pyarrow()
        from pyarrow.interchange import from_dataframe

        return nw.from_native(from_dataframe(data), eager_only=True)
    raise InputError(f"a {type(data).__name__} has no rows yet", remedy="collect() it")


def _cells(series: Any, name: str, kind: type[Table]) -> Column | tuple[str, ...] | None:
    """Numbers, texts, or None for what is neither and has no meaning here (it stays in what was given)."""
    nw = _narwhals()
    dtype = series.dtype
    if dtype.is_numeric() or dtype == nw.Boolean:
        return np.array(series.cast(nw.Float64).fill_null(float("nan")).to_numpy(), dtype=np.float64)
    if dtype in (nw.String, nw.Categorical, nw.Object, nw.Enum, nw.Unknown):
        values = series.to_list()
        numbers = _as_numbers(values)
        return _as_texts(values, name, kind) if numbers is None else numbers
    if name in kind.known:
        raise InputError(f"is of the type {dtype}, {expected_in(name)} are expected", where="table", field=name)
    return None


def _as_numbers(values: Iterable[Any]) -> Column | None:
    """Numbers, NaN for None; or None where a text is among them."""
    made = [float("nan") if value is None else value for value in values]
    if any(isinstance(value, str | bytes) for value in made):
        return None
    try:
        return np.array(made, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _as_texts(values: Sequence[Any], name: str, kind: type[Table]) -> tuple[str, ...]:
    if name in kind.known and name != "pose":
        row, text = next((row, value) for row, value in enumerate(values) if value is not None)
        raise InputError(f"is a text ({text!r}), {expected_in(name)} are expected", where=f"row {row}", field=name)
    return tuple("" if value is None or value != value else str(value) for value in values)


def _require_finite(columns: Mapping[str, Column], kind: type[Table]) -> None:
    """As a file is held to: no infinite number where one is known, no row without its time."""
    for name, values in columns.items():
        wrong = np.isinf(values) if name in kind.known else np.zeros(0, dtype=bool)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{values[row]} is not a finite number",
                where=f"row {row}",
                field=name,
                remedy=f"{expected_in(name)} are expected",
            )
        if name == "t_s" and np.isnan(values).any():
            raise InputError("every row needs its time", where=f"row {int(np.argmax(np.isnan(values)))}", field=name)


# --- out -----------------------------------------------------------------------------------------------------


def _series(frame: Any, name: str, values: Column | Sequence[str]) -> Any:
    """A column in the library of a narwhals DataFrame; what is missing is null, in pandas NaN."""
    nw = _narwhals()
    if not isinstance(values, np.ndarray):
        return nw.new_series(name, list(values), nw.String, backend=frame.implementation)
    missing = np.isnan(values)
    if missing.any() and not frame.implementation.is_pandas_like():
        numbers = [None if gone else value for value, gone in zip(values.tolist(), missing.tolist(), strict=True)]
        return nw.new_series(name, numbers, nw.Float64, backend=frame.implementation)
    return nw.new_series(name, values, nw.Float64, backend=frame.implementation)


def _narwhals() -> Any:
    return library("narwhals", "pip install 'highside[frames]'")
