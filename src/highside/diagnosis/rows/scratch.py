"""Columns of all rows that cannot be made run by run (an effect that remembers): of many rows they lie in a file.

Thirty-four of them are tried on three channels, 270 bytes a row. Rows are read back run by run at the file's own
offset, so that threads may read side by side and nothing stays in memory. The file has no name and is gone with the
last column, however the process ends.
"""

from __future__ import annotations

import os
import tempfile
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
    _end: int = field(default=0)

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
            found = os.pread(file.fileno(), size, begin + part.start * _BYTES)
            if len(found) != size:
                raise OSError(f"scratch file: {len(found)} of {size} bytes")
            return np.frombuffer(found)

        return rows
