"""The field roll test: an existing calibration checked without a bench.

The tool is rolled through at least eight toolfaces in a rest that keeps its inclination.
The ranges (largest less smallest) of I and of Gtotal are compared with limits. Noise widens a range by at most the
range of the noise itself, so that the guard band is `q u` with q the 95 % point of the studentised range of N values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import wrap_positive
from highside.calibration.budget import K
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord
from highside.calibration.verification import Conformity, VerifiedQuantity, indicated, judge, worst
from highside.errors import InputError, Refused

ROLL_MIN_TOOLFACES = 8
ROLL_SAME_RAD = math.radians(5.0)
"""Toolfaces nearer than this are one."""
ROLL_LARGEST_GAP_RAD = math.radians(90.0)
ROLL_ONE_INC_RAD = math.radians(5.0)
"""A tool that was meant to stay at one inclination does not differ by more, whatever its calibration."""
ROLL_PROBABILITY = 0.95


@dataclass(frozen=True, slots=True)
class RollTest:
    """The ranges of I (deg) and Gtotal (g) over the toolfaces; their means and harmonics say what to look for.

    `*_first`: amplitude of the first harmonic over toolface: a remaining offset across the axis; `*_second`: of the
    second: scales of x and y that differ, or their angle.
    """

    record_id: str
    toolfaces: int
    mean_inc_deg: float
    mean_g_total: float
    inc: VerifiedQuantity
    g_total: VerifiedQuantity
    inc_first_deg: float
    inc_second_deg: float
    g_first: float
    g_second: float

    @property
    def verdict(self) -> Conformity:
        return worst([self.inc.verdict, self.g_total.verdict])

    @property
    def text(self) -> str:
        """The verdict as a sentence."""
        what = (
            f"I varies by {self.inc.error:.4f} deg (limit {self.inc.limit:g}), Gtotal by {1e3 * self.g_total.error:.3f}"
            f" mg (limit {1e3 * self.g_total.limit:g}) over {self.toolfaces} toolfaces"
        )
        match self.verdict:
            case Conformity.PASS:
                return f"Pass: {what}."
            case Conformity.FAIL:
                return f"Fail: {what}."
            case _:
                return f"Undecided: {what}; too near for the noise. Average longer."

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": "roll_test",
            "record": self.record_id,
            "verdict": self.verdict.value,
            "text": self.text,
            "rule": f"range of values, guard band = {ROLL_PROBABILITY:.0%} point of the range of the noise",
            "toolfaces": self.toolfaces,
            "mean_inc_deg": self.mean_inc_deg,
            "mean_g_total": self.mean_g_total,
            "inc_deg": self.inc.to_dict(),
            "g_total": self.g_total.to_dict(),
            "inc_first_deg": self.inc_first_deg,
            "inc_second_deg": self.inc_second_deg,
            "g_first": self.g_first,
            "g_second": self.g_second,
        }


def roll_test(
    record: CalibrationRecord,
    poses: PoseSet,
    *,
    limit_inc_deg: float,
    limit_g_total_g: float,
    inc_sigma_deg: float = 0.0,
) -> RollTest:
    """The field roll test of N poses: their toolfaces are those that the calibration itself indicates.

    `inc_sigma_deg`: how well the rest keeps the inclination (one standard deviation). Raises InputError for limits that
    are none, Refused where the poses are no roll test.
    """
    for name, limit in (("limit_inc_deg", limit_inc_deg), ("limit_g_total_g", limit_g_total_g)):
        if not (math.isfinite(limit) and limit > 0.0):
            raise InputError(f"{limit:g} is no limit", field=name, remedy="give a positive number")
    found = indicated(record, poses)
    if not np.all(np.isfinite(found.inc)):
        missing = [poses.ids[i] for i in np.flatnonzero(~np.isfinite(found.inc))]
        raise Refused(f"the calibration does not hold at pose {', '.join(missing)}: no roll test follows")
    if float(np.ptp(found.inc)) > ROLL_ONE_INC_RAD:
        raise Refused(
            f"the poses are not at one inclination ({np.rad2deg(found.inc.min()):.1f} to"
            f" {np.rad2deg(found.inc.max()):.1f} deg): roll the tool in a rest"
        )
    count, gap = _toolfaces(found.tf)
    if count < ROLL_MIN_TOOLFACES or gap > ROLL_LARGEST_GAP_RAD:
        raise Refused(
            f"{count} different toolfaces, largest gap {np.rad2deg(gap):.0f} deg: a roll test has at least"
            f" {ROLL_MIN_TOOLFACES} all around (gaps of at most {np.rad2deg(ROLL_LARGEST_GAP_RAD):.0f} deg)"
        )
    g_total = np.sqrt((found.g**2).sum(axis=0))
    noise = np.sqrt(np.mean(poses.noise_of_mean() ** 2, axis=0))
    inc_std = math.hypot(float(np.sqrt(np.mean(found.inc_noise**2))), math.radians(inc_sigma_deg))
    q = _range_quantile(len(poses))
    first, second = _harmonics(found.tf, found.inc), _harmonics(found.tf, g_total)
    return RollTest(
        record_id=record.id,
        toolfaces=count,
        mean_inc_deg=float(np.rad2deg(found.inc.mean())),
        mean_g_total=float(g_total.mean()),
        # the guard band is q u: judge doubles what it is given
        inc=_range(math.degrees(float(np.ptp(found.inc))), math.degrees(inc_std), q, limit_inc_deg),
        g_total=_range(float(np.ptp(g_total)), float(np.sqrt(np.mean(noise**2))), q, limit_g_total_g),
        inc_first_deg=math.degrees(first[0]),
        inc_second_deg=math.degrees(first[1]),
        g_first=second[0],
        g_second=second[1],
    )


def _range(value: float, std: float, q: float, limit: float) -> VerifiedQuantity:
    judged = judge(value, q * std / K, limit)
    return VerifiedQuantity(value, std, limit, judged.verdict)


def _range_quantile(count: int) -> float:
    from scipy.stats import studentized_range

    return float(studentized_range.ppf(ROLL_PROBABILITY, count, np.inf))


def _toolfaces(tf: Array) -> tuple[int, float]:
    """How many different toolfaces there are, and the largest gap between neighbours (rad)."""
    order = np.sort(wrap_positive(tf))
    gaps = np.diff(np.append(order, order[0] + 2.0 * np.pi))
    return int(np.count_nonzero(gaps > ROLL_SAME_RAD)), float(gaps.max())


def _harmonics(tf: Array, values: Array) -> tuple[float, float]:
    """Amplitudes of the first and second harmonic of `values` (N,) over toolface."""
    design = np.column_stack([np.ones_like(tf), np.cos(tf), np.sin(tf), np.cos(2 * tf), np.sin(2 * tf)])
    x = np.linalg.lstsq(design, values, rcond=None)[0]
    return float(np.hypot(x[1], x[2])), float(np.hypot(x[3], x[4]))
