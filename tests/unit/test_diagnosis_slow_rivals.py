"""Slow effects beside one another: what a wandering offset makes look decisive is not, what white noise decides is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import chdtrc

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import time_constants
from highside.diagnosis.core.memory import Likelihoods, Memory, SlowEffect, SlowScore, slow_scores
from highside.diagnosis.core.policy import RIVALS
from highside.diagnosis.core.rival_refit import beside_refits
from highside.diagnosis.core.rivals import Refitted, Rivalry, beside_memory
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies.scenario import random_sensor

N = 240
T_S = 60.0 * np.arange(N)
TEMP = np.interp(np.arange(N), [0, 60, 130, 170, 239], [25.0, 55.0, 30.0, 45.0, 25.0])
SIZE = 0.2
"""of the temperature's effect, in units of the white noise per degree"""


def lagging(poses: float) -> NDArray[np.float64]:
    """(n,) how far a body that follows the temperature lags behind it."""
    inside = np.empty(N)
    inside[0] = TEMP[0]
    for k in range(1, N):
        inside[k] = inside[k - 1] + (TEMP[k] - inside[k - 1]) / poses
    return inside - TEMP


SHAPES = [TEMP - 25.0, *(lagging(length) for length in (3.0, 10.0, 30.0, 100.0))]
SLOW = [SlowEffect(0, 0, SHAPES[0][None]), *(SlowEffect(1, j, f[None]) for j, f in enumerate(SHAPES[1:]))]


def rivalry_of(seed: int, walk: float) -> tuple[Rivalry, float]:
    """How temperature and lag compare where temperature acted beside a walk of that size, with memory and without."""
    rng = np.random.default_rng(seed)
    readings = SIZE * SHAPES[0] + rng.standard_normal(N) + walk * np.cumsum(rng.standard_normal(N))
    channel = Likelihoods(readings, np.ones(N), np.ones((1, N)), T_S)
    rows = np.array(SHAPES)
    white = channel.with_each(rows[:0], rows)[0]
    # of the lag the best of four, at what four tries cost
    decided = float(white[0] - (white[1:].min() + 2 * np.log(4.0)))
    scores, _, _ = slow_scores([channel], SLOW)
    blank = Rivalry(np.full(2, np.inf), [Term(0, 0), Term(1, 0)], (1,))
    return beside_memory(blank, scores, Term(1, 0), set()), decided


def test_a_rival_is_of_the_class_where_it_comes_within_6_in_bic() -> None:
    far = Rivalry(np.array([0.0, 100.0, 100.0]), [Term(0, 0), Term(1, 0), Term(2, 0)], (0,))
    assert beside_refits(far, [Refitted(Term(1, 0), 5.0), Refitted(Term(2, 0), 7.0)]).same == (0, 1)


def test_a_random_walk_is_believed_from_a_gain_of_12_on() -> None:
    weak, plain = (Memory(gain, 0.1, np.inf, 0.2) for gain in (11.0, 13.0))
    assert (weak.is_random_walk, plain.is_random_walk) == (False, True)
    assert not Memory(13.0, 0.1, 4.0, 0.2).is_random_walk, "its memory ends"


def test_what_a_walk_makes_look_decisive_leaves_the_true_one_in_the_class() -> None:
    found = [rivalry_of(seed, 0.2) for seed in range(60)]
    misled = [r for r, decided in found if decided > RIVALS.same_class_bic]
    assert len(misled) > 10
    assert sum(0 not in r.same for r in misled) <= 0.1 * len(misled)


def test_white_noise_still_decides_between_them() -> None:
    found = [rivalry_of(seed, 0.0)[0] for seed in range(20)]
    # the true one is better by more than a class is wide: no claim of the other would stand alone
    assert np.median([r.delta_bic[0] for r in found]) < -RIVALS.same_class_bic


@pytest.mark.parametrize(("behind", "in_class"), [(0.0, True), (4.0, True), (5.9, True), (6.1, False), (20.0, False)])
def test_a_rival_is_of_one_class_with_the_claim_until_it_costs_six_in_bic(behind: float, in_class: bool) -> None:
    """6 in BIC is a ratio of 20 in evidence (Kass and Raftery 1995: strong)."""
    scores = [SlowScore(SLOW[0], 9.0, 0.0, 50.0), SlowScore(SLOW[1], 9.0, 0.0, 50.0 - behind)]
    blank = Rivalry(np.full(2, np.inf), [Term(0, 0), Term(1, 0)], (0,))
    assert (1 in beside_memory(blank, scores, Term(0, 0), set()).same) is in_class


