"""Gravity in the tool frame: the signs that a user relies on, rotations, and the size of g on the Earth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside.physics.gravity import (
    attitude_of,
    bench_gravity,
    gravity_below_mps2,
    gravity_direction,
    gravity_jacobians,
    normal_gravity_mps2,
    normal_gravity_std_mps2,
    rotate_x,
    rotate_y,
    rotate_z,
    rotation_matrix,
)

DEG = np.pi / 180


def test_a_vertical_tool_reads_plus_one_on_z() -> None:
    np.testing.assert_array_equal(gravity_direction(np.zeros(1), np.array([1.234]))[:, 0], [0.0, 0.0, 1.0])


def test_toolface_is_zero_with_plus_x_at_the_high_side() -> None:
    # horizontal, toolface 0: what is reported at rest points up, and x points to the high side, so x reads +1
    np.testing.assert_allclose(gravity_direction(np.array([90 * DEG]), np.zeros(1))[:, 0], [1, 0, 0], atol=1e-15)


def test_toolface_increases_clockwise_looking_down_hole() -> None:
    """Built without the formula: a horizontal tool whose x axis is turned clockwise, seen by one who looks down-hole.

    Let the hole run north, so z (up-hole) points south and the viewer looks north. Up is at twelve o'clock, east on
    his right hand, at three. Turned clockwise by 30 deg the x axis points between up and east.
    """
    east, north, up = np.eye(3)
    turn = 30 * DEG
    z = -north
    x = np.cos(turn) * up + np.sin(turn) * east
    y = np.cross(z, x)
    reading = np.array([x @ up, y @ up, z @ up])
    toolface = np.arctan2(reading[1], reading[0])
    assert toolface == pytest.approx(turn)
    np.testing.assert_allclose(reading, gravity_direction(np.array([90 * DEG]), np.array([turn]))[:, 0], atol=1e-15)


@given(st.floats(1e-6, np.pi - 1e-6), st.floats(0.0, 2 * np.pi - 1e-9))
def test_inversion_gives_back_inclination_and_toolface(inc: float, tf: float) -> None:
    back_inc, back_tf = attitude_of(gravity_direction(np.array([inc]), np.array([tf])))
    assert back_inc[0] == pytest.approx(inc, abs=1e-12)
    assert np.sin(inc) * abs(np.angle(np.exp(1j * (back_tf[0] - tf)))) < 1e-12


def test_a_ring_at_minus_i_is_the_opposite_toolface() -> None:
    inc, tf = attitude_of(gravity_direction(np.array([-20 * DEG]), np.array([50 * DEG])))
    assert np.degrees(inc[0]) == pytest.approx(20)
    assert np.degrees(tf[0]) == pytest.approx(230)


@pytest.mark.parametrize(("rotate", "axis"), [(rotate_x, 0), (rotate_y, 1), (rotate_z, 2)])
def test_rotations_are_right_handed_and_agree_with_the_exponential(rotate, axis: int) -> None:  # type: ignore[no-untyped-def]
    v = np.random.default_rng(1).normal(size=(3, 4))
    vector = np.zeros(3)
    vector[axis] = 0.7
    np.testing.assert_allclose(rotate(np.array(0.7), v), rotation_matrix(vector) @ v, atol=1e-15)


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_the_exponential_is_a_rotation(vector: list[float]) -> None:
    matrix = rotation_matrix(np.array(vector))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1)


def test_the_exponential_is_smooth_where_its_series_takes_over() -> None:
    below, above = rotation_matrix(np.array([0.99999e-4, 0, 0])), rotation_matrix(np.array([1.00001e-4, 0, 0]))
    cosine = -2e-13  # change of cos(a) near a = 1e-4
    np.testing.assert_allclose(above - below, [[0, 0, 0], [0, cosine, -2e-9], [0, 2e-9, cosine]], atol=1e-15)


@given(st.floats(0.05, 3.0), st.floats(0.0, 6.28))
def test_a_tilted_bench_adds_tilt_x_to_i_and_tilt_y_over_sin_i_to_t(inc: float, tf: float) -> None:
    tx, ty = 1e-6, -2e-6
    true_inc, true_tf = attitude_of(bench_gravity(np.array([inc]), np.array([tf]), tx, ty))
    assert true_inc[0] - inc == pytest.approx(tx, abs=1e-9)
    assert np.angle(np.exp(1j * (true_tf[0] - tf))) == pytest.approx(ty / np.sin(inc), abs=1e-8)


@given(st.floats(-1.0, 3.0), st.floats(0.0, 6.28))
def test_the_derivatives_of_gravity_agree_with_differences(inc: float, tf: float) -> None:
    i, t, h = np.array([inc]), np.array([tf]), 1e-6
    by_inc, by_tf = gravity_jacobians(i, t)
    np.testing.assert_allclose(by_inc, (gravity_direction(i + h, t) - gravity_direction(i - h, t)) / (2 * h), atol=1e-9)
    np.testing.assert_allclose(by_tf, (gravity_direction(i, t + h) - gravity_direction(i, t - h)) / (2 * h), atol=1e-9)


def test_normal_gravity_agrees_with_the_published_values_of_wgs84() -> None:
    # NIMA TR8350.2: equator 9.7803253359, pole 9.8321849378; free-air gradient 0.3086 mGal/m
    assert normal_gravity_mps2(0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity_mps2(np.pi / 2) == pytest.approx(9.8321849378, abs=1e-9)
    assert normal_gravity_mps2(0.8, 1000.0) - normal_gravity_mps2(0.8) == pytest.approx(-3.086e-3, rel=1e-3)


@pytest.mark.parametrize("latitude_deg", [0.0, 30.0, 60.0, 90.0])
def test_gravity_falls_off_with_height_as_newtons_law_bends_it(latitude_deg: float) -> None:
    """To second order in the height the inverse-square law bends by 6 g (h / R)^2 over two steps h, upwards."""
    latitude, step = np.deg2rad(latitude_deg), 10_000.0
    ground, middle, top = (normal_gravity_mps2(latitude, k * step) for k in range(3))
    expected = 6.0 * ground * (step / 6_371_000.0) ** 2
    assert top - 2.0 * middle + ground == pytest.approx(expected, rel=0.02)


def test_below_ground_gravity_grows_as_poincare_and_prey_have_it() -> None:
    """Heiskanen and Moritz: 0.0848 mGal/m in rock of 2,670 kg/m3; what 3 km are in rock of 2,200 and 2,700."""
    gradient = gravity_below_mps2(9.81, np.pi / 4, 0.0, 1.0, 2670.0) - 9.81
    assert gradient == pytest.approx(0.848e-6, rel=0.01)
    for density, mg in ((2700.0, 0.25), (2200.0, 0.38)):
        assert (gravity_below_mps2(9.81, np.pi / 4, 0.0, 3000.0, density) - 9.81) / 9.80665e-3 == pytest.approx(
            mg, abs=0.01
        )
    # through a sea of 1,025 kg/m3: 0.2226 mGal/m
    assert gravity_below_mps2(9.81, np.pi / 4, 0.0, 1.0, 1025.0) - 9.81 == pytest.approx(2.226e-6, rel=0.005)


def test_from_equator_to_pole_gravity_changes_by_five_thousandths() -> None:
    change = (normal_gravity_mps2(np.pi / 2) - normal_gravity_mps2(0.0)) / 9.80665
    assert change * 1e3 == pytest.approx(5.3, abs=0.05)


def test_the_uncertainty_of_gravity_follows_latitude_and_height() -> None:
    h = 1e-4
    slope = (normal_gravity_mps2(0.8 + h) - normal_gravity_mps2(0.8 - h)) / (2 * h)
    only_latitude = np.sqrt(normal_gravity_std_mps2(1e-2, 0.0, 0.8) ** 2 - normal_gravity_std_mps2() ** 2)
    assert only_latitude == pytest.approx(slope * 1e-2, rel=0.01)
    assert normal_gravity_std_mps2(height_std_m=1000.0) == pytest.approx(3.1e-3, rel=0.02)
