"""What `highside` uses of Windows' `msvcrt`, by locks on ranges of bytes (`lockf`), which keep processes apart too."""

from __future__ import annotations

import fcntl
import os

LK_NBLCK = 2


def locking(descriptor: int, mode: int, count: int) -> None:
    """Lock `count` bytes from the present offset on, of which nobody else may hold one; refused at once."""
    assert mode == LK_NBLCK
    # Windows refuses the second lock of one process as well; those of `lockf` are of the process
    here = _file(descriptor)
    for other, file in list(_held.items()):
        if _file(other) != file:
            del _held[other]  # closed since, which gave the lock back; the number may stand for another file now
        elif other != descriptor and file == here:
            raise PermissionError(13, "Permission denied")
    at = os.lseek(descriptor, 0, os.SEEK_CUR)
    assert at + count < 1 << 31, "an offset beyond what the C library takes"
    fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, count, at)
    _held[descriptor] = here


_held: dict[int, tuple[int, int] | None] = {}
"""The file of each descriptor that was locked."""


def _file(descriptor: int) -> tuple[int, int] | None:
    """Device and inode of an open file; None where the descriptor is closed."""
    try:
        found = os.fstat(descriptor)
    except OSError:
        return None
    return found.st_dev, found.st_ino
