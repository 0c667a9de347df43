"""MATLAB files of version 5 and 7.3, which are HDF5, and HDF5 files of others (h5py): their arrays by name."""

from __future__ import annotations

import io
from typing import Any

from numpy.typing import NDArray

from highside.errors import InputError
from highside.importing.core.source import SourceTable
from highside.importing.forms.arrays import tables_of
from highside.importing.forms.missing import damaged, not_installed
from highside.reading.expansion import refuse_expansion
from highside.reading.hdf5_heaps import refuse_endless_heaps
from highside.reading.mat5 import MOST_ARRAYS, mat5_arrays

MAT5 = b"MATLAB 5.0 MAT-file"
_DEEPEST = 64
"""groups within groups; visiting takes the square of it"""
HDF5 = b"\x89HDF\r\n\x1a\n"


def read_mat5(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The arrays of a MATLAB 5 file, fields of structures as `outer.inner`. Raises InputError."""
    return tables_of(mat5_arrays(data, where=where), "MATLAB 5", where)


def is_hdf5(data: bytes) -> bool:
    """Whether it is HDF5: by its mark at the beginning, or behind the block of text that MATLAB 7.3 writes."""
    return data[:8] == HDF5 or data[512:520] == HDF5


def read_hdf5(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The datasets of an HDF5 file, with their attribute `units`. Raises InputError."""
    try:
        import h5py
    except ImportError:
        raise not_installed("h5py", where) from None
    arrays: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    size = count = 0

    def take(key: str | bytes, item: Any) -> None:
        nonlocal size, count
        count += 1
        # a name that is no UTF-8 comes as bytes
        name = key.decode("utf-8", "replace") if isinstance(key, bytes) else key
        if count > MOST_ARRAYS or name.count("/") > _DEEPEST:
            what = f"holds more than {MOST_ARRAYS} objects, or groups more than {_DEEPEST} deep"
            raise InputError(what, where=where, remedy="give the right file")
        # what lies in other files is not looked at
        if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return
        if item.dtype.kind not in "biuf" and not item.dtype.names:
            return
        size += item.size * item.dtype.itemsize
        refuse_expansion(size, len(data), where=where)
        arrays[name] = item[()]
        unit = item.attrs.get("units", item.attrs.get("unit"))
        if isinstance(unit, str | bytes):
            units[name] = unit if isinstance(unit, str) else unit.decode("utf-8", "replace")

    refuse_endless_heaps(data, where=where)
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            file.visititems(take)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise damaged("HDF5", error, where) from None
    form = "MATLAB 7.3" if data[:6] == b"MATLAB" else "HDF5"
    return tables_of(arrays, form, where, units)
