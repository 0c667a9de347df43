"""The diagnosis of a recording with a known reference, from what it was prepared to (a `Problem`) to a verdict.

1. base fit (the effects that may be refitted anyway), 2. noise from what no candidate explains, 3. scan of the residual
outside of the base for places, 4. race of the candidates, 5. classes of what cannot be distinguished, 6. joint refit
with intervals, values that are plausible, 7. proof on held-out blocks, 8. scan of the remainder, verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from highside.diagnosis.beside_laws import names_before_laws, with_laws
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import INCLINATION_STATION
from highside.diagnosis.core.conclusion import conclude, is_significant
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.memory import Channel, beats_random_walk, slow_scores
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.observed import energy
from highside.diagnosis.core.policy import FITS, PROCEDURE, RIVALS
from highside.diagnosis.core.problem import N, Problem, ReportData, SelectionState
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.rival_refit import kept, with_best_rival, without_unneeded
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.serial_correlation import (
    SerialCorrelation,
    needed_together,
    no_serial_correlation,
    serial_correlation_beside,
    serial_correlation_of,
    slow_ranking,
)
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.identified_noise import beside_floor, with_remembering_rows
from highside.diagnosis.law_sessions import ChainSession, MagnitudeLaws
from highside.diagnosis.poses.problem import PoseProblem
from highside.diagnosis.poses.session import PoseSession
from highside.physics.forward import ForwardModel

if TYPE_CHECKING:
    # of kinds of reference other than poses: loaded by those who have one
    from highside.diagnosis.magnitude.session import MagnitudeSession
    from highside.diagnosis.rotation.problem import RotationProblem
    from highside.diagnosis.rows.session import RotationSession
    from highside.diagnosis.simulation.session import SimulationSession

__all__ = [
    "ReportData",
    "diagnose",
    "diagnose_magnitudes",
    "diagnose_poses",
    "diagnose_rotation",
    "diagnose_simulation",
]


def diagnose_poses(
    session: PoseSession,
    model: ForwardModel,
    free: Sequence[str],
    *,
    seed: int = 1,
    version: str = "",
    method: ProcedureParts = WHOLE,
) -> tuple[DiagnosisResult, ReportData]:
    """Diagnose n poses against a model whose effects `free` may be refitted. The same seed gives the same answer."""
    problem = PoseProblem.of(session, model, tuple(free), seed, method)
    found, report = diagnose(problem, version)
    if method.laws:
        found, report = with_laws(ChainSession.of_poses(session, free), problem.model, found, report)
    found, report = beside_floor(session, found, report, problem.floor_excess([]), problem.readings)
    return with_remembering_rows(session, problem.base, found, report) if method.colour else (found, report)


def diagnose_rotation(
    session: RotationSession,
    model: ForwardModel,
    free: Sequence[str],
    *,
    seed: int = 1,
    version: str = "",
    method: ProcedureParts = WHOLE,
) -> tuple[DiagnosisResult, ReportData]:
    """As `diagnose_poses`, for the n rows of a continuous rotation.

    What is found in a short one, laws beyond chance apart, must stand where noise is followed in finer blocks too.
    """
    from highside.diagnosis.rows.colour import is_doubtful
    from highside.diagnosis.rows.policy import GRAMS

    answer = _diagnosed_rotation(session, model, free, seed=seed, version=version, method=method)
    short = not session.long and session.n <= GRAMS.block_rows * GRAMS.max_blocks
    if not short or not method.colour or answer[0].verdict not in ("unknown", "partial", "named", "named_plus", "law"):
        return answer
    if answer[0].verdict == "law" and not is_doubtful(answer[0]):
        return answer
    names = replace(method, laws=False)
    finer = _diagnosed_rotation(
        replace(session, finer_blocks=True), model, free, seed=seed, version=version, method=names
    )
    return finer if finer[0].verdict == "nothing_left_out" else answer


def _diagnosed_rotation(
    session: RotationSession,
    model: ForwardModel,
    free: Sequence[str],
    *,
    seed: int,
    version: str,
    method: ProcedureParts,
) -> tuple[DiagnosisResult, ReportData]:
    """A rotation under one choice of blocks.

    Of a long one some rows are diagnosed first: strong effects show there, and what they do beyond first order is known
    before all rows are passed through.
    """
    from highside.diagnosis.beside_noise import beside_noise
    from highside.diagnosis.rotation.pilot import PilotFit, may_be_nonlinear
    from highside.diagnosis.rotation.policy import PILOT
    from highside.diagnosis.rotation.problem import RotationProblem
    from highside.diagnosis.rows.colour import with_long_memory

    pilot = None
    if session.n > PILOT.many_rows and may_be_nonlinear(session, model, free, seed):
        rows = session.thinned(PILOT.pilot_rows, seed)
        subsample, selection, _ = _relinearised_selection(RotationProblem.of(rows, model, tuple(free), seed, method))
        pilot = PilotFit.of(rows, subsample, selection.terms)
    problem = RotationProblem.of(session, model, tuple(free), seed, method, pilot)
    chosen = _relinearised_selection(problem, pilot.names if pilot else ())
    answer = conclude(*chosen, version)
    if method.laws:
        cells = _for_laws(session, free, problem)
        many = None
        if answer[0].verdict == "partial" and len(chosen[1].terms) > problem.policy.most_named:
            # harmonics of the toolface are matched by several names together: unless laws compete with them and lose
            many = names_before_laws(cells, problem.model, *conclude(*chosen, version, many=True))
        answer = many or with_laws(cells, problem.model, *answer)
    found, report = with_long_memory(answer[0], session), answer[1]
    if not session.long:
        return beside_noise(found, report, session), report
    own, stretch = session.sample_stretch
    found = beside_noise(found, replace(report, after=report.after[:, own]), stretch)
    if found.verdict == "wander":
        words = (
            "in so many rows an error of the colour of the noise may pass for a random walk: diagnose parts of about a "
            "million rows each, and compare"
        )
        found = hinted(found, words)
    return hinted(found, by_samples(session, laws=method.laws)), report


def _for_laws(session: RotationSession, free: Sequence[str], problem: RotationProblem) -> ChainSession:
    """The rows in which laws are sought: all, or those that stand for them."""
    if session.long:
        return ChainSession.of_rotation(session.sample, free, problem.residual[:, session.sample_rows])
    return ChainSession.of_rotation(session, free, problem.residual)


def by_samples(session: RotationSession, *, laws: bool) -> str:
    """What was not done with all rows of a recording that is not in the memory, in words."""
    from highside.diagnosis.rotation.lines import searched
    from highside.diagnosis.rows.noise import windows
    from highside.diagnosis.rows.policy import ROW_SESSIONS

    part, count = searched(session), session.sample_rows.size
    learned = sum(window.stop - window.start for window in windows(session.n))
    words = (
        f"all {session.n} rows were used for fits, tests and the choice of effects; the colour of the noise was "
        f"learned from {learned} of them, single lines were looked for in {part.stop - part.start}, and what is left "
        f"was held beside the noise of sensors in {count // ROW_SESSIONS.sample_stretches}"
    )
    if not laws:
        return f"{words}; laws were not looked for"
    return f"{words}; laws were sought in {count}, which lie in {ROW_SESSIONS.sample_stretches} stretches"


def diagnose_magnitudes(
    session: MagnitudeSession, model: ForwardModel, free: Sequence[str], *, seed: int = 1, version: str = ""
) -> tuple[DiagnosisResult, ReportData]:
    """As `diagnose_poses`, for n still readings of which only the magnitude is known."""
    from highside.diagnosis.closed_rivals import with_closed_rivals
    from highside.diagnosis.magnitude.problem import MagnitudeProblem

    problem = MagnitudeProblem.of(session, model, tuple(free), seed)
    answer = diagnose(problem, version)
    if answer[0].verdict == "not_testable" or session.few:
        return answer
    base = base_fit(problem.model.without(*problem.about), problem.observed, free)[0]
    laws = MagnitudeLaws.of(session, problem.observed, free)
    answer = with_laws(laws, base, *answer)
    return answer if session.rest else with_closed_rivals(laws, base, *answer)


def diagnose_simulation(
    session: SimulationSession, free: Sequence[str], *, seed: int = 1, version: str = "", method: ProcedureParts = WHOLE
) -> tuple[DiagnosisResult, ReportData]:
    """Diagnose channels beside another program's prediction; `free` are refitted; `method` says if laws are sought."""
    from highside.diagnosis.law_channels import UNTOUCHED, with_channel_laws
    from highside.diagnosis.rows.colour import with_long_memory
    from highside.diagnosis.simulation.constants import with_one_for_two
    from highside.diagnosis.simulation.measured_clock import with_measured_clock
    from highside.diagnosis.simulation.missing_turn import missing_turn
    from highside.diagnosis.simulation.motion import missing_motion, with_missing_motion
    from highside.diagnosis.simulation.noise_of_sensors import beside_noise_of_sensors, white_of
    from highside.diagnosis.simulation.problem import SimulationProblem

    problem = SimulationProblem.beside(session, tuple(free), seed)
    problem, found, report = with_measured_clock(problem, *diagnose(problem, version))
    turned = missing_turn(problem.session, report.after)
    if turned is not None and found.verdict not in UNTOUCHED:
        # no law is sought in what a motion does: laws of single channels would share it out
        return with_missing_motion(found, turned), report
    found, seen = beside_noise_of_sensors(problem, found, report.after)
    if method.laws:
        found, report = with_channel_laws(problem, found, report)
    if found.verdict == "unknown" and not found.claims and seen.any:
        found = with_missing_motion(
            found, missing_motion(problem.session, report.after, white_of(problem, report.after))
        )
    # whatever the colour of the noise: no error of it explains what no noise of sensors does
    certain = seen.no_noise is not None and found.verdict == "unknown"
    found = found if certain else with_long_memory(found, problem.session)
    return with_one_for_two(found, report, problem.session)


