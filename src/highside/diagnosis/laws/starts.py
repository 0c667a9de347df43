"""Where a search begins again: with single curves, beside other noise, with products, edges, onsets, without what was
found first. Each start goes on from what was found so far, and returns it where nothing does better."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.laws.edges import several_edges
from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.few_values_policy import FEW_VALUES
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.onsets import Onsets, begun, sets_in
from highside.diagnosis.laws.pairs import further_pairs, on_all_axes
from highside.diagnosis.laws.policy import LAW_SEARCH
from highside.diagnosis.laws.products import best_products, is_more_than
from highside.diagnosis.laws.state import State, which
from highside.diagnosis.laws.steps import Steps


class Starts(Steps):
    """The starts of one session's search."""

    def _measured(self, state: State) -> bool:
        """Whether the floor is one of noise, and not of the readings' rounding: beside that alone all shows, and means
        nothing."""
        return float(state.noise.times_the_floor(self.problem).max()) < FEW_VALUES.unmeasured

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
        """What was found, or what begins beside white noise between the floor and what is learnt without laws, or with
        one law after the other by its evidence, and does better."""
        nothing = self._learn([], self.problem.residual)
        learnt = nothing.noise.times_the_floor(self.problem)
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
        if self._measured(nothing):
            for start in (nothing, best) if best.terms else (nothing,):
                best = max((best, self._step_by_step(start)), key=lambda s: s.worth)
        return best

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

    def _from_exchanges(self, best: State) -> State:
        """What was found, or what is found without one of its laws, and does better: of several laws the first that is
        taken explains parts of the others as well, and bars them."""
        several = len(best.terms) > 1 or any(len(t.group.axes) > 1 for t in best.terms)
        for term in best.terms if several else []:
            if term.group.effect or not any(t is term for t in best.terms):
                continue
            if sets_in(term.group) and (made := self._set_in_instead(best, term)).less_tries > best.less_tries:
                best = made
                continue
            barred = [term.group]
            for _ in range(LAW_SEARCH.rounds):
                made = self._exchanged(best, term, barred)
                margin = LAW_SEARCH.simpler if _claims_more(made, best) else LAW_SEARCH.rival_gain
                if made.less_tries > best.less_tries + margin:
                    best = made
                    break
                # what took its place may bar what does better as well
                known, place = which(best.terms), term.group.kind[:2]
                barred += [t.group for t in made.terms if id(t.group) not in known and t.group.kind[:2] == place]
                if len(barred) == 1 or len(term.group.units) > 1:
                    break
        return best

    def _set_in_instead(self, best: State, term: LawTerm) -> State:
        """What begins with another law that sets in in the place of one, that of the highest evidence with the noise
        learnt again: of large laws the gains beside the floor tell of what their functions leave, and not of which is
        right."""
        others = [t for t in best.terms if t is not term]
        onsets = Onsets(self.problem, Whitener(self.problem, LawNoise.floor_alone(self.problem)), best.residual)
        tried = [[*others, late] for late in onsets.in_place_of(others, term)]
        state = max(
            (self._learn(terms, self.problem.residual) for terms in tried), key=lambda s: s.less_tries, default=best
        )
        self.groups = [*self.groups, *(t.group for t in state.terms if t.group not in self.groups)]
        self.families = self.families.of(self.groups, self.families.barred)
        return self._proved(self._grown(self._settled(state), relearn=True)) if state is not best else best

    def _exchanged(self, best: State, term: LawTerm, barred: Sequence[LawGroup]) -> State:
        """What begins with the other laws beside the floor, without the like of some, and goes on with all. The like of
        a law of several places are all of several."""
        before = self.families.barred
        like = [(group.kind[:2], set(group.depends_on)) for group in barred]
        if several := len(term.group.units) > 1:
            self.families = self.families.without(lambda group: len(group.units) > 1)
        else:
            self.families = self.families.without(lambda group: (group.kind[:2], set(group.depends_on)) in like)
        others = [t for t in best.terms if t is not term and not (several and len(t.group.units) > 1)]
        floor = LawNoise.floor_alone(self.problem)
        start = self._grown(State(others, floor, -np.inf, self.problem.residual), relearn=False)
        state = self._learn(start.terms, self.problem.residual)
        made = self._proved(self._grown(self._proved(state), relearn=True))
        self.families = self.families.of(self.groups, before)
        if made.worth <= best.worth - LAW_SEARCH.hopeless:
            return made
        return self._proved(self._grown(made, relearn=True))

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

    def _on_all_axes(self, best: State) -> State:
        """What was found, or a product on all axes in the place of its laws of the zero offset, and what goes with it,
        where that does better: found axis by axis it is several laws, or the two curves that are most of it."""
        more = on_all_axes(self.problem, best.terms)
        if not more or (len(best.terms) < 2 and self._quiet(best)):
            return best
        others = [term for term in best.terms if term.group.place != "offset" or term.group.effect]
        self.groups = [*self.groups, *more]
        self.families = self.families.of(self.groups, self.families.barred)
        gains, priors = self._whitened(best).of_groups(more).scores(others, within=np.inf)
        likeliest = [i for i in np.argsort(-gains)[: LAW_SEARCH.most_rivals] if np.isfinite(gains[i])]
        tried = [self._learn([*others, LawTerm(more[i], priors[i])], self.problem.residual) for i in likeliest]
        if not tried:
            return best
        start = self._settled(max(tried, key=lambda s: s.less_tries))
        made = self._proved(self._grown(self._proved(start), relearn=True))
        return made if made.less_tries > best.less_tries + LAW_SEARCH.rival_gain else best

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


def _claims_more(made: State, best: State) -> bool:
    """Whether a law of one state follows what one of another does in its place, and something else."""
    return any(is_more_than(new.group, old.group) for new in made.terms for old in best.terms)
