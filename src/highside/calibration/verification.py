"""Checking an existing calibration: at a few poses of a bench ("as found").

The error of a pose is what the calibration makes of the raw reading minus what the bench says. Its uncertainty is that
of the *comparison* (`budget`): reading noise of the mean, one setting of the bench, the bench's level as stated or as
the poses tell it (`bench_level`), and for toolface its zero.
The calibration's own stated uncertainty is not part of it (the calibration is what is being judged), but tells whether
an error is of a size that was to be expected: `sigmas`.

Decision rule: guarded acceptance with a guard band of U = k u, k = 2 (JCGM 106, ILAC-G8): *pass* where |error| + U is
within the limit, *fail* where |error| - U is beyond it, *undecided* between. A pose that passes by mistake, or fails by
mistake, does so with a probability of 2.3 % at most.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import difference
from highside.attitude.block import attitude_block, attitude_std_block
from highside.attitude.scalar import UNIFORM_ANGLE_STD_RAD
from highside.calibration.bench_level import VERTICAL_RAD, BenchLevel, LevelSource, Mask, best_level, leaning
from highside.calibration.budget import ComparisonBudget, K, Width, budgets, compared
from highside.calibration.comparison import attitudes_set
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord, correction_from_record
from highside.calibration.sensor_laws import BlockCorrection, at_rest
from highside.errors import InputError


class Conformity(StrEnum):
    """The answer to a comparison with a limit."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    """the uncertainty of the comparison is too large to say"""
    NOT_COVERED = "not_covered"
    """the calibration does not hold there: it gives no value"""


@dataclass(frozen=True, slots=True)
class VerifiedQuantity:
    """One comparison: the error, its standard uncertainty, the limit on its size (same unit), and the verdict.

    `sigmas`: the error in standard deviations of what was to be expected, the calibration's own uncertainty included.
    """

    error: float
    std: float
    limit: float
    verdict: Conformity
    sigmas: float | None = None

    def to_dict(self) -> dict[str, Any]:
        return {
            "error": self.error,
            "std": self.std,
            "limit": self.limit,
            "verdict": self.verdict.value,
            "sigmas": self.sigmas,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> VerifiedQuantity:
        return cls(data["error"], data["std"], data["limit"], Conformity(data["verdict"]), data["sigmas"])


def judge(error: float, std: float, limit: float, expected_std: float | None = None) -> VerifiedQuantity:
    """Guarded acceptance (see the module). `expected_std`: of the error if the calibration is as good as it says."""
    size, guard = abs(error), K * std
    verdict = Conformity.UNDECIDED
    if size + guard <= limit:
        verdict = Conformity.PASS
    elif size - guard > limit:
        verdict = Conformity.FAIL
    return VerifiedQuantity(error, std, limit, verdict, error / expected_std if expected_std else None)


@dataclass(frozen=True, slots=True)
class VerifiedPose:
    """One pose: the bench's setting, the indication (deg), and the two comparisons (deg) with what their uncertainties
    are made of. `tf` None: near vertical."""

    pose: str
    inc_ref_deg: float
    tf_ref_deg: float
    inc_deg: float | None
    tf_deg: float | None
    inc: VerifiedQuantity | None
    tf: VerifiedQuantity | None
    zone: str
    inc_budget: ComparisonBudget
    tf_budget: ComparisonBudget

    @property
    def verdict(self) -> Conformity:
        if self.inc is None:
            return Conformity.NOT_COVERED
        return worst([j.verdict for j in (self.inc, self.tf) if j is not None])

    def to_dict(self) -> dict[str, Any]:
        return {
            "pose": self.pose,
            "inc_ref_deg": self.inc_ref_deg,
            "tf_ref_deg": self.tf_ref_deg,
            "inc_deg": self.inc_deg,
            "tf_deg": self.tf_deg,
            "inc": None if self.inc is None else self.inc.to_dict(),
            "tf": None if self.tf is None else self.tf.to_dict(),
            "zone": self.zone,
            "inc_budget_deg": asdict(self.inc_budget),
            "tf_budget_deg": asdict(self.tf_budget),
            "verdict": self.verdict.value,
        }


@dataclass(frozen=True, slots=True)
class Verification:
    """All poses and the verdict of the whole: fail if one fails, undecided if one is, pass if all pass."""

    record_id: str
    poses: tuple[VerifiedPose, ...]
    limit_inc_deg: float
    limit_tf_deg: float
    level: BenchLevel
    """of the bench, and where it is known from; taken off"""
    toolface_zero_deg: float | None
    """taken off the toolfaces (the chuck's zero was estimated), None where it was not"""
    leans: bool = False
    """whether the poses show a bench that leans otherwise than was said"""
    unproven: bool = False
    """whether what was taken off as the bench's lean is more than was said, and could as well be the tool's error"""

    @property
    def verdict(self) -> Conformity:
        found = worst([pose.verdict for pose in self.poses])
        return Conformity.UNDECIDED if found is Conformity.PASS and self.unproven else found

    @property
    def consistent(self) -> bool:
        """Whether all errors are of a size that the calibration's stated uncertainty lets expect (3 sigma)."""
        all_judged = [j for pose in self.poses for j in (pose.inc, pose.tf) if j is not None and j.sigmas is not None]
        return all(abs(j.sigmas or 0.0) <= 3.0 for j in all_judged)

    @property
    def text(self) -> str:
        """The verdict as a sentence."""
        count = len(self.poses)
        tally = {verdict: sum(pose.verdict is verdict for pose in self.poses) for verdict in Conformity}
        match self.verdict:
            case Conformity.PASS:
                return f"Pass: all {count} poses are within the limits, uncertainty included."
            case Conformity.FAIL:
                return (
                    f"Fail: {tally[Conformity.FAIL]} of {count} poses are beyond a limit by more than the uncertainty."
                )
            case Conformity.NOT_COVERED:
                return (
                    f"Undecided: the calibration does not hold at {tally[Conformity.NOT_COVERED]} of {count} poses."
                    " Verify within its zones, or calibrate there."
                )
            case _ if not tally[Conformity.UNDECIDED]:
                return (
                    f"Undecided: the poses show a lean of {math.degrees(self.level.x_rad):+.3f} and"
                    f" {math.degrees(self.level.y_rad):+.3f} deg, more than was said of this bench; a tool that is"
                    " wrong alike everywhere looks the same. Set poses also with the table turned the other way"
                    " (inclination -I, toolface + 180), or state how level the bench is (tilt_sigma_deg)."
                )
            case _ if self.one_sided:
                return (
                    "Undecided from one side: a bench that leans as much as was stated hides a tool that is wrong alike"
                    f" everywhere. {self.widest.text}"
                )
            case _:
                return (
                    f"Undecided: {tally[Conformity.UNDECIDED]} of {count} poses are too near a limit for the"
                    f" uncertainty of this comparison. {self.widest.text}"
                )

    @property
    def one_sided(self) -> bool:
        """Whether it is the level of the bench, as stated, that leaves most undecided: reversed poses would tell."""
        return self.widest.budget.largest == "level" and self.level.source is LevelSource.STATED

    @property
    def widest(self) -> Width:
        """The comparison, among those undecided (or all), whose U takes the largest share of its limit."""
        return max(self._widths(), key=lambda width: width.share)

    @property
    def widest_on_a_level_bench(self) -> Width:
        """As `widest`, were the level of the bench known exactly: what no knowledge of it makes smaller."""
        return max((width.on_a_level_bench for width in self._widths()), key=lambda width: width.share)

    def _widths(self) -> list[Width]:
        poses = [pose for pose in self.poses if pose.verdict is Conformity.UNDECIDED] or list(self.poses)
        return [
            Width(name, pose.pose, K * budget.std, limit, budget, self.level.source)
            for pose in poses
            for name, judged, budget, limit in (
                ("I", pose.inc, pose.inc_budget, self.limit_inc_deg),
                ("T", pose.tf, pose.tf_budget, self.limit_tf_deg),
            )
            if judged is not None
        ]

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": "verification",
            "record": self.record_id,
            "verdict": self.verdict.value,
            "text": self.text,
            "consistent": self.consistent,
            "rule": "guarded acceptance, guard band U = 2 u",
            "limit_inc_deg": self.limit_inc_deg,
            "limit_tf_deg": self.limit_tf_deg,
            "bench_level": {
                "source": self.level.source.value,
                "tilt_deg": [math.degrees(self.level.x_rad), math.degrees(self.level.y_rad)],
                "tilt_std_deg": [math.degrees(self.level.x_std_rad), math.degrees(self.level.y_std_rad)],
                "otherwise_than_said": self.leans,
            },
            "toolface_zero_deg": self.toolface_zero_deg,
            "poses": [pose.to_dict() for pose in self.poses],
        }


