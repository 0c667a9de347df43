"""Verifications by the hundred, against tools and benches whose truth is known: who passes, and who must not.

Each session has its own bench (tilts of 0.05 deg, one standard deviation, each), its own errors of setting and noise,
and its own calibration, made on another bench. Gates are counts that a binomial of the rate asked for exceeds with a
probability of 1e-4 (so often does a test fail although the rate holds; the seeds are fixed).
"""

from __future__ import annotations

import functools
import math
import os
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import beta, binom, chi2

from highside.attitude.angles import difference
from highside.bench.session.plans import Limits
from highside.bench.setup import _plan
from highside.calibration.bench_level import LevelSource
from highside.calibration.comparison import attitudes_set
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord, Environment, SolveRequest, build_record, solve_poses
from highside.calibration.verification import Conformity, Verification, indicated, verify_poses
from highside.config.bench import VerificationPlan
from highside.physics.gravity import bench_gravity, gravity_direction

pytestmark = pytest.mark.slow

SESSIONS = int(os.environ.get("HIGHSIDE_VERIFICATIONS", "40"))
"""a case; the figures of docs/evidence.md are of 300"""
GATE_P = 1e-4
LIMITS = {"limit_inc_deg": 0.1, "limit_tf_deg": 1.0}
"""what README and config/bench.toml suggest"""
POSE_DEG, TILT_DEG, NOISE_G = 0.0052, 0.05, 15e-6
PLAN = _plan(VerificationPlan(kind="verification", **LIMITS), Limits())
INCLINATIONS = [0.612, 1.206, 1.998, 3.006, 5.004, 14.994, 30.006, 45.0, 59.994, 75.006, 90.0]
TOOLFACES = (45.0, 135.0, 225.0, 315.0)
POSE_SETS = {
    "plan": np.array([(pose.inc_deg, pose.tf_deg) for pose in PLAN.poses]).T,
    "both sides": np.array([(inc, tf) for inc in [-5.004, -45.0, *INCLINATIONS] for tf in TOOLFACES]).T,
    "one side": np.array([(inc, tf) for inc in INCLINATIONS[4:] for tf in TOOLFACES]).T,
}
DECIDED = ("plan", "both sides")
"""pose sets with reversed poses"""
WELL_LEVELLED_DEG = 0.02
"""stated of a bench for which one side is enough"""
SENSOR = np.array([[0.9991, 0.0038, -0.0007], [-0.0019, 0.9989, 0.0001], [0.0009, 0.0003, 0.9982]])
OFFSET_G = np.array([1.2e-3, -0.8e-3, 1.5e-3])

Changed = Callable[[np.ndarray], np.ndarray]


def as_it_was(g: np.ndarray) -> np.ndarray:
    return g


def on_a_bench(
    inc: np.ndarray,
    tf: np.ndarray,
    rng: np.random.Generator,
    changed: Changed = as_it_was,
    tilt_deg: float = TILT_DEG,
) -> np.ndarray:
    """Raw means (3, N) at settings in degrees of a bench of its own; `changed`: what the tool makes of gravity now,
    beyond its calibration."""
    tilt = np.deg2rad(tilt_deg * rng.standard_normal(2))
    set_inc, set_tf = (np.deg2rad(angle + POSE_DEG * rng.standard_normal(angle.size)) for angle in (inc, tf))
    g = changed(bench_gravity(set_inc, set_tf, *tilt))
    return SENSOR @ g + OFFSET_G[:, None] + NOISE_G * rng.standard_normal(g.shape)


