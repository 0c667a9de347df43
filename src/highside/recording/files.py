"""Reading and writing whole files: plain or gzipped by their name, never half-written, errors in one line."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import secrets
import zlib
from pathlib import Path
from typing import BinaryIO

from highside.errors import InputError


def open_binary(path: Path) -> BinaryIO:
    """Open for reading, through gzip if the content says so. Raises InputError that names the file."""
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise InputError("no such file", where=str(path)) from None
    except IsADirectoryError:
        raise InputError("is a directory, not a file", where=str(path)) from None
    except PermissionError:
        raise InputError("cannot be read by this user", where=str(path), remedy="check its permissions") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=str(path)) from None
    with contextlib.suppress(OSError, ValueError):
        magic = file.read(2)
        file.seek(0)
        if magic == b"\x1f\x8b":
            return gzip.GzipFile(fileobj=file, mode="rb")  # type: ignore[return-value]
    return file


def read_bytes(path: Path) -> bytes:
    """The whole content, unzipped. Raises InputError for a missing file or a damaged gzip stream."""
    with open_binary(path) as file:
        try:
            return file.read()
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise InputError(f"is a damaged gzip file: {error}", where=str(path)) from None
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from None


def write_whole(path: Path, data: bytes) -> None:
    """Write beside, fsync, rename: the file is the old one or the new one, whatever happens.

    A name that ends in `.gz` is gzipped without name and time, so that equal content gives equal bytes. What is no
    regular file (`/dev/stdout`, a pipe) is written to, never replaced; behind a symbolic link its target is. Raises
    InputError where the place cannot be written.
    """
    if path.suffix == ".gz":
        packed = io.BytesIO()
        with gzip.GzipFile(filename="", fileobj=packed, mode="wb", compresslevel=6, mtime=0) as stream:
            stream.write(data)
        data = packed.getvalue()
    beside: str | None = None
    try:
        if path.is_dir():
            raise InputError("is a directory, not a file", where=str(path))
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        target = path.resolve()
        name = str(target.parent / f".{target.name}.{secrets.token_hex(6)}")
        # the kernel takes the umask off; to read it here would set it for all threads
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        beside = name
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(beside).replace(target)
        beside = None
        directory = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    except OSError as error:
        raise InputError(
            f"cannot be written: {error.strerror}", where=str(path), remedy="name a place that this user may write"
        ) from None
    finally:
        if beside is not None:
            with contextlib.suppress(OSError):
                Path(beside).unlink()
