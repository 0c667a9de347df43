"""Locks on files that are held open: of one process against another, gone with the process however that ends.

`flock` where the system has it. Windows has locks on ranges of bytes only, and what is locked there nobody else can
read: the one byte taken lies far behind all that a file here may hold.
"""

from __future__ import annotations

import errno
import os
import time

try:
    import fcntl
except ImportError:
    FLOCK = False
else:
    FLOCK = True

BYTE = 0x7FFF_FFFE
"""Offset of the byte that stands for the file; the C library of Windows takes offsets below 2 GiB."""
ASK_EVERY_S = 0.05
"""Windows has no call that waits for a lock: it is asked for again and again."""


def lock(descriptor: int, *, wait: bool = False, shared: bool = False) -> None:
    """Take the lock of an open file; closing the file gives it back.

    Raises BlockingIOError where another has it, unless it is waited for. `shared` (only to look whether anybody has
    it): beside others that share it; Windows knows no such locks, there it is taken like any other.
    """
    if FLOCK:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
        return
    while not _take_byte(descriptor):
        if not wait:
            raise BlockingIOError(errno.EAGAIN, "another process has it locked")
        time.sleep(ASK_EVERY_S)


def _take_byte(descriptor: int) -> bool:
    import msvcrt  # of Windows alone

    at = os.lseek(descriptor, 0, os.SEEK_CUR)
    try:
        os.lseek(descriptor, BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    finally:
        os.lseek(descriptor, at, os.SEEK_SET)
    return True
