"""What is reported of each law that was found: the law itself, its share, its proof, its stability, its class."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import STABILITY
from highside.diagnosis.core.regression import flattened, projected
from highside.diagnosis.core.result import Claim, FittedParameter
from highside.diagnosis.laws.acting import known_where_it_acted
from highside.diagnosis.laws.curves import curve_of, law_of_group, slice_of, with_band
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import LawTerm, Whitened, raw_columns
from highside.diagnosis.laws.formulas import Closed, closed_form
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import is_wave
from highside.diagnosis.laws.nested import joined, nested
from highside.diagnosis.laws.policy import LAW_REPORT
from highside.diagnosis.laws.products import ProductGroup, coefficients_of
from highside.diagnosis.laws.readings import readings_of
from highside.diagnosis.laws.separable import as_product, heldout_loss
from highside.diagnosis.laws.to_vary import SEVERAL_PERIODS, to_vary
from highside.diagnosis.laws.together import told_together
from highside.physics.covariates import covariate
from highside.physics.effect import Effect
from highside.physics.law import PREFIX, Law, slug_beside
from highside.special import chdtrc

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class ReportedLaw:
    """A law that was found, and what is reported of it."""

    law: Law
    effect: Array
    """(C, n) what it does to the readings, to first order"""
    share: float
    """of the misfit"""
    told: Callable[[], Claim]
    """what `claim` tells, sought when it is asked for: of laws on the way to others only what they do is wanted"""

    @cached_property
    def claim(self) -> Claim:
        """What is reported of it."""
        return self.told()


def reported_laws(found: Found, taken: Iterable[str] = ()) -> list[ReportedLaw]:
    """The laws of a search, the largest share first; library effects among the terms are reported elsewhere.

    Each has a slug of its own, also beside those of the ids `taken` (laws that the model has): what follows the same in
    the same place as another does stands beside it in the model, not in its stead.
    """
    ids = set(taken)
    white = found.whitened()
    terms = list(found.terms)
    _, covariance = white.posterior(terms)
    shares = _shares(white, terms)
    numbers = [k for k, term in enumerate(terms) if not term.group.effect]
    formulas = {k: closed_form(found, white, terms, k) or as_product(white, terms, k) for k in numbers}
    sure = {k: closed for k, closed in formulas.items() if closed is not None and closed.law is not None}
    parts = nested(terms, shares, {k for k, closed in sure.items() if closed.text})
    inside = {j for own in parts.values() for j in own}
    sure = {k: one for k, one in sure.items() if k not in inside and k not in parts}
    told, curves = told_together(white, terms, sure)
    made = [_as_one(found, curves, covariance, [k, *own], ids) for k, own in parts.items()]
    for k in numbers:
        if k in parts or k in inside:
            continue
        closed, part = formulas[k], slice_of(found, terms, k)
        if k in told:
            assert closed is not None and closed.law is not None
            law, effect = closed.law, closed.effect
        else:
            # a formula that holds with all else moved alone is none
            closed = None if k in sure else closed
            law = law_of_group(terms[k].group, curves[k], covariance[part, part])
            effect = np.tensordot(curves[k], raw_columns(found.problem, [terms[k]]), 1)
        law = known_where_it_acted(found.problem, terms[k].group, replace(law, slug=slug_beside(law.slug, ids)))
        ids.add(law.id)
        gain = partial(heldout, white, terms, k)
        banded = partial(with_band, found, white, terms, k)
        told_of = partial(_claim, found, white, terms, k, law, closed, shares[k], gain, effect, banded)
        made.append(ReportedLaw(law, effect, shares[k], told_of))
    return sorted(made, key=lambda one: -one.share)


def _as_one(
    found: Found, curves: Mapping[int, Array], covariance: Array, numbers: list[int], ids: set[str]
) -> ReportedLaw:
    """Several terms as one law: the first, of which the others are a part, with their sum."""
    white, terms, k = found.whitened(), list(found.terms), numbers[0]
    laws = [law_of_group(terms[i].group, curves[i], np.zeros((0, 0))) for i in numbers]
    rows = np.concatenate([np.arange(covariance.shape[0])[slice_of(found, terms, i)] for i in numbers])
    # of a product the coefficients of the surface that it is
    turns = [coefficients_of(terms[i].group) for i in numbers]
    turn = np.zeros((sum(len(own) for own in turns), rows.size))
    for i, own in enumerate(turns):
        at = sum(len(one) for one in turns[:i]), sum(one.shape[1] for one in turns[:i])
        turn[at[0] : at[0] + own.shape[0], at[1] : at[1] + own.shape[1]] = own
    law = joined(laws, turn @ covariance[np.ix_(rows, rows)] @ turn.T)
    law = replace(law, slug=slug_beside(law.slug, ids))
    ids.add(law.id)
    effect = np.asarray(sum(np.tensordot(curves[i], raw_columns(found.problem, [terms[i]]), 1) for i in numbers))
    kept = [i for i in range(len(terms)) if i not in numbers[1:]]
    gains = {**dict(enumerate(found.gains)), k: found.gain_of(numbers)}
    one = replace(
        found,
        terms=tuple(terms[i] for i in kept),
        gains=tuple(gains[i] for i in kept),
        classes=tuple(found.classes[i] for i in kept),
    )
    share = _share_of(white, terms, numbers)
    gain = partial(heldout, white, terms, *numbers)
    told_of = partial(_claim, one, white, list(one.terms), kept.index(k), law, None, share, gain, effect)
    return ReportedLaw(law, effect, share, told_of)


def effects_of(found: Found, names: bool = False) -> dict[int, Array]:
    """(C, n) what each law of a search does to the readings, by the number of its term, the largest share first: as
    `reported_laws` has them where no formula is told. Of `names` too where it is asked."""
    white, terms = found.whitened(), list(found.terms)
    mean, _ = white.posterior(terms)
    shares = _shares(white, terms)
    numbers = [k for k, term in enumerate(terms) if names or not term.group.effect]
    return {
        k: np.tensordot(mean[slice_of(found, terms, k)], raw_columns(found.problem, [terms[k]]), 1)
        for k in sorted(numbers, key=lambda k: -shares[k])
    }


def _shares(white: Whitened, terms: list[LawTerm]) -> list[float]:
    """Of the chi-square that all terms explain, the part that goes with each alone; they need not add up to one."""
    lost, whole = _lost(white, terms)
    return [max(0.0, float(one / whole)) for one in lost]


def _share_of(white: Whitened, terms: list[LawTerm], numbers: Sequence[int]) -> float:
    """The part that goes with several terms together."""
    _, whole = _lost(white, terms)
    others = [t for i, t in enumerate(terms) if i not in numbers]
    return min(1.0, max(0.0, float((_misfit(white, others) - _misfit(white, terms)) / whole)))


def _lost(white: Whitened, terms: list[LawTerm]) -> tuple[list[float], float]:
    """The chi-square that is left more without each term, and all that they explain."""
    left = _misfit(white, terms)
    lost = [_misfit(white, [t for i, t in enumerate(terms) if i != k]) - left for k in range(len(terms))]
    return lost, max(_misfit(white, []) - left, sum(lost), 1e-12)


def _misfit(white: Whitened, terms: list[LawTerm]) -> float:
    columns, _ = white.columns(terms)
    mean, _ = white.posterior(terms)
    return float(np.sum((white.residual - np.tensordot(mean, columns, 1)) ** 2))


def folds_of(n: int) -> Array:
    """(n,) number of the fold of each value: neighbours in different ones, so that each part of a session is learnt."""
    return np.asarray(np.arange(n) % LAW_REPORT.folds)


@dataclass(frozen=True)
class HeldOut:
    """Root mean squares of errors on values that no fit has used, in units of the noise, and the share removed."""

    before: float
    after: float
    low: float
    high: float
    words: str


def heldout_of(found: Found) -> HeldOut:
    """All terms together against none."""
    white = found.whitened()
    before, after = (np.array(_by_fold(white, used)) for used in ([], list(found.terms)))
    count = white.residual.size
    gains = 1.0 - after / np.maximum(before, 1e-300)
    middle = 1.0 - after.sum() / max(float(before.sum()), 1e-300)
    half = LAW_REPORT.sure * float(gains.std(ddof=1)) / np.sqrt(gains.size)
    words = (
        f"{LAW_REPORT.folds} sets of every {LAW_REPORT.folds}th value, each predicted from the others, in units of "
        "the noise that was learnt; gain = share of the mean square removed"
    )
    return HeldOut(
        float(np.sqrt(before.sum() / count)),
        float(np.sqrt(after.sum() / count)),
        middle - half,
        min(middle + half, 1.0),
        words,
    )


def heldout(white: Whitened, terms: list[LawTerm], *numbers: int) -> float:
    """Nats of log likelihood that terms add on values that no fit has used, beside the others."""
    others = [t for i, t in enumerate(terms) if i not in numbers]
    product = len(numbers) == 1 and isinstance(terms[numbers[0]].group, ProductGroup)
    with_it = heldout_loss(white, terms, numbers[0]) if product else _predicted(white, terms)
    return 0.5 * (_predicted(white, others) - with_it)


def proved(found: Found) -> Found:
    """The terms without the laws that are worth less on values held out than a law must be, one by one.

    The evidence of a law that follows what the others leave between their functions is high, and so is what it does
    wrongly elsewhere; and one that follows an outlying value has nothing to say of the others.
    """
    while found.terms:
        white, terms = found.whitened(), list(found.terms)
        gains = [np.inf if term.group.effect else heldout(white, terms, k) for k, term in enumerate(terms)]
        worst = int(np.argmin(gains))
        if gains[worst] >= LAW_REPORT.held_out:
            break
        found = found.only([k for k in range(len(terms)) if k != worst])
    return found


def _predicted(white: Whitened, terms: list[LawTerm]) -> float:
    return float(sum(_by_fold(white, terms)))


def _by_fold(white: Whitened, terms: list[LawTerm]) -> list[float]:
    """Square of the errors, in units of the noise, of values that are predicted from the others, fold by fold."""
    columns, prior = white.columns(terms)
    n = columns.shape[2]
    fold = folds_of(n)
    flat = flattened(columns)
    whole, products = flat @ flat.T + np.diag(prior), flat @ white.residual.reshape(-1)
    found = []
    for number in range(LAW_REPORT.folds):
        out = fold == number
        own = flattened(columns[:, :, out])
        target = white.residual[:, out].reshape(-1)
        size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        left = (whole - own @ own.T) / size[:, None] / size[None] + LAW_REPORT.ridge * np.eye(size.size)
        mean = np.linalg.solve(left, (products - own @ target) / size) / size
        found.append(float(np.sum((target - mean @ own) ** 2)))
    return found


def stability(found: Found, white: Whitened, terms: list[LawTerm], k: int, effect: Array) -> float:
    """Chance that the law's size agrees as little over parts of the session: thirds in time, halves of the angles."""
    chance = 1.0
    for parts in _partings(found):
        chance = min(chance, _agreement(white, terms, k, effect, parts))
    return chance


