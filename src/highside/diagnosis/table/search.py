"""Which set of effects explains a published table: a beam search over sets, what each term can be replaced by, and
rows that no set explains.

A few dozen numbers, half of them peak-to-peaks that have lost order and phase, are explained by many sets nearly as
well. One path of best next steps goes astray among them, so the best few sets of each size are kept. A term of the
best set is believed where no set without it comes near; what takes its place in a set that does come near is of its
class.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.probability import chi2_beyond
from highside.diagnosis.table.fit import ErrorTable, Fitted, Option, fit_set, rechanced
from highside.diagnosis.table.policy import SEARCH

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class TableSearch:
    """All sets that were tried, best first, and the best."""

    best: Fitted
    tried: list[Fitted]


def search(
    table: ErrorTable,
    options: Sequence[Option],
    base: Fitted,
    *,
    width: int = SEARCH.width,
    depth: int = SEARCH.max_effects,
    seeds: Sequence[Fitted] = (),
    report: Report | None = None,
) -> TableSearch:
    """Beam search from the base fit (and from other fitted sets). The smallest set within `SEARCH.step` a term of the
    best score is the answer."""
    beam: list[Fitted] = [base, *seeds]
    every: dict[frozenset[Option], Fitted] = {frozenset(f.options): f for f in beam}
    for size in range(1, depth + 1):
        grown: dict[frozenset[Option], Fitted] = {}
        for count, parent in enumerate(beam):
            fresh: list[frozenset[Option]] = []
            for option in options:
                key = frozenset((*parent.options, option))
                if option.effect in parent.effects or key in grown or key in every:
                    continue
                grown[key] = fit_set(table, (*parent.options, option), parent, rounds=0)
                fresh.append(key)
            # a few steps tell which are worth more
            for key in sorted(fresh, key=lambda k: grown[k].score)[: SEARCH.finished]:
                grown[key] = fit_set(table, grown[key].options, grown[key], rounds=1)
            if report:
                report((size - 1 + (count + 1) / len(beam)) / depth, f"sets of {size}")
        if not grown:
            break
        every |= grown
        before = min(f.score for f in beam)
        beam = sorted(grown.values(), key=lambda f: f.score)[:width]
        if beam[0].score > before - SEARCH.going_on * SEARCH.step:
            break
    tried = sorted(every.values(), key=lambda f: f.score)
    return TableSearch(_smallest(tried), tried)


def _smallest(tried: Sequence[Fitted]) -> Fitted:
    """The best set such that each term it has more than another is worth `SEARCH.step`."""
    return min(tried, key=lambda f: f.score + SEARCH.step * len(f.options))


@dataclass(frozen=True)
class TableRanking:
    """One term of the best set: how much better sets with it are than sets without it, and what may replace it."""

    option: Option
    without: float
    """score lost by the best set that holds neither it nor anything of its class"""
    same: tuple[str, ...]
    instead: dict[str, Fitted]
    """the best set without this effect, by the effect that takes its place"""
    ruled_out: dict[str, float]
    """score lost by exchanging it for another effect, where that is clear"""
    shapes: int
    """how many of its shapes (harmonic orders) do as well: with several, it stands for something that is not known"""


def ranking(
    table: ErrorTable, options: Sequence[Option], base: Fitted, best: Fitted, tried: Sequence[Fitted], index: int
) -> TableRanking:
    """Search without one term's effect, beside the other terms, and compare."""
    option = best.options[index]
    others = tuple(o for k, o in enumerate(best.options) if k != index)
    rest = fit_set(table, others, best) if others else base
    allowed = [o for o in options if o.effect != option.effect]
    found = search(table, allowed, rest, width=2, depth=2)
    rivals = [f for f in (*found.tried, *tried) if option.effect not in f.effects]
    # an effect that is there with some of its amplitudes may take this one's place with more of them
    grown = {
        other.effect: fit_set(table, (*(o for o in others if o is not other), fuller), rest)
        for other in others
        for fuller in options
        if fuller.effect == other.effect
        and fuller.shape == other.shape
        and len(fuller.amplitudes) > len(other.amplitudes)
    }

    def cost(fitted: Fitted) -> float:
        # each effect more than the best set has must pay for itself
        return fitted.score - best.score + SEARCH.step / 2 * max(0, len(fitted.options) - len(best.options))

    kept = {o.effect for o in others}
    instead: dict[str, Fitted] = {}
    for effect in dict.fromkeys(e for f in sorted(rivals, key=cost) for e in sorted(f.effects - kept)):
        fitted = min((f for f in rivals if effect in f.effects), key=cost)
        if SEARCH.same <= cost(fitted) < SEARCH.clear:
            fitted = polished(table, fitted)
        place = next(k for k, o in enumerate(fitted.options) if o.effect == effect)
        if cost(fitted) >= SEARCH.same or _needed(table, fitted, place):
            instead[effect] = fitted
    instead |= {effect: fitted for effect, fitted in grown.items() if cost(fitted) < SEARCH.same}
    for effect, fitted in _by_means(table, allowed, best, index).items():
        if effect not in kept and cost(instead.get(effect, fitted)) >= SEARCH.same:
            instead[effect] = replace(fitted, score=best.score)
    same = tuple(effect for effect, fitted in instead.items() if cost(fitted) < SEARCH.same)
    clear = {effect: cost(fitted) for effect, fitted in instead.items() if effect not in same}
    without = min((cost(f) for f in (*rivals, *instead.values()) if not f.effects & set(same)), default=np.inf)
    rest_of = frozenset(others)
    shapes = {option.shape} | {
        o.shape
        for f in tried
        if f.score - best.score < SEARCH.same and rest_of <= set(f.options)
        for o in f.options
        if o.effect == option.effect
    }
    return TableRanking(option, float(without), (option.effect, *same), instead, clear, len(shapes))


