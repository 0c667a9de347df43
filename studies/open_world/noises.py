"""Noise of every kind that instruments have, with its covariance: strengths are counted in what it lets be known.

`energy` is the noncentrality of a signal in that noise: d^T C^-1 d, exact at pose means, by the spectrum in a rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from .world import Session, loads

KINDS = ("white", "coloured", "one_over_f", "walk", "heavy", "modulated", "quantised", "jitter")
SERIAL = frozenset({"coloured", "one_over_f", "walk", "jitter"})
"""kinds whose readings are not independent of one another along one axis"""
GYRO_SIGMA = np.radians(0.02)
"""of a row, rad/s"""
BLOCKS = 400
"""of a rotation, within which a walk hardly moves"""
LADDER = 6
"""Ornstein-Uhlenbeck processes, four apart in time, that make 1/f"""


@dataclass(frozen=True)
class Noise:
    """Noise of one session."""

    kind: str
    sigma: tuple[float, ...]
    """white part of each channel, of a row"""
    tau: float = 0.0
    """s: of the coloured part"""
    level: float = 0.0
    """rms of the slow part of a row in units of sigma; of a walk its growth a square root of a second"""
    step: float = 0.0
    """of a converter, g"""
    jitter: float = 0.0
    """of the bench, rad"""
    period: float = 1.0
    """of the modulation, s"""


def drawn(rng: np.random.Generator, s: Session, kind: str) -> Noise:
    """A noise of a kind for a session."""
    row = float(np.exp(rng.uniform(np.log(40e-6), np.log(300e-6))))
    sigma = tuple([row] * 3 + ([GYRO_SIGMA] * 3 if s.gyros else []))
    span = float(np.ptp(s.t))
    if kind in ("coloured", "one_over_f"):
        shortest = float(np.median(np.diff(s.t)))
        tau = float(np.exp(rng.uniform(np.log(10 * shortest), np.log(max(span / 8, 11 * shortest)))))
        return Noise(kind, sigma, tau=tau, level=rng.uniform(0.3, 1.0))
    if kind == "walk":
        # as large at the end as some to many errors of a mean of ten rows
        return Noise(kind, sigma, level=rng.uniform(0.5, 4.0) / np.sqrt(span))
    if kind == "quantised":
        return Noise(kind, sigma, step=row * rng.uniform(2.0, 8.0))
    if kind == "jitter":
        return Noise(kind, sigma, jitter=row * rng.uniform(0.5, 3.0))
    if kind == "modulated":
        return Noise(kind, sigma, period=span / rng.uniform(1.0, 4.0))
    return Noise(kind, sigma)


def _ou(rng: np.random.Generator, t: np.ndarray, tau: float) -> np.ndarray:
    """A process of unit variance that forgets with a time constant, exact on any times."""
    n = t.size
    decay = np.exp(-np.diff(t) / tau)
    drive = rng.standard_normal(n)
    if np.ptp(decay) < 1e-9:
        a = float(decay[0])
        first = drive[0]
        rest = lfilter([1.0], [1.0, -a], np.sqrt(1 - a * a) * drive[1:], zi=[a * first])[0]
        return np.concatenate([[first], rest])
    out = np.empty(n)
    out[0] = drive[0]
    for k in range(n - 1):
        out[k + 1] = decay[k] * out[k] + np.sqrt(1 - decay[k] ** 2) * drive[k + 1]
    return out


def _taus(noise: Noise) -> np.ndarray:
    return noise.tau * 4.0 ** np.arange(-LADDER // 2, LADDER - LADDER // 2)


def _modulation(noise: Noise, t: np.ndarray) -> np.ndarray:
    return 0.4 + 1.2 * np.sin(np.pi * (t - t[0]) / noise.period) ** 2


def added(rng: np.random.Generator, s: Session, noise: Noise, clean: np.ndarray) -> np.ndarray:
    """The readings with their noise."""
    c = len(clean)
    sigma = np.array(noise.sigma)[:, None]
    white = rng.standard_normal((c, s.n))
    if noise.kind == "heavy":
        white = rng.standard_t(3, (c, s.n)) / np.sqrt(3.0)
    if noise.kind == "modulated":
        white = white * _modulation(noise, s.t)
    out = clean + sigma * white
    if noise.kind == "coloured":
        out = out + sigma * noise.level * np.stack([_ou(rng, s.t, noise.tau) for _ in range(c)])
    if noise.kind == "one_over_f":
        steps = [sum(_ou(rng, s.t, tau) for tau in _taus(noise)) / np.sqrt(LADDER) for _ in range(c)]
        out = out + sigma * noise.level * np.stack(steps)
    if noise.kind == "walk":
        steps = rng.standard_normal((c, s.n)) * np.sqrt(np.diff(s.t, prepend=s.t[0]))
        out = out + sigma * noise.level * np.cumsum(steps, axis=1)
    if noise.kind == "jitter":
        out[:3] += _shaken(rng, s, noise.jitter)
    if noise.kind == "quantised":
        out[:3] = noise.step * np.round(out[:3] / noise.step)
    return out


def _shaken(rng: np.random.Generator, s: Session, size: float) -> np.ndarray:
    """What errors of the bench's setting do: a rotation of gravity, the same for all rows of a pose."""
    count = int(s.pose[-1]) + 1 if s.pose.size else s.n
    turn = rng.normal(0, size, (3, count))
    turn = turn[:, s.pose] if s.pose.size else turn
    return np.cross(turn.T, loads(s).T).T


