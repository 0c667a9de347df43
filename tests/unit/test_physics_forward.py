"""The forward model against physics done another way: bodies moved in the lab, filters integrated in fine steps."""

from __future__ import annotations

import time

import numpy as np
import pytest

from highside.errors import InputError
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.physics.gravity import EARTH_RATE_RADPS, attitude_of, gravity_direction, gravity_jacobians
from highside.physics.state import ChainState
from highside.units import STANDARD_GRAVITY_MPS2


def spinning(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A motion that inclines and turns at once: inclination and toolface in rad."""
    return 0.9 + 0.1 * np.sin(0.7 * t), 0.3 + 3.0 * t + 1.2 * t**2


def state_of(t: np.ndarray, **more: float) -> ChainState:
    """The same motion as the chain's input, its rates in closed form."""
    inc, tf = spinning(t)
    return ChainState.build(
        inc,
        tf,
        t_s=t,
        rotor_rate_radps=3.0 + 2.4 * t,
        rotor_accel_radps2=np.full(t.size, 2.4),
        inc_rate_radps=0.07 * np.cos(0.7 * t),
        **more,
    )


def tool_axes(inc: float, tf: float) -> np.ndarray:
    """Rows: the tool's x, y, z in the lab (x the azimuth of the hole, y to its left, z up), by geometry alone."""
    z = np.array([-np.sin(inc), 0.0, np.cos(inc)])
    high_side = np.array([np.cos(inc), 0.0, np.sin(inc)])
    # clockwise looking down-hole (along -z) is a negative turn about z
    turned = high_side * np.cos(tf) - np.cross(z, high_side) * np.sin(tf)
    return np.stack([turned, np.cross(z, turned), z])


def test_gravity_agrees_with_the_geometry_of_the_hole() -> None:
    inc, tf = np.array([0.4, 1.2, 2.8]), np.array([0.2, 2.9, 5.5])
    by_hand = np.stack([tool_axes(i, t) @ [0, 0, 1] for i, t in zip(inc, tf, strict=True)], axis=1)
    np.testing.assert_allclose(ForwardModel.of({}).predict(ChainState.build(inc, tf)), by_hand, atol=1e-15)


def test_gyro_rates_agree_with_how_the_axes_turn() -> None:
    t, h = np.array([0.4, 1.3]), 1e-5
    rates = ForwardModel.of({}).gyro(state_of(t))
    for k, instant in enumerate(t):
        before, now, after = (tool_axes(*spinning(instant + d)) for d in (-h, 0.0, h))
        turning = (after - before) / (2 * h) @ now.T
        # the rows of a turning body obey d(row)/dt = w x row, so (d axes) axes^T = [w]x^T in tool components
        by_hand = np.array([turning[1, 2], turning[2, 0], turning[0, 1]])
        np.testing.assert_allclose(rates[:, k], by_hand, atol=1e-8)


def test_a_lever_arm_agrees_with_the_second_derivative_of_the_sensors_place() -> None:
    # the stage stands still while the spindle turns: the effect knows nothing of the stage's own rate
    r = np.array([0.013, -0.004, 0.0])
    t, h = np.array([0.5, 1.1]), 1e-4
    model = ForwardModel.of({"lever_arm": {"r_x": r[0], "r_y": r[1]}})
    state = state_of(t)
    frozen = ChainState.build(
        np.full(2, 0.9), state.tf_rad, rotor_rate_radps=state.rotor_rate_radps, rotor_accel_radps2=2.4
    )
    reading = model.predict(frozen)
    for k, instant in enumerate(t):
        place = [tool_axes(0.9, spinning(instant + d)[1]).T @ r for d in (-h, 0.0, h)]
        acceleration = (place[0] - 2 * place[1] + place[2]) / h**2
        force = acceleration / STANDARD_GRAVITY_MPS2 + [0, 0, 1]
        by_hand = tool_axes(0.9, spinning(instant)[1]) @ force
        np.testing.assert_allclose(reading[:, k], by_hand, atol=2e-6)


def test_sensors_at_one_place_feel_a_common_lever_arm() -> None:
    state = state_of(np.linspace(0, 2, 9))
    common = ForwardModel.of({"lever_arm": {"r_x": 0.01, "r_y": -0.006}})
    separate = ForwardModel.of({"size_effect": {"x_x": 0.01, "y_x": -0.006, "x_y": 0.01, "y_y": -0.006}})
    np.testing.assert_allclose(common.predict(state), separate.predict(state), atol=1e-15)


def test_coriolis_agrees_with_a_point_that_creeps_sideways() -> None:
    # steady turning, a point that moves along tool x at v: what is not the lever arm of its momentary place is 2 w x v
    v, rate, h, t0 = 0.004, 5.0, 1e-4, 0.3
    place = [tool_axes(0.9, rate * (t0 + d)).T @ np.array([v * (t0 + d), 0.0, 0.0]) for d in (-h, 0.0, h)]
    force = (place[0] - 2 * place[1] + place[2]) / h**2 / STANDARD_GRAVITY_MPS2 + [0, 0, 1]
    by_hand = tool_axes(0.9, rate * t0) @ force
    state = ChainState.build(np.array([0.9]), np.array([rate * t0]), rotor_rate_radps=rate)
    model = ForwardModel.of({"coriolis": {"v_x": v}, "lever_arm": {"r_x": v * t0}})
    np.testing.assert_allclose(model.predict(state)[:, 0], by_hand, atol=2e-6)


def test_a_late_sample_is_the_reading_of_a_moment_ago() -> None:
    t = np.linspace(0.2, 2.0, 7)
    lagging = {"lever_arm": {"r_x": 0.01}, "time_offset": {"t0": 0.004}}
    late = ForwardModel.of(lagging)
    now = late.without("time_offset")
    np.testing.assert_allclose(late.predict(state_of(t)), now.predict(state_of(t - 0.004)), atol=1e-6)
    # about z alone: the state knows no acceleration of the inclination
    np.testing.assert_allclose(late.gyro(state_of(t))[2], now.gyro(state_of(t - 0.004))[2], atol=1e-12)


def test_bandwidth_lag_agrees_with_a_filter_integrated_in_fine_steps() -> None:
    tau, rate, step = 0.03, 12.0, 1e-5
    fine = np.arange(0.0, 0.6, step)
    force = gravity_direction(np.full(fine.size, 1.1), rate * fine)
    filtered = force[:, :1]
    share = 1 - np.exp(-step / tau)
    for k in range(1, fine.size):
        filtered = filtered + share * ((force[:, k - 1 : k] + force[:, k : k + 1]) / 2 - filtered)
    state = ChainState.build(np.array([1.1]), rate * fine[-1:], rotor_rate_radps=rate)
    reading = ForwardModel.of({"bandwidth_lag": {"tau": tau}}).predict(state)
    np.testing.assert_allclose(reading, filtered, atol=3e-5)


@pytest.mark.parametrize("turn", [0.001, 0.0499, 0.0501, 0.25])
def test_bandwidth_lag_has_the_gain_and_phase_of_a_first_order_filter(turn: float) -> None:
    state = ChainState.build(np.array([np.pi / 2]), np.array([0.0]), rotor_rate_radps=10.0)
    x, y, _ = ForwardModel.of({"bandwidth_lag": {"tau": turn / 10.0}}).predict(state)[:, 0]
    assert np.hypot(x, y) == pytest.approx(1 / np.sqrt(1 + turn**2), abs=1e-9)
    assert np.arctan2(y, x) == pytest.approx(-np.arctan(turn), abs=1e-9)


@pytest.mark.parametrize(("azimuth", "latitude"), [(0.0, 0.5), (1.1, -0.4), (4.0, 1.2)])
def test_earth_rotation_agrees_with_its_components_in_the_lab(azimuth: float, latitude: float) -> None:
    # lab of tool_axes: x along the hole's azimuth, y to its left, z up; the axis of the Earth lies north and up
    north = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    axis = EARTH_RATE_RADPS * (np.cos(latitude) * north + np.sin(latitude) * np.array([0, 0, 1.0]))
    inc, tf = 1.0, 2.0
    state = ChainState.build(np.array([inc]), np.array([tf]), latitude_rad=latitude, azimuth_rad=azimuth)
    reading = ForwardModel.of({"earth_rotation": {"share": 1.0}}).gyro(state)[:, 0]
    np.testing.assert_allclose(reading, tool_axes(inc, tf) @ axis, atol=1e-18)
    assert np.degrees(np.linalg.norm(reading)) * 3600 == pytest.approx(15.041, abs=1e-3)


def test_the_hole_runs_towards_its_azimuth() -> None:
    # an axis that points north and horizontal lies along the down-hole direction of a horizontal hole to the north
    state = ChainState.build(np.array([np.pi / 2]), np.array([0.0]), latitude_rad=0.0, azimuth_rad=0.0)
    reading = ForwardModel.of({"earth_rotation": {"share": 1.0}}).gyro(state)[:, 0]
    np.testing.assert_allclose(reading, [0, 0, -EARTH_RATE_RADPS], atol=1e-18)


def test_sensor_effects_are_the_calibration_equations() -> None:
    rng = np.random.default_rng(2)
    state = ChainState.build(rng.uniform(0, 3, 20), rng.uniform(0, 6, 20))
    f = gravity_direction(state.inc_rad, state.tf_rad)
    A = np.eye(3) + rng.normal(0, 3e-3, (3, 3))
    b, k2 = rng.normal(0, 2e-3, 3), rng.normal(0, 1e-3, 3)
    names = [(i, j) for i in range(3) for j in range(3) if i != j]
    model = ForwardModel.of(
        {
            "bias": dict(zip(("b_x", "b_y", "b_z"), b, strict=True)),
            "scale": {f"s_{axis}": A[i, i] - 1 for i, axis in enumerate("xyz")},
            "misalignment": {f"m_{'xyz'[i]}{'xyz'[j]}": A[i, j] for i, j in names},
            "quadratic": {f"k2_{axis}": k2[i] for i, axis in enumerate("xyz")},
        }
    )
    np.testing.assert_allclose(model.predict(state), A @ f + b[:, None] + k2[:, None] * f**2, atol=1e-15)


def test_axis_nonorthogonality_turns_the_toolface_by_cot_i_and_a_twist_by_cos_i() -> None:
    state = ChainState.build(np.array([0.3, 1.0, 2.0]), np.array([1.0, 2.0, 3.0]))
    _, tf = ForwardModel.of({"axis_nonorthogonality": {"eps": 1e-6}}).truth(state)
    np.testing.assert_allclose(tf - state.tf_rad, -1e-6 / np.tan(state.inc_rad), rtol=1e-4)
    _, tf = ForwardModel.of({"reference_twist": {"k": 1e-6}}).truth(state)
    np.testing.assert_allclose(tf - state.tf_rad, 1e-6 * np.cos(state.inc_rad), rtol=1e-6)


def test_bench_effects_move_the_truth_and_sensor_effects_do_not() -> None:
    state = ChainState.build(np.array([0.7]), np.array([0.2]))
    bench = ForwardModel.of({"base_tilt": {"tilt_x": 1e-3}, "sag": {"s": 1e-3}})
    sensor = ForwardModel.of({"bias": {"b_x": 1e-3}, "scale": {"s_z": 1e-2}})
    assert bench.truth(state)[0][0] - 0.7 == pytest.approx(1e-3 + 1e-3 * np.sin(0.7), rel=2e-3)
    assert sensor.truth(state)[0][0] == pytest.approx(0.7, abs=1e-15)
    assert attitude_of(sensor.predict(state))[0][0] != pytest.approx(0.7, abs=1e-4)


def test_pose_sensitivity_is_the_sensor_matrix_times_the_derivatives_of_gravity() -> None:
    state = ChainState.build(np.array([0.3, 1.4]), np.array([1.0, 4.0]))
    model = ForwardModel.of({"scale": {"s_x": 0.01}, "misalignment": {"m_yz": 0.004}})
    A = np.array([[1.01, 0, 0], [0, 1, 0.004], [0, 0, 1]])
    by_inc, by_tf = gravity_jacobians(state.inc_rad, state.tf_rad)
    sensitivity = model.pose_sensitivity(state)
    np.testing.assert_allclose(sensitivity[:, 0], A @ by_inc, atol=1e-15)
    np.testing.assert_allclose(sensitivity[:, 2], A @ by_tf, atol=1e-15)


def test_derivatives_of_what_the_model_leaves_out_are_taken_at_nothing() -> None:
    state = ChainState.build(np.linspace(0.1, 1.5, 8), np.linspace(0, 6, 8))
    model = ForwardModel.of({"scale": {"s_x": 0.01}})
    column = model.jacobian(state, ["base_tilt.tilt_x"])[0]
    h = 1e-6
    with_it = model.with_effects({"base_tilt": {"tilt_x": h}}).predict(state)
    np.testing.assert_allclose(column, (with_it - model.predict(state)) / h, atol=1e-6)


def test_free_parameters_go_out_and_come_back_in_the_same_order() -> None:
    model = ForwardModel.of({"bias": {"b_y": 2e-3}, "warmup": {"a_x": 1e-3, "tau": 100.0}})
    assert model.free_names() == ["bias.b_x", "bias.b_y", "bias.b_z", "warmup.a_x", "warmup.a_y", "warmup.a_z"]
    free = ["warmup.tau", "bias", "quadratic.k2_z"]
    changed = model.set_free(np.array([50.0, 1.0, 2.0, 3.0, 4.0]), free)
    assert changed.get_free(free).tolist() == [50.0, 1.0, 2.0, 3.0, 4.0]
    assert changed.parameters()["warmup"]["a_x"] == 1e-3
    assert changed.parameters()["quadratic"] == {"k2_x": 0.0, "k2_y": 0.0, "k2_z": 4.0}
    assert model.get_free(["bias"]).tolist() == [0.0, 2e-3, 0.0]


def test_an_unknown_free_parameter_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="it has: tilt_x, tilt_y"):
        ForwardModel.of({}).free_names(["base_tilt.z"])


