"""The errors a user may see: each says what is wrong, where, and what to do, in one line.

`InputError` ends a command with exit status 2 (wrong usage or input), `Refused` with 1 (the input was read, the
answer is bad news that scripts must see). Anything else that reaches the command line is a defect of highside.

`error.code` is for programs and does not change with the wording: the kind and the part of highside that speaks
(`input.reading`, `refused.rotation`), or where a reason is named, that (`record.expired`, `link.busy`). `AREAS` says
what each part means; the page of errors in the documentation is made of it and of the messages in the sources.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

from highside.printable import one_line


class Area(NamedTuple):
    """What an error of one part of highside means."""

    cause: str
    remedy: str


AREAS: dict[str, Area] = {
    "api": Area(
        "An argument of a command or of a call contradicts the data or another argument.",
        "Give what the message names; it lists what is allowed.",
    ),
    "bench": Area(
        "A bench session cannot begin, go on or be replayed as asked: its plan, journal, limits or store.",
        "Correct that field of the session's file; a journal is never edited.",
    ),
    "calibration": Area(
        "Poses, a record, a key or a limit of a calibration cannot be used.",
        "Correct the pose or option named; measure a pose again rather than edit it.",
    ),
    "cli": Area(
        "Options of a command contradict one another, or an output cannot be written.",
        "See the command's `--help`; it ends with an example.",
    ),
    "codec": Area(
        "A codec is unknown, or its settings do not describe a wire format.",
        "Correct `[codec]`; `highside detect` finds the codec of a connected tool.",
    ),
    "config": Area(
        "A configuration or a model has an unknown, missing or impossible field.",
        "Correct the field; `highside check FILE` lists all mistakes at once.",
    ),
    "diagnosis": Area(
        "A recording cannot be diagnosed: columns, length, reference or simulation are lacking.",
        "Record what the message names, or give another `[reference] kind`.",
    ),
    "watch": Area(
        "A calibration record cannot be watched (it corrects by zones of inclination alone), or no survey tells of it.",
        "Solve the same poses with `--method joint` and watch with that record; give surveys made under it.",
    ),
    "fleet": Area(
        "A catalogue of many tools, or the place for its results, cannot be used.", "Correct the line that is named."
    ),
    "gyro": Area(
        "The gyros or accelerations of a recording are not in the units or at the rate that drift needs.",
        "Give g and deg/s, in rows that rise in time.",
    ),
    "importing": Area(
        "A recording of another program is not understood without further options.",
        "Say it with `--map`, `--units`, `--axes`, `--rate`, `--table` or `--part`.",
    ),
    "link": Area(
        "The link to the tool cannot be used as it was asked for.",
        "Look at cable, power, permission and `[link]`; `highside doctor` tries them.",
    ),
    "outside": Area(
        "An effect, codec or method that is not ours refuses.",
        "Ask its maker; `docs/extending.md` says what is asked of one.",
    ),
    "packaged": Area(
        "What travels with the package was not built into this installation.", "Build it as the message says."
    ),
    "physics": Area(
        "An effect, a law or a motion of a model is unknown or impossible.",
        "`highside effects` lists effects, parameters and ranges.",
    ),
    "reading": Area(
        "A file cannot be read: absent, no permission, damaged, too long, of another kind.",
        "Give the right, whole file; `--max-bytes` reads a longer one.",
    ),
    "recording": Area(
        "A recording, a wire recording or the calibration store is not what its kind has to be.",
        "Correct the line named, or give the original file; `highside import` reads other programs'.",
    ),
    "report": Area(
        "A report or certificate cannot be made or written.", "Install the extra that is named, free the disk."
    ),
    "rotation": Area(
        "Rotor angles and errors do not determine a compensation.",
        "Record more of the circle, or both directions, as the message says.",
    ),
    "scratch_arrays": Area(
        "Columns of a recording that is too long for the memory cannot be kept in the folder for temporary files.",
        "Make room there, or name another folder by TMPDIR.",
    ),
    "service": Area(
        "The service cannot start or go on: a place, a port, a secret or the broker.",
        "`highside doctor --config FILE` tries each and says what to do.",
    ),
    "shown": Area("A picture cannot be drawn.", "Install the extra that is named, or take another result."),
    "web": Area("A page cannot be offered: its address, certificate, token or users.", "Correct `[web]`."),
}
"""By the package that raises; `highside.errors` itself knows none of them."""


def _area() -> str:
    """The package whose code makes an error: the nearest caller that is no initialiser of an error."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_name in ("__init__", "_area"):
        frame = frame.f_back
    parts = str(frame.f_globals.get("__name__", "")).split(".")
    return parts[1] if parts[0] == "highside" and len(parts) > 1 and parts[1] in AREAS else "outside"


class HighsideError(Exception):
    """Base of all errors made for a user's eyes; `str(error)` is one line that a terminal prints as it is: names and
    texts from outside may be in it."""

    exit_status = 2
    kind = "input"

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.code: str = f"{self.kind}.{_area()}"

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(HighsideError):
    """Wrong usage or unreadable input.

    `where` names the file (and line or table), `field` what in it, `remedy` what to do.
    """

    exit_status = 2

    def __init__(
        self, what: str, *, where: str | None = None, field: str | None = None, remedy: str | None = None
    ) -> None:
        self.what, self.where, self.field, self.remedy = what, where, field, remedy
        parts = [part for part in (where, field, what) if part]
        line = ": ".join(parts)
        # further mistakes (`| also ...`) may stand where the first of them has no remedy
        joint = " " if remedy and remedy.startswith("|") else "; "
        super().__init__(f"{line}{joint}{remedy}" if remedy else line)


class Refused(HighsideError):  # noqa: N818 - an answer, not a failure
    """The input was read and understood, and the answer is no (a pose set, a record, a survey)."""

    exit_status = 1
    kind = "refused"
