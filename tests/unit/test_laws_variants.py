"""What a bench may follow, what sets in midway, what acts on all axes; and classes of places that do the same."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from highside.diagnosis.core.fit import Observed, base_fit
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.identified_noise import with_identified_noise
from highside.diagnosis.laws.chain import chain_problem
from highside.diagnosis.laws.claims import reported_laws
from highside.diagnosis.laws.classes import classes_of
from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup, groups_of
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.variants import onset_knots, variants_of
from highside.physics.covariates import lag_of
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.memory import low_pass
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

FREE = ("bias", "scale", "misalignment")
SIGMA = 2e-5
PLAIN = ForwardModel.of({})


def session(seed: int, n: int, *, tilts: bool = True) -> ChainState:
    rng = np.random.default_rng(seed)
    t = 60.0 * np.arange(n) + rng.uniform(0, 10, n)
    return ChainState.build(
        np.radians(rng.uniform(10, 170, n) if tilts else np.full(n, 40.0)),
        np.radians(rng.uniform(0, 360, n)),
        t_s=t,
        temp_c=35 + 15 * np.sin(2 * np.pi * t / t[-1] * 1.7 + seed) + rng.normal(0, 0.5, n),
    )


def problem_of(state: ChainState, added: np.ndarray, seed: int, scatter: np.ndarray | float = 0.0) -> LawProblem:
    noise = np.random.default_rng(seed).normal(0, SIGMA, (3, state.n))
    angles = PLAIN.pose_sensitivity(state)[:, [0, 2]].transpose(1, 0, 2)
    observed = Observed(state, PLAIN.predict(state) + added + noise + angles[0] * scatter)
    model, residual = base_fit(PLAIN, observed, FREE)
    floor = np.full((3, state.n), SIGMA)
    base = observed.jacobian(model, FREE)
    return chain_problem(model, state, residual, base, floor, jitter=angles, every_pair=True)


def kinds(found: Found) -> list[tuple[str, str, tuple[str, ...]]]:
    return [(t.group.place, "".join(t.group.kind[1]), t.group.depends_on) for t in found.terms]


def inclination_error(state: ChainState, value: np.ndarray) -> np.ndarray:
    return np.asarray(PLAIN.pose_sensitivity(state)[:, 0] * value)


def test_a_bench_that_bends_under_the_load_on_an_axis_is_found() -> None:
    state = session(1, 60)
    load = gravity_direction(state.inc_rad, state.tf_rad)
    found = Search(problem_of(state, inclination_error(state, 3e-4 * np.tanh(3 * load[1])), 2)).run()
    assert kinds(found) == [("inclination", "inc", ("load_y",))]


def test_at_one_inclination_a_load_is_the_toolface_and_no_angle_follows_it() -> None:
    state = session(3, 40, tilts=False)
    groups = groups_of(problem_of(state, np.zeros((3, 40)), 4))
    assert not [g for g in groups if g.place in ("inclination", "toolface") and "load_x" in g.depends_on]


def test_a_scale_factor_that_follows_another_load_is_no_product() -> None:
    state = session(4, 80)
    load = gravity_direction(state.inc_rad, state.tf_rad)
    added = np.zeros_like(load)
    added[2] = 2e-3 * load[2] * np.tanh(3 * load[0] - 1)
    found = Search(problem_of(state, added, 5)).run()
    assert kinds(found) == [("scale", "z", ("load_x",))]


@FURTHER
def test_a_product_of_any_two_covariates_is_found() -> None:
    state = session(5, 90)
    load = gravity_direction(state.inc_rad, state.tf_rad)
    value = 6e-4 * np.sin((state.temp_c - 35) / 7) * load[0]
    found = Search(problem_of(state, inclination_error(state, value), 6)).run()
    assert [(place, channel, set(names)) for place, channel, names in kinds(found)] == [
        ("inclination", "inc", {"load_x", "temp"})
    ]


def test_offsets_of_all_axes_that_follow_one_quantity_are_one_law() -> None:
    state = session(7, 60)
    added = np.array([[2e-4], [-3e-4], [4e-4]]) * np.tanh((state.temp_c - 33) / 5)
    found = Search(problem_of(state, added, 8)).run()
    assert kinds(found) == [("offset", "xyz", ("temp",))]


def test_a_product_on_all_axes_each_in_its_own_way_is_one_law() -> None:
    state = session(7, 70)
    surface = np.sin((state.temp_c - 35) / 6) * np.cos(2.0 * state.inc_rad)
    search = Search(problem_of(state, np.array([[4e-4], [-3e-4], [5e-4]]) * surface, 8))
    # as a search finds it, axis by axis
    alone = [g for g in search.groups if g.place == "offset" and set(g.depends_on) == {"inc", "temp"}]
    white = search._whitened(search._learn([], search.problem.residual)).of_groups(alone)
    terms = [LawTerm(group, prior) for group, prior in zip(alone, white.scores([], within=np.inf)[1], strict=True)]
    found = search._found(search._on_all_axes(search._learn(terms, search.problem.residual)))
    assert [(place, channel, set(names)) for place, channel, names in kinds(found)] == [
        ("offset", "xyz", {"inc", "temp"})
    ]


def test_a_law_that_sets_in_midway_is_found_with_its_onset() -> None:
    state = session(9, 80)
    began = float(state.t_s[36])
    load = gravity_direction(state.inc_rad, state.tf_rad)
    value = 8e-4 * np.where(state.t_s >= began, np.cos(2 * load[1]), 0.0)
    found = Search(problem_of(state, inclination_error(state, value), 10)).run()
    assert kinds(found) == [("inclination", "inc", ("load_y", "time"))]
    (onset,) = found.terms[0].group.axes[1].functions
    assert onset.kind == "step"
    assert abs(onset.numbers[0] - (began - state.t_s[0])) < 180.0


def test_an_onset_has_values_on_either_side() -> None:
    t = np.arange(10.0)
    knots = onset_knots(t)
    assert knots.min() > t[2] - 1 and knots.max() < t[-3] + 1
    assert not onset_knots(np.arange(4.0)).size


def test_effects_of_the_library_and_products_set_in_nowhere() -> None:
    posed = problem_of(session(11, 30), np.zeros((3, 30)), 12)
    pair = next(g for g in groups_of(posed) if len(g.axes) == 2 and "time" not in g.depends_on)
    assert not [g for g in variants_of(posed, pair) if any(f.kind == "step" for a in g.axes for f in a.functions)]


def test_a_lean_of_the_level_and_an_error_of_the_inclination_are_one_class() -> None:
    state = session(13, 60)
    found = Search(problem_of(state, inclination_error(state, 4e-4 * np.sin(state.temp_c / 5)), 14)).run()
    own = found.class_of(0)
    assert {(g.place, g.kind[1], g.depends_on) for g in own} >= {
        ("inclination", ("inc",), ("temp",)),
        ("level", ("x",), ("temp",)),
    }


def test_a_law_that_another_set_as_likely_has_in_its_place_is_in_its_class() -> None:
    state = session(13, 60)
    search = Search(problem_of(state, inclination_error(state, 4e-4 * np.sin(state.temp_c / 5)), 14))
    found = search.run()
    (term,) = found.terms

    def first(place: str, *names: str, channel: str = "x") -> LawTerm:
        at = (g for g in search.groups if g.place == place and g.depends_on == names and g.kind[1][0] == channel)
        return LawTerm(next(at), term.prior)

    def class_beside(*others: list[LawTerm]) -> list[str]:
        return [g.label for g in classes_of(found.whitened(), [term], others)[0]()]

    own = class_beside()
    instead = first("offset", "load_y", channel="z")
    assert instead.group.label not in own
    assert instead.group.label in class_beside([instead])
    # what stands beside the law itself is not in its place; nor is what follows all that it does and more
    assert class_beside([term, instead]) == own
    wider = next(g for g in search.groups if g.place == term.group.place and {"temp", "inc"} == set(g.depends_on))
    assert class_beside([LawTerm(wider, term.prior)]) == own
    # on other channels than its own none can do what it does
    across = first("offset", "load_x", channel="y")
    on_z = first("offset", "load_x", channel="z")
    assert across.group.label not in [g.label for g in classes_of(found.whitened(), [on_z], [[across]])[0]()]


def told(count: int, verdict: str, scatter: Callable[[np.random.Generator], np.ndarray]) -> DiagnosisResult:
    state = session(15, count)
    found = Search(problem_of(state, np.zeros((3, count)), 16, scatter(np.random.default_rng(17)))).run()
    assert not found.terms
    return with_identified_noise(DiagnosisResult(verdict), found)  # type: ignore[arg-type]


def test_large_errors_of_set_angles_in_few_poses_are_not_nothing() -> None:
    """A line of order 6.5 of the toolface, of strength 949 in 42 poses, was nothing."""
    made = told(42, "nothing_left_out", lambda rng: rng.normal(0, 4e-4, 42))
    assert made.verdict == "not_testable"
    assert "42 poses" in made.remainder.hints[0] and "deg of inclination" in made.remainder.hints[0]
    assert "record 72 poses" in made.remainder.hints[0]


@FURTHER
def test_errors_that_any_bench_makes_are_nothing_in_few_poses_too() -> None:
    """A table of steps of 0.018 deg: sessions of 23 good poses were not testable."""
    for seed in range(5):
        made = told(24, "nothing_left_out", lambda rng, seed=seed: rng.uniform(-1.57e-4, 1.57e-4, (seed + 1, 24))[-1])
        assert made.verdict == "nothing_left_out"


def test_errors_of_set_angles_that_take_little_are_nothing_and_no_scatter_above_the_floor() -> None:
    """They were told as readings that scatter 1.0 times more than they repeat, and were not testable."""
    state = session(15, 24)
    found = Search(problem_of(state, np.zeros((3, 24)), 16)).run()
    large = replace(found.noise, jitter=np.array([4e-4, *np.zeros(len(found.noise.jitter) - 1)]))
    made = with_identified_noise(DiagnosisResult("nothing_left_out"), replace(found, noise=large))
    assert (made.verdict, made.remainder.hints) == ("nothing_left_out", ())
    far = replace(large, factor=np.array([1.0, 12.0, 1.0]))
    made = with_identified_noise(DiagnosisResult("nothing_left_out"), replace(found, noise=far))
    assert made.verdict == "not_testable"
    assert made.remainder.hints[0].startswith("ay scatters 12.0 times more than it repeats")


@FURTHER
def test_small_errors_or_many_poses_are_nothing() -> None:
    assert told(24, "nothing_left_out", lambda rng: np.zeros(24)).verdict == "nothing_left_out"
    assert told(80, "nothing_left_out", lambda rng: rng.normal(0, 4e-4, 80)).verdict == "nothing_left_out"


@FURTHER
def test_scatter_that_is_errors_of_set_angles_is_no_unknown() -> None:
    made = told(80, "unknown", lambda rng: rng.normal(0, 4e-4, 80))
    assert made.verdict == "nothing_left_out"
    assert "errors of the set angles" in made.remainder.hints[0]


def test_readings_that_repeat_a_little_worse_beside_errors_of_the_angles_are_no_unknown() -> None:
    """Sizes on the grid of 1.35, 2.5 nats ahead of none, were something without a name in 42 good poses."""
    state = session(15, 42)
    scatter = np.random.default_rng(17).normal(0, 9e-5, 42)
    found = Search(problem_of(state, np.zeros((3, 42)), 16, scatter)).run()
    worse = replace(found.noise, factor=np.array([1.35, 1.35, 1.0]))
    for ahead, verdict in ((2.5, "nothing_left_out"), (9.0, "not_testable"), (13.0, "unknown")):
        made = replace(found, noise=worse, evidence=found.to_the_floor + ahead)
        assert with_identified_noise(DiagnosisResult("unknown"), made).verdict == verdict  # type: ignore[arg-type]


def test_the_time_constant_of_a_temperature_that_lags_is_estimated() -> None:
    steps = np.random.default_rng(3).uniform(15, 45, 12)
    state = replace(session(4, 60), temp_c=np.repeat(steps, 5))
    lagging = low_pass(state.t_s, np.asarray(state.temp_c), 640.0)
    added = np.zeros((3, state.n))
    added[1] = 3e-4 * np.tanh((lagging - lagging.mean()) / 6)
    problem = problem_of(state, added, 5)
    found = Search(problem, of_offsets(problem)).run()
    ((place, channel, (name,)),) = kinds(found)
    assert (place, channel) == ("offset", "y")
    # beside a curve that is not known 60 readings tell it to 24 s (Cramer-Rao, one standard deviation)
    assert abs(lag_of(name) - 640) < 3 * 24, name


def of_offsets(problem: LawProblem) -> list[LawGroup]:
    return [g for g in groups_of(problem) if g.place == "offset" and len(g.axes) == 1 and g.size > 2]


def test_a_coefficient_of_temperature_that_is_a_curve_of_the_inclination_predicts_other_poses() -> None:
    # two curves of many functions each would follow what is left of the other
    def bends(s: ChainState) -> np.ndarray:
        u = np.pi * np.degrees(s.inc_rad) / 180
        curve = 0.4 * np.cos(2 * u) + 0.8 * np.cos(3 * u) - 0.5 * np.cos(5 * u)
        return np.asarray(2e-3 * curve * (np.asarray(s.temp_c) - 31) / 15)

    state, other = session(6, 90), session(7, 90)
    problem = problem_of(state, inclination_error(state, bends(state)), 8)
    own = [g for g in groups_of(problem) if g.place == "inclination" and "temp" in g.depends_on]
    found = Search(problem, own).run()
    assert kinds(found) == [("inclination", "inc", ("inc", "temp"))]
    (law,) = (one.law for one in reported_laws(found))
    predicted = law.value([np.degrees(other.inc_rad), np.asarray(other.temp_c)])
    within = (np.asarray(other.temp_c) > np.min(state.temp_c)) & (np.asarray(other.temp_c) < np.max(state.temp_c))
    true = bends(other)
    assert np.sum((predicted - true)[within] ** 2) < 0.01 * np.sum(true[within] ** 2)


def test_a_place_that_does_what_another_does_is_tried_once_and_told() -> None:
    state = session(1, 40)
    problem = problem_of(state, inclination_error(state, 3e-4 * np.sin(np.asarray(state.temp_c) / 4)), 2)
    assert not any(g.place == "level" and g.kind[1] == ("x",) for g in groups_of(problem))
    own = [g for g in groups_of(problem) if g.place == "inclination" and len(g.axes) == 1]
    found = Search(problem, own).run()
    assert kinds(found) == [("inclination", "inc", ("temp",))]
    assert "level_x_temp" in [g.label for g in found.class_of(0)]
