"""Writing whole files, plain or gzipped by their name, never half-written; setting damaged ones aside."""

from __future__ import annotations

import contextlib
import errno
import gzip
import io
import os
import secrets
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from highside.errors import InputError
from highside.reading.files import OPEN_FLAGS

LET_GO_S = 1.0
"""Seconds for which a file is tried to be replaced that another program of Windows has open: whoever reads one of ours
whole has let it go by then."""


def write_whole(path: Path, data: bytes) -> None:
    """Write beside, fsync, rename: the file is the old one or the new one, whatever happens.

    A name that ends in `.gz` is gzipped without name and time, so that equal content gives equal bytes. What is no
    regular file (`/dev/stdout`, a pipe that somebody reads) is written to, never replaced; behind a symbolic link its
    target is. Raises InputError where the place cannot be written.
    """
    if path.suffix == ".gz":
        packed = io.BytesIO()
        with gzip.GzipFile(filename="", fileobj=packed, mode="wb", compresslevel=6, mtime=0) as stream:
            stream.write(data)
        data = packed.getvalue()
    try:
        if path.is_dir():
            raise InputError("is a directory, not a file", where=str(path))
        if path.exists() and not path.is_file():
            _written_to(path, data)
            return
        target = Path(os.path.realpath(path))  # `Path.resolve` makes links in a circle an error of another kind
        with _written_beside(target, data) as beside:
            _replace(beside, target)
        flush_directory(target.parent)
    except OSError as error:
        raise _not_written(path, error) from None


def _written_to(path: Path, data: bytes) -> None:
    """Raises OSError, InputError. A named pipe that nobody reads is refused: to open it would wait for ever."""
    try:
        descriptor = os.open(path, os.O_WRONLY | OPEN_FLAGS | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        if error.errno == errno.ENXIO and path.is_fifo():
            raise InputError("is a named pipe, not a file", where=str(path), remedy="give a file") from None
        raise
    with os.fdopen(descriptor, "wb") as place:
        if hasattr(os, "O_NONBLOCK"):
            os.set_blocking(descriptor, True)
        place.write(data)


def write_together(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Files by name, each whole, into a folder that is made; it is flushed once for all of them: when this returns
    they survive a loss of power, and what is there before then is whole. Raises InputError."""
    try:
        make_directory(folder)
        for name, data in contents.items():
            with _written_beside(folder / name, data) as beside:
                _replace(beside, folder / name)
        flush_directory(folder)
    except OSError as error:
        raise _not_written(folder, error) from None


@contextlib.contextmanager
def _written_beside(target: Path, data: bytes) -> Iterator[Path]:
    """The data in a file beside the target, on the disk; it is removed unless it was renamed. Raises OSError."""
    name = str(target.parent / f".{target.name}.{secrets.token_hex(6)}")
    # the kernel takes the umask off; to read it here would set it for all threads
    descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            if (written := os.fstat(file.fileno()).st_size) != len(data):
                # never put an incomplete file in the place of a whole one, whoever else held the descriptor
                raise OSError(errno.EIO, f"{written} bytes of {len(data)} arrived")
        yield Path(name)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise


def _not_written(path: Path, error: OSError) -> InputError:
    return InputError(
        f"cannot be written: {error.strerror}", where=str(path), remedy="name a place that this user may write"
    )


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Files by name, whole, into a folder that is made. Raises InputError."""
    try:
        make_directory(folder)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", where=str(folder)) from None
    for name, text in texts.items():
        write_whole(folder / name, text.encode())


def _replace(beside: Path, target: Path) -> None:
    """Rename over the target. On Windows that is refused while anybody, were it a virus scanner, has the target open:
    it is tried again for `LET_GO_S`."""
    give_up_s = time.monotonic() + (0.0 if hasattr(os, "O_DIRECTORY") else LET_GO_S)
    while True:
        try:
            beside.replace(target)
        except PermissionError:
            if time.monotonic() >= give_up_s:
                raise
            time.sleep(0.02)
        else:
            return


def flush_directory(path: Path) -> None:
    """Make what was created, renamed or deleted in a directory survive a loss of power. Raises OSError.

    Nothing on Windows, where a directory cannot be opened and its entries are in the journal of NTFS.
    """
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_directory(path: Path) -> None:
    """Make a directory and its parents where they are missing, to survive a loss of power. Raises OSError."""
    missing = [place for place in (path, *path.parents) if not place.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for made in missing:
        flush_directory(made.parent)


def set_aside(path: Path) -> Path | None:
    """Rename a damaged file to NAME.damaged-TIMESTAMP (UTC), so that its owner goes on without it and it can be looked
    at. Returns the new name; None where the file is gone, or its directory cannot be written: then it stays."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    aside = path.with_name(f"{path.name}.damaged-{stamp}")
    count = 1
    while os.path.lexists(aside):
        count += 1
        aside = path.with_name(f"{path.name}.damaged-{stamp}.{count}")
    try:
        path.rename(aside)
    except OSError:
        return None
    return aside
