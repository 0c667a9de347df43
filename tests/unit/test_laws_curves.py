"""The band of a law holds what is true of it, also where nothing was read, and whether or not a formula is told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside.api.diagnosis import diagnose
from highside.arrays import Array
from highside.config.model import Model
from highside.diagnosis.laws.curves import ONE, unread
from highside.diagnosis.laws.formulas_policy import LAW_CURVES
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function

SIGMA = 5e-5
MODEL = Model.model_validate({"sensor": {"noise_g": SIGMA}})
PLATEAUS = np.array([15.0, 19.0, 23.0, 41.0, 46.0, 53.0, 60.0])
"""temperatures: none between 23 and 41 degC, four tenths of the range"""
SHAPES: dict[str, Callable[[Array], Array]] = {
    "a threshold between two plateaus": lambda temp: 3e-3 * np.tanh((temp - 30.0) / 3.0),
    "a wave that turns between them": lambda temp: 3e-3 * np.sin(2 * np.pi * (temp - 15.0) / 19.0),
    "an exponential": lambda temp: 1e-2 * np.exp((temp - 60.0) / 9.0),
}


def poses(shape: Callable[[Array], Array], seed: int) -> dict[str, Array]:
    """84 poses on the plateaus in turn; the scale of y follows the temperature."""
    rng = np.random.default_rng(seed)
    count = 84
    inc, tf, temp = rng.uniform(10, 170, count), rng.uniform(0, 360, count), PLATEAUS[np.arange(count) % 7]
    s, c = np.sin(np.radians(inc)), np.cos(np.radians(inc))
    read = np.vstack([s * np.cos(np.radians(tf)), s * np.sin(np.radians(tf)), c])
    read[1] *= 1.0 + shape(temp)
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ read + rng.normal(0, 3e-3, (3, 1))
    read += rng.normal(0, SIGMA, read.shape)
    ax, ay, az = read
    return {"inc_ref_deg": inc, "tf_ref_deg": tf, "temp_c": temp, "ax": ax, "ay": ay, "az": az}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_the_band_of_a_law_holds_what_is_true_where_nothing_was_read(shape: Callable[[Array], Array]) -> None:
    (claim,) = diagnose(poses(shape, 11), model=MODEL).claims
    assert (claim.place, claim.depends_on) == ("scale", ("temp",))
    curve = claim.curve
    assert curve is not None
    assert curve.unread == ((23.0, 41.0),)
    grid, value, std = (np.array(each) for each in (curve.grid, curve.value, curve.std))
    # a constant is what the scale of the base takes
    off = value - shape(grid)
    off -= np.interp(PLATEAUS, grid, off).mean()
    assert np.all(np.abs(off) <= 3.0 * std)
    # what the model file has of it, and the live correction takes
    assert claim.law is not None
    assert Law.from_dict(claim.law).std([grid]) == pytest.approx(std, rel=1e-3)
    between = (grid > 25.0) & (grid < 39.0)
    at_plateaus = np.interp(PLATEAUS, grid, std)
    assert std[between].max() > 3.0 * at_plateaus.min()


def test_no_sine_is_told_of_a_period_that_no_two_values_show() -> None:
    # law/122 of the open world of seed bf90003a: three rates of the temperature, and a wave between them was told
    (claim,) = diagnose(poses(SHAPES["a wave that turns between them"], 12), model=MODEL).claims
    assert "sin(" not in (claim.formula or "")


values = st.lists(st.floats(-50.0, 150.0, allow_nan=False), min_size=2, max_size=30)


@given(values, st.booleans())
def test_what_was_not_read_holds_no_reading(read: list[float], comes_round: bool) -> None:
    low, high = (0.0, 360.0) if comes_round else (min(read), max(read))
    if high <= low:
        return
    found = unread(np.array(read), low, high, comes_round=comes_round)
    at = np.mod(read, 360.0) if comes_round else np.array(read)
    for begin, end in found:
        assert low <= begin < end <= high
        assert not np.any((at > begin + 1e-9) & (at < end - 1e-9))
        assert comes_round or end - begin >= LAW_CURVES.unread * (high - low) * (1 - 1e-12)
    assert list(found) == sorted(found)


def test_all_but_one_toolface_unread_comes_round() -> None:
    found = unread(np.array([90.0, 100.0]), 0.0, 360.0, comes_round=True)
    assert found == ((0.0, 90.0), (100.0, 360.0))


@pytest.mark.parametrize("kind", ["cosine", "wide_cosine"])
@pytest.mark.parametrize("before", [(), (ONE,), (Function("bump", (30.0, 4.0)), ONE), (Function("step", (2.0,)),)])
def test_waves_that_are_computed_together_are_those_one_by_one(kind: str, before: tuple[Function, ...]) -> None:
    waves = tuple(Function(kind, (float(order),)) for order in range(1, 17))
    axis = Axis("temp", 15.0, 60.0, (*before, *waves))
    at = np.linspace(5.0, 70.0, 301)
    held, fall = axis.held(at)
    each = np.stack([function(held, (axis.low, axis.high)) for function in axis.functions]) * fall
    assert axis.basis(at) == pytest.approx(each, abs=1e-12)
