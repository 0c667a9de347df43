"""Open recordings of real sensors, as the second deck uses them; with a calibration by |g| of the deck's own.

Two kinds: sessions by hand (the tool held still in many attitudes) and rests. What is put into a recording needs the
specific force at each row: in a hand session it is found by fitting nine parameters to |a| = 1 over the still
stretches, at rest it is the one direction that all rows share.
"""

from __future__ import annotations

import gzip
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

DATA = Path(os.environ.get("HIGHSIDE_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")
"""Beside the checkout, never inside it: each recording keeps its own licence."""
G0 = 9.80665

HAND = ("imu_tk", "mpu9150_imu0", "mpu9150_imu1")
REST = ("sunsided", "tomisuarez", "vn100")
STATIC = ("sunsided", "tomisuarez")
"""rests that are long and fast enough to lend their noise to a bench"""

WINDOW = 50
MIN_RUN = 100
BLOCK_S = 2.0


@dataclass(frozen=True)
class Real:
    """n rows: `t` s, `accel` (3, n) in g at nominal scale, `force` (3, n) in g, `temp` degC where it was recorded.

    `still` are the rows of each still reading: a whole stop of a hand session, a block of a rest. `sigma` is the
    scatter of |a| of one of them, in g.
    """

    name: str
    kind: str
    t: np.ndarray
    accel: np.ndarray
    force: np.ndarray
    temp: np.ndarray | None
    still: list[slice]
    sigma: float
    step: float
    """of the converter, g; 0 where there is none to be seen"""


def _read(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, float]:
    """Time, readings at nominal scale, temperature, and the converter's step."""
    if name == "imu_tk":
        with np.load(DATA / "accel_multipose" / "imu_tk_xsens_mti.npz") as z:
            return z["t"], (z["acc"].T.astype(float) - 2**15) / 2**12, None, 2.0**-12
    if name.startswith("mpu9150"):
        with gzip.open(DATA / "accel_multipose" / f"{name}.log.gz", "rt") as lines:
            a = np.loadtxt(lines)[:, :3].T / G0
        return np.arange(a.shape[1]) / 100.0, a, None, 0.0
    if name == "sunsided":
        with np.load(DATA / "static_mpu6050" / "sunsided_static_10min.npz") as z:
            return z["t"], z["acc"].T, np.interp(z["t"], z["temp_t"], z["temp"]), 2.0**-12
    if name == "tomisuarez":
        with gzip.open(DATA / "static_mpu6050" / "mpu6050_tomisuarez_static.csv.gz", "rt") as lines:
            rows = np.loadtxt(lines, delimiter=",", skiprows=5)
        return np.arange(len(rows)) / 100.0, rows[:, :3].T / 16384.0, None, 4.0 / 16384.0
    if name == "vn100":
        with gzip.open(DATA / "serial_vn100" / "F00379_first60pct_decoded.csv.gz", "rt") as lines:
            table = np.genfromtxt(lines, delimiter=",", names=True)
        return table["t_s"], np.stack([table[f"Acc{k}"] for k in "XYZ"]) / G0, table["Temp"], 0.0
    raise ValueError(name)


@cache
def recording(name: str) -> Real:
    """A recording by its name, with what the deck found out about it."""
    t, accel, temp, step = _read(name)
    if name in HAND:
        stops = _stops(accel)
        readings = np.stack([accel[:, s].mean(axis=1) for s in stops], axis=1)
        offset, matrix, sigma = _by_magnitude(readings)
        return Real(name, "hand", t, accel, matrix @ (accel - offset[:, None]), temp, stops, sigma, step)
    middle = np.median(accel, axis=1)
    rate = (t.size - 1) / (t[-1] - t[0])
    length = max(2, round(BLOCK_S * rate))
    blocks = [slice(k, k + length) for k in range(0, t.size - length, length)]
    # only blocks as still as most of them: one at rest is handled now and then
    unrest = np.array([np.ptp(accel[:, b], axis=1).max() for b in blocks])
    blocks = [b for b, u in zip(blocks, unrest, strict=True) if u < 2.0 * np.median(unrest)]
    size = np.array([np.linalg.norm(accel[:, b].mean(axis=1)) for b in blocks])
    sigma = float(np.median(np.abs(np.diff(size))) / 0.6745 / np.sqrt(2.0))
    force = np.repeat((middle / np.linalg.norm(middle))[:, None], t.size, axis=1)
    return Real(name, "rest", t, accel, force, temp, blocks, sigma, step)


def _stops(accel: np.ndarray) -> list[slice]:
    """Runs of windows in which nothing moves, half a second cut off at both ends."""
    count = accel.shape[1] // WINDOW
    scatter = accel[:, : count * WINDOW].reshape(3, count, WINDOW).std(axis=2).max(axis=0)
    quiet = scatter < 2.0 * np.quantile(scatter, 0.2)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.astype(int), [0]])))
    runs = [slice(a * WINDOW + WINDOW, b * WINDOW - WINDOW) for a, b in edges.reshape(-1, 2)]
    return [run for run in runs if run.stop - run.start >= MIN_RUN]


def _by_magnitude(readings: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Offset (3,), symmetric matrix (3, 3) that make |matrix (a - offset)| = 1, and the scatter that stays."""
    upper = np.triu_indices(3)

    def matrix(p: np.ndarray) -> np.ndarray:
        m = np.zeros((3, 3))
        m[upper] = p[3:]
        return m + m.T - np.diag(np.diag(m))

    def misfit(p: np.ndarray) -> np.ndarray:
        return np.linalg.norm(matrix(p) @ (readings - p[:3, None]), axis=0) - 1.0

    found = least_squares(misfit, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0]), x_scale=0.01, xtol=1e-14)
    sigma = float(np.sqrt(np.sum(found.fun**2) / (readings.shape[1] - 9)))
    return found.x[:3], matrix(found.x), sigma


def energy(real: Real, signal: np.ndarray, covariates: tuple[np.ndarray, ...] = ()) -> float:
    """Of a signal (3, n): its part along gravity, outside of what a base fit absorbs, in units of the noise, squared.

    `covariates` (n,) are what the base fit follows beside offset and matrix.
    """
    along = np.array([real.force[:, s].mean(axis=1) for s in real.still]).T
    along /= np.linalg.norm(along, axis=0)
    seen = np.sum(along * np.array([signal[:, s].mean(axis=1) for s in real.still]).T, axis=0)
    x, y, z = along
    base = [x, y, z, x * x, y * y, z * z, x * y, x * z, y * z] if real.kind == "hand" else [np.ones(seen.size)]
    base += [np.array([c[s].mean() for s in real.still]) for c in covariates]
    u, s, _ = np.linalg.svd(np.array(base).T, full_matrices=False)
    q = u[:, s > 1e-9 * s[0]]
    left = seen - q @ (q.T @ seen)
    return float(np.sum((left / real.sigma) ** 2))
