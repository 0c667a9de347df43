"""Filters of noise with memory: whatever way the columns go through them, they whiten its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.arrays import Array
from highside.diagnosis.core.filters import BlockFilter
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.laws.ladder import LadderNoise
from highside.diagnosis.laws.noise_policy import LAW_NOISE

ROWS = st.integers(1, 3 * MEMORY.block_rows + 5)
COLUMNS = st.sampled_from([0, 1, LAW_NOISE.ladder_by_bands, LAW_NOISE.ladder_by_bands + 1, MEMORY.block_from, 70])


def drawn(rows: int, seed: int) -> tuple[np.random.Generator, Array, Array]:
    """A source of numbers, variances and times of rows."""
    rng = np.random.default_rng(seed)
    return rng, rng.uniform(0.5, 2.0, rows), np.cumsum(rng.uniform(0.5, 2.0, rows))


def covariance(white: Array, t_s: Array, share: float, length: float) -> Array:
    """(n, n) of a level that forgets, or of a random walk, beside white noise."""
    apart = np.abs(t_s[:, None] - t_s)
    level = np.minimum.outer(t_s, t_s) - t_s[0] if np.isinf(length) else np.exp(-apart / length)
    return np.asarray(np.diag(white) + share * level)


@settings(max_examples=60, deadline=None)
@given(ROWS, COLUMNS, st.sampled_from([0.3, 20.0, np.inf]), st.integers(0, 10**6))
def test_a_level_is_whitened_and_solved_for(rows: int, columns: int, length: float, seed: int) -> None:
    rng, white, t = drawn(rows, seed)
    shares, lengths = np.array([1.0, 0.01]), np.array([length, 3.0])
    noise = LevelNoise.of(white, t, shares, lengths)
    drawn_columns = rng.normal(size=(columns, rows))
    innovations = noise.white(drawn_columns)
    solved = noise.transposed(innovations)
    for s, (share, own) in enumerate(zip(shares, lengths, strict=True)):
        inverse = np.linalg.inv(covariance(white, t, float(share), float(own)))
        inner = drawn_columns @ inverse @ drawn_columns.T
        np.testing.assert_allclose(innovations[s] @ innovations[s].T, inner, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(solved[s], drawn_columns @ inverse, rtol=1e-8, atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(ROWS, COLUMNS, st.floats(1e-3, 1e3), st.integers(0, 10**6))
def test_a_ladder_is_whitened_and_solved_for(rows: int, columns: int, share: float, seed: int) -> None:
    rng, white, t = drawn(rows, seed)
    lengths = np.array([1.0, 10.0, 200.0])
    noise = LadderNoise.of(white, t, share, lengths)
    own = np.diag(white) + sum(share * (covariance(0 * white, t, 1.0, float(one))) for one in lengths)
    inverse = np.linalg.inv(own)
    drawn_columns = rng.normal(size=(columns, rows))
    innovations = noise.white(drawn_columns)
    scale = 1e-7 * (1.0 + share)
    np.testing.assert_allclose(
        innovations[0] @ innovations[0].T, drawn_columns @ inverse @ drawn_columns.T, rtol=1e-6, atol=scale
    )
    np.testing.assert_allclose(noise.transposed(innovations)[0], drawn_columns @ inverse, rtol=1e-6, atol=scale)


@pytest.mark.parametrize("rows", [1, MEMORY.block_rows, 2 * MEMORY.block_rows + 7])
def test_blocks_do_what_bands_do_into_every_third_row(rows: int) -> None:
    """Columns of one channel among others, as a search keeps them."""
    rng, white, t = drawn(rows, 5)
    noise = LevelNoise.of(white, t, np.array([2.0]), np.array([15.0]))
    columns = rng.normal(size=(9, 3, rows))
    out = np.zeros(columns.shape)
    BlockFilter.of(noise.gain.T, noise.decay.T, noise.variance[0]).white_into(columns[:, 1], out[:, 1])
    np.testing.assert_allclose(out[:, 1], noise.white(columns[:, 1])[0], rtol=1e-12, atol=1e-13)
    assert not out[:, ::2].any()
