"""The search: which laws, beside which noise. Several starts; the highest evidence stays."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.between import with_plain_temperature
from highside.diagnosis.laws.classes import classes_of
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.few_values_policy import FEW_VALUES
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.onsets import lasts
from highside.diagnosis.laws.other_than_time import one_for_several, without_time
from highside.diagnosis.laws.pairs import elsewhere
from highside.diagnosis.laws.policy import LAW_SEARCH
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.starts import Starts
from highside.diagnosis.laws.state import State, names_alone, which, worth


class Search(Starts):
    """One session's search."""

    def of_residual(self, residual: Array) -> Search:
        """The same search of another residual (C, n); groups and all that was whitened are shared."""
        made = copy(self)
        made.problem = replace(self.problem, residual=residual)
        made._tried, made._ends = set(), []
        return made

    def without_effects(self) -> Search:
        """The same search among laws alone; what was learnt and whitened is shared."""
        made = copy(self)
        made.families = self.families.without(lambda group: bool(group.effect))
        return made

    def without_products(self) -> Search:
        """The same search among laws of one quantity each, and names."""
        made = copy(self)
        made.families, made._tried = self.families.without(lambda group: len(group.axes) > 1), set()
        return made

    def beside_names(self, names: Sequence[LawGroup]) -> Search:
        """The same search with further groups, effects of the library."""
        made = copy(self)
        made.groups, made._tried = [*self.groups, *names], set()
        made.families = self.families.of(made.groups)
        return made

    def strongest(self) -> Found:
        """The one law that explains most beside the floor, with the noise learnt beside it; none that explains little
        of the misfit: what it does beyond first order is then no more than a part of what others do."""
        floor = State([], LawNoise.floor_alone(self.problem), -np.inf, self.problem.residual)
        white = self._whitened(floor)
        gains, priors = white.scores([], least=LAW_SEARCH.gain, within=LAW_SEARCH.simpler)
        best = self._simplest(gains)
        whole = 0.5 * float(np.sum((self.problem.residual / self.problem.floor) ** 2))
        terms = [LawTerm(self.groups[best], priors[best])] if gains[best] >= LAW_SEARCH.dominant * whole else []
        found = self._found(self._learn(self._varied(floor, terms), self.problem.residual))
        self._tried = set()
        return found

    def run(self, known: Found | None = None) -> Found:
        """All starts; the highest evidence stays.

        Names that are `known` beforehand, beside which nothing gains, are the answer once a start finds them again. A
        search that is far behind what is known after its first starts goes no further.
        """
        floor = LawNoise.floor_alone(self.problem)
        first = self._learn([], self.problem.residual)
        known_floor = self._measured(first) or self.problem.n <= FEW_VALUES.most
        # where a floor alone shows nothing, no noise shows more
        if known_floor and not self._shows(State([], floor, 0.0, self.problem.residual)):
            return self._found(first)
        if not known_floor:
            # beside rounding all shows, and means nothing; white noise is known from many values
            alone = self._proved(self._grown(first, relearn=True))
            if self._plain_beside_white(alone):
                return self._found(self._without_time(alone))
        # beside the floor first: what is whitened under it is there
        other = self._grown(State([], floor, -np.inf, self.problem.residual), relearn=False)
        two = self._learn(other.terms, self.problem.residual)
        again = known is not None and names_alone(known.terms) == names_alone(two.terms) != set()
        if (known is not None and again and known.next_gain < LAW_SEARCH.gain) or self._at_the_floor(two, first):
            proved = self._proved(two)
            if which(proved.terms) == which(two.terms):
                # nothing is left that another start could find
                return self._found(self._without_time(proved))
        one = self._proved(self._grown(first, relearn=True))
        # noise that explains more than all of its laws needs no further look
        if two.worth >= one.worth and which(two.terms) != which(one.terms):
            two = self._proved(self._grown(self._proved(two), relearn=True))
            one = max((one, two), key=lambda s: s.worth)
        if known is not None and one.worth < worth(known.evidence, known.terms) - LAW_SEARCH.hopeless:
            return self._found(one)
        one = self._from_curves(self._from_single_curves(one))
        if self.problem.every_pair:
            between = self._from_between(one)
            # from what was found already curves have begun
            one = between if between is one else self._from_curves(between)
        elif self._variants:
            one = self._from_pairs(one)
        one = self._on_all_axes(one) if self.problem.every_pair and self._variants else one
        one = self._from_its_noise(one)
        one = self._from_products(one) if self._variants else one
        if not self._variants:
            return self._found(one)
        if self.problem.every_pair and one.noise.remembers:
            one = self._from_edges(one)
        one = one if self._needs_no_onset(one) else self._from_onsets(one)
        one = self._from_exchanges(one) if self.problem.every_pair else one
        return self._found(self._ended(self._without_time(self._beside_less_noise(one))))

    def _shows(self, state: State) -> bool:
        """Whether any group gains what a law must beside the noise of a state."""
        gains, _ = self._whitened(state).scores([], least=LAW_SEARCH.gain, within=LAW_SEARCH.simpler)
        return float(np.max(gains, initial=-np.inf)) >= LAW_SEARCH.gain

    def resumed(self, found: Found) -> Found:
        """What was found goes on where groups have joined since, or what is taken out beyond first order has changed:
        or what begins anew beside its noise does, if it is worth more."""
        if not found.terms:
            return self.run()
        one = self._settled(self._learn(list(found.terms), self.problem.residual))
        one = self._proved(self._grown(self._proved(one), relearn=True))
        start = self._grown(replace(one, terms=[], evidence=-np.inf), relearn=False)
        if which(start.terms) != which(one.terms):
            two = self._settled(self._learn(start.terms, self.problem.residual))
            if two.worth > one.worth - LAW_SEARCH.gain:
                one = max((one, self._proved(self._grown(self._proved(two), relearn=True))), key=lambda s: s.worth)
        return self._found(self._ended(self._without_time(self._beside_less_noise(one))))

    def _ended(self, state: State) -> State:
        """What was found; of few values nothing, where laws are worth little beside noise far above the floor: a few of
        them explain most of what is there, whatever it is."""
        far = float(state.noise.times_the_floor(self.problem).max())
        few = self.problem.n <= FEW_VALUES.most and FEW_VALUES.far <= far < FEW_VALUES.unmeasured
        if not few or any(term.group.effect for term in state.terms) or self._worth_it_beside_what_stays(state):
            return state
        return self._learn([], self.problem.residual)

    def _at_the_floor(self, state: State, nothing: State) -> bool:
        """Whether one curve or two leave the floor alone, and are worth what laws must be beside noise alone. Curves in
        the place of a product, or of what sets in midway, leave more."""
        terms = state.terms
        if not 1 <= len(terms) <= LAW_SEARCH.curves_at_the_floor or state.noise.remembers:
            return False
        plain = all(len(t.group.axes) == 1 for t in terms) and (
            len(terms) == 1 or not any("time" in t.group.depends_on or len(t.group.units) > 1 for t in terms)
        )
        return bool(plain and self._quiet(state) and state.evidence - nothing.evidence >= LAW_SEARCH.gain * len(terms))

    def _plain_beside_white(self, state: State) -> bool:
        """Whether there is nothing, or names alone, or one curve, beside noise that is the same in all values."""
        white = not (state.noise.remembers or state.noise.jitter.any())
        plain = not state.terms or bool(names_alone(state.terms)) or len(state.terms) == 1
        return white and plain and all(lasts(term.group) for term in state.terms if not term.group.effect)

    def _needs_no_onset(self, state: State) -> bool:
        """Whether, of many values, one curve of one quantity or one name does it, or several that leave nothing but the
        floor: what set in midway would be a surface over time, several curves, or leave more. That the one set in was
        tried."""
        plain = all(lasts(term.group) for term in state.terms)
        return not self.problem.every_pair and plain and (self._quiet(state) or len(state.terms) == 1)

    def _beside_less_noise(self, best: State) -> State:
        """What was found, or its laws as large as they are beside the floor alone, with less noise learnt and of higher
        evidence: noise that took the place of half of a law leaves it too small for all of it."""
        if not best.terms or self._quiet(best):
            return best
        state = replace(best, noise=LawNoise.floor_alone(self.problem))
        for _ in range(LAW_SEARCH.rounds):
            state = self._learn(self._resized(state), self.problem.residual)
        return self._proved(self._settled(state)) if state.evidence > best.evidence + LAW_SEARCH.rival_gain else best

    def _resized(self, state: State) -> list[LawTerm]:
        """The terms, each beside the others as its best prior under this noise has it."""
        terms = list(state.terms)
        for k, term in enumerate(terms):
            others = [t for i, t in enumerate(terms) if i != k]
            gains, priors = self._whitened(state).of_groups([term.group]).scores(others, within=np.inf)
            terms[k] = LawTerm(term.group, priors[0]) if np.isfinite(gains[0]) else term
        return terms

    def beside(self, fixed: Sequence[LawGroup], terms: Sequence[LawTerm]) -> Found:
        """These groups and the laws of another search; of them stays what is worth it, with the noise learnt again."""
        kept = [t.group for t in terms if not t.group.effect]
        trial = [LawTerm(g, Prior(1.0, 1.0)) for g in (*fixed, *map(self._like, kept))]
        if more := [t.group for t in trial if t.group not in self.groups]:
            self.groups = [*self.groups, *more]
            self.families = self.families.of(self.groups, self.families.barred)
        state = self._learn(trial, self.problem.residual)
        for _ in range(LAW_SEARCH.rounds):
            white = self._whitened(state)
            for k in range(len(trial)):
                gains, priors = white.scores([t for i, t in enumerate(trial) if i != k])
                own = self.groups.index(trial[k].group)
                prior = priors[own] if np.isfinite(gains[own]) else trial[k].prior
                trial = [LawTerm(t.group, prior) if i == k else t for i, t in enumerate(trial)]
            state = self._learn(trial, self.problem.residual)
        return self._found(self._without_time(self._proved(state)))

    def _like(self, group: LawGroup) -> LawGroup:
        """The group of this search that is the one of another, of the same label and functions; if none is, the same
        functions in the places of this one."""
        alike = (own for own in self.groups if own.label == group.label and own.axes == group.axes)
        places = {(place.place, place.channel): place for place in self.problem.places}
        here = replace(group, units=tuple(places.get((unit.place, unit.channel), unit) for unit in group.units))
        return next(alike, here)

    def _without_time(self, state: State) -> State:
        """The laws that follow the session's time as laws of something else, where that does as well; so with lags."""
        whitener = Whitener(self.problem, state.noise)
        one = one_for_several(self.problem, whitener, state.residual, self.groups, state.terms)
        if one is not None:
            self.groups = [*self.groups, *(t.group for t in one if t.group not in self.groups)]
            self.families = self.families.of(self.groups, self.families.barred)
            other = self._proved(self._grown(self._settled(self._learn(one, self.problem.residual)), relearn=True))
            if other.worth > state.worth - LAW_CLASS.same_confounded:
                return other
        terms = without_time(self.problem, whitener, state.residual, self.groups, state.terms)
        terms = with_plain_temperature(self.problem, whitener, state.residual, terms)
        if which(terms) == which(state.terms):
            return state
        self.groups = [*self.groups, *(t.group for t in terms if t.group not in self.groups)]
        self.families = self.families.of(self.groups, self.families.barred)
        other = self._learn(terms, self.problem.residual)
        # of two that followed the time the functions of one quantity may leave the other nothing
        return self._proved(other) if other.evidence > state.evidence - LAW_CLASS.same_confounded else state

    def _found(self, state: State) -> Found:
        if not self.problem.every_pair and (more := elsewhere(self.problem, self.groups, state.terms)):
            self.groups = [*self.groups, *more]
            self.families = self.families.of(self.groups, self.families.barred)
        costs = self._costs(state)
        order = sorted(range(len(costs)), key=lambda k: -costs[k])
        terms = [state.terms[k] for k in order]
        own_gains = tuple(costs[k] for k in order)
        near = [end.terms for end in self._ends if end.less_tries >= state.less_tries - LAW_CLASS.same]
        return Found(
            self.problem,
            tuple(terms),
            state.noise,
            state.evidence,
            own_gains,
            classes_of(self._whitened(state), terms, near),
            state.residual,
            self.families,
        )
