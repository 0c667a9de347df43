"""What happens while a pose is held is looked at: a mean would hide it."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.poses.session import pose_session
from highside.diagnosis.poses.within import moving_pose, unsteady_poses, within_poses

POSES, ROWS, STEP_S, SIGMA_G = 24, 50, 0.2, 2e-4


def rows_of() -> list[np.ndarray]:
    return [np.arange(k * ROWS, (k + 1) * ROWS) for k in range(POSES)]


def recording(course: Array, seed: int = 1, memory: float = 0.0) -> Array:
    """Rows (3, N) at levels of their own, with noise and a course (POSES, ROWS) on the second channel."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((3, POSES, ROWS))
    for k in range(1, ROWS):
        noise[:, :, k] = memory * noise[:, :, k - 1] + np.sqrt(1 - memory**2) * noise[:, :, k]
    rows = rng.uniform(-1, 1, (3, POSES, 1)) + SIGMA_G * noise
    rows[1] += course
    return np.asarray(rows.reshape(3, -1))


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("seed", range(8))
def test_noise_does_nothing_within_a_pose(seed: int, memory: float) -> None:
    assert within_poses(recording(np.zeros((POSES, ROWS)), seed, memory), rows_of(), STEP_S) == ()


@pytest.mark.parametrize("size_g", [2e-4, 1e-3, 1.0])
def test_settling_is_found_with_its_channel_and_size(size_g: float) -> None:
    course = size_g * np.exp(-np.arange(ROWS) / 8) * np.ones((POSES, 1))
    found = within_poses(recording(course), rows_of(), STEP_S)
    assert {one.check for one in found} == {"within_pose"} and {one.channels for one in found} == {("ay",)}
    assert "settle within the first" in found[0].remedy
    size = float(found[0].remedy.split("ay by ")[1].split(" ug")[0])
    assert abs(1e-6 * size / size_g - 1) < 0.3


def test_creep_that_follows_the_pose_is_found() -> None:
    rng = np.random.default_rng(3)
    course = 3e-4 * rng.standard_normal((POSES, 1)) * np.linspace(-1, 1, ROWS)
    found = within_poses(recording(course), rows_of(), STEP_S)
    assert any("creep" in one.remedy and one.channels == ("ay",) for one in found)


@pytest.mark.parametrize("size_g", [1e-2, 1.0])
def test_what_each_pose_does_its_own_way_no_pose_does_alike(size_g: float) -> None:
    """A slow oscillation, cut by the poses: the mean of their trends was told as one that they have in common."""
    for seed in range(6):
        began = np.cumsum(np.random.default_rng(seed).uniform(12.0, 100.0, POSES))
        course = size_g * np.sin(2 * np.pi * (began[:, None] + STEP_S * np.arange(ROWS)) / 251.0)
        (found,) = within_poses(recording(course, seed), rows_of(), STEP_S)
        assert "each pose its own way" in found.remedy and found.channels == ("ay",)


def test_a_converter_coarser_than_the_noise_creeps_nowhere() -> None:
    """Poses that jump by a step of the converter, beside others that stay, crept in 55 of 300 such sessions."""
    rng = np.random.default_rng(5)
    poses, rows, step = 30, 8, 2e-4
    numbers = [np.arange(k * rows, (k + 1) * rows) for k in range(poses)]
    course = np.zeros((3, poses, rows))
    course[1] = 3 * rng.standard_normal((poses, 1)) * np.linspace(-1, 1, rows)
    told = []
    for _ in range(24):
        levels = rng.uniform(-100, 100, (3, poses, 1)) + 0.05 * rng.standard_normal((3, poses, rows))
        for put in (0.0, 1.0):
            readings = step * np.round(levels + put * course)
            told.append(within_poses(readings.reshape(3, -1), numbers, 1.0))
    assert not any(told[::2])
    assert all(any("creep" in one.remedy and one.channels == ("ay",) for one in found) for found in told[1::2])


