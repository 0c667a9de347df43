"""Steps, warm-ups and temperature where only |g| is known: named, or refused with the size of what is left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_magnitudes
from highside.diagnosis.magnitude.session import MagnitudeSession, magnitude_session
from highside.physics.forward import ForwardModel
from highside.physics.gravity import attitude_of
from highside.physics.state import ChainState

Array = NDArray[np.float64]

FREE = ("bias", "scale", "misalignment")
ALONG = np.array([0.62, -0.49, 0.61])
ROWS, RATE_HZ, POSE_S = 200, 50.0, 8.0


def diagnosed(columns: dict[str, Array], accel_g: Array) -> DiagnosisResult:
    session = magnitude_session(columns, accel_g, gravity_mps2=9.80665)
    assert isinstance(session, MagnitudeSession)
    return diagnose_magnitudes(session, ForwardModel.of({}), FREE)[0]


def by_hand(seed: int, noise_g: float = 1e-3, **effects: dict[str, float]) -> DiagnosisResult:
    """36 attitudes held for four seconds each."""
    rng = np.random.default_rng(seed)
    k = np.random.default_rng(36).permutation(36) + 0.5
    z, turn = 1 - 2 * k / 36, np.pi * (1 + np.sqrt(5)) * k
    attitudes = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    inc, tf = attitude_of(attitudes)
    t_s = np.arange(36) * POSE_S
    sensor = {"bias": {"b_x": 0.02, "b_y": -0.01, "b_z": 0.01}, "scale": {"s_x": 0.006, "s_y": 0.01, "s_z": 0.004}}
    readings = ForwardModel.of({**sensor, **effects}).predict(ChainState.build(inc, tf, t_s=t_s))
    accel = np.repeat(readings, ROWS, axis=1) + rng.normal(0, noise_g, (3, ROWS * 36))
    times = (t_s[:, None] + np.arange(ROWS) / RATE_HZ).reshape(-1)
    return diagnosed({"t_s": times, "pose": np.repeat(np.arange(36.0), ROWS)}, accel)


def of_axes(size_g: float) -> dict[str, float]:
    return {f"a_{axis}": float(size_g * part) for axis, part in zip("xyz", ALONG, strict=True)}


@pytest.mark.parametrize("size_g", [1e-3, 2e-3, 5e-3])
def test_a_step_in_a_session_by_hand_is_named_with_its_size(size_g: float) -> None:
    """Of three axes it never beat a random walk, which was as large as the step."""
    found = by_hand(1, bias_step={**of_axes(size_g), "t0": 145.0})
    assert (found.verdict, [claim.effect for claim in found.claims]) == ("named", ["bias_step"])
    for axis, part in zip("xyz", ALONG, strict=True):
        assert found.claims[0].parameters[f"a_{axis}"].value == pytest.approx(size_g * part, abs=2e-4)


@pytest.mark.parametrize("size_g", [2e-3, 5e-3])
def test_a_warm_up_in_a_session_by_hand_is_named(size_g: float) -> None:
    found = by_hand(1, warmup={**of_axes(size_g), "tau": 60.0})
    assert found.verdict in ("named", "named_plus")
    assert "warmup" in found.claims[0].equivalence_class


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("effect", ["bias_step", "warmup"])
def test_what_is_too_small_for_a_name_is_reported_with_its_size(seed: int, effect: str) -> None:
    shape = {"t0": 145.0} if effect == "bias_step" else {"tau": 60.0}
    found = by_hand(seed, **{effect: {**of_axes(7e-4 if effect == "bias_step" else 1.2e-3), **shape}})
    assert found.verdict != "nothing_left_out"
    claimed = {e for claim in found.claims for e in claim.equivalence_class}
    assert effect in claimed or any("more than they repeat" in hint for hint in found.remainder.hints)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_left_out_of_a_session_by_hand_in_order(seed: int) -> None:
    assert by_hand(seed).verdict == "nothing_left_out"


def at_rest(
    seed: int, level: Callable[[Array], Array], temp: Callable[[Array], Array] | None = None, length_s: float = 600.0
) -> DiagnosisResult:
    rng = np.random.default_rng(seed)
    t_s = np.arange(0, length_s, 0.1)
    along = np.array([0.2, -0.1, np.sqrt(0.95)])
    accel = along[:, None] * (1 + level(t_s)) + rng.normal(0, 1e-3, (3, t_s.size))
    return diagnosed({"t_s": t_s, **({"temp_c": temp(t_s)} if temp else {})}, accel)


@pytest.mark.parametrize("size_g", [3e-4, 1e-3, 3e-3, 1e-2, 2e-2, 5e-2])
def test_a_step_at_rest_is_named_at_any_size(size_g: float) -> None:
    """From 1 mg on it was a random walk: the block in which it came, and instants that were searched too coarsely."""
    found = at_rest(1, lambda t: size_g * (t >= 240.3))
    assert found.verdict in ("named", "named_plus")
    assert [claim.effect for claim in found.claims] == ["bias_step"]
    assert found.claims[0].parameters["a_z"].value == pytest.approx(size_g * np.sqrt(0.95), rel=0.2)


@pytest.mark.parametrize("walk_g", [1e-3, 5e-3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_random_walk_at_rest_is_given_no_name(seed: int, walk_g: float) -> None:
    def walk(t_s: Array) -> Array:
        return np.cumsum(np.random.default_rng(seed + 40).normal(0, walk_g / np.sqrt(t_s.size), t_s.size))

    found = at_rest(seed, walk)
    assert found.claims == ()
    assert found.verdict in ("wander", "partial")


@pytest.mark.parametrize("length_s", [600.0, 900.0, 1800.0])
def test_temperature_is_named_however_long_the_recording(length_s: float) -> None:
    """Beside a random walk that leaves it 95 % of the misfit; from 700 s on it was that walk."""

    def temp(t_s: Array) -> Array:
        return np.asarray(25 + 8 * (1 - np.exp(-t_s / 300)) + 0.5 * np.sin(t_s / 90))

    def level(t_s: Array) -> Array:
        rng = np.random.default_rng(4)
        return 3e-4 * (temp(t_s) - 25) + np.cumsum(rng.normal(0, 1e-4 / np.sqrt(6000), t_s.size))

    found = at_rest(3, level, temp, length_s)
    assert found.verdict in ("named", "named_plus")
    claimed = {e for claim in found.claims for e in claim.equivalence_class}
    assert claimed & {"temperature_bias", "temperature_scale", "reference_voltage"}
