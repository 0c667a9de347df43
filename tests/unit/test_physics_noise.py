"""Random sequences have the sizes and memories that they promise."""

from __future__ import annotations

import numpy as np
import pytest

from highside.physics.forward import ForwardModel
from highside.physics.memory import low_pass, play
from highside.physics.noise import autoregressive, quantised, random_walk, std_of_average, vibration_modulated, white
from highside.physics.state import ChainState


def rng() -> np.random.Generator:
    return np.random.default_rng(42)


def test_a_longer_average_is_calmer_by_the_root_of_the_time() -> None:
    # 50 ug/sqrt(Hz) for 1 s and for 10 s: 35.4 and 11.2 ug
    assert std_of_average(50e-6, 1.0) == pytest.approx(35.36e-6, rel=1e-3)
    assert std_of_average(50e-6, 10.0) == pytest.approx(11.18e-6, rel=1e-3)


def test_the_density_of_averaged_white_noise_is_that_of_its_spectrum() -> None:
    from scipy.signal import welch

    # rows of 0.02 s: the one-sided spectrum must lie at the density squared
    rows = white((200_000,), std_of_average(50e-6, 0.02), rng())
    _, power = welch(rows, fs=50.0, nperseg=1024)
    assert np.sqrt(np.median(power[5:-5])) == pytest.approx(50e-6, rel=0.03)


def test_coloured_noise_has_its_size_and_its_memory_from_the_first_row_on() -> None:
    rows = autoregressive((3000, 40), 2.0, 0.8, rng())
    assert rows.std(axis=0)[[0, 1, 39]] == pytest.approx(2.0, rel=0.05)
    assert np.mean(rows[:, 0] * rows[:, 3]) / 4 == pytest.approx(0.8**3, abs=0.06)


def test_a_random_walk_spreads_with_the_root_of_elapsed_time() -> None:
    t = np.array([0.0, 1.0, 4.0, 100.0])
    ends = np.array([random_walk(t, np.array([1.0, 2.0, 0.0]), np.random.default_rng(k)) for k in range(2000)])
    assert np.all(ends[:, :, 0] == 0)
    assert ends.std(axis=0)[0] == pytest.approx([0, 1, 2, 10], rel=0.06)
    assert ends.std(axis=0)[1] == pytest.approx([0, 2, 4, 20], rel=0.06)
    assert np.all(ends[:, 2] == 0)


def test_vibration_modulated_noise_follows_the_vibration() -> None:
    vibration = np.repeat([0.0, 0.5, 2.0], 20_000)
    rows = vibration_modulated(vibration, 1e-3, rng()).reshape(3, 3, 20_000)
    assert np.all(rows[:, 0] == 0)
    assert rows[:, 1].std() == pytest.approx(5e-4, rel=0.03)
    assert rows[:, 2].std() == pytest.approx(2e-3, rel=0.03)


def test_quantised_values_lie_on_the_comb_and_near_by() -> None:
    values = rng().normal(size=1000)
    steps = quantised(values, 0.1)
    assert np.abs(steps / 0.1 - np.round(steps / 0.1)).max() < 1e-9
    assert np.abs(steps - values).max() <= 0.05 + 1e-12


def test_pose_errors_are_common_to_what_they_should_be_common_to() -> None:
    state = ChainState.build(np.repeat([0.1, 0.5], 6), np.tile([0.0, 2.0, 4.0], 4), pose=np.arange(12))
    inclination = ForwardModel.of({"pose_error": {"inc_station": 1e-3}})
    error = inclination.truth(state, inclination.draw(state, rng()))[0] - state.inc_rad
    assert np.ptp(error[:6]) < 1e-15
    assert np.ptp(error[6:]) < 1e-15
    assert abs(error[0] - error[6]) > 1e-6
    station = ForwardModel.of({"pose_error": {"tf_station": 1e-3}})
    drawn = next(iter(station.draw(state, rng()).values()))[2]
    assert np.ptp(drawn.reshape(4, 3), axis=0).max() < 1e-15
    assert np.ptp(drawn[:3]) > 1e-6


def test_rows_of_one_pose_share_its_error_and_half_widths_are_kept() -> None:
    state = ChainState.build(np.full(4000, 0.7), np.linspace(0, 3, 4000), pose=np.arange(4000) // 2)
    model = ForwardModel.of({"pose_error": {"inc_pose": 2e-4}})
    error = next(iter(model.draw(state, rng()).values()))[0]
    assert np.array_equal(error[::2], error[1::2])
    assert np.abs(error).max() <= 2e-4
    assert error.std() == pytest.approx(2e-4 / np.sqrt(3), rel=0.05)


def test_the_first_order_lag_of_a_ramp_runs_behind_by_tau() -> None:
    t = np.cumsum(np.random.default_rng(1).uniform(0.1, 3.0, 400))
    behind = low_pass(t, 0.5 * t, 7.0) - 0.5 * t
    # y = x - rate tau (1 - exp(-t / tau))
    np.testing.assert_allclose(behind, -0.5 * 7.0 * (1 - np.exp(-(t - t[0]) / 7.0)), atol=1e-12)


def test_the_lag_ignores_rows_of_equal_time() -> None:
    t, x = np.array([0.0, 1.0, 1.0, 2.0]), np.array([0.0, 1.0, 1.0, 2.0])
    assert low_pass(t, x, 0.5)[1] == low_pass(t, x, 0.5)[2]


def test_play_follows_with_a_slack_on_both_sides() -> None:
    assert play(np.array([0.0, 0.5, 2.0, 1.5, 0.0, -3.0]), 1.0).tolist() == [0, 0, 1, 1, 1, -2]


def test_clipping_loss_and_stuck_bits_show_in_the_rows() -> None:
    state = ChainState.build(np.full(2000, np.pi / 2), np.linspace(0, 6, 2000))
    model = ForwardModel.of(
        {
            "clipping": {"limit_x": 0.9},
            "dropped_frames": {"lost": 0.1, "repeated": 0.05},
            "stuck_bit": {"stuck_z": 1, "bit": 3, "lsb": 1e-4, "level": 1},
            "quantisation": {"lsb_y": 0.01},
        }
    )
    values = model.simulate(state, rng())
    assert values[0].max() == 0.9
    assert np.mean(values[0] == 0.9) > 0.1
    assert set((np.round(values[2] / 1e-4).astype(int) & 8).tolist()) == {8}
    np.testing.assert_allclose(values[1] * 100, np.round(values[1] * 100), atol=1e-9)
    rows = model.recorded_rows(state, rng())
    counts = np.bincount(rows, minlength=2000)
    assert np.mean(counts == 0) == pytest.approx(0.1, abs=0.02)
    assert np.mean(counts == 2) == pytest.approx(0.05, abs=0.02)
    assert np.all(np.diff(rows) >= 0)
