"""Why a pose was not taken, why a command was refused, what is wrong at the moment: enums, each with its sentence.

Every text is for the person at the bench: what happened, then what to do. Programs use the member's value.
"""

from __future__ import annotations

from enum import StrEnum


class _Explained(StrEnum):
    """A member is its code; `text` is what a person reads."""

    text: str

    def __new__(cls, code: str, text: str = "") -> _Explained:
        member = str.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member


class Rejection(_Explained):
    """Why a pose was not accepted, or has to be taken again."""

    MOVED = "moved", "The tool moved while it was being measured. Keep hands off; it is measured again by itself."
    SHAKEN = "shaken", "The readings shook more than this sensor does at rest. Look for vibration near the bench."
    CREEPING = "creeping", "The reading drifted during the hold: clamp the table, then wait until it has settled."
    WRONG_POSE = "wrong_pose", "The tool left the requested pose before the measurement was done."
    REPEATED = "repeated", "This pose has been measured already. Turn to the pose shown, or choose Redo."
    TOO_SHORT = "too_short", "The hold was too short to average. Leave the tool until the bar is full."
    DATA_LOST = "data_lost", "The tool's data stopped during the hold. Check the cable; the pose is measured again."
    FROZEN = (
        "frozen",
        "The readings do not change at all: the sensor or its converter is stuck. Power the tool off and on.",
    )
    GAP = "gap", "Readings were lost or reordered during the hold. The pose is measured again."
    NOT_ONE_G = (
        "not_one_g",
        "The readings at rest are far from 1 g. Check the units and the axis mapping in the configuration.",
    )
    MIRRORED = (
        "mirrored",
        "Rate sensors and accelerometers turn opposite ways: two axes are swapped or one sign is wrong.",
    )
    TEMPERATURE = "temperature", "The temperature left the step during the hold. Wait until it is steady again."
    OUTLIER = (
        "outlier",
        "The reading contradicts the other poses. Set the pose again and look at table, clamp and scale.",
    )
    CLOSURE = "closure", "The four readings at this inclination contradict one another. Set this pose again with care."
    OMITTED = "omitted", "The solution had to leave this pose out. Set it again with care."
    STORAGE = "storage", "The pose could not be written to the disk. Free the disk; it is measured again."
    OPERATOR = "operator", "Taken back by the operator."
    INTERRUPTED = "interrupted", "The session was interrupted during this pose. It is measured again."

    @classmethod
    def _missing_(cls, value: object) -> Rejection | None:
        """What earlier journals call a pose that the solution omits."""
        return cls.OMITTED if value == "left_out" else None


class Refusal(_Explained):
    """Why a command was refused."""

    NOT_NOW = "not_now", "That cannot be done at this step."
    HELD_BY_OTHER = (
        "held_by_other",
        "Another holds this session, or it was taken elsewhere. Ask them, or let them pause it.",
    )
    UNKNOWN_POSE = "unknown_pose", "There is no pose of that name in this plan."
    NOTHING_TO_UNDO = "nothing_to_undo", "There is nothing left to take back."
    NOT_STILL = "not_still", "The tool is not still, or not at an open pose."
    NO_OPERATOR = "no_operator", "Say who you are: a command needs an operator's name."
    NOT_SOLVED = "not_solved", "There is no solution to accept. Measure the poses requested, or reject the session."
    STORAGE = "storage", "The journal cannot be written. Free the disk; nothing was changed."
    NO_RECORD = "no_record", "This session has made no calibration that could be put in force."
    IN_FORCE = "in_force", "This calibration is in force already."
    NOTHING_BEFORE = "nothing_before", "There is no earlier calibration to go back to."
    NOT_CONFIRMED = (
        "not_confirmed",
        "Confirm it: name (`confirm`) the record that is to be in force, by the first 6 digits of its id or more.",
    )
    STORE = "store", "The calibration store has refused, and nothing was changed."
    ID_USED = "id_used", "That request_id was another command's. Give each command an id of its own."


class Fault(_Explained):
    """What is wrong now and goes away by itself when it is corrected; nothing fails because of it."""

    NO_DATA = "no_data", "No data from the tool. Check power and cable; the session waits."
    LINK_DOWN = "link_down", "The link is down and is being tried again. The session waits."
    NOT_STILL = "not_still", "The tool does not come to rest. Keep hands off and look for vibration near the bench."
    LOST_FRAMES = (
        "lost_frames",
        "Readings are being lost on the way from the tool. Look at the cable and the baud rate.",
    )
    AXES_SUSPECT = (
        "axes_suspect",
        "The reading fits no open pose, but it would fit with axes swapped or signs changed. Check the axis mapping.",
    )
    MIRRORED = "mirrored", Rejection.MIRRORED.text
    NOT_ONE_G = "not_one_g", Rejection.NOT_ONE_G.text
    FROZEN = "frozen", Rejection.FROZEN.text
    OTHER_THAN_REQUESTED = (
        "other_than_requested",
        "Another pose than the one requested was recognised. That is allowed; if the table does stand at the pose "
        "that was requested, the axes are swapped: abort and check the axis mapping.",
    )
    READS_ALIKE = (
        "reads_alike",
        "The tool reads the same at more than one setting of this plan (the table turned to either side); which one "
        "it stands at cannot be determined. Such a pose is measured on request: set the one shown.",
    )
    WAITING_LONG = "waiting_long", "Nothing has happened for a long time. The session waits; pause it if you leave."
    TEMPERATURE = "temperature", "The temperature is not yet steady at this step. The session waits."
    NO_TEMPERATURE = (
        "no_temperature",
        "The plan goes by temperature, but the tool sends none. Abort and choose another plan.",
    )
    CONTRADICTION = (
        "contradiction",
        "The poses still contradict one another after being repeated. Accept only if you know why.",
    )
    STORAGE = "storage", "The journal cannot be written; nothing is taken until the disk is free again."
    CLOCK_STEP = (
        "clock_step",
        "The computer's clock was set during the session. Times in the record follow the new clock.",
    )
