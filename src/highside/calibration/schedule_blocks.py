"""A schedule of affine corrections over blocks of readings in numpy, in pieces that stay in the cache."""

from __future__ import annotations

import math

import numpy as np

from highside.arrays import Array
from highside.calibration.inclination_windows import InclinationWindow
from highside.calibration.linear_correction import LinearCorrection

_PIECE = 32768
"""Readings that are blended at a time. Fewer fit the cache better, but make two threads wait for each other."""
_PRODUCT = 4096
"""Columns a matrix product: the BLAS library starts threads of its own for larger ones (12 rows), against ours."""


class AffineBlocks:
    """Corrects blocks of readings by a schedule of affine corrections; one of it a thread, for it keeps its arrays.

    A blend is taken as `base + sum w (part - base)`. The matrices of guide, base and differences are one product, made
    on the assumption that a piece needs the corrections that the one before it needed.
    """

    def __init__(
        self,
        a: Array,
        windows: tuple[InclinationWindow, ...],
        zones: tuple[LinearCorrection, ...],
        fallback: LinearCorrection | None,
        guide: LinearCorrection | None,
    ) -> None:
        self._a = a
        self._windows = windows
        self._parts = [affine_matrix(part) for part in zones]
        self._fallback = None if fallback is None else affine_matrix(fallback)
        self._guide = np.eye(3, 4) if guide is None else affine_matrix(guide)
        self._products = np.empty((12, _PIECE))
        self._key, self._w, self._work, self._total = np.empty((4, _PIECE))
        self._raw = np.ones((4, _PIECE))  # readings, and a row of ones that the offsets multiply
        self._held: tuple[int | None, tuple[int, ...]] | None = None
        self._stack = self._guide

    def fill(self, low: int, high: int, out: Array) -> None:
        """Corrected vectors of the readings `low` to `high` into `out` (3, high - low)."""
        for at in range(low, high, _PIECE):
            upto = min(at + _PIECE, high)
            self._fill(self._a[:, at:upto], out[:, at - low : upto - low])

    def _fill(self, readings: Array, out: Array) -> None:
        n = readings.shape[1]
        raw = self._raw[:, :n]
        raw[:3] = readings
        rows = self._products[: len(self._stack), :n]
        _affine(self._stack, raw, rows)
        key, w, work, total = self._key[:n], self._w[:n], self._work[:n], self._total[:n]
        keys_into(rows[:3], key, work)
        least, most = float(key.min()), float(key.max())
        if math.isnan(least):
            least, most = 0.0, 2.0
        active = tuple(k for k, window in enumerate(self._windows) if window.touches(least, most))
        one = len(active) == 1 and self._windows[active[0]].is_full(least, most)
        pair = len(active) == 2 and self._sum_to_one(active[0], least, most)
        if one or pair or (self._fallback is None and len(active) == 2):
            base, others = active[-1], active[:-1]
        elif self._fallback is not None and len(active) <= 2:
            base, others = None, active
        else:
            self._blend(active, raw, key, out)
            return
        if self._held != (base, others):
            self._prepare(base, others)
            rows = self._products[: len(self._stack), :n]
            _affine(self._stack, raw, rows)
        if not others:
            out[:] = rows[3:6]
            return
        for place, k in enumerate(others):
            self._windows[k].weights(key, w, work, (least, most))
            if base is not None and not pair:
                # two zones that share the weight, but do not sum to one
                np.add(self._windows[base].weights(key, total, work, (least, most)), w, out=total)
                np.divide(w, total, out=w)  # 0/0 is NaN: neither holds
            difference = rows[6 + 3 * place : 9 + 3 * place]
            np.multiply(difference, w, out=difference)
            np.add(difference, out if place else rows[3:6], out=out)

    def _prepare(self, base: int | None, others: tuple[int, ...]) -> None:
        """Stack guide, base (None: the fallback) and the differences of the others from it."""
        self._held = (base, others)
        matrix = self._fallback if base is None else self._parts[base]
        assert matrix is not None
        self._stack = np.vstack([self._guide, matrix, *(self._parts[k] - matrix for k in others)])

    def _blend(self, active: tuple[int, ...], raw: Array, key: Array, out: Array) -> None:
        """Any number of corrections; without a fallback the weights are made to sum to one."""
        n = raw.shape[1]
        g, w, work, total = self._products[:3, :n], self._w[:n], self._work[:n], self._total[:n]
        if self._fallback is not None:
            _affine(self._fallback, raw, out)
        else:
            out.fill(0.0)
            total.fill(0.0)
        for k in active:
            _affine(self._parts[k] if self._fallback is None else self._parts[k] - self._fallback, raw, g)
            self._windows[k].weights(key, w, work)
            np.multiply(g, w, out=g)
            np.add(out, g, out=out)
            if self._fallback is None:
                np.add(total, w, out=total)
        if self._fallback is None:
            np.divide(out, total, out=out)  # 0/0 is NaN: no correction holds

    def _sum_to_one(self, k: int, least: float, most: float) -> bool:
        """Whether in this range the weights of windows k and k + 1 sum to one."""
        if k + 1 >= len(self._windows):
            return False
        one, other = self._windows[k], self._windows[k + 1]
        meet = one.high == other.center and other.low == one.center and one.fall == other.rise
        return meet and least >= one.center and most <= other.center


def affine_matrix(part: LinearCorrection) -> Array:
    """C and -C b side by side, (3, 4)."""
    k = part.coefficients(None)
    return np.column_stack([np.array(k.c).reshape(3, 3), -np.array(k.o)])


def _affine(matrix: Array, raw: Array, out: Array) -> None:
    for at in range(0, raw.shape[1], _PRODUCT):
        np.matmul(matrix, raw[:, at : at + _PRODUCT], out=out[:, at : at + _PRODUCT])


def keys_into(g: Array, out: Array, work: Array) -> None:
    """`key_of` vectors (3, N) into `out` (N,)."""
    np.multiply(g[0], g[0], out=out)
    np.multiply(g[1], g[1], out=work)
    np.add(out, work, out=out)
    np.multiply(g[2], g[2], out=work)
    np.add(work, out, out=work)
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(out, work, out=out)
    if not g[2].min() >= 0.0:  # NaN too: one must not hide the others
        below = g[2] < 0.0
        out[below] = 2.0 - out[below]