@functools.cache
def calibrations() -> tuple[CalibrationRecord, ...]:
    out = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 1])
        inc, tf = np.repeat([-90.0, -45.0, -5.0, 5.0, 45.0, 90.0, 120.0], 4), np.tile([45.0, 135.0, 225.0, 315.0], 7)
        m = on_a_bench(inc, tf, rng)
        table = {"inc_ref_deg": inc.tolist(), "tf_ref_deg": tf.tolist(), "n": [100.0] * inc.size}
        table |= {name: row.tolist() for name, row in zip(("ax", "ay", "az"), m, strict=True)}
        table |= {f"std_a{axis}": [10 * NOISE_G] * inc.size for axis in "xyz"}
        request = SolveRequest("joint")
        found = solve_poses(table, request)
        out.append(
            build_record(
                tool_id="t", serial=None, request=request, result=found.result, fallback=found.fallback,
                guide=found.guide, pose_columns=table, raw_sha256="0" * 64, raw_name="poses.csv",
                environment=Environment(), now_s=1.8e9,
            )
        )  # fmt: skip
    return tuple(out)


def session(which: str, seed: int, changed: Changed = as_it_was, tilt_deg: float = TILT_DEG) -> Verification:
    rng = np.random.default_rng([seed, 2])
    inc, tf = POSE_SETS[which]
    poses = PoseSet.build(
        on_a_bench(inc, tf, rng, changed, tilt_deg), inc_ref_rad=np.deg2rad(inc), tf_ref_rad=np.deg2rad(tf),
        n=np.full(inc.size, 100.0), std=10 * NOISE_G,
    )  # fmt: skip
    record = calibrations()[seed % len(calibrations())]
    bench = BenchAccuracy(math.radians(tilt_deg), math.radians(POSE_DEG))
    return verify_poses(record, poses, bench=bench, **LIMITS)


def error_of_limit(which: str, record: CalibrationRecord, changed: Changed) -> float:
    """The largest true error at the poses, of I or T, without bench errors and noise, in units of its limit."""
    inc, tf = np.deg2rad(POSE_SETS[which])
    raw = SENSOR @ changed(gravity_direction(inc, tf)) + OFFSET_G[:, None]
    poses = PoseSet.build(raw, inc_ref_rad=inc, tf_ref_rad=tf, n=np.full(inc.size, 100.0), std=1e-9)
    found = indicated(record, poses)
    ref_inc, ref_tf = attitudes_set(inc, tf)
    i_error, t_error = np.rad2deg(found.inc - ref_inc), np.rad2deg(difference(found.tf, ref_tf))
    return float(max(np.abs(i_error).max() / LIMITS["limit_inc_deg"], np.abs(t_error).max() / LIMITS["limit_tf_deg"]))


def _offset(size: float, direction: np.ndarray) -> Changed:
    return lambda g: g + size * direction[:, None]


def _axes(size: float, direction: np.ndarray) -> Changed:
    """Scales and axes: a matrix that depends on the direction alone."""
    matrix = np.outer(direction, np.roll(direction, 1)) + np.diag(np.roll(direction, 2))
    return lambda g: g + size * matrix @ g


def _cubic(size: float, direction: np.ndarray) -> Changed:
    return lambda g: g + size * direction[:, None] * g**3


def _leaning(size: float, direction: np.ndarray) -> Changed:
    """The tool shows I wrong by the same amount everywhere: what a leaning bench looks like from one side."""

    def changed(g: np.ndarray) -> np.ndarray:
        inc, tf = np.arctan2(np.hypot(g[0], g[1]), g[2]), np.arctan2(g[1], g[0])
        return gravity_direction(inc + size, tf)

    return changed


KINDS = {"offset": _offset, "scales and axes": _axes, "cubic": _cubic, "I everywhere": _leaning}


def out_by(factor: float, which: str, kind: str, seed: int) -> Changed:
    """A change of the tool after which its largest error is `factor` times its limit."""
    rng = np.random.default_rng([seed, 3])
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    record = calibrations()[seed % len(calibrations())]
    size = 1e-3
    for _ in range(6):
        # but for the calibration's own error it is proportional
        size *= factor / error_of_limit(which, record, KINDS[kind](size, direction))
    return KINDS[kind](size, direction)


