"""Structure that no term describes: found, corrected and honestly stated; nothing changes where there is none."""

from __future__ import annotations

import json

import numpy as np
import pytest

from highside.arrays import Array
from highside.calibration.conventional import least_squares
from highside.calibration.joint import joint
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.poses import PoseSet
from highside.calibration.refinement import refine
from highside.calibration.remark import Reason
from highside.calibration.result import CalibrationResult
from highside.physics import structure
from highside.physics.effect import Effect
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState
from studies.scenario import DirectionSine, MultiSine, Scenario, reference_scenario

TWELVE = tuple(15.0 + 30.0 * k for k in range(12))
INC, TF = (
    x.ravel() for x in np.meshgrid(np.deg2rad([0.6, 5.0, 30.0, 52.0, 75.0, 90.0]), np.deg2rad(np.arange(0, 360, 15)))
)


def pose_set(scenario: Scenario) -> PoseSet:
    p = scenario.poses
    return PoseSet.build(p.mean, inc_ref_rad=p.inc_ref, tf_ref_rad=p.tf_ref, n=p.n, std=p.std)


def errors(result: CalibrationResult, scenario: Scenario) -> Array:
    """Errors (2, N) of I and, times sin I, of T by the calibration alone, in rad."""
    g = result.correct(scenario.read(INC, TF))
    d_tf = np.angle(np.exp(1j * (np.arctan2(g[1], g[0]) - TF)))
    return np.stack([np.arctan2(np.hypot(g[0], g[1]), g[2]) - INC, d_tf * np.sin(INC)])


def rms_deg(values: list[Array]) -> Array:
    return np.asarray(np.rad2deg(np.sqrt(np.mean(np.square(values), axis=(0, 2)))))


@pytest.mark.parametrize("effect", [structure.OWN_LOAD, structure.DIRECTION])
def test_derivatives_of_the_structures_are_right(effect: Effect) -> None:
    rng = np.random.default_rng(0)
    p = rng.standard_normal(len(effect.parameters))
    x = rng.uniform(-1, 1, (3, 9))
    state = ChainState.nowhere()
    np.testing.assert_allclose(
        np.tensordot(p, effect.derivative(state, p, x), 1), effect.delta(state, p, x), atol=1e-12
    )
    slope = effect.input_jacobian(state, p, x)
    for j in range(3):
        step = np.zeros((3, 1))
        step[j] = 1e-6
        ahead, back = effect.delta(state, p, x + step), effect.delta(state, p, x - step)
        np.testing.assert_allclose(slope[:, j], (ahead - back) / 2e-6, atol=1e-6)


def test_harmonics_are_orthonormal_over_the_sphere() -> None:
    z, weight = np.polynomial.legendre.leggauss(12)
    turn = np.arange(24) * np.pi / 12
    inc, tf = np.repeat(np.arccos(z), 24), np.tile(turn, 12)
    Y = structure.harmonics(gravity_direction(inc, tf))
    np.testing.assert_allclose((Y * np.repeat(weight / 48, 24)) @ Y.T, np.eye(structure.HARMONICS), atol=1e-12)


def test_prior_variances_are_those_of_the_stated_size() -> None:
    loads = np.linspace(-0.9, 0.9, 7)
    p = structure.OwnLoad.prior_variances(2e-3, 0.3)
    basis = structure.OWN_LOAD.basis(ChainState.nowhere(), np.stack([loads] * 3))[: structure.WAVES, 0]
    np.testing.assert_allclose(np.sqrt(p @ basis**2), 2e-3, rtol=0.02)
    assert structure.Direction.prior_variances(1e-3, 0.5).sum() == pytest.approx(1e-6)


