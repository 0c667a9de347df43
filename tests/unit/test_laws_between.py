"""Numbers of a law between those that are tried: lags of a temperature, orders of the toolface; and ends of curves."""

from dataclasses import replace

import numpy as np
import pytest

from highside.diagnosis.laws.between import best_between, refined
from highside.diagnosis.laws.chain import covariate_values
from highside.diagnosis.laws.claims import reported_laws
from highside.diagnosis.laws.groups import LAGGING, groups_of
from highside.diagnosis.laws.noise import LawNoise
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.state import State
from highside.physics.covariates import COVARIATES, FILTERED, covariate, lag_of
from highside.physics.gravity import gravity_direction
from highside.physics.memory import low_pass
from highside.physics.state import ChainState
from tests.unit.test_laws_variants import inclination_error, kinds, problem_of, session


def of_places(problem: LawProblem, *places: str) -> Search:
    names = {"temp", *LAGGING, "temp_rate", "inc", "tf", "tf_fraction"}
    return Search(problem, [g for g in groups_of(problem) if g.place in places and names.issuperset(g.depends_on)])


def test_a_strong_curve_with_a_slope_at_both_ends_is_a_law_of_one_quantity() -> None:
    # cosines over the range visited leave of this one more than the noise, and a surface took its place
    def bends(s: ChainState) -> np.ndarray:
        u = (np.asarray(s.temp_c) - 35) / 15
        return np.asarray(0.02 * (1.5 * u + 0.8 * np.sin(4 * u + 0.5)))

    state, other = session(21, 80), session(22, 80)
    found = of_places(problem_of(state, inclination_error(state, bends(state)), 23), "inclination").run()
    assert kinds(found) == [("inclination", "inc", ("temp",))]
    (law,) = (one.law for one in reported_laws(found))
    temp = np.asarray(other.temp_c)
    within = (temp > np.min(state.temp_c)) & (temp < np.max(state.temp_c))
    left = (law.value([temp]) - bends(other))[within]
    assert np.std(left) < 0.003 * np.std(bends(other)[within])


@pytest.mark.parametrize("lag_s", [550, 1050])
def test_a_lag_between_those_of_the_list_is_estimated(lag_s: int) -> None:
    steps = np.random.default_rng(3).uniform(15, 45, 12)
    state = replace(session(4, 60), temp_c=np.repeat(steps, 5))
    lagging = low_pass(state.t_s, np.asarray(state.temp_c), float(lag_s))
    added = np.zeros((3, state.n))
    added[1] = 6e-3 * np.tanh((lagging - lagging.mean()) / 6)
    problem = problem_of(state, added, 5)
    found = Search(problem, [g for g in groups_of(problem) if g.place == "offset" and len(g.axes) == 1]).run()
    ((place, channel, (name,)),) = kinds(found)
    assert (place, channel) == ("offset", "y")
    assert abs(lag_of(name) / lag_s - 1) < 0.03, name


def test_a_strong_law_of_one_lag_is_no_surface() -> None:
    state = session(31, 70)
    lagging = low_pass(state.t_s, np.asarray(state.temp_c), 560.0)
    load = gravity_direction(state.inc_rad, state.tf_rad)
    added = np.zeros((3, state.n))
    added[1] = 0.02 * np.sin((lagging - 35) / 4) * load[1]
    found = of_places(problem_of(state, added, 32), "offset", "scale").run()
    ((place, channel, (name,)),) = kinds(found)
    assert (place, channel) == ("scale", "y")
    assert abs(lag_of(name) / 560 - 1) < 0.03, name


def test_an_order_of_the_toolface_between_those_that_are_tried_is_estimated() -> None:
    state = session(41, 90)
    added = np.zeros((3, state.n))
    added[2] = 5e-3 * np.cos(3.457 * np.asarray(state.tf_rad) + 1.0)
    found = of_places(problem_of(state, added, 42), "offset").run()
    (term,) = found.terms
    assert term.group.depends_on == ("tf_fraction",)
    assert abs(term.group.axes[0].functions[0].numbers[0] - 3.457) < 0.003


def test_what_a_large_law_is_is_refined_before_another_is_taken() -> None:
    # a line halfway between two orders that are tried, over 360 deg: at the best of these a sixtieth of it is left
    state = session(41, 90)
    line = np.cos(3.45 * np.asarray(state.tf_rad) + 1.0)
    for size, expected in ((5e-3, True), (5e-5, False)):
        added = np.zeros((3, state.n))
        added[2] = size * line
        search = of_places(problem_of(state, added, 42), "offset")
        problem = search.problem
        white = search._whitened(State([], LawNoise.floor_alone(problem), -np.inf, problem.residual))
        gains = white.scores([], within=np.inf)[0]
        assert (white.bounds([]) >= gains - 1e-6).all()
        found = refined(white, [], float(gains.max()))
        assert bool(found) is expected, (size, gains.max())
        if found:
            group, gain, _ = max(found, key=lambda one: one[1])
            assert group.depends_on == ("tf_fraction",)
            assert abs(group.axes[0].functions[0].numbers[0] - 3.45) < 0.003
            assert gain > gains.max() + 20.0


def test_an_order_of_the_toolface_is_refined_to_no_constant() -> None:
    # what leans all the time is no line of an order near nothing, which would be a constant where constants are free
    state = session(43, 60)
    search = of_places(problem_of(state, inclination_error(state, np.full(60, 0.01)), 44), "level")
    white = search._whitened(State([], LawNoise.floor_alone(search.problem), -np.inf, search.problem.residual))
    lines = [g for g in search.groups if g.depends_on == ("tf_fraction",)]
    low = min(lines, key=lambda g: float(g.axes[0].functions[0].numbers[0]))
    found = best_between(white, [], [low])
    assert found is not None
    assert float(found[0].axes[0].functions[0].numbers[0]) >= 0.1 - 1e-9


def test_a_temperature_of_any_lag_is_known_and_not_listed() -> None:
    assert "temp_filtered_613" in COVARIATES and "temp_filtered_613" not in list(COVARIATES)
    assert covariate("temp_filtered_613").title == "temperature that lags by 613 s"
    assert [lag_of(name) for name in ("temp", "temp_filtered_0", "temp_filtered_x", FILTERED[0])] == [0, 0, 0, 60]
    assert "temp_filtered_0" not in COVARIATES
    state = session(5, 20)
    values = covariate_values(state, gravity_direction(state.inc_rad, state.tf_rad))
    expected = covariate("temp_filtered_613").of(state, np.zeros((3, 20)), 0)
    np.testing.assert_allclose(values["temp_filtered_613"], expected)
    with pytest.raises(KeyError):
        values["temp_filtered_"]


def test_a_lag_that_the_session_does_not_show_is_not_told() -> None:
    # one slow warm-up: a temperature that lags is a curve of the temperature
    state = session(51, 60)
    state = replace(state, temp_c=45 - 20 * np.exp(-np.asarray(state.t_s) / 2500.0))
    added = np.zeros((3, state.n))
    added[0] = 6e-4 * np.tanh((np.asarray(state.temp_c) - 38) / 4)
    problem = problem_of(state, added, 52)
    found = Search(problem, [g for g in groups_of(problem) if g.place == "offset" and len(g.axes) == 1]).run()
    assert kinds(found) == [("offset", "x", ("temp",))]
    names = found.class_of(0)
    assert "temp_rate" in {name for group in names for name in group.depends_on}
