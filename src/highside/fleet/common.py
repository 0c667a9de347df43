"""What the tools of a lot have in common, and which stand out: from scores and informations alone, nothing is read.

Every effect of every lot is tested (`pool`), with the false discoveries among all of them controlled. What is found is
then told apart within the lot: the effect that explains most comes first, the others are tested beside it, those that
explain the same as well are its class. What is named is proved by tools that were left out: the mean of the others must
predict a tool better than none does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.fleet.policy import COMMON, POOLING
from highside.fleet.pooling import Pooled, between_tools, conspicuous, left_out, outlying, pool
from highside.special import stdtr, stdtrit
from highside.words import said

__all__ = ["Change", "Common", "LotScores", "LotTested", "Outlier", "Proof", "ToolScores", "judge"]


@dataclass(frozen=True)
class ToolScores:
    """One tool: score (K,) and information (K, K) over the fleet's amplitudes, zero where it says nothing."""

    tool: str
    score: Array
    information: Array


@dataclass(frozen=True)
class LotScores:
    """The tools of one lot, in the order in which they were made where that is known."""

    lot: str
    entries: tuple[str, ...]
    """(E,) effects, at a shape where there are several"""
    amplitudes: tuple[tuple[int, ...], ...]
    """(E,) the places of each entry's amplitudes among the K"""
    tools: tuple[ToolScores, ...]
    ordered: bool = False

    def of(self, entry: int, beside: Sequence[int] = ()) -> tuple[Array, Array, tuple[int, ...]]:
        """Score (n, k) and information (n, k, k) of an entry of the tools that say anything of it, and which these are.

        `beside` entries are fitted too, to each tool by itself.
        """
        own = list(self.amplitudes[entry])
        others = [k for e in beside for k in self.amplitudes[e]]
        scores, informations, which = [], [], []
        for i, tool in enumerate(self.tools):
            u, j = tool.score[own], tool.information[np.ix_(own, own)]
            alone = float(np.trace(j))
            if others:
                cross = tool.information[np.ix_(own, others)]
                inverse = np.linalg.pinv(tool.information[np.ix_(others, others)], hermitian=True)
                u, j = u - cross @ inverse @ tool.score[others], j - cross @ inverse @ cross.T
            if np.trace(j) > POOLING.visible * alone:
                scores.append(u)
                informations.append(j)
                which.append(i)
        return np.array(scores), np.array(informations), tuple(which)


@dataclass(frozen=True)
class Proof:
    """What the mean of the others adds to the log likelihood of each tool in turn."""

    gain: float
    std: float

    @property
    def holds(self) -> bool:
        """Whether tools are predicted better with than without."""
        return self.gain > self.std


@dataclass(frozen=True)
class Common:
    """An effect that the tools of a lot share."""

    lot: str
    effect: str
    parameters: tuple[str, ...]
    pooled: Pooled
    q: float
    """smallest rate of false discoveries at which it would be named"""
    same: tuple[str, ...]
    """effects that explain it as well: the class, the first is `effect`"""
    proof: Proof
    change: Change | None = None


@dataclass(frozen=True)
class Change:
    """A change of an effect along the order of the tools."""

    after: str
    """the last tool before it"""
    before: Pooled
    behind: Pooled
    p: float


@dataclass(frozen=True)
class Outlier:
    """A tool that is not like its lot."""

    lot: str
    tool: str
    effect: str
    same: tuple[str, ...]
    p: float
    departure: Array
    """(k,) its own estimate less the mean of the others"""


@dataclass(frozen=True)
class LotTested:
    """What was found in one lot."""

    lot: str
    tools: int
    common: tuple[Common, ...] = ()
    outliers: tuple[Outlier, ...] = ()
    refused: str = ""
    """why it was not judged"""
    smallest: Mapping[str, Array] = field(default_factory=dict)
    """(k,) common size of each effect that would have been found with 80 % probability"""


