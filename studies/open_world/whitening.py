"""Readings brought to independent errors of unit size, so that what they say of a signal is a sum of squares.

`whitened(s, noise)` gives a function of signals (C, n, p), p columns for each of C channels and n rows in g and rad/s;
its result (q, p) has no unit, and the inner product of two columns of it is a^T C^-1 b with C the covariance of the
noise. Poses: means, exactly correlated, and rows about them, as independent. Rotations: row by row; slow noise by the
innovations of a Kalman filter (Kailath 1968), exact on irregular times and without a matrix of n by n.

`plain_columns`, `span` and `triangle` are what is done with whitened signals before they are compared.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import noises, world
from .noises import Noise
from .world import Session

FISHER_OF_HEAVY = 2.0
"""information of a Student t of 3 degrees of freedom, in units of that of a Gaussian of the same variance"""
CUT = 1e-7
"""share of a column that is new, below which it says nothing of its own (as `world.off_base` has it)"""
CHUNK = 4096
"""rows that enter a triangular factor at a time"""

Whitening = Callable[[np.ndarray], np.ndarray]


def whitened(s: Session, noise: Noise) -> Whitening:
    """What makes the errors of a session's readings independent and of unit size: signals (C, n, p) to (q, p)."""
    if s.kind == "poses":
        return OfPoses(s, noise)
    if noise.kind in noises.SERIAL - {"jitter"}:
        return OfSlowNoise(s, noise)
    return OfRows(s, noise)


def _variances(s: Session, noise: Noise) -> list[np.ndarray]:
    """Of the white noise of each channel, at each row (n,); of heavy noise the one that is as informative."""
    heavy = FISHER_OF_HEAVY if noise.kind == "heavy" else 1.0
    return [noises._white_variance(s, noise, c) / heavy for c in range(len(noise.sigma))]


class OfPoses:
    """Of a stepped session: means of poses, and rows about them."""

    def __init__(self, s: Session, noise: Noise) -> None:
        self.number = np.unique(s.pose, return_inverse=True)[1]
        rows = np.bincount(self.number)
        self.averaged = (self.number == np.arange(rows.size)[:, None]) / rows[:, None]
        variance = _variances(s, noise)
        size = rows.size
        covariance = np.zeros((3 * size, 3 * size))
        for c in range(3):
            block = np.diag(self.averaged @ variance[c] / rows)
            if noise.kind == "quantised":
                # what rounding leaves of a mean is the same for all rows where the noise is small beside the step
                # (Widrow and Kollar 2008, chapter 4: the first term of the series)
                common = noise.step**2 / (2 * np.pi**2) * np.exp(-((2 * np.pi * noise.sigma[c] / noise.step) ** 2))
                block = block + common * np.diag(1.0 - 1.0 / rows)
            if noise.kind in ("coloured", "one_over_f", "walk"):
                block = block + noise.sigma[c] ** 2 * (self.averaged @ noises._slow(noise, s.t) @ self.averaged.T)
            covariance[c * size : (c + 1) * size, c * size : (c + 1) * size] = block
        if noise.kind == "jitter":
            up = self.averaged @ world.loads(s).T
            across = noise.jitter**2 * (np.eye(3)[None] - up[:, :, None] * up[:, None, :])
            for a in range(3):
                for b in range(3):
                    k = np.arange(size)
                    covariance[a * size + k, b * size + k] += across[:, a, b]
        self.root = np.linalg.cholesky(covariance)
        self.spread = np.sqrt(np.stack(variance))

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        """Of a signal (3, n, p): (q, p)."""
        means = np.einsum("kn,cnp->ckp", self.averaged, signal)
        within = (signal - means[:, self.number]) / self.spread[:, :, None]
        flat = np.linalg.solve(self.root, means.reshape(-1, means.shape[2]))
        return np.concatenate([flat, within.reshape(-1, within.shape[2])])


class OfRows:
    """Of a rotation whose rows are independent of one another: each by its own errors.

    What a converter rounds away is white here: the readings turn through its steps. On an axis along which the load
    stays, errors of rounding are in truth common to many rows where the noise is small beside a step.
    """

    def __init__(self, s: Session, noise: Noise) -> None:
        self.scale = 1.0 / np.sqrt(np.stack(_variances(s, noise)))
        self.up = world.loads(s) if noise.kind == "jitter" else None
        # an error of the bench's setting turns gravity: along it the readings stay as sure as they were. All three
        # accelerometers have the same noise, so that the inverse root of s^2 I + j^2 (I - u u^T) has closed form
        self.across = 1.0 / np.hypot(noise.sigma[0], noise.jitter)

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        """Of a signal (C, n, p): (C n, p)."""
        out: np.ndarray = signal * self.scale[:, :, None]
        if self.up is not None:
            along = np.einsum("cn,cnp->np", self.up, signal[:3])
            out[:3] = self.across * signal[:3]
            out[:3] += self.up[:, :, None] * ((self.scale[0] - self.across)[:, None] * along)[None]
        return out.reshape(-1, signal.shape[2])


