"""A time that is off and an error of the toolface that is straight in the rate are the same readings."""

import numpy as np

from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.laws.chain import OF_ROTATION, chain_problem
from highside.diagnosis.laws.search import Search
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

SIGMA = 1e-4
FREE = ("bias", "scale")
PLAIN = ForwardModel.of({})


def turning(seed: int, n: int = 250) -> ChainState:
    """At one inclination, at a rate that changes and a temperature that does."""
    rng = np.random.default_rng(seed)
    t = 0.5 * np.arange(n)
    rate = np.radians(60 + 40 * np.sin(2 * np.pi * t / 70))
    temp = 30 + 10 * np.sin(2 * np.pi * t / 160 + 1) + rng.normal(0, 0.2, n)
    return ChainState.build(np.full(n, 0.7), np.cumsum(rate) * 0.5, t_s=t, temp_c=temp, rotor_rate_radps=rate)


def test_a_time_that_is_off_is_told_with_the_error_of_the_toolface_that_it_may_be() -> None:
    state = turning(1)
    late = 2e-3 * np.sin(np.asarray(state.temp_c) / 4)
    slope = np.asarray(PLAIN.pose_sensitivity(state)[:, 2]) * np.asarray(state.rotor_rate_radps)
    noise = SIGMA * np.random.default_rng(2).normal(size=(3, state.n))
    observed = Observed(state, PLAIN.predict(state) + slope * late + noise)
    model, residual = base_fit(PLAIN, observed, FREE)
    base = observed.jacobian(model, FREE)
    floor = np.full((3, state.n), SIGMA)
    problem = chain_problem(model, state, residual, base, floor, places=OF_ROTATION)
    found = Search(problem).run()
    (term,), alike = found.terms, found.class_of(0)
    told = [(g.place, frozenset(g.depends_on)) for g in alike]
    assert (term.group.place, frozenset(term.group.depends_on)) in told
    assert {("timing", frozenset({"temp"})), ("toolface", frozenset({"temp", "rate"}))} <= set(told)
