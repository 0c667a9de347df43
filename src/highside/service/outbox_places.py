"""Whether files that are held open are still those that their paths lead to.

Who deletes a directory, moves it away or puts another in its place takes nothing from a process that has its files
open: it goes on to write into files that nobody will ever find again. A path is judged by the device and number of what
it leads to.
"""

from __future__ import annotations

import os
from pathlib import Path


class Places:
    """What was opened at which path. Belongs to one thread."""

    def __init__(self) -> None:
        self._opened: dict[Path, tuple[int, int]] = {}

    def note(self, path: Path, descriptor: int | None = None) -> None:
        """`path` was opened, as `descriptor` if that is known. Raises OSError."""
        status = path.stat() if descriptor is None else os.fstat(descriptor)
        self._opened[path] = (status.st_dev, status.st_ino)

    def note_if_there(self, path: Path) -> None:
        """The same of a file that need not be there."""
        try:
            self.note(path)
        except FileNotFoundError:
            self.forget(path)

    def forget(self, *paths: Path) -> None:
        """These were closed, or are of no interest."""
        for path in paths:
            self._opened.pop(path, None)

    def moved(self, path: Path) -> bool:
        """Whether the path leads to nothing, or to another file. One that was not opened has not moved, nor has one of
        which that cannot be determined: a device that gives no answer is told by the next write."""
        opened = self._opened.get(path)
        if opened is None:
            return False
        try:
            status = path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return True
        except OSError:
            return False
        return (status.st_dev, status.st_ino) != opened
