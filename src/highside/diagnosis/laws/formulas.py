"""From a curve to a formula: closed forms tried in its place, the joint refit deciding on values held out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.beside import Beside
from highside.diagnosis.laws.evidence import LawTerm, Whitened, inverse_of, orthonormal
from highside.diagnosis.laws.formulas_policy import LAW_FORMULAS
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup, values_of
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.physics.covariates import covariate
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function
from highside.physics.places import PLACES
from highside.special import chdtrc


@dataclass(frozen=True)
class Closed:
    """The text of a formula (several where none is ahead), and the law of the best where that is ahead of the curve."""

    text: str
    law: Law | None
    effect: Array
    """(C, n) what it does, to first order"""


@dataclass(frozen=True)
class _Form:
    """A kind of formula: the sets of functions it may be, each of the same number; fewer numbers are simpler."""

    name: str
    functions: Sequence[tuple[Function, ...]]
    numbers: int


def forms_of(name: str, values: Array) -> Iterator[_Form]:
    """The forms that are tried of a covariate with these values (n,)."""
    low, high = float(values.min()), float(values.max())
    width = high - low
    inner = [float(v) for v in low + width * np.linspace(0.0, 1.0, LAW_FORMULAS.places)]
    zero = [0.0] if low < 0 < high else []
    if covariate(name).periodic:
        for k in range(1, LAW_FORMULAS.orders + 1):
            # each by itself: on toolfaces of a grid two orders are the same readings, and neither is to hide the other
            yield _Form("wave", [(Function("cos", (float(k),)), Function("sin", (float(k),)))], 3)
        centres = np.arange(LAW_FORMULAS.centres) * (360.0 / LAW_FORMULAS.centres)
        dents = product(centres, LAW_FORMULAS.dent_widths_deg)
        yield _Form("dent", [(Function("dent", (float(c), w)),) for c, w in dents], 3)
        return
    yield _Form("linear", [(Function("linear", (0.0 if zero else low + width / 2,)),)], 1)
    visited = np.unique(np.round((values - low) / width / LAW_GROUPS.distinct))
    if name == "tf_fraction" or visited.size < LAW_GROUPS.few:
        # two values show no more than the difference between them
        return
    for power in LAW_FORMULAS.powers:
        at = zero or inner
        yield _Form(f"power {power:g}", [(Function("power", (c, power)),) for c in {*at, *inner}], 2)
    for power in LAW_FORMULAS.odd_powers:
        if zero:
            yield _Form(f"odd power {power:g}", [(Function("odd_power", (0.0, power)),)], 2)
    yield _Form("modulus", [(Function("modulus", (c,)),) for c in {*zero, *inner[1:-1]}], 2)
    yield _Form("step", [(Function("step", (c,)),) for c in _edges(values)], 2)
    yield _Form("ramp", [(Function("ramp", (c,)),) for c in inner[1:-1]], 2)
    widths = [width * s for s in LAW_FORMULAS.widths]
    yield _Form(
        "exponential", [(Function("exponential", (low if w < 0 else high, w)),) for s in widths for w in (-s, s)], 2
    )
    if name == "time":
        starts = [low, *inner[1:-1]]
        yield _Form("decay", [(Function("decay", (c, w)),) for c in starts for w in widths], 3)
    # with fewer values over its period a wave is whatever passes through them, and so where none is over half of one
    steps = np.diff(visited) * LAW_GROUPS.distinct * width
    least = max(LAW_FORMULAS.sampled * float(np.median(steps)), LAW_FORMULAS.unseen * float(steps.max()))
    periods = [width / k for k in LAW_FORMULAS.waves if width / k >= least]
    if periods:
        yield _Form("sine", [(Function("sine", (p,)), Function("cosine_of", (p,))) for p in periods], 3)
    yield _Form("bump", [(Function("bump", (c, w)),) for c in inner for w in widths[: LAW_FORMULAS.narrow]], 3)
    yield _Form("saturation", [(Function("saturation", (c, w)),) for c in {*zero, *inner[1:-1]} for w in widths], 3)


def _own_wave(group: LawGroup) -> tuple[_Form, ...]:
    """The wave that a group is, where it is one and no more."""
    functions = group.axes[0].functions
    if {f.kind for f in functions} != {"cos", "sin"} or len({f.numbers for f in functions}) > 1:
        return ()
    own = _Form("wave", [functions], 3)
    (order,) = functions[0].numbers
    near = round(order)
    if group.axes[0].covariate != "tf_fraction" or near < 1 or near == order:
        return (own,)
    # a short session cannot tell it from the whole order beside it, which has one number less
    whole = _Form("wave", [(Function("cos", (float(near),)), Function("sin", (float(near),)))], 2)
    return (own, whole)


def _edges(values: Array) -> list[float]:
    """Middles between neighbouring values, not more than so many."""
    distinct = np.unique(values)
    middle = (distinct[1:] + distinct[:-1]) / 2
    indices = np.unique(np.linspace(0, middle.size - 1, min(middle.size, LAW_FORMULAS.edges)).astype(int))
    return [float(v) for v in middle[indices]]


@dataclass(frozen=True)
class _Scored:
    form: _Form
    functions: tuple[Function, ...]
    coefficients: Array
    covariance: Array
    loss: float
    """square of the errors on values held out, in units of the noise"""
    effect: Array


def closed_form(found: Found, white: Whitened, terms: list[LawTerm], k: int) -> Closed | None:
    """The formula of a term; None where a curve does better than all, or where it has two covariates or channels."""
    group = terms[k].group
    if len(group.axes) > 1 or len(group.units) > 1 or group.effect:
        return None
    name, unit = group.axes[0].covariate, group.units[0]
    values = values_of(found.problem, name, unit)
    if not np.ptp(values):
        return None
    others = [t for i, t in enumerate(terms) if i != k]
    columns, prior = white.columns(others)
    beside = Beside(columns, prior, white.residual)
    curve = loss_of_curve(white, terms)
    span = Axis(name, group.axes[0].low, group.axes[0].high, (Function("one"),))
    constant = (Function("one"),) if PLACES[group.place].constant else ()
    scored: list[_Scored] = []
    for form in (*_own_wave(group), *forms_of(name, values)):
        rough = _scored(white, beside, group, span, form, constant, values)
        fine = None if rough is None else _finer(form, rough, float(np.ptp(values)))
        if fine is not None:
            rough = _scored(white, beside, group, span, fine, constant, values)
        if rough is not None:
            scored.append(rough)
    if not scored:
        return None
    fit = _Fit(white, columns, prior, field=unit.field, span=(span.low, span.high), values=values)
    for one in _one_of_each(scored)[: LAW_FORMULAS.most]:
        form = _Form(one.form.name, [fit.moved(one.functions, len(constant))], one.form.numbers)
        moved = _scored(white, beside, group, span, form, constant, values)
        scored += [] if moved is None else [moved]
    scored = _one_of_each(scored)
    best = scored[0]
    if 0.5 * (best.loss - curve) > LAW_FORMULAS.margin:
        return None
    left = _left_by_curve(white, terms, k)
    scored = [one for one in scored if not _peaks_between(one, span, values)]
    scored = [one for one in scored if not fit.refuted((*one.functions, *constant), one.form.numbers, *left)]
    if not scored:
        return None
    best = scored[0]
    near = [one for one in scored if 0.5 * (one.loss - best.loss) < LAW_FORMULAS.margin]
    simplest = sorted(
        near, key=lambda one: (one.form.numbers, round(one.loss, LAW_FORMULAS.alike), one.functions[0].numbers)
    )
    told = " or ".join(_text(one, name, bool(constant)) for one in simplest[: LAW_FORMULAS.most])
    unsure = len(near) > 1 and 0.5 * (curve - best.loss) < LAW_FORMULAS.margin
    if unsure or _jumps_where_nothing_is(best, values):
        # of several none is sure, and the curve does about as well; or it says how little is known where a step is
        return Closed(told, None, best.effect)
    axis = Axis(name, span.low, span.high, (*best.functions, *constant))
    law = Law(
        group.label,
        group.place,
        (unit.channel,),
        (axis,),
        (tuple(float(v) for v in best.coefficients),),
        tuple(tuple(float(v) for v in row) for row in best.covariance),
        _text(best, name, bool(constant)),
    )
    return Closed(told, law, best.effect)


def _peaks_between(one: _Scored, span: Axis, values: Array) -> bool:
    """Whether a formula does far more between the values visited than at any of them: of that nothing was measured."""
    axis = Axis(span.covariate, span.low, span.high, one.functions)
    sizes = one.coefficients[: len(one.functions)]
    between = sizes @ axis.basis(np.linspace(span.low, span.high, LAW_FORMULAS.between_values))
    return bool(np.ptp(between) > LAW_FORMULAS.between * np.ptp(sizes @ axis.basis(values)))


def _jumps_where_nothing_is(one: _Scored, values: Array) -> bool:
    """Whether a step lies between two values visited that are far apart: it may be anywhere between them."""
    if one.functions[0].kind != "step":
        return False
    visited, at = np.unique(values), one.functions[0].numbers[0]
    after = int(np.clip(np.searchsorted(visited, at), 1, visited.size - 1))
    return bool(visited[after] - visited[after - 1] > LAW_FORMULAS.apart * np.ptp(visited))


def _one_of_each(scored: list[_Scored]) -> list[_Scored]:
    """The best first: of each kind of form one, but of waves, steps and such all, as each stands for itself."""
    found: dict[tuple[str, ...], _Scored] = {}
    for one in sorted(scored, key=lambda one: one.loss):
        rounded = one.functions if one.form.name not in MOVED_FORMS else ()
        found.setdefault((one.form.name, *map(str, rounded)), one)
    return list(found.values())


MOVED_NUMBERS = {
    "power": "p.", "modulus": "p", "ramp": "p", "exponential": ".s", "decay": "ps", "sine": "s", "cosine_of": "s",
    "bump": "ps", "saturation": "ps", "dent": "ps",
}  # fmt: skip
"""of each number of a function whether it may be moved between those that are tried: p a place, s a scale, . not"""
MOVED_FORMS = frozenset({"modulus", "ramp", "exponential", "decay", "sine", "bump", "saturation", "dent"}) | {
    f"power {power:g}" for power in LAW_FORMULAS.powers
}


def _values(functions: Sequence[Function], values: Array, span: tuple[float, float]) -> tuple[Array, Array]:
    """(m, n) functions of a covariate and (m, 1) their root mean squares: 0 of what is nothing, or cannot be computed,
    as where its numbers were moved too far."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        basis = np.array([f(values, span) for f in functions])
        square = np.mean(basis**2, axis=1, keepdims=True)
    known = np.isfinite(square) & (square > np.finfo(float).tiny)
    return basis, np.sqrt(np.where(known, square, 0.0))


