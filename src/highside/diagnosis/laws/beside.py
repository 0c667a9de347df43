"""Functions fitted beside columns that stay: what does not depend on the functions is computed once.

Inner products are taken fold by fold. Those of all values but a fold are the sum of all less that fold's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.policy import LAW_REPORT


@dataclass(frozen=True)
class _Normal:
    """Normal equations of the columns with their prior: `gram` and its inverse (K, K), the drive and the means (K,)."""

    gram: Array
    drive: Array
    inverse: Array
    mean: Array

    @classmethod
    def of(cls, gram: Array, drive: Array, prior: Array) -> _Normal:
        gram = gram + np.diag(prior)
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inverse = np.linalg.inv(gram / size[:, None] / size[None] + LAW_REPORT.ridge * np.eye(size.size))
        inverse = inverse / size[:, None] / size[None]
        return cls(gram, drive, inverse, inverse @ drive)

    def fitted(self, gram: Array, across: Array, drive: Array) -> tuple[Array, Array, Array]:
        """Gains (B,), means of the columns (B, K) and of B sets of functions (B, w), from the functions' inner products
        (B, w, w), with the columns (B, w, K) and with the residual (B, w)."""
        count, width = drive.shape
        if not width:
            return np.zeros(count), np.repeat(self.mean[None], count, axis=0), np.zeros((count, 0))
        left = gram - across @ self.inverse @ across.transpose(0, 2, 1)
        level = np.einsum("bii->b", left) / width
        left = left + LAW_REPORT.ridge * np.maximum(level, 1e-300)[:, None, None] * np.eye(width)
        along = drive - across @ self.mean
        try:
            own = np.linalg.solve(left, along[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            # of functions that the columns hold already nothing is left
            own = (np.linalg.pinv(left, hermitian=True) @ along[:, :, None])[:, :, 0]
        # what the columns give up to the sets
        given = np.einsum("bw,bwk->bk", own, across @ self.inverse)
        return 0.5 * np.sum(own * along, axis=1), self.mean - given, own


class Beside:
    """Columns (K, C, n) with prior precisions (K,), beside which functions are fitted to a residual (C, n), all
    whitened."""

    def __init__(self, columns: Array, prior: Array, residual: Array) -> None:
        self._flat, self._residual = flattened(columns), residual
        fold = np.arange(residual.shape[1]) % LAW_REPORT.folds
        self._folds = [np.flatnonzero(fold == number) for number in range(LAW_REPORT.folds)]
        self._parts = [flattened(columns[:, :, out]) for out in self._folds]
        targets = [residual[:, out].reshape(-1) for out in self._folds]
        grams = [part @ part.T for part in self._parts]
        drives = [part @ target for part, target in zip(self._parts, targets, strict=True)]
        gram, drive = np.sum(grams, axis=0), np.sum(drives, axis=0)
        self._whole = _Normal.of(gram, drive, prior)
        self._without = [_Normal.of(gram - g, drive - d, prior) for g, d in zip(grams, drives, strict=True)]

    def fitted(self, own: Array) -> tuple[Array, Array, Array]:
        """Gains (B,), coefficients of the columns (B, K) and of sets of functions `own` (B, w, C, n), fitted
        together."""
        sets = own.reshape(*own.shape[:2], -1)
        return self._whole.fitted(
            sets @ sets.transpose(0, 2, 1), sets @ self._flat.T, sets @ self._residual.reshape(-1)
        )

    def sizes(self, own: Array) -> tuple[Array, Array]:
        """(w,) of functions (w, C, n), fitted without a prior, and their covariance (w, w)."""
        flat, width = flattened(own), len(own)
        across = self._whole.gram.shape[0]
        gram = np.empty((across + width, across + width))
        gram[:across, :across] = self._whole.gram
        gram[across:, :across] = flat @ self._flat.T
        gram[:across, across:] = gram[across:, :across].T
        gram[across:, across:] = flat @ flat.T
        unit = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inverse = np.linalg.pinv(gram / unit[:, None] / unit[None], hermitian=True) / unit[:, None] / unit[None]
        mean = inverse @ np.concatenate([self._whole.drive, flat @ self._residual.reshape(-1)])
        return mean[across:], inverse[across:, across:]

    def loss(self, own: Array) -> float:
        """Square of the errors on values left out, fold by fold, fitted by the columns and the functions (w, C, n)."""
        across = [flattened(own[:, :, out]) @ part.T for out, part in zip(self._folds, self._parts, strict=True)]
        beside, every, total = np.sum(across, axis=0), np.arange(self._residual.shape[1]), 0.0
        for out, part, gone, normal in zip(self._folds, self._parts, across, self._without, strict=True):
            kept = np.delete(every, out)
            seen, target = flattened(own[:, :, kept]), self._residual[:, kept].reshape(-1)
            # of a function that is zero at all that is kept rounding alone is left of the difference
            left = (beside - gone) * np.any(seen, axis=1)[:, None]
            _, (columns,), (sizes,) = normal.fitted((seen @ seen.T)[None], left[None], (seen @ target)[None])
            predicted = columns @ part + sizes @ flattened(own[:, :, out])
            total += float(np.sum((self._residual[:, out].reshape(-1) - predicted) ** 2))
        return total
