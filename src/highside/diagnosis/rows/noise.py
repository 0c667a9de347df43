"""The noise of a rotating recording: coloured channel by channel, and not equally large at all times.

Each channel's noise is autoregressive, its order chosen by BIC from a *rich* residual: all columns of the design are
projected off, so that no effect is taken for colour. What the projection takes with it biases the autocovariance; how
much is found out by doing the same to white noise, and is given back. How large the innovations are, row by row, is in
`scatter`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.chunks import in_order
from highside.diagnosis.core.memory import Memory
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.policy import ROW_NOISE
from highside.diagnosis.rows.scatter import scatter_of, spread
from highside.diagnosis.rows.weights import without_rows
from highside.long_arrays import by_runs, concatenated


@dataclass(frozen=True)
class RotationNoise:
    """`filters` (a_0 = 1, a_1, ...) of each channel, `weight` (C, N): whitened row = (filter * reading) * weight.

    `sigma` (C,) typical size of the innovations (g, gyros rad/s), `freedom` as for poses; `memories` of each channel's
    whitened rows, in blocks, where an offset follows a random walk.
    """

    filters: tuple[Array, ...]
    weight: Array
    sigma: Array
    freedom: float
    by_vibration: Array
    """(C,) gain of -2 log likelihood by letting the scatter follow vibration"""
    jitter: Array
    """(C, 3): gain of -2 log likelihood by letting it follow the rate, sampling jitter in s, its standard deviation"""
    impulses: int
    memories: tuple[Memory, ...] = ()

    @property
    def lead(self) -> int:
        """How many rows before a row its whitening needs."""
        return max(f.size for f in self.filters) - 1

    def whiten(self, channel: int, functions: Array, part: slice) -> Array:
        """Functions (m, lead + n), or (m, n) at the start of all, whitened for the rows of `part`, (m, n)."""
        led = min(part.start, self.lead)
        white = filtered(self.filters[channel], functions, led)
        white *= self.weight[channel, part]
        return white

    def autocorrelation(self, channel: int, lags: int) -> Array:
        """(lags,) of a channel's noise, 1 at none: that of the process which the filter whitens, by its spectrum."""
        found = self._autocovariance(channel, lags)
        return np.asarray(found / found[0], dtype=float)

    def _autocovariance(self, channel: int, lags: int) -> Array:
        """(lags,) of a channel's noise, in units of the variance of its innovations."""
        gain = np.abs(np.fft.rfft(self.filters[channel], max(ROW_NOISE.spectrum, 2 * lags))) ** 2
        return np.asarray(np.fft.irfft(1.0 / gain)[:lags], dtype=float)

    @property
    def row_sigma(self) -> Array:
        """(C,) typical standard deviation of a row, where `sigma` is that of what the rows before do not tell of it."""
        inflation = [float(self._autocovariance(c, 1)[0]) for c in range(len(self.filters))]
        return np.asarray(self.sigma * np.sqrt(inflation))

    @property
    def rows_per_independent(self) -> float:
        """How many rows tell as much of the size of the noise as one would by itself: the sum of the squares of its
        autocorrelation over all lags, the mean of the channels (Bartlett 1946, J. R. Stat. Soc. Suppl. 8, 27)."""
        lags = ROW_NOISE.spectrum // 2
        squares = [np.sum(self.autocorrelation(c, lags)[1:] ** 2) for c in range(len(self.filters))]
        return 1.0 + 2.0 * float(np.mean(squares))

    def white(self, columns: Array) -> Array:
        """(..., C, N) readings -> (..., C N) in units of the noise, a random walk of an offset left aside."""
        flat = columns.reshape(-1, *columns.shape[-2:])
        turned = np.stack([self.whiten(c, flat[:, c], slice(0, flat.shape[2])) for c in range(flat.shape[1])], axis=1)
        return np.asarray(turned.reshape(*columns.shape[:-2], columns.shape[-2] * columns.shape[-1]))


def filtered(polynomial: Array, rows: Array, led: int) -> Array:
    """a_0 x_t + a_1 x_(t-1) + ... of rows (m, led + n), (m, n); what lies before all rows counts as 0."""
    n = rows.shape[1] - led
    result = rows[:, led:].copy()
    term = np.empty_like(result)
    for k in range(1, polynomial.size):
        skip = max(0, k - led)
        if skip < n:
            part = term[:, : n - skip]
            np.multiply(rows[:, led - k + skip : led - k + n], polynomial[k], out=part)
            result[:, skip:] += part
    return np.asarray(result, dtype=float)