def test_a_walk_is_believed_from_the_gain_at_which_white_noise_hardly_ever_feigns_one() -> None:
    """A gain of 12 in -2 log likelihood: white noise has it less than once in a hundred channels, a walk whose steps
    are a fifth of the noise in 80 % of 120 poses; half of those would not reach 40."""
    rng = np.random.default_rng(5)
    white = rng.standard_normal((200, 120))
    walks = white + 0.2 * np.cumsum(rng.standard_normal((200, 120)), axis=1)
    t_s = 60.0 * np.arange(120)

    def believed(channels: NDArray[np.float64]) -> float:
        found = [Likelihoods(one, np.ones(120), np.ones((1, 120)), t_s).memory(np.empty((0, 120))) for one in channels]
        return float(np.mean([memory.is_random_walk for memory in found]))

    assert believed(white) <= 0.01
    assert believed(walks) >= 0.65  # 3 % is a standard deviation of the share of 200


def test_a_slow_effect_is_judged_by_the_channels_that_it_acts_on_alone() -> None:
    rng = np.random.default_rng(4)
    stepped = (np.arange(N) >= 100).astype(float)
    walks = np.cumsum(rng.standard_normal(N))
    readings = [rng.standard_normal(N) + stepped, rng.standard_normal(N) + walks, rng.standard_normal(N)]
    channels = [Likelihoods(r, np.ones(N), np.ones((1, N)), T_S) for r in readings]
    of_one = np.zeros((3, N))
    of_one[0] = stepped
    (single,), (gain,), (evidence,) = slow_scores(channels, [SlowEffect(0, 0, of_one)])
    assert single.log_p == pytest.approx(-np.log10(chdtrc(1, gain)))
    # what another channel remembers is no matter of this one's
    assert single.remaining < 10.0
    assert evidence < 100.0
    (every,), (gain,), (evidence,) = slow_scores(channels, [SlowEffect(0, 0, np.tile(stepped, (3, 1)))])
    assert every.log_p == pytest.approx(-np.log10(chdtrc(3, gain)))
    assert min(every.remaining, evidence) > 100.0


def test_what_is_claimed_already_is_no_rival() -> None:
    blank = Rivalry(np.array([40.0, 0.0]), [Term(0, 0), Term(1, 0)], (1,))
    rng = np.random.default_rng(1)
    channel = Likelihoods(rng.standard_normal(N) + 0.03 * SHAPES[0], np.ones(N), np.ones((1, N)), T_S)
    scores, _, _ = slow_scores([channel], SLOW)
    found = beside_memory(blank, scores, Term(1, 0), {0})
    assert found.same == (1,)
    assert found.delta_bic[0] == pytest.approx(40.0)


@given(
    length=st.floats(30.0, 1e5),
    n=st.integers(10, 5000),
    effect=st.sampled_from(["warmup", "thermal_lag"]),
)
def test_time_constants_are_tried_from_the_shortest_to_the_longest_that_a_recording_tells_apart(
    length: float, n: int, effect: str
) -> None:
    shape = next(p for p in get(effect).parameters if p.shape)
    state = ChainState.build(np.zeros(n), np.zeros(n), t_s=np.linspace(0.0, length, n))
    tried = np.array(time_constants(shape, state))
    assert set(shape.grid) <= set(tried)
    low, high = shape.gate
    assert tried[0] >= low and tried[-1] <= high
    # none is further from the next than by a factor of two; those left out are over at once, or bend hardly at all
    assert np.all((tried[1:] > tried[:-1]) & (tried[1:] <= 2.1 * tried[:-1]))
    assert tried[0] < 2 * max(low, 0.03 * length, length / (n - 1)) or tried[0] == shape.grid[0]
    assert tried[-1] >= min(length, high)


def test_a_warm_up_that_outlasts_the_session_is_one_class_with_a_drift() -> None:
    state = ChainState.build(
        np.tile(np.linspace(0.1, 2.5, 12), 20), np.repeat(np.linspace(0.0, 6.0, 20), 12), t_s=60.0 * np.arange(N)
    )
    rng = np.random.default_rng(5)
    mean = random_sensor(rng).with_effects({"bias_drift": {"d_y": 2e-8}}).predict(state)
    mean += 2e-5 * rng.standard_normal((3, N))
    free = ("bias", "scale", "misalignment")
    diagnosis, _ = diagnose_poses(PoseSession(mean, np.ones(N), state), ForwardModel.of({}), free)
    assert [c.effect for c in diagnosis.claims] == ["bias_drift"]
    assert "warmup" in diagnosis.claims[0].equivalence_class
