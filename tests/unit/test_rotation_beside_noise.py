"""What a rotation leaves is measured against a floor that it cannot raise: large departures are never "nothing"."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.beside_noise import beside_noise
from highside.diagnosis.core.fit import Observed, base_fit
from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult, Verdict
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_jacobians
from highside.physics.state import ChainState
from studies import rotation_open
from studies.rotation_open import FREE
from studies.scenario import random_sensor

Array = NDArray[np.float64]
SIGMA = 8e-5
NAMES_ALONE = ProcedureParts(laws=False)


def in_band(rng: np.random.Generator, state: ChainState, low: float, high: float) -> Array:
    """(n,) a motion of unit size between two frequencies, Hz."""
    hz = np.fft.rfftfreq(state.n, state.row_seconds)
    waves = np.fft.rfft(rng.standard_normal(state.n)) * ((hz > low) & (hz < high))
    motion = np.fft.irfft(waves, state.n)
    return np.asarray(motion / motion.std())


def recorded(added: Array, state: ChainState, seed: int) -> RotationSession:
    rng = np.random.default_rng([seed, 1])
    return RotationSession(random_sensor(rng).predict(state) + added + SIGMA * rng.standard_normal(added.shape), state)


def diagnosed(session: RotationSession) -> DiagnosisResult:
    return diagnose_rotation(session, ForwardModel.of({}), FREE, method=NAMES_ALONE)[0]


@pytest.fixture(scope="module")
def state() -> ChainState:
    return rotation_open.design(np.random.default_rng(3))


@pytest.mark.parametrize("sigmas", [2.0, 20.0])
def test_a_string_that_twists_is_not_nothing(state: ChainState, sigmas: float) -> None:
    """The filter that learns the noise took it for colour: nothing was left out, with five times the noise left."""
    across = np.asarray(gravity_jacobians(state.inc_rad, state.tf_rad)[1])
    twist = in_band(np.random.default_rng(5), state, 3.0, 5.0)
    found = diagnosed(recorded(sigmas * SIGMA * across * twist, state, 0))
    assert found.verdict in ("unknown", "named_plus")
    assert "something moves" in found.remainder.hints[0]


def test_a_motion_below_the_noise_of_a_row_shows_on_three_channels_together(state: ChainState) -> None:
    rng = np.random.default_rng(6)
    motion = 0.45 * SIGMA * np.stack([in_band(rng, state, 3.0, 5.0) for _ in range(3)])
    found = diagnosed(recorded(motion, state, 1))
    assert found.verdict == "unknown"
    assert found.location and found.location[0].p < 3e-3


def quiet(session: RotationSession, verdict: Verdict = "nothing_left_out") -> DiagnosisResult:
    """What the floor makes of an answer of a verdict, where base and claims leave what the base fit does."""
    left = base_fit(ForwardModel.of({}), Observed(session.state, session.readings), FREE)[1]
    return beside_noise(DiagnosisResult(verdict), ReportData(session, left, left), session)


@pytest.mark.parametrize("kind", [*rotation_open.KINDS, "white", "quantised", "pose errors", "rows missing"])
def test_noise_of_any_colour_is_noise(state: ChainState, kind: str) -> None:
    for seed in range(4):
        rng = np.random.default_rng([seed, 77])
        white = SIGMA * rng.standard_normal((3, state.n))
        if kind in rotation_open.KINDS:
            session = rotation_open.null(seed, kind, 1200).session
        else:
            readings = random_sensor(rng).predict(state) + white
            if kind == "quantised":
                readings = np.round(readings / (6 * SIGMA)) * 6 * SIGMA
            if kind == "pose errors":
                readings += np.asarray(gravity_jacobians(state.inc_rad, state.tf_rad)[1]) * 2e-4 * white[:1] / SIGMA
            session = RotationSession(readings, state)
            if kind == "rows missing":
                there = rng.uniform(size=state.n) < 0.8
                there[300:420] = False
                session = RotationSession(readings[:, there], state.rows(there))
        assert quiet(session).verdict == "nothing_left_out"


def test_no_colour_of_a_sensor_leaves_a_large_motion_untestable(state: ChainState) -> None:
    rng = np.random.default_rng(8)
    session = recorded(10 * SIGMA * np.stack([in_band(rng, state, 3.0, 5.0)] * 3), state, 2)
    assert quiet(session, "not_testable").verdict == "unknown"
    assert quiet(session, "named").verdict == "named_plus"
    assert quiet(session, "wander").verdict == "wander"
