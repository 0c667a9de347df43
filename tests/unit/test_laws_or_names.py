"""Where names and laws compete: an effect with a shape of its own, laws that fit as well, covariates that are one."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.config.model import Model
from highside.diagnosis.laws.claims import reported_laws
from highside.diagnosis.laws.effects import Columns, EffectGroup
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup, groups_of
from highside.diagnosis.laws.instead import names_instead
from highside.diagnosis.laws.problem import LawProblem, PlaceField
from highside.diagnosis.laws.search import Search
from highside.physics.covariates import COVARIATES, joined, parted
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.law_functions import Function
from highside.report.diagnosis_claims import confounded, title_of_any
from studies import known_names, random_laws
from studies.diagnosis_deck import diagnosed
from tests.bench.diagnosis_speed import poses

FURTHER = pytest.mark.further

KINDS = ("white", "coloured", "one_over_f", "walk")


@pytest.mark.parametrize(
    ("number", "effect"),
    [
        pytest.param(48, "bias_step", marks=FURTHER),
        pytest.param(61, "cogging", marks=FURTHER),
        (75, "bias_drift"),
        (59, "encoder_first_harmonic"),
    ],
)
def test_an_effect_in_noise_with_a_memory_has_its_name_and_not_that_of_a_law(number: int, effect: str) -> None:
    kind = KINDS[number // len(known_names.EFFECTS)]
    assert known_names.EFFECTS[number % len(known_names.EFFECTS)] == effect
    columns, _, _ = known_names.case(1, number, effect, kind)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = diagnose(columns, Model())
    assert [claim.effect for claim in found.claims] == [effect]
    assert found.verdict == "named"
    assert known_names.outcome(found.to_dict(), effect) == "right"


def test_a_law_that_fits_as_well_as_a_name_is_in_its_class() -> None:
    one = random_laws.case(101, 1, null=False)
    found = diagnose(one.columns, Model.model_validate({"sensor": {"noise_g": one.noise_g}}))
    (claim,) = found.claims
    assert not claim.effect.startswith("law:")
    assert one.truth & set(claim.equivalence_class)
    # and whoever reads one sentence knows that it is a tie, with what, and what would end it
    assert all_effects()[claim.effect].splitter in claim.next_manoeuvre
    first, _, tie, *_ = str(found).splitlines()
    assert ", or what cannot be told from it here (" in first
    assert tie == f"  {confounded(claim)}"


@FURTHER
def test_a_law_that_fits_better_than_a_name_is_told_with_what_cannot_be_told_from_it() -> None:
    # an offset of z that follows the load: a quadratic stood for it, and a law is 15 nats ahead with all noise learnt
    one = random_laws.case(101, 3, null=False)
    found = diagnose(one.columns, Model.model_validate({"sensor": {"noise_g": one.noise_g}}))
    (claim,) = found.claims
    assert claim.effect.startswith("law:")
    assert one.truth & set(claim.equivalence_class)


def test_a_name_of_which_one_amplitude_shows_is_held_beside_a_law_of_that_channel_as_one() -> None:
    # 264 poses and the square of the load on x alone: the law was 4.4 nats ahead of a square on each axis, and is 2.3
    found = diagnosed(poses(11))
    assert [claim.effect for claim in found.claims] == ["quadratic"]
    assert "law:offset_x_load" in found.claims[0].equivalence_class


def scaled_by_inclination(n: int = 80) -> tuple[LawProblem, LawGroup]:
    """A scale factor of x that follows the inclination, where the load on z is the cosine of that."""
    rng = np.random.default_rng(5)
    inc, tf = rng.uniform(5, 175, n), rng.uniform(0, 360, n)
    load = np.stack(
        [np.sin(np.radians(inc)) * np.cos(np.radians(tf)), np.sin(np.radians(inc)) * np.sin(np.radians(tf))]
    )
    field = np.zeros((3, n))
    field[0] = load[0]
    covariates = {"inc": inc, "load_z": np.cos(np.radians(inc)), "temp": rng.uniform(10, 60, n)}
    floor = np.full((3, n), 1e-4)
    residual = 1e-4 * rng.standard_normal((3, n)) + field * 2e-3 * np.tanh((inc - 90) / 25)
    place = PlaceField("scale", "x", field, 0)
    problem = LawProblem(residual, field[None], (place,), covariates, floor, 60.0 * np.arange(n), None, ("x", "y", "z"))
    return problem, next(g for g in groups_of(problem) if g.depends_on == ("inc",))


def test_a_covariate_that_is_the_same_quantity_is_in_the_class_though_it_is_not_tried() -> None:
    problem, _ = scaled_by_inclination()
    assert not any("load_z" in group.depends_on for group in groups_of(problem))
    found = Search(problem).run()
    assert [term.group.depends_on for term in found.terms] == [("inc",)]
    told = {group.depends_on for group in found.class_of(0)}
    assert ("load_z",) in told
    assert ("temp",) not in told


def decay(shape: Mapping[str, float]) -> np.ndarray:
    """(1, 1, n) of one channel."""
    return np.exp(-T_S / shape["tau"])[None, None]


T_S = 30.0 * np.arange(100.0)


def test_the_shape_of_a_name_is_sharpened_between_the_values_that_are_tried() -> None:
    rng = np.random.default_rng(2)
    floor = np.full((1, T_S.size), 1e-4)
    offset = np.ones((1, 1, T_S.size))
    residual = 1e-4 * rng.standard_normal(floor.shape) + 5e-2 * decay({"tau": 437.0})[0]
    problem = LawProblem(residual, offset, (), {"time": T_S}, floor, T_S, channels=("x",))
    tried = [120.0, 300.0, 750.0]
    groups: list[LawGroup] = []
    for k, tau in enumerate(tried):
        near = {"tau": (tried[max(k - 1, 0)], tried[min(k + 1, 2)])}
        group = EffectGroup.of("warmup", decay({"tau": tau}), floor, tries=3)
        groups.append(group.shaped({"tau": tau}, near, frozenset(), decay))
    found = Search(problem, groups).run()
    (term,) = found.terms
    assert isinstance(term.group, EffectGroup)
    assert term.group.shape is not None
    assert term.group.shape.values["tau"] == pytest.approx(437.0, rel=0.02)
    # without what lies between the values a strength of 1e6 would leave much
    assert found.noise.factor[0] < 1.3
    assert term.group.tries == 3


def with_steps(*steps: tuple[float, float]) -> LawProblem:
    """An offset of one channel that steps (g) at these times (s), in white noise."""
    rng = np.random.default_rng(3)
    floor = np.full((1, T_S.size), 1e-4)
    residual = 1e-4 * rng.standard_normal(floor.shape) + sum(size * (at <= T_S) for at, size in steps)
    place = PlaceField("offset", "x", np.ones((1, T_S.size)), 0)
    free = np.ones((1, 1, T_S.size))
    return LawProblem(residual, free, (place,), {"time": T_S}, floor, T_S, channels=("x",), memory=False)


def test_a_step_between_the_places_that_are_tried_is_moved_there() -> None:
    problem = with_steps((705.0, 2e-3))
    tried = {g.axes[0].functions[0].numbers for g in groups_of(problem) if g.axes[0].functions[0].kind == "step"}
    assert (705.0,) not in tried
    found = Search(problem).run()
    # one value on the wrong side would be off by 20 sigma, and a second step beside it would put that right
    assert [term.group.axes[0].functions for term in found.terms] == [(Function("step", (705.0,)),)]
    assert found.noise.factor[0] < 1.3


def test_the_time_constant_of_a_decay_is_found_between_those_that_are_tried() -> None:
    problem = with_steps()
    residual = problem.residual + 5e-3 * (T_S >= 705.0) * np.exp(-(T_S - 705.0) / 160.0)
    found = Search(replace(problem, residual=residual)).run()
    (shape,) = (f for term in found.terms for f in term.group.axes[0].functions)
    assert shape.kind == "decay"
    assert shape.numbers[0] == 705.0
    assert shape.numbers[1] == pytest.approx(160.0, rel=0.12)


def test_an_effect_is_named_once_and_what_is_like_it_beside_it_is_a_law() -> None:
    problem = with_steps((705.0, 2e-3), (1905.0, -1.2e-3))
    onsets = np.arange(105.0, 2900.0, 200.0)
    columns = [(onset <= T_S).astype(float)[None, None] for onset in onsets]
    steps = [EffectGroup.of("bias_step", c, problem.floor, tries=len(onsets)) for c in columns]
    found = Search(problem, [*groups_of(problem), *steps]).run()
    names = [term.group.effect for term in found.terms]
    assert names.count("bias_step") <= 1
    search = Search(problem, steps)
    assert len(search.run().terms) == 1


def test_laws_of_the_same_place_and_covariate_each_have_a_slug() -> None:
    problem = with_steps((705.0, 2e-3), (1905.0, -1.2e-3))
    steps = [group for group in groups_of(problem) if group.axes[0].functions[0].kind == "step"]
    found = Search(problem, steps).run()
    assert [term.group.label for term in found.terms] == ["offset_x_time"] * 2
    laws = reported_laws(found)
    assert [one.law.id for one in laws] == ["law:offset_x_time", "law:offset_x_time--2"]
    assert [one.claim.effect for one in laws] == [one.law.id for one in laws]
    assert all(one.law.id in one.claim.equivalence_class for one in laws)
    # beside a model that has such a law they stand in addition, not in its stead
    beside = reported_laws(found, ["law:offset_x_time"])
    assert [one.law.id for one in beside] == ["law:offset_x_time--2", "law:offset_x_time--3"]
    model = ForwardModel.of({}).with_laws([laws[0].law]).with_laws([one.law for one in beside])
    assert model.ids == ("law:offset_x_time", "law:offset_x_time--2", "law:offset_x_time--3")
    assert [title_of_any(name) for name in model.ids] == [title_of_any("law:offset_x_time")] * 3


def test_the_names_of_two_covariates_are_read_out_of_an_id() -> None:
    """Those whose name ends as the word between them begins, too."""
    for first, second in permutations([*COVARIATES, "supply_v"], 2):
        assert parted(joined((first, second))) == (first, second)
    for one in (*COVARIATES, "supply_v", "a_x_b"):
        assert parted(one) == (one,)
    assert title_of_any("law:inclination_inc_load_x_x_inc") == (
        "an error of the reference inclination that follows load on x and inclination"
    )


def shaped(effect: str, name: str, tried: list[float], of: Columns, problem: LawProblem) -> list[EffectGroup]:
    """An effect of one shape as groups, one for each value of it that is tried."""
    made = []
    for k, value in enumerate(tried):
        near = {name: (tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)])}
        group = EffectGroup.of(effect, of({name: value}), problem.floor, tries=len(tried))
        made.append(group.shaped({name: value}, near, frozenset({name} & {"t0"}), of))
    return made


def step(shape: Mapping[str, float]) -> np.ndarray:
    """(1, 1, n) of one channel."""
    return (shape["t0"] <= T_S).astype(float)[None, None]


def of_laws(problem: LawProblem, added: np.ndarray) -> Found:
    """A search among laws alone."""
    found = Search(replace(problem, residual=problem.residual + added)).run()
    assert found.terms
    assert not any(term.group.effect for term in found.terms)
    return found


def test_a_name_that_fits_as_well_as_the_laws_that_were_found_is_told_in_their_place() -> None:
    problem = with_steps()
    found = of_laws(problem, 5e-3 * decay({"tau": 437.0})[0])
    offered = [
        shaped("warmup", "tau", [120.0, 300.0, 750.0], decay, problem),
        shaped("bias_step", "t0", [405.0, 1005.0, 1605.0], step, problem),
    ]
    named = names_instead(found, offered, lambda made, k: True)
    (term,) = named.terms
    assert term.group.effect == "warmup"
    assert isinstance(term.group, EffectGroup)
    assert term.group.shape is not None
    assert term.group.shape.values["tau"] == pytest.approx(437.0, rel=0.1)
    assert names_instead(found, offered, lambda made, k: False) is found


def test_a_law_in_the_place_of_which_a_name_is_told_stays_in_its_class() -> None:
    problem = with_steps()
    found = of_laws(problem, 2e-3 * step({"t0": 1305.0})[0])
    named = names_instead(
        found, [shaped("bias_step", "t0", [405.0, 1005.0, 1605.0], step, problem)], lambda made, k: True
    )
    (term,) = named.terms
    assert isinstance(term.group, EffectGroup)
    assert term.group.shape is not None
    assert 1290.0 < term.group.shape.values["t0"] <= 1320.0
    assert [group.label for group in named.class_of(0)] == ["bias_step", "offset_x_time"]


def test_a_name_that_leaves_a_part_of_a_law_does_not_take_its_place() -> None:
    problem = with_steps()
    bump = 5e-3 * np.exp(-(((T_S - 1500.0) / 500.0) ** 2))[None]
    found = of_laws(problem, bump)
    offered = [
        shaped("warmup", "tau", [120.0, 300.0, 750.0], decay, problem),
        shaped("bias_step", "t0", [405.0, 1005.0, 1605.0], step, problem),
    ]
    assert names_instead(found, offered, lambda made, k: True) is found
