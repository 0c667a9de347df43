"""Long arrays in files without a name, which are gone with the last array that reads them, however the process ends.

Rows are read back run by run at the file's own offset, so that threads may read side by side and nothing stays in
memory. Within `scratch_shared` they have names, in a folder that other processes see too: an array that is sent to one
of these is read there from the same file.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.long_arrays import LongArray, is_long, runs_of

__all__ = ["ScratchColumns", "ScratchFile", "evaluated", "filed", "scratch_shared", "stored"]

_shared: ContextVar[Path | None] = ContextVar("shared", default=None)


@contextmanager
def scratch_shared(within: Path | None = None) -> Iterator[Path]:
    """Scratch files are made in a folder of their own, where other processes can read them; it is gone afterwards.

    `within`: where that folder is made; None: where temporary files are. Raises InputError where it cannot be made.
    """
    try:
        folder = tempfile.TemporaryDirectory(prefix="highside-rows-", dir=within, ignore_cleanup_errors=True)
    except OSError as error:
        raise _no_room(error) from None
    with folder as name:
        before = _shared.set(Path(name))
        try:
            yield Path(name)
        finally:
            _shared.reset(before)


class ScratchFile:
    """A file without a name, gone with the last array that reads it, however the process ends.

    Within `scratch_shared` it has one, and a copy that is sent to another process reads the same file.
    """

    def __init__(self) -> None:
        folder = _shared.get()
        try:
            self._file: IO[bytes] = (
                tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open as long as it is read
                if folder is None
                else tempfile.NamedTemporaryFile(dir=folder, buffering=0, delete=False)  # noqa: SIM115 - the same
            )
        except OSError as error:
            raise _no_room(error) from None
        self._name = None if folder is None else Path(self._file.name)
        self._turn = threading.Lock()
        self._end = 0

    def __reduce__(self) -> tuple[Callable[[Path], ScratchFile], tuple[Path]]:
        if self._name is None:
            raise TypeError("a scratch file without a name cannot be sent to another process")
        # a file system of several machines shows the others what has been written out
        os.fsync(self._file.fileno())
        return _opened, (self._name,)

    def append(self, content: bytes | memoryview) -> int:
        """Write behind all that is there; where it begins. Raises InputError where there is no room."""
        at = self._end
        left = memoryview(content).cast("B")
        try:
            with self._turn:
                self._file.seek(at)
                while left:
                    left = left[self._file.write(left) :]
        except OSError as error:
            raise _no_room(error) from None
        self._end += len(memoryview(content).cast("B"))
        return at

    def read(self, size: int, at: int) -> bytes:
        """`size` bytes from there. Raises InputError where they are not to be had.

        Windows has no reads at an offset of their own: there threads read in turn.
        """
        try:
            if hasattr(os, "pread"):
                found = os.pread(self._file.fileno(), size, at)
            else:
                with self._turn:
                    self._file.seek(at)
                    found = self._file.read(size)
        except OSError as error:
            raise _unread(error.strerror or str(error)) from None
        if len(found) != size:
            raise _unread(f"{len(found)} of {size} bytes")
        return found


def _opened(name: Path) -> ScratchFile:
    """A file of another process, to be read. Raises InputError where it is not seen."""
    made = ScratchFile.__new__(ScratchFile)
    try:
        made._file = name.open("rb", buffering=0)
    except OSError as error:
        raise _unread(error.strerror or str(error)) from None
    made._name, made._turn, made._end = name, threading.Lock(), name.stat().st_size
    return made


def stored(like: object, shape: tuple[int, ...], runs: Iterable[AnyArray]) -> AnyArray:
    """(..., n) runs of rows, in their order, as one array; in a scratch file where `like` is long.

    Raises InputError where there is no room for it.
    """
    if is_long(like):
        return cast(AnyArray, _in_file(shape, runs))
    whole = np.empty(shape)
    at = 0
    for rows in runs:
        whole[..., at : at + rows.shape[-1]] = rows
        at += rows.shape[-1]
    return whole


def filed(values: AnyArray) -> LongArray:
    """An array in a file. Raises InputError where there is no room for it."""
    return _in_file(values.shape, [values])


def _in_file(shape: tuple[int, ...], runs: Iterable[AnyArray]) -> LongArray:
    file, places, dtype = ScratchFile(), _Places(), np.dtype(float)
    for rows in runs:
        dtype = rows.dtype
        if rows.shape[-1]:
            places.add(rows.shape[-1], file.append(np.ascontiguousarray(rows).data))
    return _of_file(file, places, shape, dtype)


def _of_file(file: ScratchFile, places: _Places, shape: tuple[int, ...], dtype: np.dtype[Any]) -> LongArray:
    """An array whose runs of rows lie in a file."""
    lead = shape[:-1]
    count = int(np.prod(lead, dtype=int))

    def some(part: slice, wanted: Sequence[int]) -> AnyArray:
        rows = np.empty((len(wanted), part.stop - part.start), dtype)
        for begin, length, at in places.within(part):
            first, stop = max(part.start, begin), min(part.stop, begin + length)
            for row, into in zip(wanted, rows, strict=True):
                own = file.read((stop - first) * dtype.itemsize, at + (row * length + first - begin) * dtype.itemsize)
                into[first - part.start : stop - part.start] = np.frombuffer(own, dtype)
        return rows

    def one(number: int) -> LongArray:
        return LongArray(shape[-1:], lambda part: some(part, [number])[0])

    every = range(count)
    return LongArray(shape, lambda part: some(part, every).reshape(*lead, -1), one if len(lead) == 1 else None)


class _Places:
    """Where the runs of an array lie in a file."""

    def __init__(self) -> None:
        self._begins: list[int] = [0]
        self._at: list[int] = []

    def add(self, rows: int, at: int) -> None:
        self._begins.append(self._begins[-1] + rows)
        self._at.append(at)

    def within(self, part: slice) -> Iterator[tuple[int, int, int]]:
        """First row, number of rows and place of each run of which some are in `part`."""
        k = int(np.searchsorted(self._begins, part.start, side="right")) - 1
        while k < len(self._at) and self._begins[k] < part.stop:
            yield self._begins[k], self._begins[k + 1] - self._begins[k], self._at[k]
            k += 1


def evaluated(values: AnyArray) -> AnyArray:
    """The same numbers, worked out once: a long array that is made of others is written to a file."""
    if not is_long(values):
        return values
    return cast(AnyArray, _in_file(values.shape, (values[..., part] for part in runs_of(values.shape[-1]))))


def _no_room(error: OSError) -> InputError:
    return InputError(
        f"has no room for columns that do not fit into the memory ({error.strerror})",
        where=tempfile.gettempdir(),
        remedy="make room there (about 800 bytes a row), or name another folder by TMPDIR",
    )


def _unread(why: str) -> InputError:
    return InputError(
        f"a scratch file cannot be read back ({why})",
        where=tempfile.gettempdir(),
        remedy="check the disk, or name another folder by TMPDIR",
    )


class ScratchColumns:
    """Columns that are written together, run by run, each to be read alone."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names, self._file, self._places, self._n = tuple(names), ScratchFile(), _Places(), 0

    def add(self, columns: Mapping[str, AnyArray]) -> None:
        """A run of rows (n,) of each. Raises InputError where there is no room."""
        rows = np.stack([columns[name] for name in self._names])
        if rows.shape[1]:
            self._places.add(rows.shape[1], self._file.append(rows.data))
            self._n += rows.shape[1]

    def columns(self) -> dict[str, LongArray]:
        """What was written, by name."""
        every = _of_file(self._file, self._places, (len(self._names), self._n), np.dtype(float))
        return {name: every[k] for k, name in enumerate(self._names)}
