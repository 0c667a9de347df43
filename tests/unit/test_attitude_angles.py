"""Angles on the circle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside.attitude import circular_mean, circular_std, difference, wrap_positive, wrap_signed

angles = st.floats(-1e6, 1e6)


@given(angles)
def test_wrapped_angles_stay_in_their_interval_and_keep_their_direction(angle: float) -> None:
    positive, signed = wrap_positive(angle, 360.0), wrap_signed(angle, 360.0)
    assert 0.0 <= positive < 360.0
    assert -180.0 < signed <= 180.0
    for wrapped in (positive, signed):
        turns = (wrapped - angle) / 360.0
        assert turns == pytest.approx(round(turns), abs=1e-9)


@given(st.lists(angles, min_size=1, max_size=20))
def test_arrays_are_wrapped_like_floats(values: list[float]) -> None:
    array = np.array(values)
    np.testing.assert_array_equal(wrap_positive(array, 360.0), [wrap_positive(v, 360.0) for v in values])
    np.testing.assert_array_equal(wrap_signed(array, 360.0), [wrap_signed(v, 360.0) for v in values])


def test_the_seams() -> None:
    assert wrap_positive(-1e-300) == 0.0
    assert wrap_positive(360.0, 360.0) == 0.0
    assert wrap_signed(180.0, 360.0) == 180.0
    assert wrap_signed(-180.0, 360.0) == 180.0
    assert wrap_positive(np.array(-90.0), 360.0) == 270.0


def test_a_difference_goes_the_short_way() -> None:
    assert difference(359.0, 1.0, 360.0) == pytest.approx(-2.0)
    assert difference(1.0, 359.0, 360.0) == pytest.approx(2.0)
    np.testing.assert_allclose(difference(np.array([359.0, 10.0]), 1.0, 360.0), [-2.0, 9.0])


def test_means_cross_the_seam() -> None:
    assert circular_mean([350.0, 20.0], period=360.0) == pytest.approx(5.0)
    assert circular_mean([350.0, 20.0], weights=[0.0, 1.0], period=360.0) == pytest.approx(20.0)
    narrow = np.random.default_rng(1).normal(0.0, 2.0, 20_000)
    assert circular_std(narrow, period=360.0) == pytest.approx(narrow.std(), rel=1e-3)
    assert circular_std([0.0, math.pi]) > 5.0


@pytest.mark.parametrize(("values", "weights"), [([], None), ([0.0, math.pi], None), ([1.0], [0.0]), ([1.0], [1, 1])])
def test_a_mean_that_does_not_exist_is_refused(values: list[float], weights: list[float] | None) -> None:
    with pytest.raises(ValueError, match=r"no angles|cancel|weights"):
        circular_mean(values, weights)
