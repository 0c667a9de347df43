"""The limit of theory in rotations: what whitens their noise agrees with its covariance written out."""

from __future__ import annotations

import numpy as np
import pytest

from studies.open_world import designs, limit, noises, whitening, world
from studies.open_world.noises import Noise

ROWS = 60


def turning(n: int, *, gyros: bool = False, gaps: bool = False) -> world.Session:
    """The first rows of a rotation, perhaps with some lost."""
    rng = np.random.default_rng(5)
    s = designs.rotation(rng, gyros=gyros)
    rows = np.flatnonzero(rng.random(s.n) < 0.6) if gaps else np.arange(s.n)
    return s.rows(np.isin(np.arange(s.n), rows[:n]))


def written_out(s: world.Session, noise: Noise) -> np.ndarray:
    """Covariance (C, n, C, n) of the readings' noise, from its description."""
    channels = len(noise.sigma)
    found = np.zeros((channels, s.n, channels, s.n))
    rows = np.arange(s.n)
    for c, sigma in enumerate(noise.sigma):
        block = np.diag(noises._white_variance(s, noise, c))
        if noise.kind == "heavy":
            block = block / 2.0  # of a Student t of 3 degrees: (3 + 1) / (3 + 3) of its scale, a third of its variance
        if noise.kind in ("coloured", "one_over_f", "walk"):
            block = block + sigma**2 * noises._slow(noise, s.t)
        found[c, :, c, :] = block
    if noise.kind == "jitter":
        up = world.loads(s)
        for a in range(3):
            for b in range(3):
                found[a, rows, b, rows] += noise.jitter**2 * (float(a == b) - up[a] * up[b])
    return found


@pytest.mark.parametrize("gyros", [False, True])
@pytest.mark.parametrize("kind", noises.KINDS)
def test_whitened_rows_of_a_rotation_agree_with_their_covariance(kind: str, gyros: bool) -> None:
    s = turning(ROWS, gyros=gyros, gaps=True)
    rng = np.random.default_rng(6)
    noise = noises.drawn(rng, s, kind)
    signal = rng.standard_normal((len(noise.sigma), s.n, 3)) * np.array(noise.sigma)[:, None, None]
    signal[1, :, 0] = 0.0
    flat = signal.reshape(-1, 3)
    true = flat.T @ np.linalg.solve(written_out(s, noise).reshape(len(flat), -1), flat)
    found = whitening.whitened(s, noise)(signal)
    np.testing.assert_allclose(found.T @ found, true, rtol=1e-8, atol=1e-8 * np.abs(true).max())


@pytest.mark.parametrize(("kind", "tolerance"), [("white", 1e-9), ("modulated", 1e-9), ("coloured", 0.03)])
def test_energy_in_whitened_rows_is_the_strength_of_the_deck(kind: str, tolerance: float) -> None:
    s = turning(1500)
    noise = noises.drawn(np.random.default_rng(7), s, kind)
    signal = 1e-4 * np.stack([np.sin(s.tf), np.cos(3 * s.tf), np.sin(s.t)])
    energy = float(np.sum(whitening.whitened(s, noise)(signal[:, :, None]) ** 2))
    assert energy == pytest.approx(noises.energy(s, noise, signal), rel=tolerance)


def test_columns_that_a_constant_angle_makes_twice_span_what_the_base_fit_takes_up() -> None:
    s = turning(200, gyros=True)
    noise = noises.drawn(np.random.default_rng(8), s, "white")
    white = whitening.whitened(s, noise)
    base = whitening.span(white(whitening.plain_columns(s)))
    assert base.shape[1] == 3 * (3 + 4)  # the load along z is constant, the rate is not
    signal = np.random.default_rng(9).standard_normal((6, s.n))
    left = white(signal[:, :, None])[:, 0]
    np.testing.assert_allclose(
        left - base @ (base.T @ left), white(world.off_base(s, signal)[:, :, None])[:, 0], atol=1e-6
    )


def test_a_triangle_keeps_every_inner_product() -> None:
    rng = np.random.default_rng(10)
    parts = [rng.standard_normal((2 * whitening.CHUNK + 5, p)) for p in (3, 1, 4)]
    whole = np.concatenate(parts, axis=1)
    factor = whitening.triangle(parts)
    assert factor.shape == (8, 8)
    np.testing.assert_allclose(factor.T @ factor, whole.T @ whole, atol=1e-8)


def test_what_theory_allows_of_a_rotation_lies_between_nothing_and_all() -> None:
    parts = limit.made("limit-test", "law/005", 5)
    assert parts.first.kind == "rotation"
    row = limit.limits(parts)
    assert len(row["form"]["gains"]) == len(parts.case.laws)
    assert row["smooth"]["closed"] - 0.05 < row["form"]["closed"] <= 1.0
