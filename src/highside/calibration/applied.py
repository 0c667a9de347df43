"""A calibration record applied to the rows of a recording: inclination and toolface with their standard deviations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import wrap_positive
from highside.attitude.block import attitude_block, attitude_std_block
from highside.calibration.record import CalibrationRecord, correction_from_record
from highside.calibration.sensor_laws import BlockCorrection, LawCorrection
from highside.errors import InputError

__all__ = ["ADDED", "Applied", "apply_record", "corrected_accel"]


ADDED = ("inc_deg", "tf_deg", "inc_std_deg", "tf_std_deg")
ROWS_AT_ONCE = 65536
"""rows corrected together: vectors and covariances of as many take some 10 MB, whatever the recording's length"""
DECIMALS = 9
"""of an angle, deg: a millionth of what the best sensor tells; more digits only make a file larger"""
NO_ZONE = "none"


@dataclass(frozen=True, slots=True)
class Applied:
    """N rows: inclination, toolface and their standard deviations in degrees by name, (N,) each, NaN in no zone."""

    columns: dict[str, Array]
    zones: tuple[str, ...]
    """which correction made each row; "none" where no zone holds"""
    temperature_outside: int
    """rows in a zone but beyond the calibrated temperatures: their uncertainty is grown"""
    law_outside: int = 0
    """rows in a zone but beyond the range that a law of the record was learnt in: it falls to 0, its band grows"""
    law_not_applied: int = 0
    """rows in a zone for which a law lacks what it depends on: their uncertainty is grown by the law's size"""

    @property
    def rows_by_zone(self) -> dict[str, int]:
        """Rows that each zone corrected, by its name."""
        return dict(sorted((name, rows) for name, rows in Counter(self.zones).items() if name != NO_ZONE))

    @property
    def outside_zone(self) -> int:
        """Rows that lie outside of every zone and have no inclination or toolface."""
        return self.zones.count(NO_ZONE)


def apply_record(
    record: CalibrationRecord,
    a: Array,
    noise_g: Array | float,
    temp_c: Array | None = None,
    *,
    frame: Literal["gravity", "bench"] = "gravity",
    columns: Mapping[str, Array] | None = None,
) -> Applied:
    """Correct readings `a` (3, N) in g with the noise of a row (one value or (N,), g) at temperatures (N,) in C.

    `columns`: what else was recorded, (N,) by name; laws of the record may depend on it. `frame`: what I and T are
    referred to. Raises TypeError for a record whose correction knows single readings only.
    """
    correction = _block_correction(record)
    n = a.shape[1]
    made = {name: np.full(n, np.nan) for name in ADDED}
    zones = np.full(n, NO_ZONE, dtype=object)
    counts = {"temperature_outside": 0, "law_outside": 0, "law_unknown": 0}
    for start in range(0, n, ROWS_AT_ONCE):
        rows = slice(start, min(start + ROWS_AT_ONCE, n))
        own = noise_g[rows] if isinstance(noise_g, np.ndarray) else noise_g
        now = _beside(correction, columns, rows)
        done = now.corrected_block(a[:, rows], own, None if temp_c is None else temp_c[rows])
        inc, tf = attitude_block(done.g)
        inc_std, tf_std, _ = attitude_std_block(done.g, done.cov)
        if frame == "bench":
            inc, tf, inc_std, tf_std = _in_bench_frame(record, inc, tf, inc_std, tf_std, own)
        inc_std[done.zone < 0] = np.nan
        tf_std[done.zone < 0] = np.nan
        for name, values in zip(ADDED, (inc, tf, inc_std, tf_std), strict=True):
            made[name][rows] = np.round(np.rad2deg(values), DECIMALS)
        zones[rows] = np.array([*done.names, NO_ZONE], dtype=object)[done.zone]
        for name in counts:
            where = getattr(done, name)
            counts[name] += 0 if where is None else int(np.count_nonzero(where & (done.zone >= 0)))
    return Applied(made, tuple(zones.tolist()), *counts.values())


def _beside(correction: BlockCorrection, columns: Mapping[str, Array] | None, rows: slice) -> BlockCorrection:
    """The correction with what was recorded beside the readings of some rows, where its laws depend on it."""
    if not isinstance(correction, LawCorrection) or columns is None:
        return correction
    return correction.knowing({name: columns[name][rows] for name in correction.laws.columns if name in columns})


def corrected_accel(
    record: CalibrationRecord,
    a: Array,
    temp_c: Array | None = None,
    *,
    where: str | None = None,
    columns: Mapping[str, Array] | None = None,
) -> Array:
    """Corrected gravity (3, N) in g; `columns` as in `apply_record`.

    Raises InputError for a record that corrects no blocks of accelerations.
    """
    correction = correction_from_record(record)
    if not isinstance(correction, BlockCorrection):
        raise InputError("does not correct accelerations", where=where)
    return _beside(correction, columns, slice(None)).correct_block(a, temp_c)


def _block_correction(record: CalibrationRecord) -> BlockCorrection:
    correction = correction_from_record(record)
    if not isinstance(correction, BlockCorrection):
        raise TypeError(f"{type(correction).__name__} cannot be applied in blocks")
    return correction


def _in_bench_frame(
    record: CalibrationRecord, inc: Array, tf: Array, inc_std: Array, tf_std: Array, noise: Array | float
) -> tuple[Array, Array, Array, Array]:
    """I and T as the bench reads them. The tilt's error is correlated with the vector's: both are taken together."""
    result = record.result
    if result.frame != "gravity":
        return inc, tf, inc_std, tf_std  # the bench was taken as level: its frame is all there is
    alone = result.predict_std(inc, tf, noise)
    together = result.predict_std(inc, tf, noise, frame="bench")
    bench_inc, bench_tf = result.to_bench_frame(inc, tf)
    stds = [
        np.sqrt(np.maximum(total**2 - without**2 + with_tilt**2, 0.0))
        for total, without, with_tilt in zip((inc_std, tf_std), alone, together, strict=True)
    ]
    return bench_inc, wrap_positive(bench_tf), stds[0], stds[1]
