"""Closed forms of a load, the temperature or time as rivals of each name, where only |g| is known.

A few dozen attitudes say little of how a curve runs: a kink, or a fourth power, of a load is nearly a square, and the
smooth law that would show the difference needs more functions than there are readings to pay for them. A closed form
(a kink at so many g, a step, a power) pays for two or three numbers. So a name is held beside all of them, each in the
place in which a law acts, by the likelihood less what the numbers of each are worth (Schwarz 1978). Where a form is
ahead by a margin, the name is withdrawn and the law stands that resembles it; where one that runs differently is as
good, both are told.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.beside_laws import with_laws
from highside.diagnosis.claimed_values import values_of_claim
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.core.unexplained import hinted, in_ug, unimproved
from highside.diagnosis.law_sessions import MagnitudeLaws
from highside.diagnosis.laws.formulas import forms_of
from highside.diagnosis.laws.groups import values_of, varying
from highside.diagnosis.laws.policy import CLOSED_RIVALS
from highside.diagnosis.laws.problem import LawProblem, PlaceField
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.law import PREFIX, Law
from highside.physics.law_functions import Function
from highside.physics.places import PLACES

FOLLOWED = ("load", "temp", "time")
"""covariates of the forms: those of which hand sessions have many values"""


@dataclass(frozen=True)
class Explained:
    """How well something stands for a name: chi-square that it leaves, numbers that it has, what it does (n,)."""

    left: float
    numbers: int
    does: Array

    def nats(self, n: int, factor: float) -> float:
        """Log likelihood in noise of so many times its floor, less what its numbers are worth in n readings."""
        return -0.5 * self.left / factor**2 - 0.5 * self.numbers * float(np.log(n))


@dataclass(frozen=True)
class ClosedRival:
    """A closed form that may stand for a name."""

    label: str
    """place, channels and covariate, as a law of them would be called"""
    text: str
    explained: Explained
    alike: float
    """share of what it does that the name could do as well"""


@dataclass(frozen=True)
class Comparison:
    """A claim of a name and the forms that are as good, the best first, with the nats by which each is ahead."""

    claim: Claim
    rivals: tuple[tuple[ClosedRival, float], ...]

    @property
    def beaten(self) -> bool:
        """Whether a form is ahead by so much that the name is none."""
        return bool(self.rivals) and self.rivals[0][1] > CLOSED_RIVALS.ahead


def with_closed_rivals(
    session: MagnitudeLaws, model: ForwardModel, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with each name held beside closed forms; `model` is the base fit without what was found."""
    names = [c for c in diagnosis.claims if c.effect in library.registry() and not library.get(c.effect).random]
    if not names or diagnosis.verdict not in ("named", "named_plus"):
        return diagnosis, report
    compared = [_compared(session, model, diagnosis.claims, claim) for claim in names]
    beaten = [one for one in compared if one.beaten]
    if beaten:
        return _withdrawn(session, model, diagnosis, report, beaten)
    tied = {one.claim.effect: one for one in compared if one.rivals}
    claims = tuple(_told_as_tie(c, tied[c.effect]) if c.effect in tied else c for c in diagnosis.claims)
    found = replace(diagnosis, claims=claims)
    for one in tied.values():
        found = hinted(found, f"as good as {one.claim.effect}: {_words(one)}")
    return found, report


def _told_as_tie(claim: Claim, one: Comparison) -> Claim:
    """The claim with the laws in its class."""
    labels = dict.fromkeys(f"{PREFIX}{rival.label}" for rival, _ in one.rivals)
    others = tuple(name for name in labels if name not in claim.equivalence_class)[: CLOSED_RIVALS.most]
    advice = "more attitudes, where the two differ most: all over the range of what they follow"
    return replace(claim, equivalence_class=(*claim.equivalence_class, *others), next_manoeuvre=advice)


def _words(one: Comparison) -> str:
    return " or ".join(dict.fromkeys(rival.text for rival, _ in one.rivals[: CLOSED_RIVALS.most]))


