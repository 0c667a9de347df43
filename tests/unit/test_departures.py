"""The quick check of a session under way gives the joint estimator's own numbers."""

from __future__ import annotations

import numpy as np
import pytest

from highside.calibration.departures import departures
from highside.calibration.joint import joint
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.physics.gravity import gravity_direction

BENCH = BenchAccuracy(pose_rad=float(np.deg2rad(0.0052)))


@pytest.mark.parametrize("wrong_deg", [0.0, 0.2, 3.0])
@pytest.mark.parametrize("inclinations", [(45.0,), (5.0, 45.0, 90.0)])
def test_they_are_those_of_the_joint_estimator(inclinations: tuple[float, ...], wrong_deg: float) -> None:
    rng = np.random.default_rng(4)
    inc = np.deg2rad(np.repeat(inclinations, 6))
    tf = np.deg2rad(np.tile(np.arange(0.0, 360.0, 60.0), len(inclinations)))
    true_tf = tf + rng.normal(0.0, BENCH.pose_rad, tf.size)
    true_tf[3] += np.deg2rad(wrong_deg)
    matrix = np.eye(3) + 3e-3 * rng.standard_normal((3, 3))
    a = matrix @ gravity_direction(inc, true_tf) + 1e-3 + 2e-5 * rng.standard_normal((3, inc.size))
    columns = {"inc_ref_deg": np.rad2deg(inc), "tf_ref_deg": np.rad2deg(tf)} | dict(
        zip(("ax", "ay", "az"), a, strict=True)
    )
    columns |= {f"std_a{axis}": np.full(inc.size, 2e-5) for axis in "xyz"} | {"n": np.ones(inc.size)}
    poses = PoseSet.from_columns(columns)
    whole = joint(poses, bench=BENCH, nonlinear="none", encoder="none", estimate_variances=False)
    assert np.allclose(departures(poses, BENCH), whole.poses.studentised, rtol=1e-9)
    if wrong_deg and len(inclinations) > 1:
        assert int(np.argmax(departures(poses, BENCH))) == 3
