"""Laws are found where they are, judged on another session; where there is none, noise of any kind is none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.laws.chain import chain_problem
from highside.diagnosis.laws.claims import reported_laws
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.few_values_policy import FEW_VALUES
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.ladder import LadderNoise
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.noise_filters import ladder_lengths, level_lengths
from highside.diagnosis.laws.noise_policy import LAW_NOISE
from highside.diagnosis.laws.policy import LAW_EVIDENCE, LAW_SEARCH
from highside.diagnosis.laws.priors import Prior, best_priors
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.state import State
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

FREE = ("bias", "scale", "misalignment")
SIGMA = 2e-5
PLAIN = ForwardModel.of({})

Law = Callable[[ChainState], np.ndarray]


def session(seed: int, n: int = 60) -> ChainState:
    rng = np.random.default_rng(seed)
    t = 60.0 * np.arange(n) + rng.uniform(0, 10, n)
    temp = 35 + 15 * np.sin(2 * np.pi * t / t[-1] * 1.7 + seed) + rng.normal(0, 0.5, n)
    return ChainState.build(
        np.radians(rng.uniform(10, 170, n)),
        np.radians(rng.uniform(0, 360, n)),
        t_s=t,
        temp_c=temp,
        direction=rng.choice([-1.0, 1.0], n),
    )


def axis(k: int) -> np.ndarray:
    return np.eye(3)[k][:, None]


def offset_of_temp(state: ChainState) -> np.ndarray:
    return axis(0) * 2e-4 * np.tanh((state.temp_c - 35) / 5)


def scale_of_temp(state: ChainState) -> np.ndarray:
    load = gravity_direction(state.inc_rad, state.tf_rad)
    return axis(2) * load * 4e-4 * np.cos(state.temp_c / 6)


def inclination_of_inclination(state: ChainState) -> np.ndarray:
    return PLAIN.pose_sensitivity(state)[:, 0] * 3e-4 * np.sin(2.3 * state.inc_rad + 0.4)


def toolface_of_toolface(state: ChainState) -> np.ndarray:
    return PLAIN.pose_sensitivity(state)[:, 2] * 6e-4 * np.sin(3 * state.tf_rad + 1)


def problem(state: ChainState, readings: np.ndarray) -> tuple[ForwardModel, LawProblem]:
    observed = Observed(state, readings)
    model, residual = base_fit(PLAIN, observed, FREE)
    tangents = model.pose_sensitivity(state)[:, [0, 2]].transpose(1, 0, 2)
    base = observed.jacobian(model, FREE)
    floor = np.full(readings.shape, SIGMA)
    return model, chain_problem(model, state, residual, base, floor, jitter=tangents)


def few_poses(state: ChainState, readings: np.ndarray) -> LawProblem:
    """Means of poses, as a session hands them over: few values, laws of every pair of covariates."""
    return replace(problem(state, readings)[1], every_pair=True)


def closed(found: Found, law: Law) -> float:
    """Share of the law's true contribution on another session, off what is free there, that the learnt one predicts."""
    other = session(991)
    true = law(other).reshape(-1)
    learnt = PLAIN.with_laws([one.law for one in reported_laws(found)]).predict(other) - PLAIN.predict(other)
    free = PLAIN.jacobian(other, FREE).reshape(12, -1)
    off = np.eye(true.size) - np.linalg.pinv(free) @ free
    true, left = off @ true, off @ (true - learnt.reshape(-1))
    return 1 - float(left @ left) / float(true @ true)


