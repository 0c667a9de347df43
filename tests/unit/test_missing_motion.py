"""Beside another program's prediction: a motion that is missing from it is told as that, and no sensor's error is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from highside.arrays import Array
from highside.diagnosis.law_channels import _ChannelLaw, _without_motion
from highside.diagnosis.simulation.missing_turn import agreement, attitudes, missing_turn
from highside.diagnosis.simulation.motion import missing_motion, stretch
from highside.diagnosis.simulation.session import SimulationSession, simulation_session
from studies import simulation_honesty as study

MOTION = study.Motion(41)
STARTS_S, LASTS_S = 20.0, 6.0


def beside(added: Array, seed: int = 1) -> SimulationSession:
    clean = MOTION.at(study.T_S)
    rows = clean + added + study.SIGMA * np.random.default_rng(seed).standard_normal(clean.shape)
    recorded, predicted = (
        {"t_s": study.T_S, **dict(zip(study.NAMES, values, strict=True))} for values in (rows, clean)
    )
    return simulation_session(recorded, predicted)


def turned(largest_deg: float, axis: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Array:
    """(6, n) what a rotation about an axis of the tool and back again adds, for some seconds."""
    u = np.clip((study.T_S - STARTS_S) / LASTS_S, 0.0, 1.0)
    angle = np.radians(largest_deg) * np.sin(np.pi * u) ** 2
    clean, back = MOTION.at(study.T_S), Rotation.from_rotvec(-angle[:, None] * np.array(axis))
    rates = back.apply(clean[3:].T).T + np.outer(axis, np.degrees(np.gradient(angle, study.T_S)))
    return np.asarray(np.concatenate([back.apply(clean[:3].T).T, rates]) - clean)


@pytest.mark.parametrize("largest_deg", [0.5, 20.0])
def test_a_turn_is_told_with_its_time_its_size_and_its_axis(largest_deg: float) -> None:
    session = beside(turned(largest_deg))
    found = missing_turn(session, session.readings - session.predicted)
    assert found is not None and found.stretch_s is not None
    start, stop = found.stretch_s
    assert STARTS_S - 0.5 < start < stop < STARTS_S + LASTS_S + 0.5
    (words,) = found.seen
    assert "most of it about y" in words
    assert float(words.partition("by up to ")[2].partition(" ")[0]) == pytest.approx(largest_deg, rel=0.2)


@pytest.mark.parametrize("shown", ["gyros", "accelerometers", "neither"])
def test_what_one_kind_of_sensor_shows_alone_is_no_turn(shown: str) -> None:
    added = turned(2.0)
    added[:3] *= shown == "accelerometers"
    added[3:] *= shown == "gyros"
    session = beside(added)
    assert missing_turn(session, session.readings - session.predicted) is None


def test_a_delay_that_follows_time_is_no_turn() -> None:
    """It turns the tool as well, along its own motion; what it does to a motion along lines tells."""
    session = beside(study.made("delay by time", MOTION, 1e5))
    assert missing_turn(session, session.readings - session.predicted) is None


def test_slow_errors_of_either_kind_agree_by_chance_only() -> None:
    """What ends elsewhere than it begins has tails in every octave, which follow one another."""
    chances = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        walk = np.cumsum(rng.standard_normal((3, 600)), axis=1)
        wave = np.sin(2 * np.pi * 2.4 * np.arange(600) / 600 + rng.uniform(0.0, 6.0, (3, 1)))
        found = agreement(walk, 20 * wave + rng.standard_normal((3, 600)), 0.08)
        assert found is not None
        chances.append(found.p)
    assert min(chances) > 1e-3
    assert np.mean(np.array(chances) < 0.1) < 0.2


def test_attitudes_are_those_of_steps_one_after_the_other() -> None:
    rate = MOTION.at(np.arange(0.0, 4.0, 0.02))[3:] * np.pi / 180
    now, expected = Rotation.identity(), [Rotation.identity()]
    fine = MOTION.at(np.arange(0.0, 4.0 - 0.02, 0.0005) + 0.00025)[3:] * np.pi / 180
    for k, step in enumerate(Rotation.from_rotvec(fine.T * 0.0005), start=1):
        now = now * step
        if k % 40 == 0:
            expected.append(now)
    found = Rotation.from_quat(attitudes(rate, 0.02))
    apart = [(a.inv() * b).magnitude() for a, b in zip(found, expected, strict=False)]
    assert len(found) == rate.shape[1] and max(apart) < 1e-3


def test_a_stretch_is_told_where_the_power_is_and_none_where_it_is_everywhere() -> None:
    rng, kept = np.random.default_rng(3), np.ones(1200, dtype=bool)
    rows = rng.standard_normal((3, 1200))
    assert stretch(np.sum(rows**2, axis=0), kept, 3) is None
    rows[:, 500:700] *= 3.0
    found = stretch(np.sum(rows**2, axis=0), kept, 3)
    assert found is not None
    assert found[0] == pytest.approx(500, abs=25) and found[1] == pytest.approx(700, abs=25)


@pytest.mark.parametrize(("share", "told"), [(0.2, False), (0.9, True)])
def test_a_law_that_leaves_the_larger_part_to_a_motion_is_withdrawn(share: float, told: bool) -> None:
    session = beside(np.zeros((6, study.T_S.size)))
    rng = np.random.default_rng(4)
    shaken = sosfiltfilt(butter(2, [0.15, 0.4], "band", output="sos"), rng.standard_normal(session.n))
    shaken *= 20 * study.SIGMA[0] / shaken.std() * (np.abs(np.arange(session.n) / session.n - 0.4) < 0.1)
    left = session.readings - session.predicted
    left[0] += shaken
    sigma = study.SIGMA[:, 0]
    noise = SimpleNamespace(sigma=sigma, white=lambda rows: rows / sigma[:, None])
    problem: Any = SimpleNamespace(session=session, noise=noise)
    claim: Any = SimpleNamespace(effect="law:one", depends_on=("time",))
    law = _ChannelLaw(0, claim, claim, shaken * (1.0 - np.sqrt(1.0 - share)))
    laws, motion = _without_motion(problem, left, [law])
    assert (laws == [law]) is told and (motion is None) is told
    alone = missing_motion(session, left, noise.white(left))
    assert alone is not None and alone.stretch_s is not None
    if motion is not None:
        assert motion.words == alone.words
        assert "a motion is missing from the prediction, most of it from" in motion.words
        assert [name for name, _, _ in motion.rms] == ["ax_g"]
