"""Columns of all rows that cannot be made run by run (an effect that remembers): of many rows they lie in a file.

Thirty-four of them are tried on three channels, 270 bytes a row. Rows are read back run by run at the file's own
offset, so that threads may read side by side and nothing stays in memory. The file has no name and is gone with the
last column, however the process ends.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import IO

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rows.policy import DESIGN
from highside.errors import InputError

_BYTES = np.dtype(float).itemsize

Stored = Callable[[slice], Array]
"""rows of a stored column: (n,) of a run"""


@dataclass
class Scratch:
    """Where columns (N,) are put; those of no more than `DESIGN.in_memory` rows stay in memory."""

    _file: IO[bytes] | None = None
    _end: int = 0
    _turn: threading.Lock = field(default_factory=threading.Lock)

    def put(self, values: Array) -> Stored:
        """The column, to be read run by run. Raises InputError where there is no room for it."""
        # a row of a larger array would keep all of it
        values = np.array(values, dtype=float)
        if values.size <= DESIGN.in_memory:
            return values.__getitem__
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open as long as its columns are
            self._file.seek(self._end)
            left = values.data.cast("B")
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            need = float(values.nbytes * DESIGN.stored)
            raise InputError(
                f"has no room for scratch columns of {values.size} rows ({error.strerror})",
                where=tempfile.gettempdir(),
                remedy=f"make room for {need:.1e} bytes there, or name another folder by TMPDIR",
            ) from None
        file, begin = self._file, self._end
        self._end += values.nbytes

        def rows(part: slice) -> Array:
            size = (part.stop - part.start) * _BYTES
            try:
                found = self._read(file, size, begin + part.start * _BYTES)
            except OSError as error:
                raise _unread(error.strerror or str(error)) from None
            if len(found) != size:
                raise _unread(f"{len(found)} of {size} bytes")
            return np.frombuffer(found)

        return rows

    def _read(self, file: IO[bytes], size: int, at: int) -> bytes:
        """`size` bytes from there. Windows has no reads at an offset of their own: there threads read in turn."""
        if hasattr(os, "pread"):
            return os.pread(file.fileno(), size, at)
        with self._turn:
            file.seek(at)
            return file.read(size)


def _unread(why: str) -> InputError:
    return InputError(
        f"a scratch file cannot be read back ({why})",
        where=tempfile.gettempdir(),
        remedy="check the disk, or name another folder by TMPDIR",
    )
