"""Probabilities that are smaller than a double can be, by their logarithms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import chdtrc, fdtrc

from highside.diagnosis.core.probability import log10_f_beyond
from highside.diagnosis.core.regression import log10_p, p_of


@pytest.mark.parametrize("dof", [1, 2, 3, 8, 40, 150])
def test_the_logarithm_goes_on_where_the_probability_ends(dof: int) -> None:
    # some 1e-270 and 1e-290, on both sides of where the way changes; scipy still has both
    gain = np.linspace(1200.0, 1400.0, 21)
    exact = np.log10(chdtrc(dof, gain))
    kept = np.isfinite(exact) & (exact > -305)
    found = log10_f_beyond(gain, dof, np.inf)
    assert found[kept] == pytest.approx(exact[kept], rel=1e-10)
    assert np.all(np.diff(found) < 0)


@pytest.mark.parametrize("freedom", [200.0, 24_000.0, 2e7])
@pytest.mark.parametrize("dof", [1, 3, 40])
def test_so_it_does_where_the_noise_is_known_to_some_freedom(dof: int, freedom: float) -> None:
    gain = np.geomspace(1000.0, 1e6, 200)
    exact = np.log10(np.maximum(fdtrc(dof, freedom, gain / dof), 1e-320))
    found = log10_f_beyond(gain, dof, freedom)
    kept = exact > -290  # scipy loses digits just before it has none
    assert found[kept] == pytest.approx(exact[kept], rel=1e-8)
    assert np.all(np.diff(found) < 0)


@given(st.floats(1.0, 1e12), st.floats(1.0, 1e8))
def test_two_directions_have_a_closed_form(gain: float, freedom: float) -> None:
    exact = -freedom / 2 * np.log1p(gain / freedom) / np.log(10.0)
    assert float(log10_f_beyond(gain, 2, freedom)) == pytest.approx(exact, rel=1e-7, abs=1e-12)
    assert float(log10_f_beyond(gain, 2, np.inf)) == pytest.approx(-gain / 2 / np.log(10.0), rel=1e-9)


def test_of_two_effects_that_are_certain_the_better_one_is_known() -> None:
    found = log10_p(np.array([3e5, 4e5, 0.0]), np.array([3, 3, 0]), 24_000.0, np.array([10.0, 1000.0, 1.0]))
    assert 300.0 < found[0] < found[1]
    assert found[2] == pytest.approx(0.0, abs=1e-11)
    assert log10_p(np.array(1e5), np.array(1), np.inf) == pytest.approx(1e5 / 2 / np.log(10), rel=1e-3)


def test_a_probability_that_is_written_is_not_0() -> None:
    assert p_of(5e4) == 1e-300
    assert p_of(2.0) == 0.01
