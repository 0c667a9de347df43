"""Scatter above what readings repeat to is a finding: noise learned from a misfit may not explain that misfit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.core.floor import NoiseFloor, excess, floor_of_means, lattice_step
from highside.diagnosis.core.method import WHOLE
from highside.diagnosis.engine import diagnose_magnitudes, diagnose_poses
from highside.diagnosis.magnitude.session import magnitude_session
from highside.diagnosis.poses.session import pose_session
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

FREE = ("bias", "scale", "misalignment")
ROWS = 40
SIGMA_G = 2e-4
"""of a row"""


def intervals(count: int, rows: int) -> list[np.ndarray]:
    return [np.arange(k * rows, (k + 1) * rows) for k in range(count)]


def recorded(inc_deg: Array, tf_deg: Array, mean: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Rows (N,) of stops with white noise about `mean` (3, n)."""
    n = inc_deg.size
    every = np.repeat(np.arange(n), ROWS)
    rows = mean[:, every] + SIGMA_G * rng.standard_normal((3, every.size))
    return {
        "t_s": 0.1 * np.arange(every.size),
        "ax_g": rows[0],
        "ay_g": rows[1],
        "az_g": rows[2],
        "inc_ref_deg": inc_deg[every],
        "tf_ref_deg": tf_deg[every],
        "pose": every.astype(float),
    }


def accel(columns: dict[str, Array]) -> Array:
    return np.stack([columns["ax_g"], columns["ay_g"], columns["az_g"]])


def sixteen() -> tuple[Array, Array, Array]:
    """Sixteen stops all over the sphere, and gravity there."""
    inc, tf = np.tile([30.0, 75.0, 110.0, 150.0], 4), np.repeat([10.0, 100.0, 190.0, 280.0], 4)
    return inc, tf, np.asarray(gravity_direction(np.radians(inc), np.radians(tf)), dtype=float)


def test_a_spike_or_a_jump_in_one_interval_makes_its_own_mean_uncertain_and_no_other() -> None:
    rng = np.random.default_rng(5)
    rows, channel = intervals(12, 3), 1e-4 * rng.standard_normal((1, 36))
    plain = floor_of_means(channel, rows)
    channel[0, 15] += 8e-3
    spiked = floor_of_means(channel, rows)
    assert plain is not None and spiked is not None
    others = np.arange(12) != 5
    assert np.all(spiked.sigma[0, others] < 1.5 * plain.sigma[0, others])
    # the spike moves the mean by a third of itself
    assert 8e-3 / 3 < 2 * spiked.sigma[0, 5] < 4 * 8e-3 / 3


@pytest.mark.parametrize("rows", [2, 3, 8, 40])
def test_of_white_rows_no_interval_is_louder_than_the_others(rows: int) -> None:
    """One session in ten thousand by the threshold: of 300 more than two are none of chance (p = 4e-6)."""
    rng = np.random.default_rng(6)
    unlike = 0
    for _ in range(300):
        floor = floor_of_means(rng.standard_normal((1, 20 * rows)), intervals(20, rows))
        assert floor is not None
        unlike += bool(np.ptp(floor.sigma) > 0.0)
    assert unlike <= 2


def test_white_rows_repeat_to_their_root_and_correlated_ones_to_less() -> None:
    rng = np.random.default_rng(1)
    white = rng.standard_normal((1, 40 * 64))
    rows = intervals(40, 64)
    floor = floor_of_means(white, rows)
    assert floor is not None
    assert floor.sigma[0, 0] == pytest.approx(1 / 8, rel=0.15)
    slow = np.convolve(white[0], np.ones(8), mode="same")[None]
    correlated = floor_of_means(slow, rows)
    means = np.array([slow[0, r].mean() for r in rows])
    assert correlated is not None
    assert correlated.sigma[0, 0] == pytest.approx(float(means.std()), rel=0.35)


def test_a_drift_within_the_intervals_does_not_raise_the_floor_much() -> None:
    rng = np.random.default_rng(2)
    rows = intervals(30, 64)
    drifting = rng.standard_normal((1, 30 * 64)) + np.tile(np.linspace(0, 2, 64), 30)
    floor = floor_of_means(drifting, rows)
    assert floor is not None and floor.sigma[0, 0] < 1.6 / 8


