"""Two poses whose set angles were exchanged in what was written down: each reads as the other should.

A law that reproduces such a pair is found easily, and is none. So every pair is tried: with the readings of the two
exchanged and the base fitted again, what is left must fall by far more than chance, and the two be as near to the model
as the others are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import EXCHANGED
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.observed import Observed
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

Pair = tuple[int, int]


def exchanged_pairs(
    state: ChainState, mean: Array, model: ForwardModel, free: Sequence[str]
) -> list[tuple[Pair, float, float]]:
    """Pairs of n poses whose readings `mean` (3, n) fit when they are exchanged, and the rms in g that is left before
    and after; none where poses are few, or more than a few pairs would be exchanged."""
    found: list[tuple[Pair, float, float]] = []
    if state.n < EXCHANGED.least:
        return found
    left = _left(state, mean, model, free)
    for _ in range(EXCHANGED.most + 1):
        best = min(
            ((pair, _left(state, _with_exchanged(mean, pair), model, free)) for pair in _nearest(mean, left)),
            key=lambda one: float(np.sum(one[1] ** 2)),
            default=None,
        )
        if best is None or not _fits(left, *best, len(free)):
            break
        pair, after = best
        found.append((pair, float(np.sqrt(np.mean(left**2))), float(np.sqrt(np.mean(after**2)))))
        mean, left = _with_exchanged(mean, pair), after
    return found if len(found) <= EXCHANGED.most else []


def _left(state: ChainState, mean: Array, model: ForwardModel, free: Sequence[str]) -> Array:
    """(3, n) what the base effects leave of the readings."""
    return base_fit(model, Observed(state, mean), free)[1]


def _with_exchanged(mean: Array, pair: Pair) -> Array:
    order = np.arange(mean.shape[1])
    order[list(pair)] = pair[::-1]
    return mean[:, order]


def _nearest(mean: Array, left: Array) -> list[Pair]:
    """The pairs that reduce a misfit (3, n) most when the readings of the two are exchanged, the model kept."""
    expected = mean - left
    own = np.sum(left**2, axis=0)
    other = np.sum((mean[:, :, None] - expected[:, None]) ** 2, axis=0)
    gain = np.triu(own[:, None] + own[None] - other - other.T, 1)
    order = np.argsort(-gain, axis=None)[: EXCHANGED.tried]
    pairs = [divmod(int(k), own.size) for k in order if gain.flat[k] > 0.0]
    return [(int(i), int(j)) for i, j in pairs]


def _fits(before: Array, pair: Pair, after: Array, free: int) -> bool:
    """Whether what is left falls by more than chance when a pair is exchanged, and the pair is like the others then."""
    n = before.shape[1]
    squares = [float(np.sum(one**2)) for one in (before, after)]
    nats = 0.5 * (before.size - free) * float(np.log(squares[0] / max(squares[1], 1e-300)))
    of_pose = np.sum(after**2, axis=0)
    typical = float(np.median(of_pose))
    alike = bool(np.all(of_pose[list(pair)] < EXCHANGED.like_others**2 * max(typical, 1e-300)))
    chance = EXCHANGED.gain + float(np.log(n * (n - 1) / 2))
    return alike and nats > chance and squares[0] > EXCHANGED.falls**2 * squares[1]
