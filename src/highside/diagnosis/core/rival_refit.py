"""Rivals of a strong effect, fitted to the readings as they are: what they differ by may be beyond first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.policy import RIVAL_REFIT, RIVALS
from highside.diagnosis.core.problem import N, Problem, SelectionState
from highside.diagnosis.core.rivals import Refitted, Rivalry, rivalry


def refitted(
    problem: Problem[N], selection: SelectionState[N], claim: Term, fit: JointFit, found: Rivalry
) -> list[Refitted]:
    """The nearest rivals of a claim, each fitted beside the other claims; `fit` is that of the claims themselves."""
    others = [m for m in selection.terms if m != claim]
    candidates, candidate_set = problem.candidates, selection.selector.candidate_set
    if any(not candidates[m.candidate].named for m in selection.terms):
        return []
    taken = {m.candidate for m in selection.terms}
    nearest = [int(k) for k in np.argsort(found.delta_bic) if candidates[k].named and k not in taken][
        : RIVAL_REFIT.refitted
    ]
    own = problem.subsample_chi_square([*others, claim])
    result = []
    for rival in (found.best[k] for k in nearest):
        more = (len(candidate_set.columns(rival)) - len(candidate_set.columns(claim))) * float(
            np.log(selection.selector.size)
        )
        with_rival = problem.subsample_chi_square([*others, rival])
        if own is not None and with_rival is not None and with_rival - own > RIVALS.same_class_evidence:
            # what some of the readings rule out all of them rule out
            result.append(Refitted(rival, with_rival - own + more))
            continue
        one = problem.fit([*others, rival], selection.noise, with_second_order=False)
        result.append(Refitted(rival, one.chi_square - fit.chi_square + more))
    return result


def with_best_rival(problem: Problem[N], selection: SelectionState[N], fit: JointFit) -> SelectionState[N]:
    """What was chosen, or that with one term replaced by a rival that explains the readings better when both are
    fitted in full; with its fit, and with the refits of the rivals of what stays."""
    slow = problem.slow_ids
    best: tuple[float, list[Term]] | None = None
    refits = {}
    for m in selection.terms:
        candidate = problem.candidates[m.candidate]
        if not candidate.named or candidate.id in slow or m in selection.selector.fixed:
            continue
        refits[m] = refitted(problem, selection, m, fit, rivalry(selection.selector, selection.terms, m))
        for one in refits[m]:
            allowed = one.rival.candidate not in selection.selector.banned
            if allowed and one.delta_bic < (best[0] if best else 0.0):
                best = (one.delta_bic, [one.rival if o == m else o for o in selection.terms])
    if best is None:
        return replace(selection, fit=fit, refits=refits)
    return replace(selection, terms=best[1], fit=problem.fit(best[1], selection.noise))


def without_unneeded(problem: Problem[N], selection: SelectionState[N]) -> SelectionState[N]:
    """What was chosen, less the terms that the full fit does as well without: to first order they stood in for what a
    strong effect does beyond it. Only terms whose fitted size is within its error are tried."""
    if any(not problem.candidates[m.candidate].named for m in selection.terms):
        return selection
    while selection.fit is not None and len(selection.terms) > 1:
        fit = selection.fit
        doubtful = [m for m in selection.terms if m not in selection.selector.fixed and _is_nothing(problem, m, fit)]
        others = [[o for o in selection.terms if o != m] for m in doubtful]
        costs = [problem.fit(o, selection.noise, with_second_order=False).chi_square - fit.chi_square for o in others]
        if not costs or min(costs) >= RIVAL_REFIT.needed:
            break
        terms = others[int(np.argmin(costs))]
        selection = replace(selection, terms=terms, fit=problem.fit(terms, selection.noise), refits={})
    return selection


def _is_nothing(problem: Problem[N], term: Term, fit: JointFit) -> bool:
    """Whether every amplitude of a term was fitted to nothing within its error."""
    candidate = problem.candidates[term.candidate]
    fitted = fit.parameters.get(candidate.id)
    sizes = [] if fitted is None else [fitted[name] for name in candidate.amplitudes if name in fitted]
    return bool(sizes) and all(abs(p.value) <= RIVAL_REFIT.nothing * p.std for p in sizes)


def kept(problem: Problem[N], selection: SelectionState[N], taken_out: Sequence[str]) -> SelectionState[N]:
    """What was chosen, with effects of which the second-order part was taken out in the place of what is the same to
    first order.

    Where two differ only beyond that, which of them it is has been decided before, by fits in full.
    """
    for name in taken_out:
        names = [problem.candidates[m.candidate].id for m in selection.terms]
        if name in names:
            continue
        for m, own in zip(selection.terms, names, strict=True):
            found = rivalry(selection.selector, selection.terms, m)
            k = next((k for k in found.same if problem.candidates[k].id == name), None)
            if own not in taken_out and k is not None and found.delta_bic[k] < RIVAL_REFIT.alike:
                selection = replace(selection, terms=[found.best[k] if o == m else o for o in selection.terms])
                break
    return selection


def beside_refits(found: Rivalry, refits: Sequence[Refitted]) -> Rivalry:
    """The rivalry with what refits say instead of what it says to first order."""
    delta, same = found.delta_bic.copy(), list(found.same)
    for one in refits:
        k = one.rival.candidate
        delta[k] = one.delta_bic
        if delta[k] < RIVALS.same_class_bic and k not in same:
            same.append(k)
        elif delta[k] > RIVALS.same_class_evidence and k in same:
            same.remove(k)
    return replace(found, delta_bic=delta, same=tuple(same))
