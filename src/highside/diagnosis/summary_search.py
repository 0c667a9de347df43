"""Which set of effects explains a published table: a beam search over sets, what each member can be exchanged for, and
rows that no set explains.

A few dozen numbers, half of them peak-to-peaks that have lost their phase, are explained by many sets nearly as well.
One path of best next steps goes astray among them, so the best few sets of each size are kept. A member of the best set
is believed where no set without it comes near; what takes its place in a set that does come near is of its class.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.summary_fit import Fitted, Option, Table, fit_set

Array = NDArray[np.float64]

WIDTH = 6
MAX_EFFECTS = 5
STEP = 6.0
"""What one more effect must improve the score by (as a difference of BIC: strong)."""
SAME = 6.0
"""Sets whose scores differ by less cannot be told apart."""
UNEXPLAINED_P = 1e-3
"""A row less likely than this, predicted from the others, is not explained (over all rows)."""

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class Search:
    """All sets that were tried, best first, and the best."""

    best: Fitted
    tried: list[Fitted]


def search(
    table: Table,
    options: Sequence[Option],
    base: Fitted,
    *,
    width: int = WIDTH,
    depth: int = MAX_EFFECTS,
    seeds: Sequence[Fitted] = (),
    report: Report | None = None,
) -> Search:
    """Beam search from the base fit (and from other fitted sets). The smallest set within `STEP` a member of the best
    score is the answer."""
    beam: list[Fitted] = [base, *seeds]
    every: dict[frozenset[Option], Fitted] = {frozenset(f.options): f for f in beam}
    for size in range(1, depth + 1):
        grown: dict[frozenset[Option], Fitted] = {}
        for count, parent in enumerate(beam):
            for option in options:
                key = frozenset((*parent.options, option))
                if option.effect in parent.effects or key in grown or key in every:
                    continue
                grown[key] = fit_set(table, (*parent.options, option), parent)
            if report:
                report((size - 1 + (count + 1) / len(beam)) / depth, f"sets of {size}")
        if not grown:
            break
        every |= grown
        before = min(f.score for f in beam)
        beam = sorted(grown.values(), key=lambda f: f.score)[:width]
        if beam[0].score > before - 0.5 * STEP:
            break
    tried = sorted(every.values(), key=lambda f: f.score)
    return Search(_smallest(tried), tried)


def _smallest(tried: Sequence[Fitted]) -> Fitted:
    """The best set such that each member it has more than another is worth `STEP`."""
    return min(tried, key=lambda f: f.score + STEP * len(f.options))


@dataclass(frozen=True)
class Standing:
    """One member of the best set: how much better sets with it are than sets without it, and what may replace it."""

    option: Option
    without: float
    """score lost by the best set that holds neither it nor anything of its class"""
    same: tuple[str, ...]
    instead: dict[str, Fitted]
    """the best set without this effect, by the effect that takes its place"""
    ruled_out: dict[str, float]
    """score lost by exchanging it for another effect, where that is clear"""


def standing(
    table: Table, options: Sequence[Option], base: Fitted, best: Fitted, tried: Sequence[Fitted], index: int
) -> Standing:
    """Search without one member's effect, the other members given and free to go, and compare."""
    option = best.options[index]
    others = tuple(o for k, o in enumerate(best.options) if k != index)
    rest = fit_set(table, others, best) if others else base
    allowed = [o for o in options if o.effect != option.effect]
    found = search(table, allowed, base, width=3, depth=2, seeds=[rest])
    rivals = [f for f in (*found.tried, *tried) if option.effect not in f.effects]
    kept = {o.effect for o in others}

    def cost(fitted: Fitted) -> float:
        return fitted.score + STEP * len(fitted.options)

    level = cost(best)
    instead: dict[str, Fitted] = {}
    for fitted in sorted(rivals, key=cost):
        for effect in fitted.effects - kept:
            instead.setdefault(effect, fitted)
    same = tuple(effect for effect, fitted in instead.items() if cost(fitted) - level < SAME)
    clear = {effect: cost(fitted) - level for effect, fitted in instead.items() if effect not in same}
    without = min((cost(f) - level for f in rivals if not f.effects & set(same)), default=np.inf)
    return Standing(option, float(without), (option.effect, *same), instead, clear)


def left_out_row(table: Table, fitted: Fitted, row: int) -> tuple[Array, Array, Array]:
    """Prediction of one row from the others: residual (4,), its covariance (4, 4) in deg, and which cells count."""
    part = fit_set(table.without_row(row), fitted.options, fitted, rounds=1)
    cov = part.covariance(table)
    mask = np.isfinite(table.told[row])
    if table.sessions.degenerate()[row]:
        mask[:2] = False
    cells = np.arange(4 * row, 4 * row + 4)
    rest = np.flatnonzero(table.without_row(row).mask)
    # chance that the rows share (the correction's poses) is predicted too
    left = (table.told - part.cells).reshape(-1)
    gain = np.linalg.solve(cov[np.ix_(rest, rest)], cov[np.ix_(rest, cells)]).T
    # and what the others do not determine of the parameters adds to the uncertainty
    open_slope = part.jacobian[:, cells].T - gain @ part.jacobian[:, rest].T
    inner = part.jacobian[:, rest] @ np.linalg.solve(cov[np.ix_(rest, rest)], part.jacobian[:, rest].T)
    inner += np.eye(inner.shape[0]) / 30.0**2
    spread = cov[np.ix_(cells, cells)] - gain @ cov[np.ix_(rest, cells)]
    spread = spread + open_slope @ np.linalg.solve(inner, open_slope.T)
    return np.nan_to_num(left[cells] - gain @ left[rest]), np.asarray(spread), mask


def unexplained_rows(table: Table, fitted: Fitted) -> dict[int, float]:
    """Rows that the others do not predict, with the probability of their departure."""
    from scipy.stats import chi2

    found: dict[int, float] = {}
    rows = np.flatnonzero(table.use)
    for row in rows:
        left, cov, mask = left_out_row(table, fitted, int(row))
        if not mask.any():
            continue
        value = float(left[mask] @ np.linalg.solve(cov[np.ix_(mask, mask)], left[mask]))
        p = float(chi2.sf(value, int(mask.sum())))
        if p * rows.size < UNEXPLAINED_P:
            found[int(row)] = p
    return found