def test_a_sensor_without_structure_is_left_as_it_is() -> None:
    for seed in range(4):
        for toolfaces in ((45.0, 135.0, 225.0, 315.0), TWELVE):
            for bench in ({}, {"pose_error_deg": 0.0, "inc_station_error_deg": 0.009, "tf_station_error_deg": 0.009}):
                poses = pose_set(reference_scenario(seed, toolfaces_deg=toolfaces, **bench))  # type: ignore[arg-type]
                plain = joint(poses)
                same = refine(plain, poses)
                assert same.main.parameters.names == plain.main.parameters.names
                np.testing.assert_array_equal(same.main.parameters.values, plain.main.parameters.values)
                np.testing.assert_array_equal(same.main.parameters.covariance, plain.main.parameters.covariance)
                assert same.options["structure_own_g"] == same.options["structure_field_g"] == 0.0


@pytest.mark.parametrize(
    ("kind", "toolfaces", "worst_deg", "gain"),
    [
        (MultiSine, (45.0, 135.0, 225.0, 315.0), 0.0125, 3.0),
        (MultiSine, TWELVE, 0.002, 10.0),
        (DirectionSine, TWELVE, 0.006, 5.0),
    ],
)
def test_structure_is_found_and_the_stated_uncertainty_is_the_error(
    kind: type[MultiSine], toolfaces: tuple[float, ...], worst_deg: float, gain: float
) -> None:
    refined, squares, pulls = [], [], []
    for seed in range(3):
        scenario = reference_scenario(seed, toolfaces_deg=toolfaces, structure_g=1e-3, structure=kind)
        poses = pose_set(scenario)
        result = refine(joint(poses), poses)
        assert float(result.options["structure_own_g"]) + float(result.options["structure_field_g"]) > 1e-4
        assert Reason.MISFIT not in [remark.reason for remark in result.remarks]
        refined.append(errors(result, scenario))
        squares.append(errors(least_squares(poses), scenario))
        std_inc, std_tf = result.predict_std(INC, TF, 0.0)
        pulls.append(refined[-1] / np.stack([std_inc, std_tf * np.sin(INC)]))
    mine, theirs = rms_deg(refined), rms_deg(squares)
    assert mine[0] < worst_deg
    assert np.all(mine < theirs / gain)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.3


def test_a_bad_pose_is_not_taken_for_structure() -> None:
    scenario = reference_scenario(2)
    poses = pose_set(scenario)
    a = poses.a.copy()
    a[:, [9]] = scenario.read(scenario.poses.inc_true[[9]], scenario.poses.tf_true[[9]] + np.deg2rad(1.0))
    bad = PoseSet.build(a, inc_ref_rad=poses.inc_ref_rad, tf_ref_rad=poses.tf_ref_rad, n=poses.n, std=poses.std)
    result = refine(joint(bad), bad)
    assert result.options["structure_own_g"] == result.options["structure_field_g"] == 0.0
    assert not result.poses.used[9]


def test_a_refined_result_is_applied_frame_by_frame_as_in_bulk_and_survives_json() -> None:
    scenario = reference_scenario(1, structure_g=1e-3)
    poses = pose_set(scenario)
    result = refine(joint(poses), poses)
    result = CalibrationResult.from_dict(json.loads(json.dumps(result.to_dict())))
    correction = LinearCorrection(result.main)
    m = scenario.read(INC, TF, np.random.default_rng(0))
    block = correction.corrected_block(m, 1e-5)
    np.testing.assert_allclose(block.g, result.correct(m), atol=1e-9)
    for k in range(0, INC.size, 37):
        one = correction.correct((float(m[0, k]), float(m[1, k]), float(m[2, k])), (1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10))
        np.testing.assert_allclose((one.gx, one.gy, one.gz), block.g[:, k], atol=1e-12)
        np.testing.assert_allclose(one.cov, block.cov[:, k], rtol=1e-2, atol=1e-13)
    stated = result.covariance_of(gravity_direction(INC[:3], TF[:3]))
    found = correction.covariance_block(gravity_direction(INC[:3], TF[:3]))
    np.testing.assert_allclose(found[0], stated[:, 0, 0], rtol=1e-9)
