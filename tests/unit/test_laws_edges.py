"""Several steps of one session are found together, at their places; one over the temperature stays one."""

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.config.model import Model
from highside.diagnosis.laws.edges import several_edges
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from tests.unit.test_laws_search import PLAIN, SIGMA, axis, problem, session

FURTHER = pytest.mark.further

STATE = session(31, 100)
T = STATE.t_s - STATE.t_s[0]
FIRST, SECOND = (float(T[k - 1] + T[k]) / 2 for k in (30, 64))


def posed(added: np.ndarray, seed: int = 32) -> LawProblem:
    """The session with something added and white noise, every pair tried as in poses."""
    noise = SIGMA * np.random.default_rng(seed).normal(size=(3, STATE.n))
    return problem(STATE, PLAIN.predict(STATE) + added + noise)[1]


def sets(known: LawProblem, run: int = 0) -> list[list[tuple[str, str, str, float]]]:
    """Of a run, the first of steps in time alone: channel, covariate, kind, place of each edge, from set to set."""
    found = list(several_edges(known, groups_of(known), known.residual))[run]
    return [
        [
            (t.group.units[0].channel, t.group.depends_on[0], f.kind, f.numbers[0])
            for t in terms
            for f in t.group.axes[0].functions
        ]
        for terms in found
    ]


def test_two_steps_of_one_offset_are_put_where_they_are() -> None:
    known = posed(axis(2) * (3e-4 * (T >= FIRST) - 2.5e-4 * (T >= SECOND)))
    assert sorted(sets(known)[1]) == [
        ("z", "time", "step", pytest.approx(FIRST)),
        ("z", "time", "step", pytest.approx(SECOND)),
    ]
    assert len(sets(known)) == 2


def test_a_step_over_the_temperature_is_one() -> None:
    known = posed(axis(1) * 3e-4 * (STATE.temp_c > 40))
    (only,) = sets(known, run=1)
    ((channel, covariate, _, at),) = only
    assert (channel, covariate) == ("y", "temp")
    below, above = STATE.temp_c[STATE.temp_c <= 40].max(), STATE.temp_c[STATE.temp_c > 40].min()
    assert below < at < above


def test_without_anything_there_is_no_edge() -> None:
    assert sets(posed(np.zeros((3, STATE.n)))) == []


def test_terms_are_worth_more_together_than_each_by_itself() -> None:
    known = posed(axis(2) * (3e-4 * (T >= FIRST) - 2.5e-4 * (T >= SECOND)))
    search = Search(known)
    steps = [g for g in search.groups if g.kind[:2] == ("offset", ("z",)) and len(g.axes[0].functions) == 1]
    terms = list(several_edges(known, steps, known.residual))
    two = list(terms[0])[1]
    found = search.beside([t.group for t in two], [])
    both, alone = found.gain_of([0, 1]), found.gains
    assert both > max(alone)
    assert found.only([0]).gains[0] < found.evidence - found.only([]).evidence


def two_steps(seed: int) -> dict[str, np.ndarray]:
    """A session by hand of 64 poses, z up by 0.6 mg and down by 0.5."""
    rng, n = np.random.default_rng(seed), 64
    inc, tf = rng.uniform(10, 120, n), rng.uniform(0, 360, n)
    i, t = np.radians(inc), np.radians(tf)
    t_s = 40.0 * np.arange(n)
    read = np.stack([np.sin(i) * np.cos(t), np.sin(i) * np.sin(t), np.cos(i)])
    read[2] += 6e-4 * (t_s >= 900.0) - 5e-4 * (t_s >= 1700.0)
    rows = read.repeat(4, 1) + 5e-5 * rng.standard_normal((3, 4 * n))
    columns = {"t_s": (t_s[:, None] + np.arange(4.0)).ravel(), "inc_ref_deg": inc.repeat(4), "tf_ref_deg": tf.repeat(4)}
    return columns | {"pose": np.arange(float(n)).repeat(4)} | dict(zip(("ax_g", "ay_g", "az_g"), rows, strict=True))


@FURTHER
def test_two_steps_are_told_although_a_random_walk_may_do_what_each_does() -> None:
    found = diagnose(two_steps(6), Model()).found
    places = [
        float(claim.law["axes"][0]["functions"][0][1]) if claim.law else claim.parameters["t0"].value
        for claim in found.claims
    ]
    assert found.verdict in ("law", "named", "named_plus")
    assert sorted(places) == [pytest.approx(900.0, abs=40.0), pytest.approx(1700.0, abs=40.0)]
