"""Of what a search found, what is told: not the session's own time where another session can vary something as good, no
formula that the curve refutes, no law that predicts worse than the others do without it."""

from collections.abc import Callable
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from test_laws_search import FREE, PLAIN, SIGMA, axis, problem, scale_of_temp

from highside.arrays import Array
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.laws import claims
from highside.diagnosis.laws.beside import Beside
from highside.diagnosis.laws.chain import chain_problem
from highside.diagnosis.laws.claims import heldout, proved, reported_laws
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.formulas import _Form, _peaks_between, _Scored, forms_of
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup, groups_of
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.other_than_time import _as_good
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.separable import as_product
from highside.physics.gravity import gravity_direction
from highside.physics.law import Axis
from highside.physics.law_functions import Function
from highside.physics.state import ChainState


def warming(seed: int, n: int = 60) -> ChainState:
    """Poses of which the temperature rises once, ever slower: it runs with the time."""
    rng = np.random.default_rng(seed)
    t = 60.0 * np.arange(n) + rng.uniform(0, 10, n)
    inc, tf = np.radians(rng.uniform(10, 170, n)), np.radians(rng.uniform(0, 360, n))
    return ChainState.build(inc, tf, t_s=t, temp_c=20 + 30 * (1 - np.exp(-t / 1500)), direction=np.ones(n))


def found_in(state: ChainState, effect: Array, seed: int, places: frozenset[str]) -> Found:
    readings = gravity_direction(state.inc_rad, state.tf_rad) + effect
    readings = readings + np.random.default_rng(seed).normal(0, SIGMA, readings.shape)
    _, posed = problem(state, readings)
    return Search(posed, [g for g in groups_of(posed) if g.place in places]).run()


def named(group: LawGroup) -> tuple[str, ...]:
    return group.depends_on


def test_what_another_session_can_vary_stands_in_the_place_of_the_time() -> None:
    state = warming(3)
    # of the time it is one slow wave, of the temperature a curve that is steep where the session was long
    load = gravity_direction(state.inc_rad, state.tf_rad)
    effect = axis(2) * load * 3e-4 * np.sin(2 * np.pi * state.t_s / state.t_s[-1])
    found = found_in(state, effect, 4, frozenset({"scale"}))
    # as it lags or not: that is not to be known here
    assert [named(term.group)[0].split("_")[0] for term in found.terms] == ["temp"]
    assert ("time",) in [named(group) for group in found.class_of(0)]


def test_what_the_time_alone_does_stays_a_law_of_the_time() -> None:
    state = warming(3)
    state = replace(state, temp_c=20 + np.random.default_rng(5).normal(0, 3, state.n))
    load = gravity_direction(state.inc_rad, state.tf_rad)
    effect = axis(2) * load * 3e-4 * np.sin(2 * np.pi * state.t_s / state.t_s[-1])
    assert [named(term.group) for term in found_in(state, effect, 4, frozenset({"scale"})).terms] == [("time",)]


def test_what_is_far_behind_a_law_of_the_time_does_not_take_its_place() -> None:
    """Whatever ran along with the time: 20 nats behind it is another law."""
    state = warming(3)
    load = gravity_direction(state.inc_rad, state.tf_rad)
    effect = axis(2) * load * 3e-4 * np.sin(2 * np.pi * state.t_s / state.t_s[-1])
    found = found_in(state, effect, 4, frozenset({"scale"}))
    (term,), problem = found.terms, found.problem
    time, of_it = (
        next(g for g in found.families.groups if g.depends_on == (name,) and g.kind[:2] == term.group.kind[:2])
        for name in ("time", "temp")
    )
    whitener = Whitener(problem, found.noise)
    among = Whitened(Families(problem, [time, of_it]), whitener, found.residual)
    (gain, _), priors = among.scores([], within=np.inf)
    own = [LawTerm(time, priors[0])]
    for behind, taken in ((10.0, True), (LAW_CLASS.same_confounded + 1.0, False)):
        with mock.patch.object(among, "scores", return_value=(np.array([gain, gain - behind]), priors)):
            assert (_as_good(among, own, 0) is not None) == taken


