"""Priors of smooth functions, and the one beside which a group of them is likeliest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.noise import cholesky_and_half
from highside.diagnosis.laws.noise_policy import LAW_NOISE
from highside.diagnosis.laws.policy import LAW_EVIDENCE


@dataclass(frozen=True)
class Prior:
    """Variance `size` (1 + (k / length)^2)^-power of a coefficient of order k."""

    size: float
    length: float

    def variances(self, orders: Array) -> Array:
        """(m,)."""
        return np.asarray(self.size * falls(orders, self.length))


def falls(orders: Array, length: float | Array) -> Array:
    """How the prior falls with the order, beside its size."""
    return np.asarray((1.0 + (orders / length) ** 2) ** -LAW_EVIDENCE.power)


def shown_of(before: Array, gram: Array, drive: Array) -> tuple[Array, Array]:
    """What the terms leave of the groups, without the functions they take whole: what is left of those is rounding, and
    may be negative."""
    power = np.diagonal(gram, axis1=1, axis2=2)
    shown = power > LAW_EVIDENCE.ridge * np.diagonal(before, axis1=1, axis2=2)
    if shown.all():
        return gram, drive
    return gram * (shown[:, :, None] & shown[:, None, :]), drive * shown


def bound_of(gram: Array, drive: Array) -> Array:
    """(G,) nats that a best fit without any prior gains."""
    power = np.diagonal(gram, axis1=1, axis2=2)
    # what is free anyway leaves nothing of some functions
    most = np.maximum(power.max(axis=1, keepdims=True), LAW_EVIDENCE.nothing)
    size = np.sqrt(np.maximum(power, LAW_EVIDENCE.ridge * most))
    unit = gram / size[:, :, None] / size[:, None, :] + LAW_EVIDENCE.ridge * np.eye(gram.shape[1])
    along = drive / size
    return _explained(unit, along)


def _explained(unit: Array, along: Array) -> Array:
    """(G,) half of along' unit^-1 along. A difference of large numbers leaves values below zero by rounding: of those
    that are not positive, found by halves, these are taken for the ridge."""
    try:
        return np.asarray(0.5 * np.sum(cholesky_and_half(unit, along)[1] ** 2, axis=1))
    except np.linalg.LinAlgError:
        half = len(unit) // 2
        if half >= LAW_EVIDENCE.halved:
            return np.concatenate([_explained(unit[:half], along[:half]), _explained(unit[half:], along[half:])])
        values, vectors = np.linalg.eigh(unit)
        turned = np.einsum("gkv,gk->gv", vectors, along)
        return np.asarray(0.5 * np.sum(turned**2 / np.maximum(values, LAW_EVIDENCE.ridge), axis=1))


def best_priors(gram: Array, drive: Array, orders: Array, near: Array | float = -np.inf) -> tuple[Array, Array, Array]:
    """Gain (G,), size and length of the best prior, from inner products (G, m, m) and (G, m) and orders (G, m).

    Gain -inf: with one length of the prior the group stays so far behind `near` (G,) that none brings it there.
    """
    if len(gram) and orders.any() and np.any(np.isfinite(near)):
        gain, size, length = _at_lengths(gram, drive, orders, (LAW_EVIDENCE.rough,))
        gain = np.where(gain >= near - LAW_EVIDENCE.slack, gain, -np.inf)
        worth = np.flatnonzero(np.isfinite(gain))
        if worth.size:
            others = tuple(one for one in LAW_EVIDENCE.lengths if one != LAW_EVIDENCE.rough)
            more = _at_lengths(gram[worth], drive[worth], orders[worth], others)
            better = more[0] > gain[worth]
            for whole, own in zip((gain, size, length), more, strict=True):
                whole[worth[better]] = own[better]
        return gain, size, length
    return _at_lengths(gram, drive, orders, LAW_EVIDENCE.lengths if orders.any() else LAW_EVIDENCE.lengths[:1])


def _at_lengths(gram: Array, drive: Array, orders: Array, lengths: Sequence[float]) -> tuple[Array, Array, Array]:
    sizes, m = np.array(LAW_EVIDENCE.sizes), gram.shape[1]
    # of few groups all lengths at once: of single ones the calls take the time
    at_once = len(lengths) if gram.size * len(lengths) <= LAW_NOISE.matrices else 1
    best = np.full(len(gram), -np.inf)
    best_size, best_length = np.ones(len(gram)), np.ones(len(gram))
    for start in range(0, len(lengths), at_once):
        tried = np.array(lengths[start : start + at_once])
        fall = np.sqrt(falls(orders, tried[:, None, None])).reshape(-1, m)
        turned = (gram * fall.reshape(-1, *gram.shape[:2])[..., None]).reshape(-1, m, m) * fall[:, None, :]
        values, vectors = np.linalg.eigh(turned)
        values = np.maximum(values, 0.0)
        along = (drive * fall.reshape(-1, *drive.shape)).reshape(-1, m)
        power = np.matmul(along[:, None], vectors)[:, 0] ** 2
        # sizes are tried in units of what the noise lets the best seen combination be known by
        unit = 1.0 / np.maximum(values[:, -1], LAW_EVIDENCE.nothing)
        s = unit[:, None] * sizes
        spread = 1.0 + s[:, :, None] * values[:, None, :]
        gain = 0.5 * (s * np.matmul(1.0 / spread, power[:, :, None])[:, :, 0] - np.log(spread).sum(axis=2))
        where = np.argmax(gain, axis=1)[:, None]
        found = np.take_along_axis(gain, where, axis=1).reshape(tried.size, -1)
        size = np.take_along_axis(s, where, axis=1).reshape(tried.size, -1)
        for own, own_size, length in zip(found, size, tried, strict=True):
            better = own > best
            best = np.where(better, own, best)
            best_size = np.where(better, own_size, best_size)
            best_length = np.where(better, length, best_length)
    return best, best_size, best_length
