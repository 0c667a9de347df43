"""Functions fitted beside columns, fold by fold: as a fit of all together, made anew for each fold, has them."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.laws.beside import Beside
from highside.diagnosis.laws.evidence import orthonormal
from highside.diagnosis.laws.noise import evidence, evidence_of_settings
from highside.diagnosis.laws.policy import LAW_REPORT

N = 200


def fitted(rows: Array, prior: Array, target: Array) -> Array:
    """Coefficients of rows, a prior being so many more values that are zero."""
    more = np.diag(np.sqrt(prior))
    return np.linalg.lstsq(np.concatenate([rows.T, more]), np.concatenate([target, np.zeros(prior.size)]), rcond=None)[
        0
    ]


def loss_of_fits(base: Array, prior: Array, own: Array, residual: Array) -> float:
    """Square of the errors on each fold, fitted on the others."""
    every, whole, loss = np.concatenate([base, own]), np.concatenate([prior, np.zeros(len(own))]), 0.0
    for number in range(LAW_REPORT.folds):
        out = np.arange(N) % LAW_REPORT.folds == number
        sizes = fitted(every[:, :, ~out].reshape(len(every), -1), whole, residual[:, ~out].reshape(-1))
        loss += float(np.sum((residual[:, out] - np.tensordot(sizes, every[:, :, out], 1)) ** 2))
    return loss


@pytest.mark.parametrize(("columns", "functions"), [(5, 1), (40, 3), (0, 2), (30, 0)])
def test_a_loss_is_that_of_fits_without_each_fold(columns: int, functions: int) -> None:
    rng = np.random.default_rng(columns)
    base, residual = rng.standard_normal((columns, 3, N)), rng.standard_normal((3, N))
    prior = np.where(np.arange(columns) < 3, 0.0, rng.uniform(0.1, 10.0, columns))
    own = rng.standard_normal((functions, 3, N))
    beside = Beside(base, prior, residual)
    assert beside.loss(own) == pytest.approx(loss_of_fits(base, prior, own, residual), rel=1e-7)
    if functions:
        every, whole = np.concatenate([base, own]), np.concatenate([prior, np.zeros(functions)])
        together = fitted(every.reshape(len(every), -1), whole, residual.reshape(-1))
        _, coefficients, sizes = beside.fitted(own[None])
        np.testing.assert_allclose(np.concatenate([coefficients[0], sizes[0]]), together, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(beside.sizes(own)[0], together[columns:], rtol=1e-6, atol=1e-9)


def test_a_function_that_one_fold_alone_shows_is_not_fitted_by_the_rounding_of_the_others() -> None:
    rng = np.random.default_rng(2)
    base, residual = rng.standard_normal((20, 1, N)), rng.standard_normal((1, N))
    own = np.zeros((1, 1, N))
    own[0, 0, LAW_REPORT.folds] = 1.0
    prior = np.full(20, 0.3)
    assert Beside(base, prior, residual).loss(own) == pytest.approx(loss_of_fits(base, prior, own, residual), rel=1e-7)


@pytest.mark.parametrize("worst", [1.0, 1e-5, 1e-8])
def test_orthonormal_rows_span_what_they_are_made_of(worst: float) -> None:
    """By Cholesky's factor, or, where rows are nearly alike, by singular values."""
    rng = np.random.default_rng(3)
    far = np.linalg.qr(rng.standard_normal((500, 30)))[0].T
    rows = np.linalg.qr(rng.standard_normal((30, 30)))[0] @ (np.geomspace(1.0, worst, 30)[:, None] * far)
    made = orthonormal(rows)
    assert len(made) == 30
    np.testing.assert_allclose(made @ made.T, np.eye(30), atol=1e-12)
    np.testing.assert_allclose((rows @ made.T) @ made, rows, atol=1e-12)
    twice = orthonormal(np.concatenate([rows, rows[:2]]))
    assert len(twice) == 30


def test_columns_of_other_channels_change_no_comparison_of_noise() -> None:
    """Three on the channel, two that share another with one of these, four apart from all: as all at once."""
    rng = np.random.default_rng(4)
    own, linked, apart = (rng.standard_normal((k, 60)) for k in (3, 2, 4))
    residual = rng.standard_normal((3, 60))
    first = np.zeros((4, 10, 10))
    for s, size in enumerate((1.0, 1.3, 2.0, 5.0)):
        rows = np.zeros((10, 60))
        rows[:3], rows[9] = own / size, residual[0] / size
        first[s] = rows @ rows.T
    second, third = np.zeros((10, 60)), np.zeros((10, 60))
    second[2:5], second[9] = rng.standard_normal((3, 60)), residual[1]
    second[3:5] = linked
    third[5:9], third[9] = apart, residual[2]
    rest = second @ second.T + third @ third.T
    prior = np.concatenate([np.zeros(2), rng.uniform(0.5, 2.0, 7)])
    sizes, total = np.array([[1.0, 1.15]] * 4), rng.standard_normal((4, 2))
    found = evidence_of_settings(first, sizes, rest, prior, total)
    wanted = [
        [evidence((first[s] / size**2 + rest)[None], prior, total[s, f : f + 1])[0] for f, size in enumerate(sizes[s])]
        for s in range(4)
    ]
    np.testing.assert_allclose(found, wanted, rtol=1e-10)