@pytest.mark.parametrize(
    ("law", "place", "channel", "covariate"),
    [
        (offset_of_temp, "offset", "x", "temp"),
        (scale_of_temp, "scale", "z", "temp"),
        (inclination_of_inclination, "inclination", "inc", "inc"),
        (toolface_of_toolface, "toolface", "tf", "tf"),
    ],
)
def test_a_law_is_found_in_its_place_and_predicts_another_session(
    law: Law, place: str, channel: str, covariate: str
) -> None:
    state = session(4)
    noise = SIGMA * np.random.default_rng(5).normal(size=(3, state.n))
    _, posed = problem(state, PLAIN.predict(state) + law(state) + noise)
    found = Search(posed).run()
    assert [(t.group.place, t.group.units[0].channel, t.group.depends_on) for t in found.terms] == [
        (place, channel, (covariate,))
    ]
    assert closed(found, law) > 0.9
    claim = reported_laws(found)[0].claim
    assert claim.stable
    assert claim.share == pytest.approx(1.0)
    assert claim.heldout_gain is not None
    assert claim.heldout_gain > 100


def coloured(kind: str, state: ChainState, rng: np.random.Generator) -> np.ndarray:
    white = SIGMA * rng.normal(size=(3, state.n))
    if kind == "random walk":
        return white + np.cumsum(SIGMA * 0.7 * rng.normal(size=(3, state.n)), axis=1)
    if kind == "first order":
        level = np.zeros((3, state.n))
        for k in range(1, state.n):
            level[:, k] = 0.9 * level[:, k - 1] + SIGMA * rng.normal(size=3)
        return white / 2 + level
    if kind == "1/f":
        frequency = np.maximum(np.fft.rfftfreq(state.n), 1 / state.n)
        drawn = rng.normal(size=(3, frequency.size)) + 1j * rng.normal(size=(3, frequency.size))
        pink = np.fft.irfft(drawn / np.sqrt(frequency), state.n)
        return white / 2 + 3 * SIGMA * pink / pink.std()
    angles = 3 * SIGMA * rng.normal(size=(2, state.n))
    across = PLAIN.pose_sensitivity(state)
    return white + across[:, 0] * angles[0] + across[:, 2] * angles[1]


@pytest.mark.parametrize("kind", ["random walk", "first order", "1/f", "set angles"])
def test_noise_is_no_law(kind: str) -> None:
    state = session(6, 48)
    _, posed = problem(state, PLAIN.predict(state) + coloured(kind, state, np.random.default_rng(8)))
    white = Whitened(Families(posed, groups_of(posed)), Whitener(posed, LawNoise.floor_alone(posed)), posed.residual)
    # with the floor alone it would be one
    assert white.scores([])[0].max() > 12
    assert Search(posed).run().terms == ()


@pytest.mark.parametrize("shaken", [(2,), pytest.param((0, 2), marks=FURTHER)])
def test_noise_far_above_the_floor_bars_a_law_from_its_own_channels_alone(shaken: tuple[int, ...]) -> None:
    state = session(21, 14)
    rng = np.random.default_rng(21)
    noise = SIGMA * rng.normal(size=(3, state.n))
    for channel in shaken:
        noise[channel] += 50 * SIGMA * rng.normal(size=state.n)
    found = Search(few_poses(state, PLAIN.predict(state) + 6 * offset_of_temp(state) + noise)).run()
    # of 14 values on one channel a law can gain 23 nats beside noise that is learnt, 60 times the floor before it
    assert [t.group.label for t in found.terms] == ([] if 0 in shaken else ["offset_x_temp"])
    if found.terms:
        assert found.noise.times_the_floor(found.problem)[0] < 1.5
        assert found.gains[0] < FEW_VALUES.gain


