"""What a search among laws and names came to, and what of it is believed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import Claim
from highside.diagnosis.laws.claims import ReportedLaw, effects_of, reported_laws
from highside.diagnosis.laws.evidence import raw_columns
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.free_rivals import with_free_rivals
from highside.diagnosis.laws.policy import LAW_SEARCH, LAW_VERDICT
from highside.diagnosis.names_instead import names_of
from highside.physics import effects as library
from highside.physics.covariates import lag_of
from highside.physics.forward import ForwardModel

OFFSETS = frozenset({"offset", "gyro_offset"})
"""places in which a random walk of the zero offset acts"""
SLOW = frozenset({"time", "temp", "temp_rate"})
"""covariates that run as slowly as such a random walk"""


@dataclass(frozen=True)
class Outcome:
    """What was chosen: names that stay, laws, and the search that found them."""

    names: tuple[Claim, ...]
    laws: tuple[ReportedLaw, ...]
    found: Found
    renamed: bool = False
    """a name stands where a law was found"""
    doubted: frozenset[str] = frozenset()
    """names that are to give way to laws, or have"""
    is_noise: bool = False
    """the name is worth nothing beside the noise that was learned here"""
    behind: float = 0.0
    """nats by which the worst of these is behind a law in its place"""
    implausible: bool = False
    """the names explain it, at sizes that no instrument has"""


def beside_random_walk(outcome: Outcome, model: ForwardModel) -> Outcome:
    """What is believed where a random walk of the zero offset was found: of what may be that walk, what gains enough
    beside it by itself or together; and of all else what is worth its claim without what is not believed. Of poses,
    whose means are the values of the walk, what is worth its claim beside the noise is."""
    if outcome.implausible or outcome.found.problem.every_pair:
        return outcome
    found = outcome.found
    for _ in range(len(found.terms)):
        small = [k for k, gain in enumerate(found.gains) if gain < LAW_VERDICT.beside_random_walk]
        together = doubted = {k for k in small if _as_slow(found, k)}
        if doubted and not found.noise.remembers:
            # several that leave nothing of the walk stand in its place together
            together = {k for k in range(len(found.terms)) if _as_slow(found, k)}
        if doubted and found.gain_of(together) < LAW_VERDICT.beside_random_walk:
            kept = [k for k in range(len(found.terms)) if k not in doubted]
        else:
            kept = [k for k, gain in enumerate(found.gains) if gain >= LAW_SEARCH.gain]
        if len(kept) == len(found.terms):
            break
        found = found.only(kept)
    if found is outcome.found:
        return outcome
    names, _ = with_free_rivals(names_of(found, model), found)
    return replace(outcome, names=names, laws=tuple(reported_laws(found, model.ids)), found=found, renamed=False)


def without_leftovers(outcome: Outcome, model: ForwardModel, known: set[str]) -> Outcome:
    """Without names that explain less beside laws than smooth functions leave of these; those `known` before stay."""
    small = {c.effect for c in outcome.names if (c.share or 0.0) < LAW_VERDICT.leftover} - known
    if not (outcome.laws and small):
        return outcome
    found = outcome.found.only([k for k, t in enumerate(outcome.found.terms) if t.group.effect not in small])
    names = tuple(c for c in outcome.names if c.effect not in small)
    return replace(outcome, names=names, laws=tuple(reported_laws(found, model.ids)), found=found)


def above_rounding(outcome: Outcome, model: ForwardModel, error: Array) -> Outcome:
    """Without the laws that stay below the error (C, n) that rounding leaves in means, a function of the reading too,
    or that only values show at which they do."""
    if not np.any(error):
        return outcome
    found, least = outcome.found, LAW_VERDICT.overshoot * error
    terms = list(found.terms)
    mean, _ = found.whitened().posterior(terms)
    columns = np.concatenate([found.problem.free, raw_columns(found.problem, terms)])
    left = found.residual - np.tensordot(mean, columns, 1)
    # a law of one function of the reading explains the other as well, so the error counts as noise in full
    scale = np.hypot(found.problem.floor * found.noise.factor[:, None], error)
    small = set()
    for k, one in effects_of(found).items():
        gained = ((left + one) ** 2 - left**2) / scale**2
        if gained[np.abs(one) > least].sum() < 2.0 * LAW_SEARCH.gain:
            small.add(k)
    if not small:
        return outcome
    found = found.only([k for k in range(len(terms)) if k not in small])
    return replace(outcome, laws=tuple(reported_laws(found, model.ids)), found=found)


def _as_slow(found: Found, k: int) -> bool:
    """Whether a term may be a random walk of a zero offset."""
    if effect := found.terms[k].group.effect:
        return library.get(effect).slow
    if not all(name in SLOW or lag_of(name) for name in found.terms[k].group.depends_on):
        return False
    # at one inclination an element of the load matrix is an offset: what may be one is judged as one
    return any(group.place in OFFSETS for group in found.class_of(k))


def explains_nothing(floor: Array, outcome: Outcome, before: Array, after: Array) -> bool:
    """Whether nearly all of a misfit larger than the noise is left on the channels that the laws act on."""
    sigma = np.sqrt(np.mean((outcome.found.noise.factor[:, None] * floor) ** 2, axis=1))
    acts = np.any([np.any(one.effect != 0, axis=1) for one in outcome.laws], axis=0)
    had, left = (float(np.mean((one[acts] / sigma[acts, None]) ** 2)) - 1.0 for one in (before, after))
    return had > 1.0 and left > (1.0 - LAW_VERDICT.least_explained) * had
