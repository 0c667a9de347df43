"""What well-kept regressions reach on the same pairs of sessions: they learn what the base fit leaves of the first one,
channel by channel, from all covariates that vary, and have to say what the second one's law adds.

* a Gaussian process (scikit-learn): a length for each covariate and a noise level, by marginal likelihood, on at most
  400 pose means or means of rows;
* boosted trees (`HistGradientBoostingRegressor`), stopped early on a part held out;
* a sparse regression: SINDy's sequentially thresholded least squares (pysindy) over polynomials of the third degree.

None of them tells a place or a covariate.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np

from . import judging, laws, world
from .answers import Case
from .world import Session

POINTS = 400
"""a Gaussian process costs the third power of this"""
ROWS = 4000
"""of the boosted trees"""


def features(s: Session) -> dict[str, np.ndarray]:
    """Covariates (n,) that a user could give to a regression: all that is recorded, angles as sine and cosine."""
    found = {f"load_{axis}": row for axis, row in zip("xyz", world.loads(s), strict=True)}
    found |= {"temp": s.temp, "time": s.t - s.t[0], "temp_rate": np.gradient(s.temp, s.t), "vibration": s.vibration}
    found |= {"cos_tf": np.cos(s.tf), "sin_tf": np.sin(s.tf), "inc": s.inc, **s.extra}
    if s.kind == "rotation":
        found |= {"rate": s.rate, "acceleration": s.acceleration}
    else:
        found |= {"previous_load_z": laws.covariate(s, "previous_load_z"), "side": s.side}
    return found


def row_of(case: Case) -> dict[str, Any] | None:
    """The share of the law that each way closes on the second session."""
    if case.other is None or case.first is None or case.kept_from is None or not all(map(laws.repeatable, case.laws)):
        return None
    names = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")[: len(case.kept_from)]
    data = np.stack([case.recording[name] for name in names])
    data[3:] = np.radians(data[3:])
    target = world.off_base(case.first, data)
    before, after = features(case.first), features(case.other)
    used = [name for name, values in before.items() if np.ptp(values) > 1e-9]
    scale = {name: (before[name].mean(), before[name].std()) for name in used}
    x, new = (np.stack([(f[n] - scale[n][0]) / scale[n][1] for n in used], axis=1) for f in (before, after))
    ways: dict[str, float | None] = {}
    seconds: dict[str, float] = {}
    for way, learn in (("gaussian process", _process), ("boosted trees", _trees), ("sparse regression", _sparse)):
        began = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reported = np.stack([learn(case.first, x, row, new) for row in target])
        ways[way] = judging.closed(case.other, case.kept_from, reported, case.sigma)
        seconds[way] = time.perf_counter() - began
    return {"name": case.name, "group": case.group, "truth": case.answer(), "ways": ways, "seconds": seconds}


def _means(s: Session, x: np.ndarray, y: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose means, or every so many rows: no more than a number of points."""
    if s.kind == "poses":
        number = np.unique(s.pose, return_inverse=True)[1]
        count = np.bincount(number)
        return np.stack([np.bincount(number, c) / count for c in x.T], axis=1), np.bincount(number, y) / count
    chosen = np.linspace(0, s.n - 1, min(points, s.n)).astype(int)
    return x[chosen], y[chosen]


def _process(s: Session, x: np.ndarray, y: np.ndarray, new: np.ndarray) -> np.ndarray:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    points, values = _means(s, x, y, POINTS)
    size = max(float(values.std()), 1e-12)
    lengths = np.full(x.shape[1], 2.0)
    kernel = ConstantKernel(1.0, (1e-4, 1e3)) * RBF(lengths, (0.1, 1e3)) + WhiteKernel(0.3, (1e-4, 10.0))
    model = GaussianProcessRegressor(kernel, n_restarts_optimizer=0, normalize_y=True)
    model.fit(points, values / size)
    return np.concatenate([size * model.predict(part) for part in np.array_split(new, max(1, len(new) // 1000))])


def _trees(s: Session, x: np.ndarray, y: np.ndarray, new: np.ndarray) -> np.ndarray:
    from sklearn.ensemble import HistGradientBoostingRegressor

    points, values = _means(s, x, y, ROWS)
    size = max(float(values.std()), 1e-12)
    least = max(2, min(20, len(points) // 20))
    model = HistGradientBoostingRegressor(early_stopping=True, min_samples_leaf=least, random_state=0)
    return np.asarray(size * model.fit(points, values / size).predict(new))


def _sparse(s: Session, x: np.ndarray, y: np.ndarray, new: np.ndarray) -> np.ndarray:
    from pysindy import STLSQ
    from sklearn.preprocessing import PolynomialFeatures

    points, values = _means(s, x, y, ROWS)
    size = max(float(values.std()), 1e-12)
    # as many terms as half of the points allow
    degree = 3 if len(points) > 2 * _terms(x.shape[1], 3) else 2 if len(points) > 2 * _terms(x.shape[1], 2) else 1
    library = PolynomialFeatures(degree, include_bias=False)
    matrix = library.fit_transform(points)
    norms = np.linalg.norm(matrix, axis=0)
    cut = np.arange(len(points)) % 5 == 0
    best, chosen = np.inf, np.zeros(matrix.shape[1])
    for threshold in np.geomspace(0.02, 1.0, 8) * np.sqrt(len(points)):
        part = STLSQ(threshold=threshold, alpha=1e-2, max_iter=10)
        part.fit(matrix[~cut] / norms, values[~cut, None] / size)
        error = float(np.mean((values[cut] / size - (matrix[cut] / norms) @ part.coef_[0]) ** 2))
        if error < best:
            best, chosen = error, part.coef_[0]
    return np.asarray(size * (library.transform(new) / norms) @ chosen)


def _terms(n: int, degree: int) -> int:
    from math import comb

    return comb(n + degree, degree) - 1
