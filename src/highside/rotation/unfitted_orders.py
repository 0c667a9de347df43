"""Orders of the turn above those of a fit: does what the fit leaves come back from turn to turn?

BIC compares orders one by one from the lowest, so a lone high order is not seen while its range ends below it. The
coefficient of each order above the fitted ones is therefore taken turn by turn, c_kt = (2 / n_t) sum r exp(-i k theta).
Its mean over T turns is compared with what it varies by from turn to turn at the orders near it,

    F_k = T |mean_t c_kt|^2 / s_k^2
    s_k^2: the mean over the orders j within 5 of k of sum_t |c_jt - mean_t c_jt|^2 / (T - 1)

which is F distributed with 2 and 22 (T - 1) degrees of freedom where nothing comes back (circular complex normal
coefficients: Brillinger, Time Series, 1981, section 6.2); half as many are counted, as levels differ from order to
order. Wobble of one order that differs from turn to turn is not in the level of its neighbours: the same ratio to the
order's own variance, with 2 and 2 (T - 1) degrees of freedom, must exceed chance too. Of less than two whole turns s_k
is taken from the other orders near it, and wobble cannot be distinguished from an error that comes back.

A turn of n_t rows shows orders below n_t / 2; above them a constant, or what the sensor drifts by between turns, comes
back as an order near n_t. So turns of far fewer rows than the others (faster ones) are left aside, and the least of the
rest bounds the orders. A drift within the turns, a ramp each, would come back at all orders: the straight line of each
turn is taken off first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.angles import TURN, wrap_positive
from highside.rotation.samples import Samples
from highside.special import fdtrc

HIGHEST_ORDER = 120
"""Highest order that is looked at: twice the highest that is fitted, so that what lies beyond that is told."""
CHANCE = 1e-4
"""Probability by which any order of noise is reported. Source: a hundredth of a false alarm in a hundred fits."""
OWN_CHANCE = 1e-3
"""Probability by which wobble of one order comes back as well by chance. Source: two turns of 720 rows prove an order
of three times the noise of a row; of 200 recordings with nine such orders each 2 are alarms
(`tests/unit/test_rotation_orders.py`)."""
NEIGHBOURS = 5
"""Orders at each side by which the level of an order is known. Source: eleven are known to a third of a turn's own."""
FEWER_ROWS = 0.5
"""Rows of a turn, of the median's, below which it is left aside. Source: half as many show half of the orders."""
LEAKAGE = 0.05
"""Size, in that of the largest, below which an order is taken for leakage of it. Source: rows uneven over the turn by a
tenth leave at most that of one order in its neighbours."""


@dataclass(frozen=True, slots=True)
class RepeatedOrder:
    """An order that comes back in every turn, its amplitude in the errors' unit, and the number of whole turns."""

    order: int
    amplitude: float
    turns: int