def _withdrawn(
    session: MagnitudeLaws,
    model: ForwardModel,
    diagnosis: DiagnosisResult,
    report: ReportData,
    beaten: Sequence[Comparison],
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis without the names that a form beats: the laws that stand for them, else how much is left."""
    gone = {one.claim.effect for one in beaten}
    staying = tuple(c for c in diagnosis.claims if c.effect not in gone and c.effect in library.registry())
    remainder = replace(diagnosis.remainder, changing=(*diagnosis.remainder.changing, *sorted(gone)))
    bare = replace(diagnosis, verdict="unknown", claims=staying, remainder=remainder)
    answer, data = with_laws(session, model, bare, replace(report, after=report.before, parts={}))
    laws = [c for c in answer.claims if c.effect.startswith(PREFIX)]
    if laws:
        claims = tuple(
            replace(c, resembles=tuple(dict.fromkeys((*sorted(gone), *c.resembles)))) if c in laws else c
            for c in answer.claims
        )
        remainder = replace(answer.remainder, changing=diagnosis.remainder.changing)
        return replace(answer, claims=claims, remainder=remainder), data
    remainder = replace(diagnosis.remainder, resembles=tuple(sorted(gone)))
    found, data = replace(diagnosis, remainder=remainder), replace(report, after=report.before, parts={})
    if staying:
        found, data = _of_the_rest(session, model, found, report, staying)
    else:
        found = replace(found, verdict="unknown", claims=(), fit=unimproved(diagnosis.fit))
    left = float(np.sqrt(np.mean(data.after**2)))
    for one in beaten:
        words = (
            f"{in_ug(left)} rms are left out; they resemble {one.claim.effect}, but {_words(one)} is ahead of it "
            f"by {one.rivals[0][1]:.0f} nats"
        )
        found = hinted(found, words)
    return found, data


def _of_the_rest(
    session: MagnitudeLaws, model: ForwardModel, found: DiagnosisResult, report: ReportData, staying: tuple[Claim, ...]
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis of the names that stay, the base fitted beside them: what is left is left beside these."""
    values = {c.effect: values_of_claim(session, model, c) for c in staying if not library.get(c.effect).random}
    rest = base_fit(model.with_effects(values), session.observed, session.free)[0]
    after = session.residual(rest)
    fit = found.fit
    if fit is not None:
        left = float(np.sqrt(np.mean(after**2)))
        fit = replace(fit, rmse_after=left, heldout_rmse_after=None, heldout_gain_low=None, heldout_gain_high=None)
    names = {c.effect for c in staying}
    places = zip(found.location, found.claims, strict=False)
    location = tuple(place for place, c in places if c.effect in names)
    parts = {name: part for name, part in report.parts.items() if name in names}
    found = replace(found, verdict="named_plus", claims=staying, fit=fit, location=location)
    return found, replace(report, after=after, parts=parts)


# --- the comparison ------------------------------------------------------------------------------------------


def _compared(session: MagnitudeLaws, model: ForwardModel, claims: Sequence[Claim], claim: Claim) -> Comparison:
    """A name beside the forms, all to first order about what is claimed."""
    named = [c for c in claims if c.effect in library.registry() and not library.get(c.effect).random]
    values = {c.effect: values_of_claim(session, model, c) for c in named}
    laws = [Law.from_dict(c.law) for c in claims if c.law is not None]
    whole = base_fit(model.with_effects(values).with_laws(laws), session.observed, session.free)[0]
    others = [f"{c.effect}.{p}" for c in named if c is not claim for p in c.parameters if _fitted(c.effect, p)]
    own = [f"{claim.effect}.{p}" for p in claim.parameters if _fitted(claim.effect, p)]
    sizes = np.array([values[claim.effect][name.partition(".")[2]] for name in own])
    residual = session.residual(whole)
    problem = session.problem(whole, residual, others)
    table = session.observed.jacobian(whole, own)
    shapes = {p.name for p in library.get(claim.effect).shapes}
    moves = np.array([name.partition(".")[2] not in shapes for name in own])
    target = residual + np.tensordot(sizes[moves], table[moves], 1)
    floor = problem.floor[0]
    free = span(problem.free[:, 0] / floor)
    y = outside(free, target[0] / floor)
    basis = span(outside(free, table[:, 0] / floor), tolerance=CLOSED_RIVALS.shown)
    name = Explained(float(np.sum(outside(basis, y) ** 2)), len(claim.parameters), (basis @ y) @ basis)
    forms = list(_forms(problem, free, y, basis))
    freedom = max(1, y.size - len(free))
    every = [name, *(form.explained for form in forms)]
    factor = float(np.sqrt(max(1.0, *(0.0, min(e.left / max(1, freedom - e.numbers) for e in every)))))
    own_nats = name.nats(y.size, factor)
    ahead = [(form, form.explained.nats(y.size, factor) - own_nats) for form in forms]
    near = [(form, nats) for form, nats in ahead if _told(form, nats)]
    return Comparison(claim, tuple(sorted(near, key=lambda one: -one[1])))


def _told(form: ClosedRival, nats: float) -> bool:
    """Whether a form is one to be told beside the name: it runs differently, or somewhat so and is ahead."""
    limits = ((CLOSED_RIVALS.differs, -CLOSED_RIVALS.behind), (CLOSED_RIVALS.same, CLOSED_RIVALS.tied))
    return nats > CLOSED_RIVALS.ahead or any(form.alike < alike and nats > least for alike, least in limits)


def _fitted(effect: str, parameter: str) -> bool:
    return next(p for p in library.get(effect).parameters if p.name == parameter).fitted


def _forms(problem: LawProblem, free: Array, y: Array, name: Array) -> Iterator[ClosedRival]:
    """The best of each kind of form in each place; `free` (r, n) and `name` (k, n) are orthonormal, `y` (n,)."""
    alone = [(place,) for place in problem.places]
    offsets = tuple(place for place in problem.places if place.place == "offset")
    for units in [*alone, *([offsets] if len(offsets) > 1 else [])]:
        known = {covariate: values for covariate, values, _ in varying(problem, units)}
        if len(units) > 1 or units[0].place == "offset":
            # the load of an axis itself is what a sensor's curve follows
            known |= {"load": values_of(problem, "load", units[0])}
        for covariate in FOLLOWED:
            if covariate in known:
                yield from _along(problem, units, covariate, free, y, name)


def _along(
    problem: LawProblem, units: tuple[PlaceField, ...], covariate: str, free: Array, y: Array, name: Array
) -> Iterator[ClosedRival]:
    floor = problem.floor[0]
    own = [values_of(problem, covariate, unit) for unit in units]
    spans = (float(min(v.min() for v in own)), float(max(v.max() for v in own)))
    for form in forms_of(covariate, own[0]):
        made = np.array([_does(functions, units, own, spans) for functions in form.functions])
        raw = np.linalg.norm(made / floor, axis=2)
        left = outside(free, (made / floor).reshape(-1, y.size)).reshape(made.shape)
        size = np.linalg.norm(left, axis=2)
        good = np.all(size > CLOSED_RIVALS.shown * np.maximum(raw, 1e-300), axis=1) & np.all(np.isfinite(size), axis=1)
        if not good.any():
            continue
        left = left[good] / size[good][:, :, None]
        gram = np.einsum("bin,bjn->bij", left, left) + CLOSED_RIVALS.ridge * np.eye(left.shape[1])
        drive = left @ y
        mean = np.linalg.solve(gram, drive[:, :, None])[:, :, 0]
        best = int(np.argmax(np.sum(mean * drive, axis=1)))
        does = mean[best] @ left[best]
        functions = [f for f, kept in zip(form.functions, good, strict=True) if kept][best]
        numbers = form.numbers + len(functions) * (len(units) - 1)
        strength = float(does @ does)
        alike = float(np.sum((name @ does) ** 2)) / max(strength, 1e-300)
        channels = "".join(unit.channel for unit in units)
        where = PLACES[units[0].place].title.lower()
        text = f"{where} ({channels}) as {' + '.join(f.text(covariate) for f in functions)}"
        explained = Explained(float(np.sum((y - does) ** 2)), numbers, does)
        yield ClosedRival(f"{units[0].place}_{channels}_{covariate}", text, explained, alike)


def _does(
    functions: Sequence[Function], units: Sequence[PlaceField], own: Sequence[Array], spans: tuple[float, float]
) -> Array:
    """(k, n) what one unit of each function does, place by place."""
    return np.array(
        [f(values, spans) * unit.field[0] for unit, values in zip(units, own, strict=True) for f in functions]
    )
