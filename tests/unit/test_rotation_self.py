"""Errors against the rotor angle without an outside reference, held against the truth of simulated chains."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from highside.attitude import attitude_block
from highside.errors import Refused
from highside.physics.gravity import gravity_direction
from highside.physics.rotation_chain import Faults, inclination_toolface_errors
from highside.rotation.bases import fourier_rows
from highside.rotation.self_reference import ErrorPart, GyroDoubt, SelfErrors, self_errors
from highside.rotation.self_turntable import self_turntable

ARCMIN = 10800.0 / math.pi
FAULTS: Faults = [
    ("encoder_first_harmonic", {"c1": 3e-4, "s1": -2e-4}),
    ("encoder_second_harmonic", {"c2": 8e-5, "s2": 5e-5}),
    ("wobble", {"ck": 6e-5, "sk": 3e-5, "dk": -4e-5, "tk": 7e-5, "k": 2.0}),
    ("wobble", {"ck": 2e-5, "sk": 1e-5, "dk": 3e-5, "tk": 1e-5, "k": 3.0}),
]
DOUBT = GyroDoubt(math.radians(5.0 / 3600.0), math.radians(1.0 / 60.0))


@dataclass(frozen=True)
class Run:
    """A package on a faulty rotor; gyros with bias, scale error, misalignment and noise, accelerometers with errors."""

    turns: int = 20
    rpm: float = 20.0
    inc_deg: float = 50.0
    case_dps: float = 0.0
    sway_arcmin: float = 0.0
    """the case sways at the rotor's own rate"""
    misalignment_arcmin: float = 1.0
    bias_dph: float = 5.0
    seed: int = 0


@dataclass(frozen=True)
class Made:
    t_s: np.ndarray
    accel: np.ndarray
    gyro: np.ndarray
    theta: np.ndarray
    true: dict[ErrorPart, tuple[np.ndarray, np.ndarray]]


def made(run: Run) -> Made:
    rng, rate_hz = np.random.default_rng(run.seed), 100.0
    rate = run.rpm * 2.0 * np.pi / 60.0
    t = np.arange(int(run.turns * 60.0 / run.rpm * rate_hz)) / rate_hz
    count = t.size

    def state(t: np.ndarray) -> tuple[np.ndarray, ...]:
        theta, inc = rate * t, np.full_like(t, math.radians(run.inc_deg))
        d_inc, d_tf = inclination_toolface_errors(theta, inc, FAULTS)
        drift = np.radians(run.case_dps * t)
        return (
            theta,
            inc + d_inc + 0.3 * drift,
            theta + d_tf + drift + run.sway_arcmin / ARCMIN * np.sin(theta),
            d_inc,
            d_tf,
        )

    theta, inc, tf, d_inc, d_tf = state(t)
    (_, inc_1, tf_1, _, _), (_, inc_0, tf_0, _, _) = state(t + 1e-5), state(t - 1e-5)
    inc_rate, tf_rate = (inc_1 - inc_0) / 2e-5, (tf_1 - tf_0) / 2e-5
    gyro = np.stack([inc_rate * np.sin(tf), -inc_rate * np.cos(tf), -tf_rate])
    misaligned = run.misalignment_arcmin / ARCMIN * rng.standard_normal(3)
    gyro = (1.0 + 3e-4) * (gyro + np.cross(misaligned, gyro.T).T)
    gyro += math.radians(run.bias_dph / 3600.0) * rng.standard_normal((3, 1))
    gyro += math.radians(0.005 * math.sqrt(rate_hz / 2.0)) * rng.standard_normal((3, count))
    sensor = np.array([[1.0003, 2e-4, 0.0], [0.0, 0.9998, 2e-4], [0.0, 0.0, 1.0]])
    felt = sensor @ gravity_direction(inc, tf) + np.array([[3e-4], [-2e-4], [1e-4]])
    felt_inc, felt_tf = attitude_block(felt)
    own = felt_inc - inc, np.angle(np.exp(1j * (felt_tf - tf)))
    true = {ErrorPart.SENSOR: own, ErrorPart.ROTOR: (d_inc, d_tf), ErrorPart.DECODED: (own[0] + d_inc, own[1] + d_tf)}
    return Made(t, felt + 1e-4 * rng.standard_normal((3, count)), gyro, theta, true)


def harmonics_off(one: Made, part: ErrorPart) -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """By channel: errors of the harmonics' coefficients (arcmin), their stated deviations, amplitude of the truth."""
    curves = self_errors(one.t_s, one.accel, one.gyro, one.theta, part).curves(DOUBT)
    out = {}
    for (name, curve), true in zip(curves.items(), one.true[part], strict=True):
        rows = fourier_rows(one.theta, curve.order)
        exact = np.linalg.lstsq(rows.T, ARCMIN * true, rcond=None)[0]
        std = np.sqrt(np.diag(curve.covariance))
        size = float(np.ptp(true) * ARCMIN / 2.0)
        out[name] = ((curve.parameters - exact)[1:], std[1:], size)
    return out


@pytest.mark.parametrize("part", list(ErrorPart))
def test_all_harmonics_are_found_within_what_is_stated(part: ErrorPart) -> None:
    pulls: list[np.ndarray] = []
    for seed in range(5):
        for off, std, size in harmonics_off(made(Run(seed=seed)), part).values():
            pulls.append(off / std)
            assert np.abs(off[2:]).max() < 0.1 * size
            if part is ErrorPart.DECODED:
                assert np.abs(off).max() < 0.03
    assert 0.5 < float(np.sqrt(np.mean(np.concatenate(pulls) ** 2))) < 1.6


