"""Equations (7) to (12) to the letter: what the algebra promises, and where the method fails."""

from __future__ import annotations

import numpy as np
import pytest

from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import from_rotation_vector, multiply, up_direction
from highside.gyro.frames import DEG_PER_HOUR, EARTH_RATE_RADPS, to_body
from highside.gyro.literal import AzimuthPolicy, Literal, Quaternion, aligned, gravity_quaternion, literal
from highside.gyro.result import AzimuthBasis, DriftResult
from highside.papers.drift_scenarios import (
    DriftData,
    Triad,
    curved_hole,
    record,
    rotating_table,
    turntable,
    vibration_table,
)

PSI0 = np.radians(60.0)


def _run(data: DriftData, policy: AzimuthPolicy, *, average: bool = False) -> DriftResult:
    return literal(
        data.experiment.t_s, data.rate, data.accel, policy=policy, azimuth_rad=PSI0, average=average, start_s=10.0
    )


def _azimuth_error_deg(result: DriftResult, data: DriftData) -> np.ndarray:
    return np.degrees(wrap_signed(result.azi_rad - data.experiment.psi))


def _floats(q: np.ndarray) -> Quaternion:
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


@pytest.mark.parametrize("policy", list(AzimuthPolicy))
def test_one_step_replaces_the_attitude_by_that_of_gravity(policy: AzimuthPolicy) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = _floats(multiply(np.array(aligned(rng.standard_normal(3), 1.0)), np.array([1.0, 0.0, 0.0, 0.0])))
        g = up_direction(np.array(q)) + 2e-3 * rng.standard_normal(3)
        g /= np.linalg.norm(g)
        if abs(g[1]) > 0.99:
            continue
        engine = Literal(policy, q)
        engine.update(0.01, (1e-3, -2e-3, 5e-4), _vector(g), True)
        gyro = multiply(np.array(q), from_rotation_vector(0.01 * np.array([1e-3, -2e-3, 5e-4])))
        q_a = np.array(gravity_quaternion(policy, q, _floats(gyro), _vector(g)))
        delta = float(np.linalg.norm(gyro - q_a))
        assert np.linalg.norm(np.array(engine.q) - q_a) <= 2 * delta**2


def _vector(v: np.ndarray) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def test_with_the_gyro_policy_the_drift_estimate_has_no_part_along_up() -> None:
    data = record(turntable(5.0), 1)
    engine = Literal(AzimuthPolicy.GYRO, aligned(to_body(data.accel)[:, 0], PSI0))
    for w, a in zip(to_body(data.rate).T, to_body(data.accel).T, strict=True):
        before = up_direction(np.array(engine.q))
        engine.update(0.01, _vector(w), _vector(a), True)
        level = float(np.linalg.norm(engine.drift))
        assert abs(np.array(engine.drift) @ before) < 2e-2 * level


def test_the_drift_estimate_is_the_accelerometer_noise_differentiated() -> None:
    data = record(turntable(60.0), 2)
    drift = to_body(_run(data, AzimuthPolicy.GYRO).bias_radps)[:, 100:]
    # in the plane across Up there are two axes; x and z of the body lie almost in it
    spread = np.sqrt((drift.var(axis=1)).sum() / 2)
    assert spread / DEG_PER_HOUR == pytest.approx(np.sqrt(2) * 1e-3 / 0.01 / DEG_PER_HOUR, rel=0.2)


def test_at_rest_the_gyro_policy_drifts_by_the_rate_along_up_and_hold_not_at_all() -> None:
    experiment = turntable(600.0, 50.0)
    data = record(experiment, 3)
    e = experiment
    up = np.array([-np.sin(e.phi[0]) * np.cos(e.theta[0]), np.sin(e.theta[0]), np.cos(e.phi[0]) * np.cos(e.theta[0])])
    bias = np.array(e.triad.bias_dph)
    earth = EARTH_RATE_RADPS / DEG_PER_HOUR * np.sin(e.latitude_rad)
    expected = -(bias @ up + earth)
    free = _azimuth_error_deg(_run(data, AzimuthPolicy.GYRO), data)[-500:].mean() / e.hours
    # the angle random walk adds N / sqrt(t) of its own: 0.25 deg/h after ten minutes
    assert free == pytest.approx(expected, rel=0.05, abs=0.6)
    held = _azimuth_error_deg(_run(data, AzimuthPolicy.HOLD), data)
    assert abs(held[-500:].mean()) / e.hours < 0.01


def test_prev_is_wrong_by_any_angle_when_the_tool_turns() -> None:
    data = record(rotating_table(30.0, 300.0, 50.0), 1)
    assert np.abs(_azimuth_error_deg(_run(data, AzimuthPolicy.PREV), data)).max() > 20.0
    assert np.abs(_azimuth_error_deg(_run(data, AzimuthPolicy.HOLD), data)[-500:]).max() < 1.0


@pytest.mark.parametrize("policy", [AzimuthPolicy.PREV, AzimuthPolicy.HOLD])
def test_a_curved_hole_is_reported_as_straight_and_the_basis_says_so(policy: AzimuthPolicy) -> None:
    data = record(curved_hole(rate_hz=50.0), 1)
    result = _run(data, policy)
    assert abs(_azimuth_error_deg(result, data)[-500:].mean()) > 4.5
    assert result.basis == (AzimuthBasis.CONSTRAINT,)


def test_under_vibration_the_method_fails() -> None:
    data = record(vibration_table(120.0), 1)
    errors = _azimuth_error_deg(_run(data, AzimuthPolicy.HOLD), data)
    assert np.abs(errors).max() > 30.0


def test_averaging_over_a_stop_gives_a_usable_bias() -> None:
    quiet_gyro = Triad((10.0, -4.0, 6.0), arw_deg_sqrt_h=0.01, rrw_dph_sqrt_h=0.0)
    data = record(turntable(300.0, triad=quiet_gyro), 4)
    drift = to_body(_run(data, AzimuthPolicy.HOLD, average=True).bias_radps)[:, -1] / DEG_PER_HOUR
    one = to_body(_run(data, AzimuthPolicy.HOLD).bias_radps)[:, -1] / DEG_PER_HOUR
    lumped = np.array(quiet_gyro.bias_dph) + 0.0
    # bias and Earth rate together, at most 15 deg/h apart; a single step is wrong by thousands
    assert np.linalg.norm(drift - lumped) < 16.0
    assert np.linalg.norm(one - lumped) > 1000.0
