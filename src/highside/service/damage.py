"""Files of the state directory that cannot be used: set aside, named, and the service goes on without them.

None of them is worth the readings of a tool. A damaged file keeps its content under another name beside the old one, is
named in one line of the log, and stands in the health message with an alarm until the next start. Files that the user
wrote (configuration, calibration, compensation) are never touched.
"""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from pathlib import Path

from highside.recording.files import set_aside
from highside.service.in_force import error_text

log = logging.getLogger("highside")


@dataclass(frozen=True, slots=True)
class DamagedFile:
    """One file."""

    file: str
    what: str
    """what was wrong, and what that costs"""
    aside: str | None
    """its new name; None: it could not be renamed, or this user may not read it, and it is where it was"""


class DamageLog:
    """What was found damaged since the start."""

    def __init__(self) -> None:
        self._found: dict[str, DamagedFile] = {}

    def note(self, path: Path, error: BaseException | str, cost: str) -> str:
        """A file that cannot be used because of `error`; `cost` says what is lost by that. Returns the line that was
        logged."""
        what = error if isinstance(error, str) else error_text(error)
        # what this user may not read need not be damaged, and renaming would hide it from whom it belongs to
        aside = set_aside(path) if os.access(path, os.R_OK) else None
        kept = f"kept as {aside.name}" if aside is not None else "left where it is"
        named = what if path.name in what else f"{path}: {what}"
        line = f"{named}; {kept}; {cost}"
        log.error("%s", line)
        self._found[path.name] = DamagedFile(path.name, what, None if aside is None else aside.name)
        return line

    def require_directory(self, path: Path, cost: str) -> None:
        """Set aside what stands where a directory has to be."""
        if os.path.lexists(path) and not path.is_dir():
            self.note(path, "is no directory", cost)

    def require_file(self, path: Path, cost: str) -> None:
        """Set aside what stands where a file has to be."""
        if os.path.lexists(path) and not path.is_file():
            self.note(path, "is no file", cost)

    def as_list(self) -> list[dict[str, str | None]]:
        """Member `damaged` of the health message."""
        return [{"file": one.file, "what": one.what, "aside": one.aside} for one in self._found.values()]
