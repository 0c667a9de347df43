"""Edges: several steps, ramps and decays in one session, found together.

One edge of several explains little beside noise that wanders, which takes the others: taken one by one beside such
noise none is worth its claim. So they are sought beside the floor, each put again where it does best beside the others,
and what was found competes with all else by evidence with the noise learnt. Steps over other covariates are among them:
a step by the temperature is many in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import SETS_IN, Bases, LawGroup, each_place
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.onsets_policy import EDGES
from highside.diagnosis.laws.policy import LAW_GROUPS, LAW_SEARCH
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.variants import moved
from highside.physics.covariates import COVARIATES, FILTERED
from highside.physics.law import Axis
from highside.physics.law_functions import Function

STEPS = ("step",)


def is_edge(group: LawGroup, kinds: Sequence[str] = SETS_IN) -> bool:
    """Whether a group is one step, ramp or decay."""
    return len(group.axes) == 1 and len(group.axes[0].functions) == 1 and group.axes[0].functions[0].kind in kinds


def steps_over_others(problem: LawProblem) -> Iterator[LawGroup]:
    """Steps over whatever varies beside time and does not come round; a temperature that lags is as good as time."""
    bases = Bases(problem)
    for units in each_place(problem.places):
        if len(units) > 1 or not units[0].channels or units[0].place in ("matrix", "timing"):
            continue
        found = []
        for name, values, distinct in bases.varying(units):
            known = COVARIATES.get(name)
            around = name == "tf_fraction" or (known is not None and known.periodic)
            if name not in ("time", *FILTERED) and distinct > LAW_GROUPS.few and not around:
                found.append((name, values))
        for name, values in found:
            knots = _knots(values)
            low, high = float(values.min()), float(values.max())
            for at in knots:
                axis = Axis(name, low, high, (Function("step", (float(at),)),))
                yield bases.group(units, (axis,), np.zeros(1), len(knots) * len(found))


def _knots(values: Array) -> Array:
    """Places between values at which a step is tried."""
    edges = np.unique(values)
    middle = (edges[1:] + edges[:-1]) / 2
    return np.asarray(middle[np.unique(np.linspace(0, middle.size - 1, EDGES.steps_over).astype(int))])


def several_edges(
    problem: LawProblem, groups: Sequence[LawGroup], residual: Array
) -> Iterator[Iterator[list[LawTerm]]]:
    """Runs of sets of edges that explain a residual beside the floor, one more from set to set: of steps in time alone,
    of these and steps over all else, then of all kinds."""
    edges = [g for g in groups if not g.effect and is_edge(g)]
    others = list(steps_over_others(problem))
    whitener = Whitener(problem, LawNoise.floor_alone(problem))
    steps = [g for g in edges if is_edge(g, STEPS)]
    for tried in (steps, [*steps, *others], [*edges, *others]):
        if tried:
            yield _one_more(Whitened(Families(problem, tried), whitener, residual))


def _one_more(white: Whitened) -> Iterator[list[LawTerm]]:
    terms: list[LawTerm] = []
    while len(terms) < EDGES.most:
        gains, priors = white.scores(terms, within=0.0)
        best = int(np.argmax(gains))
        if gains[best] < LAW_SEARCH.gain:
            return
        more = LawTerm(white.families.groups[best], priors[best])
        terms = _settled(white, [*terms, _between(white, terms, more)])
        yield terms


def _settled(white: Whitened, terms: list[LawTerm]) -> list[LawTerm]:
    """Each edge where it does best beside the others, until none moves."""
    terms = list(terms)
    for _ in range(EDGES.rounds):
        before = {t.group for t in terms}
        for k in range(len(terms)) if len(terms) > 1 else ():
            others = [t for i, t in enumerate(terms) if i != k]
            gains, priors = white.scores(others, within=0.0)
            best = int(np.argmax(gains))
            own = _gain_of(white, others, [terms[k].group])
            if gains[best] > own[0][0] + LAW_SEARCH.rival_gain:
                terms[k] = LawTerm(white.families.groups[best], priors[best])
            terms[k] = _between(white, others, terms[k])
        if {t.group for t in terms} == before:
            break
    return terms


def _between(white: Whitened, others: list[LawTerm], term: LawTerm) -> LawTerm:
    """The edge, or one of those between the places that are tried."""
    near = [term.group, *moved(white.families.problem, term.group)]
    gains, priors = _gain_of(white, others, near)
    best = int(np.argmax(gains >= float(gains.max()) - LAW_SEARCH.tie))
    return LawTerm(near[best], priors[best])


def _gain_of(white: Whitened, others: list[LawTerm], groups: list[LawGroup]) -> tuple[Array, list[Prior]]:
    """(G,) nats that these groups gain beside the others, and their priors."""
    return white.of_groups(groups).scores(others, within=np.inf)