def repeated_orders(samples: Samples, residual: Array, above: int) -> list[RepeatedOrder]:
    """Orders above `above` that the residual (N,) of a fit holds beyond chance, the largest amplitude first.

    None of them where a part of the turn is not covered: orders cannot be separated there.
    """
    turn, count = _turns(samples)
    least = int(np.bincount(turn[turn >= 0], minlength=count).min())
    top = min(HIGHEST_ORDER, (_occupied(samples.theta_rad) - 1) // 2, least // 2 - 1)
    if samples.coverage.has_gap or top - above < NEIGHBOURS:
        return []
    orders = np.arange(above + 1.0, top + 1.0)
    coefficients = _coefficients(samples.theta_rad, residual, turn, count, orders)
    mean = coefficients.mean(axis=1)
    level, freedom, own = _level(coefficients, mean)
    energy = count * np.abs(mean) ** 2
    chance = fdtrc(2.0, freedom, energy / np.maximum(level, 1e-300)) * orders.size
    wobble = (1.0 + energy / np.maximum(own * (count - 1), 1e-300)) ** (1.0 - count)
    # what double precision leaves of a fit is no order
    largest = max(float(np.abs(mean).max()), 1e-12 * float(np.abs(samples.error).max()))
    found = np.flatnonzero(
        (chance < CHANCE) & ((wobble < OWN_CHANCE) | (count == 1)) & (np.abs(mean) > LEAKAGE * largest)
    )
    found = found[np.argsort(-np.abs(mean[found]), kind="stable")]
    return [RepeatedOrder(int(orders[k]), float(np.abs(mean[k])), count) for k in found]


def _turns(samples: Samples) -> tuple[NDArray[np.int64], int]:
    """(N,) number of the whole turn of each row, -1 beyond the last of them, and how many; all rows as one turn where
    there are less than two."""
    whole = samples.whole_revolutions
    if len(whole) < 2:
        return np.zeros(samples.n, dtype=np.int64), 1
    revolution = samples.revolution
    turn = np.where(revolution <= whole[-1], revolution - whole[0], -1)
    rows = np.bincount(turn[turn >= 0], minlength=len(whole))
    kept = rows >= FEWER_ROWS * np.median(rows)
    number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return number[turn], int(kept.sum())


def _occupied(theta_rad: Array) -> int:
    """Sectors of the turn that hold rows, of twice as many as the highest order needs."""
    sectors = 4 * HIGHEST_ORDER + 2
    return int(np.unique((wrap_positive(theta_rad) * (sectors / TURN)).astype(np.int64)).size)


def _coefficients(theta_rad: Array, residual: Array, turn: NDArray[np.int64], count: int, orders: Array) -> Array:
    """(K, T) complex amplitude of each order in each turn."""
    used = turn >= 0
    own, theta = turn[used], theta_rad[used]
    rows = np.maximum(np.bincount(own, minlength=count), 1)
    left = _without_lines(residual[used], own, rows)
    step = np.exp(-1j * theta)
    wave = left * np.exp(-1j * orders[0] * theta)
    found = np.empty((orders.size, count), dtype=complex)
    for k in range(orders.size):
        real = np.bincount(own, wave.real, minlength=count)
        found[k] = 2.0 / rows * (real + 1j * np.bincount(own, wave.imag, minlength=count))
        wave *= step
    return found


def _without_lines(values: Array, own: NDArray[np.int64], rows: NDArray[np.int64]) -> Array:
    """Values (N,) without the straight line over the rows of each turn `own` (N,), which has `rows` (T,) of them."""
    count = rows.size
    order = np.argsort(own, kind="stable")
    place = np.empty(own.size)
    place[order] = np.arange(own.size) - np.repeat(np.cumsum(rows) - rows, np.bincount(own, minlength=count))
    place -= (0.5 * (rows - 1))[own]
    centred = values - (np.bincount(own, values, minlength=count) / rows)[own]
    slope = np.bincount(own, centred * place, minlength=count) / np.maximum(
        np.bincount(own, place**2, minlength=count), 1e-300
    )
    return np.asarray(centred - slope[own] * place)


def _level(coefficients: Array, mean: Array) -> tuple[Array, float, Array]:
    """(K,) variance of one turn's coefficient by the orders near it, the degrees of freedom it is known to, and (K,)
    that by the order alone."""
    orders, count = coefficients.shape
    width = min(NEIGHBOURS, (orders - 1) // 2)
    if count > 1:
        own = np.sum(np.abs(coefficients - mean[:, None]) ** 2, axis=1) / (count - 1)
        freedom = 2.0 * (count - 1) * (width + 1)
    else:
        own, freedom = np.abs(mean) ** 2, 2.0 * width
    level = np.empty(orders)
    for k in range(orders):
        low = min(max(k - width, 0), orders - 2 * width - 1)
        near = np.arange(low, low + 2 * width + 1)
        # one turn says nothing of how an order varies: the median of the others, which a second order does not raise
        level[k] = own[near].mean() if count > 1 else np.median(own[near[near != k]]) / np.log(2.0)
    return level, freedom, own
