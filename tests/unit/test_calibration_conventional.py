"""Conventional and balance correction: the paper's example, what each method absorbs, and what it must refuse."""

from __future__ import annotations

import json

import numpy as np
import pytest

from highside.arrays import Array
from highside.calibration.balance import TRIPLES, balance, balance_matrix, closures_of, zone_limits
from highside.calibration.conventional import conventional, least_squares, position_plan
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.remark import CalibrationRefused, Reason
from highside.calibration.result import CalibrationResult
from highside.errors import InputError
from highside.physics.gravity import gravity_direction
from highside.physics.plan import pose_grid
from studies.scenario import reference_scenario

QUADRANTS = (45.0, 135.0, 225.0, 315.0)
# equation (10): readings of a real accelerometer in the three conventional poses, and its inverse
PAPER_S = np.array([
    [0.9991259, 0.0038336, -0.0006875],
    [-0.0018858, 0.9988513, 0.0001215],
    [0.0008911, 0.0002816, 0.9981544],
])  # fmt: skip
PAPER_C = np.array([
    [1.0008670, -0.0038415, 0.0006898],
    [0.0018897, 1.0011428, -0.0001206],
    [-0.0008941, -0.0002790, 1.0018484],
])  # fmt: skip
EXACT = BenchAccuracy(tilt_rad=0.0, pose_rad=0.0)


def measured(A: Array, b: Array, inc: Array, tf: Array, noise: Array | None = None) -> PoseSet:
    m = A @ gravity_direction(inc, tf) + b[:, None]
    return PoseSet.build(m if noise is None else m + noise, inc_ref_rad=inc, tf_ref_rad=tf, n=10, std=30e-6)


