"""The diagnosis of a published error table: from means and peak-to-peaks after a correction to a verdict.

The whole chain is simulated (`summary_chain`), sets of effects are fitted to all cells at once (`summary_fit`), the
best set is searched and each of its terms is replaced by others (`summary_search`). A term is given its name where no
set without it and its class comes near, and where it moves a mean otherwise than by a constant: a peak-to-peak of a sum
has lost order and phase of what is in it. The rest is reported as a remainder. Misfits are in units of sigma: what
chance and the scatter that stays unexplained do to a cell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import INTERVALS, PLACES
from highside.diagnosis.core.probability import chi2_beyond
from highside.diagnosis.core.result import (
    Claim,
    DiagnosisResult,
    Fit,
    FittedParameter,
    Location,
    Remainder,
    Rival,
    Verdict,
)
from highside.diagnosis.table.advice import next_station
from highside.diagnosis.table.chain import CELLS, Linear, Procedure, predict_cells
from highside.diagnosis.table.explained import Explained, TableProblem, explain, prepare
from highside.diagnosis.table.fit import ErrorTable, Fitted, covariance_of_values, deviance_at, fit_set
from highside.diagnosis.table.instrument import detectable, instrument
from highside.diagnosis.table.policy import TABLE_VERDICT
from highside.diagnosis.table.search import (
    TableRanking,
    alike,
    held_out_row,
    other_amplitudes,
    ranking,
)
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel


@dataclass(frozen=True)
class SummaryReportData:
    """What a report draws, all (R, 4) in the order of `CELLS`: deg reported and predicted, and misfits in sigma."""

    inc_deg: Array
    published: Array
    base: Array
    fitted: Array
    sigma: Array

    @property
    def before(self) -> Array:
        """Misfit of the base in sigma."""
        return np.asarray((self.published - self.base) / self.sigma)

    @property
    def after(self) -> Array:
        """Misfit with the claims in sigma."""
        return np.asarray((self.published - self.fitted) / self.sigma)


@dataclass(frozen=True)
class Summarised:
    """The answer, what a report draws, and the instruments that were fitted, with the noise of a reading in g.

    `before` is the model refitted alone, `named` has what was given a name beside that, `whole` everything that helps.
    """

    diagnosis: DiagnosisResult
    report_data: SummaryReportData
    before: ForwardModel
    named: ForwardModel
    whole: ForwardModel
    noise_g: float
    explained: Explained
    """all sets that were tried: what else explains the table (`summary_posterior` draws instruments from them)"""


def diagnose_summary(
    inc_deg: Array,
    published: Array,
    procedure: Procedure,
    model: ForwardModel,
    free: Sequence[str],
    *,
    noise_g: float | None = None,
    seed: int = 1,
    version: str = "",
    progress: Callable[[float, str], None] | None = None,
) -> Summarised:
    """Diagnose R rows `published` (R, 4) in deg (NaN where lost) at inclinations (R,) against a model.

    `free` are the effects that may be refitted anyway; `noise_g` the standard deviation of one reading, fitted where it
    is None. Raises InputError where the table says too little.
    """
    report_progress = progress or (lambda share, words: None)
    problem = prepare(inc_deg, published, procedure, model, tuple(free), noise_g, seed)
    explained = explain(problem, lambda share, words: report_progress(TABLE_VERDICT.progress[0] * share, words))
    problem, best, table = explained.problem, explained.best, explained.problem.table
    rankings: dict[int, TableRanking] = {}
    for k in range(len(best.options)):
        if _shows_in_means(table, best, k):
            report_progress(
                TABLE_VERDICT.progress[0] + TABLE_VERDICT.progress[1] * k / len(best.options),
                f"rivals of {best.options[k].effect}",
            )
            rankings[k] = ranking(table, problem.options, problem.base, best, explained.tried, k)
    report_progress(sum(TABLE_VERDICT.progress), "inclination stations left out")
    return _conclude(explained, rankings, version)


def _conclude(explained: Explained, rankings: dict[int, TableRanking], version: str) -> Summarised:
    problem, best, tried, lost = explained.problem, explained.best, explained.tried, explained.lost
    table, base = problem.table, problem.base
    places = [_location(table, best, k) for k in range(len(best.options))]
    believed = [k for k, s in rankings.items() if s.without >= TABLE_VERDICT.believed and s.shapes == 1]
    share = (
        1.0 - (best.tau_rad / base.tau_rad) ** 2 if _scatter_gain(table, best) > TABLE_VERDICT.observed_scatter else 1.0
    )
    mask = table.mask
    beyond = _scatter_gain(table, best)
    gated = _implausible(best)
    verdict = _verdict(best, believed, beyond > TABLE_VERDICT.observed_scatter, share, bool(lost), gated)
    published = verdict in ("named", "named_plus")
    parameters = _parameters(problem, best)
    location = tuple(places[k] for k in (believed if published else range(len(best.options))))
    if not best.options and verdict == "unknown":
        location = (_base_location(table, base, best),)
    claims = tuple(_claim(problem, best, k, rankings[k], parameters[k]) for k in believed) if published else ()
    sigma = best.sigma(table)
    report_data = SummaryReportData(np.degrees(table.sessions.inc_rad), table.published, base.cells, best.cells, sigma)
    diagnosis = DiagnosisResult(
        verdict=verdict,
        location=location,
        claims=claims,
        fit=_proof(table, base, best, report_data, mask),
        remainder=_remainder(problem, best, tried, rankings, believed if published else [], lost, beyond, report_data),
        not_testable=tuple(problem.lacking),
        minimum_detectable=detectable(problem.table, problem.options, best),
        noise={
            "model": "chance drawn from the simulated chain, and a scatter beyond it",
            "reading_noise_g": best.noise_g,
            "reading_noise_is": "fitted" if table.noise_g is None else "given",
            "scatter_beyond_chance_rad": {"before": base.tau_rad, "after": best.tau_rad},
            "scatter_evidence": beyond,
            "score": {"before": base.score, "after": best.score},
            "nuisances": {
                name: float(v * u)
                for name, v, u in zip(problem.base_names, best.values, problem.base_units, strict=False)
            },
            "unexplained_rows_deg": {f"{np.degrees(table.sessions.inc_rad[r]):g}": p for r, p in lost.items()},
        },
        seed=problem.seed,
        version=version,
    )
    knows = problem.model, problem.base_names, problem.base_units
    return Summarised(
        diagnosis,
        report_data,
        before=instrument(*knows, base, []),
        named=instrument(*knows, best, believed if published else []),
        whole=instrument(*knows, best, range(len(best.options))),
        noise_g=best.noise_g,
        explained=explained,
    )


def _scatter_gain(table: ErrorTable, fitted: Fitted) -> float:
    """How much more likely the cells are with a scatter beyond chance than without (deviance)."""
    mask = table.mask
    left = (table.published - fitted.cells).reshape(-1)[mask]
    chance = fitted.chance[np.ix_(mask, mask)]
    return deviance_at(TABLE_VERDICT.no_scatter_rad, chance, table.spread[mask], left) - deviance_at(
        fitted.tau_rad, chance, table.spread[mask], left
    )


def _verdict(best: Fitted, believed: list[int], beyond: bool, share: float, lost: bool, gated: list[str]) -> Verdict:
    if not best.options:
        return "unknown" if beyond else "nothing_left_out"
    if gated:
        return "implausible_fit"
    if not believed or share < TABLE_VERDICT.named_share:
        return "partial"
    return "named_plus" if lost or len(believed) < len(best.options) else "named"


def _implausible(best: Fitted) -> list[str]:
    outside = []
    for k, option in enumerate(best.options):
        effect = all_effects()[option.effect]
        values = best.values[best.own(k)] * option.typical
        gates = {p.name: p.gate for p in effect.parameters}
        outside += [
            f"{option.effect}.{name}"
            for name, value in zip(option.amplitudes, values, strict=True)
            if not gates[name][0] <= value <= gates[name][1]
        ]
    return outside


def _parameters(problem: TableProblem, best: Fitted) -> list[dict[str, FittedParameter]]:
    std = np.sqrt(np.diag(covariance_of_values(problem.table, best)))
    result = []
    for k, option in enumerate(best.options):
        effect = all_effects()[option.effect]
        own = best.own(k)
        fitted: dict[str, FittedParameter] = {}
        for name, unit, value, error in zip(option.amplitudes, option.typical, best.values[own], std[own], strict=True):
            kind = next(p.unit for p in effect.parameters if p.name == name)
            v, e = float(value * unit), float(error * unit)
            fitted[name] = FittedParameter(v, e, v - INTERVALS.normal * e, v + INTERVALS.normal * e, kind)
        for name, shape in option.shape:
            kind = next(p.unit for p in effect.parameters if p.name == name)
            fitted[name] = FittedParameter(shape, 0.0, shape, shape, kind)
        result.append(fitted)
    return result


def _gain_p(table: ErrorTable, best: Fitted, index: int) -> float:
    others = tuple(o for k, o in enumerate(best.options) if k != index)
    rest = fit_set(table, others, best)
    option = best.options[index]
    p = chi2_beyond(max(rest.deviance - best.deviance, 0.0), len(option.amplitudes))
    return min(1.0, p * option.tries)


def _moves(table: ErrorTable, best: Fitted, index: int) -> Array:
    """(R, 4) sigma by which one term moves the cells that count."""
    without = best.values.copy()
    without[best.own(index)] = 0.0
    linear = Linear(table.sessions, table.start, np.concatenate([table.base, *(o.field for o in best.options)]))
    predicted = predict_cells(linear, without, best.noise_g, table.draws, slopes=False).cells.mean(axis=0)
    return np.where(table.mask.reshape(-1, 4), (best.cells - predicted) / best.sigma(table), 0.0)


def _shows_in_means(table: ErrorTable, best: Fitted, index: int) -> bool:
    """Whether a term moves a mean.

    A constant of toolface does not count: errors of the correction's own poses make one.
    """
    moved = _moves(table, best, index)
    rows = table.mask.reshape(-1, 4).any(axis=1)
    inc, tf = moved[rows, 0], moved[rows, 2]
    weight = 1.0 / best.sigma(table)[rows, 2]
    constant = float(np.sum(tf * weight) / np.sum(weight**2))
    energy = float(np.sum(inc**2) + np.sum((tf - constant * weight) ** 2))
    return energy > TABLE_VERDICT.shows and energy > TABLE_VERDICT.of_means * float(np.sum(moved**2))


def _location(table: ErrorTable, best: Fitted, index: int) -> Location:
    """Rows and columns that one term moves, in sigma."""
    moved = _moves(table, best, index)
    return _where(table, moved, 1.0, _gain_p(table, best, index))


def _base_location(table: ErrorTable, base: Fitted, best: Fitted) -> Location:
    z = np.nan_to_num((table.published - base.cells) / np.sqrt(np.diag(best.chance)).reshape(-1, 4))
    return _where(table, z, 1.0, chi2_beyond(_scatter_gain(table, base), 1))


def _where(table: ErrorTable, moved: Array, share: float, p: float) -> Location:
    moved = np.where(table.mask.reshape(-1, 4), moved, 0.0)
    by_column = np.sum(moved**2, axis=0)
    columns = [c for c in range(4) if by_column[c] > PLACES.channel_share * by_column.max()]
    by_row = np.sum(moved[:, columns] ** 2, axis=1)
    order = np.argsort(table.sessions.inc_rad)
    inc = np.degrees(table.sessions.inc_rad[order])
    significant = by_row[order] > PLACES.ranged * by_row.max()
    intervals: list[tuple[float, float]] = []
    for k in range(inc.size):
        if significant[k]:
            if k and significant[k - 1]:
                intervals[-1] = (intervals[-1][0], float(inc[k]))
            else:
                intervals.append((float(inc[k]), float(inc[k])))
    return Location(tuple(CELLS[c] for c in columns), "inc_ref_deg", tuple(intervals), None, share, p)


def _claim(
    problem: TableProblem, best: Fitted, index: int, own: TableRanking, parameters: dict[str, FittedParameter]
) -> Claim:
    effect = all_effects()[own.option.effect]
    instead = {name: fitted for name, fitted in own.instead.items() if name in own.same}
    advice = next_station(
        problem.model, problem.table, problem.base_names, problem.base_units, best, instead, problem.seed
    )
    return Claim(
        effect=effect.id,
        story=effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        parameters=parameters,
        p_familywise=min(1.0, len(problem.options) * _gain_p(problem.table, best, index)),
        equivalence_class=own.same,
        rivals_ruled_out=tuple(
            Rival(name, float(cost)) for name, cost in sorted(own.ruled_out.items(), key=lambda item: item[1])
        ),
        next_manoeuvre=advice or effect.splitter,
    )


def _proof(
    table: ErrorTable, base: Fitted, best: Fitted, report_data: SummaryReportData, mask: NDArray[np.bool_]
) -> Fit:
    """Each inclination predicted from the others, in units of the cells' final sigma."""
    cells = mask.reshape(-1, 4)
    rows = np.flatnonzero(cells.any(axis=1))

    def held_out(fitted: Fitted) -> Array:
        return np.array(
            [np.mean((held_out_row(table, fitted, int(r))[0] / report_data.sigma[r])[cells[r]] ** 2) for r in rows]
        )

    before, after = held_out(base), held_out(best) if best.options else held_out(base)
    relative = (before - after) / before.mean()
    half = INTERVALS.normal * float(relative.std(ddof=1) / np.sqrt(relative.size))
    return Fit(
        unit="sigma",
        rmse_before=float(np.sqrt(np.mean(report_data.before[cells] ** 2))),
        rmse_after=float(np.sqrt(np.mean(report_data.after[cells] ** 2))),
        heldout_rmse_before=float(np.sqrt(before.mean())),
        heldout_rmse_after=float(np.sqrt(after.mean())),
        heldout_gain_low=float(relative.mean()) - half,
        heldout_gain_high=min(1.0, float(relative.mean()) + half),
        noise_floor=1.0,
        how_held_out=f"each of {rows.size} inclinations in turn; gain = share of the held-out mean square removed",
    )


