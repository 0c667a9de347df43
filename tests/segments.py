"""A plain writer of wire segments, for recordings that a test needs; the service writes them through its recorder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from highside.recording.wire import encode_header, encode_record


class SegmentWriter:
    """Appends records to a new file. Every `append` hands its bytes to the kernel; `sync` flushes to the disk."""

    def __init__(self, path: Path, meta: Mapping[str, Any]) -> None:
        self._file = path.open("xb", buffering=0)
        self._size = 0
        self._write(encode_header(meta))

    def append(self, data: bytes, *, t_wall: float, t_mono: float) -> int:
        """Returns the number of bytes that the file grew by. Raises OSError; then the file is as it was before."""
        record = encode_record((t_mono, t_wall, data))
        self._write(record)
        return len(record)

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError:
            # a record behind a torn one could not be found again
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size += len(data)

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()