class _Fit:
    """Functions of a covariate fitted beside all other columns, on all values."""

    def __init__(
        self, white: Whitened, columns: Array, prior: Array, *, field: Array, span: tuple[float, float], values: Array
    ) -> None:
        self.white, self.field, self.span, self.values = white, field, span, values
        flat = flattened(columns)
        self.width = len(flat)
        # a prior is so many more values that are zero
        rows = np.concatenate([flat, np.diag(np.sqrt(prior))], axis=1)
        self.beside = orthonormal(rows)
        target = np.concatenate([white.residual.reshape(-1), np.zeros(self.width)])
        self.target = target - (target @ self.beside.T) @ self.beside

    def left(self, functions: Sequence[Function]) -> float:
        """Square of what is left, in units of the noise; infinite where they cannot be computed."""
        basis, size = _values(functions, self.values, self.span)
        if not np.all(size > 0.0):
            return np.inf
        basis = basis / size
        own = flattened(self.white.whitener.white(basis[:, None] * self.field[None]))
        own = np.concatenate([own, np.zeros((len(own), self.width))], axis=1)
        own = orthonormal(own - (own @ self.beside.T) @ self.beside)
        return float(self.target @ self.target - np.sum((own @ self.target) ** 2))

    def moved(self, functions: tuple[Function, ...], constants: int) -> tuple[Function, ...]:
        """The functions with their numbers moved to where they leave least."""
        kinds = MOVED_NUMBERS.get(functions[0].kind, "")
        if not kinds.strip("."):
            return functions
        numbers, width = np.array(functions[0].numbers), self.span[1] - self.span[0]
        unit = {"p": np.full(numbers.size, width), "s": np.abs(numbers), ".": np.zeros(numbers.size)}
        steps = LAW_FORMULAS.step * np.array([unit[kind][i] for i, kind in enumerate(kinds)])
        free = np.flatnonzero(steps)
        more = (Function("one"),) * constants

        def at(x: Array) -> tuple[Function, ...]:
            own = numbers.copy()
            own[free] += x * steps[free]
            return tuple(Function(f.kind, tuple(float(v) for v in own)) for f in functions)

        def left(x: Array) -> float:
            return self.left((*at(x), *more))

        from scipy.optimize import fmin  # not above: it takes a tenth of a start

        around = np.concatenate([np.zeros((1, free.size)), np.eye(free.size)])
        best = fmin(
            left,
            around[0],
            ftol=LAW_FORMULAS.still,
            maxfun=LAW_FORMULAS.moves,
            disp=False,
            initial_simplex=around,
        )
        return at(np.asarray(best))

    def refuted(self, functions: Sequence[Function], numbers: int, left: float, used: float) -> bool:
        """Whether they leave more than the curve does (`left`) by more than its `used` degrees of freedom may take."""
        more = self.left(functions) - left
        return bool(chdtrc(max(used - numbers, 1.0), max(more, 0.0)) < LAW_FORMULAS.refuted)