def law_of_temp(seed: int, ripple: float) -> Found:
    """A bump over the temperature in few poses, and of a part of it a wave beside it."""
    rng = np.random.default_rng(seed)
    n = 30
    inc, tf = np.radians(rng.uniform(10, 170, n)), np.radians(rng.uniform(0, 360, n))
    state = ChainState.build(inc, tf, t_s=60.0 * np.arange(n), temp_c=rng.uniform(0, 60, n), direction=np.ones(n))
    temp = state.temp_c
    effect = axis(0) * (2e-3 * np.exp(-0.5 * ((temp - 31.3) / 6.2) ** 2) + ripple * np.sin(temp / 9))
    readings = gravity_direction(state.inc_rad, state.tf_rad) + effect + rng.normal(0, SIGMA, (3, n))
    model, residual = base_fit(PLAIN, observed := Observed(state, readings), FREE)
    posed = chain_problem(model, state, residual, observed.jacobian(model, FREE), np.full((3, n), SIGMA))
    groups = [g for g in groups_of(posed) if g.place == "offset" and g.depends_on == ("temp",)]
    return Search(posed, groups).run()


@pytest.mark.parametrize("seed", range(3))
def test_a_formula_is_told_only_where_the_curve_follows_nothing_else(seed: int) -> None:
    (true,) = reported_laws(law_of_temp(seed, 0.0))
    assert true.law.formula and "exp(-((temp - 31.3" in true.law.formula
    for one in reported_laws(law_of_temp(seed, 2e-4)):
        assert not one.law.formula, one.law.formula


def test_no_formula_does_far_more_where_nothing_was_measured() -> None:
    """Of a bump at 30 C the foot alone was seen: how high it is nobody knows."""
    bump, span = (Function("bump", (30.0, 2.0)),), Axis("temp", 0.0, 60.0, (Function("one"),))
    form = _Scored(_Form("bump", [bump], 3), bump, np.array([0.5, 0.2]), np.eye(2), 0.0, np.zeros((3, 0)))
    assert _peaks_between(form, span, np.array([*np.linspace(0, 24, 20), *np.linspace(36, 60, 20)]))
    assert not _peaks_between(form, span, np.linspace(0, 60, 20))


@pytest.mark.parametrize(("low", "high"), [(24.0, 36.0), (29.0, 31.0)])
def test_a_step_whose_place_nothing_tells_is_told_and_predicts_as_a_curve(low: float, high: float) -> None:
    """Between 24 and 36 C no pose was: where the step is nobody knows, and a law of it would be as sure there."""
    rng, n = np.random.default_rng(7), 60
    temp = np.where(np.arange(n) % 2 == 0, rng.uniform(10.0, low, n), rng.uniform(high, 50.0, n))
    temp[:2] = low, high
    inc, tf = np.radians(rng.uniform(10, 170, n)), np.radians(rng.uniform(0, 360, n))
    state = ChainState.build(inc, tf, t_s=60.0 * np.arange(n), temp_c=temp, direction=np.ones(n))
    (law,) = reported_laws(found_in(state, axis(0) * 1e-3 * (temp > 30.0), 8, frozenset({"offset"})))
    std = law.law.std([np.array([30.0, low, high])])
    assert law.claim.formula is not None and "[temp >= " in law.claim.formula
    assert bool(law.law.formula) == (high - low < 10.0)
    assert law.law.formula or std[0] > 3.0 * std[1:].max()


def of_two(temp: Array, inc: Array) -> Array:
    return 2e-4 * np.tanh((temp - 30) / 6) * np.sin(3 * inc)


def of_both(temp: Array, inc: Array) -> Array:
    return 2e-4 * np.sin(3 * inc + temp / 6)


def predicted(found: Found, law: Callable[[Array, Array], Array]) -> float:
    """Share of the variance of a law of the temperature and the inclination that the one told has between its ends."""
    temp, inc = np.meshgrid(np.linspace(12, 48, 25), np.linspace(0.3, 2.8, 25))
    (one,) = reported_laws(found)
    values = {"temp": temp.ravel(), "inc": np.degrees(inc.ravel())}
    told = one.law.value([values[name] for name in one.law.depends_on]).reshape(temp.shape)
    true = law(temp, inc)
    return 1.0 - float(np.var(told - true) / np.var(true))


