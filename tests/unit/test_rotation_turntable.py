"""The whole chain on a simulated turntable: fitted on two turns, scored on ten others at another inclination."""

from __future__ import annotations

import numpy as np
import pytest

from highside.errors import InputError, Refused
from highside.physics.rotation_chain import Faults, inclination_toolface_errors
from highside.rotation.turntable import fit_turntable

TABLE: Faults = [
    ("encoder_first_harmonic", {"c1": 3e-4, "s1": -2e-4}),
    ("encoder_second_harmonic", {"c2": 8e-5, "s2": 5e-5}),
    ("wobble", {"ck": 6e-5, "sk": 3e-5, "dk": -4e-5, "tk": 7e-5, "k": 2.0}),
    ("wobble", {"ck": 2e-5, "sk": 1e-5, "dk": 3e-5, "tk": 1e-5, "k": 3.0}),
]
ROWS = 720
THETA = np.arange(ROWS) * (2 * np.pi / ROWS)
NOISE_RAD = 1e-5
IRREGULAR_RAD = 1e-5


def turn(inc_deg: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of one turn (I, T) and the part of T that no other turn repeats: wobble of its own, and noise."""
    d_inc, d_tf = inclination_toolface_errors(THETA, np.radians(inc_deg), TABLE)
    own = sum(
        (IRREGULAR_RAD / k * rng.standard_normal() * np.sin(k * THETA + rng.uniform(0, 6.28)) for k in range(3, 9)),
        start=np.zeros(ROWS),
    ) + NOISE_RAD * rng.standard_normal(ROWS)
    return d_inc + NOISE_RAD * rng.standard_normal(ROWS), d_tf + own, own


@pytest.mark.parametrize("seed", range(4))
def test_two_turns_correct_ten_others_at_another_inclination(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fitted_at = (30.0, 70.0)
    turns = [turn(inc, rng) for inc in fitted_at]
    curve = fit_turntable(
        np.tile(THETA, 2),
        np.radians(np.repeat(fitted_at, ROWS)),
        np.concatenate([tf for _, tf, _ in turns]),
        np.concatenate([inc for inc, _, _ in turns]),
    )
    before, after, own = [], [], []
    for _ in range(10):
        _, d_tf, not_repeated = turn(50.0, rng)
        before.append(d_tf)
        after.append(d_tf - curve.toolface_error(THETA, np.radians(50.0)))
        own.append(not_repeated)
    rms_before, rms_after, rms_own = (float(np.sqrt(np.mean(np.square(x)))) for x in (before, after, own))
    assert rms_before > 15 * rms_own
    assert rms_after <= 1.2 * rms_own


def test_the_parts_are_distinguished() -> None:
    rng = np.random.default_rng(7)
    turns = [(inc, *turn(inc, rng)) for inc in (20.0, 45.0, 80.0)]
    curve = fit_turntable(
        np.tile(THETA, 3),
        np.radians(np.repeat([inc for inc, *_ in turns], ROWS)),
        np.concatenate([tf for _, _, tf, _ in turns]),
        np.concatenate([d_inc for _, d_inc, _, _ in turns]),
    )
    assert curve.encoder[1:5] == pytest.approx([-2e-4, 3e-4, 5e-5, 8e-5], abs=8e-6)
    assert curve.across[3:5] == pytest.approx([7e-5, -4e-5], abs=8e-6)
    assert curve.along[3:5] == pytest.approx([3e-5, 6e-5], abs=3e-6)
    assert np.abs(curve.inclination_error(THETA) - inclination_toolface_errors(THETA, 0.8, TABLE)[0]).max() < 8e-6


def test_one_inclination_is_refused_and_so_is_the_vertical() -> None:
    zero = np.zeros(ROWS)
    with pytest.raises(Refused, match="one inclination cannot separate"):
        fit_turntable(THETA, np.full(ROWS, 0.7), zero, zero)
    with pytest.raises(InputError, match="within three degrees of vertical"):
        fit_turntable(THETA, np.full(ROWS, 0.01), zero, zero)
