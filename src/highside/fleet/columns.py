"""Rows of results as columns of Parquet, of types that are known beforehand.

Parts of one job all have the same columns and types, so that they are read as one table. The arrays are made of their
buffers: given lists of Python objects, pyarrow looks whether they are of pandas, and imports it, which takes a process
as long as thirty short sessions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from highside.errors import InputError
from highside.fleet.catalogue import INSTALL

__all__ = ["KINDS", "table_of", "table_of_texts"]

Made = Callable[[Sequence[Any]], Any]
"""an Arrow array of the values of a column"""


def _texts(values: Sequence[str | None]) -> Any:
    import pyarrow as pa

    pieces = [b"" if value is None else value.encode() for value in values]
    ends = np.cumsum([0, *map(len, pieces)], dtype=np.int64)
    buffers = [_valid(values), pa.py_buffer(ends), pa.py_buffer(b"".join(pieces))]
    return pa.Array.from_buffers(pa.large_string(), len(values), buffers)


def _numbers(values: Sequence[float | None]) -> Any:
    import pyarrow as pa

    numbers = np.array([np.nan if value is None else value for value in values], dtype=float)
    return pa.Array.from_buffers(pa.float64(), len(values), [_valid(values), pa.py_buffer(numbers)])


def _counts(values: Sequence[int]) -> Any:
    import pyarrow as pa

    return pa.Array.from_buffers(pa.int64(), len(values), [None, pa.py_buffer(np.array(values, dtype=np.int64))])


def _valid(values: Sequence[Any]) -> Any:
    """Which values are there, bit by bit; None where all are."""
    import pyarrow as pa

    there = np.array([value is not None for value in values], dtype=bool)
    return None if there.all() else pa.py_buffer(np.packbits(there, bitorder="little"))


def _lists_of(made: Made) -> Made:
    def lists(values: Sequence[Sequence[Any]]) -> Any:
        import pyarrow as pa

        ends = np.cumsum([0, *map(len, values)], dtype=np.int32)
        offsets = pa.Array.from_buffers(pa.int32(), ends.size, [None, pa.py_buffer(ends)])
        return pa.ListArray.from_arrays(offsets, made([one for own in values for one in own]))

    return lists


KINDS: Mapping[str, Made] = {
    "key": _texts,
    "job": _texts,
    "verdict": _texts,
    "error": _texts,
    "rows": _counts,
    "seconds": _numbers,
    "cpu_s": _numbers,
    "claims": _lists_of(_texts),
    "diagnosis": _texts,
    "noise": _texts,
    "temp_c": _numbers,
    "entries": _lists_of(_texts),
    "entry_of": _lists_of(_counts),
    "parameters": _lists_of(_texts),
    "units": _lists_of(_texts),
    "score": _lists_of(_numbers),
    "information": _lists_of(_numbers),
    "freedom": _numbers,
    "record": _texts,
    "record_id": _texts,
    "basis": _texts,
    "last": _texts,
    "arguments": _texts,
    "answer": _texts,
}
"""of every column of a result, how it is made"""


def table_of(rows: Sequence[Mapping[str, Any]]) -> Any:
    """The Arrow table of rows that have the same columns, each of `KINDS`. Raises InputError without pyarrow."""
    return _table(rows, KINDS)


def table_of_texts(rows: Sequence[Mapping[str, Any]]) -> Any:
    """The Arrow table of rows that have the same columns, texts all. Raises InputError without pyarrow."""
    return _table(rows, dict.fromkeys(rows[0] if rows else (), _texts))


def _table(rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, Made]) -> Any:
    try:
        import pyarrow as pa
    except ImportError:
        raise InputError("a fleet needs pyarrow, which is not installed", remedy=INSTALL) from None
    names = list(rows[0]) if rows else []
    return pa.Table.from_arrays([kinds[name]([row[name] for row in rows]) for name in names], names=names)
