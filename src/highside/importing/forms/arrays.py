"""Named arrays, as NumPy, MATLAB and HDF5 keep them: those of one length make a table, (N, 3) makes three columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError
from highside.importing.core.source import SourceColumn, SourceTable, number_column, text_column
from highside.reading.arrays import npy_array, npz_arrays

_WIDEST = 32
"""columns of one array that are taken apart"""
_RATES = frozenset({"fs", "rate", "rate_hz", "sample_rate", "samplerate", "sampling_rate", "frequency", "fs_hz"})


def read_npz(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The tables of an `.npz` archive. Raises InputError."""
    return tables_of(npz_arrays(data, where=where), "NumPy archive", where)


def read_npy(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The table of an `.npy` array: (N, columns), or fields with names. Raises InputError."""
    return tables_of({"column": npy_array(data, where=where)}, "NumPy array", where)


def tables_of(
    arrays: Mapping[str, NDArray[Any]], form: str, where: str, units: Mapping[str, str] | None = None
) -> tuple[SourceTable, ...]:
    """Tables of arrays by name, the longest first. Raises InputError where no array is a column."""
    units = units or {}
    rate: float | None = None
    by_length: dict[int, list[SourceColumn]] = {}
    for name, array in arrays.items():
        last = name.rsplit("/", 1)[-1].rsplit(".", 1)[-1].lower()
        if array.size == 1 and last in _RATES and array.dtype.kind in "iuf":
            rate = float(array.ravel()[0])
        for column in _columns(name, array, units.get(name)):
            by_length.setdefault(column.n, []).append(column)
    tables = [
        SourceTable(tuple(columns), form, where, f"{length} rows", rate_hz=rate)
        for length, columns in sorted(by_length.items(), reverse=True)
        if length > 1
    ]
    if not tables:
        raise InputError(
            "holds no columns of numbers", where=where, remedy=f"a {form} of arrays (N,) or (N, 3) is read"
        )
    return tuple(tables)


def _columns(name: str, array: NDArray[Any], unit: str | None) -> list[SourceColumn]:
    if array.dtype.names:
        return [c for field in array.dtype.names for c in _columns(field, array[field], None)]
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim == 2:
        if array.shape[0] <= _WIDEST < array.shape[1] or array.shape[0] == 3 < array.shape[1]:
            array = array.T
        if array.shape[1] > _WIDEST:
            return []
        return [c for k in range(array.shape[1]) for c in _columns(f"{name}[{k}]", array[:, k], unit)]
    if array.ndim != 1:
        return []
    if array.dtype.kind in "biuf":
        return [number_column(name, array.astype(np.int64) if array.dtype.kind == "b" else array, unit)]
    if array.dtype.kind == "M":
        ns = array.astype("datetime64[ns]").astype(np.int64)
        return [SourceColumn(name, numbers=ns.astype(np.float64), integers=ns, instant=True)]
    if array.dtype.kind in "US":
        return [text_column(name, _texts(array), unit)]
    return []


def _texts(array: NDArray[Any]) -> tuple[str, ...]:
    """The texts of an array (N,) of bytes or characters; what is none in Unicode is marked as such."""
    if array.dtype.kind == "S":
        return tuple(text.decode("utf-8", "replace") for text in array.tolist())
    wide = array.dtype.itemsize
    data = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<"))).tobytes()
    cells = (data[k : k + wide] for k in range(0, len(data), wide)) if wide else [b""] * array.size
    return tuple(cell.decode("utf-32-le", "replace").rstrip("\0") for cell in cells)
