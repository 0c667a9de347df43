"""What sparse regressions of well-kept libraries name, given the engine's own columns and noise.

The candidates are the columns of the effects of the library (each shape a column of its own), the target is what the
base fit leaves; base directions are taken off both, rows are divided by the noise of their channel, columns have unit
length. An effect is named where any of its columns has a coefficient. Both are told which rows belong together: their
folds are the engine's contiguous blocks.

* `LassoCV` (scikit-learn): at the penalty with the least error on held-out blocks, and at the largest penalty within
  one standard error of it, which is sparser.
* `STLSQ` (pysindy): sequentially thresholded ridge regression, its threshold chosen in the same two ways.
"""

from __future__ import annotations

import tomllib
import warnings

import numpy as np

from highside.config.model import Model
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.held_out import pose_folds
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.poses.problem import PoseProblem
from highside.diagnosis.poses.session import pose_session
from highside.diagnosis.rotation.problem import RotationProblem
from highside.diagnosis.rows.session import rotation_session

from . import deck

PENALTIES = 40
THRESHOLDS = np.geomspace(0.03, 1.0, 14)
"""of the largest coefficient of a plain ridge regression"""
RIDGE = 1e-3
FOLDS = 5


def names_of(case: deck.Case) -> dict[str, list[str]]:
    """The effects that each way of regression names, by the way's name."""
    columns, owner, target, folds = _problem(case)
    kept = np.linalg.norm(columns, axis=1) > 1e-9
    columns, owner = columns[kept], owner[kept]
    x = (columns / np.linalg.norm(columns, axis=1, keepdims=True)).T
    found = {**_lasso(x, target, folds), **_stlsq(x, target, folds)}
    return {way: sorted({str(owner[k]) for k in np.flatnonzero(weights)}) for way, weights in found.items()}


def _problem(case: deck.Case) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Columns (P, N) of the candidates, the effect of each (P,), the target (N,), and the folds."""
    knows = Model.model_validate(tomllib.loads(case.model))
    accel = np.stack([case.columns[f"a{axis}_g"] for axis in "xyz"])
    site = knows.site.site
    place = {"gravity_mps2": site.gravity_mps2, "latitude_rad": site.latitude_rad, "azimuth_rad": site.azimuth_rad}
    free = tuple(knows.sensor.free)
    if case.design == "poses":
        session = pose_session(case.columns, accel, **place)
        problem = PoseProblem.of(session, knows.forward(), free, 1)
        sigma = problem.noise.sigma[:, None]
        n = session.n
        base, target = (problem.base / sigma).reshape(-1, 3 * n), (problem.residual / sigma).reshape(-1)
        owner, parts = [], []
        for candidate, variant in _whole(problem.candidates):
            parts.append((variant / sigma).reshape(-1, 3 * n))
            owner += [candidate] * len(variant)
        every, folds = np.concatenate(parts), pose_folds(n, FOLDS)
    else:
        gyro = None
        if "gx_dps" in case.columns:
            gyro = np.radians(np.stack([case.columns[f"g{axis}_dps"] for axis in "xyz"]))
        turning = rotation_session(case.columns, accel, gyro, **place)
        problem_r = RotationProblem.of(turning, knows.forward(), free, 1)
        channels = len(turning.channels)
        functions = problem_r.design.functions(slice(0, turning.n), problem_r.residual)
        level = problem_r.residual.std(axis=1)

        def made(numbers: np.ndarray) -> np.ndarray:
            out = np.zeros((numbers.size, channels, turning.n))
            for k, number in enumerate(numbers):
                for c, place_of in enumerate(problem_r.design.where[number] if number >= 0 else ()):
                    if place_of >= 0:
                        out[k, c] = functions[c][place_of] / level[c]
            return out.reshape(numbers.size, -1)

        base = made(np.asarray(problem_r.design.base))
        target = np.concatenate([functions[c][-1] / level[c] for c in range(channels)])
        owner, parts = [], []
        for candidate, numbers in _whole(problem_r.candidates):
            parts.append(made(np.asarray(numbers, dtype=np.intp)))
            owner += [candidate] * len(numbers)
        every = np.concatenate(parts)
        blocks = np.array_split(np.arange(turning.n), FOLDS)
        folds = [np.concatenate([b + c * turning.n for c in range(channels)]) for b in blocks]
    space = span(base)
    return outside(space, every), np.array(owner), outside(space, target), folds


def _whole(candidates: list[Candidate]) -> list[tuple[str, np.ndarray]]:
    return [(c.id, v.columns) for c in candidates if c.named for v in c.variants if v.whole]


def _split(folds: list[np.ndarray], n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(np.setdiff1d(np.arange(n), fold), fold) for fold in folds]


def _simplest(errors: np.ndarray) -> tuple[int, int]:
    """Errors (choices, folds), the sparsest choice first: the best one, and the sparsest within a standard error."""
    mean = errors.mean(axis=1)
    best = int(np.argmin(mean))
    limit = mean[best] + errors[best].std(ddof=1) / np.sqrt(errors.shape[1])
    return best, int(np.flatnonzero(mean <= limit)[0])


def _lasso(x: np.ndarray, y: np.ndarray, folds: list[np.ndarray]) -> dict[str, np.ndarray]:
    from sklearn.linear_model import Lasso, LassoCV

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of slow convergence at the smallest penalties, which are not chosen
        search = LassoCV(
            alphas=PENALTIES, cv=_split(folds, y.size), fit_intercept=False, max_iter=3000, eps=1e-2, precompute=True
        )
        search.fit(x, y)
        _, sparse = _simplest(search.mse_path_)
        sparser = Lasso(alpha=float(search.alphas_[sparse]), fit_intercept=False, max_iter=3000, precompute=True).fit(
            x, y
        )
    return {"LassoCV": search.coef_, "LassoCV, one standard error": sparser.coef_}


def _stlsq(x: np.ndarray, y: np.ndarray, folds: list[np.ndarray]) -> dict[str, np.ndarray]:
    from pysindy import STLSQ

    parts = [_inner(x[fold], y[fold]) for fold in folds]
    gram, moment, _ = (sum(p[k] for p in parts) for k in range(3))
    plain = np.linalg.solve(gram + RIDGE * np.eye(len(gram)), moment)
    thresholds = float(np.max(np.abs(plain))) * THRESHOLDS[::-1]

    def fitted(gram: np.ndarray, moment: np.ndarray, threshold: float) -> np.ndarray:
        # as few rows as columns, with the same inner products: the same regression, in less time
        values, vectors = np.linalg.eigh(gram)
        good = values > 1e-10 * values[-1]
        root = np.sqrt(values[good])
        rows, target = root[:, None] * vectors[:, good].T, (vectors[:, good].T @ moment) / root
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that a threshold leaves nothing, which is an answer
            way = STLSQ(threshold=threshold, alpha=RIDGE, max_iter=20)
            return np.asarray(way.fit(rows, target[:, None]).coef_).reshape(-1)

    errors = np.empty((thresholds.size, len(folds)))
    for k, (own, cross, size) in enumerate(parts):
        for i, threshold in enumerate(thresholds):
            w = fitted(gram - own, moment - cross, float(threshold))
            errors[i, k] = (size - 2 * w @ cross + w @ own @ w) / folds[k].size
    best, sparse = _simplest(errors)
    return {
        "STLSQ": fitted(gram, moment, float(thresholds[best])),
        "STLSQ, one standard error": fitted(gram, moment, float(thresholds[sparse])),
    }


def _inner(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    return x.T @ x, x.T @ y, float(y @ y)
