"""Poses that scatter more than they repeat: noise with a memory leaves its trace in the rows within them."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult, Location
from highside.diagnosis.identified_noise import with_remembering_rows
from highside.diagnosis.poses.policy import ROWS_MEMORY
from highside.diagnosis.poses.rows_memory import rows_memory
from highside.diagnosis.poses.session import PoseSession, pose_session
from highside.physics.forward import ForwardModel
from studies import diagnosis_deck as deck

STATE = deck.design()
MODEL = ForwardModel.of({})
POSES, SIGMA = 60, 1e-4
REPORT = ReportData(None, np.zeros((3, 1)), np.zeros((3, 1)))


def session_of(kind: str, seed: int, rows: int = 6) -> PoseSession:
    """60 poses of so many rows of white noise, with a level that forgets or an error of each pose that is larger."""
    rng = np.random.default_rng(seed)
    n = POSES * rows
    t_s = np.repeat((28.0 + 2.0 * rows) * np.arange(POSES), rows) + 2.0 * np.tile(np.arange(rows), POSES)
    state = STATE.rows(np.arange(POSES))
    added = rng.standard_normal((3, n))
    if kind == "pose":
        added += 1.5 * np.repeat(rng.standard_normal((3, POSES)), rows, axis=1)
    if kind == "level":
        level = np.zeros(3)
        for k, gap in enumerate(np.diff(t_s, prepend=-1e9)):
            kept = np.exp(-gap / 24.0)
            level = kept * level + np.sqrt(1 - kept**2) * rng.standard_normal(3)
            added[:, k] += 1.5 * level
    columns = {
        "t_s": t_s,
        "inc_ref_deg": np.repeat(np.degrees(state.inc_rad), rows),
        "tf_ref_deg": np.repeat(np.degrees(state.tf_rad), rows),
        "pose": np.repeat(np.arange(POSES, dtype=float), rows),
    }
    accel = np.repeat(MODEL.predict(state), rows, axis=1) + SIGMA * added
    return pose_session(columns, accel, gravity_mps2=9.80665)


def base_of(session: PoseSession) -> np.ndarray:
    return Observed(session.state, session.mean).jacobian(MODEL, deck.FREE)


def nats(session: PoseSession) -> float:
    known = rows_memory(session, base_of(session))
    assert known is not None
    return known.nats


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_level_that_forgets_is_told_from_errors_of_the_poses(seed: int) -> None:
    assert nats(session_of("level", seed)) > ROWS_MEMORY.found
    assert nats(session_of("pose", seed)) < -ROWS_MEMORY.found
    assert nats(session_of("white", seed)) < ROWS_MEMORY.found


def test_long_poses_are_asked_by_means_of_stretches() -> None:
    few, many = session_of("level", 4, rows=16), session_of("level", 4, rows=160)
    assert many.rows is not None
    known = rows_memory(many, base_of(many))
    assert known is not None and nats(few) > ROWS_MEMORY.found
    kept = many.select(np.arange(3, POSES))
    assert kept.rows is not None and kept.rows.values.shape == (3, 160 * (POSES - 3))
    assert kept.rows.pose[0] == 0 and kept.rows.pose[-1] == POSES - 4


def test_scatter_that_the_rows_show_to_be_noise_is_a_wandering_offset() -> None:
    for kind, verdict in (("level", "wander"), ("pose", "unknown")):
        session = session_of(kind, 5)
        found, _ = with_remembering_rows(session, base_of(session), DiagnosisResult("unknown"), REPORT)
        assert found.verdict == verdict
    session = session_of("level", 5)
    located = DiagnosisResult("unknown", (Location(("ax",), "temp_c", (), None, 1.0, 1e-9),))
    assert with_remembering_rows(session, base_of(session), located, REPORT)[0] is located


def test_scatter_that_the_rows_cannot_tell_from_noise_is_not_testable() -> None:
    session = session_of("white", 7, rows=2)
    assert abs(nats(session)) < ROWS_MEMORY.found
    found, _ = with_remembering_rows(session, base_of(session), DiagnosisResult("unknown"), REPORT)
    assert found.verdict == "not_testable"
    assert "hold each pose longer" in found.remainder.hints[0]


def test_single_rows_say_nothing() -> None:
    session = session_of("level", 6, rows=1)
    assert rows_memory(session, base_of(session)) is None
