"""What a new calibration of a tool changes: its coefficients, and what the same reading is taken for.

Coefficients are compared by name within zones of one name; the errors of the two records are taken as independent of
one another, which they are not where both stood on one bench whose level or turntable is in error: the band of the
difference is then too wide for what both have in common. The readings are those of a perfect sensor over a grid of
attitudes, both records at one temperature: they show the difference in degrees whatever methods and zones the records
have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import difference
from highside.attitude.block import attitude_block, attitude_std_block
from highside.calibration.comparison import INCLINATIONS_DEG, TOOLFACES_RAD
from highside.calibration.record import CalibrationRecord, correction_from_record
from highside.calibration.sensor_laws import BlockCorrection, at_rest
from highside.calibration.zone import SHARED_NAMES, Zone
from highside.physics.gravity import gravity_direction

__all__ = ["CoefficientChange", "ReadingChange", "RecordChange", "change"]


@dataclass(frozen=True, slots=True)
class CoefficientChange:
    """One coefficient of both: values and standard deviations in `unit` ("" for elements of the matrix)."""

    zone: str
    name: str
    unit: str
    before: float
    before_std: float
    after: float
    after_std: float

    @property
    def difference(self) -> float:
        return self.after - self.before

    @property
    def std(self) -> float:
        """Of the difference, the errors of both taken as independent."""
        return math.hypot(self.before_std, self.after_std)

    @property
    def sigmas(self) -> float | None:
        """The difference in its standard deviations; None where neither record estimates the coefficient."""
        return abs(self.difference) / self.std if self.std > 0.0 else None


@dataclass(frozen=True, slots=True)
class ReadingChange:
    """What the same readings near one inclination are taken for, over all toolfaces: the largest change of I and T
    (deg) and the largest standard deviation of it. None: one of the two does not hold there."""

    inc_deg: float
    inc_change_deg: float | None
    inc_std_deg: float | None
    tf_change_deg: float | None
    tf_std_deg: float | None


@dataclass(frozen=True, slots=True)
class RecordChange:
    """From one record to another. `temp_c`: the temperature at which the readings are compared (None: the reference
    temperature of each); `only_before`, `only_after`: zones that the other does not have."""

    coefficients: tuple[CoefficientChange, ...]
    readings: tuple[ReadingChange, ...]
    temp_c: float | None
    only_before: tuple[str, ...]
    only_after: tuple[str, ...]


def change(before: CalibrationRecord, after: CalibrationRecord) -> RecordChange:
    """Compare two records, of one tool or not, solved by one method or not."""
    old, new = _zones(before), _zones(after)
    temp_c = _temperature(after)
    return RecordChange(
        tuple(row for name in old if name in new for row in _coefficients(old[name], new[name])),
        _readings(before, after, temp_c),
        temp_c,
        tuple(name for name in old if name not in new),
        tuple(name for name in new if name not in old),
    )


def _zones(record: CalibrationRecord) -> dict[str, Zone]:
    return {zone.name: zone for zone in record.result.zones}


def _temperature(record: CalibrationRecord) -> float | None:
    """That at which the newer record is best known."""
    fitted = record.result.main.temperature
    stated = record.content["environment"]["temp_c"]
    if fitted is not None:
        return fitted.ref_c
    return None if stated is None else float(stated)


def _coefficients(old: Zone, new: Zone) -> list[CoefficientChange]:
    """In the order of the newer record; what only one of them has counts as 0 in the other."""
    names = dict.fromkeys((*new.parameters.names, *old.parameters.names))
    return [
        CoefficientChange(
            new.name,
            name,
            new.parameters.unit(name) if name.partition("_")[0] != "A" else "",
            old.parameters.get(name),
            old.parameters.std(name),
            new.parameters.get(name),
            new.parameters.std(name),
        )
        for name in names
        if name not in SHARED_NAMES
    ]


def _readings(before: CalibrationRecord, after: CalibrationRecord, temp_c: float | None) -> tuple[ReadingChange, ...]:
    inc = np.repeat(np.deg2rad(INCLINATIONS_DEG), TOOLFACES_RAD.size)
    raw = np.ascontiguousarray(gravity_direction(inc, np.tile(TOOLFACES_RAD, len(INCLINATIONS_DEG))))
    old, new = (_attitudes(record, raw, temp_c) for record in (before, after))
    shape = (len(INCLINATIONS_DEG), TOOLFACES_RAD.size)
    inc_change = np.rad2deg(np.abs(new[0] - old[0])).reshape(shape)
    tf_change = np.rad2deg(np.abs(difference(new[1], old[1]))).reshape(shape)
    held = np.isfinite(inc_change)
    inc_std, tf_std = (np.where(held, np.rad2deg(np.hypot(old[k], new[k])).reshape(shape), np.nan) for k in (2, 3))
    return tuple(
        ReadingChange(inc_deg, *(_largest(values[k]) for values in (inc_change, inc_std, tf_change, tf_std)))
        for k, inc_deg in enumerate(INCLINATIONS_DEG)
    )


def _attitudes(record: CalibrationRecord, raw: Array, temp_c: float | None) -> tuple[Array, Array, Array, Array]:
    """I, T and their standard deviations (rad), each (N,), by the calibration alone."""
    correction = correction_from_record(record)
    if not isinstance(correction, BlockCorrection):
        raise TypeError(f"{type(correction).__name__} cannot be applied in blocks")
    done = at_rest(correction).corrected_block(raw, 0.0, temp_c)
    inc, tf = attitude_block(np.ascontiguousarray(done.g))
    inc_std, tf_std, _ = attitude_std_block(done.g, done.cov)
    return inc, tf, inc_std, tf_std


def _largest(values: Array) -> float | None:
    """None where one of them is no number: a calibration that does not hold at every toolface does not hold there."""
    return float(values.max()) if np.isfinite(values).all() else None