def test_a_line_is_found_with_its_frequency() -> None:
    rng = np.random.default_rng(4)
    phase = rng.uniform(0, 2 * np.pi, (POSES, 1))
    course = 1.5e-4 * np.sin(2 * np.pi * 1.1 * STEP_S * np.arange(ROWS) + phase)
    found = within_poses(recording(course), rows_of(), STEP_S)
    assert [one.channels for one in found] == [("ay",)]
    hz = float(found[0].remedy.split("oscillate at ")[1].split(" Hz")[0])
    size = float(found[0].remedy.split("ay by ")[1].split(" ug")[0])
    assert abs(hz - 1.1) < 0.05 and abs(size - 300) < 60


@pytest.mark.parametrize("size_g", [1e-3, 1.0])
def test_a_course_of_any_shape_is_found_in_few_rows(size_g: float) -> None:
    few = [r[:6] for r in rows_of()]
    course = np.zeros((POSES, ROWS))
    course[:, :6] = size_g * np.array([1, -1, -2, -1, 1, 2]) / 4
    (found,) = within_poses(recording(course), few, STEP_S)
    assert "drift alike in every pose" in found.remedy and found.channels == ("ay",)
    size = float(found.remedy.split("ay by ")[1].split(" ug")[0])
    assert abs(1e-6 * size / size_g - 1) < 0.3


def test_a_course_that_grows_with_the_load_is_found_though_its_mean_is_none() -> None:
    rows = recording(np.zeros((POSES, ROWS)))
    load = rows[1].reshape(POSES, ROWS).mean(axis=1, keepdims=True)
    rows[1] += (5e-3 * (load - load.mean()) * np.linspace(-1, 1, ROWS) ** 2).ravel()
    few = [r[10:40:5] for r in rows_of()]
    (found,) = within_poses(rows, few, STEP_S)
    assert "in proportion to its load" in found.remedy and found.channels == ("ay",)


@pytest.mark.parametrize("length", [3, 6, 8])
@pytest.mark.parametrize("tails", [False, True])
def test_noise_has_no_course_in_few_rows(length: int, tails: bool) -> None:
    # 90 sessions: at the chance that is allowed (1e-5 for each of six tests) one alarm has a probability of 0.005
    for seed in range(15):
        rng = np.random.default_rng([seed, length])
        noise = rng.standard_t(3, (3, 60, length)) if tails else rng.standard_normal((3, 60, length))
        rows = (rng.uniform(-1, 1, (3, 60, 1)) + 1e-4 * noise).reshape(3, -1)
        assert within_poses(rows, [np.arange(k * length, (k + 1) * length) for k in range(60)], STEP_S) == ()


def test_too_few_rows_or_poses_say_nothing() -> None:
    rows = recording(np.linspace(-1, 1, ROWS) * np.ones((POSES, 1)))
    assert within_poses(rows, [r[:2] for r in rows_of()], STEP_S) == ()
    assert within_poses(rows, rows_of()[:3], STEP_S) == ()


def session_of(course: Array, seed: int) -> tuple[Array, Array]:
    """Scatter (3, POSES) of five rows in each pose, with a course (POSES, 5) on the second channel, and their count."""
    rng = np.random.default_rng(seed)
    rows = SIGMA_G * rng.standard_normal((3, POSES, 5))
    rows[1] += course
    return np.asarray(rows.std(axis=2, ddof=1)), np.full(POSES, 5.0)


@pytest.mark.parametrize("size_g", [2e-3, 0.1, 10.0])
def test_a_course_that_averages_out_shows_beside_the_means(size_g: float) -> None:
    """Each pose its own way, in poses too short for a trend of their own: its mean, and with it the fit, knows nothing
    of it."""
    rng = np.random.default_rng(9)
    course = size_g * rng.standard_normal((POSES, 1)) * np.array([-1.0, -0.5, 0.3, 0.4, 0.8])
    of_a_mean = np.full(3, SIGMA_G / np.sqrt(5))
    found = unsteady_poses(*session_of(course, 1), of_a_mean, 20.0)
    assert [(one.check, one.channels) for one in found] == [("within_pose", ("ay",))]
    told = float(found[0].remedy.split("ay by ")[1].split(" ug")[0])
    assert abs(1e-6 * told / size_g / 0.76 - 1) < 0.3