def surface(law: Callable[[Array, Array], Array], n: int) -> Found:
    rng = np.random.default_rng(21)
    inc, tf = np.radians(rng.uniform(10, 170, n)), np.radians(rng.uniform(0, 360, n))
    state = ChainState.build(inc, tf, t_s=60.0 * np.arange(n), temp_c=rng.uniform(10, 50, n), direction=np.ones(n))
    readings = gravity_direction(inc, tf) + axis(1) * law(state.temp_c, inc) + rng.normal(0, SIGMA, (3, n))
    model, residual = base_fit(PLAIN, observed := Observed(state, readings), FREE)
    posed = chain_problem(model, state, residual, observed.jacobian(model, FREE), np.full((3, n), SIGMA))
    return Search(posed, [g for g in groups_of(posed) if g.label == "offset_y_inc_x_temp"]).run()


def test_a_surface_that_is_a_product_is_told_as_one_and_predicts_more(monkeypatch: pytest.MonkeyPatch) -> None:
    found = surface(of_two, 70)
    as_it_is = predicted(found, of_two)
    monkeypatch.setattr(claims, "as_product", lambda *given: None)
    assert as_it_is > 0.95
    assert as_it_is > predicted(found, of_two) + 0.02


def test_a_surface_that_is_no_product_stays_a_surface() -> None:
    found = surface(of_both, 120)
    assert found.terms and as_product(found.whitened(), list(found.terms), 0) is None


def test_a_law_that_predicts_worse_than_the_others_alone_goes() -> None:
    state = warming(6)
    state = replace(state, temp_c=35 + np.random.default_rng(7).normal(0, 8, state.n))
    found = found_in(state, scale_of_temp(state), 8, frozenset({"scale", "offset"}))
    assert proved(found).terms == found.terms
    other = next(g for g in groups_of(found.problem) if g.place == "offset" and g.depends_on == ("inc",))
    # a curve as large as that follows the noise
    more = LawTerm(other, Prior(1e3, 1.0))
    classes = (*found.classes, lambda: (other,))
    both = replace(found, terms=(*found.terms, more), gains=(*found.gains, 99.0), classes=classes)
    assert heldout(both.whitened(), list(both.terms), len(found.terms)) < 0
    assert proved(both).terms == found.terms


def test_a_law_that_is_alone_goes_too_if_it_says_little_of_other_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """A level over time that followed one outlying pose of heavy tails gained 5 nats on values held out."""
    state = warming(6)
    found = found_in(state, scale_of_temp(state), 8, frozenset({"scale"}))
    assert len(found.terms) == 1 and proved(found) is found
    for gain, kept in ((5.0, 0), (13.0, 1)):
        monkeypatch.setattr(claims, "heldout", lambda *given, gain=gain: gain)
        assert len(proved(found).terms) == kept


@pytest.mark.parametrize("distinct", [2, 3])
def test_two_values_show_a_line_and_no_other_formula(distinct: int) -> None:
    supply = np.linspace(4.8, 5.2, distinct)[np.arange(60) % distinct]
    names = [form.name for form in forms_of("supply_v", supply + 1e-9 * np.sin(np.arange(60)))]
    assert (names == ["linear"]) == (distinct == 2)


def test_a_formula_that_the_other_laws_hold_already_gains_nothing() -> None:
    """Nothing is left of it beside them, and a system of nothing has no solution: the command ended by an error."""
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((3, 1, 40))
    residual = rng.standard_normal((1, 40))
    twice = np.repeat(columns[:1], 2, axis=0)[None]
    for own in (twice, np.zeros((2, 2, 1, 40))):
        gains, _, means = Beside(columns, np.zeros(3), residual).fitted(own)
        assert np.isfinite(means).all()
        np.testing.assert_allclose(gains, 0.0, atol=1e-3)
