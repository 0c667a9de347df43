"""What is named at one strength is named at any larger one, and with more rows: at rest, seconds to minutes, in mg."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_magnitudes
from highside.diagnosis.magnitude.session import magnitude_session
from highside.physics.forward import ForwardModel

FREE = ("bias", "scale", "misalignment")
SIGMA_G = 3e-4
"""of a row, ten rows a second"""


def rest(signal: Array, seed: int = 2, along: tuple[float, float, float] = (1.0, 0.5, 0.8)) -> DiagnosisResult:
    """A rest of which the three channels read more by so many times a signal (N,) in g."""
    n = signal.size
    t_s = 0.1 * np.arange(n)
    noise = SIGMA_G * np.random.default_rng(seed).standard_normal((3, n))
    accel = np.array([[0.3], [0.2], [0.933]]) + noise + signal * np.array(along)[:, None]
    columns = {"t_s": t_s, "ax_g": accel[0], "ay_g": accel[1], "az_g": accel[2]}
    columns["temp_c"] = 25 + 5 * np.sin(t_s / 200)
    session = magnitude_session(columns, accel, gravity_mps2=9.80665)
    assert not isinstance(session, str)
    return diagnose_magnitudes(session, ForwardModel.of({}), FREE)[0]


def classes(found: DiagnosisResult) -> set[str]:
    return {name for claim in found.claims for name in claim.equivalence_class}


T_S = 0.1 * np.arange(6000)
STEP = (T_S > 317.3).astype(float)
WARMUP = np.exp(-T_S / 90)


@pytest.mark.parametrize("size_g", [3e-4, 1e-3, 3e-3, 1e-2, 3e-2])
@pytest.mark.parametrize(("shape", "effect"), [(STEP, "bias_step"), (WARMUP, "warmup")])
def test_steps_and_warmups_are_named_whatever_their_size(shape: Array, effect: str, size_g: float) -> None:
    """Between the instants that are searched, a step of 1 mg left what looked like a random walk."""
    found = rest(size_g * shape)
    assert found.verdict in ("named", "named_plus"), (found.verdict, found.remainder.hints)
    assert effect in classes(found)


def test_a_jump_that_makes_another_attitude_is_not_explained() -> None:
    """50 mg across gravity turn the reading by three degrees: offset and scale would fit any level there."""
    found = rest(5e-2 * STEP, along=(-0.933, 0.0, 0.33))
    assert found.verdict != "nothing_left_out"
    assert any("attitudes of this rest" in words for words in found.remainder.hints) or found.claims


def test_rest_alone_is_explained() -> None:
    assert rest(0.0 * STEP).verdict == "nothing_left_out"


def test_what_a_prefix_supports_does_not_vanish_with_more_rows() -> None:
    """An offset that follows the temperature, over ever longer parts of one recording."""
    warm = 25 + 5 * np.sin(T_S / 200)
    for rows in (2400, 3600, 4800, 6000):
        found = rest(2e-3 * (warm[:rows] - 25) / 10)
        assert found.verdict in ("named", "named_plus"), rows
        assert any("temperature" in claim or claim == "reference_voltage" for claim in classes(found)), classes(found)