def test_readings_without_dither_are_no_better_than_their_lattice() -> None:
    rng = np.random.default_rng(3)
    coarse = np.round((0.3 * np.arange(20).repeat(50) + 0.01 * rng.standard_normal(1000))[None])
    assert lattice_step(coarse[0]) == 1.0 and lattice_step(rng.standard_normal(100)) == 0.0
    floor = floor_of_means(coarse, intervals(20, 50))
    assert floor is not None and floor.sigma.min() > 0.28


def test_what_is_above_the_floor_is_reported_in_units_of_it() -> None:
    rng = np.random.default_rng(4)
    floor = NoiseFloor(np.full((3, 60), 1e-5), 1e3)
    columns = rng.standard_normal((6, 3, 60))
    noise = 1e-5 * rng.standard_normal((3, 60))
    assert not excess(noise, columns, floor).above(1.3)
    found = excess(5 * noise, columns, floor)
    assert found.above(1.3) and found.ratio == pytest.approx(5.0, rel=0.15)


@pytest.mark.parametrize("seed", [1, 2, pytest.param(3, marks=FURTHER)])
def test_few_poses_with_a_quadratic_and_a_step_are_not_explained(seed: int) -> None:
    """Half of the readings go into what might be systematic; the noise learned from the rest hid both."""
    rng = np.random.default_rng(seed)
    inc, tf, gravity = sixteen()
    mean_sigma = SIGMA_G / np.sqrt(ROWS)
    missing = np.zeros_like(gravity)
    missing[0] = gravity[0] ** 2 - np.mean(gravity[0] ** 2)
    missing[0] *= mean_sigma * np.sqrt(200) / np.linalg.norm(missing[0])
    missing[1, 9:] = 2 * mean_sigma * np.sqrt(200) / np.sqrt(16)
    columns = recorded(inc, tf, gravity + missing, rng)
    found, _ = diagnose_poses(pose_session(columns, accel(columns), gravity_mps2=9.80665), ForwardModel.of({}), FREE)
    assert found.verdict != "nothing_left_out"
    if found.verdict == "unknown":
        assert "disagree" in " ".join(found.remainder.hints) or found.remainder.p < 0.01


@pytest.mark.parametrize("seed", [1, 2, pytest.param(3, marks=FURTHER)])
def test_few_poses_without_a_mismatch_are_explained(seed: int) -> None:
    inc, tf, gravity = sixteen()
    columns = recorded(inc, tf, gravity, np.random.default_rng(seed))
    session = pose_session(columns, accel(columns), gravity_mps2=9.80665)
    found, _ = diagnose_poses(session, ForwardModel.of({}), FREE)
    assert found.verdict == "nothing_left_out"
    assert found.coverage is not None
    assert (found.coverage.intervals_used, found.coverage.intervals_expected) == (16, 16)
    assert 0 < found.coverage.effects_tested < found.coverage.effects_known


def test_errors_of_the_set_angles_are_identified_as_noise() -> None:
    """They act across gravity and leave its magnitude alone."""
    rng = np.random.default_rng(5)
    inc = np.tile(np.arange(15.0, 166.0, 25.0), 12)
    tf = np.repeat(np.arange(0.0, 360.0, 30.0), 7) + 3.0
    off = rng.normal(0.0, 0.03, (2, inc.size))
    mean = np.asarray(gravity_direction(np.radians(inc + off[0]), np.radians(tf + off[1])), dtype=float)
    columns = recorded(inc, tf, mean, rng)
    session = pose_session(columns, accel(columns), gravity_mps2=9.80665)
    found, _ = diagnose_poses(session, ForwardModel.of({}), FREE)
    assert found.verdict == "nothing_left_out"
    assert "taken for errors of the set angles" in found.remainder.hints[0]


