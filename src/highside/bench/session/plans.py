"""Which poses a session takes, in stages, and how it is solved: plans for each way to calibrate a tool.

A plan is a list of poses, each in a *stage*. Most plans have one stage. An oven soak has one for every step of
temperature: its poses are open only while the tool is at that temperature, and steady; a heated roll goes by
temperature alone, without waiting. Within a stage the poses may be taken in any order; they are listed so that the
table turns one way and the inclination changes seldom.

`reference` "none" is the session without a bench: the operator lays the tool down in as many attitudes as can be, poses
are found by themselves, and |g| alone calibrates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal

import numpy as np

from highside.calibration.advice import CANDIDATE_INC_RAD, CANDIDATE_TF_RAD, next_best_poses
from highside.calibration.conventional import position_plan
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.methods import get
from highside.calibration.methods.balance import METHOD as BALANCE
from highside.calibration.methods.conventional import METHOD as CONVENTIONAL
from highside.calibration.methods.joint import METHOD as JOINT
from highside.errors import InputError
from highside.physics.law import Law

Reference = Literal["pose", "magnitude"]


class SessionKind(StrEnum):
    """What a session is for."""

    BALANCE = "balance"
    CONVENTIONAL = "conventional"
    JOINT = "joint"
    TURNTABLE = "turntable"
    OVEN = "oven"
    HEATED_ROLL = "heated_roll"
    CUSTOM = "custom"
    UNGUIDED = "unguided"
    VERIFICATION = "verification"
    ROLL_TEST = "roll_test"

    @property
    def calibrates(self) -> bool:
        """Whether it ends in a calibration record (else in a verdict on an existing one)."""
        return self not in (SessionKind.VERIFICATION, SessionKind.ROLL_TEST)


BALANCE_TOOLFACES_DEG = (45.0, 135.0, 225.0, 315.0)
ROLL_TEST_MIN_TOOLFACES = 8
MAX_POSES = 2000


@dataclass(frozen=True, slots=True)
class PlannedPose:
    """A pose to take: the bench's settings in degrees (negative inclination: the table turned the other way).

    `true_*`: where the bench stands at these settings, by the fit of its turntable or a model; None: where it says.
    """

    id: str
    inc_deg: float
    tf_deg: float
    stage: int = 0
    true_inc_deg: float | None = None
    true_tf_deg: float | None = None

    @property
    def reference(self) -> tuple[float, float]:
        """Inclination and toolface that the pose is solved with, deg."""
        inc, tf = self.true_inc_deg, self.true_tf_deg
        return (self.inc_deg if inc is None else inc), (self.tf_deg if tf is None else tf)


@dataclass(frozen=True, slots=True)
class TemperatureStage:
    """A step of temperature. `temp_c` None: whatever it is. `steady`: wait until it does not change any more."""

    temp_c: float | None = None
    steady: bool = True


@dataclass(frozen=True, slots=True)
class Limits:
    """When a pose is good enough, and what is known of the sensor before it is measured.

    The table `[session]` (`config.bench.SessionTable`) is not this: there an absent field stands for what the kind of
    plan begins with. Here all have values, which the journal keeps. A test holds the names of both equal.

    `std_error_g`: the hold ends when the standard error of the mean (worst axis) is below this, not before `min_hold_s`
    and not after `max_hold_s`. `align_deg`: what may be missing to a pose beside what the sensor's own errors explain;
    these are taken from `prior_offset_g` and `prior_matrix` (one standard deviation each) until poses tell more.
    `retakes`: how often one pose is requested again before its contradiction is left to the operator. Temperature:
    within `temp_tolerance_c` of the step, and changing by less than `temp_rate_c_min`, for `soak_s`.
    """

    std_error_g: float = 15e-6
    min_hold_s: float = 3.0
    max_hold_s: float = 20.0
    align_deg: float = 0.3
    pose_sigma_deg: float = 0.0052
    prior_offset_g: float = 3e-3
    prior_matrix: float = 4e-3
    outlier_sigmas: float = 5.0
    retakes: int = 2
    temp_tolerance_c: float = 1.5
    temp_rate_c_min: float = 0.2
    soak_s: float = 120.0
    remind_s: float = 120.0
    """waiting longer than this is reported"""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not np.isfinite(value) or value < 0 or (value == 0 and name not in ("retakes", "soak_s")):
                raise InputError(f"{value!r} cannot be", field=f"session.{name}", remedy="give a positive number")
        if self.max_hold_s < self.min_hold_s:
            raise InputError("is less than min_hold_s", field="session.max_hold_s")


@dataclass(frozen=True, slots=True)
class Criterion:
    """What a verification or roll test judges (`record`: the id of the calibration), and by which limits.

    Of the plan in the file (`config.bench.VerificationPlan`, `RollTestPlan`) what the journal needs to judge again the
    same: there `record` may say "the active one" or be a file, and poses are given; here the id is settled.

    A verification has limits on the errors of I and T at a bench whose tilts are known to `tilt_sigma_deg` each
    (`same_bench`: as the record has found them), its tool clamped in toolface to `toolface_zero_sigma_deg`
    (`free_toolface_zero`: estimated). A roll test has limits on the ranges of I and of Gtotal.
    """

    record: str
    limit_inc_deg: float
    limit_tf_deg: float | None = None
    limit_g_total_g: float | None = None
    tilt_sigma_deg: float = 0.05
    same_bench: bool = False
    toolface_zero_sigma_deg: float = 0.0
    free_toolface_zero: bool = False


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """A whole session as planned. `poses` is empty, and `open_ended` true, where poses are found by themselves."""

    kind: SessionKind
    title: str
    method: str
    poses: tuple[PlannedPose, ...]
    stages: tuple[TemperatureStage, ...] = (TemperatureStage(),)
    limits: Limits = field(default_factory=Limits)
    reference: Reference = "pose"
    triples: str = "average"
    fallback: str = "none"
    min_poses: int = 1
    criterion: Criterion | None = None
    laws: tuple[Law, ...] = ()
    """of the sensor: taken off the poses before they are solved, and kept in the record"""

    def __post_init__(self) -> None:
        if self.open_ended:
            return
        if not self.poses:
            raise InputError("the plan has no poses", field="plan", remedy="give at least one inclination and toolface")
        if len(self.poses) > MAX_POSES:
            raise InputError(f"{len(self.poses)} poses", field="plan", remedy=f"at most {MAX_POSES}")
        if len({pose.id for pose in self.poses}) != len(self.poses):
            raise InputError("two poses have the same name", field="plan")
        for pose in self.poses:
            if not (np.isfinite(pose.inc_deg) and abs(pose.inc_deg) <= 180.0 and np.isfinite(pose.tf_deg)):
                raise InputError(f"inclination {pose.inc_deg:g}, toolface {pose.tf_deg:g} deg", field=f"pose {pose.id}")
            if not 0 <= pose.stage < len(self.stages):
                raise InputError(f"stage {pose.stage} of {len(self.stages)}", field=f"pose {pose.id}")

    @property
    def open_ended(self) -> bool:
        return self.kind is SessionKind.UNGUIDED

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the journal; every float comes back exactly."""
        plain = asdict(replace(self, laws=())) | {"kind": self.kind.value}
        # absent where there are none: journals made without stay as they are
        del plain["laws"]
        return plain | ({"laws": [law.to_dict() for law in self.laws]} if self.laws else {})

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> SessionPlan:
        return cls(
            **(
                dict(data)
                | {
                    "kind": SessionKind(data["kind"]),
                    "poses": tuple(PlannedPose(**pose) for pose in data["poses"]),
                    "stages": tuple(TemperatureStage(**stage) for stage in data["stages"]),
                    "limits": Limits(**data["limits"]),
                    "laws": tuple(Law.from_dict(law) for law in data.get("laws", ())),
                    "criterion": None if data.get("criterion") is None else Criterion(**data["criterion"]),
                }
            )
        )