_ORDER = (
    Conformity.PASS,
    Conformity.NOT_COVERED,
    Conformity.UNDECIDED,
    Conformity.FAIL,
)


def worst(verdicts: list[Conformity]) -> Conformity:
    """The verdict of several together."""
    return max(verdicts, key=_ORDER.index)


@dataclass(frozen=True, slots=True)
class Indicated:
    """What a record makes of N poses: `g` (3, N) in g, I and T (rad) with the standard deviations of the reading noise
    and of the calibration, and the zone of each ("none": not covered, values are not numbers)."""

    g: Array
    inc: Array
    tf: Array
    inc_noise: Array
    tf_noise: Array
    inc_cal: Array
    tf_cal: Array
    zone: tuple[str, ...]


def indicated(record: CalibrationRecord, poses: PoseSet) -> Indicated:
    """The corrected attitudes of N poses."""
    correction = correction_from_record(record)
    if not isinstance(correction, BlockCorrection):
        raise TypeError(f"{type(correction).__name__} cannot be applied in blocks")
    correction = at_rest(correction)
    temp = poses.temp_c
    alone = correction.corrected_block(poses.a, 0.0, temp)
    noise = np.sqrt(np.mean(poses.noise_of_mean() ** 2, axis=0))
    noisy = correction.corrected_block(poses.a, noise, temp)
    inc, tf = attitude_block(alone.g)
    inc_cal, tf_cal, _ = attitude_std_block(alone.g, alone.cov)
    inc_noise, tf_noise, _ = attitude_std_block(alone.g, noisy.reading)
    names = (*alone.names, "none")
    return Indicated(
        alone.g, inc, tf, inc_noise, tf_noise, inc_cal, tf_cal, tuple(names[index] for index in alone.zone.tolist())
    )


