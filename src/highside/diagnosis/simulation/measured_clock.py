"""A shift of the clock that two measurements agree on is reported, though other names beside it are withdrawn.

Real predictions differ from recordings by much that has no name, and then no name may be given for most of the misfit.
A shift of the clock is not in that position: the alignment measures it from the likeness of the two courses alone,
without a model of what else differs, and the fit measures it beside all other effects. Where both agree, it is sure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.regression import p_of
from highside.diagnosis.core.result import Claim, DiagnosisResult, Location
from highside.diagnosis.core.shares import shares_of
from highside.diagnosis.simulation.clock_or_filter import LAG
from highside.diagnosis.simulation.constancy import stability_beside
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE
from highside.diagnosis.simulation.problem import SimulationProblem
from highside.diagnosis.simulation.session import OFFSET, SKEW

WITHDRAWN = frozenset({"partial", "implausible_fit", "unknown"})


def with_measured_clock(
    problem: SimulationProblem, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with the shift of the clock as its only claim where names were withdrawn and the fit agrees with
    the alignment; the same where it does not."""
    if diagnosis.claims or diagnosis.verdict not in WITHDRAWN:
        return diagnosis, report
    selection = problem.chosen
    by_id = {problem.candidates[m.candidate].id: m for m in selection.terms}
    term = by_id.get(OFFSET)
    if term is None or LAG in by_id or SKEW in by_id:
        return diagnosis, report
    fit = problem.fit(selection.terms, problem.noise)
    if not agrees(problem, fit):
        return diagnosis, report
    steady = stability_beside(problem, selection, term)
    if steady is not None and not steady.stable:
        return diagnosis, report
    share = float(shares_of(selection.selector, selection.terms)[list(selection.terms).index(term)])
    alone = problem.fit([term], problem.noise)
    left = problem.mean_square_left(selection)
    claim = replace(_claim(problem, fit, term, left), share=share, stable=None if steady is None else steady.stable)
    resembles = tuple(name for name in diagnosis.remainder.resembles if name != OFFSET)
    measured = problem.session.alignment.lag_s
    words = (
        f"the two courses lie {measured:.3g} s apart by their likeness alone, without any effect: the shift of the "
        f"clock is sure. What is left beside it has no name that could be given"
    )
    remainder = replace(diagnosis.remainder, resembles=resembles, hints=(words, *diagnosis.remainder.hints))
    place = Location(problem.channels, "t_s", (), None, share, claim.p_familywise)
    found = replace(
        diagnosis,
        verdict="named_plus",
        claims=(claim,),
        location=(place,),
        fit=problem.proof([term], alone),
        remainder=remainder,
    )
    return found, replace(problem.report_data(alone), scores=report.scores)


def agrees(problem: SimulationProblem, fit: JointFit) -> bool:
    """Whether the fitted shift is that of the alignment."""
    a = problem.session.alignment
    found = fit.parameters[OFFSET]["t0"].value
    return a.same_clock and not a.rate and abs(found - a.lag_s) < SIMULATION_CHOICE.clocks_agree_s


def _claim(problem: SimulationProblem, fit: JointFit, term: Term, left: float | None) -> Claim:
    effect = problem.design.effect_of(term.candidate)
    factor = float(np.sqrt(max(left or 1.0, 1.0)))
    parameters = {
        name: replace(
            p,
            std=factor * p.std,
            low=p.value - factor * (p.value - p.low),
            high=p.value + factor * (p.high - p.value),
        )
        for name, p in fit.parameters[OFFSET].items()
    }
    log_p = problem.chosen.selector.ranking([m for m in problem.chosen.terms if m != term]).log_p[term.candidate]
    return Claim(
        effect=OFFSET,
        story=effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        parameters=parameters,
        p_familywise=float(min(1.0, len(problem.candidates) * p_of(float(log_p)))),
        equivalence_class=(OFFSET,),
        rivals_ruled_out=(),
        next_manoeuvre=effect.splitter,
        channels=problem.channels,
    )
