"""The circle that a turning tool draws: sums over single revolutions, and the fit of its centre.

About a provisional centre c, with u the unit vector from c to a reading and rho its distance, to first order

    rho = R + R' t + u . d + noise,        d = (true centre) - c.

A drift R' of the inclination must be estimated with it, or a part of it would pass for an offset. This is linear in
(R, dx, dy, R'), so that the sums of products of (1, ux, uy, t, rho, gz) over a revolution are sufficient statistics:
memory is one 6 x 6 matrix a revolution, and sums taken about an old centre are moved to a new one. For N readings of
noise s over full turns the centre has the covariance `2 s^2 / N` in each axis. The radial noise is taken from the fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array

SECTORS = 12
"""Parts of a turn that must each hold their share of the readings."""
INCONSISTENT_SIGMAS = 3.7
"""Departure of single revolutions from the common circle that is no chance (once in ten thousand)."""
MIN_NOISE_G = 1e-6
"""Below this a scatter is rounding, not noise."""
TURN = 2.0 * math.pi


@dataclass(slots=True)
class Revolution:
    """One turn in progress or complete: sums of products of v = (1, ux, uy, t - t0, rho, gz)."""

    t0: float
    centre: tuple[float, float]
    sums: list[float]
    counts: list[int]
    angle: float = 0.0
    """unwrapped angle since its beginning"""
    end_s: float = 0.0
    shocks: int = 0
    outward: int = 0
    """shocks outside of the circle less those inside: a drifting radius has them all on one side"""
    frames: int = 0

    @classmethod
    def begin(cls, t_s: float, centre: tuple[float, float], angle: float = 0.0) -> Revolution:
        return cls(t_s, centre, [0.0] * 21, [0] * SECTORS, angle, end_s=t_s)

    def add(self, t_s: float, ux: float, uy: float, rho: float, gz: float, angle: float) -> None:
        """Add a reading: unit vector (ux, uy) and distance from the centre, axial component, and its angle."""
        t = t_s - self.t0
        s = self.sums
        s[0] += 1.0
        s[1] += ux
        s[2] += uy
        s[3] += t
        s[4] += rho
        s[5] += gz
        s[6] += ux * ux
        s[7] += ux * uy
        s[8] += ux * t
        s[9] += ux * rho
        s[10] += ux * gz
        s[11] += uy * uy
        s[12] += uy * t
        s[13] += uy * rho
        s[14] += uy * gz
        s[15] += t * t
        s[16] += t * rho
        s[17] += t * gz
        s[18] += rho * rho
        s[19] += rho * gz
        s[20] += gz * gz
        self.counts[int((angle + math.pi) / TURN * SECTORS) % SECTORS] += 1

    def moments(self, t_ref: float, centre: tuple[float, float]) -> Array:
        """The 6 x 6 sums about another time and another provisional centre."""
        M = np.zeros((6, 6))
        M[np.triu_indices(6)] = self.sums
        M = M + np.triu(M, 1).T
        L = np.eye(6)
        L[3, 0] = self.t0 - t_ref
        # rho about the new centre is smaller by u . (new - old)
        L[4, 1], L[4, 2] = self.centre[0] - centre[0], self.centre[1] - centre[1]
        return np.asarray(L @ M @ L.T)


@dataclass(frozen=True, slots=True)
class CircleFit:
    """Circle over some revolutions: `theta` = (R, dx, dy, R'), covariance, and what the acceptance tests need."""

    theta: Array
    covariance: Array
    noise_g: float
    gz: float
    drift_deg: float
    drift_std_deg: float
    consistency: float
    rate_rpm: float


def fit_circle(revolutions: Sequence[Revolution], centre: tuple[float, float]) -> CircleFit:
    """The circle about which the revolutions lie, linearised about `centre` (g)."""
    t_ref = revolutions[0].t0
    parts = [r.moments(t_ref, centre) for r in revolutions]
    M = np.sum(parts, axis=0)
    n = M[0, 0]
    normal = M[:4, :4]
    inverse = np.linalg.inv(normal)
    theta = inverse @ M[:4, 4]
    axial = inverse @ M[:4, 5]
    dof = max(n - 4.0, 1.0)
    variance = max(float(M[4, 4] - theta @ M[:4, 4]) / dof, MIN_NOISE_G**2)
    axial_variance = max(float(M[5, 5] - axial @ M[:4, 5]), 0.0) / dof
    radius, gz = float(theta[0]), float(axial[0])
    size = math.hypot(radius, gz)
    cos_i, sin_i = gz / size, radius / size
    span = revolutions[-1].end_s - t_ref
    drift = (theta[3] * cos_i - axial[3] * sin_i) * span
    drift_variance = inverse[3, 3] * (variance * cos_i**2 + axial_variance * sin_i**2) * span**2
    turned = sum(abs(r.angle) for r in revolutions)
    return CircleFit(
        theta=theta,
        covariance=inverse * variance,
        noise_g=math.sqrt(variance),
        gz=gz,
        drift_deg=math.degrees(float(drift)),
        drift_std_deg=math.degrees(math.sqrt(max(float(drift_variance), 0.0))),
        consistency=_consistency(parts, theta, variance),
        rate_rpm=60.0 * turned / TURN / max(sum(r.end_s - r.t0 for r in revolutions), 1e-9),
    )


def _consistency(parts: Sequence[Array], theta: Array, variance: float) -> float:
    """How far the revolutions depart from the common circle: chi squared a degree of freedom (1 by noise alone).

    Each revolution gets its own radius and centre, (1, ux, uy), from the residuals of the common fit.
    """
    if len(parts) < 2 or variance <= 0.0:
        return 1.0
    chi2 = 0.0
    for M in parts:
        left = M[:3, 4] - M[:3, :4] @ theta
        chi2 += float(left @ np.linalg.solve(M[:3, :3], left)) / variance
    return chi2 / degrees_of_freedom(len(parts))


def degrees_of_freedom(turns: int) -> float:
    """Three numbers of each revolution, less the four of the common fit."""
    return 3.0 * turns - 4.0


def chance_limit(dof: float) -> float:
    """Chi squared a degree of freedom that chance exceeds once in ten thousand (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * dof)
    return (1.0 - part + INCONSISTENT_SIGMAS * math.sqrt(part)) ** 3
