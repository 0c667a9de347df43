"""Pose tables are checked on the way in, one line for each fault; still intervals are found by the noise itself."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.calibration.poses import PoseSet, group_settings
from highside.calibration.still_intervals import find_still_intervals, poses_from_intervals
from highside.errors import InputError
from highside.physics.gravity import gravity_direction


def table(**changes: object) -> dict[str, object]:
    inc, tf = np.array([5.0, 45.0, 90.0, 90.0]), np.array([45.0, 135.0, 0.0, 90.0])
    w = gravity_direction(np.deg2rad(inc), np.deg2rad(tf))
    columns: dict[str, object] = {"inc_ref_deg": inc, "tf_ref_deg": tf, "ax": w[0], "ay": w[1], "az": w[2]}
    return {k: v for k, v in {**columns, **changes}.items() if v is not None}


def test_a_table_in_degrees_becomes_a_pose_set() -> None:
    poses = PoseSet.from_columns(table(n=np.full(4, 10.0), temp_c=np.full(4, 20.0)))  # type: ignore[arg-type]
    assert len(poses) == 4
    assert np.allclose(np.rad2deg(poses.reference()[0]), [5, 45, 90, 90])
    assert not poses.std_known
    assert poses.inclination_stations().tolist() == [0, 1, 2, 2]
    assert poses.subset(np.array([True, False, True, True])).ids == ("1", "3", "4")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ay": None}, "missing column ay"),
        ({"ay": None, "tf_ref_deg": None}, "missing columns ay, tf_ref_deg"),
        ({"az": np.array([1.0, np.nan, 0.0, 0.0])}, "az: not a number in pose 2"),
        ({"ax": np.full(4, 9.8), "ay": np.zeros(4), "az": np.zeros(4)}, "looks like m/s2"),
        ({"ax": np.full(4, 998.0), "ay": np.zeros(4), "az": np.zeros(4)}, "looks like mg"),
        ({"ax": np.full(4, 16384.0), "ay": np.zeros(4), "az": np.zeros(4)}, "raw counts"),
        ({"n": np.array([10.0, 10.0, 0.0, 10.0])}, "n: 0 readings in pose 3"),
        ({"std_ax": np.full(4, 1e-5)}, "give all three"),
        ({"std_ax": np.zeros(4), "std_ay": np.zeros(4), "std_az": np.zeros(4)}, "must be positive"),
        ({"inc_ref_deg": np.array([5.0, 45.0, 90.0, 200.0])}, "inc_ref_deg: 200 is outside"),
    ],
)
def test_a_fault_in_a_table_is_one_line_that_names_it(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError) as error:
        PoseSet.from_columns(table(**changes), where="POSES.csv")  # type: ignore[arg-type]
    assert words in str(error.value)
    assert str(error.value).startswith("POSES.csv")
    assert "\n" not in str(error.value)


def test_a_row_copied_is_not_a_pose_repeated() -> None:
    columns = table()
    for name in ("ax", "ay", "az"):
        columns[name] = np.asarray(columns[name])[[0, 1, 2, 1]]
    with pytest.raises(InputError, match=r"pose 2 .* and pose 4 .* are the same reading"):
        PoseSet.from_columns(columns)  # type: ignore[arg-type]


def test_settings_are_grouped_across_the_turn_of_toolface() -> None:
    groups = group_settings(np.deg2rad(np.array([0.0, 359.999, 90.0, 0.005, 90.001])), modulo=2 * np.pi)
    assert groups[0] == groups[1] == groups[3] != groups[2] == groups[4]
    inc = group_settings(np.deg2rad(np.array([45.0, -45.0, 45.001])))
    assert inc[0] == inc[2] != inc[1]


def test_noise_is_pooled_but_a_rough_pose_keeps_its_own() -> None:
    rng = np.random.default_rng(0)
    std = 50e-6 * np.sqrt(rng.chisquare(9, (3, 40)) / 9)
    std[:, 7] = 500e-6
    w = gravity_direction(np.linspace(0.1, 3.0, 40), np.linspace(0.0, 6.0, 40))
    noise = PoseSet.build(w, n=10, std=std).noise_of_mean() * np.sqrt(10)
    assert np.allclose(noise[:, 0], 50e-6, rtol=0.12)
    assert np.all(noise[:, :7] == noise[:, [0]])
    assert np.allclose(noise[:, 7], 500e-6)


def session(noise_g: float, rng: np.random.Generator) -> tuple[Array, list[tuple[int, int]]]:
    """Ten poses of 6 s with turns of 2 s between them at 100 Hz, and where the poses are."""
    attitudes = gravity_direction(rng.uniform(0.2, 2.8, 10), rng.uniform(0.0, 6.0, 10))
    parts, places, at = [], [], 0
    for k in range(10):
        places.append((at, at + 600))
        parts.append(np.repeat(attitudes[:, [k]], 600, axis=1))
        if k < 9:
            share = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 200))
            way = attitudes[:, [k]] * (1 - share) + attitudes[:, [k + 1]] * share
            parts.append(way / np.linalg.norm(way, axis=0))
        at += 800
    a = np.concatenate(parts, axis=1)
    return a + noise_g * rng.standard_normal(a.shape), places


@pytest.mark.parametrize("noise_g", [20e-6, 1e-3, 6e-3])
def test_still_intervals_are_found_whatever_the_noise_of_the_sensor(noise_g: float) -> None:
    a, places = session(noise_g, np.random.default_rng(3))
    found = find_still_intervals(a, 100.0)
    assert len(found) == 10
    for interval, (start, stop) in zip(found, places, strict=True):
        assert start - 15 <= interval.start <= start + 110
        assert stop - 110 <= interval.stop <= stop + 15
    poses = poses_from_intervals(a, found, temp_c=np.full(a.shape[1], 21.0))
    assert np.all(poses.temp_c == 21.0)  # type: ignore[arg-type]
    truth = np.stack([a[:, s + 100 : t - 100].mean(axis=1) for s, t in places], axis=1)
    assert np.abs(poses.a - truth).max() < max(10 * noise_g / np.sqrt(300), 3e-5)


def test_a_disturbed_pose_stays_one_pose_and_the_disturbance_is_left_out() -> None:
    rng = np.random.default_rng(4)
    a, places = session(1e-3, rng)
    middle = places[4][0] + 300
    a[:, middle : middle + 40] += 0.05 * rng.standard_normal((3, 40))
    found = find_still_intervals(a, 100.0)
    assert len(found) == 10
    rows = found[4].rows()
    assert not np.any((rows >= middle) & (rows < middle + 40))
    assert rows.size > 350


def test_nothing_still_is_said() -> None:
    turning = gravity_direction(np.linspace(0.0, 3.0, 3000), np.linspace(0.0, 60.0, 3000))
    with pytest.raises(InputError, match="still"):
        find_still_intervals(turning + 1e-4 * np.random.default_rng(0).standard_normal(turning.shape), 100.0)
    with pytest.raises(InputError, match="too few"):
        find_still_intervals(np.zeros((3, 5)), 100.0)


@pytest.mark.parametrize("hold_s", [1.8, 2.0, 2.2])
def test_holds_of_two_seconds_are_found_wherever_they_begin(hold_s: float) -> None:
    """They lie in three or four windows of half a second, of which those at their ends share a movement."""
    rng = np.random.default_rng(1)
    holds, move_s, rate_hz, sigma = 20, 1.37, 50.0, 1e-3
    aims = rng.normal(size=(holds, 3))
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)
    t_s = np.arange(int(holds * (hold_s + move_s) * rate_hz)) / rate_hz
    which = np.minimum((t_s / (hold_s + move_s)).astype(int), holds - 1)
    share = np.clip((t_s - which * (hold_s + move_s) - hold_s) / move_s, 0.0, 1.0)[:, None]
    up = (1 - share) * aims[which] + share * aims[np.minimum(which + 1, holds - 1)]
    a = up.T / np.linalg.norm(up, axis=1) + rng.normal(0, sigma, (3, t_s.size))
    found = find_still_intervals(a, rate_hz)
    assert len(found) == holds
    for k, interval in enumerate(found):
        assert interval.rows().size >= 1.5 * rate_hz
        assert np.abs(a[:, interval.rows()].mean(axis=1) - aims[k]).max() < sigma
