"""The reference scenario is what the specification says, draw by draw."""

from __future__ import annotations

import numpy as np
import pytest

from highside.physics.gravity import gravity_direction
from highside.physics.plan import PUBLISHED_INCLINATIONS_DEG, pose_grid
from studies.scenario import random_bench, random_sensor, reference_scenario, true_gravity


def test_a_seed_gives_the_same_instrument_and_another_seed_another() -> None:
    first, again, other = reference_scenario(5), reference_scenario(5), reference_scenario(6)
    assert np.array_equal(first.poses.mean, again.poses.mean)
    assert first.sensor.parameters() == again.sensor.parameters()
    assert first.sensor.parameters() != other.sensor.parameters()


def test_another_plan_of_poses_leaves_the_sensor_and_the_bench_of_a_seed() -> None:
    few = reference_scenario(5, inclinations_deg=[5.0, 45.0, 90.0], toolfaces_deg=[0.0, 90.0])
    assert few.poses.mean.shape == (3, 6)
    assert few.sensor.parameters() == reference_scenario(5).sensor.parameters()
    tilt = reference_scenario(5, inc_station_error_deg=0.01).bench.parameters()["base_tilt"]
    assert tilt == reference_scenario(5).bench.parameters()["base_tilt"]


def test_it_has_44_poses_at_the_published_inclinations() -> None:
    poses = reference_scenario(1).poses
    assert poses.mean.shape == (3, 44)
    assert sorted(set(np.degrees(poses.inc_ref).round(6).tolist())) == list(PUBLISHED_INCLINATIONS_DEG)
    assert set(np.degrees(poses.tf_ref).round(6).tolist()) == {45, 135, 225, 315}


def test_the_published_inclinations_are_those_of_the_tables(shared_data) -> None:  # type: ignore[no-untyped-def]
    table = np.genfromtxt(shared_data / "paper_balance" / "table1_conventional.csv", delimiter=",", names=True)
    assert sorted(table["inc_ref_deg"].tolist()) == list(PUBLISHED_INCLINATIONS_DEG)


def test_parameters_fill_their_half_widths_and_never_leave_them() -> None:
    sensors = [random_sensor(np.random.default_rng(k)).parameters() for k in range(300)]
    for effect, limit in (("scale", 5e-3), ("bias", 2e-3), ("misalignment", np.radians(0.2))):
        values = np.abs([value for sensor in sensors for value in sensor[effect].values()])
        assert 0.98 * limit < values.max() <= limit
        assert values.mean() == pytest.approx(limit / 2, rel=0.07)
    benches = [random_bench(np.random.default_rng(k)).parameters()["base_tilt"] for k in range(300)]
    tilts = np.abs([value for bench in benches for value in bench.values()])
    assert np.radians(0.029) < tilts.max() <= np.radians(0.03)


def test_a_pose_is_the_truth_through_the_sensor_with_the_noise_of_ten_seconds() -> None:
    residuals, stds = [], []
    for seed in range(60):
        scenario = reference_scenario(seed)
        clean = scenario.read(scenario.poses.inc_true, scenario.poses.tf_true)
        residuals.append(scenario.poses.mean - clean)
        stds.append(scenario.poses.std)
    assert np.std(residuals) == pytest.approx(50e-6 / np.sqrt(20), rel=0.03)
    assert np.sqrt(np.mean(np.square(stds))) == pytest.approx(50e-6 / np.sqrt(2), rel=0.03)
    assert reference_scenario(0).poses.n.tolist() == [10] * 44


def test_pose_errors_are_uniform_within_half_a_step_around_the_tilted_bench() -> None:
    level = reference_scenario(3, tilt_deg=0.0, inclinations_deg=np.linspace(5, 90, 200).tolist())
    error = np.degrees(level.poses.inc_true - level.poses.inc_ref)
    assert 0.0085 < np.abs(error).max() <= 0.009 + 1e-12
    assert error.std() == pytest.approx(0.009 / np.sqrt(3), rel=0.06)


def test_a_bench_with_ring_errors_moves_a_whole_ring() -> None:
    poses = reference_scenario(3, tilt_deg=0.0, pose_error_deg=0.0, inc_station_error_deg=0.009).poses
    error = (poses.inc_true - poses.inc_ref).reshape(11, 4)
    assert np.ptp(error, axis=1).max() < 1e-12
    assert np.degrees(np.abs(error)).max() > 0.004


def test_a_reading_in_the_field_has_the_noise_of_one_second() -> None:
    scenario = reference_scenario(1)
    inc, tf = pose_grid([45.0], np.linspace(0, 355, 4000).tolist())
    noise = scenario.read(inc, tf, np.random.default_rng(2)) - scenario.read(inc, tf)
    assert noise.std() == pytest.approx(35.36e-6, rel=0.02)


def test_the_structure_that_no_model_has_is_smooth_and_of_its_size() -> None:
    plain, rippled = reference_scenario(4), reference_scenario(4, structure_g=1e-3)
    inc, tf = pose_grid(np.linspace(0, 180, 60).tolist(), np.linspace(0, 350, 36).tolist())
    ripple = rippled.read(inc, tf) - plain.read(inc, tf)
    assert 3e-4 < np.abs(ripple).max() < 1.5e-3
    f = gravity_direction(inc, tf)
    # a cubic polynomial on each axis leaves most of it
    for axis in range(3):
        basis = np.vander(f[axis], 4)
        left = ripple[axis] - basis @ np.linalg.lstsq(basis, ripple[axis], rcond=None)[0]
        assert left.std() > 5e-5


def test_nonlinear_sensors_have_all_three_kinds_of_terms() -> None:
    parameters = reference_scenario(2, nonlinearity_g=2e-3).sensor.parameters()
    for effect in ("quadratic", "cubic", "cross_product"):
        values = np.abs(list(parameters[effect].values()))
        assert 0 < values.min() <= values.max() <= 2e-3


def test_poses_of_one_session_on_the_same_bench_share_its_tilt() -> None:
    scenario = reference_scenario(8, pose_error_deg=0.0)
    inc, tf = pose_grid([90.0], [0.0, 90.0])
    session = scenario.measure(inc, tf, np.random.default_rng(0))
    tilt = scenario.bench.parameters()["base_tilt"]
    assert session.inc_true - inc == pytest.approx(tilt["tilt_x"], abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(true_gravity(session), axis=0), 1.0, atol=1e-12)
