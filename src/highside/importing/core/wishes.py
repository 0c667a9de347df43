"""What the user says of a file; it goes before everything that is inferred."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from highside.errors import InputError
from highside.importing.core.units import Quantity, Unit, unit_named

NOTHING = "none"
"""written for a column that is to be left out"""


@dataclass(frozen=True, slots=True)
class Wishes:
    """`mapping`: column of ours to `COLUMN` or `COLUMN:unit` of the file, or `none`; `units`: one for each quantity."""

    mapping: Mapping[str, str] = field(default_factory=dict)
    units: tuple[str, ...] = ()
    axes: str | None = None
    rate_hz: float | None = None
    table: str | None = None
    part: int | None = None

    def unit_of(self, quantity: Quantity) -> Unit | None:
        """The unit that was given for a quantity."""
        return next((unit for text in self.units if (unit := unit_named(text, quantity)) is not None), None)

    def check(self, known: Sequence[str]) -> None:
        """Raises InputError for a column of ours that does not exist, or a unit that is none."""
        for name in self.mapping:
            if name not in known:
                near = ", ".join(known[:10])
                raise InputError(f"{name!r} is no column of a recording", field="--map", remedy=f"columns: {near}, ...")
        for text in self.units:
            if unit_named(text) is None:
                raise InputError(f"{text!r} is no unit", field="--units", remedy="write e.g. m/s2,rad/s,C,ms")
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
