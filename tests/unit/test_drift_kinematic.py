"""The error-state filter: exact with perfect sensors, consistent with its covariance, honest about its azimuth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from highside.attitude.angles import wrap_signed
from highside.drift.filter import KinematicFilter, Settings
from highside.drift.frames import attitude, to_body
from highside.drift.gates import Motion
from highside.drift.kinematic import kinematic
from highside.drift.result import AzimuthBasis, DriftResult
from highside.physics.drift_scenarios import (
    LATITUDE_RAD,
    PERFECT,
    DriftData,
    Experiment,
    curved_hole,
    drilling,
    record,
    rotating_rod,
    rotating_table,
    turntable,
    vibration_table,
)

SETTINGS = Settings(latitude_rad=LATITUDE_RAD, azimuth_rad=np.radians(60.0))


def _run(
    experiment: Experiment, seed: int, *, rest: list[list[float]] | None = None, settings: Settings = SETTINGS
) -> tuple[DriftResult, DriftData]:
    data = record(experiment, seed)
    intervals = None if rest is None else np.array(rest)
    return kinematic(experiment.t_s, data.rate, data.accel, settings, rest=intervals), data


def _drifts_dph(result: DriftResult, e: Experiment) -> tuple[float, float, float]:
    """Mean error over the last ten seconds by the hours passed: inclination, toolface, azimuth."""
    last = e.t_s >= e.t_s[-1] - 10.0
    pairs = ((result.inc_rad, e.theta + np.pi / 2), (result.tf_rad, e.phi), (result.azi_rad, e.psi))
    inc, tf, azi = (abs(np.degrees(wrap_signed(ours[last] - true[last]).mean())) / e.hours for ours, true in pairs)
    return float(inc), float(tf), float(azi)


NO_STOPS = replace(SETTINGS, detect_stops=False)


@pytest.mark.parametrize("turning", [False, True])
def test_perfect_sensors_do_not_drift_in_an_hour(turning: bool) -> None:
    experiment = rotating_table(30.0, 3600.0, 20.0, triad=PERFECT) if turning else turntable(3600.0, 20.0, PERFECT)
    result, _ = _run(experiment, 0, settings=NO_STOPS)
    assert max(_drifts_dph(result, experiment)) < 1e-3


def test_without_the_latitude_the_earth_turns_the_azimuth_and_the_result_says_so() -> None:
    experiment = turntable(600.0, 20.0, PERFECT)
    result, _ = _run(experiment, 0, settings=replace(NO_STOPS, latitude_rad=None))
    drift = _drifts_dph(result, experiment)[2]
    assert drift == pytest.approx(15.041 * np.sin(LATITUDE_RAD), rel=0.05)
    assert drift * experiment.hours < 3 * np.degrees(result.azi_std_rad[-1])
    assert any("latitude" in note for note in result.notes)


def test_online_and_batch_are_equal_bit_for_bit() -> None:
    experiment = drilling(120.0, 50.0, leg_s=60.0, stop_s=20.0, start_s=30.0)
    result, data = _run(experiment, 1)
    engine = KinematicFilter(SETTINGS)
    online = []
    for i, (t, w, a) in enumerate(
        zip(experiment.t_s.tolist(), to_body(data.rate).T.tolist(), to_body(data.accel).T.tolist(), strict=True)
    ):
        state = engine.update(t, tuple(w), tuple(a))
        if state is not None:
            online.append((i - 1, state))
        if i > 200 and i % 37 == 0:
            inc, tf, azi = attitude(engine.attitude_now())
            ours = (result.inc_rad[i], result.tf_rad[i], result.azi_rad[i])
            assert (i + 1) % 50 == 0 or np.allclose((inc, tf, azi), ours, rtol=0.0, atol=1e-12)
    assert len(online) == 120
    for row, state in online:
        assert np.array_equal(attitude(state.q)[2], result.azi_rad[row])
        assert np.array_equal(to_body(result.bias_radps[:, row]), state.bias)
        assert result.motion is not None
        assert state.motion == result.motion[row]


def test_gravity_alone_at_rest_finds_the_azimuth_through_the_earths_rotation_and_no_better() -> None:
    # the bias (24 deg/h) exceeds the Earth's rotation: an error propagated with it in place would run away
    experiment = turntable(3600.0, 20.0)
    for seed in (0, 2):
        result, data = _run(experiment, seed, settings=NO_STOPS)
        std = np.degrees(result.azi_std_rad[-1])
        assert 1.2 < std < 2.2
        assert np.degrees(abs(wrap_signed(float(result.azi_rad[-1] - experiment.psi[-1])))) < 3 * std
        assert np.all(np.abs(result.bias_radps[:, -1] - data.bias_end) < 3 * result.bias_std_radps[:, -1])
        assert result.basis == (AzimuthBasis.NOTHING,)


def test_turntable_with_rest_declared_for_seven_minutes() -> None:
    drifts = []
    for seed in range(3):
        experiment = turntable(3600.0, 20.0)
        result, _ = _run(experiment, seed, rest=[[0.0, 420.0]])
        drifts.append(_drifts_dph(result, experiment))
    inc, tf, azi = np.sqrt(np.mean(np.square(drifts), axis=0))
    # the tilt is that of the accelerometer bias, which nothing here can find
    assert inc < 1.3 * 0.19
    assert tf < 1.5 * 0.22
    assert azi < 0.6


def test_vibration_table_with_rest_declared_for_seven_minutes() -> None:
    drifts = []
    for seed in (0, 2, 3):
        experiment = vibration_table(rate_hz=50.0)
        result, _ = _run(experiment, seed, rest=[[0.0, 420.0]])
        drifts.append(_drifts_dph(result, experiment)[2])
    assert np.sqrt(np.mean(np.square(drifts))) < 0.9


def test_drilling_with_declared_stops_stays_within_the_published_figures() -> None:
    good = 0
    for seed in (1, 2):
        experiment = drilling()
        result, _ = _run(experiment, seed, rest=experiment.rest.tolist())
        inc, _, azi = _drifts_dph(result, experiment)
        good += inc <= 0.22 and azi <= 0.46
        assert AzimuthBasis.ZERO_RATE in result.basis
    assert good == 2


@pytest.mark.parametrize("theta_deg", [0.0, 30.0])
def test_a_turning_table_shows_all_biases_to_gravity(theta_deg: float) -> None:
    drifts = []
    for seed in range(2):
        experiment = rotating_table(theta_deg, rate_hz=50.0)
        result, _ = _run(experiment, seed, settings=NO_STOPS)
        drifts.append(_drifts_dph(result, experiment)[2])
        assert result.basis == (AzimuthBasis.ROTATION,)
    assert np.sqrt(np.mean(np.square(drifts))) < 0.3


def test_a_turning_rod_with_a_scale_error_keeps_its_azimuth_and_finds_the_error() -> None:
    experiment = rotating_rod(5400.0)
    result, _ = _run(experiment, 1, rest=experiment.rest.tolist())
    without, _ = _run(experiment, 1, rest=experiment.rest.tolist(), settings=replace(SETTINGS, scale_std=0.0))
    assert result.scale == pytest.approx(200e-6, abs=20e-6)
    assert _drifts_dph(result, experiment)[2] < 0.6
    assert _drifts_dph(result, experiment)[2] < _drifts_dph(without, experiment)[2]


def test_a_curved_hole_is_followed_and_straight_hole_hides_it() -> None:
    experiment = curved_hole(rate_hz=50.0)
    for settings, rest in ((SETTINGS, [[0.0, 300.0]]), (SETTINGS, None)):
        result, _ = _run(experiment, 2, rest=rest, settings=settings)
        assert np.degrees(abs(wrap_signed(result.azi_rad - experiment.psi)).max()) < 0.5
        assert AzimuthBasis.CONSTRAINT not in result.basis
    hidden, _ = _run(
        experiment, 2, rest=[[0.0, 300.0]], settings=replace(SETTINGS, straight_hole_std_rad=np.radians(0.1))
    )
    assert np.degrees(abs(hidden.azi_rad[-1] - experiment.psi[-1])) > 1.5
    assert AzimuthBasis.CONSTRAINT in hidden.basis


@pytest.mark.parametrize("case", ["rest", "turning", "curved", "wrong priors"])
def test_errors_stay_within_three_sigma(case: str) -> None:
    settings = replace(NO_STOPS, azimuth_std_rad=np.radians(1.0))
    inside, count = 0, 20
    for seed in range(count):
        offset = np.random.default_rng(1000 + seed)
        own, rest = settings, None
        if case == "rest":
            experiment, rest = turntable(600.0, 20.0), [[0.0, 120.0]]
        elif case == "turning":
            experiment = rotating_table(30.0, 600.0, 20.0)
        elif case == "curved":
            experiment, rest = curved_hole(rate_hz=20.0), [[0.0, 300.0]]
        else:
            experiment, rest = turntable(600.0, 20.0), [[0.0, 120.0]]
            wrong = np.radians(0.1) * offset.standard_normal()
            own = replace(settings, latitude_rad=LATITUDE_RAD + wrong)
        own = replace(own, azimuth_rad=np.radians(60.0 + offset.standard_normal()))
        result, data = _run(experiment, seed, rest=rest, settings=own)
        azimuth = abs(wrap_signed(float(result.azi_rad[-1] - experiment.psi[-1]))) / result.azi_std_rad[-1]
        bias = np.abs(result.bias_radps[:, -1] - data.bias_end) / result.bias_std_radps[:, -1]
        inside += int(azimuth < 3.0 and bias.max() < 3.0)
    assert inside >= 0.95 * count - 1


def test_a_gap_widens_the_azimuth_and_is_told() -> None:
    experiment = turntable(120.0, 50.0)
    data = record(experiment, 1)
    keep = (experiment.t_s < 60.0) | (experiment.t_s > 70.0)
    result = kinematic(experiment.t_s[keep], data.rate[:, keep], data.accel[:, keep], NO_STOPS)
    assert result.azi_std_rad[-1] > 5 * result.azi_std_rad[100]
    assert any("gap" in note for note in result.notes)


def test_rows_know_nothing_of_later_ones() -> None:
    experiment = drilling(120.0, 50.0, leg_s=60.0, stop_s=20.0, start_s=30.0)
    data = record(experiment, 1)
    whole = kinematic(experiment.t_s, data.rate, data.accel, SETTINGS)
    part = kinematic(experiment.t_s[:5500], data.rate[:, :5500], data.accel[:, :5500], SETTINGS)
    assert np.array_equal(whole.azi_rad[:5500], part.azi_rad)
    assert np.array_equal(whole.bias_radps[:, :5500], part.bias_radps)
    assert whole.motion is not None
    assert (whole.motion == Motion.STILL).any()
