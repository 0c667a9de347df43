"""The search: which laws, beside which noise. Several starts; the highest evidence stays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.between import with_plain_temperature
from highside.diagnosis.laws.classes import classes_of
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.edges import several_edges
from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.few_values_policy import FEW_VALUES
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.onsets import Onsets, begun, lasts
from highside.diagnosis.laws.other_than_time import one_for_several, without_time
from highside.diagnosis.laws.pairs import elsewhere, further_pairs
from highside.diagnosis.laws.policy import LAW_SEARCH
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.products import best_products, is_more_than
from highside.diagnosis.laws.state import State, names_alone, which, worth
from highside.diagnosis.laws.steps import Steps


class Search(Steps):
    """One session's search."""

    def of_residual(self, residual: Array) -> Search:
        """The same search of another residual (C, n); groups and all that was whitened are shared."""
        made = copy(self)
        made.problem = replace(self.problem, residual=residual)
        made._tried = set()
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
        quiet = self._whitened(State([], floor, 0.0, self.problem.residual))
        # where the floor alone shows nothing, no noise shows more
        gains, _ = quiet.scores([], least=LAW_SEARCH.gain, within=LAW_SEARCH.simpler)
        if float(np.max(gains, initial=-np.inf)) < LAW_SEARCH.gain:
            return self._found(first)
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
            one = self._from_curves(self._from_between(one))
        elif self._variants:
            one = self._from_pairs(one)
        one = self._from_its_noise(one)
        one = self._from_products(one) if self._variants else one
        if not self._variants:
            return self._found(one)
        if self.problem.every_pair and one.noise.remembers:
            one = self._from_edges(one)
        one = one if self._needs_no_onset(one) else self._from_onsets(one)
        return self._found(self._ended(self._without_time(self._beside_less_noise(one))))

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

    def _measured(self, state: State) -> bool:
        """Whether the floor is one of noise, and not of the readings' rounding: beside that alone all shows, and means
        nothing."""
        return float(state.noise.times_the_floor(self.problem).max()) < FEW_VALUES.unmeasured

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

    def _needs_no_onset(self, state: State) -> bool:
        """Whether, of many values, one curve of one quantity or one name does it, or several that leave nothing but the
        floor: what set in midway would be a surface over time, several curves, or leave more. That the one set in was
        tried."""
        plain = all(lasts(term.group) for term in state.terms)
        return not self.problem.every_pair and plain and (self._quiet(state) or len(state.terms) == 1)

    def _quiet(self, state: State) -> bool:
        """Whether the noise exceeds the floor of values that are independent by no more than chance."""
        chance = LAW_SEARCH.at_the_floor / np.sqrt(2.0 * self.problem.n)
        return bool(state.noise.times_the_floor(self.problem).max() <= 1.0 + min(chance, LAW_SEARCH.quiet))

    def _from_products(self, best: State) -> State:
        """What was found, or what begins with a product of one function of each of two quantities and does better:
        beside the floor, where noise may hold all of it, and beside what was found."""
        if not self.problem.every_pair or self._quiet(best):
            return best
        floor = State([], LawNoise.floor_alone(self.problem), -np.inf, self.problem.residual)
        start, least = best, best.less_tries
        for state in (floor, best) if self._measured(best) else (best,):
            for group in best_products(self._whitened(state), state.terms, self.groups):
                made = self._with_product(state.terms, group)
                # beside a law of one of its quantities it may follow what the functions of that leave
                margin = LAW_SEARCH.simpler if any(is_more_than(group, t.group) for t in state.terms) else 0.0
                if made.less_tries - margin > least:
                    start, least = made, made.less_tries - margin
        if start is best:
            return best
        start = self._simpler(start)
        self._tried.update(t.group for t in start.terms)
        self.groups = [*self.groups, *(t.group for t in start.terms if t.group not in self.groups)]
        self.families = self.families.of(self.groups, self.families.barred)
        made = self._proved(self._grown(self._proved(start), relearn=True))
        return made if made.less_tries > best.less_tries + (start.less_tries - least) else best

    def _from_between(self, best: State) -> State:
        """What was found, or what begins beside white noise between the floor and what was learnt, and does better."""
        learnt = best.noise.times_the_floor(self.problem)
        if self.problem.n > FEW_VALUES.most or float(learnt.max()) < FEW_VALUES.far:
            return best
        for power in FEW_VALUES.between:
            noise = replace(LawNoise.floor_alone(self.problem), factor=learnt**power)
            start = self._grown(State([], noise, -np.inf, self.problem.residual), relearn=False)
            state = self._learn(start.terms, self.problem.residual)
            if state.worth < best.worth or which(state.terms) == which(best.terms):
                continue
            made = self._proved(self._grown(self._proved(state), relearn=True))
            still = float(made.noise.times_the_floor(self.problem).max()) >= FEW_VALUES.far
            if not still or min(self._costs(made), default=0.0) >= FEW_VALUES.gain:
                best = max((best, made), key=lambda s: s.worth)
            if best is made and not still:
                break
        return self._step_by_step(best) if self._measured(best) and not best.terms else best

    def _from_curves(self, best: State) -> State:
        """What was found, or what begins with laws of one covariate each and does better.

        Taken one by one a product explains more than either of two laws, and bars both. Without a product, and with
        nothing left but the floor, nothing can do better; and a floor that is rounding alone shows nothing."""
        product, noise = any(len(term.group.axes) > 1 for term in best.terms), best.noise
        learnt = float(noise.times_the_floor(self.problem).max())
        # of many values the colour and the size of the noise are known from more than what is left
        unsure = noise.remembers or learnt > 1.0
        possible = product or unsure if self.problem.every_pair else product and not self._quiet(best)
        if not possible or learnt >= FEW_VALUES.unmeasured:
            return best
        return self._begun_without(best, lambda group: len(group.axes) > 1)

    def _from_single_curves(self, best: State) -> State:
        """What was found, or what begins with laws of one curve each and does better.

        A lean of the level has two curves: taken one by one it explains more than either of two sensors' in its place,
        and bars both."""
        if len(best.terms) < 2 or all(len(term.group.units) == 1 for term in best.terms):
            return best
        return self._begun_without(best, lambda group: len(group.units) > 1)

    def _begun_without(self, best: State, barred: Callable[[LawGroup], bool]) -> State:
        """What was found, or what begins without some groups, goes on with all of them, and does better."""
        before, self.families = self.families.barred, self.families.without(barred)
        floor = LawNoise.floor_alone(self.problem)
        start = self._grown(State([], floor, -np.inf, self.problem.residual), relearn=False)
        state = self._proved(self._grown(self._learn(start.terms, self.problem.residual), relearn=True))
        self.families = self.families.of(self.groups, before)
        made = self._proved(self._grown(state, relearn=True))
        return max((best, made), key=lambda s: s.worth)

    def _from_pairs(self, best: State) -> State:
        """What was found, or products of what it follows and anything else that do better."""
        for _ in range(LAW_SEARCH.rounds):
            if not (more := further_pairs(self.problem, self.groups, best.terms)):
                break
            self.groups = [*self.groups, *more]
            self.families = self.families.of(self.groups, self.families.barred)
            made = self._proved(self._grown(self._proved(self._settled(best)), relearn=True))
            if made.worth <= best.worth:
                break
            best = made
        return best

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

    def _from_its_noise(self, best: State) -> State:
        """What was found, or what begins anew without any law beside the noise that was learnt last, and does better:
        beside the noise of a session without laws a surface is worth less than several curves in its place."""
        while len(best.terms) > 1:
            start = self._grown(replace(best, terms=[], evidence=-np.inf), relearn=False)
            if which(start.terms) == which(best.terms):
                break
            state = self._learn(start.terms, self.problem.residual)
            if state.worth <= best.worth:
                break
            made = self._proved(self._grown(self._proved(state), relearn=True))
            best = max((best, made), key=lambda s: s.worth)
            if best is not made:
                break
        return best

    def _step_by_step(self, nothing: State) -> State:
        """Laws, each chosen by its evidence with the noise learnt again, where no other start finds any."""
        varied = self._tried
        # what was varied beside other noise is varied again
        self._tried = set()
        state = nothing
        while len(state.terms) < LAW_SEARCH.most and (further := self._next_by_evidence(state)) is not None:
            state = further
        if state is not nothing:
            state = self._proved(self._grown(self._proved(state), relearn=True))
        self._tried = varied
        return state if self._worth_it_beside_what_stays(state) else nothing

    def _next_by_evidence(self, state: State) -> State | None:
        """The state with one law more: of those that gain most beside less noise the one of the highest evidence with
        the noise learnt again. None where that is not worth a law, or little noise is left."""
        learnt = state.noise.times_the_floor(self.problem)
        if float(learnt.max()) < FEW_VALUES.far:
            return None
        tried: dict[LawGroup, State] = {}
        for power in FEW_VALUES.powers:
            noise = replace(LawNoise.floor_alone(self.problem), factor=learnt**power)
            gains, priors = self._whitened(replace(state, noise=noise)).scores(state.terms)
            gains = self._each_name_once(gains, state.terms)
            for i in np.argsort(-gains)[: FEW_VALUES.first]:
                if self.groups[i] not in tried and gains[i] >= LAW_SEARCH.gain:
                    terms = [*state.terms, LawTerm(self.groups[i], priors[i])]
                    tried[self.groups[i]] = self._learn(terms, self.problem.residual)
        likeliest = sorted(tried.values(), key=lambda s: -s.evidence)[: FEW_VALUES.settled]
        best = max(map(self._settled, likeliest), key=lambda s: s.less_tries, default=state)
        return best if best.less_tries - state.less_tries >= LAW_SEARCH.gain - LAW_SEARCH.each else None

    def _settled(self, state: State) -> State:
        """A state whose terms are refitted and varied beside its own noise, while that does better."""
        for _ in range(LAW_SEARCH.rounds):
            terms = self._varied(state, self._refitted_with_rivals(self._whitened(state), state.terms))
            other = self._learn(terms, self.problem.residual)
            if other.less_tries <= state.less_tries:
                break
            state = other
        return state

    def _worth_it_beside_what_stays(self, state: State) -> bool:
        """Whether each law, on whose channels noise far above the floor stays, is worth more than others must be."""
        far = state.noise.times_the_floor(self.problem) >= FEW_VALUES.far
        costs = zip(state.terms, self._costs(state), strict=True)
        return all(cost >= FEW_VALUES.gain for term, cost in costs if far[list(term.group.channels)].any())

    def _from_edges(self, best: State) -> State:
        """What was found, its noise taking something slow, or edges that do better, and what goes with them."""
        first = best
        for k, run in enumerate(several_edges(self.problem, self.groups, self.problem.residual)):
            before = -np.inf
            for terms in run:
                state = self._learn(terms, self.problem.residual)
                best = max((best, state), key=lambda s: s.worth)
                if state.worth < before or not state.noise.remembers:
                    break
                before = state.worth
            if k > 0 and not best.noise.remembers:
                break
        if best is first:
            return first
        self._tried.update(t.group for t in best.terms)
        self.groups = [*self.groups, *(t.group for t in best.terms if t.group not in self.groups)]
        self.families = self.families.of(self.groups, self.families.barred)
        return max((first, self._proved(self._grown(self._proved(best), relearn=True))), key=lambda s: s.worth)

    def _from_onsets(self, first: State) -> State:
        """What was found, or what begins with a law that sets in midway and does better."""
        floor = LawNoise.floor_alone(self.problem)
        best, groups = first, list[LawGroup]()
        own = [] if first.noise.remembers else [first.noise]
        for noise in [floor, *own] if self._measured(first) or not own else own:
            state = State([], noise, -np.inf, first.residual)
            onsets = Onsets(self.problem, Whitener(self.problem, noise), first.residual)
            if not onsets.knots.size:
                return first
            # of many values the colour of the noise is known: what sets in, where nothing was found, is found first
            first_of_all = not (first.terms or self.problem.every_pair) and first.noise.remembers
            for terms, others in begun(onsets, self._whitened(state), self.groups, first_of_all=first_of_all):
                state = self._learn(terms, self.problem.residual)
                if state.less_tries > best.less_tries:
                    best, groups = state, [t.group for t in terms] + others
        if best is first:
            return first
        self._tried.update(t.group for t in best.terms)
        self.groups = [*self.groups, *(g for g in dict.fromkeys(groups) if g not in self.groups)]
        self.families = self.families.of(self.groups, self.families.barred)
        made = self._proved(self._grown(self._proved(best), relearn=True))
        return max((first, made), key=lambda s: s.less_tries)

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
        return Found(
            self.problem,
            tuple(terms),
            state.noise,
            state.evidence,
            own_gains,
            classes_of(self._whitened(state), terms),
            state.residual,
            self.families,
        )