def tilt_of(record: CalibrationRecord) -> BenchLevel | None:
    """The tilt of the bench that a record was made on; None where it was not estimated."""
    result = record.result
    if result.frame != "gravity":
        return None
    parameters = result.main.parameters
    return BenchLevel(*result.tilt_rad, parameters.std("tilt_x"), parameters.std("tilt_y"))


class _AngleErrors(NamedTuple):
    """Errors (N,) of I or T with their standard deviations, rad, and the limit on them, deg."""

    error: Array
    std: Array
    limit_deg: float


def _verified_pose(
    i: int,
    name: str,
    found: Indicated,
    reference: tuple[Array, Array, Mask],
    judged: tuple[_AngleErrors, _AngleErrors],
    budgets_of: tuple[ComparisonBudget, ComparisonBudget],
) -> VerifiedPose:
    """Row i: angles outside of every zone, and toolfaces near the vertical, are not judged."""
    inc_ref, tf_ref, has_tf = reference
    inc, tf = judged
    set_deg = math.degrees(inc_ref[i]), math.degrees(tf_ref[i])
    zone, inc_budget, tf_budget = found.zone[i], *budgets_of
    if not np.isfinite(found.inc[i]):
        return VerifiedPose(name, *set_deg, None, None, None, None, zone, inc_budget, tf_budget)
    expected = math.hypot(inc.std[i], found.inc_cal[i])
    inc_judged = _judge_angle(inc.error[i], inc.std[i], inc.limit_deg, expected)
    tf_judged = tf_deg = None
    if has_tf[i]:
        wide = min(float(tf.std[i]), UNIFORM_ANGLE_STD_RAD)
        expected = math.hypot(wide, found.tf_cal[i])
        tf_judged = _judge_angle(tf.error[i], wide, tf.limit_deg, expected)
        tf_deg = math.degrees(found.tf[i])
    inc_deg = math.degrees(found.inc[i])
    return VerifiedPose(name, *set_deg, inc_deg, tf_deg, inc_judged, tf_judged, zone, inc_budget, tf_budget)