def _by_means(table: ErrorTable, options: Sequence[Option], best: Fitted, index: int) -> dict[str, Fitted]:
    """Effects that explain the means as well as one term does, and require no larger peak-to-peaks than there are.

    What is missing of a peak-to-peak may be any ripple, so it speaks for no effect; only too much speaks against one.
    """
    published = table.published.copy()
    published[:, [1, 3]] = np.nan
    means = replace(table, published=published)
    others = tuple(o for k, o in enumerate(best.options) if k != index)
    level = fit_set(means, best.options, best).score
    sigma = best.sigma(table)
    found: dict[str, Fitted] = {}
    for option in options:
        fitted = fit_set(means, (*others, option), best)
        over = ((fitted.cells - table.published) / sigma)[table.use][:, [1, 3]]
        near = fitted.score - level < SEARCH.same and np.nanmax(over) < SEARCH.over
        if near and (option.effect not in found or fitted.score < found[option.effect].score):
            found[option.effect] = fitted
    return found


def alike(best: Fitted, tried: Sequence[Fitted], index: int) -> tuple[str, ...]:
    """A term's effect and those that took its place in other sets that were tried and score as well."""
    others = {o for k, o in enumerate(best.options) if k != index}
    own = best.options[index].effect
    found = [own]
    for fitted in tried:
        if fitted.score - best.score > SEARCH.same:
            break
        extra = set(fitted.options) - others
        if len(fitted.options) == len(best.options) and len(extra) == 1:
            found.append(extra.pop().effect)
    return tuple(dict.fromkeys(found))


def other_amplitudes(best: Fitted, tried: Sequence[Fitted], index: int) -> list[tuple[str, ...]]:
    """Amplitudes of a term's own effect (other axes, say) that do as well in its place, the other effects kept."""
    own = best.options[index]
    kept = best.effects - {own.effect}
    found = [
        option.amplitudes
        for fitted in tried
        if fitted.score - best.score < SEARCH.same and fitted.effects >= kept
        for option in fitted.options
        if option.effect == own.effect and option.amplitudes != own.amplitudes
    ]
    return list(dict.fromkeys(found))[:4]


def _needed(table: ErrorTable, fitted: Fitted, place: int) -> bool:
    """Whether a set is worse without one of its terms."""
    rest = tuple(o for k, o in enumerate(fitted.options) if k != place)
    return fit_set(table, rest, fitted).score - fitted.score > SEARCH.step


def polished(table: ErrorTable, fitted: Fitted) -> Fitted:
    """The same set from other signs of its amplitudes: peak-to-peaks hardly know them, and no fit crosses zero."""
    best = rechanced(table, fitted)
    for k in range(len(fitted.options)):
        own = fitted.own(k)
        for signs in _patterns(own.stop - own.start):
            values = best.values.copy()
            values[own] *= signs
            other = fit_set(table, best.options, replace(best, values=values))
            if other.score < best.score - SEARCH.better:
                best = other
    return best


def _patterns(count: int) -> list[Array]:
    """Signs to try beside those that are there."""
    if count == 1:
        return [np.array([-1.0])]
    return [-np.ones(count), *(np.where(np.arange(count) == k, -1.0, 1.0) for k in range(count))]


def held_out_row(table: ErrorTable, fitted: Fitted, row: int) -> tuple[Array, Array, Array]:
    """Prediction of one row from the others: residual (4,), its covariance (4, 4) in deg, and which cells count."""
    part = fit_set(table.without_row(row), fitted.options, fitted, rounds=1)
    cov = part.covariance(table)
    mask = np.isfinite(table.published[row])
    if table.sessions.degenerate()[row]:
        mask[:2] = False
    cells = np.arange(4 * row, 4 * row + 4)
    rest = np.flatnonzero(table.without_row(row).mask)
    # chance that the rows share (the correction's poses) is predicted too
    left = (table.published - part.cells).reshape(-1)
    gain = np.linalg.solve(cov[np.ix_(rest, rest)], cov[np.ix_(rest, cells)]).T
    # and what the others do not determine of the parameters adds to the uncertainty
    open_slope = part.jacobian[:, cells].T - gain @ part.jacobian[:, rest].T
    inner = part.jacobian[:, rest] @ np.linalg.solve(cov[np.ix_(rest, rest)], part.jacobian[:, rest].T)
    inner += np.diag(table.precision(inner.shape[0]))
    spread = cov[np.ix_(cells, cells)] - gain @ cov[np.ix_(rest, cells)]
    spread = spread + open_slope @ np.linalg.solve(inner, open_slope.T)
    return np.nan_to_num(left[cells] - gain @ left[rest]), np.asarray(spread), mask


def unexplained_rows(table: ErrorTable, fitted: Fitted) -> dict[int, float]:
    """Rows that the others do not predict, with the probability of their departure."""
    found: dict[int, float] = {}
    rows = np.flatnonzero(table.use)
    for row in rows:
        left, cov, mask = held_out_row(table, fitted, int(row))
        if not mask.any():
            continue
        value = float(left[mask] @ np.linalg.solve(cov[np.ix_(mask, mask)], left[mask]))
        p = chi2_beyond(value, int(mask.sum()))
        if p * rows.size < SEARCH.unexplained_p:
            found[int(row)] = p
    return found
