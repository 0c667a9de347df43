"""Whether a file that is held open is still where it was opened."""

from __future__ import annotations

import os
from pathlib import Path


def is_at(path: Path, descriptor: int) -> bool:
    """Whether a path leads to the file that is open: False once it was deleted, moved away or replaced.

    True where that cannot be found out: a device that gives no answer is told by the next write.
    """
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        return True