# --- what can be known ---------------------------------------------------------------------------------------------


def energy(s: Session, noise: Noise, signal: np.ndarray) -> float:
    """Noncentrality of a signal (C, n) off the base fit."""
    return _energy_of_poses(s, noise, signal) if s.kind == "poses" else _energy_of_rows(s, noise, signal)


def _white_variance(s: Session, noise: Noise, channel: int) -> np.ndarray:
    variance = np.full(s.n, noise.sigma[channel] ** 2)
    if noise.kind == "modulated":
        variance = variance * _modulation(noise, s.t) ** 2
    if noise.kind == "quantised" and channel < 3:
        variance = variance + noise.step**2 / 12.0
    return variance


def _slow(noise: Noise, t: np.ndarray) -> np.ndarray:
    """Covariance (n, n) of the slow part at times, in units of sigma squared."""
    apart = np.abs(t[:, None] - t[None])
    if noise.kind == "coloured":
        return noise.level**2 * np.exp(-apart / noise.tau)
    if noise.kind == "one_over_f":
        return noise.level**2 * np.mean([np.exp(-apart / tau) for tau in _taus(noise)], axis=0)
    return noise.level**2 * np.minimum((t - t[0])[:, None], (t - t[0])[None])


def _energy_of_poses(s: Session, noise: Noise, signal: np.ndarray) -> float:
    return _energy_of_means(s, noise, signal, np.unique(s.pose, return_inverse=True)[1])


def _energy_of_means(s: Session, noise: Noise, signal: np.ndarray, number: np.ndarray) -> float:
    """Means of groups of rows, whose slow noise is common, and what happens within a group in white noise."""
    rows = np.bincount(number)
    averaged = (number == np.arange(rows.size)[:, None]) / rows[:, None]
    slow = averaged @ _slow(noise, s.t) @ averaged.T if noise.kind in SERIAL - {"jitter"} and s.n <= 3000 else None
    if slow is None and noise.kind in SERIAL - {"jitter"}:
        slow = _slow(noise, averaged @ s.t)
    total = 0.0
    for c, values in enumerate(signal):
        variance = _white_variance(s, noise, c)
        covariance = np.diag(averaged @ variance / rows)
        if slow is not None:
            covariance = covariance + noise.sigma[c] ** 2 * slow
        elif noise.kind == "jitter" and c < 3:
            # across gravity; along it the readings stay as sure as they were
            covariance = covariance + np.diag(noise.jitter**2 * (1.0 - (averaged @ loads(s)[c]) ** 2))
        d = averaged @ values
        total += float(d @ np.linalg.solve(covariance, d) + np.sum((values - d[number]) ** 2 / variance))
    return total


def _energy_of_rows(s: Session, noise: Noise, signal: np.ndarray) -> float:
    if noise.kind == "walk":
        return _energy_of_means(s, noise, signal, np.arange(s.n) * BLOCKS // s.n)
    total = 0.0
    step = float(np.median(np.diff(s.t)))
    for c, values in enumerate(signal):
        variance = _white_variance(s, noise, c)
        if noise.kind not in SERIAL:
            total += float(np.sum(values**2 / variance))
            continue
        if noise.kind == "jitter":
            across = noise.jitter**2 * (1.0 - loads(s)[c] ** 2) if c < 3 else 0.0
            total += float(np.sum(values**2 / (variance + across)))
            continue
        frequency = np.fft.rfftfreq(s.n, step)
        power = np.abs(np.fft.rfft(values)) ** 2 / s.n
        weight = np.where((frequency == 0) | (np.arange(frequency.size) * 2 == s.n), 1.0, 2.0)
        size = (noise.sigma[c] * noise.level) ** 2
        taus = np.array([noise.tau]) if noise.kind == "coloured" else _taus(noise)
        a = np.exp(-step / taus)[:, None]
        slow = size * np.mean((1 - a**2) / (1 - 2 * a * np.cos(2 * np.pi * frequency * step) + a**2), axis=0)
        total += float(np.sum(weight * power / (variance[0] + slow)))
    return total
