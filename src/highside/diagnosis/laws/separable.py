"""A law of two quantities as a product of one function of each: a temperature coefficient that follows the load.

A surface has a number for each pair of functions, a product one for each function; few poses are enough for it where
they say little of a surface. It is tried in the place of a surface that was found, and decided on values held out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.evidence import LawTerm, Whitened, inverse_of, orthonormal
from highside.diagnosis.laws.formulas import Closed, loss_of_curve
from highside.diagnosis.laws.formulas_policy import LAW_FORMULAS, LAW_SEPARABLE
from highside.diagnosis.laws.groups import LawGroup, values_of
from highside.diagnosis.laws.policy import LAW_REPORT
from highside.diagnosis.laws.priors import Prior, best_priors
from highside.diagnosis.laws.products import ProductGroup, is_surface, unit
from highside.diagnosis.laws.variants import fine_axes, orders_of
from highside.physics.law import Axis, Law


@dataclass(frozen=True)
class _Product:
    """Coefficients of the functions of two quantities, and the priors they were fitted with."""

    first: Array
    """(a,) of length 1"""
    second: Array
    """(b,)"""
    priors: tuple[Prior, Prior]
    """of each with the other of length 1"""


class _Rows:
    """Some of the values of a session: the products of all functions off what is beside them."""

    def __init__(self, columns: Array, prior: Array, products: Array, residual: Array) -> None:
        """`columns` (K, C, n) of the other terms, `products` (a, b, C, n) and `residual` (C, n), whitened."""
        first, second = products.shape[:2]
        self.flat, self.prior = flattened(columns), prior
        self.whole, self.residual = products.reshape(first, second, -1), residual.reshape(-1)
        # a prior is so many more values that are zero
        beside = orthonormal(np.concatenate([self.flat, np.diag(np.sqrt(prior))], axis=1))
        seen = beside[:, : self.residual.size]
        # off what is beside them, as inner products need it: x.y - (Bx).(By)
        self.along = np.einsum("fn,abn->abf", seen, self.whole)
        self.target = seen @ self.residual

    def given(self, coefficients: Array, axis: int) -> tuple[Array, Array]:
        """Gram (m, m) and drive (m,) of the functions of one quantity, those of the other being given."""
        own = np.tensordot(self.whole, coefficients, (axis, 0))
        along = np.tensordot(self.along, coefficients, (axis, 0))
        return own @ own.T - along @ along.T, own @ self.residual - along @ self.target

    def fitted(self, start: Array, orders: tuple[Array, Array], priors: tuple[Prior, Prior] | None) -> _Product:
        """Each function in turn beside the other, from a second one on; the priors learnt where they are not given."""
        one, other = priors or (None, None)
        second = start
        for _ in range(LAW_SEPARABLE.turns):
            before = second
            first, of_first = _half(*self.given(unit(second), 1), orders[0], one)
            second, of_second = _half(*self.given(unit(first), 0), orders[1], other)
            if np.linalg.norm(second - before) < LAW_SEPARABLE.settled * np.linalg.norm(second):
                break
        return _Product(unit(first), second, (of_first, of_second))

    def beside(self, product: _Product) -> Array:
        """(K,) coefficients of the other terms beside a product."""
        own = np.einsum("a,abn,b->n", product.first, self.whole, product.second)
        return np.asarray(inverse_of(self.flat @ self.flat.T, self.prior) @ (self.flat @ (self.residual - own)))


def _half(gram: Array, drive: Array, orders: Array, prior: Prior | None) -> tuple[Array, Prior]:
    if prior is None:
        _, size, length = best_priors(gram[None], drive[None], orders[None])
        prior = Prior(float(size[0]), float(length[0]))
    return np.asarray(inverse_of(gram, 1.0 / prior.variances(orders)) @ drive), prior


def as_product(white: Whitened, terms: list[LawTerm], k: int) -> Closed | None:
    """The product that does better than the surface of a term on values held out; None where none does, or where the
    term is no surface of two smooth functions. A term that is a product is told as one, its second function as
    uncertain as its first."""
    group = terms[k].group
    if not isinstance(group, ProductGroup) and not is_surface(group):
        return None
    fit = _Fit.of(white, terms, k)
    if not isinstance(group, ProductGroup) and 0.5 * (loss_of_curve(white, terms) - fit.loss()) < LAW_FORMULAS.margin:
        return None
    return _law(group, fit.axes, fit.whole, fit.product, fit.orders, fit.raw)


def heldout_loss(white: Whitened, terms: list[LawTerm], k: int) -> float:
    """Sum of the squares that all terms leave of values held out, both functions of a product fitted to the others."""
    return _Fit.of(white, terms, k).loss()


@dataclass(frozen=True)
class _Fit:
    """A product in the place of a term, beside the others."""

    white: Whitened
    axes: tuple[Axis, Axis]
    raw: Array
    """(a b, C, n) the products of all functions"""
    products: Array
    """(a, b, C, n) whitened"""
    columns: Array
    prior: Array
    orders: tuple[Array, Array]
    whole: _Rows
    product: _Product

    @classmethod
    def of(cls, white: Whitened, terms: list[LawTerm], k: int) -> _Fit:
        group, problem = terms[k].group, white.families.problem
        first, second = group.surface if isinstance(group, ProductGroup) else fine_axes(problem, group)
        place = group.units[0]
        one, other = (axis.basis(values_of(problem, axis.covariate, place)) for axis in (first, second))
        raw = (one[:, None] * other[None]).reshape(len(one) * len(other), 1, -1) * place.field[None]
        products = white.whitener.white(raw).reshape(len(one), len(other), *white.residual.shape)
        columns, prior = white.columns([t for i, t in enumerate(terms) if i != k])
        orders = orders_of(first), orders_of(second)
        whole = _Rows(columns, prior, products, white.residual)
        product = whole.fitted(group.weights if isinstance(group, ProductGroup) else _start(whole), orders, None)
        return cls(white, (first, second), raw, products, columns, prior, orders, whole, product)

    def loss(self) -> float:
        """Sum of the squares that are left of values held out."""
        residual = self.white.residual
        loss, fold = 0.0, np.arange(residual.shape[1]) % LAW_REPORT.folds
        for number in range(LAW_REPORT.folds):
            out = fold == number
            part = _Rows(self.columns[..., ~out], self.prior, self.products[..., ~out], residual[:, ~out])
            own = part.fitted(self.product.second, self.orders, self.product.priors)
            told = np.einsum("a,abcn,b->cn", own.first, self.products[..., out], own.second)
            told = told + np.tensordot(part.beside(own), self.columns[..., out], 1)
            loss += float(np.sum((residual[:, out] - told) ** 2))
        return loss


def _start(rows: _Rows) -> Array:
    """Where the second function begins: the one that goes with the largest part of what the products are driven by."""
    drive = rows.whole @ rows.residual - rows.along @ rows.target
    power = np.einsum("abn,abn->ab", rows.whole, rows.whole)
    return np.asarray(np.linalg.svd(drive / np.sqrt(np.maximum(power, 1e-300)))[2][0])


def _law(
    group: LawGroup, axes: tuple[Axis, ...], rows: _Rows, product: _Product, orders: tuple[Array, Array], raw: Array
) -> Closed:
    """The law of a product, its covariance to first order about it."""
    first, second = product.first, product.second
    slopes = np.concatenate(
        [np.kron(np.eye(first.size), second[:, None]), np.kron(first[:, None], np.eye(second.size))], 1
    )
    own, along = (slopes.T @ x.reshape(len(slopes), -1) for x in (rows.whole, rows.along))
    size = float(np.linalg.norm(second))
    of_first, of_second = (prior.variances(order) for prior, order in zip(product.priors, orders, strict=True))
    precision = np.concatenate([size**2 / of_first, 1.0 / of_second])
    covariance = slopes @ inverse_of(own @ own.T - along @ along.T, precision) @ slopes.T
    values = np.kron(first, second)
    coefficients = (tuple(float(v) for v in values),)
    spread = tuple(tuple(float(v) for v in row) for row in covariance)
    law = Law(group.label, group.place, (group.units[0].channel,), axes, coefficients, spread)
    return Closed("", law, np.asarray(np.tensordot(values, raw, 1)))
