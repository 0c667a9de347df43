"""The recursive form: follows a drifting error, keeps what it does not see, takes bad rows in its stride."""

from __future__ import annotations

import math

import numpy as np
import pytest

from highside.errors import InputError
from highside.papers.rotation_scenarios import A, draw
from highside.rotation import OnlineFit, Samples, auto, harmonics2, online
from highside.rotation.bases import fourier_sum

ROWS = 6000
TURNS = 5


def drifting(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A first harmonic that grows by half and turns by 0.3 rad over five turns: angle, truth, measured."""
    base = draw(A, seed, 0).coefficients
    rest = base.copy()
    rest[1:3] = 0.0
    size, phase = math.hypot(base[1], base[2]), math.atan2(base[2], base[1])
    theta = np.arange(ROWS * TURNS) * (2 * np.pi / ROWS)
    share = np.linspace(0.0, 1.0, theta.size)
    truth = fourier_sum(theta, rest) + size * (1 + 0.5 * share) * np.sin(theta + phase + 0.3 * share)
    return theta, truth, truth + A.noise * np.random.default_rng(seed).standard_normal(theta.size)


def followed(theta: np.ndarray, error: np.ndarray, memory_turns: float) -> np.ndarray:
    one = OnlineFit(noise=A.noise, amplitude=0.05, memory_turns=memory_turns)
    return np.array([y - one.update(t, y) for t, y in zip(theta.tolist(), error.tolist(), strict=True)])


def test_a_drifting_eccentricity_is_followed() -> None:
    last = slice(ROWS * (TURNS - 1), None)
    for seed in range(2):
        theta, truth, error = drifting(seed)
        off = {m: float(np.sqrt(np.mean((followed(theta, error, m) - truth)[last] ** 2))) for m in (1 / 6, 1.0)}
        frozen = harmonics2(Samples.build(theta[:ROWS], error[:ROWS]))
        frozen_off = float(np.sqrt(np.mean((frozen(theta) - truth)[last] ** 2)))
        assert off[1 / 6] < 0.0006
        assert frozen_off > 0.012
        assert off[1 / 6] < off[1.0] < 0.4 * frozen_off


def test_without_drift_it_agrees_with_the_fit_of_all_rows() -> None:
    one = draw(A, 2, 0, rows=6000, turns=3.0)
    fit = OnlineFit(noise=A.noise, amplitude=0.05, order=8, memory_turns=1e6)
    for t, y in zip(one.theta_rad.tolist(), one.error.tolist(), strict=True):
        fit.update(t, y)
    batch = auto(Samples.build(one.theta_rad, one.error), robust=False, largest_order=8)
    at = np.linspace(0, 2 * np.pi, 100)
    assert np.abs(fit.curve()(at) - batch(at)).max() < 3e-4
    # the recursion is least squares with the prior as first rows: equal to it to rounding
    rows = np.vstack([np.ones(6000), *(f(k * one.theta_rad) for k in range(1, 9) for f in (np.sin, np.cos))])
    prior = np.concatenate([[0.05], 0.05 / np.repeat(np.arange(1, 9), 2) ** 2]) / A.noise
    exact = np.linalg.solve(rows @ rows.T + np.diag(prior**-2.0), rows @ one.error)
    # a memory of a million turns forgets three parts in a million
    assert np.allclose(fit.curve().parameters, exact, atol=2e-7)
    assert fit.predict(1.0) == pytest.approx(float(fit.curve()(np.array([1.0]))[0]), abs=1e-14)


def swinging(rows: int = 12000) -> tuple[OnlineFit, np.ndarray]:
    """Two turns all round, then hundreds of swings within 30 degrees either side."""
    one = draw(A, 0, 0, rows=12000, turns=2.0)
    fit = OnlineFit(noise=A.noise, amplitude=0.05, memory_turns=1.0)
    for t, y in zip(one.theta_rad.tolist(), one.error.tolist(), strict=True):
        fit.update(t, y)
    theta = 0.5 * np.sin(np.arange(rows) * (2 * np.pi / 200))
    error = one.true_at(theta) + A.noise * np.random.default_rng(5).standard_normal(rows)
    for t, y in zip(theta.tolist(), error.tolist(), strict=True):
        fit.update(t, y)
    at = np.linspace(0, 2 * np.pi, 360)
    return fit, fit.curve()(at) - one.true_at(at)


def test_a_rotor_that_swings_in_a_sector_keeps_the_rest_of_the_turn() -> None:
    fit, off = swinging()
    assert fit.covariance_trace <= online.MOST_UNCERTAIN * (1 + 1e-9)
    assert np.abs(off).max() < 0.01


def test_without_protection_the_same_swings_wind_the_covariance_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(online, "MOST_UNCERTAIN", math.inf)
    fit, off = swinging()
    assert fit.covariance_trace > 1e3
    assert np.abs(off).max() > 0.02


def test_a_rotor_that_stands_still_forgets_nothing() -> None:
    one = draw(A, 1, 0)
    fit = OnlineFit(noise=A.noise, amplitude=0.05)
    for t, y in zip(one.theta_rad.tolist(), one.error.tolist(), strict=True):
        fit.update(t, y)
    here = float(one.true_at(np.array([1.0]))[0])
    fit.update(1.0, here)
    before = fit.covariance_trace
    for _ in range(3000):
        fit.update(1.0, here)
    assert fit.covariance_trace <= before * (1 + 1e-6)


def test_rows_that_are_not_finite_change_nothing() -> None:
    fit = OnlineFit(noise=1e-3, amplitude=0.05)
    fit.update(0.1, 0.02)
    before = fit.curve().parameters
    assert math.isnan(fit.update(math.nan, 0.1))
    assert math.isnan(fit.update(0.3, math.inf))
    assert np.array_equal(fit.curve().parameters, before)


def test_settings_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="cannot hold the turn"):
        OnlineFit(noise=1e-3, amplitude=0.05, memory_turns=0.05)
    with pytest.raises(InputError, match="more than 0"):
        OnlineFit(noise=0.0, amplitude=0.05)
    with pytest.raises(InputError, match="order 40"):
        OnlineFit(noise=1e-3, amplitude=0.05, order=40)