def judge(lots: Sequence[LotScores], parameters: Sequence[str]) -> list[LotTested]:
    """Judge all lots together, as the false discoveries are counted over all of them. `parameters`: (K,) names."""
    able = [lot for lot in lots if len(lot.tools) >= COMMON.fewest_tools]
    pooled: dict[tuple[int, int], Pooled] = {}
    for number, lot in enumerate(able):
        for entry in range(len(lot.entries)):
            score, information, which = lot.of(entry)
            if len(which) >= COMMON.fewest_tools:
                pooled[number, entry] = pool(score, information)
    q = _false_discovery_rates({key: one.p for key, one in pooled.items()})
    limit = max((one.p for key, one in pooled.items() if q[key] <= COMMON.false_discoveries), default=0.0)
    tests = sum(len(lot.tools) * len(lot.entries) for lot in able)
    found = []
    for lot in lots:
        if lot not in able:
            why = said(
                "tools: %(tools)s; %(needed)s are needed to tell what they share from chance",
                tools=len(lot.tools),
                needed=COMMON.fewest_tools,
            )
            found.append(LotTested(lot.lot, len(lot.tools), refused=why))
            continue
        number = able.index(lot)
        own = {entry: one for (n, entry), one in pooled.items() if n == number}
        rates = {entry: q[number, entry] for entry in own}
        common = _common(lot, own, rates, limit, parameters, max(1, len(pooled)))
        smallest = {lot.entries[e]: _smallest(one, len(pooled)) for e, one in own.items()}
        found.append(LotTested(lot.lot, len(lot.tools), common, _outliers(lot, own, tests), smallest=smallest))
    return found


def _false_discovery_rates(p: Mapping[tuple[int, int], float]) -> dict[tuple[int, int], float]:
    """The rate at which each would just be named (Benjamini and Hochberg)."""
    order = sorted(p, key=lambda key: p[key])
    rates: dict[tuple[int, int], float] = {}
    smallest = 1.0
    for rank in range(len(order), 0, -1):
        smallest = min(smallest, p[order[rank - 1]] * len(order) / rank)
        rates[order[rank - 1]] = smallest
    return rates


def _smallest(one: Pooled, tests: int) -> Array:
    """(k,) the size that passes, in 80 % of lots like this, the threshold of a first discovery."""
    tail = COMMON.false_discoveries / (2.0 * max(1, tests) * one.mean.size)
    limit = -float(stdtrit(one.tools - 1, tail)) + COMMON.power_80
    return limit * one.std


def _common(
    lot: LotScores,
    pooled: Mapping[int, Pooled],
    rates: Mapping[int, float],
    limit: float,
    parameters: Sequence[str],
    tests: int,
) -> tuple[Common, ...]:
    """The effects of a lot, the one that explains most first; each beside those before it."""
    named: list[Common] = []
    taken: list[int] = []
    standing = {entry for entry, one in pooled.items() if one.p <= limit}
    while standing and len(named) < COMMON.most:
        beside = _beside(lot, [e for e in pooled if e not in taken], taken) if taken else dict(pooled)
        standing = {e for e in standing if e in beside and beside[e].p <= limit}
        if not standing:
            break
        worth = {e: _worth(one, len(lot.tools)) for e, one in beside.items()}
        best = max(standing, key=lambda e: worth[e])
        # one that explains it as well belongs to the class, whether or not it would have been found by itself
        near = [e for e in worth if worth[e] > max(0.0, worth[best] - COMMON.same_class) and e != best]
        same = [best, *sorted(near, key=lambda e: -worth[e])]
        same += [e for e in standing if e not in same and _hidden(lot, e, [*taken, best], best)]
        proof = _proof(lot, best, taken)
        if proof.holds:
            own = lot.amplitudes[best]
            named.append(
                Common(
                    lot.lot,
                    lot.entries[best],
                    tuple(parameters[k] for k in own),
                    beside[best],
                    rates[best],
                    tuple(lot.entries[e] for e in same),
                    proof,
                    _change(lot, best, taken, tests) if lot.ordered else None,
                )
            )
        # what is of the class of one that was named is named with it
        taken.append(best)
        standing -= {best, *same}
    return tuple(named)


def _beside(lot: LotScores, entries: Sequence[int], taken: Sequence[int]) -> dict[int, Pooled]:
    """What is in common beside the entries taken, of those of which enough tools still say anything."""
    found = {}
    for entry in entries:
        score, information, which = lot.of(entry, taken)
        if len(which) >= COMMON.fewest_tools:
            found[entry] = pool(score, information)
    return found


def _worth(one: Pooled, tools: int) -> float:
    """What the mean explains, less what its number of amplitudes would by chance (BIC)."""
    return one.gain - one.mean.size * float(np.log(tools))