def _partings(found: Found) -> list[list[Bools]]:
    problem = found.problem
    time = np.argsort(np.argsort(problem.t_s, kind="stable"), kind="stable")
    partings = [[time * 3 // problem.n == third for third in range(3)]]
    for name in ("inc", "rate"):
        values = problem.covariates.get(name)
        if values is not None and np.ptp(values) > 0:
            low = values <= np.median(values)
            if 0 < low.sum() < low.size:
                partings.append([low, ~low])
    return partings


def _agreement(white: Whitened, terms: list[LawTerm], k: int, effect: Array, parts: list[Bools]) -> float:
    others = [t for i, t in enumerate(terms) if i != k]
    columns, prior = white.columns(others)
    own = white.whitener.white(np.stack([effect * part for part in parts]))
    every = flattened(np.concatenate([columns, own]))
    precision = np.diag(np.concatenate([prior, np.zeros(len(parts))]))
    gram = every @ every.T + precision
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / size[:, None] / size[None], hermitian=True) / size[:, None] / size[None]
    mean = inverse @ (every @ white.residual.reshape(-1))
    sizes, spread = mean[len(columns) :], inverse[len(columns) :, len(columns) :]
    known = np.diag(spread) < LAW_REPORT.known**2
    if known.sum() < 2:
        return 1.0
    sizes, weight = sizes[known], np.linalg.pinv(spread[np.ix_(known, known)], hermitian=True)
    ones = np.ones(sizes.size)
    common = float(ones @ weight @ sizes / (ones @ weight @ ones))
    # a law that is 1 here and 1 + x there shows; how the shape may vary beside its size is not in this spread
    apart = sizes - common
    chi = float(apart @ np.linalg.pinv(np.linalg.pinv(weight) + LAW_REPORT.shape**2 * np.eye(sizes.size)) @ apart)
    return float(chdtrc(sizes.size - 1, chi))


def named_claim(found: Found, k: int, effect: Effect, known: Mapping[str, float]) -> Claim:
    """The claim of a library effect that was chosen among laws, its sizes as they are beside them; `known`: the values
    that the model has of its parameters, from which on it was fitted."""
    white = found.whitened()
    terms = list(found.terms)
    mean, _ = white.posterior(terms)
    part, group = slice_of(found, terms, k), terms[k].group
    assert isinstance(group, EffectGroup)
    shown = np.flatnonzero(group.unit > 0)
    value, std = np.zeros(group.unit.size), np.zeros(group.unit.size)
    value[shown] = mean[part] / group.unit[shown]
    slopes = group.slopes(value)
    spread = _spread(white, terms, list(slopes.values()))
    std[shown] = spread[part] / group.unit[shown]
    value += [known.get(effect.parameters[i].name, 0.0) for i in effect.amplitudes]
    half = LAW_REPORT.sure * std
    parameters = {
        effect.parameters[i].name: FittedParameter(
            float(v), float(s), float(v - h), float(v + h), effect.parameters[i].unit
        )
        for i, v, s, h in zip(effect.amplitudes, value, std, half, strict=True)
    }
    of_shapes = dict(zip(slopes, spread[len(mean) :], strict=True))
    for p in effect.shapes:
        at, s = (group.shape.values[p.name] if group.shape else p.default), float(of_shapes.get(p.name, 0.0))
        parameters[p.name] = FittedParameter(at, s, at - LAW_REPORT.sure * s, at + LAW_REPORT.sure * s, p.unit)
    rivals = tuple(g.effect or f"{PREFIX}{g.label}" for g in found.class_of(k))
    does = np.tensordot(mean[part], raw_columns(found.problem, [terms[k]]), 1)
    return Claim(
        effect=effect.id,
        story=effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        parameters=parameters,
        p_familywise=float(np.exp(-min(found.gains[k], LAW_REPORT.least_log))),
        equivalence_class=rivals,
        rivals_ruled_out=(),
        next_manoeuvre=effect.splitter,
        share=_shares(white, terms)[k],
        channels=tuple(found.problem.channels[c] for c in group.channels),
        heldout_gain=heldout(white, terms, k),
        stable=bool(-np.log10(max(stability(found, white, terms, k, does), 1e-300)) < STABILITY.log_p),
    )


def _spread(white: Whitened, terms: list[LawTerm], slopes: list[Array]) -> Array:
    """(K + s,) standard deviations of all coefficients, where s further columns (C, n) are free beside the terms."""
    if not slopes:
        return np.sqrt(np.diag(white.posterior(terms)[1]))
    columns, prior = white.columns(terms)
    every = flattened(np.concatenate([columns, white.whitener.white(np.stack(slopes))]))
    gram = every @ every.T + np.diag(np.concatenate([prior, np.zeros(len(slopes))]))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / size[:, None] / size[None], hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size)


