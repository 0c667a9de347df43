"""The scatter of sensors and bench by maximum likelihood: Fisher scoring beside a general minimiser."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

from highside.arrays import Array
from highside.diagnosis.poses import noise
from highside.diagnosis.poses.policy import POSE_NOISE

Deviance = Callable[[Array], tuple[float, Array, Array]]


def drawn(seed: int) -> tuple[Array, Array]:
    """A residual (3, n) of poses with scatter of its own and of the set angles, and the tangents (3, 3, n)."""
    rng = np.random.default_rng(seed)
    n = int(rng.choice([12, 24, 60, 126]))
    gravity = rng.standard_normal((3, n))
    gravity /= np.linalg.norm(gravity, axis=0)
    toolface = np.cross(gravity.T, [0.0, 0.0, 1.0]).T
    across = toolface / np.linalg.norm(toolface, axis=0)
    tangents = np.stack([np.cross(gravity.T, across.T).T, toolface, across])
    sensor = 1e-4 * np.exp(rng.uniform(-1, 1, 3))
    angles = np.where(rng.random(3) < 0.4, 0.0, 1e-4 * np.exp(rng.uniform(-3, 2, 3)))
    bench = sum(size * rng.standard_normal(n) * tangent for size, tangent in zip(angles, tangents, strict=True))
    return sensor[:, None] * rng.standard_normal((3, n)) + bench, tangents


def test_scoring_climbs_as_high_as_a_general_minimiser(monkeypatch: pytest.MonkeyPatch) -> None:
    climbed = noise._scored
    compared: list[tuple[float, float]] = []

    def both(deviance: Deviance, start: Array, bounds: Array) -> tuple[Array, float]:
        logs, least = climbed(deviance, start, bounds)
        _, gradient, expected = deviance(logs)
        by_differences = [(deviance(logs + e)[0] - deviance(logs - e)[0]) / 2e-5 for e in 1e-5 * np.eye(logs.size)]
        np.testing.assert_allclose(gradient, by_differences, atol=2e-3 * max(1.0, np.abs(gradient).max()))
        assert np.linalg.eigvalsh(expected)[0] > -1e-9 * np.trace(expected)
        found = minimize(
            lambda x: deviance(x)[:2],
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[tuple(one) for one in bounds],
            options={"maxiter": 200, "ftol": 1e-12},
        )
        compared.append((least, float(found.fun)))
        return logs, least

    monkeypatch.setattr(noise, "_scored", both)
    for seed in range(60):
        noise._components(*drawn(seed), np.zeros(3))
    least, general = np.array(compared).T
    # a fifth of -2 log likelihood is nothing beside what a bench's scatter must gain to be believed
    assert np.max(least - general) < 0.2 < POSE_NOISE.table_gain / 10
