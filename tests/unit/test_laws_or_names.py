"""Where names and laws compete: an effect with a shape of its own, laws that fit as well, covariates that are one."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.config.model import Model
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.groups import LawGroup, groups_of
from highside.diagnosis.laws.problem import LawProblem, PlaceField
from highside.diagnosis.laws.search import Search
from studies import known_names, random_laws

KINDS = ("white", "coloured", "one_over_f", "walk")


@pytest.mark.parametrize(
    ("number", "effect"), [(48, "bias_step"), (61, "cogging"), (75, "bias_drift"), (59, "encoder_first_harmonic")]
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


@pytest.mark.parametrize("number", [1, 3])
def test_a_law_that_fits_as_well_as_a_name_is_in_its_class(number: int) -> None:
    one = random_laws.case(101, number, null=False)
    found = diagnose(one.columns, Model.model_validate({"sensor": {"noise_g": one.noise_g}}))
    (claim,) = found.claims
    assert not claim.effect.startswith("law:")
    assert one.truth & set(claim.equivalence_class)


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
    told = {group.depends_on for group in found.classes[0]}
    assert ("load_z",) in told
    assert ("temp",) not in told


def decay(shape: dict[str, float]) -> np.ndarray:
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