def diagnose(problem: Problem[N], version: str = "") -> tuple[DiagnosisResult, ReportData]:
    """Choose, compare, prove and report."""
    return conclude(*_relinearised_selection(problem), version)


def _relinearised_selection(
    problem: Problem[N], taken_out: Sequence[str] = ()
) -> tuple[Problem[N], SelectionState[N], SerialCorrelation[N]]:
    """What is chosen, and the problem in which it was; of effects `taken_out` its second-order part is already.

    Everything is chosen by what effects do to first order. Where those that are chosen do more than that, what they do
    beyond it at their fitted sizes is taken out of the readings, and it is chosen again: else the rest of a strong
    effect would be given a name of its own.
    """
    selection, correlation = _selected(problem)
    learned = problem.learned_beside(selection)
    if learned is not None:
        problem = learned
        selection, correlation = _selected(problem)
    selection = kept(problem, selection, taken_out)
    if correlation.random_walk and not correlation.claimed:
        problem, selection, correlation = _refined(problem, selection, correlation)
    compared: set[int] = set()
    for _ in range(PROCEDURE.relinearisations):
        named = [m for m in selection.terms if problem.candidates[m.candidate].named]
        fit = problem.fit(named, selection.noise) if named else None
        selection = replace(selection, fit=fit)
        nonlinear = fit is not None and fit.beyond >= FITS.second_order and problem.relinearises
        if fit is not None and nonlinear and len(named) == len(selection.terms) and _which(named) != compared:
            selection = with_best_rival(problem, selection, fit)
            compared = _which(selection.terms)
        selection = without_unneeded(problem, selection)
        beyond = None if selection.fit is None else selection.fit.second_order
        second_order = 0.0 if beyond is None else beyond
        other = second_order - problem.second_order
        if isinstance(other, float) or not np.any(other) or energy(problem.noise, other) < FITS.second_order:
            break
        relinearised = problem.relinearised(second_order)
        if relinearised is None:
            break
        problem = relinearised
        taken_out = [problem.candidates[m.candidate].id for m in selection.terms]
        selection, correlation = _selected(problem)
        selection = kept(problem, selection, taken_out)
    return problem, selection, correlation


