"""What the uncertainty of a comparison with a bench is made of, how wide that makes it against a limit, and what helps.

Known before anything is measured but for the reading noise, which a session ends its holds by: a limit that no error at
all could pass is refused before the first pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.calibration.bench_level import VERTICAL_RAD, BenchLevel, LevelSource, ReferenceComparison, best_level
from highside.calibration.linear_errors import BenchAccuracy

K = 2.0
"""Coverage factor of the guard band."""


@dataclass(frozen=True, slots=True)
class ComparisonBudget:
    """What the uncertainty of one comparison is made of: standard deviations, deg."""

    noise: float
    setting: float
    level: float
    zero: float = 0.0

    @property
    def std(self) -> float:
        return math.hypot(self.noise, self.setting, self.level, self.zero)

    @property
    def largest(self) -> str:
        """The term that makes the most of it."""
        return max(asdict(self).items(), key=lambda term: term[1])[0]


@dataclass(frozen=True, slots=True)
class Width:
    """How wide a comparison of I or T at a pose is against its limit (deg), and what makes it so."""

    name: str
    pose: str
    u_deg: float
    limit_deg: float
    budget: ComparisonBudget
    level: LevelSource

    @property
    def hopeless(self) -> bool:
        """Whether even an error of zero would not pass."""
        return self.u_deg >= self.limit_deg

    @property
    def share(self) -> float:
        """U as a multiple of the limit."""
        return self.u_deg / self.limit_deg

    @property
    def on_a_level_bench(self) -> Width:
        """The same comparison, were the level of the bench known exactly."""
        budget = replace(self.budget, level=0.0)
        return replace(self, budget=budget, u_deg=K * budget.std)

    @property
    def text(self) -> str:
        """Which term is the largest, and what would make it smaller."""
        std = getattr(self.budget, self.budget.largest)
        what = {"noise": "reading noise", "setting": "one setting of the bench", "zero": "the zero of the clamping"}
        term = what.get(self.budget.largest, f"the bench's level ({self.level.text})")
        return (
            f"U of {self.name} at pose {self.pose} is {self.u_deg:.3g} deg (limit {self.limit_deg:g}), most of it by"
            f" {term}: {std:.2g} deg, 1 sigma. {self.remedy}"
        )

    @property
    def remedy(self) -> str:
        """For the largest term."""
        more = "Set poses also with the table turned the other way (inclination -I, toolface + 180)"
        match self.budget.largest:
            case "noise":
                return "Average longer."
            case "setting":
                return "State how well the bench sets a pose (pose_sigma_deg), or use a better bench."
            case "zero":
                return "Let the zero of the clamping be estimated (free_toolface_zero), or state it better."
            case _ if self.level is LevelSource.STATED:
                return f"{more}, state how level the bench is (tilt_sigma_deg), or same_bench: as the record found it."
            case _:
                return f"{more}, more of them where there are some."


def narrowest(
    settings_deg: Sequence[tuple[str, float, float]],
    *,
    limit_inc_deg: float,
    limit_tf_deg: float,
    bench: BenchAccuracy,
    noise_g: float,
    tilt: BenchLevel | None = None,
    toolface_zero_std_deg: float = 0.0,
) -> Width:
    """How wide the comparison will be at poses (name, inclination, toolface) that are only planned, with means of a
    standard error of `noise_g`: the one whose U takes the largest share of its limit."""
    inc, tf = (np.deg2rad([pose[k] for pose in settings_deg]) for k in (1, 2))
    sine = np.maximum(np.abs(np.sin(inc)), math.sin(VERTICAL_RAD))
    noise = np.full_like(inc, noise_g), noise_g / sine
    poses = compared(inc, tf, noise, bench.pose_rad, None)
    level = best_level(poses, tilt or BenchLevel.stated(bench.tilt_rad))
    found = budgets(poses, noise, bench.pose_rad, level, math.radians(toolface_zero_std_deg))
    widths = [
        Width(name, pose[0], K * budget.std, limit, budget, level.source)
        for name, which, limit in (("I", found[0], limit_inc_deg), ("T", found[1], limit_tf_deg))
        for pose, budget, counts in zip(settings_deg, which, poses.usable()[name == "T"], strict=True)
        if counts
    ]
    return max(widths, key=lambda width: width.share)


def compared(
    inc_set: Array, tf_set: Array, noise: tuple[Array, Array], pose_rad: float, errors: tuple[Array, Array] | None
) -> ReferenceComparison:
    """The poses as the level of the bench is estimated from them."""
    inc_error, tf_error = (None, None) if errors is None else errors
    return ReferenceComparison(
        inc_set, tf_set, np.hypot(noise[0], pose_rad), np.hypot(noise[1], pose_rad), inc_error, tf_error
    )


def budgets(
    poses: ReferenceComparison, noise: tuple[Array, Array], pose_rad: float, level: BenchLevel, zero_std_rad: float
) -> tuple[list[ComparisonBudget], list[ComparisonBudget]]:
    """What the uncertainties of I and of T at each pose are made of, deg."""
    sine = np.abs(np.sin(poses.inc_set))
    across = level.y_std_rad / np.where(sine > math.sin(VERTICAL_RAD), sine, 1.0)
    setting, zero = math.degrees(pose_rad), math.degrees(zero_std_rad)
    inc = [ComparisonBudget(one, setting, math.degrees(level.x_std_rad)) for one in np.rad2deg(noise[0]).tolist()]
    both = zip(np.rad2deg(noise[1]).tolist(), np.rad2deg(across).tolist(), strict=True)
    return inc, [ComparisonBudget(one, setting, leaning, zero) for one, leaning in both]
