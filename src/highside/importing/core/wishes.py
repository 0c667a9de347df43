"""What the user says of a file; it goes before everything that is inferred."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from highside.errors import InputError
from highside.importing.core.units import Quantity, Unit, unit_named, unit_wanted

NOTHING = "none"
"""written for a column that is to be left out"""


_OF = {
    "accel": Quantity.ACCELERATION,
    "gyro": Quantity.RATE,
    "time": Quantity.TIME,
    "angle": Quantity.ANGLE,
    "temp": Quantity.TEMPERATURE,
}
"""written before a unit that does not say what it is of: `accel=lsb/16384`"""


class Taken(StrEnum):
    """How a value between two rows is taken."""

    INTERPOLATED = "interpolated"
    NEAREST = "nearest"
    LAST = "last"


@dataclass(frozen=True, slots=True)
class Wishes:
    """`mapping`: column of ours to `COLUMN` or `COLUMN:unit` of the file, or `none`; `units`: one for each quantity."""

    mapping: Mapping[str, str] = field(default_factory=dict)
    units: tuple[str, ...] = ()
    axes: str | None = None
    rate_hz: float | None = None
    table: str | None = None
    part: int | None = None
    reference: bool = False
    """whether it is joined to a recording: it need hold no accelerations, and its angles are the reference"""
    poses: bool = False
    """whether each row is a pose, not a moment: it needs no time, and its angles are the reference"""

    def unit_of(self, quantity: Quantity) -> Unit | None:
        """The unit that was given for a quantity."""
        for text in self.units:
            name, mark, unit = text.partition("=")
            if mark and _OF.get(name.strip().lower()) is quantity:
                return unit_wanted(unit, quantity)
            if not mark and (found := unit_named(text, quantity)) is not None:
                return found
        return None

    def check(self, known: Sequence[str]) -> None:
        """Raises InputError for a column of ours that does not exist, or a unit that is none."""
        for name in self.mapping:
            if name not in known:
                near = ", ".join(known[:10])
                raise InputError(f"{name!r} is no column of a recording", field="--map", remedy=f"columns: {near}, ...")
        for text in self.units:
            name, mark, unit = text.partition("=")
            quantity = _OF.get(name.strip().lower())
            if mark and quantity is not None:
                unit_wanted(unit, quantity)
            elif mark or unit_named(text) is None:
                remedy = "write e.g. m/s2,rad/s,C,ms, or accel=lsb/16384,gyro=lsb/131"
                raise InputError(f"{text!r} is no unit", field="--units", remedy=remedy)
        if self.poses and (self.rate_hz is not None or self.mapping.get("t_s", NOTHING) != NOTHING):
            raise InputError("a table of poses has no time", field="--poses", remedy="leave out --rate and t_s")
        if self.rate_hz is not None and not 0 < self.rate_hz < 1e9:
            raise InputError(f"{self.rate_hz:g} is no rate", field="--rate", remedy="give rows a second, e.g. 100")


def parse_mapping(texts: Sequence[str]) -> dict[str, str]:
    """`NAME=COLUMN[:unit]` given several times. Raises InputError."""
    found: dict[str, str] = {}
    for text in texts:
        name, mark, column = text.partition("=")
        if not mark or not name.strip() or not column.strip():
            raise InputError(f"{text!r} is no mapping", field="--map", remedy="write NAME=COLUMN or NAME=COLUMN:unit")
        if name.strip() in found:
            raise InputError(f"{name.strip()} is given twice", field="--map", remedy="give each column once")
        found[name.strip()] = column.strip()
    return found
