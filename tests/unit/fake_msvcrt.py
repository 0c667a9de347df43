"""What `highside` uses of Windows' `msvcrt`, by locks on ranges of bytes (`lockf`), which keep processes apart too."""

from __future__ import annotations

import fcntl
import os

LK_NBLCK = 2


def locking(descriptor: int, mode: int, count: int) -> None:
    """Lock `count` bytes from the present offset on, of which nobody else may hold one; refused at once."""
    assert mode == LK_NBLCK
    # Windows refuses the second lock of one process as well; those of `lockf` are of the process
    here = os.fstat(descriptor)
    for other in map(int, os.listdir("/proc/self/fd")):  # noqa: PTH208
        if other != descriptor and (other, here.st_ino) in _held:
            raise PermissionError(13, "Permission denied")
    at = os.lseek(descriptor, 0, os.SEEK_CUR)
    assert at + count < 1 << 31, "an offset beyond what the C library takes"
    fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, count, at)
    _held.add((descriptor, here.st_ino))


_held: set[tuple[int, int]] = set()