@dataclass
class _Learning:
    """Windows of rows with their functions on one channel: (m, lead + n) each, and readings (lead + n,).

    `counts` (n,) are 0 for rows that are left out.
    """

    parts: list[slice]
    functions: list[Array]
    readings: list[Array]
    counts: list[Array] | None

    def outside(self, polynomial: Array, others: Sequence[Array] = ()) -> tuple[list[Array], int, list[Array]]:
        """Filtered readings beyond the functions, window by window; the rank; and `others` (d, n) treated alike."""
        lead = polynomial.size - 1
        led = [min(lead, part.start) for part in self.parts]
        turned = [
            filtered(polynomial, f[:, f.shape[1] - (p.stop - p.start) - n :], n)
            for f, p, n in zip(self.functions, self.parts, led, strict=True)
        ]
        target = [
            filtered(polynomial, r[None, r.size - (p.stop - p.start) - n :], n)
            for r, p, n in zip(self.readings, self.parts, led, strict=True)
        ]
        if self.parts[0].start == 0:
            # the first rows lack what came before them
            for one in (turned[0], target[0]):
                one[:, :lead] = 0.0
        if self.counts is not None:
            lost = [np.convolve(1 - kept, np.ones(lead + 1))[: kept.size] > 0 for kept in self.counts]
            for one, rows in [*zip(turned, lost, strict=True), *zip(target, lost, strict=True)]:
                one[:, rows] = 0.0
        gram = sum((t @ t.T for t in turned), np.zeros((turned[0].shape[0],) * 2))
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram / size[:, None] / size[None, :])
        good = values > 1e-9 * values[-1]
        root = (vectors[:, good] / np.sqrt(values[good])) / size[:, None]

        def left(rows: list[Array]) -> list[Array]:
            projected = root.T @ sum(
                (t @ r.T for t, r in zip(turned, rows, strict=True)), np.zeros((size.size, len(rows[0])))
            )
            back = root @ projected
            return [r - back.T @ t for r, t in zip(rows, turned, strict=True)]

        return [r[0] for r in left(target)], int(good.sum()), left(list(others)) if others else []


def windows(n: int) -> list[slice]:
    """The rows that the noise is learned from."""
    if n <= ROW_NOISE.max_rows:
        return [slice(0, n)]
    length = ROW_NOISE.max_rows // ROW_NOISE.windows
    starts = np.linspace(0, n - length, ROW_NOISE.windows).astype(int)
    return [slice(int(s), int(s) + length) for s in starts]


def estimate(
    design: Design, residual: Array, seed: int, *, coloured: bool = True, only: Sequence[NDArray[np.intp]] | None = None
) -> RotationNoise:
    """The noise of a residual (C, N) after the base fit, all in the design, or `only` these functions, projected off.

    Without `coloured` it is taken for white and equally large at all times.
    """
    session = design.session
    parts = windows(session.n)
    made: list[list[Array]] = [[] for _ in session.channels]
    for part in parts:
        led = slice(max(0, part.start - 2 * ROW_NOISE.max_order), part.stop)
        for c, functions in enumerate(design.functions(led, only=only)):
            made[c].append(functions)

    def of(c: int) -> _Found:
        ones = by_runs(session.readings, (session.n,), lambda part: np.ones(part.stop - part.start))
        counts = None if session.omitted is None else [np.where(session.omitted[p], 0.0, 1.0) for p in parts]
        before = [residual[c, max(0, p.start - 2 * ROW_NOISE.max_order) : p.stop] for p in parts]
        size = float(np.sqrt(np.mean(session.readings[c] ** 2)))
        if float(residual[c].std()) < ROW_NOISE.rounding * size:
            # a simulation without noise: nothing is smaller than rounding
            return _Found(np.ones(1), ones / (ROW_NOISE.rounding * size), ROW_NOISE.rounding * size)
        learning = _Learning(parts, made[c], before, counts)
        polynomial = _colour(learning, np.random.default_rng([seed, c])) if coloured else np.ones(1)
        left, rank, _ = learning.outside(polynomial)
        rows = sum(r.size for r in left)
        shape, by_vibration, jitter, wild = scatter_of(session, c, parts, left, polynomial, coloured)
        level = float(
            np.sqrt(sum(float(np.sum((r * w) ** 2)) for r, w in zip(left, shape[1], strict=True)) / (rows - rank))
        )
        level = max(level, ROW_NOISE.least)
        nothing = [wild, np.arange(polynomial.size - 1)]
        if session.omitted is not None:
            nothing.append(spread(np.flatnonzero(session.omitted), polynomial.size - 1, session.n))
        weight = without_rows(shape[0] / level, np.unique(np.concatenate(nothing)))
        scatter = (jitter[0], jitter[1] * level, jitter[2] * level)
        return _Found(polynomial, weight, level, by_vibration, scatter, wild.size, float(rows - rank))

    found = list(in_order(of, range(len(session.channels))))
    return RotationNoise(
        tuple(one.polynomial for one in found),
        concatenated([one.weight[None] for one in found]),
        np.array([one.sigma for one in found]),
        min(float(session.n), *(one.freedom for one in found)),
        np.array([one.by_vibration for one in found]),
        np.array([one.jitter for one in found]),
        sum(one.impulses for one in found),
    )