def _which(terms: Sequence[Term]) -> set[int]:
    return {m.candidate for m in terms}


def _selected(problem: Problem[N]) -> tuple[SelectionState[N], SerialCorrelation[N]]:
    """What is chosen, and what was found of memory in the noise."""
    selection = problem.prepare(problem.noise)
    channels = problem.likelihoods([])
    slow = frozenset(i for i, c in enumerate(problem.candidates) if c.id in problem.slow_ids)
    unnamed = frozenset(i for i, c in enumerate(problem.candidates) if not c.named)
    inclination_stations = frozenset(i for i in unnamed if problem.candidates[i].id.startswith(INCLINATION_STATION))
    # first what has a name and does not follow time, or one inclination station; then, beside that, whether anything
    # slow beats a random walk
    first = _choose(problem, selection, channels, (slow | unnamed) - inclination_stations)
    correlation = (
        serial_correlation_beside(problem, selection, first, slow, unnamed - inclination_stations)
        if problem.method.colour
        else no_serial_correlation(problem)
    )
    doubtful = correlation.random_walk or any(m.candidate in inclination_stations for m in first.terms)
    if doubtful and first.terms and not (correlation.claimed or correlation.admitted):
        # what was chosen may stand in place of something slow: once more beside what is chosen where that may be too
        fast = [
            m
            for m in _choose(problem, selection, channels, unnamed - inclination_stations).terms
            if m.candidate not in slow
        ]
        if fast != first.terms:
            again = serial_correlation_of(problem, fast)
            correlation = again if again.claimed or again.admitted else correlation
    plain = _to_the_floor(problem, selection, channels, unnamed) if not correlation.claimed else None
    if plain is not None:
        return plain, no_serial_correlation(problem)
    if correlation.noise is not problem.noise:
        selection = problem.prepare(correlation.noise)
    fixed = tuple(Term(score.effect.candidate, score.effect.variant) for score in correlation.claimed)
    barred = frozenset(
        i
        for i, c in enumerate(problem.candidates)
        if (i in slow and c.id not in correlation.admitted)
        or (correlation.random_walk and c.id.startswith("interaction:time"))
    )
    if not problem.method.refusal:
        barred |= unnamed
    return _choose(problem, selection, channels, barred, fixed, slow), correlation


