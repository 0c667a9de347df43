"""Tables without times: what changes from row to row is found, and gets no name that needs a clock.

The rows stand in some order, and what follows it competes with all else: left out, it would be given to a load or to
the temperature. But nothing is said per second of rows of which nobody wrote down when they were taken.
"""

from __future__ import annotations

from dataclasses import replace

from highside.diagnosis.core.result import Claim, DiagnosisResult, NotTestable, Verdict
from highside.diagnosis.core.unexplained import hinted, in_ug, unimproved
from highside.physics import effects as library
from highside.physics.covariates import COVARIATES
from highside.physics.effect import Effect

WITHOUT_TIMES = (
    "the table has no column t_s: the rows are taken to stand in the order in which they were measured, and what "
    "follows time, or how fast a temperature changes, gets no name"
)
WHY = "the table has no column t_s: when each row was taken is not known"
NEEDS = "add a column t_s, in s"


def takes_time(effect: Effect) -> bool:
    """Whether an effect follows the clock, or how fast something goes."""
    clocked = any(p.epoch or p.time_constant for p in effect.parameters)
    return clocked or bool({"t_s", "since_move_s"}.intersection(effect.needs))


def _clocked(claim: Claim) -> bool:
    if claim.law is not None:
        return any(name in COVARIATES and COVARIATES[name].clock for name in claim.depends_on)
    return claim.effect in library.registry() and takes_time(library.get(claim.effect))


def without_clock(diagnosis: DiagnosisResult) -> DiagnosisResult:
    """The diagnosis of rows in their order, without claims and limits that need their times."""
    clocked = {e.id for e in library.all_effects().values() if not e.random and takes_time(e)}
    known = {entry.effect for entry in diagnosis.not_testable}
    lacking = tuple(NotTestable(name, WHY, NEEDS) for name in sorted(clocked - known))
    found = replace(
        diagnosis,
        not_testable=(*diagnosis.not_testable, *lacking),
        minimum_detectable={k: v for k, v in diagnosis.minimum_detectable.items() if k not in clocked},
    )
    gone = [c for c in diagnosis.claims if _clocked(c)]
    if not gone:
        return found
    staying = tuple(c for c in diagnosis.claims if c not in gone)
    verdict: Verdict = "named_plus" if staying else "unknown"
    share = min(1.0, sum(c.share or 0.0 for c in gone))
    part = f"{share:.0%} of what is explained" if share else "it"
    names = tuple(c.effect for c in gone if c.law is None)
    remainder = replace(found.remainder, resembles=(*found.remainder.resembles, *names))
    found = replace(found, verdict=verdict, claims=staying, remainder=remainder)
    if not staying:
        found = replace(found, fit=unimproved(found.fit))
    size = "" if diagnosis.fit is None else f"{in_ug(diagnosis.fit.rmse_before)} rms are left out; "
    words = (
        f"{size}{part} follows the order of the rows; the table has no column t_s, so that no size per second is told"
    )
    return hinted(found, words)