def verify_poses(
    record: CalibrationRecord,
    poses: PoseSet,
    *,
    limit_inc_deg: float,
    limit_tf_deg: float,
    bench: BenchAccuracy,
    tilt: BenchLevel | None = None,
    toolface_zero_std_deg: float = 0.0,
    free_toolface_zero: bool = False,
) -> Verification:
    """Test a calibration at N poses whose attitudes the bench gives.

    The bench is level within `bench.tilt_rad`, or leans by `tilt`, unless the poses determine it better or contradict
    it (`bench_level.best_level`); what is known of it is taken off, and counts with its own uncertainty.
    `free_toolface_zero`: the zero of this clamping is estimated and taken off. Raises InputError.
    """
    _require_limits(limit_inc_deg, limit_tf_deg)
    inc_set, tf_set = poses.reference()
    inc_ref, tf_ref = attitudes_set(inc_set, tf_set)
    found = indicated(record, poses)
    zero_std = math.radians(toolface_zero_std_deg)
    errors = (found.inc - inc_ref, difference(found.tf, tf_ref))
    poses_of = compared(inc_set, tf_set, (found.inc_noise, found.tf_noise), bench.pose_rad, errors)
    level_text = tilt or BenchLevel.stated(bench.tilt_rad)
    level = best_level(poses_of, level_text)
    inc_budgets, tf_budgets = budgets(poses_of, (found.inc_noise, found.tf_noise), bench.pose_rad, level, zero_std)
    inc_std, tf_std = (np.radians([budget.std for budget in which]) for which in (inc_budgets, tf_budgets))
    shift_inc, shift_tf = leaning(inc_set, tf_set, level.x_rad, level.y_rad)
    inc_error, tf_error = errors[0] - shift_inc, difference(errors[1], shift_tf)
    has_tf = np.abs(np.sin(inc_set)) > math.sin(VERTICAL_RAD)
    zero = None
    if free_toolface_zero:
        zero = _zero(tf_error, tf_std, has_tf & np.isfinite(found.inc))
        tf_error = difference(tf_error, zero)
    reference = inc_ref, tf_ref, has_tf
    judged = _AngleErrors(inc_error, inc_std, limit_inc_deg), _AngleErrors(tf_error, tf_std, limit_tf_deg)
    rows = [
        _verified_pose(i, name, found, reference, judged, (inc_budgets[i], tf_budgets[i]))
        for i, name in enumerate(poses.ids)
    ]
    return Verification(
        record.id,
        tuple(rows),
        limit_inc_deg,
        limit_tf_deg,
        level,
        None if zero is None else math.degrees(zero),
        level.contradicts(level_text),
        level.unproven,
    )


def _require_limits(limit_inc_deg: float, limit_tf_deg: float) -> None:
    """Raises InputError for a limit that is none."""
    for name, limit in (("limit_inc_deg", limit_inc_deg), ("limit_tf_deg", limit_tf_deg)):
        if not (math.isfinite(limit) and limit > 0.0):
            raise InputError(f"{limit:g} is no limit", field=name, remedy="give a positive number of degrees")


def _zero(tf_error: Array, tf_std: Array, use: Mask) -> float:
    """The zero of the toolfaces: their weighted mean error. Raises InputError for too few."""
    if np.count_nonzero(use) < 3:
        raise InputError("too few poses to estimate the toolface zero", remedy="three at the least, or state it")
    weight = 1.0 / tf_std[use] ** 2
    # about the first one, so that errors near half a turn average well
    first = float(tf_error[use][0])
    return first + float(np.sum(weight * difference(tf_error[use], first)) / np.sum(weight))


def _judge_angle(error: float, std: float, limit_deg: float, expected: float) -> VerifiedQuantity:
    return judge(math.degrees(error), math.degrees(std), limit_deg, math.degrees(expected))
