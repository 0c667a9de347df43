"""A name that is found beside laws is judged by whether its size is a constant, as any other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.laws.claims import named_claim
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.physics.effects import get

Array = NDArray[np.float64]

N, FLOOR_G = 60, 1e-4


def squares(seed: int, size: Array) -> tuple[LawProblem, EffectGroup]:
    """60 readings of three channels with a quadratic of `size` (n,) on the first."""
    rng = np.random.default_rng(seed)
    load = rng.uniform(-1, 1, (3, N))
    columns = np.zeros((3, 3, N))
    for axis in range(3):
        columns[axis, axis] = load[axis] ** 2
    floor = np.full((3, N), FLOOR_G)
    residual = size * columns[0] + FLOOR_G * rng.standard_normal((3, N))
    offsets = np.repeat(np.eye(3)[:, :, None], N, axis=2)
    residual -= residual.mean(axis=1, keepdims=True)
    problem = LawProblem(
        residual, offsets, (), {"inc": rng.uniform(0, 3, N)}, floor, np.arange(N) * 60.0, channels=("ax", "ay", "az")
    )
    return problem, EffectGroup.of("quadratic", columns, floor)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("late", "constant"), [(1.0, True), (4.0, False), (2.5, False)])
def test_a_size_that_changes_over_the_session_is_no_constant(seed: int, late: float, constant: bool) -> None:
    size = 2e-3 * np.where(np.arange(N) < 2 * N // 3, 1.0, late)
    problem, own = squares(seed, size)
    found = Search(problem, [own]).beside([own], [])
    assert [term.group.effect for term in found.terms] == ["quadratic"]
    claim = named_claim(found, 0, get("quadratic"), {})
    assert claim.stable is constant
    if constant:
        assert claim.parameters["k2_x"].value == pytest.approx(2e-3, rel=0.1)
