"""A sensor waved by hand: accelerations of any size, a bounded velocity, gyros true to some parts in a thousand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import conjugate as conj
from highside.attitude.quaternion import from_angles, multiply, to_angles, to_rotation_vector, to_tool, up_direction
from highside.gyro.compiled import kernels
from highside.gyro.filter import ErrorStateFilter, FilterSettings, carried
from highside.gyro.frames import to_body
from highside.gyro.recording_filter import error_state_filter

G = 9.80665
RATE_HZ = 100.0
NOISE = FilterSettings(
    bias_std_radps=float(np.radians(0.5)),
    arw=float(np.radians(0.02)),
    rrw=float(np.radians(0.001)),
    accel_noise_g=2e-3,
    accel_floor_g=0.03,
)
HAND = carried(NOISE)


def _waved(seed: int, *, seconds: float = 120.0, still_s: float = 25.0) -> tuple[np.ndarray, ...]:
    """Times, rates, readings (tool frame) and the true attitude (4, N): at rest, then turned and moved by hand."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    begun = np.clip((t - still_s) / 2.0, 0.0, 1.0)

    def swing(size: float, lowest_hz: float, highest_hz: float) -> np.ndarray:
        hz, phase = rng.uniform(lowest_hz, highest_hz, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
        return begun * size / 3.0**0.5 * np.sin(2.0 * np.pi * hz[:, None] * t + phase[:, None]).sum(axis=0)

    q = from_angles(0.3 + swing(0.3, 0.1, 0.4), 0.5 + swing(0.4, 0.1, 0.4), 1.0 + swing(0.4, 0.1, 0.4))
    velocity = np.stack([swing(0.3, 0.1, 1.0) for _ in range(3)])
    acceleration = np.gradient(velocity, t, axis=1) / G
    steps = to_rotation_vector(multiply(conj(q[:, :-1]), q[:, 1:])) * RATE_HZ
    rate = np.concatenate([steps[:, :1], steps], axis=1) * (1.0 + 3e-3 * rng.standard_normal((3, 1)))
    rate += np.radians(0.3) * rng.standard_normal((3, 1)) + np.radians(0.1) * rng.standard_normal(rate.shape)
    # an acceleration of East, North, Up seen from the body
    pure = np.concatenate([np.zeros((1, t.size)), acceleration])
    seen = multiply(multiply(conj(q), pure), q)[1:]
    reading = up_direction(q) + seen + 2e-3 * rng.standard_normal(rate.shape)
    return t, to_tool(rate), to_tool(reading), q


def _tilt_deg(t: np.ndarray, rate: np.ndarray, accel: np.ndarray, q: np.ndarray, settings: FilterSettings) -> float:
    result = error_state_filter(t, rate, accel, settings)
    ours = from_angles(result.inc_rad - 0.5 * np.pi, result.tf_rad, result.azi_rad)
    e = multiply(ours, conj(q))[:, t > 30.0]
    return float(np.degrees(np.sqrt(np.mean((2.0 * np.arccos(np.clip(np.hypot(e[0], e[3]), 0.0, 1.0))) ** 2))))


def test_a_bounded_velocity_holds_the_tilt_better_than_accelerations_taken_for_noise() -> None:
    pairs = np.array([[_tilt_deg(*_waved(seed), settings) for settings in (HAND, NOISE)] for seed in range(4)])
    assert pairs[:, 0].max() < 0.6
    assert np.all(pairs[:, 0] < 0.8 * pairs[:, 1])


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_half_or_twice_the_velocity_changes_little(factor: float) -> None:
    data = _waved(1)
    other = replace(HAND, velocity_std_mps=factor * HAND.velocity_std_mps)
    assert _tilt_deg(*data, other) < 1.5 * _tilt_deg(*data, HAND)


def test_compiled_interpreted_and_online_are_the_same() -> None:
    t, rate, accel, _ = _waved(2, seconds=60.0)
    keep = ~((t > 40.0) & (t < 42.0))
    t, rate, accel = t[keep], rate[:, keep], accel[:, keep]
    engine = ErrorStateFilter(HAND)
    for at, w, a in zip(t.tolist(), to_body(rate).T.tolist(), to_body(accel).T.tolist(), strict=True):
        engine.update(at, (w[0], w[1], w[2]), (a[0], a[1], a[2]))
    online = engine.finish()
    assert online is not None
    assert kernels(10**9) is not None, "the tests need numba (the extra fast)"
    for smooth in (False, True):
        quick = error_state_filter(t, rate, accel, HAND, smooth=smooth)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("highside.gyro.recording_filter.kernels", lambda rows: None)
            plain = error_state_filter(t, rate, accel, HAND, smooth=smooth)
        assert np.array_equal(quick.bias_radps, plain.bias_radps)
        assert np.abs(np.asarray(wrap_signed(quick.inc_rad - plain.inc_rad))).max() < 1e-12
        assert plain.inc_rad[-1] - 0.5 * np.pi == pytest.approx(to_angles(online.q[:, None])[0][0], abs=1e-12)
        assert np.array_equal(plain.bias_radps[:, -1], to_tool(online.bias[:, None])[:, 0])


def test_smoothing_holds_the_tilt_better_still() -> None:
    t, rate, accel, q = _waved(3)
    result = error_state_filter(t, rate, accel, HAND, smooth=True)
    ours = from_angles(result.inc_rad - 0.5 * np.pi, result.tf_rad, result.azi_rad)
    e = multiply(ours, conj(q))[:, t > 30.0]
    smoothed = np.degrees(np.sqrt(np.mean((2.0 * np.arccos(np.clip(np.hypot(e[0], e[3]), 0.0, 1.0))) ** 2)))
    assert smoothed < _tilt_deg(t, rate, accel, q, HAND)
