"""An oven cycle: orders by evidence, hysteresis reported, growing uncertainty outside of what was visited."""

from __future__ import annotations

import json

import numpy as np
import pytest

from highside.arrays import Array
from highside.calibration.magnitude import magnitude
from highside.calibration.poses import PoseSet
from highside.calibration.remark import CalibrationRefused, Reason
from highside.calibration.result import CalibrationResult
from highside.calibration.temperature import joint_over_temperature, legs
from highside.errors import InputError
from highside.physics.gravity import bench_gravity, gravity_direction
from highside.physics.plan import BALANCE_TOOLFACES_DEG, pose_grid

CYCLE_C = (25.0, 75.0, 125.0, 150.0, 125.0, 75.0, 25.0)
REF_C, HALF_C = 87.5, 62.5


class Oven:
    """An instrument whose offset is quadratic and whose matrix is linear in temperature, and its session in an oven."""

    def __init__(self, seed: int, *, bend_g: float = 1e-3, hysteresis_g: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self.A = np.eye(3) + rng.uniform(-5e-3, 5e-3, (3, 3))
        self.A1 = np.diag(rng.uniform(1e-3, 3e-3, 3))
        self.b = rng.uniform(-2e-3, 2e-3, 3)
        self.b1 = rng.uniform(1e-3, 3e-3, 3)
        self.b2 = bend_g * np.array([1.0, -0.7, 0.5])
        self.loop = hysteresis_g * np.array([1.0, 0.0, 0.0])
        self.tilt = rng.uniform(-5e-4, 5e-4, 2)
        self.rng = rng

    def read(self, w: Array, temp_c: float, leg: float = 0.0) -> Array:
        u = (temp_c - REF_C) / HALF_C
        return (self.A + self.A1 * u) @ w + (self.b + self.b1 * u + self.b2 * u * u + 0.5 * leg * self.loop)[:, None]

    def session(self, cycle: tuple[float, ...] = CYCLE_C) -> PoseSet:
        inc, tf = pose_grid([5.0, 45.0, 90.0], BALANCE_TOOLFACES_DEG)
        inc, tf = np.append(inc, 2.1), np.append(tf, 0.3)
        top = int(np.argmax(cycle))
        means = []
        for k, temp in enumerate(cycle):
            jitter = np.deg2rad(0.009)
            w = bench_gravity(
                inc + self.rng.uniform(-jitter, jitter, 13), tf + self.rng.uniform(-jitter, jitter, 13), *self.tilt
            )
            means.append(self.read(w, temp, 1.0 if k <= top else -1.0) + 11e-6 * self.rng.standard_normal(w.shape))
        return PoseSet.build(
            np.hstack(means),
            inc_ref_rad=np.tile(inc, len(cycle)),
            tf_ref_rad=np.tile(tf, len(cycle)),
            temp_c=np.repeat(cycle, 13),
            n=10,
            std=35e-6,
        )


def pulls(result: CalibrationResult, oven: Oven, temp_c: float) -> Array:
    """Error of a corrected vector at a temperature in stated standard deviations (3,)."""
    g = gravity_direction(np.array([0.6]), np.array([1.0]))
    error = (result.correct(oven.read(g, temp_c), temp_c) - g)[:, 0]
    return np.asarray(error / np.sqrt(np.diag(result.covariance_of(g[:, 0], temp_c))))


def test_the_orders_that_are_there_are_found() -> None:
    linear = joint_over_temperature(Oven(1, bend_g=0.0).session())
    assert (linear.options["offset_order"], linear.options["matrix_order"]) == (1.0, 1.0)
    bent = joint_over_temperature(Oven(1).session())
    assert (bent.options["offset_order"], bent.options["matrix_order"]) == (2.0, 1.0)
    assert not bent.remarks


def test_readings_at_temperatures_between_are_corrected_within_the_stated_uncertainty() -> None:
    values = []
    for seed in range(20):
        oven = Oven(seed)
        result = joint_over_temperature(oven.session())
        values.append([pulls(result, oven, temp) for temp in (30.0, 60.0, 100.0, 145.0)])
    spread = np.sqrt(np.mean(np.square(values)))
    assert 0.6 < spread < 1.25
    # without temperature in the model the same readings are out by mg
    plain = oven.read(gravity_direction(np.array([0.6]), np.array([1.0])), 145.0) - oven.read(
        gravity_direction(np.array([0.6]), np.array([1.0])), 60.0
    )
    assert np.abs(plain).max() > 1e-3


def test_hysteresis_is_reported_and_enters_the_uncertainty() -> None:
    without, with_loop = (joint_over_temperature(Oven(3, hysteresis_g=size).session()) for size in (0.0, 300e-6))
    assert [r.reason for r in with_loop.remarks] == [Reason.TEMPERATURE_HYSTERESIS]
    assert with_loop.options["hyst_x"] == pytest.approx(300e-6, abs=4 * float(with_loop.options["hyst_x_std"]))
    assert abs(float(without.options["hyst_x"])) < 4 * float(without.options["hyst_x_std"])
    g = gravity_direction(np.array([0.6]), np.array([1.0]))[:, 0]
    stated = [np.sqrt(result.covariance_of(g, 80.0)[0, 0]) for result in (without, with_loop)]
    assert stated[0] < 30e-6 < 140e-6 < stated[1]
    # the same orders: the loop does not pass for a bend
    assert with_loop.options["offset_order"] == without.options["offset_order"]


def test_outside_of_the_range_the_uncertainty_grows_without_a_jump_of_the_value() -> None:
    oven = Oven(4)
    result = joint_over_temperature(oven.session())
    g = gravity_direction(np.array([0.6]), np.array([1.0]))[:, 0]
    m = oven.read(g[:, None], 150.0)[:, 0]
    stds = [np.sqrt(np.trace(result.covariance_of(g, temp))) for temp in (150.0, 155.0, 165.0, 185.0)]
    assert np.all(np.diff(stds) > 0) and stds[-1] > 10 * stds[0]
    assert np.allclose(result.correct(m, 150.0), result.correct(m, 150.001), atol=1e-7)
    window = result.main.temperature
    assert window is not None and not window.inside(160.0) and window.inside(140.0)
    assert all(np.all(np.abs(pulls(result, oven, temp)) < 4) for temp in (10.0, 160.0, 175.0))


def test_one_temperature_says_that_nothing_is_known_of_others() -> None:
    result = joint_over_temperature(Oven(5).session((25.0,)))
    assert [r.reason for r in result.remarks] == [Reason.TEMPERATURE_SPAN]
    assert " to " not in result.remarks[0].text, "one temperature is no span"
    poses = Oven(5).session((25.0,))
    with pytest.raises(InputError, match="temp_c"):
        joint_over_temperature(PoseSet.build(poses.a, inc_ref_rad=poses.inc_ref_rad, tf_ref_rad=poses.tf_ref_rad))


def test_a_one_way_ramp_has_no_hysteresis_to_report() -> None:
    result = joint_over_temperature(Oven(6).session((25.0, 75.0, 125.0, 150.0)))
    assert "hyst_x" not in result.options
    assert result.options["offset_order"] == 2.0


def test_two_temperatures_bear_a_line_and_no_more() -> None:
    result = joint_over_temperature(Oven(7).session((25.0, 150.0)))
    assert (result.options["offset_order"], result.options["matrix_order"]) == (1.0, 1.0)


def test_legs_follow_the_steps_of_the_oven_and_not_its_flutter() -> None:
    temp = np.array([25.0, 25.6, 24.9, 80.0, 79.2, 80.5, 150.0, 150.2, 80.0, 79.0, 25.0, 25.5])
    assert legs(temp).tolist() == [1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1]
    assert legs(np.full(3, 20.0)).tolist() == [1, 1, 1]


def test_a_result_over_temperature_survives_json_float_by_float() -> None:
    result = joint_over_temperature(Oven(8).session())
    back = CalibrationResult.from_dict(json.loads(json.dumps(result.to_dict())))
    m = Oven(8).read(gravity_direction(np.array([0.6]), np.array([1.0])), 33.3)
    assert np.array_equal(back.correct(m, 33.3), result.correct(m, 33.3))
    assert json.dumps(back.to_dict()) == json.dumps(result.to_dict())


def hand_session(seed: int, count: int, *, quadratic_g: float = 0.0) -> tuple[PoseSet, Array]:
    rng = np.random.default_rng(seed)
    A = np.eye(3) + np.diag(rng.uniform(-0.01, 0.01, 3))
    A[0, 1] = A[1, 0] = 0.004
    w = rng.standard_normal((3, count))
    w /= np.linalg.norm(w, axis=0)
    m = A @ w + np.array([[0.02], [-0.03], [0.01]]) + quadratic_g * w**2 + 100e-6 * rng.standard_normal((3, count))
    return PoseSet.build(m, n=100, std=1e-3), A


def test_magnitude_alone_finds_a_symmetric_matrix_and_the_offset_within_the_stated_uncertainty() -> None:
    values = []
    for seed in range(25):
        poses, A = hand_session(seed, 24)
        result = magnitude(poses, mounting_std_rad=0.0)
        std = np.sqrt(np.diag(result.main.parameters.covariance))
        values.append(np.concatenate([(result.A - A).ravel(), result.b - [0.02, -0.03, 0.01]]) / std[:12])
        assert result.options["admitted"] == "none"
    assert 0.8 < np.sqrt(np.mean(np.square(values))) < 1.25


def test_the_gauge_is_stated_and_the_unseen_rotation_is_in_the_uncertainty() -> None:
    poses, _ = hand_session(1, 24)
    result = magnitude(poses, mounting_std_rad=0.01)
    assert Reason.GAUGE in [r.reason for r in result.remarks]
    assert result.predict_std(np.pi / 2, 1.0, 0.0)[1][0] == pytest.approx(0.01, rel=0.1)


def test_attitudes_that_do_not_cover_the_sphere_are_refused() -> None:
    rng = np.random.default_rng(0)
    w = gravity_direction(rng.uniform(0.0, 0.15, 20), rng.uniform(0.0, 6.0, 20))
    with pytest.raises(CalibrationRefused, match="do not cover the sphere"):
        magnitude(PoseSet.build(w + 1e-4 * rng.standard_normal(w.shape), n=100, std=1e-3))
    with pytest.raises(CalibrationRefused, match="nine unknowns"):
        magnitude(hand_session(0, 8)[0])


def test_a_quadratic_term_is_admitted_only_where_it_is() -> None:
    assert magnitude(hand_session(2, 40)[0]).options["admitted"] == "none"
    assert magnitude(hand_session(2, 40, quadratic_g=3e-3)[0]).options["admitted"] == "quadratic"
