"""What a converter's step leaves in means: nothing on a channel that a turn carries over many steps, or noise does."""

import numpy as np
import pytest

from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.floor import rounding_error, rounding_errors

STEP = 1e-3
N = 6000
TURN = np.cumsum(np.full(N, 0.11))


def rounded(truth: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    read = np.round((truth + noise * np.random.default_rng(3).standard_normal(N)) / STEP) * STEP
    return read, read - truth


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_channel_across_the_axis_is_rounded_anywhere_on_the_step(noise: float) -> None:
    read, left = rounded(0.9 * np.sin(TURN), noise)
    assert rounding_error(read, left, TURN) < FLOOR.rounded * STEP


def test_a_channel_along_the_axis_keeps_the_error_of_its_step() -> None:
    # less than a step of misalignment is all that moves it
    read, left = rounded(0.5 + 0.4 * STEP * np.sin(TURN), 1e-4)
    error = rounding_error(read, left, TURN)
    assert 0.25 * STEP < error <= 0.5 * STEP
    # and the means over sectors of the turn depart by as much, but no more
    sector = (TURN / (2 * np.pi) % 1.0 * FLOOR.sectors).astype(int)
    means = np.bincount(sector, left) / np.bincount(sector)
    assert 0.3 * error < np.abs(means).max() < 1.2 * error


def test_noise_of_half_a_step_removes_it() -> None:
    read, left = rounded(np.full(N, 0.50021), 0.5 * STEP)
    assert rounding_error(read, left, TURN) < FLOOR.rounded * STEP


def test_readings_on_no_lattice_have_none() -> None:
    read = np.random.default_rng(1).standard_normal(N)
    assert rounding_error(read, read, TURN) == 0.0


def test_a_rate_that_comes_back_to_the_same_toolfaces_keeps_it_for_its_time() -> None:
    """25 toolfaces again and again are rounded as they were; at other rates each turn finds others."""
    turn = np.concatenate([TURN[: N // 2], 2 * np.pi * np.arange(N // 2) / 25])
    read, left = rounded(0.9 * np.sin(turn), 1e-5)
    error, whole = rounding_errors(read, left, turn), rounding_error(read, left, turn)
    assert error.shape == (N,)
    assert error[: N // 2 - N // FLOOR.spans] == pytest.approx(whole)
    assert error[N // 2 :].min() > max(0.2 * STEP, 1.2 * whole)
    assert not rounding_errors(left, left, turn).any()
