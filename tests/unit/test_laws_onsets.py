"""Laws that set in midway: sought from each time on; a model of the next recording has them from its start."""

from dataclasses import replace

import numpy as np
import pytest

from highside.api.diagnosis import Diagnosis
from highside.config.model import Model
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.laws.acting import known_where_it_acted
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import LawGroup, groups_of
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.onsets import Onsets, begun, sets_in
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function
from highside.physics.state import ChainState
from highside.report.diagnosis_claims import law_words
from tests.unit.test_laws_variants import PLAIN, inclination_error, problem_of, session

STATE = session(21, 40)
T = STATE.t_s - STATE.t_s[0]
ONSET = float(T[15] + T[16]) / 2


def late(size: float, seed: int = 22, state: ChainState = STATE) -> LawProblem:
    """Errors of the inclination that follow the load on y, from the 17th pose on."""
    load = PLAIN.predict(state)
    return problem_of(state, inclination_error(state, size * np.sin(4 * load[1]) * (ONSET < T)), seed)


def onsets_of(posed: LawProblem, noise: LawNoise) -> Onsets:
    return Onsets(posed, Whitener(posed, noise), posed.residual)


def test_place_quantity_and_time_are_the_best_of_all_together() -> None:
    posed = late(3e-4)
    (gain, term), *others = onsets_of(posed, LawNoise.floor_alone(posed)).best([])
    step = term.group.axes[-1]
    assert (term.group.label, step.covariate) == ("inclination_inc_load_y_x_time", "time")
    assert T[15] < step.functions[0].numbers[0] < T[16]
    assert gain > 12 and all(gain > other for other, _ in others)


@pytest.mark.parametrize("angles", [0.0, 1e-4])
def test_a_gain_is_that_of_the_same_group_among_all_others(angles: float) -> None:
    posed = late(4e-4)
    noise = replace(LawNoise.floor_alone(posed), jitter=np.full(2, angles))
    beside = [LawTerm(groups_of(posed)[0], Prior(1e-9, 2.0))]
    gain, term = onsets_of(posed, noise).best(beside)[0]
    white = Whitened(Families(posed, [term.group]), Whitener(posed, noise), posed.residual)
    gains, priors = white.scores(beside)
    assert gain == pytest.approx(gains[0], rel=1e-6)
    assert (term.prior.size, term.prior.length) == pytest.approx((priors[0].size, priors[0].length))


def test_a_law_of_another_search_stays_where_it_is() -> None:
    posed = late(3e-4)
    onsets = onsets_of(posed, LawNoise.floor_alone(posed))
    term = onsets.best([])[0][1]
    assert onsets.moved([], replace(term)).group.axes == term.group.axes
    lagging = replace(term.group.axes[0], covariate="temp_filtered_650")
    other = replace(term, group=replace(term.group, axes=(lagging, term.group.axes[1])))
    assert onsets.moved([], other) is other


def angles_of(posed: LawProblem) -> list[LawGroup]:
    """The laws of the inclination among all that are tried."""
    return [group for group in groups_of(posed) if group.place == "inclination"]


@pytest.mark.parametrize(("size", "some"), [(3e-4, True), (0.0, False)])
def test_a_start_has_one_that_sets_in_or_is_none(size: float, some: bool) -> None:
    posed = late(size)
    floor, groups = LawNoise.floor_alone(posed), angles_of(posed)
    white = Whitened(Families(posed, groups), Whitener(posed, floor), posed.residual)
    runs = list(begun(onsets_of(posed, floor), white, groups))
    assert bool(runs) is some
    assert all(any(sets_in(t.group) for t in terms) for terms, _ in runs)


def test_what_sets_in_is_no_product_of_two_quantities() -> None:
    warmed = replace(STATE, temp_c=35 + 10 * np.tanh((T - ONSET) / 600) + np.sin(T))
    posed = late(3e-4, state=warmed)
    found = Search(posed, angles_of(posed)).run()
    assert [t.group.label for t in found.terms] == ["inclination_inc_load_y_x_time"]


def test_a_law_that_set_in_acts_all_the_time_in_the_next_session() -> None:
    curve = Axis("temp", 20.0, 40.0, (Function("one"), Function("cosine", (1.0,))))
    step = Axis("time", 0.0, 100.0, (Function("step", (60.0,)),))
    law = Law("offset_x_temp_x_time", "offset", ("x",), (curve, step), ((1.0, 0.5),))
    temp, time = np.array([25.0, 25.0]), np.array([10.0, 90.0])
    assert law.sets_in_s == 60.0
    assert law.value([temp, time])[0] == 0.0
    assert law.lasting().depends_on == ("temp",)
    assert law.lasting().value([temp]) == pytest.approx([law.value([temp, time])[1]] * 2)
    claim = Claim(law.id, "", None, "", {}, 1e-9, (law.id,), (), "", law=law.to_dict(), place="offset")
    told = replace(claim, channels=("ax",), depends_on=law.depends_on)
    next_one = Diagnosis(DiagnosisResult("law", claims=(told,)), None, Model(), "rec.csv").model()
    assert next_one is not None and next_one.known_laws == (law.lasting(),)
    assert law_words(told) == "an offset of ax that follows temperature, from 60 s on"
    alone = replace(law, axes=(step,), coefficients=((1.0,),))
    assert alone.lasting() is alone and alone.sets_in_s is None


@pytest.mark.parametrize("functions", ["wide_cosine", "bump"])
def test_a_law_that_set_in_is_known_where_it_acted(functions: str) -> None:
    """Its curve reaches over all temperatures that were visited; what it does at those of before it set in was a model
    that left fifty thousand times what there was."""
    posed = late(3e-4)
    group = next(g for g in groups_of(posed) if g.label == "inclination_inc_temp")
    temp = posed.covariates["temp"]
    acts = T >= ONSET
    low, high = float(temp[acts].min()), float(temp[acts].max())
    assert temp.min() < low or temp.max() > high
    whole = (float(temp.min()), float(temp.max()))
    made = (
        (Function("one"), *(Function("wide_cosine", (float(k),)) for k in range(1, 9)))
        if functions == "wide_cosine"
        else (Function("bump", (0.5 * sum(whole), 4.0)),)
    )
    onset = Axis("time", 0.0, float(T[-1]), (Function("step", (ONSET,)),))
    values = np.random.default_rng(3).standard_normal(len(made))
    spread = tuple(tuple(map(float, row)) for row in np.diag(values**2))
    law = Law(
        "late", "inclination", ("inc",), (Axis("temp", *whole, made), onset), (tuple(map(float, values)),), spread
    )
    known = known_where_it_acted(posed, group, law)
    assert (known.axes[0].low, known.axes[0].high) == (low, high) and known.axes[1] == onset
    at = np.linspace(low, high, 57)
    late_on = np.full(57, T[-1])
    size = float(np.max(np.abs(law.value([at, late_on]))))
    np.testing.assert_allclose(known.value([at, late_on]), law.value([at, late_on]), atol=1e-3 * size)
    np.testing.assert_allclose(known.std([at, late_on]), law.std([at, late_on]), rtol=0.02)
    width = high - low
    for beyond in (low - width, high + width):
        assert abs(float(known.lasting().value([np.array([beyond])])[0])) < 1e-6 * size
    assert known_where_it_acted(posed, group, law.lasting()) == law.lasting()
