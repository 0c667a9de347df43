"""One pass over whitened rows: inner products of a design's functions, and what chance makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.policy import CHUNKS
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.gram import Gram, Space, accumulate, coordinates_and_lift
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.noise import windows as learned_from
from highside.diagnosis.rows.policy import ROW_PLACES
from highside.diagnosis.rows.segments import Segments


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
    rows = sum(part.stop - part.start for part, _ in parts)
    used = np.unique(np.concatenate([segments.flip[part] for part, _ in parts]))
    result = [np.zeros((used.size, m)) for m in design.sizes]
    seen = [np.zeros((m, m)) for m in design.sizes]
    for part, kept in parts:
        led = slice(max(0, part.start - noise.lead), part.stop)
        starts = np.concatenate([[0], np.flatnonzero(np.diff(segments.flip[part])) + 1])
        blocks = np.searchsorted(used, segments.flip[part][starts])
        for c, functions in enumerate(design.functions(led, residual)):
            white = noise.whiten(c, functions, part)
            left = white[-1] - explained[c] @ white[:-1]
            kept[c, : left.size] = left
            result[c][blocks] += np.add.reduceat(white[:-1] * left, starts, axis=1).T
            if rows < session.n:
                seen[c] += white[:-1] @ white[:-1].T
    if rows < session.n:
        share = rows / session.n
        made = zip(result, grams, seen, strict=True)
        result = [_of_all_rows(r, gram.total[:-1, :-1], own, share) for r, gram, own in made]
    # with what the projection took given back
    swell = [1 / max(1 - m / session.n, ROW_PLACES.least_left) for m in design.sizes]
    return [r * np.sqrt(s) for r, s in zip(result, swell, strict=True)], rest


def _of_all_rows(products: Array, whole: Array, seen: Array, share: float) -> Array:
    """(blocks, m) inner products of functions with noise, as large in all rows as functions are there: `whole` (m, m)
    are the functions' own inner products, `seen` (m, m) those in the rows, a `share` of all, of which `products` are.

    A function that acts where the noise was learned, a warm-up at the beginning, is no larger in all rows than there:
    by the share of the rows alone chance would grow in proportion to a recording, and hide what grows with it. What is
    hardly seen in these rows at all (a ramp between two windows) is given what white noise makes of it.
    """
    coordinates, lift = coordinates_and_lift(whole)
    amount, turned = np.linalg.eigh(lift.T @ seen @ lift)
    hardly = amount < ROW_PLACES.least_seen * share
    unit = products @ lift @ turned / np.sqrt(np.where(hardly, 1.0, amount))
    # drawn for the functions, not for axes between equals of which rounding chooses: one answer however rows are summed
    axes = coordinates / np.sqrt(np.maximum(np.diag(whole), 1e-300))[:, None]
    axes = axes / np.linalg.norm(axes, axis=0)
    drawn = np.random.default_rng(0).standard_normal((products.shape[0], len(whole)))
    unit[:, hardly] = drawn @ axes @ turned[:, hardly] / np.sqrt(products.shape[0])
    return np.asarray(unit @ (coordinates @ turned).T)
