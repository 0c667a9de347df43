"""Three real hand sessions, calibrated by |g| alone: poses found by the sensor's own noise, judged pose by pose."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from highside.arrays import Array
from highside.calibration.magnitude import leave_one_out_errors, magnitude
from highside.calibration.poses import PoseSet
from highside.calibration.still_intervals import find_still_intervals, poses_from_intervals

RATE_HZ = 100.0


def recording(folder: Path, name: str) -> Array:
    """Readings (3, N) in nominal g."""
    if name == "imu_tk":
        with np.load(folder / "imu_tk_xsens_mti.npz") as data:
            return (data["acc"].T.astype(float) - 2**15) / 2**12  # raw counts of a range of +-8 g
    with gzip.open(folder / f"{name}.log.gz", "rt") as lines:
        return np.asarray(np.loadtxt(lines)[:, :3].T / 9.80665)


def poses_of(folder: Path, name: str) -> PoseSet:
    a = recording(folder, name)
    return poses_from_intervals(a, find_still_intervals(a, RATE_HZ))


# poses, and the rms of |a| over poses left out that is to be reached, mg
SESSIONS = [("imu_tk", 38, 0.16), ("mpu9150_imu0", 22, 0.37), ("mpu9150_imu1", 22, 0.33)]


@pytest.mark.parametrize(("name", "count", "bar_mg"), SESSIONS)
def test_every_pose_is_found_and_the_ones_left_out_are_predicted(
    shared_data: Path, name: str, count: int, bar_mg: float
) -> None:
    poses = poses_of(shared_data / "accel_multipose", name)
    assert len(poses) == count
    error_mg = 1e3 * leave_one_out_errors(poses)
    assert error_mg.size == count
    assert np.sqrt(np.mean(error_mg**2)) <= bar_mg
    # the nominal sensor is out by tens of mg: the calibration does the work
    assert 1e3 * np.std(np.linalg.norm(poses.a, axis=0)) > 10 * bar_mg


@pytest.mark.parametrize(("name", "count", "bar_mg"), SESSIONS)
def test_no_quadratic_term_is_admitted_and_one_would_predict_worse(
    shared_data: Path, name: str, count: int, bar_mg: float
) -> None:
    poses = poses_of(shared_data / "accel_multipose", name)
    result = magnitude(poses)
    assert result.options["admitted"] == "none"
    assert result.options["log_bayes_quadratic"] < 0
    assert result.poses.used.all()
    without, with_term = (np.sqrt(np.mean(leave_one_out_errors(poses, nonlinear=term) ** 2)) for term in (False, True))
    assert with_term > without


@pytest.mark.parametrize("name", ["imu_tk", "mpu9150_imu0"])
def test_the_gauge_does_not_change_the_magnitude(shared_data: Path, name: str) -> None:
    poses = poses_of(shared_data / "accel_multipose", name)
    symmetric, upper = (magnitude(poses, gauge=gauge) for gauge in ("symmetric", "upper"))  # type: ignore[arg-type]
    assert np.allclose(symmetric.A, symmetric.A.T, atol=1e-15)
    assert np.allclose(np.tril(upper.A, -1), 0.0)
    sizes = [np.linalg.norm(result.correct(poses.a), axis=0) for result in (symmetric, upper)]
    assert np.allclose(sizes[0], sizes[1], atol=2e-6)


def test_a_quadratic_term_that_is_there_is_found(shared_data: Path) -> None:
    """The gate that keeps g2 out of the real sets opens for the same set with 5 mg/g^2 put in."""
    poses = poses_of(shared_data / "accel_multipose", "imu_tk")
    result = magnitude(poses)
    g = result.correct(poses.a)
    bent = PoseSet.build(poses.a + np.array([[5e-3], [0.0], [-4e-3]]) * g**2, n=poses.n, std=poses.std)
    found = magnitude(bent)
    assert found.options["admitted"] == "quadratic"
    assert found.main.parameters.get("K2_x") == pytest.approx(5e-3, abs=4 * found.main.parameters.std("K2_x"))


def test_a_pose_in_which_the_tool_moved_is_named(shared_data: Path) -> None:
    poses = poses_of(shared_data / "accel_multipose", "imu_tk")
    a = poses.a.copy()
    a[:, 7] *= 1.005
    result = magnitude(PoseSet.build(a, n=poses.n, std=poses.std))
    assert not result.poses.used[7]
    assert result.poses.used.sum() == len(poses) - 1
    assert any(remark.poses == ("8",) and remark.refused for remark in result.remarks)