def _remainder(
    problem: TableProblem,
    best: Fitted,
    tried: Sequence[Fitted],
    rankings: dict[int, TableRanking],
    believed: list[int],
    lost: dict[int, float],
    beyond: float,
    report_data: SummaryReportData,
) -> Remainder:
    table = problem.table
    hints = []
    resembles: list[str] = []
    for k, option in enumerate(best.options):
        if k in believed:
            continue
        same = rankings[k].same if k in rankings else alike(best, tried, k)
        resembles += [name for name in same if name not in resembles]
        others = f" (so do {', '.join(same[1:])})" if len(same) > 1 else ""
        why = (
            "other sets without it come near"
            if k in rankings
            else "it shows in peak-to-peaks only, which have lost order and phase: errors by toolface would tell"
        )
        hints.append(f"something like {option.effect} helps as well{others}, but has no sure name: {why}")
    for k in believed:
        turned = other_amplitudes(best, tried, k)
        if turned:
            parts = "; ".join(", ".join(names) for names in turned)
            hints.append(f"{best.options[k].effect} does as well with other amplitudes: {parts}")
    cells = np.where(table.mask.reshape(-1, 4), report_data.after, 0.0)
    for row, column in sorted(
        zip(*np.nonzero(np.abs(cells) > TABLE_VERDICT.off), strict=True), key=lambda at: -abs(cells[at])
    ):
        hints.append(
            f"the row at {report_data.inc_deg[row]:g} deg stays off: its {CELLS[column]} is "
            f"{cells[row, column]:+.1f} sigma beside what is explained"
        )
    for row in lost:
        z = report_data.after[row]
        worst = int(np.nanargmax(np.abs(z)))
        hints.append(
            f"the row at {report_data.inc_deg[row]:g} deg is not explained (p = {lost[row]:.1e} from the others; "
            f"{CELLS[worst]} is {z[worst]:+.1f} sigma): measure it again"
        )
    if beyond > TABLE_VERDICT.observed_scatter:
        hints.append(
            f"rows scatter by {np.degrees(best.tau_rad):.4f} deg of direction beyond chance "
            f"({np.degrees(problem.base.tau_rad):.4f} before): they were not measured under one and the same state"
        )
    location: tuple[Location, ...] = ()
    if lost:
        z = np.where(np.isin(np.arange(len(report_data.inc_deg)), list(lost))[:, None], report_data.after, 0.0)
        everything = replace(table, use=np.ones_like(table.use))
        location = (_where(everything, np.nan_to_num(z), 1.0 - 0.0, min(lost.values())),)
    p = chi2_beyond(max(beyond, 0.0), 1)
    return Remainder(location, tuple(hints), p, tuple(resembles))
