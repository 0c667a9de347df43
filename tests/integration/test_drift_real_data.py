"""Recordings of real gyros: inclination against an optical reference, the bias at rest and against temperature."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from highside.attitude.quaternion import conjugate, from_angles, multiply, to_tool
from highside.gyro.filter import FilterSettings, carried
from highside.gyro.recording_filter import error_state_filter
from highside.gyro.result import AzimuthBasis

G = 9.80665
MEMS = FilterSettings(
    bias_std_radps=float(np.radians(0.5)), arw=float(np.radians(0.02)), rrw=float(np.radians(0.001)),
    accel_noise_g=2e-3, accel_floor_g=0.03, azimuth_std_rad=0.01, scale_std=5e-3,
)  # fmt: skip


@pytest.mark.parametrize(
    ("trial", "worst_deg", "by_hand_deg"),
    [
        ("02_undisturbed_slow_rotation_B", 0.7, 0.50),
        ("07_undisturbed_fast_rotation_B", 1.2, 1.05),
        ("10_undisturbed_slow_translation_A", 0.6, 0.27),
        ("27_disturbed_phone_vibration_B", 0.5, 0.30),
    ],
)
@pytest.mark.parametrize("by_hand", [False, True])
def test_the_inclination_of_a_hand_held_sensor_and_the_bias_of_its_rest(
    shared_data: Path, trial: str, worst_deg: float, by_hand_deg: float, by_hand: bool
) -> None:
    # vqf at its defaults: 0.43, 1.02, 0.30, 0.37 deg
    z = np.load(shared_data / "broad" / f"{trial}.npz")
    rate, accel = (np.ascontiguousarray(z[name].astype(float).T) for name in ("imu_gyr", "imu_acc"))
    t = np.arange(rate.shape[1]) / float(z["fs"])
    moving, reference = z["movement"].astype(bool), z["opt_quat"].astype(float).T
    result = error_state_filter(t, to_tool(rate), to_tool(accel / G), carried(MEMS) if by_hand else MEMS)
    known = np.flatnonzero(~np.isnan(reference).any(axis=0) & moving)
    ours = from_angles(result.inc_rad - 0.5 * np.pi, result.tf_rad, result.azi_rad)
    e = multiply(ours[:, known], conjugate(reference[:, known]))
    inclination = 2.0 * np.arccos(np.clip(np.sqrt(e[0] ** 2 + e[3] ** 2), 0.0, 1.0))
    assert np.degrees(np.sqrt(np.mean(inclination**2))) < (by_hand_deg if by_hand else worst_deg)
    # stops are found: before it moves the bias is that of the rest
    begin = int(np.argmax(moving)) - 300
    rest = rate[:, :begin].mean(axis=1)
    assert np.degrees(np.abs(result.bias_radps[:, begin] - to_tool(rest))).max() < 0.02
    assert AzimuthBasis.ZERO_RATE in result.basis


def test_the_bias_of_a_unit_that_warms_up_follows_its_temperature(shared_data: Path) -> None:
    with gzip.open(shared_data / "serial_vn100" / "F00379_first60pct_decoded.csv.gz", "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    keep = table["t_s"] > 70.0
    # x forward, y right, z down: half a turn about x to the tool frame
    rate = np.stack([table["GyroX"], -table["GyroY"], -table["GyroZ"]])[:, keep]
    accel = np.stack([table["AccX"], -table["AccY"], -table["AccZ"]])[:, keep] / G
    t, temperature = table["t_s"][keep], table["Temp"][keep]
    settings = replace(MEMS, rrw=float(np.radians(3e-4)), accel_noise_g=5e-4)
    result = error_state_filter(t, rate, accel, settings, rest=np.array([[t[0], t[-1]]]), smooth=True)
    settled = t > t[0] + 30.0
    for axis, slope in ((0, 0.0033), (2, 0.0105)):
        bias = np.degrees(result.bias_radps[axis, settled])
        found, offset = np.polyfit(temperature[settled] - 12.0, bias, 1)
        assert found == pytest.approx(slope, rel=0.25)
        # the raw means of the first and the last half minute say the same
        raw = np.degrees([rate[axis, settled][:300].mean(), rate[axis, settled][-300:].mean()])
        warmed = temperature[settled][-300:].mean() - temperature[settled][:300].mean()
        assert found == pytest.approx((raw[1] - raw[0]) / warmed, rel=0.25)
        assert (bias - offset - found * (temperature[settled] - 12.0)).std() < 0.0015