def test_draws_are_reported_by_the_stage_they_disturb() -> None:
    model = ForwardModel.of({"pose_error": {"inc_pose": 1e-4}, "turn_on_bias": {"sigma_x": 3e-4}})
    draws = model.draw(ChainState.build(np.zeros(3), np.zeros(3)), np.random.default_rng(0))
    assert set(draws) == {Stage.POSE, Stage.SENSOR}
    assert np.ptp(draws[Stage.SENSOR][0]) == 0.0
    assert np.max(np.abs(draws[Stage.POSE])) <= 1e-4


def test_a_prediction_and_its_derivatives_are_quick() -> None:
    rng = np.random.default_rng(0)
    state = ChainState.build(rng.uniform(0, 3, 126), rng.uniform(0, 6, 126))
    model = ForwardModel.of(
        {
            name: {}
            for name in (
                "bias",
                "scale",
                "misalignment",
                "quadratic",
                "cubic",
                "cross_product",
                "base_tilt",
                "axis_nonorthogonality",
                "encoder_first_harmonic",
            )
        }
    )
    assert len(model.free_names()) == 32
    model.jacobian(state)
    times = []
    for _ in range(20):
        start = time.perf_counter()
        model.jacobian(state)
        times.append(time.perf_counter() - start)
    # median near 1 ms on an idle core
    assert np.median(times) < 0.010