def balance_plan(
    inclinations_deg: Sequence[float], limits: Limits | None = None, *, triples: str = "average"
) -> SessionPlan:
    """Four toolfaces in the middles of the quadrants at each inclination."""
    for inc in inclinations_deg:
        if abs(inc - 90.0) < 0.6 or abs(inc) < 0.06 or abs(inc) > 179.9:
            raise InputError(
                f"balance is not determined at an inclination of {inc:g} deg",
                field="plan.inclinations_deg",
                remedy="choose others, or the joint method",
            )
    poses = _grid(inclinations_deg, BALANCE_TOOLFACES_DEG)
    inclinations = ", ".join(f"{inc:g}" for inc in inclinations_deg)
    return SessionPlan(
        SessionKind.BALANCE,
        f"balance at {inclinations} deg",
        BALANCE.name,
        poses,
        limits=limits or Limits(),
        triples=triples,
    )


def conventional_plan(positions: int, limits: Limits | None = None) -> SessionPlan:
    """3, 6, 8, 12 or 24 positions."""
    try:
        inc, tf = position_plan(positions)
    except ValueError as error:
        raise InputError(str(error), field="plan.positions") from None
    attitudes = zip(np.rad2deg(inc).tolist(), np.rad2deg(tf).tolist(), strict=True)
    poses = tuple(PlannedPose(str(k + 1), i, t) for k, (i, t) in enumerate(attitudes))
    return SessionPlan(
        SessionKind.CONVENTIONAL,
        f"conventional, {positions} positions",
        CONVENTIONAL.name,
        poses,
        limits=limits or Limits(),
    )