def reported(name: str, count: int, total: int) -> str:
    low = beta.ppf(0.025, count, total - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, total - count) if count < total else 1.0
    return f"{name}: {count} of {total} ({100 * low:.2f} to {100 * high:.2f} %)"


def passing(which: str, sessions: int, kind: str | None = None, factor: float = 1.0, tilt_deg: float = TILT_DEG) -> int:
    """How many of so many tools pass, changed by `kind` to `factor` of a limit."""
    found = [
        session(which, seed, as_it_was if kind is None else out_by(factor, which, kind, seed), tilt_deg).verdict
        for seed in range(sessions)
    ]
    passed = sum(verdict is Conformity.PASS for verdict in found)
    what = "good tools" if kind is None else f"tools out by {factor:g} of a limit, {kind}"
    print(reported(f"{what}, {which}, level to {tilt_deg:g} deg: pass", passed, sessions), dict(Counter(found)))
    return passed


def at_most(share: float, sessions: int) -> int:
    return int(binom.ppf(1.0 - GATE_P, sessions, share))


@pytest.mark.parametrize("which", DECIDED)
def test_good_tools_pass(which: str) -> None:
    assert SESSIONS - passing(which, SESSIONS) <= at_most(0.02, SESSIONS)
    found = [session(which, seed) for seed in range(SESSIONS)]
    assert not any(one.verdict is Conformity.FAIL for one in found)
    assert all(one.level.source is LevelSource.REVERSED for one in found)


@pytest.mark.parametrize("which", DECIDED)
def test_the_level_that_the_poses_tell_is_the_benchs(which: str) -> None:
    """Normalised errors of the tilts, over benches that lean by chance: their mean square is one."""
    squares = []
    for seed in range(SESSIONS):
        rng = np.random.default_rng([seed, 2])
        true = np.deg2rad(TILT_DEG * rng.standard_normal(2))
        level = session(which, seed).level
        squares += [
            ((level.x_rad - true[0]) / level.x_std_rad) ** 2,
            ((level.y_rad - true[1]) / level.y_std_rad) ** 2,
        ]
    # Birge's ratio only widens: below one is allowed, but not far; right ones are above the bound once in a thousand
    assert 0.5 < np.mean(squares) < chi2.ppf(0.999, len(squares)) / len(squares), np.mean(squares)


@pytest.mark.parametrize("factor", [1.0, 1.5])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("which", POSE_SETS)
def test_tools_that_are_out_do_not_pass(which: str, kind: str, factor: float) -> None:
    """At the limit itself one of 44 may pass by mistake (k = 2); beyond it none worth a count."""
    assert passing(which, SESSIONS, kind, factor) <= at_most(0.025, SESSIONS)


def test_from_one_side_nothing_is_decided_by_a_bench_that_may_lean_as_much_as_the_limit() -> None:
    """Neither "pass" nor "fail" for good tools, and the way out is said. By the pattern of 24 poses a constant error of
    I within three sigma of the stated tilt was taken for the bench's: every second tool passed that was out by 1.5."""
    found = [session("one side", seed) for seed in range(SESSIONS)]
    assert {one.verdict for one in found} == {Conformity.UNDECIDED}
    for one in found:
        assert "Set poses also with the table turned the other way" in one.text, one.text


@pytest.mark.parametrize("kind", [None, *KINDS])
def test_a_bench_that_is_said_to_be_well_levelled_is_enough_from_one_side(kind: str | None) -> None:
    if kind is None:
        # at 5 deg of inclination U of T is 0.47 of the limit of 1 by the level alone: 14 of 300 are undecided by that
        passed = passing("one side", SESSIONS, tilt_deg=WELL_LEVELLED_DEG)
        assert SESSIONS - passed <= at_most(0.07, SESSIONS)
        return
    for factor in (1.0, 1.5):
        assert passing("one side", SESSIONS, kind, factor, WELL_LEVELLED_DEG) <= at_most(0.025, SESSIONS)
