"""Onsets: laws of one quantity that act from some time of a session on, found as such.

What acts for a part of a session is found as something else first: as a surface over time and what runs with it, as two
laws, as errors of the set angles. So each law of one quantity is tried from each time on. Under noise without a memory
the inner products of what acts from a time on are sums over the values after it: those of all times take one pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.evidence import LawTerm, Whitened, inverse_of, prior_of, raw_columns
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import Bases, LawGroup, axis_of, each_place
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.onsets_policy import ONSETS
from highside.diagnosis.laws.policy import LAW_GROUPS, LAW_SEARCH
from highside.diagnosis.laws.priors import Prior, best_priors, bound_of, shown_of
from highside.diagnosis.laws.problem import CovariateValues, LawProblem, functions_of
from highside.diagnosis.laws.variants import ONSET, onset_knots
from highside.physics.effects import all_effects
from highside.physics.law import Axis
from highside.physics.law_functions import Function


def sets_in(group: LawGroup) -> bool:
    """Whether a group is a law of something that acts from some time on."""
    return len(group.axes) > 1 and group.axes[-1].covariate == "time" and group.axes[-1].functions[0].kind == ONSET


def lasts(group: LawGroup) -> bool:
    """Whether a group is a law of one quantity, or an effect of the library, that no time makes."""
    if group.effect:
        effect = all_effects().get(group.effect)
        timed = effect is None or effect.slow or "t_s" in effect.needs or any(p.epoch for p in effect.parameters)
        return not timed
    return len(group.axes) == 1 and "time" not in group.depends_on


def from_time(problem: LawProblem, base: LawGroup, at: float, tries: float) -> LawGroup:
    """A law from a time on."""
    time = problem.covariates["time"]
    step = Axis("time", float(time.min()), float(time.max()), (Function(ONSET, (at,)),))
    return replace(
        base, axes=(*base.axes, step), basis=base.basis * functions_of(problem.covariates, step)[0], tries=tries
    )


def lasting(problem: LawProblem) -> list[LawGroup]:
    """Laws of one quantity in each place, each with a constant: what is free takes the mean of a law, but not of one
    that acts for a part of the session."""
    bases, made = Bases(problem), []
    for units in each_place(problem.places):
        if not any(unit.channels for unit in units):
            continue
        for name, values, distinct in bases.varying(units):
            if name in ("time", "tf_fraction") or distinct < LAW_GROUPS.few:
                continue
            count = min(LAW_GROUPS.cosines, distinct - 1)
            turns = min(LAW_GROUPS.orders, max(1, distinct // 2))
            axis, order = axis_of(name, values, count, constant=True, turns=turns)
            made.append(bases.group(units, (axis,), order))
    return made


Gained = tuple[float, LawTerm]


class Onsets:
    """Every law of one quantity from every time on, beside chosen terms, under one noise without a memory."""

    def __init__(self, problem: LawProblem, whitener: Whitener, residual: Array) -> None:
        self.problem, self.bases = problem, lasting(problem)
        self.knots = onset_knots(problem.t_s, ONSETS.values, ONSETS.before)
        self._numbers = {(*base.kind[:2], base.axes): i for i, base in enumerate(self.bases)}
        self._raw, self._whitener, self._residual = residual, whitener, whitener.white(residual[None])
        self._free = whitener.white(problem.free)
        self._always = _by_time(np.concatenate([self._free, self._residual]))
        self._white: dict[int, Array] = {}
        self._known: dict[int, tuple[Array, Array]] = {}
        """of each law from the times that are tried: its inner products, those with what is free and the residual"""

    def best(self, terms: Sequence[LawTerm]) -> list[Gained]:
        """Each law from its best time on beside the terms, and nats that it gains; the best first, none far behind."""
        found = self._scored(terms, range(len(self.bases)), self.knots)
        if not found:
            return []
        return sorted([*found[1:], self._settled(terms, found[0])], key=lambda one: -one[0])

    def moved(self, terms: Sequence[LawTerm], term: LawTerm) -> LawTerm:
        """A law that sets in, from the time on that is the best beside the terms; as it is if it is none of these."""
        at = self._number(term.group)
        found = [] if at is None else self._scored(terms, [at], self.knots)
        return self._settled(terms, found[0])[1] if found else term

    def instead(self, terms: Sequence[LawTerm], term: LawTerm) -> LawTerm:
        """The law from a time on that is the best beside the terms, in the place of one: what was taken first explains
        a part of what was taken next."""
        found = self.best(terms) if self.problem.every_pair else []
        return found[0][1] if found else self.moved(terms, term)

    def in_place_of(self, terms: Sequence[LawTerm], term: LawTerm) -> list[LawTerm]:
        """What else may set in in the place of a law that does: of each other quantity the law from its best time on
        beside the terms, however far behind the best it is in this noise."""
        place, own = term.group.kind[:2], term.group.axes[:-1]
        numbers = [i for i, base in enumerate(self.bases) if base.kind[:2] == place and base.axes != own]
        each = [self._scored(terms, [i], self.knots) for i in numbers]
        return [self._settled(terms, found[0])[1] for found in each if found]

    def _number(self, late: LawGroup) -> int | None:
        """Which of the laws a law from a time on is; None of one that another search has found."""
        return self._numbers.get((*late.kind[:2], late.axes[:-1]))

    def _settled(self, terms: Sequence[LawTerm], best: Gained) -> Gained:
        """The law from a time on between those that are tried."""
        at = self._number(best[1].group)
        assert at is not None
        tried, own = self.knots, float(best[1].group.axes[-1].functions[0].numbers[0])
        every = _boundaries(self.problem.t_s)
        k = int(np.searchsorted(tried, own))
        low, high = tried[max(k - 1, 0)], tried[min(k + 1, tried.size - 1)]
        near = every[(every > low) & (every < high) & (every != own)]
        found = self._scored(terms, [at], near) if near.size else []
        return self._to_the_row(terms, at, max([best, *found], key=lambda one: one[0]))

    def _to_the_row(self, terms: Sequence[LawTerm], number: int, best: Gained) -> Gained:
        """The law from a time on within a value that stands for many rows: it acts on a part of these."""
        known = self.problem.covariates
        spread = known.spread_of_times() if isinstance(known, CovariateValues) else None
        span = 0.0 if spread is None else ONSETS.span * float(np.quantile(spread, ONSETS.most_values))
        for _ in range(ONSETS.rounds_to_the_row if span else 0):
            own = float(best[1].group.axes[-1].functions[0].numbers[0])
            tried = own + span * np.linspace(-1.0, 1.0, ONSETS.in_a_value)
            late = [from_time(self.problem, self.bases[number], float(at), best[1].group.tries) for at in tried]
            white = Whitened(Families(self.problem, late), self._whitener, self._raw)
            gains, priors = white.scores(list(terms), within=np.inf)
            k = int(np.argmax(gains))
            # as it stands it is the one in the middle
            if np.isfinite(gains[k]):
                best = float(gains[k]), LawTerm(late[k], priors[k])
            span *= 2.0 / (ONSETS.in_a_value - 1)
        return best

    def _scored(self, terms: Sequence[LawTerm], which: Sequence[int], knots: Array) -> list[Gained]:
        beside = np.concatenate([self._free, self._whitener.white(raw_columns(self.problem, list(terms)))])
        flat, prior = flattened(beside), prior_of(self.problem, list(terms))
        inverse = inverse_of(flat @ flat.T, prior)
        coefficients = inverse @ (flat @ self._residual.reshape(-1))
        looked, chosen = [], _by_time(beside[len(self._free) :])
        for i in which:
            gram, free, across = self._inner(i, chosen, knots)
            others = np.concatenate([free[:, :, :-1], across], axis=2)
            left = gram - others @ inverse @ others.transpose(0, 2, 1)
            shown = shown_of(gram, left, free[:, :, -1] - others @ coefficients)
            looked.append((i, *shown, bound_of(*shown)))
        found: list[Gained] = []
        best, tried = 0.0, 2 * self.knots.size
        for i, gram, drive, bound in sorted(looked, key=lambda one: -float(one[3].max())):
            least = max(best - LAW_CLASS.same_confounded, 0.0) if best >= LAW_SEARCH.gain else LAW_SEARCH.gain
            near = np.flatnonzero(bound >= least + np.log(tried))
            if not near.size:
                continue
            orders = np.broadcast_to(self.bases[i].orders, (near.size, self.bases[i].size))
            gains, sizes, lengths = best_priors(gram[near], drive[near], orders, least + np.log(tried))
            k = int(np.argmax(gains))
            gain = float(gains[k] - np.log(tried))
            if gain >= least:
                group = from_time(self.problem, self.bases[i], float(knots[near[k]]), tried)
                found.append((gain, LawTerm(group, Prior(float(sizes[k]), float(lengths[k])))))
                best = max(best, gain)
        return sorted(found, key=lambda one: -one[0])

    def _inner(self, i: int, terms: Array, knots: Array) -> tuple[Array, Array, Array]:
        """Of a law from each time on the inner products (K, m, m) of its columns, (K, m, P + 1) with what is free and
        the residual, and (K, m, Q) with terms (n, C, Q)."""
        if i not in self._white:
            raw = raw_columns(self.problem, [LawTerm(self.bases[i], Prior(1.0, 1.0))])
            self._white[i] = _by_time(self._whitener.white(raw))
        white, known = self._white[i], self._known.get(i) if knots is self.knots else None
        if known is None:
            known = self._after(white, white, knots), self._after(white, self._always, knots)
            if knots is self.knots:
                self._known[i] = known
        return *known, self._after(white, terms, knots)

    def _after(self, white: Array, right: Array, knots: Array) -> Array:
        """(K, m, Q) inner products of columns (n, C, m) with others (n, C, Q) over the values after each time."""
        starts = np.searchsorted(self.problem.covariates["time"], knots)
        parts = np.empty((knots.size, white.shape[2], right.shape[2]))
        for k, (first, last) in enumerate(zip(starts, [*starts[1:], len(white)], strict=True)):
            own = white[first:last].reshape(-1, white.shape[2])
            parts[k] = own.T @ right[first:last].reshape(len(own), right.shape[2])
        return np.asarray(np.cumsum(parts[::-1], axis=0)[::-1])


def _by_time(rows: Array) -> Array:
    """(K, C, n) -> (n, C, K): what is summed over a stretch of time lies together."""
    return np.ascontiguousarray(rows.transpose(2, 1, 0))


def _boundaries(t_s: Array) -> Array:
    """Times between values."""
    t = np.unique(t_s - t_s[:1])
    return np.asarray((t[1:] + t[:-1]) / 2)


def begun(
    onsets: Onsets, whitened: Whitened, groups: Sequence[LawGroup], *, first_of_all: bool = False
) -> Iterator[tuple[list[LawTerm], list[LawGroup]]]:
    """Sets of terms under one noise, one more from set to set, of which one at least sets in midway; and what else may
    stand in their place. `whitened`: the other groups under the same noise, which are taken where they gain more; with
    `first_of_all` there are no sets where one of them gains most."""
    terms: list[LawTerm] = []
    others: list[LawGroup] = []
    while len(terms) < ONSETS.most:
        found = onsets.best(terms)
        gains, priors = whitened.scores(terms, least=LAW_SEARCH.gain, within=LAW_SEARCH.simpler)
        k = int(np.argmax(gains))
        late = found[0][0] if found else -np.inf
        if max(late, gains[k]) < LAW_SEARCH.gain:
            return
        # a law that acts all the time claims less
        ahead = late - gains[k] > (0.0 if "time" in groups[k].depends_on else LAW_SEARCH.variant)
        if first_of_all and not (terms or ahead):
            return
        if ahead:
            others += [term.group for _, term in found[1:]]
        terms = [*terms, found[0][1] if ahead else LawTerm(groups[k], priors[k])]
        for _ in range(ONSETS.rounds if len(terms) > 1 else 0):
            for i, term in enumerate(terms):
                if sets_in(term.group):
                    terms[i] = onsets.instead([t for j, t in enumerate(terms) if j != i], term)
        if any(sets_in(term.group) for term in terms):
            yield list(terms), others
