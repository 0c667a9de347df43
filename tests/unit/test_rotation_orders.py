"""`auto` and orders of the turn above its usual range: fitted, or told with their size, and never invented."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from highside.rotation.curve import CurveMethod, ErrorCurve
from highside.rotation.fit import fit
from highside.rotation.fourier import LARGEST_ORDER
from highside.rotation.samples import Samples
from highside.rotation.unfitted_orders import repeated_orders

NOISE = 0.03


def wave(orders: tuple[int, ...], theta: np.ndarray) -> np.ndarray:
    """(N,) 0.1 of each order."""
    return np.asarray(0.1 * np.sum([np.cos(k * theta + k) for k in orders], axis=0))


def fitted(orders: tuple[int, ...], turns: int, rows: int) -> tuple[ErrorCurve, float]:
    """The curve of so many turns of so many rows, and its largest error."""
    rng = np.random.default_rng([turns, rows, *orders])
    theta = rng.uniform(0, 6) + np.arange(turns * rows) / rows * 2 * np.pi
    truth = wave(orders, theta)
    curve = fit(Samples.build(theta, truth + NOISE * rng.standard_normal(theta.size)), CurveMethod.AUTO)
    return curve, float(np.abs(curve(theta) - truth).max())


@pytest.mark.parametrize("order", [1, 12, 13, 20, 36, 60])
@pytest.mark.parametrize(("turns", "rows"), [(4, 720), (2, 720), (1, 720), (8, 200)])
def test_a_lone_order_is_fitted_as_that_order(order: int, turns: int, rows: int) -> None:
    curve, error = fitted((order,), turns, rows)
    assert curve.order == order
    assert error < 0.05
    assert any("beyond the usual range" in remark for remark in curve.remarks) == (order > LARGEST_ORDER)


@pytest.mark.parametrize("orders", [(1, 20), (20, 50), (1, 2, 33, 60), (3, 35, 36)])
def test_orders_together_are_all_fitted(orders: tuple[int, ...]) -> None:
    curve, error = fitted(orders, 4, 720)
    assert curve.order == max(orders)
    assert error < 0.05


@pytest.mark.parametrize(("orders", "turns", "left"), [((5, 90), 4, 90), ((100,), 1, 100)])
def test_an_order_beyond_all_that_is_fitted_is_told_with_its_size(
    orders: tuple[int, ...], turns: int, left: int
) -> None:
    curve, _ = fitted(orders, turns, 720)
    (words,) = [remark for remark in curve.remarks if "is left" in remark]
    assert words.startswith(f"an error of order {left}, amplitude 0.1")
    assert "orders above 60 are not fitted" in words


def alarms(wobbling: range) -> int:
    """Of 200 recordings of coloured noise, with orders that differ from turn to turn, those in which one is told."""
    count = 0
    for seed in range(200):
        rng = np.random.default_rng([seed, 6])
        turns, rows = int(rng.integers(2, 9)), int(rng.choice([100, 200, 400]))
        theta = np.arange(turns * rows) / rows * 2 * np.pi
        phi = float(rng.choice([0.0, 0.5, 0.9, 0.97]))
        left = lfilter([np.sqrt(1 - phi**2)], [1, -phi], rng.standard_normal(theta.size))
        turn = np.arange(theta.size) // rows
        for k in wobbling:
            left = left + rng.standard_normal(turns)[turn] * np.cos(k * theta + rng.uniform(0, 6, turns)[turn])
        count += bool(repeated_orders(Samples.build(theta, left), left, 4))
    return count


def test_noise_is_no_order_and_wobble_of_each_turn_seldom() -> None:
    assert alarms(range(0)) == 0
    assert alarms(range(13, 40)) <= 1
    # isolated orders: nine in each recording, each taken for one that comes back once in a thousand
    assert alarms(range(13, 40, 3)) <= 5


def test_without_rows_in_a_part_of_the_turn_no_order_is_told() -> None:
    theta = np.linspace(0, 1.7 * np.pi, 400)
    samples = Samples.build(theta, np.cos(20 * theta))
    assert repeated_orders(samples, samples.error, 3) == []


@pytest.mark.parametrize("drift", [0.0, 0.05, 5.0])
def test_a_drift_and_faster_turns_with_fewer_rows_are_no_order(drift: float) -> None:
    """24 turns of 600 rows and 40 of 120: what the sensor drifts by was told as order 120, the aliased constant."""
    rows = np.array([600] * 24 + [120] * 40)
    theta = np.concatenate([np.arange(n) / n * 2 * np.pi + 2 * np.pi * k for k, n in enumerate(rows)])
    left = NOISE * np.random.default_rng(8).standard_normal(theta.size) + drift * np.arange(theta.size) / theta.size
    assert repeated_orders(Samples.build(theta, left), left, 8) == []
    with_order = left + 0.1 * np.cos(40 * theta)
    (found,) = repeated_orders(Samples.build(theta, with_order), with_order, 8)
    assert (found.order, found.amplitude) == (40, pytest.approx(0.1, abs=0.01))


@pytest.mark.parametrize("turns", [1, 4, 12])
def test_slow_noise_alone_raises_no_order_beyond_the_usual_range(turns: int) -> None:
    # before, BIC took such noise for structure in four of ten single turns
    raised = 0
    for seed in range(25):
        rng = np.random.default_rng([seed, turns])
        theta = np.arange(turns * 360) / 360 * 2 * np.pi
        noise = lfilter([np.sqrt(1 - 0.81)], [1, -0.9], rng.standard_normal(theta.size + 50))[50:]
        curve = fit(Samples.build(theta, NOISE * noise), CurveMethod.AUTO)
        raised += curve.order > LARGEST_ORDER
    assert raised == 0