def sensor(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return np.eye(3) + rng.uniform(-5e-3, 5e-3, (3, 3)), rng.uniform(-2e-3, 2e-3, 3)


def test_three_poses_give_the_inverse_of_the_papers_example() -> None:
    inc, tf = position_plan(3)
    assert np.allclose(gravity_direction(inc, tf), np.eye(3), atol=1e-15)
    result = conventional(PoseSet.build(PAPER_S, inc_ref_rad=inc, tf_ref_rad=tf))
    assert np.allclose(result.C @ PAPER_S, np.eye(3), atol=1e-14)
    assert np.allclose(result.C, PAPER_C, atol=6e-8)


def test_the_matrix_printed_in_the_paper_is_not_an_inverse() -> None:
    """Erratum 1: elements 12, 21, 23 and 32 have lost the sign of their cofactor."""
    printed = PAPER_C.copy()
    for i, j in ((0, 1), (1, 0), (1, 2), (2, 1)):
        printed[i, j] = -printed[i, j]
    assert np.abs(printed @ PAPER_S - np.eye(3)).max() > 7e-3
    assert np.abs(PAPER_C @ PAPER_S - np.eye(3)).max() < 2e-7


@pytest.mark.parametrize("count", [6, 8, 12, 24])
def test_six_and_more_positions_find_matrix_and_offset_exactly(count: int) -> None:
    A, b = sensor(1)
    inc, tf = position_plan(count)
    assert len({tuple(np.round(w, 9)) for w in gravity_direction(inc, tf).T}) == count
    result = conventional(measured(A, b, inc, tf))
    assert np.allclose(result.A, A, atol=1e-12)
    assert np.allclose(result.b, b, atol=1e-12)
    assert result.options["offset"] == "estimated"


def test_three_positions_say_that_the_offset_is_not_seen_and_carry_it_in_the_uncertainty() -> None:
    A, b = sensor(2)
    inc, tf = position_plan(3)
    result = conventional(measured(A, b, inc, tf), bench=EXACT, offset_std_g=2e-3)
    assert [remark.reason for remark in result.remarks] == [Reason.OFFSET_NOT_OBSERVABLE]
    up, down = gravity_direction(np.array([0.0]), np.array([0.0]))[:, 0], np.array([0.0, 0.0, -1.0])
    assert np.sqrt(result.covariance_of(up)[2, 2]) < 50e-6  # a pose of the calibration: the offset is in the matrix
    assert np.sqrt(result.covariance_of(down)[2, 2]) == pytest.approx(4e-3, rel=0.02)  # there it counts twice
    error = result.correct(A @ down + b) - down
    assert abs(error[2]) < 3 * np.sqrt(result.covariance_of(down)[2, 2])


def test_a_known_offset_is_used() -> None:
    A, b = sensor(3)
    result = conventional(measured(A, b, *position_plan(3)), offset_g=b, offset_std_g=0.0)
    assert np.allclose(result.A, A, atol=1e-12)


def test_too_few_or_flat_poses_are_refused_by_reason() -> None:
    A, b = sensor(1)
    with pytest.raises(CalibrationRefused) as few:
        conventional(measured(A, b, *(x[:2] for x in position_plan(3))))
    assert few.value.remark.reason is Reason.TOO_FEW_POSES
    flat = np.full(6, np.pi / 2), np.deg2rad(np.arange(0.0, 360.0, 60.0))
    with pytest.raises(CalibrationRefused, match="do not span") as singular:
        conventional(measured(A, b, *flat))
    assert singular.value.exit_status == 1
    with pytest.raises(CalibrationRefused, match="second, very different inclination"):
        least_squares(measured(A, b, *pose_grid([45.0], QUADRANTS)))


def test_linear_methods_state_the_scatter_that_they_have() -> None:
    """Standard deviations of 300 calibrations on benches of stated accuracy against the stated covariance."""
    pulls: dict[str, list[Array]] = {"conventional": [], "balance": []}
    stated = BenchAccuracy(np.deg2rad(0.03) / np.sqrt(3), np.deg2rad(0.009) / np.sqrt(3))
    attitude = np.deg2rad(np.array([45.0])), np.array([1.0])
    truth = gravity_direction(*attitude)
    for seed in range(300):
        scenario = reference_scenario(seed)
        reading = scenario.read(*attitude)
        rng = np.random.default_rng(seed)
        for name, solve, plan in (
            ("conventional", conventional, position_plan(6)),
            ("balance", balance, pose_grid([45.0], QUADRANTS)),
        ):
            data = scenario.measure(*plan, rng)
            poses = PoseSet.build(data.mean, inc_ref_rad=data.inc_ref, tf_ref_rad=data.tf_ref, n=data.n, std=data.std)
            result = solve(poses, bench=stated)
            error = (result.correct(reading) - truth)[:, 0]
            pulls[name].append(error / np.sqrt(np.diag(result.covariance_of(truth[:, 0]))))
    for name, values in pulls.items():
        spread = np.sqrt(np.mean(np.array(values) ** 2, axis=0))
        # the root mean square of 300 pulls scatters by 4 %: four of these
        assert np.all(np.abs(spread - 1.0) < 0.17), (name, spread)


def test_every_triple_the_average_and_least_squares_recover_a_sensor_without_offset() -> None:
    A, _ = sensor(4)
    W = gravity_direction(*pose_grid([30.0], QUADRANTS))
    for name in (*TRIPLES, "average", "least-squares"):
        assert np.allclose(balance_matrix(A @ W, W, name) @ A, np.eye(3), atol=1e-12)


def test_the_average_of_the_triples_is_least_squares_to_second_order() -> None:
    A, _ = sensor(5)
    W = gravity_direction(*pose_grid([5.004], QUADRANTS))
    noise = np.random.default_rng(0).standard_normal((3, 4))
    apart = []
    for size in (2e-4, 1e-4):
        S = A @ W + size * noise
        apart.append(np.abs(balance_matrix(S, W, "average") - balance_matrix(S, W, "least-squares")).max())
        triples = [np.abs(balance_matrix(S, W, name) - balance_matrix(S, W, "average")).max() for name in TRIPLES]
        assert min(triples) > 30 * apart[-1]
    assert apart[1] == pytest.approx(apart[0] / 4, rel=0.1)  # quadratic in the errors


def test_an_offset_vanishes_at_the_zones_inclination_and_comes_back_away_from_it() -> None:
    A, _ = sensor(6)
    d = np.array([1e-3, -2e-3, 0.5e-3])
    center = np.deg2rad(45.0)
    result = balance(measured(A, A @ d, *pose_grid([45.0], QUADRANTS)))
    for inc in np.deg2rad([40.0, 45.0, 50.0, 80.0]):
        g = gravity_direction(np.array([inc]), np.array([0.7]))
        error = (result.correct(A @ (g + d[:, None])) - g)[:, 0]
        # first order in the offset; the matrix also scales it by 1 + d
        assert np.allclose(error, d * (1.0 - np.cos(inc) / np.cos(center)), atol=1e-5)
        assert np.allclose(result.zones[0].outside_error(inc, 1e-3), 1e-3 * abs(1 - np.cos(inc) / np.cos(center)))
    stated = [
        np.sqrt(result.covariance_of(gravity_direction(np.array([i]), np.array([0.7]))[:, 0])[0, 0])
        for i in (center, 1.4)
    ]
    assert stated[1] > 1e-3 > stated[0]


def test_balance_refuses_90_deg_and_says_why() -> None:
    A, b = sensor(7)
    poses = measured(A, b, *pose_grid([90.0], QUADRANTS))
    # the trap: S is invertible, and the corrected gz is identically zero whatever the tool does
    W = gravity_direction(*poses.reference())
    W[2] = 0.0
    C = balance_matrix(poses.a, W, "1-2-3")
    assert np.all(C[2] == 0.0)
    with pytest.raises(CalibrationRefused, match="gz near zero") as refusal:
        balance(poses)
    assert refusal.value.remark.reason is Reason.NEAR_HORIZONTAL
    assert refusal.value.exit_status == 1


def test_a_session_with_a_90_deg_ring_keeps_the_others_and_says_so() -> None:
    A, b = sensor(7)
    result = balance(measured(A, b, *pose_grid([5.0, 45.0, 90.0], QUADRANTS)))
    assert [zone.name for zone in result.zones] == ["zone 5.000", "zone 45.000"]
    assert result.refused
    assert [r.reason for r in result.remarks if r.refused] == [Reason.NEAR_HORIZONTAL]
    assert not result.poses.used[8:].any()


def test_a_ring_without_four_quadrants_is_refused_with_the_missing_ones_named() -> None:
    A, b = sensor(8)
    with pytest.raises(CalibrationRefused, match="no pose near toolface 225, 315 deg"):
        balance(measured(A, b, *pose_grid([5.0], [45.0, 135.0, 46.0, 134.0])))


def test_zones_are_narrow_where_a_local_matrix_fails() -> None:
    for inc_deg in (0.612, 5.0, 30.0, 60.0, 75.0, 120.0):
        lo, hi = zone_limits(np.deg2rad(inc_deg))
        assert lo <= np.deg2rad(inc_deg) <= hi
        edges = np.array([lo, hi])
        assert np.all(np.abs(1 - np.cos(edges) / np.cos(np.deg2rad(inc_deg))) <= 0.05 + 1e-9)
        assert np.all(np.sin(edges) <= 2 * np.sin(np.deg2rad(inc_deg)) + 1e-9)


def test_an_affine_sensor_on_a_perfect_rig_closes() -> None:
    A, b = sensor(9)
    poses = measured(A, b, *pose_grid([30.0], QUADRANTS))
    closure = closures_of(poses, [np.arange(4)], [A], pose_rad=1e-4)[0]
    assert np.allclose(closure.value, 0.0, atol=1e-15)
    assert closure.p == pytest.approx(1.0)


def test_a_wrong_pose_fails_the_closure_and_is_asked_for_again() -> None:
    A, b = sensor(9)
    inc, tf = pose_grid([30.0, 60.0], QUADRANTS)
    moved = inc.copy()
    moved[2] += np.deg2rad(0.3)
    poses = PoseSet.build(measured(A, b, moved, tf).a, inc_ref_rad=inc, tf_ref_rad=tf, n=10, std=30e-6)
    result = balance(poses)
    assert [r.reason for r in result.remarks] == [Reason.CLOSURE]
    assert "3" in result.closures[0].worst_pose.split(" or ")
    assert "measure pose" in result.remarks[0].text
    assert result.closures[1].p > 0.001


def test_an_error_common_to_the_ring_does_not_show_in_its_closure() -> None:
    A, b = sensor(9)
    inc, tf = pose_grid([30.0], QUADRANTS)
    poses = PoseSet.build(measured(A, b, inc + 0.01, tf).a, inc_ref_rad=inc, tf_ref_rad=tf, n=10, std=30e-6)
    assert balance(poses).closures[0].p > 0.9


@pytest.mark.parametrize("method", [conventional, balance, least_squares])
def test_a_result_survives_json_float_by_float(method: object) -> None:
    A, b = sensor(10)
    result: CalibrationResult = method(measured(A, b, *pose_grid([5.0, 45.0], QUADRANTS)))  # type: ignore[operator]
    back = CalibrationResult.from_dict(json.loads(json.dumps(result.to_dict())))
    assert json.dumps(back.to_dict()) == json.dumps(result.to_dict())
    g = gravity_direction(np.array([0.3]), np.array([2.0]))
    assert np.array_equal(back.correct(g), result.correct(g))
    assert np.array_equal(back.predict_std(0.3, 2.0)[1], result.predict_std(0.3, 2.0)[1])


def test_methods_refuse_poses_without_reference() -> None:
    with pytest.raises(InputError, match="magnitude"):
        conventional(PoseSet.build(np.eye(3)))
