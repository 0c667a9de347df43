"""One pass over whitened rows: inner products of a design's functions, and what chance makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.policy import CHUNKS
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.gram import Gram, Segments, Space, accumulate
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.noise import windows as learned_from
from highside.diagnosis.rows.policy import ROW_PLACES


@dataclass(frozen=True)
class InnerProducts:
    """What one pass over whitened rows leaves of them."""

    grams: list[Gram]
    segments: Segments
    chance: list[Array]
    """(flip blocks, m) on each channel: inner products of the functions with what is left of everything, by blocks"""
    rest: list[tuple[slice, Array]]
    """what is left of everything, whitened, (C, n) of the rows that the noise was learned from"""

    @classmethod
    def of(cls, design: Design, noise: RotationNoise, residual: Array) -> InnerProducts:
        """Of a design's functions and a residual (C, n) after the base fit, under a noise."""
        grams, segments = accumulate(design, noise, residual)
        return cls(grams, segments, *_chance(design, noise, residual, grams, segments))


def _chance(
    design: Design, noise: RotationNoise, residual: Array, grams: Sequence[Gram], segments: Segments
) -> tuple[list[Array], list[tuple[slice, Array]]]:
    """(flip blocks, m) on each channel: inner products of functions with the residual of everything, block by block;
    and that residual itself.

    Of long recordings the windows that the noise was learned from stand for the rest.
    """
    session = design.session
    explained = [Space.of_channel(gram.total) for gram in grams]
    rest = [(window, np.zeros((len(grams), window.stop - window.start))) for window in learned_from(session.n)]
    parts = [
        (slice(start, min(start + CHUNKS.rows, window.stop)), left[:, start - window.start :])
        for window, left in rest
        for start in range(window.start, window.stop, CHUNKS.rows)
    ]
    used = np.unique(np.concatenate([segments.flip[part] for part, _ in parts]))
    result = [np.zeros((used.size, m)) for m in design.sizes]
    for part, kept in parts:
        led = slice(max(0, part.start - noise.lead), part.stop)
        starts = np.concatenate([[0], np.flatnonzero(np.diff(segments.flip[part])) + 1])
        blocks = np.searchsorted(used, segments.flip[part][starts])
        for c, functions in enumerate(design.functions(led, residual)):
            white = noise.whiten(c, functions, part)
            left = white[-1] - explained[c] @ white[:-1]
            kept[c, : left.size] = left
            result[c][blocks] += np.add.reduceat(white[:-1] * left, starts, axis=1).T
    rows = sum(part.stop - part.start for part, _ in parts)
    # to the size it has in all rows, and with what the projection took given back
    swell = [session.n / rows / max(1 - m / session.n, ROW_PLACES.least_left) for m in design.sizes]
    return [r * np.sqrt(s) for r, s in zip(result, swell, strict=True)], rest
