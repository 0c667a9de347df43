"""What the files of this folder hold: a tool that is turned by hand, and the same spoilt on the way into a file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

STANDARD_GRAVITY = 9.80665
START_NS = 1_752_345_678_000_000_000
"""2025-07-12 18:41:18 UTC"""
RATE_HZ = 50.0


@dataclass(frozen=True, slots=True)
class Session:
    """`t_s` (N,), gravity in g (3, N), rates in deg/s (3, N), the bench's angles in deg (N,), temperature in deg C."""

    t_s: np.ndarray
    accel_g: np.ndarray
    rate_dps: np.ndarray
    inc_deg: np.ndarray
    tf_deg: np.ndarray
    temp_c: np.ndarray

    @property
    def n(self) -> int:
        return int(self.t_s.size)

    @property
    def ns(self) -> np.ndarray:
        """Whole nanoseconds since 1970 (N,)."""
        return START_NS + np.rint(self.t_s * 1e9).astype(np.int64)

    @property
    def accel_mps2(self) -> np.ndarray:
        return self.accel_g * STANDARD_GRAVITY

    @property
    def rate_rads(self) -> np.ndarray:
        return np.radians(self.rate_dps)

    def rows(self, kept: np.ndarray) -> Session:
        """Some of the rows."""
        return Session(
            self.t_s[kept], self.accel_g[:, kept], self.rate_dps[:, kept], self.inc_deg[kept], self.tf_deg[kept],
            self.temp_c[kept],
        )  # fmt: skip

    def scaled(self, *, accel: float = 1.0, rate: float = 1.0, time: float = 1.0) -> Session:
        """Other numbers under the same names: what a wrong unit looks like."""
        return replace(self, accel_g=accel * self.accel_g, rate_dps=rate * self.rate_dps, t_s=time * self.t_s)

    def turned(self, order: tuple[int, ...], signs: tuple[int, ...], *, rates: bool) -> Session:
        """Axes exchanged and turned, of the accelerations alone or of the rates with them."""
        sign = np.array(signs)[:, None]
        found = replace(self, accel_g=sign * self.accel_g[list(order)])
        return replace(found, rate_dps=sign * self.rate_dps[list(order)]) if rates else found


def session(n: int = 160, seed: int = 0) -> Session:
    """Inclination and toolface swing; the rates are the smallest that turn gravity so (du/dt = -w x u)."""
    rng = np.random.default_rng(seed)
    t = np.round(np.arange(n) / RATE_HZ, 6)
    inc, tf = np.radians(40 + 30 * np.sin(1.9 * t)), np.radians(50 + 40 * np.sin(1.7 * t + 1))
    u = np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
    d_inc, d_tf = np.radians(57 * np.cos(1.9 * t)), np.radians(68 * np.cos(1.7 * t + 1))
    along_inc = np.vstack([np.cos(inc) * np.cos(tf), np.cos(inc) * np.sin(tf), -np.sin(inc)])
    along_tf = np.vstack([-np.sin(inc) * np.sin(tf), np.sin(inc) * np.cos(tf), np.zeros(n)])
    w = np.degrees(np.cross(along_inc * d_inc + along_tf * d_tf, u, axis=0))
    accel = u + rng.normal(0, 3e-4, u.shape)
    temp = 25.0 + np.round(rng.normal(0, 0.1, n), 2)
    return Session(t, accel, w, np.degrees(inc), np.degrees(tf), temp)