def joint_plan(
    count: int = 24,
    limits: Limits | None = None,
    *,
    inclinations_deg: Sequence[float] | None = None,
    toolfaces_deg: Sequence[float] | None = None,
) -> SessionPlan:
    """`count` poses chosen one by one so that each lowers the final uncertainty the most (see `calibration.advice`).

    The bench's travel is what is allowed: inclinations (negative ones for a table that turns the other way) and
    toolfaces. They are then put in an order that moves the inclination stage seldom.
    """
    limits = limits or Limits()
    inc_allowed = CANDIDATE_INC_RAD if inclinations_deg is None else np.deg2rad(np.asarray(inclinations_deg, float))
    tf_allowed = CANDIDATE_TF_RAD if toolfaces_deg is None else np.deg2rad(np.asarray(toolfaces_deg, float))
    if count < 5:
        raise InputError(f"{count} poses", field="plan.poses", remedy="the joint method needs at least 5")
    if inc_allowed.size * tf_allowed.size < count:
        raise InputError("fewer settings than poses", field="plan.inclinations_deg", remedy="allow more of them")
    bench = BenchAccuracy(pose_rad=float(np.deg2rad(limits.pose_sigma_deg)))
    first = (np.array([inc_allowed[np.argmin(np.abs(inc_allowed - np.pi / 4))]]), tf_allowed[:1])
    chosen = [(float(first[0][0]), float(first[1][0]))]
    taken = set(chosen)
    inc, tf = first
    while len(chosen) < count:
        advice = next_best_poses(
            (inc, tf),
            bench=bench,
            noise_g=limits.std_error_g,
            count=1,
            inc_candidates_rad=inc_allowed,
            tf_candidates_rad=tf_allowed,
        )
        best = (advice[0].inc_rad, advice[0].tf_rad)
        if best in taken:  # the same setting again tells less of the bench than its neighbour
            free = [(float(i), float(t)) for i in inc_allowed for t in tf_allowed if (float(i), float(t)) not in taken]
            best = min(free, key=lambda pose: abs(pose[0] - best[0]) + abs(np.sin(0.5 * (pose[1] - best[1]))))
        taken.add(best)
        chosen.append(best)
        inc, tf = np.append(inc, best[0]), np.append(tf, best[1])
    ordered = sorted(chosen)
    poses = tuple(
        PlannedPose(str(k + 1), round(float(np.rad2deg(i)), 9), round(float(np.rad2deg(t)), 9))
        for k, (i, t) in enumerate(ordered)
    )
    return SessionPlan(SessionKind.JOINT, f"joint, {count} poses by advice", JOINT.name, poses, limits=limits)


LEAST_TURNTABLE_SIN = 0.05
LEAST_TURN = 8
"""Fewest stations of a full turn."""


def turntable_plan(
    inclinations_deg: Sequence[float] = (20.0, 50.0, 90.0), stations: int = 24, limits: Limits | None = None
) -> SessionPlan:
    """Full turns in equal steps at two inclinations or more: the sensor and the bench's own encoder and axis."""
    inc = np.deg2rad(np.asarray(inclinations_deg, dtype=float))
    if np.any(inc <= 0) or np.any(np.sin(inc) < LEAST_TURNTABLE_SIN):
        raise InputError(
            "a turn near vertical, or with the table on its other side, tells nothing of the encoder",
            field="plan.inclinations_deg",
            remedy="choose others between 3 and 177",
        )
    if np.ptp(1.0 / np.tan(inc)) < 0.1:
        raise InputError(
            "one inclination cannot tell the encoder from the wobble of the axis",
            field="plan.inclinations_deg",
            remedy="add a turn at another one",
        )
    if stations < LEAST_TURN:
        raise InputError(f"{stations} stations", field="plan.stations", remedy=f"at least {LEAST_TURN}")
    poses = _grid(inclinations_deg, tuple(360.0 * k / stations for k in range(stations)))
    turns = ", ".join(f"{value:g}" for value in inclinations_deg)
    return SessionPlan(
        SessionKind.TURNTABLE, f"turntable, full turns at {turns} deg", JOINT.name, poses, limits=limits or Limits()
    )


