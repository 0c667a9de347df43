"""Bytes of a file, plain or gzipped by its content, never more than a limit."""

from __future__ import annotations

import gzip
import io
import os
import stat
import zlib
from contextlib import closing
from pathlib import Path
from typing import IO, BinaryIO

from highside.errors import InputError

MAX_FILE_BYTES = 2 << 30
"""Longest content of a file, unzipped: five hours of 3,840 frames/s on the wire, five million rows of a Recording. A
command needs about five times as much memory; more is given with `highside --max-bytes`."""
MAX_RATIO = 200
"""Bytes that may come out of one gzipped byte. Recordings of numbers pack 2 to 20 times, a column that never changes
100 times; zeros pack 1,030 times, which is what a file made to fill the memory consists of."""
RATIO_FROM_BYTES = 16 << 20
"""What may come out before the ratio is looked at: this much does no harm."""
SECRET_MAX = 64 << 10
"""Bytes of a file with a password or a token; what is longer is another file."""
CERTIFICATES_MAX = 4 << 20
"""Bytes of a PEM file: the bundle of all authorities that a system trusts has about 200 KiB."""
_PIECE = 1 << 20
OPEN_FLAGS: int = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
"""For `os.open`: not handed down to other programs, and on Windows no line ends translated."""
_WITHOUT_WAITING: int = getattr(os, "O_NONBLOCK", 0)
"""Windows has no named pipes among its files whose opening could wait."""
_UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30}
_LONGEST_SIZE = 15
"""digits"""

_allowed = MAX_FILE_BYTES
_configured = False

IF_MEANT = "if it is meant so: highside --max-bytes SIZE ..., or highside.allow_bytes(SIZE) in a program"
"""What to do about a file that is too long, or expands too much."""


def allow_bytes(count: int) -> None:
    """Read files of up to `count` bytes from now on, however they are packed: the user said so. Raises InputError."""
    global _allowed, _configured
    if count < 1:
        raise InputError(f"{count} bytes are none", field="max_bytes", remedy="give at least 1, e.g. 8G")
    _allowed, _configured = count, True


def allowed_bytes() -> int:
    """Bytes that a file may have, unzipped."""
    return _allowed


class _Expanding(io.RawIOBase):
    """A gzip stream that counts: what comes out, and how much went in for it."""

    def __init__(self, packed: BinaryIO, path: Path) -> None:
        self._packed, self._path = packed, path
        self._plain = gzip.GzipFile(fileobj=packed, mode="rb")
        self._out = 0
        self.name = str(path)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        # no more than one step of the stream: what came before a torn end must not be lost with it
        piece = self._plain.read1(len(buffer))
        count = len(piece)
        buffer[:count] = piece
        self._out += count
        if self._out > _allowed:
            raise _too_big(self._path, "expands to more than")
        if not _configured and self._out > RATIO_FROM_BYTES and self._out > MAX_RATIO * self._packed.tell():
            raise InputError(
                f"expands to more than {MAX_RATIO} times its size, as no recording does",
                where=str(self._path),
                remedy=IF_MEANT,
            )
        return count

    def close(self) -> None:
        if not self.closed:
            self._plain.close()
            self._packed.close()
        super().close()


def size(text: str) -> int:
    """Bytes, written as a number with K, M or G (powers of 1024) behind it, or nothing. Raises InputError."""
    number, unit = text.strip().upper().removesuffix("B").removesuffix("I"), 1
    if number[-1:] in _UNITS:
        number, unit = number[:-1], _UNITS[number[-1]]
    if not number.isascii() or not number.isdigit() or len(number) > _LONGEST_SIZE:
        raise InputError(f"{text!r} is no size", field="max_bytes", remedy="give bytes, or a number with K, M or G")
    return int(number) * unit


def open_file(path: Path) -> BinaryIO:
    """Open as it is, for reading; nothing is unzipped and nothing limited. Raises InputError that names the file.

    A named pipe, a device and a socket are refused, without waiting for anybody: one that was put where a file is
    expected would hold up the whole service. The shell's own pipes (`/dev/stdin`, `<(command)`) are read.
    """
    try:
        # looked at first: opening a device may already do something
        _refuse_special(path, path.stat().st_mode)
        descriptor = os.open(path, os.O_RDONLY | OPEN_FLAGS | _WITHOUT_WAITING)
        try:
            _refuse_special(path, os.fstat(descriptor).st_mode)
            if _WITHOUT_WAITING:
                os.set_blocking(descriptor, True)
            return os.fdopen(descriptor, "rb")
        except BaseException:
            os.close(descriptor)
            raise
    except FileNotFoundError:
        raise InputError("no such file", where=str(path)) from None
    except PermissionError:
        raise InputError("cannot be read by this user", where=str(path), remedy="check its permissions") from None
    except OSError as error:
        raise unreadable(path, error) from None
    except ValueError as error:
        # a NUL or a lone surrogate in the name
        raise InputError(f"is no name of a file ({error})", where=str(path)) from None


