"""A Parquet file that is too long for the memory, batch of rows by batch of rows.

Nothing is read but what is asked for, so the limit on the length of files does not apply; a row group, which the format
unpacks as a whole, is held to it.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError
from highside.reading.columnar import PARQUET_MAGIC, column_of_arrow
from highside.reading.files import open_file, unreadable
from highside.reading.parquet_size import group_bytes, row_groups
from highside.reading.table import MAX_COLUMNS

BATCH_ROWS = 1 << 16
"""rows that are read at a time"""
GROUP_BYTES = 256 << 20
"""unpacked bytes of a row group, at most: what is in the memory while its rows are read. A million rows of ten columns,
which is what pyarrow writes as one group unless told otherwise, have 80 MB."""


@dataclass(frozen=True)
class RowGroups:
    """A Parquet file by its metadata: how many rows there are of which columns of numbers."""

    path: Path
    rows: int
    names: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> RowGroups | None:
        """None for a file that is not Parquet, or where pyarrow is not installed. Raises InputError for one that is
        damaged, or whose row groups are too large."""
        try:
            with open_file(path) as file:
                if file.read(len(PARQUET_MAGIC)) != PARQUET_MAGIC:
                    return None
        except OSError as error:
            raise unreadable(path, error) from None
        try:
            parquet = importlib.import_module("pyarrow.parquet")
        except ImportError:
            return None
        try:
            meta = parquet.read_metadata(path)
            schema = meta.schema.to_arrow_schema()
            largest = _largest_group(path) if meta.num_columns <= MAX_COLUMNS else 0
        except InputError:
            raise
        except Exception as error:
            raise _damaged(path, error) from None
        if meta.num_columns > MAX_COLUMNS:
            raise InputError(f"has more than {MAX_COLUMNS} columns", where=str(path), remedy="give the right file")
        if largest > GROUP_BYTES:
            raise InputError(
                f"has a row group of {largest} bytes, which is in the memory while it is read",
                where=str(path),
                remedy="write it with row groups of a million rows at most",
            )
        return cls(path, int(meta.num_rows), tuple(f.name for f in schema if _is_number(f.type)))

    def batches(self, names: Sequence[str]) -> Iterator[dict[str, NDArray[np.float64]]]:
        """Columns of numbers (n,) of runs of rows, in their order; NaN where a value is missing. Raises InputError."""
        parquet = importlib.import_module("pyarrow.parquet")
        try:
            with parquet.ParquetFile(self.path, pre_buffer=False) as file:
                for batch in file.iter_batches(batch_size=BATCH_ROWS, columns=list(names), use_threads=False):
                    yield {name: _numbers(name, batch) for name in names}
        except InputError:
            raise
        except Exception as error:
            raise _damaged(self.path, error) from None


def _largest_group(path: Path) -> int:
    """Bytes to which the pages of one row group unpack, at most. Raises ValueError, OSError, InputError."""
    with open_file(path) as file:
        size = file.seek(0, os.SEEK_END)

        def read(at: int, size: int) -> bytes:
            file.seek(at)
            return file.read(size)

        groups = row_groups(read, size)
        return max((max(group.stated_bytes, group_bytes(group, read)) for group in groups), default=0)


def _numbers(name: str, batch: Any) -> NDArray[np.float64]:
    found = column_of_arrow(name, batch.schema.field(name), batch.column(name))
    assert found is not None and found.numbers is not None
    return found.numbers


def _is_number(kind: Any) -> bool:
    from pyarrow import types

    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind))


def _damaged(path: Path, error: Exception) -> InputError:
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    return InputError(f"is a damaged Parquet file ({reason})", where=str(path), remedy="give the right file")
