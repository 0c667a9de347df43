"""Arrays of NumPy from bytes: no pickled objects, no array larger than what stands in the file or may be unzipped."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError
from highside.reading.expansion import refuse_expansion

MAX_MEMBERS = 4096
"""files in an archive: the largest that are known here have 40"""
DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    OSError,
    ValueError,
)
"""what `zipfile` raises over damaged bytes: names that are no UTF-8 and places before the start are ValueErrors, a
method of compression or a version that it does not know is a NotImplementedError"""


def npy_array(data: bytes, *, where: str) -> NDArray[Any]:
    """The array of an `.npy` file. Raises InputError for objects, and for what is torn."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    except (ValueError, EOFError, SyntaxError, TypeError, RecursionError, MemoryError) as error:
        raise _no_array(str(error).split("\n")[0], where) from None
    if dtype.hasobject:
        raise InputError("holds Python objects, which are not read", where=where, remedy="save arrays of numbers")
    count = math.prod(shape)
    begin = stream.tell()
    if dtype.itemsize == 0 or count * dtype.itemsize > len(data) - begin:
        raise _no_array("it is torn: the array is longer than the file", where)
    try:
        values = np.frombuffer(data, dtype=dtype, count=count, offset=begin)
        return values.reshape(shape, order="F" if fortran else "C")
    except ValueError as error:
        # negative sizes, more dimensions than NumPy has
        raise _no_array(str(error), where) from None


def npz_arrays(data: bytes, *, where: str) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz` file by name. Raises InputError."""
    found: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_archive(archive, len(data), where=where)
            for member in archive.infolist():
                if member.filename.endswith(".npy"):
                    name = member.filename.removesuffix(".npy")
                    found[name] = npy_array(archive.read(member), where=f"{where}: {name}")
    except DAMAGED as error:
        raise InputError(f"is a damaged archive ({error})", where=where, remedy="give the right file") from None
    return found


def check_archive(archive: zipfile.ZipFile, packed: int, *, where: str) -> None:
    """Hold what an archive says it unpacks to against the limits. Raises InputError."""
    members = archive.infolist()
    total = sum(member.file_size for member in members)
    if len(members) > MAX_MEMBERS:
        raise InputError(f"holds more than {MAX_MEMBERS} files", where=where, remedy="give the right file")
    refuse_expansion(total, packed, where=where)


def check_zip(data: bytes, *, where: str) -> None:
    """The same for bytes whose archive another library opens. Raises InputError."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_archive(archive, len(data), where=where)
    except DAMAGED as error:
        raise InputError(f"is a damaged archive ({error})", where=where, remedy="give the right file") from None


def zip_member(data: bytes, name: str) -> bytes | None:
    """A member of an archive that `check_zip` has passed; None where there is none, or it is damaged."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return archive.read(name)
    except (KeyError, *DAMAGED):
        return None


def _no_array(why: str, where: str) -> InputError:
    return InputError(f"is no NumPy array ({why})", where=where, remedy="give the right file")
