"""Signed permutations of axes."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from highside.codec.axes import AxisMap
from highside.errors import InputError


@pytest.mark.parametrize(("letters", "signs"), list(product(permutations("xyz"), product("+-", repeat=3))))
def test_every_map_equals_its_matrix_and_mirrors_are_refused(letters: tuple[str, ...], signs: tuple[str, ...]) -> None:
    text = "".join(s + c for s, c in zip(signs, letters, strict=True))
    matrix = np.zeros((3, 3))
    for row, (letter, sign) in enumerate(zip(letters, signs, strict=True)):
        matrix[row, "xyz".index(letter)] = 1.0 if sign == "+" else -1.0
    mirror = np.linalg.det(matrix) < 0
    if mirror:
        with pytest.raises(InputError, match="mirror"):
            AxisMap.parse(text)
    axes = AxisMap.parse(text, allow_mirror=mirror)
    assert axes.determinant == round(np.linalg.det(matrix))
    assert axes.identity == bool(np.all(matrix == np.eye(3)))
    assert axes.apply(0.1, 0.2, 0.3) == tuple(matrix @ [0.1, 0.2, 0.3])
    # plus signs may be left out
    assert AxisMap.parse(text.replace("+", ""), allow_mirror=mirror) == axes


@pytest.mark.parametrize("text", ["", "xy", "xxz", "xyzz", "abc", "x y z", "--xyz", "xyz-"])
def test_what_is_no_map_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match="is no axis map") as caught:
        AxisMap.parse(text)
    assert "\n" not in str(caught.value)


def test_absent_values_stay_absent() -> None:
    assert AxisMap.parse("y-xz").apply(None, 1.0, None) == (1.0, None, None)