def _to_the_floor(
    problem: Problem[N], selection: SelectionState[N], channels: Sequence[Channel], unnamed: frozenset[int]
) -> SelectionState[N] | None:
    """What is chosen where anything slow may be, if that leaves no more than how well the readings repeat.

    Against a random walk of any size a slow effect of three axes never wins. But few numbers take no random walk down
    to a floor that is known without it.
    """
    if problem.remaining([]) is None:
        return None
    free = replace(selection.selector, banned=unnamed, fixed=())
    terms = free.select()
    effects = [problem.candidates[m.candidate].effect for m in terms if problem.candidates[m.candidate].slow]
    # several functions of time together follow a random walk as well; the temperature goes its own way
    if len(effects) != 1 and not (effects and all(e is not None and "temp_c" in e.needs for e in effects)):
        return None
    left = problem.remaining(terms)
    if left is None or not left.explained:
        return None
    return replace(selection, selector=free, terms=terms, to_the_floor=True)


def _refined(
    problem: Problem[N], selection: SelectionState[N], correlation: SerialCorrelation[N]
) -> tuple[Problem[N], SelectionState[N], SerialCorrelation[N]]:
    """The same, or what is chosen where a slow effect that comes near has the time constant that fits best.

    Time constants are tried at a few values. Of a strong effect what lies between them is above the noise, and
    varies as slowly as a random walk does.
    """
    for near in correlation.nearest[: PROCEDURE.refined]:
        term = Term(near.effect.candidate, near.effect.variant)
        second_order = problem.fit([term], problem.noise).second_order
        relinearised = None if second_order is None else problem.relinearised(second_order)
        if relinearised is None:
            continue
        known = serial_correlation_of(relinearised, [])
        scores = slow_ranking(relinearised, [], term.candidate)
        own = max(one.score for one in scores if one.effect.candidate == term.candidate)
        rival = max(one.score for one in scores if one.effect.candidate != term.candidate)
        believed = {one.effect.candidate for one in known.claimed}
        found = term.candidate in believed or problem.candidates[term.candidate].id in known.admitted
        if found and own > rival + RIVALS.same_class_evidence:
            return relinearised, *_selected(relinearised)
    return problem, selection, correlation


