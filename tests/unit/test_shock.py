"""Shock and vibration counters against what was put in."""

from __future__ import annotations

import math

import numpy as np
import pytest

from highside.config.rig import VibrationSettings
from highside.service.rig.shock import ShockMeter

RATE = 400.0


def feed(meter: ShockMeter, a: np.ndarray, start: float = 0.0) -> None:
    for i, (x, y, z) in enumerate(a.T.tolist()):
        meter.add(start + i / RATE, x, y, z)


def turning(seconds: float, rpm: float = 0.0) -> np.ndarray:
    t = np.arange(int(seconds * RATE)) / RATE
    angle = 2 * np.pi * rpm / 60 * t
    return np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(t.size, math.sqrt(0.75))])


def test_a_tool_that_turns_smoothly_does_not_shake() -> None:
    meter = ShockMeter(VibrationSettings())
    feed(meter, turning(20.0, rpm=60.0))
    assert max(meter.max_rms_g) < 0.02
    assert all(s == 0 for row in meter.seconds for s in row)
    assert all(n == 0 for row in meter.shocks for n in row)


@pytest.mark.parametrize("frequency_hz", [30.0, 60.0, 120.0])
def test_rms_and_peak_of_a_tone(frequency_hz: float) -> None:
    meter = ShockMeter(VibrationSettings())
    a = turning(20.0)
    a[1] += 1.5 * np.sin(2 * np.pi * frequency_hz * np.arange(a.shape[1]) / RATE)
    feed(meter, a)
    assert meter.max_rms_g[1] == pytest.approx(1.5 / math.sqrt(2), rel=0.07)
    assert meter.max_peak_g[1] == pytest.approx(1.5, rel=0.07)
    assert max(meter.max_rms_g[0], meter.max_rms_g[2]) < 1e-6
    # levels 0.1, 0.5, 1, 2, 5 g rms: at or above three of them for all but the settling time
    assert meter.seconds[1][:3] == pytest.approx([19.0] * 3, abs=1.5)
    assert meter.seconds[1][3:] == [0.0, 0.0]


def test_each_shock_is_counted_once_at_each_level_it_reached() -> None:
    meter = ShockMeter(VibrationSettings())
    a = turning(20.0)
    for at, size in ((4.0, 2.0), (8.0, 7.0), (12.0, 30.0)):
        k = int(at * RATE)
        # a ringing of 20 ms: eight readings, one shock
        a[2, k : k + 8] += size * np.array([1.0, -0.9, 0.8, -0.6, 0.4, -0.3, 0.2, -0.1])
    feed(meter, a)
    assert meter.shocks[2] == [3, 2, 1, 1, 0]
    assert meter.shocks[0] == [0] * 5
    assert 27.0 < meter.max_peak_g[2] < 40.0


def test_a_gap_or_a_reset_is_no_shock() -> None:
    meter = ShockMeter(VibrationSettings())
    feed(meter, turning(2.0))
    feed(meter, -turning(2.0), start=100.0)
    feed(meter, turning(2.0), start=0.0)
    meter.add(3.0, math.nan, 0.0, 0.0)
    assert max(meter.max_peak_g) < 1e-3


def test_a_watch_tells_its_own_peak() -> None:
    meter = ShockMeter(VibrationSettings())
    a = turning(6.0)
    a[0, int(2 * RATE)] += 3.0
    feed(meter, a[:, : int(4 * RATE)])
    assert meter.since_g[0] > 2.5
    meter.begin_watch()
    feed(meter, a[:, int(4 * RATE) :], start=4.0)
    assert meter.since_g[0] < 1e-3
