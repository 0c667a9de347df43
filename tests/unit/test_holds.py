"""Sessions by hand: how many holds were read, and what is left or could have shown, whatever the verdict."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.core.floor import floor_of_means
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_magnitudes
from highside.diagnosis.magnitude.session import MagnitudeSession, magnitude_session
from highside.physics.forward import ForwardModel
from highside.report import diagnosis_words

Array = NDArray[np.float64]

FREE = ("bias", "scale", "misalignment")
RATE_HZ, ROWS, NOISE_G = 100.0, 300, 5e-4
ALONG = np.array([0.62, -0.49, 0.61])


def directions(n: int) -> Array:
    k = np.random.default_rng(n).permutation(n) + 0.5
    z, turn = 1 - 2 * k / n, np.pi * (1 + np.sqrt(5)) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def held(n: int, still: int, seed: int, step_g: float = 0.0) -> DiagnosisResult:
    """n holds of three seconds, of which the first `still` are at rest and the others tremble by half a degree."""
    rng = np.random.default_rng(seed)
    to, parts = directions(n), []
    elapsed = np.arange(ROWS) / RATE_HZ
    for i in range(n):
        hold = np.repeat(to[:, i : i + 1], ROWS, axis=1) + (i >= n / 2) * step_g * ALONG[:, None]
        if i >= still:
            across = np.cross(to[:, i], [0.3, 0.5, 0.8])
            hold = hold + 8e-3 * np.outer(across, np.sin(6 * np.pi * elapsed + rng.uniform(0, 6)))
        part = np.linspace(0, 1, 80)
        way = to[:, i : i + 1] * (1 - part) + to[:, (i + 1) % n][:, None] * part
        parts += [hold, way / np.linalg.norm(way, axis=0)]
    accel = np.concatenate(parts, axis=1)
    accel += NOISE_G * rng.standard_normal(accel.shape)
    session = magnitude_session({"t_s": np.arange(accel.shape[1]) / RATE_HZ}, accel, gravity_mps2=9.80665)
    assert isinstance(session, MagnitudeSession) and not session.rest
    return diagnose_magnitudes(session, ForwardModel.of({}), FREE)[0]


def test_the_lesser_part_of_the_holds_says_nothing_of_the_session() -> None:
    found = held(31, 12, 3)
    assert found.verdict == "not_testable"
    assert "12 of about 31 holds" in found.remainder.hints[0]
    assert "12 still intervals of about 31" in diagnosis_words.tested(found)


def test_nothing_left_out_is_said_with_what_would_have_shown() -> None:
    found = held(24, 24, 4)
    assert found.verdict == "nothing_left_out"
    assert found.coverage is not None
    assert (found.coverage.intervals_used, found.coverage.intervals_expected) == (24, 24)
    smallest = found.minimum_detectable["bias_step"].value
    assert f"bias_step {smallest:.2g} g" in found.remainder.hints[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_step_of_twice_what_would_have_shown_is_named_or_refused_with_its_size(seed: int) -> None:
    """Of 24 readings nine go into offset and matrix: chance of the rest alone hid steps of many times their noise."""
    smallest = held(24, 24, seed).minimum_detectable["bias_step"].value
    found = held(24, 24, seed, step_g=2 * smallest)
    assert found.verdict != "nothing_left_out"
    claimed = {name for claim in found.claims for name in claim.equivalence_class}
    assert "bias_step" in claimed or any("more than they repeat" in hint for hint in found.remainder.hints)


def test_one_long_interval_shows_a_slow_noise_that_short_ones_hide() -> None:
    """An oscillation of ten seconds is constant in intervals of two; in one of a minute it is seen, and counts."""
    rng = np.random.default_rng(5)
    rows = [np.arange(6400)] + [np.arange(6400 + 200 * k, 6600 + 200 * k) for k in range(30)]
    white = rng.standard_normal(6400 + 6000)
    slow = np.sin(2 * np.pi * np.arange(white.size) / 900) * 0.5
    quiet, loud = floor_of_means(white[None], rows), floor_of_means((white + slow)[None], rows)
    assert quiet is not None and loud is not None
    assert quiet.sigma[0, 1] == pytest.approx(200**-0.5, rel=0.1) and quiet.freedom > 1000
    assert loud.sigma[0, 1] > 2.5 * quiet.sigma[0, 1]