class OfSlowNoise:
    """Of a rotation with slow noise beside the white one: innovations of a Kalman filter, in units of their spread.

    The slow part is a sum of Ornstein-Uhlenbeck processes, or a walk from the first row on. It grows with the white
    noise of its channel, so that one sequence of gains (n, m), m states, serves all channels.
    """

    def __init__(self, s: Session, noise: Noise) -> None:
        self.sigma = np.array(noise.sigma)
        steps = np.diff(s.t, prepend=s.t[0])
        if noise.kind == "walk":
            self.decay, fresh = np.ones((s.n, 1)), steps[:, None]
            covariance = np.zeros((1, 1))
        else:
            taus = np.array([noise.tau]) if noise.kind == "coloured" else noises._taus(noise)
            self.decay = np.exp(-steps[:, None] / taus)
            fresh = 1.0 - self.decay**2
            covariance = np.eye(taus.size)
        states = self.decay.shape[1]
        self.seen = noise.level / np.sqrt(states)
        """of each state in a reading"""
        self.gains = np.empty((s.n, states))
        self.spread = np.empty(s.n)
        for k in range(s.n):
            covariance = covariance * np.outer(self.decay[k], self.decay[k])
            covariance[np.diag_indices(states)] += fresh[k]
            with_reading = self.seen * covariance.sum(axis=1)
            variance = 1.0 + self.seen * with_reading.sum()
            self.gains[k] = with_reading / variance
            self.spread[k] = np.sqrt(variance)
            covariance = covariance - np.outer(self.gains[k], with_reading)

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        """Of a signal (C, n, p): (n C, p)."""
        channels, n, p = signal.shape
        out = np.zeros((n, channels, p))
        touched = np.flatnonzero(np.any(signal != 0.0, axis=(1, 2)))
        of_rows = (signal[touched] / self.sigma[touched, None, None]).transpose(1, 0, 2).reshape(n, -1)
        state = np.zeros((self.gains.shape[1], of_rows.shape[1]))
        for k in range(n):
            state *= self.decay[k][:, None]
            of_rows[k] -= self.seen * state.sum(axis=0)
            state += self.gains[k][:, None] * of_rows[k]
        out[:, touched] = (of_rows / self.spread[:, None]).reshape(n, touched.size, p)
        return out.reshape(-1, p)


# --- of whitened signals --------------------------------------------------------------------------------------------


def plain_columns(s: Session) -> np.ndarray:
    """Offset, scale and misalignment (C, n, 4 C), g and rad/s: of accelerometers by the load, of gyros by the spin."""
    drives = [world.loads(s)] + ([world.spin(s.inc, s.tf, s.rate)] if s.gyros else [])
    found = np.zeros((3 * len(drives), s.n, 12 * len(drives)))
    for k, load in enumerate(drives):
        drive = np.concatenate([np.ones((1, s.n)), load])
        for c in range(3 * k, 3 * k + 3):
            found[c, :, 4 * c : 4 * c + 4] = drive.T
    return found


def span(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns (q, r) of what columns (q, p) span."""
    q, r = np.linalg.qr(columns)
    norms = np.linalg.norm(columns, axis=0)
    if np.all(np.abs(np.diag(r)) > CUT * norms):
        return q
    # a constant angle makes a column twice
    u, size, _ = np.linalg.svd(columns / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
    return u[:, size > CUT * size[0]]


def triangle(parts: list[np.ndarray]) -> np.ndarray:
    """Columns beside one another, each part (q, p_k), brought to as few rows as their inner products need (P, P)."""
    width = sum(part.shape[1] for part in parts)
    chunk = max(CHUNK, 2 * width)
    factor = np.zeros((0, width))
    for at in range(0, len(parts[0]), chunk):
        rows = np.concatenate([part[at : at + chunk] for part in parts], axis=1)
        factor = np.asarray(np.linalg.qr(np.concatenate([factor, rows]), mode="r"))
    return factor