@dataclass(frozen=True)
class _Found:
    """The noise of one channel; names as in `RotationNoise`."""

    polynomial: Array
    weight: Array
    sigma: float
    by_vibration: float = 0.0
    jitter: tuple[float, float, float] = (0.0, 0.0, 0.0)
    impulses: int = 0
    freedom: float = np.inf


def plain(sigma: Array, n: int) -> RotationNoise:
    """White noise of one size (C,) on each channel of n rows."""
    count = sigma.size
    weight = np.repeat(1 / sigma[:, None], n, axis=1)
    return RotationNoise((np.ones(1),) * count, weight, sigma, float(n), np.zeros(count), np.zeros((count, 3)), 0)


def with_random_walk(noise: RotationNoise, memories: Sequence[Memory]) -> RotationNoise:
    """The same noise with a random walk added to it."""
    return replace(noise, memories=tuple(memories))


def _colour(learning: _Learning, rng: np.random.Generator) -> Array:
    """The filter that whitens a channel: a first guess, then what is left of colour after it, bias taken off.

    What the projection takes of coloured noise is known only where it is white, after a filter. Of filters that
    multiply on, each small rest of colour is dropped that cannot be seen by itself, and what remains of it at low
    frequencies passes for a random walk. So where the projection takes much, the filter is chosen anew as a whole until
    it has settled. Elsewhere it may be longer (real surroundings: resonances, wind, roads) than one choice gives.
    """
    polynomial = np.ones(1)
    autocovariance, rows, rank = _left_over(learning, polynomial, rng)
    anew = rank >= ROW_NOISE.projected_share * rows
    for turn in range(ROW_NOISE.colour_turns if anew else 3):
        if turn:
            autocovariance, rows, _ = _left_over(learning, polynomial, rng)
        if anew:
            before, polynomial = polynomial, _levinson(_unfiltered(autocovariance, polynomial), rows)
            if polynomial.size == before.size and np.abs(polynomial - before).max() < ROW_NOISE.colour_settled:
                break
            continue
        step = _levinson(autocovariance, rows)
        if step.size == 1:
            break
        polynomial = np.convolve(polynomial, step)
        if turn:
            # the refinement multiplies on; its far terms are nothing
            polynomial = polynomial[: 2 * ROW_NOISE.max_order + 1]
    return polynomial


def _left_over(learning: _Learning, polynomial: Array, rng: np.random.Generator) -> tuple[Array, int, int]:
    """Autocovariance (lags,) of what a filter leaves of the noise, relative to its variance; how many rows; rank."""
    drawn = [rng.standard_normal((ROW_NOISE.draws, p.stop - p.start)) for p in learning.parts]
    left, rank, projected = learning.outside(polynomial, drawn)
    rows = sum(r.size for r in left)
    level = sum(float(r @ r) for r in left) / (rows - rank)
    found = _autocovariance([r[None] for r in left])[0] / level
    # what projecting the functions off does to white noise, on average
    return found + np.mean(_autocovariance(drawn) - _autocovariance(projected), axis=0), rows, rank


def _unfiltered(autocovariance: Array, polynomial: Array) -> Array:
    """Autocovariance (lags,) of what a filter made the given one of, by their spectra."""
    if polynomial.size == 1:
        return autocovariance
    lags = autocovariance.size
    whole = np.zeros(ROW_NOISE.spectrum)
    whole[:lags] = autocovariance
    whole[1 - lags :] = autocovariance[:0:-1]
    gain = np.abs(np.fft.rfft(polynomial, ROW_NOISE.spectrum)) ** 2
    return np.asarray(np.fft.irfft(np.fft.rfft(whole).real / gain, ROW_NOISE.spectrum)[:lags], dtype=float)


def _autocovariance(series: list[Array]) -> Array:
    """(d, lags) mean product at each lag of series (d, n), pooled over windows."""
    total = np.zeros((series[0].shape[0], ROW_NOISE.max_order + 1))
    rows = sum(s.shape[1] for s in series)
    for s in series:
        for k in range(ROW_NOISE.max_order + 1):
            total[:, k] += np.einsum("dn,dn->d", s[:, k:], s[:, : s.shape[1] - k])
    return np.asarray(total / rows, dtype=float)


def _levinson(autocovariance: Array, rows: int) -> Array:
    """Prediction error filter of the order that BIC chooses, by the Levinson-Durbin recursion."""
    error = float(autocovariance[0])
    polynomial = np.ones(1)
    if error <= 0.0:
        # of nearly nothing, what a filter is divided out of may be less than nothing
        return polynomial
    best, chosen = rows * np.log(error), polynomial
    for order in range(1, ROW_NOISE.max_order + 1):
        reflection = -float(polynomial @ autocovariance[order:0:-1][:order]) / error
        if not abs(reflection) < 1:
            break
        padded = np.append(polynomial, 0.0)
        polynomial = padded + reflection * padded[::-1]
        error *= 1 - reflection**2
        score = rows * np.log(error) + order * np.log(rows)
        if score < best:
            best, chosen = score, polynomial
    return np.asarray(chosen)
