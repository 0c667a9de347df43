"""What the tool is doing, from the data: stops found, motion never taken for a stop, thresholds from its own record."""

from __future__ import annotations

import numpy as np

from highside.gyro.blocks import Batch, Block
from highside.gyro.frames import DEG_PER_HOUR, to_body
from highside.gyro.gates import DWELL_S, LEARN_S, Gate, MotionState, quiet_rows
from highside.gyro.stop_test import stop_agrees
from highside.papers.drift_scenarios import (
    DriftExperiment,
    drilling,
    record,
    rotating_table,
    turntable,
    vibration_table,
)


def _blocks(experiment: DriftExperiment, seed: int) -> list[Block]:
    data = record(experiment, seed)
    return Batch.of(experiment.t_s, to_body(data.rate), to_body(data.accel)).blocks()


def _verdicts(experiment: DriftExperiment, seed: int = 1) -> np.ndarray:
    gate = Gate()
    return np.array([gate.verdict(block) for block in _blocks(experiment, seed)])


def test_stops_between_drilling_are_found_after_the_dwell() -> None:
    experiment = drilling(600.0, 50.0, leg_s=200.0, stop_s=40.0)
    verdicts = _verdicts(experiment)
    ends = np.arange(verdicts.size) + 1.0
    vibrating = experiment.vibrating[np.minimum((ends * 50).astype(int) - 1, experiment.t_s.size - 1)]
    assert not ((verdicts == MotionState.STILL) & vibrating).any()
    for begin, end in experiment.rest[1:]:
        inside = (ends > begin + 1 + DWELL_S) & (ends <= end)
        assert (verdicts[inside] == MotionState.STILL).mean() > 0.95
    assert not (verdicts[: int(LEARN_S) - 1] == MotionState.STILL).any()


def test_weak_vibration_while_the_tool_drifts_is_no_stop() -> None:
    # from quiet (1 mg) towards drilling (1 g): each level for an hour
    for level in (0.004, 0.02, 0.3):
        experiment = drilling(3600.0, 20.0, leg_s=1e6, vibration_rms_g=level)
        verdicts = _verdicts(experiment)
        assert not (verdicts[52:] == MotionState.STILL).any()


def test_a_turning_table_is_turning_and_never_still() -> None:
    still = turntable(40.0, 50.0)
    turning = rotating_table(30.0, 200.0, 50.0)
    gate = Gate()
    for block in _blocks(still, 1):
        gate.verdict(block)
    verdicts = [gate.verdict(block) for block in _blocks(turning, 1)]
    assert set(verdicts) <= {MotionState.TURNING}


def test_a_record_that_begins_in_motion_gives_no_thresholds() -> None:
    for experiment in (vibration_table(60.0), rotating_table(30.0, 60.0)):
        gate = Gate()
        verdicts = [gate.verdict(block) for block in _blocks(experiment, 1)]
        assert gate.still is None
        assert MotionState.STILL not in verdicts
        # a table that turns evenly lets gravity be believed, one that shakes does not
        data = record(experiment, 1)
        quiet, _ = quiet_rows(data.experiment.t_s, data.rate, data.accel, np.zeros((0, 2)))
        assert quiet.all() if experiment.name == "rotating table" else not quiet.any()


def test_a_declared_stop_is_believed_at_once() -> None:
    gate = Gate()
    assert all(gate.verdict(block, declared=True) is MotionState.STILL for block in _blocks(vibration_table(10.0), 1))


def test_the_gate_leaves_at_once_and_returns_after_the_dwell() -> None:
    blocks = _blocks(turntable(60.0, 50.0), 1)
    gate = Gate()
    for block in blocks[:30]:
        last = gate.verdict(block)
    assert last is MotionState.STILL
    shaken = blocks[30].vector.copy()
    shaken[22] = 0.5
    assert Block(shaken).norm_std == 0.5
    assert gate.verdict(Block(shaken)) is MotionState.VIBRATING
    after = [gate.verdict(block) for block in blocks[31:36]]
    assert after[0] is MotionState.QUIET
    assert after[-1] is MotionState.STILL


def test_the_stop_test_refuses_a_slow_real_turn_and_forgives_when_it_ends() -> None:
    rng = np.random.default_rng(1)
    arw, known = 3e-5, ((0.5 * DEG_PER_HOUR) ** 2,) * 3
    stop = [0.0] * 5

    def seen(rate_dph: float, seconds: int) -> list[bool]:
        turn = np.array([0.0, 0.0, rate_dph * DEG_PER_HOUR])
        return [stop_agrees(stop, tuple(turn + arw * rng.standard_normal(3)), 1.0, known, arw) for _ in range(seconds)]

    at_rest, moving, after = seen(0.0, 500), seen(30.0, 100), seen(0.0, 200)
    assert all(at_rest)
    assert moving.index(False) < 20
    assert not any(moving[20:])
    assert all(after[-60:])