def _left_by_curve(white: Whitened, terms: list[LawTerm], k: int) -> tuple[float, float]:
    """Square of what is left beside the terms with what their prior takes, and degrees of freedom of the k-th term."""
    columns, prior = white.columns(terms)
    mean, _ = white.posterior(terms)
    left = white.residual - np.tensordot(mean, columns, 1)
    start = len(columns) - sum(t.group.size for t in terms[k:])
    own = slice(start, start + terms[k].group.size)
    flat = flattened(columns)
    inverse = inverse_of(flat @ flat.T, prior)
    used = terms[k].group.size - float(np.sum(np.diag(inverse)[own] * prior[own]))
    others = np.ones(prior.size, dtype=bool)
    others[own] = False
    return float(np.sum(left**2) + np.sum(prior[others] * mean[others] ** 2)), used


def _finer(form: _Form, rough: _Scored, width: float) -> _Form | None:
    """The form with its numbers tried closer around those that were best."""
    first = rough.functions[0]
    if form.name in ("linear", "wave", "step", "sine") or not first.numbers:
        return None
    step = width / (LAW_FORMULAS.places - 1)
    middles = [first.numbers[0] + step * s for s in LAW_FORMULAS.finer]
    if first.kind == "odd_power" and first.numbers[0] == 0:
        middles = [0.0]
    rest = first.numbers[1:]
    scales = LAW_FORMULAS.closer if rest and first.kind != "power" and first.kind != "odd_power" else (1.0,)
    tried = [(Function(first.kind, (float(c), *(float(v * s) for v in rest))),) for c in middles for s in scales]
    return _Form(form.name, tried, form.numbers)


