"""The tool from the side: where its ends and its scribe line are."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside.web.flat import HALF, RADIUS, side_view
from highside.web.space import orientation


def drawn(tool: tuple[float, float] | None, ghost: tuple[float, float] | None = None) -> list[ElementTree.Element]:
    found = re.search(r"<svg.*</svg>", side_view(tool, ghost), re.S)
    assert found is not None
    return list(ElementTree.fromstring(found[0]))


def points(shape: ElementTree.Element) -> np.ndarray:
    """(n, 2), y up."""
    numbers = [float(text) for text in re.findall(r"-?\d+\.\d+", shape.get("d", ""))]
    return np.asarray(numbers).reshape(-1, 2) * (1.0, -1.0)


@given(st.floats(-180.0, 180.0), st.floats(0.0, 360.0))
def test_it_is_the_picture_in_space_from_the_side(inc_deg: float, tf_deg: float) -> None:
    """Both are drawn of the same attitude: the hole to the east, seen from the south, what is up at the top."""
    _plumb, pipe, scribe = drawn((inc_deg, tf_deg))
    turned = np.asarray(orientation(inc_deg, tf_deg, 90.0))
    upper, lower = turned @ (0.0, 0.0, HALF), turned @ (0.0, 0.0, -HALF)
    corners = points(pipe)
    assert corners[:2].mean(axis=0) == pytest.approx(upper[[0, 2]], abs=0.11)
    assert (corners[2] + corners[4]) / 2.0 == pytest.approx(lower[[0, 2]], abs=0.11)
    line = turned @ (RADIUS, 0.0, HALF)
    assert points(scribe)[0] == pytest.approx(line[[0, 2]], abs=0.11)
    south = -(turned @ (1.0, 0.0, 0.0))[1]
    if abs(south) > 1e-6:
        assert ("behind" in scribe.get("class", "")) == (south < 0.0)


def test_what_is_wanted_is_a_ghost_and_nothing_is_a_plumb_line() -> None:
    assert [shape.get("class") for shape in drawn(None)] == ["plumb"]
    assert [shape.get("class") for shape in drawn(None, (45.0, 0.0))] == ["plumb", "ghost"]
    kinds = [shape.get("class") for shape in drawn((math.nan, 0.0), (45.0, 0.0))]
    assert kinds == ["plumb", "ghost"], "what is no number is not drawn"
