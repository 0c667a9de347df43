"""What a person at the page of calibrations asks to be put in force, or to be taken back."""

from __future__ import annotations

from dataclasses import dataclass

from highside.calibration.record import CalibrationRecord


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked for. `now`: in force at present, `then`: afterwards; `back`: by taking the present one back;
    `to_nothing`: it is the only one, and `then` is that which is taken out; `doubt`: why it cannot be."""

    then: CalibrationRecord
    now: CalibrationRecord | None
    now_id: str
    back: bool
    doubt: str | None
    to_nothing: bool = False
