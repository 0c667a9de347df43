"""Names of units as data loggers write them, and what they are in ours: g, deg/s, deg, deg C, s."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import StrEnum

from highside.errors import InputError

STANDARD_GRAVITY = 9.80665
"""m/s2: the g of data sheets"""


class Quantity(StrEnum):
    """What a column measures."""

    ACCELERATION = "acceleration"
    RATE = "rate"
    ANGLE = "angle"
    TEMPERATURE = "temperature"
    TIME = "time"
    NUMBER = "number"


@dataclass(frozen=True, slots=True)
class Unit:
    """`ours = (value - zero) * factor + offset`; a time has nanoseconds as its own (whole numbers stay exact)."""

    name: str
    quantity: Quantity
    factor: float
    offset: float = 0.0
    zero: float = 0.0


_A, _R, _W, _T, _S = Quantity.ACCELERATION, Quantity.RATE, Quantity.ANGLE, Quantity.TEMPERATURE, Quantity.TIME
_DEG = 180.0 / math.pi
_UNITS = (
    (Unit("g", _A, 1.0), "g gee gn g0 standardgravity standard_gravity"),
    (Unit("mg", _A, 1e-3), "mg milli-g millig"),
    (Unit("ug", _A, 1e-6), "ug µg μg micro-g"),
    (
        Unit("m/s2", _A, 1 / STANDARD_GRAVITY),
        "m/s2 m/s^2 m/s² m/s**2 m/s/s ms-2 m*s-2 ms^-2 m*s^-2 ms⁻² mps2 mss m/ss ms2 m_s2 mps^2 m/(s^2) m/(s^2",
    ),
    (Unit("cm/s2", _A, 0.01 / STANDARD_GRAVITY), "cm/s2 cm/s^2 cm/s² gal"),
    (Unit("ft/s2", _A, 0.3048 / STANDARD_GRAVITY), "ft/s2 ft/s^2 ft/s²"),
    (
        Unit("deg/s", _R, 1.0),
        "deg/s °/s º/s dps deg/sec °/sec degps degpersec degs-1 deg*s-1 degree/s degrees/s deg_s degreepersecond",
    ),
    (Unit("rad/s", _R, _DEG), "rad/s rad/sec rads-1 rad*s-1 rad*s^-1 rads radps rad_s rads⁻¹ radian/s radians/s"),
    (Unit("mdeg/s", _R, 1e-3), "mdps mdeg/s m°/s"),
    (Unit("mrad/s", _R, _DEG * 1e-3), "mrad/s mradps mrad/sec"),
    (Unit("deg/h", _R, 1 / 3600), "deg/h °/h dph deg/hr"),
    (Unit("rpm", _R, 6.0), "rpm rev/min"),
    (Unit("deg", _W, 1.0), "deg ° º degree degrees"),
    (Unit("rad", _W, _DEG), "rad radian radians"),
    (Unit("mrad", _W, _DEG * 1e-3), "mrad"),
    (Unit("arcmin", _W, 1 / 60), "arcmin"),
    (Unit("C", _T, 1.0), "c degc °c ºc celsius degreecelsius deg_c centigrade"),
    (Unit("K", _T, 1.0, -273.15), "k kelvin degk"),
    (Unit("F", _T, 5 / 9, -160 / 9), "f degf °f fahrenheit"),
    (Unit("s", _S, 1e9), "s sec secs second seconds"),
    (Unit("ms", _S, 1e6), "ms msec millis millisecond milliseconds"),
    (Unit("us", _S, 1e3), "us µs μs usec micros microsecond microseconds"),
    (Unit("ns", _S, 1.0), "ns nsec nanos nanosecond nanoseconds"),
    (Unit("min", _S, 60e9), "min minute minutes"),
    (Unit("h", _S, 3600e9), "h hour hours"),
    # the order of a written date, where its numbers leave it open
    (Unit("day.month.year", _S, 1.0), "dmy day.month.year"),
    (Unit("month/day/year", _S, 1.0), "mdy month/day/year"),
)
_BY_NAME = {spelling: unit for unit, spellings in _UNITS for spelling in spellings.split()}
WRITTEN_DATES = ("day.month.year", "month/day/year")
"""units of time that are orders of a written date"""
_COUNTS = re.compile(r"(lsb|counts?|ticks?)/([0-9.]+(?:e[0-9]+)?)(?:@(-?[0-9.]+))?", re.IGNORECASE)
SUFFIXES = frozenset(
    unit
    for line in (
        "g mg ug mps2 ms2 mss dps rads radps mdps deg rad c degc celsius k kelvin f rpm",
        "s sec seconds ms msec millis us usec micros ns nsec nanos",
    )
    for unit in line.split()
)
"""words that, standing last in a name, are its unit"""


def unit_named(text: str, quantity: Quantity | None = None) -> Unit | None:
    """The unit of that name, of that quantity where one is given; None for what is none."""
    found = _BY_NAME.get(text.strip().lower().replace(" ", ""))
    return found if found is not None and quantity in (None, found.quantity) else None


def unit_wanted(text: str, quantity: Quantity) -> Unit:
    """What a user writes: the name of a unit, or a resolution: `lsb/16384` (per g, or per deg/s), `lsb/16384@32768`
    with the reading at zero, `ticks/10000` (a second). Raises InputError."""
    counts = _COUNTS.fullmatch(text.strip())
    if counts:
        per, zero = float(counts[2]), float(counts[3] or 0.0)
        time = quantity is Quantity.TIME
        if per > 0 and (counts[1].lower().startswith("tick") == time):
            return Unit(text.strip(), quantity, (1e9 if time else 1.0) / per, zero=zero)
    unit = unit_named(text, quantity)
    if unit is None:
        known = ", ".join(dict.fromkeys(unit.name for unit in _BY_NAME.values() if unit.quantity is quantity))
        extra = "ticks/10000" if quantity is Quantity.TIME else "lsb/16384"
        raise InputError(
            f"{text!r} is no unit of {quantity}", field="unit", remedy=f"known are {known or 'none'}, and {extra}"
        )
    return unit