def _as_a_slow_one(
    problem: Problem[N], selector: Selector, terms: Sequence[Term], term: Term, slow: frozenset[int]
) -> bool:
    """Whether a term is a case of slow effects of which none would be believed in its place."""
    if not problem.policy.slow_beside_fast:
        # of poses and hands nothing that is fast elsewhere runs like time
        return False
    others = [m for m in terms if m != term]
    best = selector.ranking(others).best
    alike = {k for k in slow if selector.holds([*others, selector.candidate_set.whole(best[k])], term)}
    tested = [one for one in problem.slow() if one.candidate in alike]
    if not tested:
        return False
    scores, _, evidence = slow_scores(problem.likelihoods(others), tested)
    return not any(
        problem.policy.slow.passes(
            problem.candidates[one.effect.candidate].id, one.log_p, one.remaining, of_memory, one.score
        )
        for one, of_memory in zip(scores, evidence.tolist(), strict=True)
    )


def _choose(
    problem: Problem[N],
    selection: SelectionState[N],
    channels: Sequence[Channel],
    banned: frozenset[int],
    fixed: tuple[Term, ...] = (),
    slow: frozenset[int] = frozenset(),
) -> SelectionState[N]:
    """Select among the candidates that are not banned; a named one that a random walk explains as well is not believed.

    A random walk may run like an effect of attitude where the session goes through the inclination stations in order.
    And what is here a case of one of the `slow` is required no less than they are.
    """
    selector = replace(selection.selector, banned=banned, fixed=fixed)
    terms = selector.select()
    if is_significant(problem, replace(selection, selector=selector), terms):
        # something is there: two effects that cancel one another may each be too small to be detected alone
        selector = replace(selector, opposed=True)
        terms = selector.select()
    if not problem.method.colour:
        return replace(selection, selector=selector, terms=terms)

    def needed(subsample: Sequence[Term]) -> bool:
        others = [o for o in terms if o not in subsample]
        dof = len(selector.space_with(terms)) - len(selector.space_with(others))
        stations = [m for m in subsample if problem.candidates[m.candidate].id.startswith(INCLINATION_STATION)]
        searched = subsample if problem.policy.products_beside_memory else stations
        tries = float(np.prod([selector.candidate_set.tries[m.candidate] for m in searched]))
        certain = problem.policy.certain + (PROCEDURE.station_certain if stations else 0.0)
        return beats_random_walk(channels, problem.block(others), problem.block(subsample), dof, tries, certain)

    for _ in range(PROCEDURE.doubts):
        tested = [
            m
            for m in terms
            if (
                problem.candidates[m.candidate].named
                or problem.candidates[m.candidate].id.startswith(INCLINATION_STATION)
                or problem.policy.products_beside_memory
            )
            and problem.candidates[m.candidate].id not in problem.slow_ids
        ]
        doubted = [m for m in tested if not needed([m]) or _as_a_slow_one(problem, selector, terms, m, slow)]
        # beside the one a random walk takes the other's place; what both do together it may not
        if not doubted or (len(doubted) > 1 and needed(doubted)):
            break
        # what is chosen instead must pass the same test
        selector = replace(selector, banned=selector.banned | {m.candidate for m in doubted})
        terms = selector.select()
    together = [m for m in terms if m.candidate not in slow and m not in fixed]
    if (
        problem.policy.slow_beside_fast
        and len(together) > 1
        and not needed_together(problem, selector, channels, together)
    ):
        terms = [m for m in terms if m not in together]
    return replace(selection, selector=selector, terms=terms)
