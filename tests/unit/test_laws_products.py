"""Laws that are a product of one function of each of two quantities: found where a surface is too much to ask."""

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.diagnosis.laws.evidence import Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.problem import LawProblem, PlaceField
from highside.diagnosis.laws.products import ProductGroup, best_products, coefficients_of, fitted_again
from studies.open_world.score import every_case

FURTHER = pytest.mark.further
SEED = "925c2d2d27532b4dde268f156b02263ff139bce2"
MODEL = {"sensor": {"free": ["bias", "scale", "misalignment"]}}


@FURTHER
@pytest.mark.parametrize(
    ("name", "place", "follows"),
    [
        # taken for errors of the set angles, and "nothing": the surface was worth less than these
        ("law/154", "inclination", {"tf", "inc"}),
        # the same, and named a wobble
        pytest.param("law/092", "inclination", {"tf", "temp"}, marks=FURTHER),
        # 32 poses, told as one function of the toolface, of which nothing was left elsewhere
        pytest.param("law/140", "toolface", {"tf", "supply_v"}, marks=FURTHER),
    ],
)
def test_a_product_is_found_where_noise_held_all_of_it(name: str, place: str, follows: set[str]) -> None:
    case = every_case(SEED, ("law",))[name]()
    made = diagnose({column: np.asarray(values) for column, values in case.recording.items()}, MODEL)
    assert [(claim.place, set(claim.depends_on)) for claim in made.claims] == [(place, follows)]
    assert made.verdict == "law"


@FURTHER
@pytest.mark.parametrize("number", ["046", "110", "190", "270"])
def test_errors_of_the_set_angles_alone_are_no_product(number: str) -> None:
    case = every_case(SEED, ("null",))[f"null/{number}"]()
    assert case.noise == "jitter"
    made = diagnose({column: np.asarray(values) for column, values in case.recording.items()}, MODEL)
    assert not made.claims


def problem(seed: int, n: int, size: float) -> tuple[LawProblem, np.ndarray]:
    """One channel of n values with an offset that is a function of `a` times one of `b`; and that offset."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    added = size * np.sin(5.0 * a) * np.exp(-(((b - 0.4) / 0.3) ** 2))
    field = PlaceField("offset", "x", np.ones((1, n)), 0)
    covariates = {"supply_v": a, "vibration": b, "temp": rng.uniform(0.0, 1.0, n)}
    made = LawProblem(
        added[None] + rng.normal(0.0, 1.0, (1, n)), np.ones((1, 1, n)), (field,), covariates, np.ones((1, n)),
        np.arange(n, dtype=float), channels=("ax",), every_pair=True,
    )  # fmt: skip
    return made, added


def whitened(made: LawProblem) -> Whitened:
    families = Families(made, groups_of(made))
    return Whitened(families, Whitener(made, LawNoise.floor_alone(made)), made.residual)


def does(group: ProductGroup, made: LawProblem) -> np.ndarray:
    """(n,) the product that fits best."""
    columns = group.columns()[:, 0]
    beside = np.concatenate([columns, made.free[:, 0]])
    sizes = np.linalg.lstsq(beside.T, made.residual[0], rcond=None)[0]
    return np.asarray(sizes[: len(columns)] @ columns)


@pytest.mark.parametrize("n", [30, 60])
def test_the_product_of_the_right_quantities_is_the_likeliest_and_near_the_truth(n: int) -> None:
    made, added = problem(1, n, 100.0)
    white = whitened(made)
    best = best_products(white, [], white.families.groups)[0]
    assert set(best.depends_on) == {"supply_v", "vibration"}
    left = does(best, made) - added
    assert np.var(left) < (0.02 if n == 60 else 0.1) * np.var(added)
    again = fitted_again(white, [], best)
    assert np.var(does(again, made) - does(best, made)) < 1e-3 * np.var(added)


def test_its_coefficients_are_those_of_a_surface() -> None:
    made, _ = problem(2, 60, 100.0)
    white = whitened(made)
    best = best_products(white, [], white.families.groups)[0]
    first, second = best.surface
    values = [made.covariates[axis.covariate] for axis in best.surface]
    every = (first.basis(values[0])[:, None] * second.basis(values[1])[None]).reshape(-1, made.n)
    sizes = np.random.default_rng(3).normal(size=best.size)
    np.testing.assert_allclose(sizes @ best.columns()[:, 0], (coefficients_of(best) @ sizes) @ every, atol=1e-9)
    assert best.tries > best.alike  # what the second function costs


def test_of_noise_alone_none_is_worth_a_law() -> None:
    for seed in range(20):
        made, _ = problem(100 + seed, 40, 0.0)
        white = whitened(made)
        group = best_products(white, [], white.families.groups)[0]
        gains, _ = white.of_groups([group]).scores([], within=np.inf)
        assert gains[0] < 6.0
