"""Laws of two quantities that are one function of each, multiplied, sought among all pairs of quantities in all places.

A surface has a number for each pair of functions: in few poses, or with fine functions, no evidence speaks for so many,
and what it does is given to noise. A product has one for each function. It is not linear in them, so each function is
fitted in turn with the other given (alternating least squares), beside the noise and the laws that are known; the
evidence is that of the one function with the other given, less what the other costs, both by Laplace's method (MacKay,
Information Theory, Inference, and Learning Algorithms, 2003, chapter 27). With its second function held the product is
a group like any other.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.evidence import LawTerm, Whitened, inverse_of
from highside.diagnosis.laws.groups import LawGroup, confounded, values_of
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.diagnosis.laws.priors import best_priors, falls, shown_of
from highside.diagnosis.laws.problem import functions_of
from highside.diagnosis.laws.products_policy import PRODUCTS
from highside.diagnosis.laws.variants import fine_axes, orders_of
from highside.physics.law import Axis
from highside.physics.law_functions import Function


@dataclass(frozen=True)
class Combined(Axis):
    """One function of a covariate: those of an axis with weights (m,)."""

    of: Axis | None = None
    weights: tuple[float, ...] = ()

    def basis(self, u: AnyArray) -> AnyArray:
        """(1, n)."""
        assert self.of is not None
        return np.asarray(np.array(self.weights) @ self.of.basis(u))[None]


@dataclass(frozen=True, eq=False)
class ProductGroup(LawGroup):
    """The functions of the first quantity, each times one function of the second."""

    functions: tuple[Array, Array] = (np.empty((0, 0)), np.empty((0, 0)))
    """(a, n) and (b, n) of each quantity"""
    alike: float = 1
    """how many surfaces like its own are tried; `tries` has what the second function costs as well"""

    @property
    def surface(self) -> tuple[Axis, Axis]:
        """The axes of all products of functions."""
        first, second = self.axes
        assert isinstance(second, Combined) and second.of is not None
        return first, second.of

    def curves(self) -> list[LawGroup]:
        """The functions of each quantity alone, in its place."""
        both = zip(self.surface, self.functions, strict=True)
        return [LawGroup(self.units, (axis,), orders_of(axis), own[None]) for axis, own in both]

    @property
    def weights(self) -> Array:
        """(b,) of the functions of the second quantity."""
        second = self.axes[1]
        assert isinstance(second, Combined)
        return np.array(second.weights)


@dataclass(frozen=True)
class _Pair:
    """A surface off what is beside it: inner products (a, b, a, b) of its columns, and (a, b) with the residual."""

    group: LawGroup
    axes: tuple[Axis, Axis]
    functions: tuple[Array, Array]
    """(a, n) and (b, n)"""
    gram: Array
    drive: Array


def coefficients_of(group: LawGroup) -> Array:
    """(M, m) what turns the coefficients of a group into those of all products of the functions of its law."""
    if isinstance(group, ProductGroup):
        return np.asarray(np.kron(np.eye(group.order.size), group.weights[:, None]), dtype=float)
    return np.eye(group.size)


def is_surface(group: LawGroup) -> bool:
    """Whether a group is of all products of two smooth functions in one place and channel."""
    smooth = all(len(axis.functions) > LAW_GROUPS.few and not axis.sets_in for axis in group.axes)
    return not group.effect and len(group.axes) == 2 and len(group.units) == 1 and smooth


def is_more_than(product: LawGroup, law: LawGroup) -> bool:
    """Whether a product acts as a law does and follows what that follows, and something else."""
    return not law.effect and product.kind[:2] == law.kind[:2] and set(law.depends_on) < set(product.depends_on)


def best_products(white: Whitened, terms: Sequence[LawTerm], groups: Sequence[LawGroup]) -> list[ProductGroup]:
    """The likeliest products in the places and of the quantities of some groups, beside terms, the best first."""
    beside, problem = _Beside(white, terms), white.families.problem
    alike: dict[tuple[int, ...], list[tuple[LawGroup, tuple[Axis, ...]]]] = defaultdict(list)
    for group in filter(is_surface, groups):
        one, other = (values_of(problem, name, group.units[0]) for name in group.depends_on)
        if confounded(one, other, LAW_CLASS.function):
            # of one quantity it is a curve with an edge, or a function of what happened in this session
            continue
        axes = fine_axes(problem, group)
        alike[tuple(len(axis.functions) for axis in axes)].append((group, axes))
    best: list[tuple[float, _Pair, Array]] = []
    for surfaces in alike.values():
        # the inner products of all at once would not fit where a recording has many columns
        for first in range(0, len(surfaces), PRODUCTS.at_once):
            pairs = [beside.pair(*one) for one in surfaces[first : first + PRODUCTS.at_once]]
            worth, second = _fitted(pairs, PRODUCTS.turns, _starts(pairs))
            best += zip(worth.tolist(), pairs, second, strict=True)
            best = sorted(best, key=lambda one: -one[0])[: PRODUCTS.refined]
    near = sorted((refined(pair, start) for _, pair, start in best), key=lambda one: -one[0])
    return [group for _, group in near[: PRODUCTS.tried]]


def fitted_again(white: Whitened, others: Sequence[LawTerm], group: ProductGroup) -> ProductGroup:
    """A product with its second function fitted anew, beside other terms under another noise."""
    pair = _Beside(white, others).pair(group, group.surface)
    return refined(pair, group.weights)[1]


def refined(pair: _Pair, start: Array) -> tuple[float, ProductGroup]:
    """The product of a pair from a second function on, with all lengths of the priors, and its evidence in nats."""
    worth, second = _fitted([pair], PRODUCTS.refined_turns, start[None, None], every_length=True)
    orders = [orders_of(axis)[None] for axis in pair.axes]
    cost = _costs_of_second(pair.gram[None], pair.drive[None], orders, second)
    return float(worth[0]), _group(pair, second[0], float(cost[0]))


class _Beside:
    """What is free (P, C, n) and some terms, whitened, and the whitened residual (C, n) off them."""

    def __init__(self, white: Whitened, terms: Sequence[LawTerm]) -> None:
        columns, prior = white.columns(list(terms))
        self.white, self.flat = white, flattened(columns)
        self.inverse = inverse_of(self.flat @ self.flat.T, prior)
        self.residual = white.residual.reshape(-1)
        self.along = self.inverse @ (self.flat @ self.residual)

    def pair(self, group: LawGroup, axes: tuple[Axis, ...]) -> _Pair:
        """A surface of these axes in the place of a group."""
        unit, problem = group.units[0], self.white.families.problem
        first, second = axes
        one, other = (functions_of(problem.covariates, axis, unit.own) for axis in axes)
        count = len(one), len(other)
        raw = (one[:, None] * other[None]).reshape(count[0] * count[1], 1, -1) * unit.field[None]
        flat = flattened(self.white.whitener.white(raw))
        whole, across = flat @ flat.T, flat @ self.flat.T
        left, drive = whole - across @ self.inverse @ across.T, flat @ self.residual - across @ self.along
        left, drive = (shown[0] for shown in shown_of(whole[None], left[None], drive[None]))
        return _Pair(group, (first, second), (one, other), left.reshape(*count, *count), drive.reshape(count))


def _starts(pairs: Sequence[_Pair]) -> Array:
    """(S, G, b) second functions to begin with: the one that goes with the largest part of what the products are driven
    by, and the first few of the axis."""
    drive = np.stack([pair.drive for pair in pairs])
    power = np.stack([np.einsum("abab->ab", pair.gram) for pair in pairs])
    most = np.maximum(power.max(axis=(1, 2), keepdims=True), 1e-300)
    turned = np.linalg.svd(drive / np.sqrt(np.maximum(power, PRODUCTS.ridge * most)), full_matrices=False)[2][:, 0]
    plain = np.broadcast_to(np.eye(drive.shape[2])[: PRODUCTS.starts, None], (PRODUCTS.starts, *turned.shape))
    return np.concatenate([turned[None], plain])


def _fitted(pairs: Sequence[_Pair], turns: int, starts: Array, *, every_length: bool = False) -> tuple[Array, Array]:
    """(G,) nats of the best product of each pair of equally many functions, and its second function (G, b) of length 1,
    from some starts (S, G, b)."""
    gram, drive = np.stack([pair.gram for pair in pairs]), np.stack([pair.drive for pair in pairs])
    orders = [np.stack([orders_of(pair.axes[k]) for pair in pairs]) for k in (0, 1)]
    near = -np.inf if every_length else np.full(len(pairs), -np.finfo(float).max)
    best, found = np.full(len(pairs), -np.inf), np.zeros((len(pairs), drive.shape[2]))
    for second in starts:
        for _ in range(turns):
            first, _ = _half(*_given_second(gram, drive, second), orders[0], near)
            own = _given_first(gram, drive, unit(first))
            second, _ = _half(*own, orders[1], near)
            second = unit(second)
        own = _given_second(gram, drive, second)
        _, gain = _half(*own, orders[0], near)
        gain = gain - _costs_of_second(gram, drive, orders, second)
        better = gain > best
        best, found = np.where(better, gain, best), np.where(better[:, None], second, found)
    return best, found


def _given_second(gram: Array, drive: Array, second: Array) -> tuple[Array, Array]:
    """Inner products (G, a, a) and (G, a) of the first functions with the second (G, b) given."""
    own = np.einsum("gb,gabcd->gacd", second, gram)
    return np.einsum("gacd,gd->gac", own, second), np.einsum("gab,gb->ga", drive, second)


def _given_first(gram: Array, drive: Array, first: Array) -> tuple[Array, Array]:
    own = np.einsum("ga,gabcd->gbcd", first, gram)
    return np.einsum("gbcd,gc->gbd", own, first), np.einsum("gab,ga->gb", drive, first)


def _half(gram: Array, drive: Array, orders: Array, near: Array | float) -> tuple[Array, Array]:
    """Coefficients (G, m) of one of the two functions at its best prior, and its evidence (G,)."""
    gain, size, length = best_priors(gram, drive, orders, near)
    size, length = np.where(np.isfinite(gain), size, 1.0), np.where(np.isfinite(gain), length, 1.0)
    precision = 1.0 / np.maximum(size[:, None] * falls(orders, length[:, None]), 1e-300)
    whole = gram + precision[:, :, None] * np.eye(orders.shape[1])
    return np.asarray(np.linalg.solve(whole, drive[:, :, None])[:, :, 0]), gain


def _costs_of_second(gram: Array, drive: Array, orders: Sequence[Array], second: Array) -> Array:
    """(G,) nats that each second function (G, b), of length 1, costs: half the logarithm of how much sharper the
    readings know it than its prior does, and how unlikely it is by that."""
    first, _ = _half(*_given_second(gram, drive, second), orders[0], -np.inf)
    own, _ = _given_first(gram, drive, first)
    costs = []
    for length in PRODUCTS.lengths:
        fall = falls(orders[1], length)
        variance = fall / fall.sum(axis=1, keepdims=True)
        size = np.sqrt(variance)
        sharper = np.eye(second.shape[1]) + size[:, :, None] * own * size[:, None, :]
        costs.append(0.5 * np.linalg.slogdet(sharper)[1] + 0.5 * np.sum(second**2 / variance, axis=1))
    return np.asarray(np.min(costs, axis=0))


def unit(coefficients: Array) -> Array:
    """(..., m) of length 1; zeros stay."""
    return np.asarray(coefficients / np.maximum(np.linalg.norm(coefficients, axis=-1, keepdims=True), 1e-300))


def _group(pair: _Pair, second: Array, cost: float) -> ProductGroup:
    first, other = pair.axes
    one = Combined(other.covariate, other.low, other.high, (Function("one"),), other, tuple(map(float, second)))
    basis = pair.functions[0] * (second @ pair.functions[1])
    alike = pair.group.alike if isinstance(pair.group, ProductGroup) else pair.group.tries
    tries = alike * float(np.exp(np.clip(cost, 0.0, np.log(np.finfo(float).max / alike))))
    return ProductGroup(
        pair.group.units, (first, one), orders_of(first), basis[None], tries, functions=pair.functions, alike=alike
    )
