"""Two laws that act alike, of which one follows a part of what the other does, are told as one: their sum."""

import numpy as np
import pytest

from highside.diagnosis.laws.nested import joined
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function

COSINES = tuple(Function("wide_cosine", (float(k),)) for k in range(1, 10))
TEMP = Axis("temp", 10.0, 50.0, (Function("one"), *COSINES[:4]))
INC = Axis("inc", 5.0, 150.0, (Function("straight"), *COSINES[:3]))


def law(rng: np.random.Generator, axes: tuple[Axis, ...], channels: tuple[str, ...] = ("x", "z")) -> Law:
    count = int(np.prod([len(axis.functions) for axis in axes]))
    return Law("one", "offset", channels, axes, tuple(map(tuple, rng.normal(size=(len(channels), count)).tolist())))


@pytest.mark.parametrize(
    "others",
    [
        [(Axis("temp", 10.0, 50.0, COSINES),)],
        # a constant of the temperature is no function of the whole, and is needed
        [(Axis("inc", 5.0, 150.0, (Function("one"), *COSINES[:6])),)],
        # the same quantities in another order
        [(Axis("inc", 5.0, 150.0, COSINES[2:5]), Axis("temp", 10.0, 50.0, COSINES[:2]))],
        [(Axis("temp", 10.0, 50.0, COSINES),), (Axis("inc", 5.0, 150.0, COSINES),)],
    ],
)
def test_the_sum_and_its_band_are_those_of_all(others: list[tuple[Axis, ...]]) -> None:
    rng = np.random.default_rng(3)
    laws = [law(rng, (TEMP, INC)), *(law(rng, axes) for axes in others)]
    count = sum(np.asarray(one.coefficients).size for one in laws)
    root = rng.normal(size=(count, count))
    covariance = root @ root.T
    one = joined(laws, covariance)
    # beyond the range of what it does not follow a part falls off as the whole does
    at = {"temp": rng.uniform(10, 50, 40), "inc": rng.uniform(5, 150, 40)}
    here = [at[name] for name in one.depends_on]
    assert one.depends_on == ("temp", "inc")
    for channel in range(2):
        want = sum(each.value([at[name] for name in each.depends_on], channel) for each in laws)
        np.testing.assert_allclose(one.value(here, channel), want, atol=1e-10)
        # what each coefficient of all laws adds to the value
        blocks = []
        for each in laws:
            basis = each.basis([at[name] for name in each.depends_on])
            blocks += [basis if c == channel else np.zeros_like(basis) for c in range(2)]
        rows = np.concatenate(blocks)
        np.testing.assert_allclose(one.std(here, channel) ** 2, np.einsum("in,ij,jn->n", rows, covariance, rows))
    assert Law.from_dict(one.to_dict()).depends_on == one.depends_on