def _refuse_special(path: Path, mode: int) -> None:
    if stat.S_ISREG(mode):
        return
    if stat.S_ISDIR(mode):
        raise InputError("is a directory, not a file", where=str(path))
    # a pipe of the shell's is nowhere in the file system, a named one is
    if stat.S_ISFIFO(mode) and not os.path.lexists(os.path.realpath(path)):
        return
    kind = "a named pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"
    raise InputError(f"is {kind}, not a file", where=str(path), remedy="give a file")


def open_binary(path: Path) -> BinaryIO:
    """Open for reading, through gzip if the content says so. Raises InputError that names the file.

    A plain file is read as far as its reader goes; of a gzipped one, reading raises InputError where it expands beyond
    `MAX_FILE_BYTES` or `MAX_RATIO`, and gzip's own errors where it is damaged.
    """
    file = open_file(path)
    try:
        packed = file.peek(2)[:2] == b"\x1f\x8b"  # type: ignore[attr-defined]
    except OSError as error:
        file.close()
        raise unreadable(path, error) from None
    return io.BufferedReader(_Expanding(file, path), _PIECE) if packed else file


def read_bytes(path: Path, *, max_bytes: int | None = None) -> bytes:
    """The whole content, unzipped. Raises InputError for a missing file, a damaged gzip stream, or too much content.

    `max_bytes`: what this kind of file has at most, if less than any file may have.
    """
    limit = _allowed if max_bytes is None else min(max_bytes, _allowed)
    with closing(open_binary(path)) as file:
        try:
            stated = 0 if isinstance(file, io.BufferedReader) and isinstance(file.raw, _Expanding) else _stated(file)
            if stated > limit:
                raise _too_big(path, "has more than", limit)
            return _whole(file, path, limit, stated)
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise InputError(f"is a damaged gzip file: {error}", where=str(path)) from None
        except OSError as error:
            raise unreadable(path, error) from None


def read_named(path: Path, field: str, *, max_bytes: int | None = None) -> bytes:
    """The whole content of a small file that a field of the configuration names. Raises InputError that names both."""
    try:
        return read_bytes(path, max_bytes=max_bytes)
    except InputError as error:
        remedy = error.remedy or "name a file that this user may read"
        raise InputError(error.what, where=error.where, field=field, remedy=remedy) from None


def _stated(file: BinaryIO) -> int:
    """Bytes that a plain file has by its directory; 0 for a pipe, and for what the kernel makes as it is read."""
    state = os.fstat(file.fileno())
    return state.st_size if stat.S_ISREG(state.st_mode) else 0


def _whole(file: IO[bytes], path: Path, limit: int, stated: int) -> bytes:
    """What is `stated` at once, the rest in pieces, so that a source without an end (a pipe) ends at the limit. The
    content is in the memory once: pieces in a list would be there twice when they are joined."""
    first = file.read(stated) if stated else b""
    if not (piece := file.read(_PIECE)):
        return first
    held = io.BytesIO()
    held.write(first)
    del first
    while piece:
        held.write(piece)
        if held.tell() > limit:
            raise _too_big(path, "has more than", limit)
        piece = file.read(_PIECE)
    return held.getvalue()


def _too_big(path: Path, how: str, limit: int | None = None) -> InputError:
    limit = _allowed if limit is None else limit
    remedy = (
        "if it is meant so: highside --max-bytes SIZE ..., or highside.allow_bytes"
        if limit == _allowed
        else "give the right file"
    )
    return InputError(f"{how} {in_words(limit)}", where=str(path), remedy=remedy)


def in_words(count: int) -> str:
    """A number of bytes for people, as far as a power of 1024 divides it."""
    for unit, size in (("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)):
        if count >= size and count % size == 0:
            return f"{count // size} {unit}"
    return f"{count} bytes"


def unreadable(path: Path, error: OSError) -> InputError:
    """For a file that is there and cannot be read."""
    return InputError(f"cannot be read: {error.strerror or error}", where=str(path))