def soak_plan(
    temperatures_c: Sequence[float],
    inclinations_deg: Sequence[float],
    toolfaces_deg: Sequence[float],
    limits: Limits | None = None,
) -> SessionPlan:
    """The poses repeated at each step of an oven cycle (list the way up and the way down), each time when steady."""
    return _over_temperature(
        SessionKind.OVEN, "oven soak", temperatures_c, inclinations_deg, toolfaces_deg, limits, steady=True
    )


def heated_roll_plan(
    temperatures_c: Sequence[float],
    inclination_deg: float,
    toolfaces_deg: Sequence[float],
    limits: Limits | None = None,
) -> SessionPlan:
    """The tool is rolled at one inclination while it warms or cools: a turn of poses at each temperature passed."""
    return _over_temperature(
        SessionKind.HEATED_ROLL, "heated roll", temperatures_c, (inclination_deg,), toolfaces_deg, limits, steady=False
    )


def _over_temperature(
    kind: SessionKind,
    name: str,
    temperatures_c: Sequence[float],
    inclinations_deg: Sequence[float],
    toolfaces_deg: Sequence[float],
    limits: Limits | None,
    *,
    steady: bool,
) -> SessionPlan:
    if len(temperatures_c) < 2:
        raise InputError("a cycle has at least two steps", field="plan.temperatures_c")
    stages = tuple(TemperatureStage(float(temp), steady) for temp in temperatures_c)
    poses = tuple(
        replace(pose, id=f"{s + 1}.{pose.id}", stage=s)
        for s in range(len(stages))
        for pose in _grid(inclinations_deg, toolfaces_deg)
    )
    steps = " ".join(f"{temp:g}" for temp in temperatures_c)
    return SessionPlan(kind, f"{name} at {steps} C", JOINT.name, poses, stages, limits or Limits())


def custom_plan(
    poses: Sequence[tuple[float, float]],
    method: str = JOINT.name,
    limits: Limits | None = None,
    *,
    title: str = "custom",
) -> SessionPlan:
    """Any poses (inclination, toolface) in degrees, in the order given."""
    get(method, field="plan.method")
    planned = tuple(PlannedPose(str(k + 1), float(i), float(t)) for k, (i, t) in enumerate(poses))
    return SessionPlan(SessionKind.CUSTOM, title, method, planned, limits=limits or Limits())


def unguided_plan(limits: Limits | None = None, *, min_poses: int = 10) -> SessionPlan:
    """No bench: as many attitudes as can be, found by themselves; |g| alone calibrates. Ended by `accept`."""
    # sensors of hand sessions are uncalibrated as often as not
    limits = limits or Limits(min_hold_s=1.5, max_hold_s=60.0, prior_offset_g=0.05, prior_matrix=0.05)
    return SessionPlan(
        SessionKind.UNGUIDED,
        "attitudes by hand",
        JOINT.name,
        (),
        limits=limits,
        reference="magnitude",
        min_poses=min_poses,
    )


def verification_plan(
    poses: Sequence[tuple[float, float]], limits: Limits | None = None, criterion: Criterion | None = None
) -> SessionPlan:
    """A few poses to judge an existing calibration by ("as found"). Without a criterion they are only taken."""
    made = custom_plan(poses, JOINT.name, limits, title="verification")
    return replace(made, kind=SessionKind.VERIFICATION, method="none", criterion=criterion)


def roll_test_plan(
    inclination_deg: float, toolfaces: int = 8, limits: Limits | None = None, criterion: Criterion | None = None
) -> SessionPlan:
    """The field roll test: toolfaces all around at one inclination. Without a criterion they are only taken."""
    if toolfaces < ROLL_TEST_MIN_TOOLFACES:
        raise InputError(f"{toolfaces} toolfaces", field="plan.toolfaces", remedy=f"at least {ROLL_TEST_MIN_TOOLFACES}")
    poses = _grid((inclination_deg,), tuple(360.0 * k / toolfaces for k in range(toolfaces)))
    title = f"roll test at {inclination_deg:g} deg"
    return SessionPlan(SessionKind.ROLL_TEST, title, "none", poses, limits=limits or Limits(), criterion=criterion)


def _grid(inclinations_deg: Sequence[float], toolfaces_deg: Sequence[float]) -> tuple[PlannedPose, ...]:
    """Inclination by inclination, all toolfaces of one inclination before the next."""
    settings = [(float(inc), float(tf)) for inc in inclinations_deg for tf in toolfaces_deg]
    return tuple(PlannedPose(str(k + 1), inc, tf) for k, (inc, tf) in enumerate(settings))
