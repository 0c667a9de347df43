"""Poses of a recording whose rows are numbered: slow readings, disturbed rows, runs that move."""

from __future__ import annotations

import numpy as np
import pytest

from highside.calibration.still_intervals import labelled_intervals, poses_from_intervals
from highside.errors import InputError

NOISE_G = 35e-6


def session(rows: int, poses: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(3, N) readings of `poses` attitudes one after the other without rows in between, and their numbers."""
    rng = np.random.default_rng(seed)
    g = rng.standard_normal((3, poses))
    g /= np.linalg.norm(g, axis=0)
    a = np.repeat(g, rows, axis=1) + NOISE_G * rng.standard_normal((3, rows * poses))
    return a, np.repeat(np.arange(poses, dtype=float), rows)


def test_ten_rows_a_pose_without_any_motion_between_are_all_found():
    a, labels = session(10, 44)
    found = labelled_intervals(a, labels)
    assert len(found) == 44
    kept = sum(interval.rows().size for interval in found)
    assert kept >= 435  # six sigma of a noise that is itself estimated
    poses = poses_from_intervals(a, found)
    assert np.abs(poses.a - a.reshape(3, 44, 10).mean(axis=2)).max() < 2 * NOISE_G


def test_rows_on_the_way_in_and_a_touch_are_left_out():
    a, labels = session(50, 5)
    a[:, 50:56] += 0.01
    a[0, 120] += 0.5
    found = labelled_intervals(a, labels)
    assert found[1].start == 56
    assert 120 not in found[2].rows()
    assert len(found) == 5


def test_a_run_that_moves_and_rows_without_a_number_are_no_pose():
    a, labels = session(50, 5)
    a[0, 100:150] += np.linspace(0.0, 0.1, 50)
    labels[0:50] = -1.0
    found = labelled_intervals(a, labels)
    assert [interval.start // 50 for interval in found] == [1, 3, 4]


def test_a_recording_that_only_moves_is_refused():
    a, labels = session(30, 2)
    a[0] += np.linspace(0.0, 1.0, 60)
    with pytest.raises(InputError, match="moves in every"):
        labelled_intervals(a, labels)
    with pytest.raises(InputError, match="three rows"):
        labelled_intervals(a, np.full(60, -1.0))