def test_noise_moves_the_means_as_much_as_the_rows() -> None:
    """Also where the fit is known to a few degrees of freedom only; none of 300 sessions."""
    of_a_mean = SIGMA_G / np.sqrt(5)
    rng = np.random.default_rng(4)
    for seed in range(300):
        learned = of_a_mean * np.sqrt(rng.chisquare(6, 3) / 6)
        assert unsteady_poses(*session_of(np.zeros((POSES, 5)), seed), learned, 6.0) == ()


def few_rows(seed: int, loud: Array | None = None, outlier_g: float = 0.0) -> tuple[Array, list[np.ndarray]]:
    """17 poses of 7 rows: too few for the course of each."""
    rng = np.random.default_rng(seed)
    noise = SIGMA_G * rng.standard_normal((3, 17, 7)) * (np.ones(17) if loud is None else loud)[:, None]
    noise[0, 4, 6] += outlier_g
    rows = rng.uniform(-1, 1, (3, 17, 1)) + noise
    return np.asarray(rows.reshape(3, -1)), [np.arange(7 * k, 7 * k + 7) for k in range(17)]


@pytest.mark.parametrize("size_g", [4e-3, 1.0])
def test_a_single_pose_in_which_readings_move_is_found(size_g: float) -> None:
    """A law that sets in while one pose is held raised what all were said to scatter by, and "nothing" was left out."""
    readings, rows = few_rows(1)
    readings[:2, rows[9]] += size_g * np.array([0.0, -0.1, 0.2, 0.6, 0.9, 1.0, 1.0])
    moved = moving_pose(readings, rows)
    assert moved is not None
    number, found = moved
    assert (number, found.check, found.channels) == (9, "within_pose", ("ax", "ay"))
    assert found.remedy.startswith("readings move while pose 10 is held, unlike in the others: ax by ")


def test_a_pose_that_moved_raises_the_floor_of_no_other() -> None:
    """Its own mean is known no better than its rows move; else what the others repeat by stood at a third of that."""
    readings, rows = few_rows(1)
    n = len(rows)
    columns = {
        "t_s": 5.0 * np.arange(readings.shape[1]),
        "inc_ref_deg": np.repeat(np.linspace(10.0, 80.0, n), 7),
        "tf_ref_deg": np.repeat(40.0 * np.arange(n) % 360.0, 7),
        "pose": np.repeat(np.arange(n, dtype=float), 7),
    }

    def floor_of(accel_g: Array) -> Array:
        session = pose_session(
            columns | dict(zip(("ax_g", "ay_g", "az_g"), accel_g, strict=True)), accel_g, gravity_mps2=9.8
        )
        assert session.floor is not None
        return session.floor.sigma

    still = floor_of(readings)
    readings[:2, rows[9]] += 0.1 * np.array([0.0, -0.1, 0.2, 0.6, 0.9, 1.0, 1.0])
    found = floor_of(readings)
    others = np.arange(n) != 9
    # six of 102 differences are not there
    np.testing.assert_allclose(found[:, others], still[:, others], rtol=0.1)
    assert np.all(found[:2, 9] > 0.03)


def test_a_loud_pose_an_outlying_row_and_noise_move_nothing() -> None:
    """One in a hundred loud poses goes one way by chance; more than 5 of 100 are less likely than 0.1 %."""
    moved = 0
    for seed in range(100):
        moved += bool(moving_pose(*few_rows(seed, np.where(np.arange(17) == seed % 17, 6.0, 1.0))))
        assert moving_pose(*few_rows(seed, outlier_g=0.1)) is None
        assert moving_pose(*few_rows(seed)) is None
    assert moved <= 5