@pytest.mark.parametrize(("floor", "asked"), [(SIGMA / 40, True), (SIGMA / 1e6, False)])
def test_only_noise_far_above_a_measured_floor_has_laws_chosen_one_by_one(
    floor: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = list[int]()
    monkeypatch.setattr(Search, "_next_by_evidence", lambda search, _: begun.append(search.problem.n))
    state = session(6, 14)
    readings = PLAIN.predict(state) + SIGMA * np.random.default_rng(6).normal(size=(3, state.n))
    posed = replace(few_poses(state, readings), floor=np.full(readings.shape, floor))
    assert Search(posed).run().terms == ()
    assert begun == ([state.n] if asked else [])


def test_the_gain_of_a_group_is_the_ratio_of_two_densities() -> None:
    state = session(9, 30)
    rng = np.random.default_rng(10)
    _, posed = problem(state, PLAIN.predict(state) + offset_of_temp(state) + SIGMA * rng.normal(size=(3, 30)))
    search = Search(posed, [g for g in groups_of(posed) if g.label in ("offset_x_temp", "scale_z_temp")])
    white = Whitened(search.families, Whitener(search.problem, LawNoise.floor_alone(search.problem)), posed.residual)
    gains, priors = white.scores([])
    group, prior = search.groups[0], priors[0]
    # by the covariance of the readings outside of what is free
    free = (search.problem.free / SIGMA).reshape(len(search.problem.free), -1)
    outside = np.linalg.svd(free)[2][len(free) :]
    reading = outside @ (posed.residual / SIGMA).reshape(-1)
    columns = np.zeros((group.size, 3, 30))
    columns[:, list(group.channels)] = group.columns()
    columns = (columns / SIGMA).reshape(group.size, -1) @ outside.T
    whole = np.eye(len(reading)) + columns.T @ np.diag(prior.variances(group.orders)) @ columns
    want = 0.5 * (reading @ reading - reading @ np.linalg.solve(whole, reading) - np.linalg.slogdet(whole)[1])
    assert gains[0] == pytest.approx(want, rel=1e-6)


def test_no_other_prior_of_the_grid_does_better() -> None:
    rng = np.random.default_rng(11)
    rows = rng.normal(size=(6, 40))
    gram, drive = (rows @ rows.T)[None], (rows @ rng.normal(size=40) * 3)[None]
    gain, size, length = best_priors(gram, drive, np.arange(1.0, 7.0)[None])
    variances = size[0] * (1 + (np.arange(1, 7) / length[0]) ** 2) ** -2.0
    whole = np.diag(1 / variances) + gram[0]
    want = 0.5 * (drive[0] @ np.linalg.solve(whole, drive[0]) - np.linalg.slogdet(whole)[1] - np.sum(np.log(variances)))
    assert gain[0] == pytest.approx(want, rel=1e-9)


@pytest.mark.parametrize("kind", ["white", "random walk", "1/f", "set angles"])
def test_groups_that_are_not_kept_whitened_score_the_same(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    state = session(6, 40)
    posed = problem(state, PLAIN.predict(state) + 6 * offset_of_temp(state) + 6 * scale_of_temp(state))[1]
    assert posed.jitter is not None
    ones = np.ones(3)
    noise = {
        "white": LawNoise.floor_alone(posed),
        "random walk": replace(LawNoise.floor_alone(posed), share=40 * ones, length=1e6 * ones),
        "1/f": replace(LawNoise.floor_alone(posed), ladder=5 * ones),
        "set angles": replace(LawNoise.floor_alone(posed), jitter=np.full(len(posed.jitter), 3 * SIGMA)),
    }[kind]
    found = []
    for room in (10**9, 0):
        monkeypatch.setitem(LAW_EVIDENCE.__dict__, "kept", room)
        monkeypatch.setitem(LAW_EVIDENCE.__dict__, "raw", room)
        white = Whitened(Families(posed, groups_of(posed)), Whitener(posed, noise), posed.residual)
        gains, priors = white.scores([], within=np.inf)
        best = int(np.argmax(gains))
        terms = [LawTerm(white.families.groups[best], priors[best])]
        found.append(np.stack([gains, white.scores(terms, within=np.inf)[0]]))
    assert np.isfinite(found[0]).any()
    # functions of which the terms leave a millionth part have gains that rounding moves by some hundredths
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6, atol=0.1)


@pytest.mark.parametrize("n", [60, 4500])
def test_the_longest_level_is_a_walk_to_sessions_of_any_length(n: int) -> None:
    """Of a thousand steps it forgot within a fourth of 4,500 values, and the drift of a walk was worth 46 nats."""
    t = np.arange(n) * 0.04
    lengths = level_lengths(t)
    assert lengths[-1] >= LAW_NOISE.spans_of_a_walk * np.ptp(t) * 0.999
    assert ladder_lengths(t)[-1] >= LAW_NOISE.spans_of_a_ladder * np.ptp(t) * 0.999
    if n == 60:
        np.testing.assert_allclose(lengths, 0.04 * np.array(LAW_NOISE.lengths))


def test_the_ladder_whitens_as_its_covariance_does() -> None:
    rng = np.random.default_rng(12)
    t = np.cumsum(rng.uniform(0.5, 2, 25))
    white, lengths = rng.uniform(0.5, 2, 25), ladder_lengths(t)
    apart = np.abs(t[:, None] - t)
    covariance = np.diag(white) + 0.7 * np.exp(-apart[:, :, None] / lengths).sum(axis=2)
    made = LadderNoise.of(white, t, 0.7, lengths)
    column = rng.normal(size=(1, 25))
    assert made.log_determinant[0] == pytest.approx(np.linalg.slogdet(covariance)[1])
    turned = made.white(column)[0]
    assert float(turned[0] @ turned[0]) == pytest.approx(column[0] @ np.linalg.solve(covariance, column[0]))


def test_a_formula_is_reported_where_it_predicts_as_well_as_the_curve() -> None:
    state = session(13, 90)
    noise = SIGMA * np.random.default_rng(14).normal(size=(3, state.n))
    readings = PLAIN.predict(state) + axis(1) * 6e-4 * (state.temp_c > 40) + noise
    found = Search(problem(state, readings)[1]).run()
    claim = reported_laws(found)[0].claim
    assert claim.depends_on == ("temp",)
    assert claim.formula is not None
    assert "[temp >= " in claim.formula


def test_without_a_second_session_of_its_own_the_floor_is_not_raised_by_the_misfit() -> None:
    state = session(15, 48)
    strong = PLAIN.predict(state) + 100 * offset_of_temp(state)
    noise = SIGMA * np.random.default_rng(16).normal(size=(3, state.n))
    found = Search(problem(state, strong + noise)[1]).run()
    assert [t.group.depends_on for t in found.terms][:1] == [("temp",)]
    assert found.noise.factor.max() < 1.5


def test_a_place_that_acts_by_rounding_alone_is_none() -> None:
    """A gyro across the axis of the turn has no rate to scale: what is left of one are the last digits of the other."""
    t = 0.01 * np.arange(4000)
    tf, rate = 2.0 * t + 6.0 * np.sin(0.3 * t), 2.0 + 1.8 * np.cos(0.3 * t)
    state = ChainState.build(np.full(t.size, 0.5), tf, t_s=t, temp_c=20 + t / 4, rotor_rate_radps=rate)
    posed = chain_problem(PLAIN, state, np.zeros((6, t.size)), np.zeros((0, 6, t.size)), np.ones((6, t.size)))
    places = {(one.place, one.channel) for one in posed.places}
    assert {("gyro_scale", "z"), ("gyro_offset", "x"), ("gyro_offset", "y"), ("scale", "y")} <= places
    assert not places & {("gyro_scale", "x"), ("gyro_scale", "y")}
    for one in posed.places:
        assert np.abs(one.field).max() > 1e-6


def at_one_inclination(seed: int, n: int = 150) -> tuple[ChainState, np.random.Generator]:
    rng = np.random.default_rng(seed)
    t = 2.0 * np.arange(n)
    temp = 35 + 5 * np.sin(2 * np.pi * t / t[-1] * 1.3 + seed)
    return ChainState.build(np.full(n, np.radians(60.0)), rng.uniform(0, 2 * np.pi, n), t_s=t, temp_c=temp), rng


def test_curves_of_three_sensors_are_no_lean_of_the_level() -> None:
    """At one inclination a lean, two curves, took two of them, and the third had the rest, as functions of the
    toolface; in the load that they follow the three are worth more."""
    state, rng = at_one_inclination(0)
    load = PLAIN.predict(state)[1]
    effect = 5e-4 * np.outer([0.9, -1.2, -1.3], np.abs(load) ** 1.5)
    _, posed = problem(state, PLAIN.predict(state) + effect + SIGMA * rng.normal(size=(3, state.n)))
    found = Search(posed).run()
    assert sorted(t.group.units[0].channel for t in found.terms) == ["x", "y", "z"]
    assert all(t.group.place == "offset" and t.group.depends_on[0].startswith("load") for t in found.terms)


@pytest.mark.parametrize("with_name", [True, False])
def test_a_search_ends_where_what_is_known_is_found_again_or_is_out_of_reach(with_name: bool) -> None:
    """A name that explains it all needs no second look once it is found among laws; laws alone, far behind, none."""
    state, rng = at_one_inclination(1)
    # what the name does to two channels in one proportion, no law does
    load, warm, turn = PLAIN.predict(state), (state.temp_c - 35) / 10, 3 * state.tf_rad
    column = axis(0) * load[1] * warm + axis(2) * np.sin(turn) * warm**2
    _, posed = problem(state, PLAIN.predict(state) + 4e-3 * column + SIGMA * rng.normal(size=(3, state.n)))
    own = EffectGroup.of("name", column[None], posed.floor)
    among = Search(posed, [*groups_of(posed), own])
    known = among.beside([own], [])
    search = among if with_name else among.without_effects()
    starts = list[str]()
    with pytest.MonkeyPatch.context() as patch:
        for name in ("_from_curves", "_from_onsets"):
            patch.setattr(Search, name, lambda self, state, name=name: starts.append(name) or state)
        found = search.run(known)
        ended = list(starts)
        search.run()
    assert ended == []
    assert starts
    assert [t.group.effect for t in found.terms if t.group.effect] == (["name"] if with_name else [])
    assert with_name == (found.evidence > known.evidence - LAW_SEARCH.hopeless)


def test_a_law_that_was_taken_for_noise_is_as_large_as_beside_the_floor_alone() -> None:
    """Noise as large as half of a law, learnt beside the law at a size that is far too small, is no end of a search."""
    state = session(7, 120)
    law = offset_of_temp(state) * 20
    noise = SIGMA * np.random.default_rng(8).normal(size=(3, state.n))
    search = Search(problem(state, PLAIN.predict(state) + law + noise)[1])
    group = next(g for g in search.groups if g.label == "offset_x_temp")
    beside = search._learn([LawTerm(group, Prior(1e-12, 1.0))], search.problem.residual)
    assert beside.noise.times_the_floor(search.problem).max() > 3.0
    made = search._beside_less_noise(beside)
    assert [t.group for t in made.terms] == [group]
    assert made.evidence > beside.evidence + 100.0
    assert made.noise.times_the_floor(search.problem).max() < 1.3
    # at the floor there is nothing to do
    assert search._beside_less_noise(made) is made


def test_as_many_laws_as_may_be_taken_first_are_refitted_without_another() -> None:
    # five effects in one session ended in an error where a way of the search began with four
    state = session(12)
    _, own = problem(state, offset_of_temp(state) + scale_of_temp(state))
    search = Search(own)
    wanted = [("offset", "x"), ("scale", "z"), ("inclination", "inc"), ("toolface", "tf")]
    groups = [next(g for g in search.groups if (g.place, g.units[0].channel) == one) for one in wanted]
    terms = [LawTerm(group, Prior(1.0, 1.0)) for group in groups]
    assert len(terms) == LAW_SEARCH.most_first
    made = search._grown(State(terms, LawNoise.floor_alone(own), -np.inf, own.residual), relearn=False)
    assert len(made.terms) == len(terms)
    assert {("offset", ("temp",)), ("scale", ("temp",))} <= {(t.group.place, t.group.depends_on) for t in made.terms}
