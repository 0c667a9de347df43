"""Thresholds of noise with memory, and of the filters that whiten it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class MemoryPolicy:
    """Serially correlated noise, and what is slow beside it."""

    found: float = 12.0
    """-2 log likelihood of a channel, gain from which memory is believed. Chosen in 1d73a30 after looking at the
    prototype's scored runs; no run that varied it is recorded."""
    in_use: float = 8.0
    """-2 log likelihood of a channel, gain from which judging uses memory. Source: studies.thresholds, 4 to 16."""
    slow_log_p: float = 2.8
    """-log10 p that a slow effect must reach beside a random walk. Source: parametric bootstrap of random walks, 7
    rates with 400 draws each on two channel patterns: the least favourable rate passes in 4.2 % [2.7, 6.7]; 2.5 would
    pass 7.5 %."""
    near_log_p: float = 1.0
    """-log10 p beside a random walk from which a slow effect resembles what was observed. Source: studies.thresholds,
    0.5 to 2."""
    remaining: float = 15.0
    """-2 log likelihood; a slow effect beside which more evidence of memory than this remains is not the whole story.
    Source: the bootstrap of `slow_log_p`. 6 was tried on strong effects: 17 of 30 steps and 23 of 30 warm-ups were
    left."""
    lengths: tuple[float, ...] = (1.5, 4.0, np.inf)
    """Poses; memories that are tried, infinite is the random walk. Source: a grid: a neighbour, a few poses, and
    all."""
    shares: Mapping[float, tuple[float, ...]] = field(
        default_factory=lambda: {
            1.5: (0.3, 1.0, 3.0, 10.0),
            4.0: (0.1, 0.4, 1.5, 6.0),
            np.inf: (3e-4, 1e-3, 4e-3, 0.015, 0.05, 0.2, 0.8),
        }
    )
    """By memory length, variances in units of the white variance of a pose (of a step, for the random walk). Source: a
    grid: each three to five times the one before, about twice in the scatter."""
    seeds: int = 4
    """Slow effects with each of which a second one is tried. Source: studies.thresholds, 2 to 8."""
    pair_log_p: float = 0.7
    """-log10 p; so much more is required of each of two: there are as many more ways for a random walk to look like
    them. Source: studies.thresholds, 0.35 to 0.85."""
    pair_score: float = 12.0
    """-2 log likelihood; two slow effects stand in place of one that is enough by itself where they gain so much more.
    Source: chi-square of two degrees of freedom, beyond 12 by chance in 0.25 %."""
    block_from: int = 32
    """Columns from which a filter goes block by block. Source: of 2,717 rows 16 take 0.3 ms so or as a system of bands,
    48 take 0.5 ms and 0.9 ms, and the matrices of the blocks 0.4 ms."""
    block_rows: int = 32
    """Rows of such a block. Source: the fastest of 8, 16, 32 and 64, for 48 columns and for 256."""


MEMORY = MemoryPolicy()