def test_a_case_that_moves_slowly_changes_nothing() -> None:
    for part in ErrorPart:
        for off, _, _ in harmonics_off(made(Run(case_dps=0.02, misalignment_arcmin=0.0, bias_dph=0.0)), part).values():
            assert np.abs(off).max() < 0.1


def test_misaligned_gyros_go_into_the_first_harmonic_of_sensor_and_rotor_alone() -> None:
    bad = made(Run(misalignment_arcmin=20.0, bias_dph=0.0))
    for part in (ErrorPart.SENSOR, ErrorPart.ROTOR):
        off, _std, _ = harmonics_off(bad, part)["inclination"]
        assert np.hypot(*off[:2]) > 3.0
        assert np.abs(off[2:]).max() < 0.1
    off, _, _ = harmonics_off(bad, ErrorPart.DECODED)["inclination"]
    assert np.abs(off).max() < 0.03


def test_a_case_that_sways_with_the_rotor_is_taken_for_an_error_except_by_the_gyros() -> None:
    swaying = made(Run(sway_arcmin=2.0, misalignment_arcmin=0.0, bias_dph=0.0))
    off, _, _ = harmonics_off(swaying, ErrorPart.DECODED)["toolface"]
    assert abs(abs(off[0]) - 2.0) < 0.05
    off, _, _ = harmonics_off(swaying, ErrorPart.SENSOR)["toolface"]
    assert np.abs(off).max() < 0.15


def test_the_constant_is_not_made_up() -> None:
    one = made(Run())
    curves = self_errors(one.t_s, one.accel, None, one.theta).curves()
    for curve in curves.values():
        assert curve.parameters[0] == 0.0
        assert any("constant is unobservable" in remark for remark in curve.remarks)


def test_gaps_in_time_part_the_recording() -> None:
    one = made(Run(turns=24))
    kept = (one.t_s < 28.0) | (one.t_s > 40.0)
    errors = self_errors(one.t_s[kept], one.accel[:, kept], one.gyro[:, kept], one.theta[kept], ErrorPart.SENSOR)
    curve = errors.curves(DOUBT)["inclination"]
    rows = fourier_rows(one.theta, curve.order)
    exact = np.linalg.lstsq(rows.T, ARCMIN * one.true[ErrorPart.SENSOR][0], rcond=None)[0]
    assert np.abs((curve.parameters - exact)[3:]).max() < 0.1


def test_what_cannot_be_reported_is_refused() -> None:
    one = made(Run(turns=4))
    with pytest.raises(Refused, match="needs gyros"):
        self_errors(one.t_s, one.accel, None, one.theta, ErrorPart.SENSOR)
    short = slice(0, 600)
    with pytest.raises(Refused, match="no 3 turns"):
        self_errors(one.t_s[short], one.accel[:, short], None, one.theta[short])
    few = slice(None, None, 20)
    with pytest.raises(Refused, match="rows a turn"):
        self_errors(one.t_s[few], one.accel[:, few], None, one.theta[few])
    upright = made(replace(Run(turns=4), inc_deg=1.0))
    with pytest.raises(Refused, match="vertical"):
        self_errors(upright.t_s, upright.accel, None, upright.theta)


def errors_at(inc_deg: float, part: ErrorPart = ErrorPart.ROTOR, seed: int = 0) -> SelfErrors:
    one = made(Run(inc_deg=inc_deg, seed=seed))
    return self_errors(one.t_s, one.accel, one.gyro, one.theta, part)


@pytest.mark.parametrize("seed", range(3))
def test_turns_at_two_inclinations_measure_the_turntable_for_all_others(seed: int) -> None:
    # one tool: the same misaligned gyros in both
    curves = self_turntable([errors_at(25.0, seed=seed), errors_at(70.0, seed=seed)], DOUBT)
    assert set(curves) == {"encoder", "across", "along"}
    theta = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    for inc_deg in (40.0, 85.0):
        inc = math.radians(inc_deg)
        d_inc, d_tf = inclination_toolface_errors(theta, inc, FAULTS)
        tf = curves["encoder"](theta) - curves["across"](theta) / math.tan(inc)
        tf_std = np.hypot(curves["encoder"].std(theta), curves["across"].std(theta) / math.tan(inc))
        off = {"toolface": (tf - ARCMIN * d_tf, tf_std), "inclination": (curves["along"](theta) - ARCMIN * d_inc, None)}
        for name, (left, std) in off.items():
            left = left - left.mean()
            # all but the first harmonic to a twentieth of an arcminute, that within its doubt
            later = left - fourier_rows(theta, 1).T @ (fourier_rows(theta, 1) @ left * 2.0 / theta.size)
            assert np.abs(later).max() < 0.05
            bound = curves["along"].std(theta) if std is None else std
            assert np.abs(left).max() < 4.0 * bound.max(), name
        assert np.std(ARCMIN * d_tf) > 0.8
    for curve in curves.values():
        assert curve.parameters[0] == 0.0
        assert any("constant is unobservable" in remark for remark in curve.remarks)
        assert any("first harmonic is uncertain" in remark for remark in curve.remarks)


def test_one_inclination_or_the_sensors_own_errors_make_no_turntable() -> None:
    with pytest.raises(Refused, match="one inclination cannot separate the encoder"):
        self_turntable([errors_at(50.0), errors_at(50.5, seed=1)], DOUBT)
    with pytest.raises(Refused, match="'sensor' is no error of a turntable"):
        self_turntable([errors_at(25.0, ErrorPart.SENSOR), errors_at(70.0, ErrorPart.SENSOR)], DOUBT)
