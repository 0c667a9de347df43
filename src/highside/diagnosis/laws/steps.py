"""Steps of the search from one state to the next: noise learnt, a law taken, exchanged, varied, refined or dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.between import best_between, between_of, refined
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import LawTerm, Whitened, raw_columns
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import LawGroup, dent_of, groups_of, within_another
from highside.diagnosis.laws.learning import NoiseLearner
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.policy import LAW_SEARCH, LAW_VERDICT
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import LawProblem, independent
from highside.diagnosis.laws.products import ProductGroup, fitted_again
from highside.diagnosis.laws.products_policy import PRODUCTS
from highside.diagnosis.laws.state import State, which
from highside.diagnosis.laws.variants import as_simple, variants_of


class Steps:
    """What a search of one session is made of: its groups, and the steps that all of its starts share."""

    def __init__(self, problem: LawProblem, groups: list[LawGroup] | None = None, *, variants: bool = True) -> None:
        self.problem = replace(problem, free=independent(problem.free, problem.floor))
        self.groups = groups_of(self.problem) if groups is None else groups
        self.families = Families(self.problem, self.groups)
        self.learner = NoiseLearner(self.problem)
        self._variants = variants
        self._tried: set[LawGroup] = set()
        """groups whose variants were looked at"""
        self._ends: list[State] = []
        """what ways of the search ended in"""
        self._learnt: list[tuple[Array, dict[tuple[tuple[float, ...], ...], tuple[LawNoise, float]]]] = []

    def _whitened(self, state: State) -> Whitened:
        return Whitened(self.families, Whitener(self.problem, state.noise), state.residual)

    def _learn(self, terms: list[LawTerm], residual: Array) -> State:
        """The noise beside these terms; far values clipped, and learnt once more if there are any."""
        noise, found = self._noise(terms, residual)
        clipped = self._clipped(State(terms, noise, found, residual))
        if clipped is not residual:
            noise, found = self._noise(terms, clipped)
        return State(terms, noise, found, clipped)

    def _noise(self, terms: list[LawTerm], residual: Array) -> tuple[LawNoise, float]:
        """The noise beside these terms and its evidence: what was learnt once of a residual is known."""
        known = next((found for one, found in self._learnt if one is residual), None)
        if known is None:
            known = {}
            self._learnt.append((residual, known))
        key = tuple(sorted((float(id(t.group)), t.prior.size, t.prior.length) for t in terms))
        if key not in known:
            known[key] = self.learner.learn(terms, residual)
        return known[key]

    def _clipped(self, state: State) -> Array:
        whitener = Whitener(self.problem, state.noise)
        columns = np.concatenate([self.problem.free, raw_columns(self.problem, state.terms)])
        mean, _ = Whitened(Families(self.problem, []), whitener, self.problem.residual).posterior(state.terms)
        return whitener.clipped(self.problem.residual, np.tensordot(mean, columns, 1))

    def _grown(self, state: State, *, relearn: bool) -> State:
        """Groups taken one by one while they gain, each put to the test against its rivals; where the noise is learnt
        again the best on the way stays: beside much of it rivals may change places with a loss."""
        best_of_all = state
        while len(state.terms) < (LAW_SEARCH.most if relearn else LAW_SEARCH.most_first):
            white, gains, priors = self._scored(state)
            best = self._simplest(gains)
            if gains[best] < LAW_SEARCH.gain:
                break
            terms = [*state.terms, LawTerm(self.groups[best], priors[best])]
            if relearn:
                terms = self._varied(state, self._refitted_with_rivals(white, terms))
                state = self._learn(terms, self.problem.residual)
                best_of_all = max((best_of_all, state), key=lambda s: s.worth)
            elif state.terms and self._is_noise(white, terms, float(gains[best])):
                break
            else:
                state = replace(state, terms=self._varied(state, terms))
        if not state.terms:
            return state
        if not relearn:
            # of a state that has as many as may be taken nothing was scored
            white = self._whitened(state)
            return replace(state, terms=self._varied(state, self._refitted_with_rivals(white, state.terms)))
        terms = self._varied(state, state.terms)
        varied = state if which(terms) == which(state.terms) else self._learn(terms, self.problem.residual)
        return max((varied, best_of_all), key=lambda s: s.worth)

    def _scored(self, state: State) -> tuple[Whitened, Array, list[Prior]]:
        """What each group gains beside the terms of a state, and its prior; where that is much, with those that come
        near at the best of a number that lies between those tried."""
        white = self._whitened(state)
        gains, priors = white.scores(state.terms, least=LAW_VERDICT.beside, within=LAW_SEARCH.simpler)
        gains = self._each_name_once(gains, state.terms)
        if not self._variants or not gains.size:
            return white, gains, priors
        best = float(gains.max())
        found = [one for one in refined(white, state.terms, best) if one[1] > best - LAW_SEARCH.simpler]
        if not found:
            return white, gains, priors
        self.groups = [*self.groups, *(group for group, _, _ in found)]
        self.families = self.families.of(self.groups, self.families.barred)
        more = np.array([gain for _, gain, _ in found])
        return self._whitened(state), np.append(gains, more), [*priors, *(prior for _, _, prior in found)]

    def _is_noise(self, white: Whitened, terms: list[LawTerm], gain: float) -> bool:
        """Whether laws of many numbers explain less than noise alone does, and would with as many more as may be taken,
        each as good as the last, which gains so many nats."""
        if sum(term.group.size for term in terms) <= LAW_SEARCH.numbers_first:
            return False
        most = white.total(terms) + gain * (LAW_SEARCH.most_first - len(terms))
        return most < self._noise([], self.problem.residual)[1]

    def _varied(self, state: State, terms: list[LawTerm]) -> list[LawTerm]:
        """Each term, or a variant of it that gains more beside the others: with an onset, or of finer functions."""
        for k, term in enumerate(terms):
            if term.group in self._tried:
                continue
            self._tried.add(term.group)
            if isinstance(term.group, EffectGroup):
                terms = self._sharpened(state, terms, k)
                continue
            if not self._variants:
                continue
            variants = variants_of(self.problem, term.group)
            between = between_of(self.problem, term.group)
            if not variants and not between:
                continue
            others = [t for i, t in enumerate(terms) if i != k]
            whitener = Whitener(self.problem, state.noise)
            own = Families(self.problem, [term.group, *variants])
            among = Whitened(own, whitener, state.residual)
            gains, priors = among.scores(others)
            if not np.isfinite(gains[0]):
                # far behind a variant, or nothing is left of it beside the others that a variant could do better
                gains[0] = among.of_groups([term.group]).scores(others)[0][0]
            if not np.isfinite(gains[0]):
                continue
            for group, gain, prior in filter(None, (best_between(among, others, one) for one in between)):
                own, gains, priors = own.of([*own.groups, group]), np.append(gains, gain), [*priors, prior]
            # what has a covariate less need only come near
            fewer = [max(len(term.group.axes) - len(g.axes), 0) for g in own.groups]
            gains = gains + LAW_SEARCH.simpler * np.array(fewer)
            alike = [as_simple(term.group, g) for g in own.groups]
            least = np.where(alike, LAW_SEARCH.rival_gain, LAW_SEARCH.variant)
            least[np.array(fewer) > 0], least[0] = 0.0, 0.0
            ahead = gains - gains[0] - least
            best = int(np.argmax(ahead))
            if best and ahead[best] > 0:
                # over time with more functions may be what sets in midway, with more functions of the other
                finer = "time" in own.groups[best].depends_on and len(own.groups[best].axes) == len(term.group.axes) > 1
                if not alike[best] and not finer:
                    self._tried.add(own.groups[best])
                self.groups.append(own.groups[best])
                self.families = self.families.of(self.groups, self.families.barred)
                terms = [LawTerm(own.groups[best], priors[best]) if i == k else t for i, t in enumerate(terms)]
        return terms

    def _sharpened(self, state: State, terms: list[LawTerm], k: int) -> list[LawTerm]:
        """The terms with an effect of the library at the best of its shapes between those that are tried."""
        others = [t for i, t in enumerate(terms) if i != k]
        whitener, best = Whitener(self.problem, state.noise), terms[k]
        for _ in range(LAW_SEARCH.shape_rounds):
            assert isinstance(best.group, EffectGroup)
            finer = best.group.finer()
            if not finer:
                break
            gains, priors = Whitened(Families(self.problem, list(finer)), whitener, state.residual).scores(others)
            at = int(np.argmax(gains))
            if not np.isfinite(gains[at]):
                break
            best = LawTerm(finer[at], priors[at])
        if best is terms[k]:
            return terms
        self._tried.add(best.group)
        self.groups.append(best.group)
        self.families = self.families.of(self.groups, self.families.barred)
        return [best if i == k else t for i, t in enumerate(terms)]

    def _refitted_with_rivals(self, white: Whitened, terms: list[LawTerm]) -> list[LawTerm]:
        """Each term beside the others as its best prior has it, or another group in its place."""
        for _ in range(LAW_SEARCH.rounds):
            before = which(terms)
            for k in range(len(terms)):
                others = [t for i, t in enumerate(terms) if i != k]
                gains, priors = white.scores(others, within=LAW_SEARCH.simpler)
                own = self.groups.index(terms[k].group)
                best = self._simplest(gains := self._each_name_once(gains, others))
                simpler = len(self.groups[best].axes) < len(terms[k].group.axes)
                ahead = gains[best] > gains[own] + LAW_SEARCH.rival_gain
                choice = best if ahead or simpler else own
                terms = [LawTerm(self.groups[choice], priors[choice]) if i == k else t for i, t in enumerate(terms)]
            if which(terms) == before or len(terms) == 1:
                break
        return terms

    def _each_name_once(self, gains: Array, terms: list[LawTerm]) -> Array:
        """The gains without those of further shapes of an effect that is among the terms: a model has an effect once.
        A second step or decay beside it is a law of time. Nor is a dent within a dent a second law: in few poses the
        narrow one is what a single pose says."""
        names = {t.group.effect for t in terms if t.group.effect}
        if names:
            gains = np.where([g.effect in names for g in self.groups], -np.inf, gains)
        dents = [t.group for t in terms if dent_of(t.group)]
        if dents:
            gains = np.where([any(within_another(g, one) for one in dents) for g in self.groups], -np.inf, gains)
        return gains

    def _simplest(self, gains: Array) -> int:
        """The group of the highest gain; one of fewer covariates of it, in its place, that comes near."""
        # groups that are the same functions in this recording tie to rounding: the first of them on any processor
        best = int(np.argmax(gains >= float(gains.max()) - LAW_SEARCH.tie))
        own = self.groups[best]
        named = [i for i, g in enumerate(self.groups) if g.effect and gains[i] > gains[best] - LAW_SEARCH.named]
        if named and not own.effect:
            return max(named, key=lambda i: float(gains[i]))
        if len(own.axes) < 2:
            return best
        near = [
            int(i)
            for i in np.flatnonzero(gains > gains[best] - LAW_SEARCH.simpler)
            if self.groups[int(i)].kind[:2] == own.kind[:2]
            and set(self.groups[int(i)].depends_on) < set(own.depends_on)
        ]
        return max(near, key=lambda i: float(gains[i])) if near else best

    def _proved(self, state: State) -> State:
        """Without the terms whose removal costs too little with the noise learnt again."""
        while state.terms:
            costs = self._costs(state)
            worst = int(np.argmin(costs))
            if costs[worst] >= LAW_SEARCH.gain:
                break
            terms = [t for i, t in enumerate(state.terms) if i != worst]
            state = self._learn(terms, self.problem.residual)
            if terms:
                terms = self._varied(state, self._refitted_with_rivals(self._whitened(state), terms))
                state = max((state, self._learn(terms, self.problem.residual)), key=lambda s: s.worth)
        self._ends.append(state)
        return state

    def _costs(self, state: State) -> list[float]:
        costs = []
        for k, term in enumerate(state.terms):
            others = [t for i, t in enumerate(state.terms) if i != k]
            _, without = self._noise(others, state.residual)
            costs.append(state.evidence - without - float(np.log(term.group.tries)))
        return costs

    def _simpler(self, state: State) -> State:
        """A state whose last term is a product, or that with a curve of one of its quantities where that comes near."""
        *terms, product = state.terms
        assert isinstance(product.group, ProductGroup)
        made = [state]
        for curve in product.group.curves():
            _, priors = self._whitened(state).of_groups([curve]).scores(terms, within=np.inf)
            made.append(self._learn([*terms, LawTerm(curve, priors[0])], self.problem.residual))
        return max(made, key=lambda one: one.worth + (0.0 if one is state else LAW_SEARCH.simpler))

    def _with_product(self, terms: list[LawTerm], group: ProductGroup) -> State:
        """These terms and a product, fitted anew beside the noise that is left of them."""
        best: State | None = None
        for _ in range(PRODUCTS.rounds + 1):
            noise = best.noise if best else LawNoise.floor_alone(self.problem)
            white = self._whitened(State([], noise, -np.inf, self.problem.residual))
            group = group if best is None else fitted_again(white, terms, group)
            _, priors = white.of_groups([group]).scores(terms, within=np.inf)
            state = self._learn([*terms, LawTerm(group, priors[0])], self.problem.residual)
            if best is not None and state.less_tries <= best.less_tries:
                break
            best = state
        assert best is not None
        return best
