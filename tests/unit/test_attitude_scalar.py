"""Single readings: equation 2, its covariance, and its honesty near vertical."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside.attitude import (
    UNIFORM_ANGLE_STD_RAD,
    attitude,
    attitude_std_block,
    attitude_with_std,
    gravity_vector,
    toolface_std,
    wrap_signed,
)
from highside.papers import balance_angles

ISOTROPIC = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)


def scaled(cov: tuple[float, ...], std: float) -> tuple[float, float, float, float, float, float]:
    xx, xy, xz, yy, yz, zz = (std * std * c for c in cov)
    return xx, xy, xz, yy, yz, zz


@given(st.floats(1e-6, math.pi - 1e-6), st.floats(0.0, 2 * math.pi, exclude_max=True), st.floats(1e-3, 1e3))
def test_inversion_of_equation_1(inc: float, tf: float, length: float) -> None:
    gx, gy, gz = (length * g for g in gravity_vector(inc, tf))
    i, t = attitude(gx, gy, gz)
    assert i == pytest.approx(inc, abs=1e-14)
    assert 0.0 <= t < 2 * math.pi
    assert abs(wrap_signed(t - tf)) < 1e-14


def test_toolface_is_zero_with_x_at_the_high_side_and_grows_towards_y() -> None:
    assert attitude(0.1, 0.0, 0.99)[1] == 0.0
    assert attitude(0.0, 0.1, 0.99)[1] == pytest.approx(math.pi / 2)
    assert attitude(-0.1, 0.0, 0.99)[1] == pytest.approx(math.pi)
    assert attitude(0.0, -0.1, 0.99)[1] == pytest.approx(3 * math.pi / 2)


def test_the_seam_and_the_axis() -> None:
    assert attitude(1.0, -1e-300, 0.0)[1] == 0.0
    assert math.copysign(1.0, attitude(1.0, -0.0, 0.0)[1]) == 1.0
    assert attitude(0.0, 0.0, 1.0) == (0.0, 0.0)
    assert attitude(0.0, 0.0, -1.0) == (math.pi, 0.0)


@pytest.mark.parametrize("inc_deg", [0.612, 5.0, 45.0, 90.0, 135.0])
def test_covariance_of_a_correlated_reading_matches_monte_carlo(inc_deg: float) -> None:
    rng = np.random.default_rng(3)
    root = 1e-5 * np.array([[1.0, 0.0, 0.0], [0.6, 0.9, 0.0], [-0.4, 0.5, 1.2]])
    cov = root @ root.T
    g = np.array(gravity_vector(math.radians(inc_deg), 1.1)) * 1.003
    draws = g[:, None] + root @ rng.normal(size=(3, 100_000))
    inc = np.arctan2(np.hypot(draws[0], draws[1]), draws[2])
    tf = np.arctan2(draws[1], draws[0])
    upper = cov[np.triu_indices(3)]
    result = attitude_with_std(*g, (upper[0], upper[1], upper[2], upper[3], upper[4], upper[5]))
    assert result.inc_std_rad == pytest.approx(inc.std(), rel=0.01)
    assert result.tf_std_rad == pytest.approx(tf.std(), rel=0.02)
    correlation = np.corrcoef(inc, tf)[0, 1]
    claimed = result.inc_tf_cov_rad2 / (result.inc_std_rad * result.tf_std_rad)
    assert claimed == pytest.approx(correlation, abs=0.015)
    assert not result.toolface_undefined


@pytest.mark.parametrize("sigmas", [0.0, 0.2, 0.5, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0])
@pytest.mark.parametrize("vertical", [1.0, -1.0])
def test_uncertainty_is_honest_at_any_distance_from_vertical(sigmas: float, vertical: float) -> None:
    # what is known after the reading: the truth lies about it as the Gaussian says
    sigma = 1e-3
    rng = np.random.default_rng(7)
    x = sigma * sigmas
    truth = np.array([[x], [0.0]]) + sigma * rng.normal(size=(2, 200_000))
    published = attitude_with_std(x, 0.0, vertical, scaled(ISOTROPIC, sigma))
    tf_error = np.arctan2(truth[1], truth[0])
    inc_error = np.arctan2(np.hypot(truth[0], truth[1]), vertical) - published.inc_rad
    assert published.tf_std_rad == pytest.approx(math.sqrt(np.mean(tf_error**2)), rel=0.02)
    assert published.inc_std_rad == pytest.approx(math.sqrt(np.mean(inc_error**2)), rel=0.09)
    assert published.toolface_undefined == (sigmas < 2.4)


@pytest.mark.parametrize("sigmas", [0.5, 1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("ratio", [1 / 3, 3.0])
def test_toolface_is_not_overconfident_when_the_axes_differ(sigmas: float, ratio: float) -> None:
    # x, along the toolface, known `ratio` times as well or badly as y
    sigma_y = 1e-3
    sigma_x = ratio * sigma_y
    rng = np.random.default_rng(8)
    x = sigmas * sigma_y
    truth = rng.normal(size=(2, 200_000)) * [[sigma_x], [sigma_y]] + [[x], [0.0]]
    published = attitude_with_std(x, 0.0, 1.0, (sigma_x**2, 0.0, 0.0, sigma_y**2, 0.0, sigma_y**2))
    actual = math.sqrt(np.mean(np.arctan2(truth[1], truth[0]) ** 2))
    assert 0.8 * actual < published.tf_std_rad < 1.7 * actual


def test_intervals_cover_nearly_vertical_truths() -> None:
    sigma = 1e-3
    rng = np.random.default_rng(9)
    # directions spread evenly over a disc of 10 sigma, each read once
    radius, phase = 10 * sigma * np.sqrt(rng.uniform(size=100_000)), rng.uniform(-np.pi, np.pi, 100_000)
    truth = np.stack([radius * np.cos(phase), radius * np.sin(phase)])
    read = truth + sigma * rng.normal(size=truth.shape)
    g = np.vstack([read, np.ones(read.shape[1])])
    _, tf_std, _ = attitude_std_block(g, np.array(scaled(ISOTROPIC, sigma)))
    error = np.abs(wrap_signed(np.arctan2(read[1], read[0]) - phase))
    assert 0.93 < np.mean(error < 1.96 * tf_std) < 0.97


def test_toolface_uncertainty_grows_to_that_of_a_uniform_angle_and_never_past_it() -> None:
    stds = [toolface_std(s) for s in np.linspace(0.0, 50.0, 5001)]
    assert all(later < earlier for earlier, later in pairwise(stds))
    assert math.degrees(toolface_std(0.0)) == pytest.approx(103.92, abs=0.01)
    assert toolface_std(1e4) == pytest.approx(1e-4, rel=1e-3)
    assert toolface_std(1e9) == 1e-9


def test_a_vector_without_a_direction_says_so() -> None:
    on_axis = attitude_with_std(0.0, 0.0, 1.0, scaled(ISOTROPIC, 1e-4))
    assert on_axis.toolface_undefined
    assert on_axis.tf_std_rad == pytest.approx(UNIFORM_ANGLE_STD_RAD, rel=1e-6)
    assert on_axis.inc_std_rad == pytest.approx(math.sqrt(2) * 1e-4)
    exact = attitude_with_std(0.0, 0.0, 1.0, scaled(ISOTROPIC, 0.0))
    assert exact.toolface_undefined
    nothing = attitude_with_std(0.0, 0.0, 0.0, scaled(ISOTROPIC, 1e-4))
    assert nothing.toolface_undefined
    assert math.degrees(nothing.inc_std_rad) == pytest.approx(98.1, abs=0.1)


@given(
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    st.lists(st.floats(-1e-2, 1e-2), min_size=9, max_size=9),
)
def test_no_covariance_makes_a_result_that_is_not_a_number(g: tuple[float, float, float], root: list[float]) -> None:
    m = np.array(root).reshape(3, 3)
    c = (m @ m.T)[np.triu_indices(3)]
    result = attitude_with_std(*g, (c[0], c[1], c[2], c[3], c[4], c[5]))
    assert all(math.isfinite(value) for value in result)
    assert 0.0 <= result.tf_std_rad <= UNIFORM_ANGLE_STD_RAD
    assert abs(result.inc_tf_cov_rad2) <= result.inc_std_rad * result.tf_std_rad * (1 + 1e-12)


def test_the_printed_inversion_agrees_away_from_its_singularities_and_loses_half_the_digits_at_them() -> None:
    for tf_deg in range(5, 360, 10):
        inc, tf = math.radians(35.0), math.radians(tf_deg)
        gx, gy, gz = gravity_vector(inc, tf)
        assert balance_angles.inclination_arccos(gz) == pytest.approx(inc, abs=1e-14)
        assert balance_angles.toolface_arccot(gx, gy) == pytest.approx(tf, abs=1e-13)
        assert balance_angles.toolface_arcsin(gx, gy, gz) == pytest.approx(tf, abs=1e-13)
    assert balance_angles.toolface_arccot(-1.0, 0.0) == math.pi
    inc = 1e-7
    gx, gy, gz = gravity_vector(inc, 0.3)
    assert abs(attitude(gx, gy, gz)[0] - inc) < 1e-22
    assert abs(balance_angles.inclination_arccos(gz) - inc) > 1e-11