def _claim(
    found: Found,
    white: Whitened,
    terms: list[LawTerm],
    k: int,
    law: Law,
    closed: Closed | None,
    share: float,
    gain: Callable[[], float],
    effect: Array,
    banded: Callable[[Law], Law] = lambda law: law,
) -> Claim:
    group = terms[k].group
    strength = float(np.sum(white.whitener.white(effect[None]) ** 2))
    labels = [f"{PREFIX}{g.label}" if not g.effect else g.effect for g in found.class_of(k)]
    rivals = tuple(law.id if label == f"{PREFIX}{group.label}" else label for label in labels)
    own = found.gains[k]
    apart = [g for g in found.class_of(k)[1:] if not g.effect]
    # what set in stays, as far as one session tells: another need not vary its own time
    rivals_follow = {name for g in apart for name in g.depends_on} - set(law.depends_on)
    wave = any(map(is_wave, group.axes))
    confirm = SEVERAL_PERIODS if wave else to_vary(law.lasting().depends_on, rivals_follow)
    words = " and ".join(covariate(name).title for name in group.depends_on)
    formula = closed.text or None if closed is not None else None
    rms, rms_std = size_beside_free(white, effect, group.channels)
    shapes = tuple(f.kind for axis in law.axes for f in axis.functions) if law.formula or wave else ()
    told = banded(law)
    return Claim(
        effect=law.id,
        story=f"{law.at.title}, following {words}: no effect of the library, a law learnt from this recording.",
        formula=formula,
        stage="" if law.at.stage is None else law.at.stage.value,
        parameters={},
        p_familywise=float(np.exp(-min(own, LAW_REPORT.least_log))),
        equivalence_class=rivals,
        rivals_ruled_out=(),
        next_manoeuvre=f"record another session and {confirm}",
        share=share,
        channels=tuple(found.problem.channels[c] for c in group.channels),
        heldout_gain=gain(),
        stable=stability(found, white, terms, k, effect) > LAW_REPORT.stable,
        shape_within=float(np.sqrt(LAW_REPORT.unseen / max(strength, LAW_REPORT.unseen))),
        place=law.place,
        depends_on=law.depends_on,
        curve=curve_of(found, group, told),
        range=tuple((axis.low, axis.high) for axis in law.axes),
        readings=readings_of(law.place, law.depends_on, shapes),
        confirm=confirm,
        law=told.to_dict(),
        rms=rms,
        rms_std=rms_std,
    )


def size_beside_free(white: Whitened, effect: Array, channels: tuple[int, ...]) -> tuple[float, float]:
    """Rms of a contribution (C, n) over its channels, less what bias, scale and all that is free takes of it, and the
    standard deviation of that as a factor of the shape. A curve's own band also holds what is free takes of it.

    What is free takes is that of a base fit, beside the floor: under noise that wanders an offset would be let go, and
    the law be larger than the misfit it explains.
    """
    problem = white.families.problem
    own = white.whitener.white(effect[None])[0].reshape(-1)
    strength = float(np.sum((own - projected(flattened(white.free), own)) ** 2))
    free = flattened(problem.free / problem.floor)
    left = effect - projected(free, (effect / problem.floor).reshape(-1)).reshape(effect.shape) * problem.floor
    rms = float(np.sqrt(np.mean(left[list(channels)] ** 2)))
    return rms, rms / float(np.sqrt(max(strength, 1.0)))