@pytest.mark.parametrize("seed", range(4))
def test_a_tool_that_sits_a_little_differently_each_time_is_told_so_near_the_vertical_too(seed: int) -> None:
    """Its level errs to all sides alike: nearly upright by as much as at any inclination, where a toolface does not."""
    rng = np.random.default_rng(seed)
    inc, tf = np.repeat([0.6, 6.0, 20.0, 45.0, 70.0, 90.0], 18), np.tile(np.arange(0.0, 360.0, 20.0), 6)
    gravity = np.asarray(gravity_direction(np.radians(inc), np.radians(tf)), dtype=float)
    size = 3e-4
    mean = gravity + np.cross(rng.normal(0.0, size, (inc.size, 3)), gravity.T).T
    columns = recorded(inc, tf, mean, rng)
    session = pose_session(columns, accel(columns), gravity_mps2=9.80665)
    found, _ = diagnose_poses(session, ForwardModel.of({}), FREE, method=replace(WHOLE, laws=False))
    assert found.verdict == "nothing_left_out"
    (hint,) = (one for one in found.remainder.hints if "errors of the set angles" in one)
    assert "deg across the plane of the tilt" in hint
    # half of what the readings can show is taken by what could be systematic, and two of the three ways are alike
    assert found.noise["bench_across_rad"] > max(size / 3, found.noise["bench_toolface_rad"])
    assert found.noise["bench_inclination_rad"] == pytest.approx(size, rel=0.25)


def test_a_name_that_leaves_all_to_errors_of_the_set_angles_in_few_poses_is_not_told() -> None:
    """A step of one axis beside toolfaces that are off by 0.25 deg, or follow something by as much: it explains 1 %."""
    rng = np.random.default_rng(0)
    inc, tf = rng.uniform(10, 100, 20), rng.uniform(0, 360, 20)
    mean = np.asarray(gravity_direction(np.radians(inc), np.radians(tf + rng.normal(0, 0.25, 20))), dtype=float)
    mean[2, 10:] += 4e-4
    columns = recorded(inc, tf, mean, rng)
    found, _ = diagnose_poses(pose_session(columns, accel(columns), gravity_mps2=9.80665), ForwardModel.of({}), FREE)
    assert (found.verdict, found.claims) == ("not_testable", ())
    assert "bias_step" in found.remainder.resembles
    assert "deg of toolface; in 20 poses these cannot be distinguished from" in found.remainder.hints[0]


@pytest.mark.parametrize("step_g", [1e-3, 5e-3])
def test_a_step_in_a_session_by_hand_is_not_taken_for_noise(step_g: float) -> None:
    """22 attitudes, one axis reads more from the middle on: the magnitudes disagree more than they repeat."""
    rng = np.random.default_rng(6)
    n = 22
    inc = np.degrees(np.arccos(np.linspace(0.95, -0.95, n)))
    tf = (137.5 * np.arange(n)) % 360.0
    order = rng.permutation(n)
    gravity = np.asarray(gravity_direction(np.radians(inc[order]), np.radians(tf[order])), dtype=float)
    for missing, nothing in ((0.0, True), (step_g, False)):
        mean = gravity + missing * np.outer([1.0, -0.5, 0.7], np.arange(n) >= n // 2)
        columns = recorded(inc[order], tf[order], mean, np.random.default_rng(7))
        columns = {name: columns[name] for name in ("t_s", "ax_g", "ay_g", "az_g", "pose")}
        session = magnitude_session(columns, accel(columns), gravity_mps2=9.80665)
        assert not isinstance(session, str) and not session.rest
        found, _ = diagnose_magnitudes(session, ForwardModel.of({}), FREE)
        assert (found.verdict == "nothing_left_out") is nothing, found.remainder.hints


def test_states_of_a_pose_session_have_their_floor() -> None:
    inc, tf, gravity = sixteen()
    columns = recorded(inc, tf, gravity, np.random.default_rng(8))
    session = pose_session(columns, accel(columns), gravity_mps2=9.80665)
    assert isinstance(session.state, ChainState) and session.floor is not None
    assert session.floor.sigma == pytest.approx(SIGMA_G / np.sqrt(ROWS), rel=0.15)
