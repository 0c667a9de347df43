"""Every code of an error with its cause and what to do: the page of errors in the documentation is made of this.

A code is `error.code` of a `HighsideError`; those of a part of highside (`input.reading`) come from `errors.AREAS`,
those that name a reason from the tables below, one entry for each member of its enum.
"""

from __future__ import annotations

from typing import NamedTuple

from highside.calibration.record import RecordReason
from highside.calibration.remark import Reason
from highside.errors import AREAS, InputError, Refused
from highside.link.base import LinkReason

RECORD: dict[RecordReason, tuple[str, str]] = {
    RecordReason.TAMPERED: (
        "The content does not give the record's id, or is not what was signed.",
        "Use the original file; a record is never edited.",
    ),
    RecordReason.UNSIGNED: (
        "`calibration.trusted_keys` accepts signed records only, and this one is not.",
        "Sign it: `highside keys sign RECORD --key KEY`.",
    ),
    RecordReason.UNTRUSTED: (
        "It is signed with a key that is not among the trusted ones.",
        "Have it signed by the laboratory, or add that laboratory's public key.",
    ),
    RecordReason.EXPIRED: ("Its time is over.", "Calibrate the tool anew."),
    RecordReason.WRONG_TOOL: (
        "It was made for another tool or serial number.",
        "Give this tool's record, or correct `tool.id` and `tool.serial`.",
    ),
    RecordReason.UNIT_MISMATCH: ("It is written in other units than are read here.", "Solve the poses again."),
    RecordReason.UNKNOWN_SCHEMA: (
        "Another version of highside wrote it.",
        "Update highside, or solve the poses again.",
    ),
    RecordReason.MALFORMED: (
        "Its id is right, but parts are missing or contradict one another.",
        "Solve the poses again.",
    ),
    RecordReason.NOT_FOUND: ("The store holds no record of that id.", "`highside calibrate history` lists them."),
    RecordReason.NONE_ACTIVE: (
        "No calibration was ever put in force for this tool.",
        "Calibrate it, then `highside calibrate activate`.",
    ),
    RecordReason.NOTHING_BEFORE: (
        "There is no earlier calibration to go back to.",
        "Activate the record that is meant.",
    ),
}

CALIBRATION: dict[Reason, tuple[str, str]] = {
    Reason.NEAR_HORIZONTAL: ("Balance is not determined at 90 deg.", "Use `--method joint`, or other inclinations."),
    Reason.SINGULAR: ("The poses do not determine the matrix.", "Add poses at other toolfaces and inclinations."),
    Reason.TOO_FEW_POSES: ("Fewer poses than the method has unknowns.", "Add poses; the message says how many."),
    Reason.NOT_FOUR_QUADRANTS: ("An inclination lacks one of its four toolfaces.", "Measure 45, 135, 225 and 315 deg."),
    Reason.CLOSURE: ("The four readings at an inclination contradict one another.", "Set its poses again, hands off."),
    Reason.BAD_POSE: ("A reading is not what the other poses predict.", "Set the pose again, or leave it out."),
    Reason.SWAPPED_POSES: (
        "Two poses read as if they were exchanged.",
        "Exchange their reference angles, or repeat both.",
    ),
    Reason.UNOBSERVABLE: ("The poses cannot separate two quantities.", "Add the poses that the message names."),
    Reason.OFFSET_NOT_OBSERVABLE: ("The poses do not show an offset.", "Add poses on the opposite side."),
    Reason.TOO_MANY_BAD: (
        "So many poses contradict the rest that none can be believed.",
        "Look at clamp and reference angles, then measure again.",
    ),
    Reason.NOT_NOMINAL: (
        "The result is far from a sensor as it is built: axes, signs or units are confused.",
        "Correct `codec.axes` or the units.",
    ),
    Reason.TEMPERATURE_HYSTERESIS: (
        "The way up and the way down in temperature differ.",
        "Wait longer at each step of temperature.",
    ),
    Reason.TEMPERATURE_SPAN: ("The temperatures are too near to one another for a coefficient.", "Widen the range."),
    Reason.NOISE_ASSUMED: ("The noise of a reading was not measured.", "Give std_ax, std_ay, std_az and n."),
    Reason.BENCH_SCATTER: (
        "The bench repeats worse than was stated.",
        "State a larger `--pose-sigma-deg`, or repair it.",
    ),
    Reason.MISFIT: (
        "Scatter that neither noise nor bench explains.",
        "`highside diagnose` says which physics is missing.",
    ),
    Reason.GAUGE: ("Without a reference attitude a rotation stays open.", "Give reference angles where axes matter."),
}

LINK: dict[LinkReason, tuple[str, str]] = {
    LinkReason.NOT_FOUND: ("There is no such device.", "Plug it in and power it; `highside detect` lists ports."),
    LinkReason.NO_PERMISSION: ("This user may not open the device.", "Add the user to its group (dialout)."),
    LinkReason.BUSY: ("Another program has the device open.", "End that program."),
    LinkReason.END_OF_FILE: ("The device went away: unplugged, powered off, its hub reset.", "Look at the cable."),
    LinkReason.SILENT: ("The device is open but sends nothing.", "Look at power, baud rate and wiring."),
    LinkReason.IO_ERROR: ("Reading failed in the operating system.", "Look at the cable and the adapter."),
    LinkReason.INTERFACE_DOWN: ("The CAN interface is down.", "`ip link set can0 up type can bitrate 500000`."),
    LinkReason.INTERFACE_GONE: ("The CAN interface was removed.", "Plug the adapter in."),
    LinkReason.BUS_OFF: (
        "The CAN controller left the bus after too many errors.",
        "Look at bit rate, wiring and termination.",
    ),
    LinkReason.REMOTE_CLOSED: ("The other end of a network line closed it.", "See who else uses the terminal server."),
    LinkReason.CONFIG: ("The link cannot be opened as it is configured.", "Correct `[link]`."),
    LinkReason.FINISHED: ("The recording was played to its end.", "Nothing; give another to go on."),
}


class ErrorCode(NamedTuple):
    """One line of the page."""

    code: str
    exit_status: int
    cause: str
    remedy: str


def catalogue() -> list[ErrorCode]:
    """All codes that a `HighsideError` may have."""
    areas = [
        ErrorCode(f"{kind.kind}.{name}", kind.exit_status, *area)
        for kind in (InputError, Refused)
        for name, area in AREAS.items()
    ]
    record = [ErrorCode(f"record.{reason.value}", 1, *words) for reason, words in RECORD.items()]
    calibration = [ErrorCode(f"calibration.{reason.value}", 1, *words) for reason, words in CALIBRATION.items()]
    link = [ErrorCode(f"link.{reason.value}", 2, *words) for reason, words in LINK.items()]
    return [*areas, *record, *calibration, *link]
