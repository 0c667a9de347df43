"""Random walks of the offsets, observed through the magnitude of gravity in changing attitudes.

A random walk of the three offsets, each by itself with variance q a step, adds to the magnitude at times t_i, t_j with
gravity along u_i, u_j the covariance q min(t_i, t_j) (u_i . u_j): turned over, the tool shows the same offset with the
other sign. Readings are few, so the covariance matrices are taken as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.memory import Likelihoods, intervals
from highside.diagnosis.magnitude.policy import PROJECTED_RANDOM_WALK


@dataclass(frozen=True)
class ProjectedRandomWalkNoise:
    """Whitening of n readings under S random walks: `roots` (S, n, n), the inverse of the Cholesky factors."""

    roots: Array

    @classmethod
    def of(cls, variance: Array, direction: Array, t_s: Array, shares: Array) -> ProjectedRandomWalkNoise:
        """`variance` (n,) of the white part, `direction` (3, n) of gravity, `shares` (S,) of its mean."""
        t = intervals(t_s) + 1.0
        random_walk = np.minimum.outer(t, t) * (direction.T @ direction)
        covariance = np.diag(variance) + shares[:, None, None] * float(variance.mean()) * random_walk
        return cls(np.asarray(np.linalg.inv(np.linalg.cholesky(covariance))))

    @property
    def log_determinant(self) -> Array:
        """(S,) logarithm of the determinant of the covariance."""
        return np.asarray(-2 * np.log(np.diagonal(self.roots, axis1=1, axis2=2)).sum(axis=1))

    def white(self, columns: Array) -> Array:
        """(S, K, n) independent unit innovations of columns (K, n)."""
        return np.asarray(np.einsum("sij,kj->ski", self.roots, columns))


class ProjectedRandomWalkLikelihoods(Likelihoods):
    """As `Likelihoods`, of magnitudes with gravity along `direction` (3, n), under random walks alone."""

    def __init__(self, residual: Array, variance: Array, nuisance: Array, t_s: Array, direction: Array) -> None:
        self.settings = [(np.inf if share else 1.0, share) for share in PROJECTED_RANDOM_WALK.shares]
        self._prepare(
            residual,
            ProjectedRandomWalkNoise.of(variance, direction, t_s, np.array(PROJECTED_RANDOM_WALK.shares)),
            nuisance,
        )