def loss_of_curve(white: Whitened, terms: list[LawTerm]) -> float:
    """Square of the errors on values held out, in units of the noise, of the terms as they are."""
    columns, prior = white.columns(terms)
    return Beside(columns, prior, white.residual).loss(np.empty((0, *white.residual.shape)))


def _scored(
    white: Whitened,
    beside: Beside,
    group: LawGroup,
    span: Axis,
    form: _Form,
    constant: tuple[Function, ...],
    values: Array,
) -> _Scored | None:
    """The form's best functions, chosen on all values, and the loss of their sizes, fold by fold; each number costs.

    Where a step is, the values beside it alone say: left out, they would be given to whatever hedges.
    """
    field = group.units[0].field
    made = [_values([*functions, *constant], values, (span.low, span.high)) for functions in form.functions]
    basis, size = (np.array(one) for one in zip(*made, strict=True))
    good = np.all(size[:, :, 0] > 0.0, axis=1)
    if not good.any():
        return None
    basis, size = basis[good], size[good]
    count, width, n = basis.shape
    raw = (basis / size).reshape(count * width, 1, n) * field[None]
    own = white.whitener.white(raw).reshape(count, width, field.shape[0], n)
    best = int(np.argmax(beside.fitted(own)[0]))
    loss = beside.loss(own[best]) + 2 * form.numbers
    mean, inverse = beside.sizes(own[best])
    scale = size[best, :, 0]
    functions = [f for f, ok in zip(form.functions, good, strict=True) if ok][best]
    effect = (mean @ (basis[best] / size[best])) * field
    spread = inverse / scale[:, None] / scale[None]
    return _Scored(form, functions, mean / scale, spread, loss, np.asarray(effect))


def _text(one: _Scored, name: str, constant: bool) -> str:
    parts = [f"{v:.3g} {f.text(name)}" for v, f in zip(one.coefficients, one.functions, strict=False)]
    if constant:
        parts.append(f"{one.coefficients[-1]:.3g}")
    return " + ".join(parts).replace("+ -", "- ")