def _hidden(lot: LotScores, entry: int, taken: Sequence[int], best: int) -> bool:
    """Whether next to nothing of what an entry does in this lot lies beside the one that was chosen."""
    alone = sum(float(np.trace(j)) for j in lot.of(entry, [e for e in taken if e != best])[1])
    left = sum(float(np.trace(j)) for j in lot.of(entry, taken)[1])
    return left < COMMON.hidden * alone


def _proof(lot: LotScores, entry: int, beside: Sequence[int]) -> Proof:
    """Leave one tool out at a time: the mean of the others against none at all, whatever scatter that would need."""
    score, information, which = lot.of(entry, beside)
    scatter = between_tools(score, information)
    rest = left_out(score, information, scatter)
    n = len(which)
    with_it, plain, wide = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        # in units of the noise, along what the tool shows: some amplitudes show together only
        scale = np.sqrt(np.maximum(np.diag(information[i]), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(information[i] / np.outer(scale, scale))
        shown = values > POOLING.visible * max(float(values[-1]), 1.0)
        root = np.sqrt(values[shown])
        seen, turned = (vectors[:, shown].T @ (score[i] / scale)) / root, root[:, None] * vectors[:, shown].T * scale
        own, mean = np.eye(root.size) + (turned * scatter**2) @ turned.T, turned @ rest.mean[i]
        with_it[i] = _log_density(seen - mean, own + turned @ rest.covariance[i] @ turned.T)
        plain[i] = _log_density(seen, own)
        # without a mean the tools would scatter about nothing by so much
        wide[i] = _log_density(seen, own + (turned * rest.mean[i] ** 2) @ turned.T)
    gains = with_it - (plain if plain.sum() > wide.sum() else wide)
    return Proof(float(gains.sum()), float(np.std(gains, ddof=1) * np.sqrt(n)))


def _log_density(value: Array, covariance: Array) -> float:
    _, log_volume = np.linalg.slogdet(covariance)
    return float(-0.5 * (value @ np.linalg.solve(covariance, value) + log_volume))


def _change(lot: LotScores, entry: int, beside: Sequence[int], tests: int) -> Change | None:
    """The place along the order of the tools at which an effect changes most, if that is no chance."""
    score, information, which = lot.of(entry, beside)
    best: Change | None = None
    first, last = COMMON.fewest_tools, len(which) - COMMON.fewest_tools
    places = np.unique(np.linspace(first, last, COMMON.places).astype(int)).tolist() if last >= first else []
    for place in places:
        before, behind = pool(score[:place], information[:place]), pool(score[place:], information[place:])
        std = np.sqrt(np.diag(before.covariance) + np.diag(behind.covariance))
        largest = float(np.max(np.abs(before.mean - behind.mean) / np.where(std > 0, std, np.inf)))
        p = 2.0 * float(stdtr(len(which) - 2, -largest)) * before.mean.size * len(places) * tests
        if p < COMMON.change_p and (best is None or p < best.p):
            best = Change(lot.tools[which[place - 1]].tool, before, behind, p)
    return best


def _outliers(lot: LotScores, pooled: Mapping[int, Pooled], tests: int) -> tuple[Outlier, ...]:
    """The tools that their lot does not predict; of each the effect that shows it most, and its class."""
    found = []
    by_tool: dict[int, dict[int, float]] = {}
    for entry in pooled:
        score, information, which = lot.of(entry)
        for place in conspicuous(score, information).tolist():
            i = which[place]
            by_tool.setdefault(i, {})[entry] = outlying(score, information, place)
    for i, of_tool in sorted(by_tool.items()):
        best = min(of_tool, key=lambda e: of_tool[e])
        if of_tool[best] * tests > COMMON.outlier_p:
            continue
        near = [e for e, p in sorted(of_tool.items(), key=lambda item: item[1]) if p < of_tool[best] * np.exp(3.0)]
        own = list(lot.amplitudes[best])
        tool = lot.tools[i]
        estimate = np.linalg.pinv(tool.information[np.ix_(own, own)], hermitian=True) @ tool.score[own]
        found.append(
            Outlier(
                lot.lot,
                tool.tool,
                lot.entries[best],
                tuple(lot.entries[e] for e in near),
                float(of_tool[best]),
                estimate - pooled[best].mean,
            )
        )
    return tuple(found)
