"""The simulated tool's motion: smooth, consistent with its gyros, the same for one instant and for many."""

from __future__ import annotations

import numpy as np
import pytest

from highside.physics.motion import Leg, Motion, demo, still


def test_gravity_follows_inclination_and_toolface() -> None:
    block = demo().block(np.linspace(0.0, 300.0, 2001))
    i, t = block.inclination_rad, block.toolface_rad
    assert np.allclose(block.gravity, [np.sin(i) * np.cos(t), np.sin(i) * np.sin(t), np.cos(i)], atol=1e-15)
    assert np.allclose(np.linalg.norm(block.gravity, axis=0), 1.0, atol=1e-15)


def test_gyros_turn_the_gravity_vector_as_it_moves() -> None:
    """dG/dt = -w x G, checked by central differences in the middle of legs and over their joints."""
    motion = demo()
    t, h = np.linspace(0.05, motion.duration_s * 1.5, 4001), 1e-5
    change = (motion.block(t + h).gravity - motion.block(t - h).gravity) / (2 * h)
    now = motion.block(t)
    expected = -np.cross(now.gyro_rad_s, now.gravity, axis=0)
    assert np.abs(change).max() > 1.0
    assert np.abs(change - expected).max() < 1e-4


def test_rates_are_continuous_and_vanish_at_the_ends_of_legs() -> None:
    motion = demo()
    t = np.arange(0.0, 2 * motion.duration_s, 1e-3)
    block = motion.block(t)
    assert np.abs(np.diff(block.toolface_rate_rad_s)).max() < 0.02
    assert np.abs(np.diff(block.inclination_rate_rad_s)).max() < 0.02
    joints = np.cumsum([leg.duration_s for leg in motion.legs])
    assert np.abs(motion.block(joints).gyro_rad_s).max() < 1e-9


def test_toolface_grows_clockwise_looking_down_hole_which_is_negative_about_z() -> None:
    block = Motion((Leg(10.0, turn_deg=90.0),), repeat=False).block([5.0])
    assert block.toolface_rate_rad_s[0] > 0.0
    assert block.gyro_rad_s[2, 0] == -block.toolface_rate_rad_s[0]


def test_a_leg_ends_where_it_was_told_to() -> None:
    motion = Motion((Leg(4.0, inclination_to_deg=35.0, turn_deg=-400.0), Leg(2.0)), 10.0, 50.0, repeat=False)
    end = motion.block([4.0, 5.0, 99.0])
    assert np.allclose(np.rad2deg(end.inclination_rad), 35.0)
    assert np.allclose(np.rad2deg(end.toolface_rad), -350.0)
    assert np.allclose(end.gyro_rad_s, 0.0)


def test_one_instant_equals_the_same_instant_in_a_block_in_any_order() -> None:
    motion = demo(seed=3)
    t = np.random.default_rng(0).uniform(-5.0, 400.0, 200)
    block = motion.block(t)
    for k in range(0, 200, 17):
        one = motion.block(t[k])
        for single, many in zip(one, block, strict=True):
            assert np.array_equal(single[..., 0], many[..., k])


def test_repetition_goes_on_turning_and_does_not_jump() -> None:
    motion = Motion((Leg(3.0, turn_deg=100.0), Leg(1.0)), 20.0, 0.0)
    later = motion.block([4.0 - 1e-9, 4.0 + 1e-9, 8.0 + 1e-9])
    assert np.allclose(np.rad2deg(later.toolface_rad), [100.0, 100.0, 200.0], atol=1e-6)
    with pytest.raises(ValueError, match="end where it began"):
        Motion((Leg(3.0, inclination_to_deg=40.0),), 20.0)


def test_shaking_has_the_stated_rms_and_depends_on_the_seed_alone() -> None:
    motion = Motion((Leg(2.0), Leg(100.0, vibration_g=0.05)), seed=7)
    t = np.arange(30.0, 75.0, 1e-3)  # inside the plateau
    shaken = motion.block(t)
    assert np.allclose(shaken.vibration_rms_g, 0.05)
    assert np.allclose(np.sqrt(np.mean(shaken.vibration_g**2, axis=1)), 0.05, rtol=0.1)
    assert np.array_equal(Motion(motion.legs, seed=7).block(t).vibration_g, shaken.vibration_g)
    assert not np.allclose(Motion(motion.legs, seed=8).block(t).vibration_g, shaken.vibration_g)
    assert not np.any(motion.block(np.linspace(0.0, 2.0, 50)).vibration_g)


def test_the_demonstration_visits_5_to_60_degrees_stops_for_surveys_and_shakes() -> None:
    motion = demo()
    block = motion.block(np.arange(0.0, motion.duration_s, 0.01))
    inclination = np.rad2deg(block.inclination_rad)
    assert inclination.min() == pytest.approx(5.0)
    assert inclination.max() == pytest.approx(60.0)
    assert np.rad2deg(np.abs(block.toolface_rate_rad_s)).max() > 90.0
    assert block.vibration_rms_g.max() > 0.02
    stops = motion.still_intervals(motion.duration_s)
    assert len(stops) >= 6
    assert all(end - start >= 7.0 for start, end in stops)
    for start, end in stops:
        inside = motion.block(np.linspace(start, end, 20))
        assert np.allclose(inside.gyro_rad_s, 0.0, atol=1e-12)


def test_a_still_tool_stays_still() -> None:
    block = still(33.0, 210.0).block(np.linspace(0.0, 1e4, 100))
    assert np.allclose(np.rad2deg(block.inclination_rad), 33.0)
    assert np.allclose(np.rad2deg(block.toolface_rad), 210.0)


def test_a_motion_without_legs_or_with_a_leg_of_no_duration_is_refused() -> None:
    for legs in ((), (Leg(0.0),), (Leg(float("nan")),)):
        with pytest.raises(ValueError, match="legs"):
            Motion(legs)
