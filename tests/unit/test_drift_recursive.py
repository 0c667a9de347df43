"""The light filter: its gains are the derived ones, its bias as good as theory allows."""

from __future__ import annotations

import numpy as np
import pytest

from highside.attitude.quaternion import from_angles, up_direction
from highside.gyro.complementary import ComplementaryFilter, ScalarFilter, complementary, steady_gains
from highside.gyro.filter import FilterSettings
from highside.gyro.frames import DEG_PER_HOUR, DEG_PER_SQRT_HOUR, to_body
from highside.gyro.result import AzimuthBasis
from highside.papers.drift_scenarios import LATITUDE_RAD, Triad, record, turntable

ARW, RRW = 0.1 * DEG_PER_SQRT_HOUR, 0.1 * DEG_PER_HOUR / 60


@pytest.mark.parametrize("accel_std", [1e-3, 0.5])
def test_the_gains_settle_where_the_closed_form_says(accel_std: float) -> None:
    T = 0.01
    scalar = ScalarFilter(1e-6, 0.0, (0.3 * DEG_PER_HOUR) ** 2)
    kt = kb = 0.0
    for _ in range(1_500_000):
        scalar.predict(T, ARW, RRW)
        kt, kb = scalar.update(accel_std**2)
    k_p, k_i = steady_gains(accel_std, T, ARW, RRW)
    assert kt / T == pytest.approx(k_p, rel=0.01)
    assert kb / T == pytest.approx(k_i, rel=0.01)


def test_the_bias_after_fifty_seconds_is_as_good_as_its_covariance() -> None:
    experiment = turntable(50.0, 50.0, triad=Triad((10.0, -5.0, 3.0), accel_bias_g=0.0))
    settings = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=np.radians(60.0))
    errors, stated = [], []
    for seed in range(40):
        data = record(experiment, seed)
        # held, the axis along Up is as well known as the others
        result = complementary(experiment.t_s, data.rate, data.accel, settings, hold=True)
        up = up_direction(from_angles(experiment.theta[-1], experiment.phi[-1], experiment.psi[-1]))
        error = to_body(result.bias_radps)[:, -1] - to_body(data.bias_end)
        errors.append(error - (error @ up) * up)
        stated.append(result.bias_std_radps[0, -1])
    # two level axes
    ratio = np.sqrt(np.square(errors).sum() / (2 * len(errors))) / np.mean(stated)
    assert 0.75 < ratio < 1.25


def test_held_azimuth_stays_and_says_why() -> None:
    experiment = turntable(300.0, 50.0)
    data = record(experiment, 1)
    settings = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=np.radians(60.0))
    held = complementary(experiment.t_s, data.rate, data.accel, settings, hold=True)
    free = complementary(experiment.t_s, data.rate, data.accel, settings)
    assert np.degrees(np.abs(held.azi_rad - experiment.psi).max()) < 0.1
    assert held.basis == (AzimuthBasis.CONSTRAINT,)
    assert free.basis == (AzimuthBasis.NOTHING,)
    assert free.azi_std_rad[-1] > 10 * held.azi_std_rad[-1]
    assert np.degrees(abs(free.azi_rad[-1] - experiment.psi[-1])) < 3 * np.degrees(free.azi_std_rad[-1])


def test_samples_one_by_one_give_what_the_batch_gives() -> None:
    experiment = turntable(20.0, 50.0)
    data = record(experiment, 1)
    settings = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=np.radians(60.0))
    engine = ComplementaryFilter(settings, hold=False)
    for t, w, a in zip(
        experiment.t_s.tolist(), to_body(data.rate).T.tolist(), to_body(data.accel).T.tolist(), strict=True
    ):
        engine.update(t, tuple(w), tuple(a))
    engine.finish()
    batch = complementary(experiment.t_s, data.rate, data.accel, settings)
    assert np.array_equal(to_body(batch.bias_radps)[:, -1], engine.bias)
