"""A shift of the clock that every measurement agrees on is reported, though other names beside it are withdrawn.

Real predictions differ from recordings by much that has no name, and then no name may be given for most of the misfit.
A shift of the clock is not in that position: it is measured from the likeness of the two courses alone, without a model
of what else differs, on each channel and over each part of the session. Where all agree, it is sure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.probability import student_quantile
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.regression import p_of
from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter, Location
from highside.diagnosis.simulation.clock_or_filter import LAG
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE
from highside.diagnosis.simulation.problem import SimulationProblem
from highside.diagnosis.simulation.session import OFFSET, SimulationSession

PARTS = 3
"""of a session, in each of which the shift is the same: the beginning, the middle and the end"""
WITHDRAWN = frozenset({"partial", "implausible_fit", "unknown"})


def with_measured_clock(
    problem: SimulationProblem, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[SimulationProblem, DiagnosisResult, ReportData]:
    """The diagnosis with the shift of the clock as its only claim where names were withdrawn and all that measures the
    shift agrees, with the columns made about it; the same where it does not."""
    shift = _measured(problem.session) if diagnosis.verdict in WITHDRAWN and not diagnosis.claims else None
    if shift is None:
        return problem, diagnosis, report
    moved = problem.about_clock(shift.value)
    term = moved.whole_term(OFFSET)
    if term is None:
        return problem, diagnosis, report
    names = {problem.candidates[m.candidate].id for m in problem.chosen.terms}
    claim = _claim(moved, shift, term, either=LAG in names and shift.value > 0.0)
    words = (
        f"the two courses lie {shift.value:.3g} s apart by their likeness alone, without any effect: the shift of the "
        f"clock is sure. What is left beside it has no name that could be given"
    )
    resembles = tuple(name for name in diagnosis.remainder.resembles if name not in claim.equivalence_class)
    remainder = replace(diagnosis.remainder, resembles=resembles, hints=(words, *diagnosis.remainder.hints))
    alone = moved.fit([term], moved.noise)
    found = replace(
        diagnosis,
        verdict="named_plus",
        claims=(claim,),
        location=(Location(moved.channels, "t_s", (), None, 1.0, claim.p_familywise),),
        fit=moved.proof([term], alone),
        remainder=remainder,
    )
    return moved, found, replace(moved.report_data(alone), scores=report.scores)


def _measured(session: SimulationSession) -> FittedParameter | None:
    """The shift of the clock by the likeness of the courses, if there is one: on every channel, and over the beginning,
    the middle and the end of the session, each by itself.

    Of what the prediction lacks a part follows its slope, now with the one sign, now with the other, and moves the
    size that a fit gives to the shift: by what the parts of the session differ is known by how much.
    """
    a, agree = session.alignment, SIMULATION_CHOICE.clocks_agree_s
    if not a.same_clock or a.rate or any(abs(lag_s - a.lag_s) > agree for _, lag_s in a.lags_s):
        return None
    moved = session.about({OFFSET: (a.lag_s,)})
    kept = np.ones(moved.n, dtype=bool) if moved.omitted is None else ~moved.omitted
    parts = np.array_split(np.arange(moved.n), PARTS)
    shifts = np.array([_shift_left(moved, part[kept[part]]) for part in parts])
    value, std = a.lag_s + float(shifts.mean()), float(shifts.std(ddof=1) / np.sqrt(PARTS))
    half = student_quantile(INTERVALS.upper, PARTS - 1) * std
    if np.any(np.abs(shifts) > agree) or abs(value) < max(agree, half):
        return None
    return FittedParameter(value, std, value - half, value + half, "s")


def _shift_left(session: SimulationSession, rows: NDArray[np.intp]) -> float:
    """Seconds by which the recording of these rows lags what is predicted of them, offset and scale of each channel
    free: the mean of the channels by how much each is left to say."""
    along, weight = 0.0, 0.0
    for read, predicted, slope in zip(session.readings, session.predicted, session.slope, strict=True):
        free = np.linalg.qr(np.stack([np.ones(rows.size), predicted[rows]], axis=1))[0]
        left, late = (one - free @ (free.T @ one) for one in (read[rows] - predicted[rows], -slope[rows]))
        variance = max(float(np.mean(left**2)), np.finfo(float).tiny)
        along += float(late @ left) / variance
        weight += float(late @ late) / variance
    return along / weight if weight else 0.0


def _claim(problem: SimulationProblem, shift: FittedParameter, term: Term, *, either: bool) -> Claim:
    """The shift as it was measured; `either` it or a filter's lag."""
    effect = problem.design.effect_of(term.candidate)
    log_p = problem.chosen.selector.ranking([]).log_p[term.candidate]
    (name,) = (p.name for p in effect.parameters)
    return Claim(
        effect=OFFSET,
        story=effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        parameters={name: shift},
        p_familywise=float(min(1.0, len(problem.candidates) * p_of(float(log_p)))),
        equivalence_class=(OFFSET, LAG) if either else (OFFSET,),
        rivals_ruled_out=(),
        next_manoeuvre=effect.splitter,
        share=1.0,
        stable=True,
        channels=problem.channels,
    )
