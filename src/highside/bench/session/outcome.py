"""From a complete session to its result: solve, judge what the solver says, make the record.

The record follows from the journal alone: poses from their raw readings, the time from the journal's last line, so that
the same journal gives the same record with the same id.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from highside.arrays import Array
from highside.bench.session import turntable
from highside.bench.session.journal import Header, Journal
from highside.bench.session.ledger import Ledger
from highside.bench.session.plans import SessionKind, SessionPlan
from highside.bench.session.reasons import Rejection
from highside.bench.session.snapshot import PoseState, UncertaintyState
from highside.bench.session.verdict import Found, judge
from highside.calibration.method import Solution, SolveRequest
from highside.calibration.methods import solves_by_inclination
from highside.calibration.record import CalibrationRecord, PoseColumns, build_record, solve_poses
from highside.calibration.remark import Reason
from highside.calibration.result import CalibrationResult
from highside.calibration.sensor_laws import without_laws
from highside.errors import HighsideError, InputError
from highside.physics.gravity import gravity_direction
from highside.rotation.compensation import Compensation

DAY_S = 86_400.0
ALL_INC_DEG = (3.0, 177.0)
"""Toolface has no finite mean square error over all attitudes: it is omitted within 3 deg of vertical."""
ALL_COUNT = 400

_REQUEST_AGAIN = {
    Reason.CLOSURE: Rejection.CLOSURE,
    Reason.BAD_POSE: Rejection.OMITTED,
    Reason.SWAPPED_POSES: Rejection.OMITTED,
}


@dataclass(frozen=True, slots=True)
class Solved:
    """What came out. `solution` None: nothing follows from these poses, and `why` says it; or a session that
    calibrates nothing (verification) whose poses are complete (`why` empty)."""

    revision: int
    solution: Solution | None
    why: str
    again: tuple[tuple[str, Rejection, str], ...]
    """poses that the solution contradicts, the worst first: name, reason, sentence"""
    inc_std_deg: float | None
    tf_std_deg: float | None
    refused: tuple[str, ...]
    remarks: tuple[str, ...]
    uncertainty: UncertaintyState | None = None
    verdict: Found | None = None
    """of a session that judges an existing calibration"""
    turntable: Compensation | None = None
    """of a session of full turns"""

    @property
    def may_be_accepted(self) -> bool:
        return self.solution is not None or not self.why


def solve(ledger: Ledger, judged: CalibrationRecord | None = None) -> Solved:
    """Solve the poses of a ledger as its plan says, or judge by them the record `judged`. Takes milliseconds to
    seconds; touches nothing."""
    plan = ledger.plan
    revision = ledger.revision
    if not plan.kind.calibrates:
        return _judge(ledger, judged)
    if len(ledger.done) < max(plan.min_poses, 1):
        why = f"{len(ledger.done)} poses were taken, {max(plan.min_poses, 1)} are needed"
        return Solved(revision, None, why, (), None, None, (why,), ())
    try:
        solution = solve_poses(without_laws(ledger.pose_columns(), plan.laws), ledger.request())
    except HighsideError as error:
        why = str(error)
        return Solved(revision, None, why, (), None, None, (why,), ())
    result = solution.result
    uncertainty = uncertainty_of(solution, plan)
    why, table, notes = "", None, list[str]()
    if plan.kind is SessionKind.TURNTABLE:
        try:
            table = turntable.fit(ledger, solution, plan.title, ledger.raw_sha256())
            notes.append(turntable.describe(table))
        except HighsideError as error:
            why = str(error)
    return Solved(
        revision=revision,
        solution=None if why else solution,
        why=why,
        turntable=table,
        again=_contradicted(result),
        inc_std_deg=uncertainty.rms_inc_std_deg,
        tf_std_deg=uncertainty.rms_tf_std_deg,
        uncertainty=uncertainty,
        refused=tuple(remark.text for remark in result.remarks if remark.refused),
        remarks=(*notes, *(remark.text for remark in result.remarks if not remark.refused)),
    )


def _judge(ledger: Ledger, judged: CalibrationRecord | None) -> Solved:
    """The verdict of a session that calibrates nothing; without a record its poses are all it has."""
    why, verdict = "" if ledger.done else "no pose was taken", None
    if not why and judged is not None and ledger.plan.criterion is not None:
        try:
            verdict = judge(ledger, judged, ledger.plan.criterion)
        except HighsideError as error:
            why = str(error)
    refused = (why,) if why else ()
    return Solved(ledger.revision, None, why, (), None, None, refused, (), verdict=verdict)


def solve_so_far(columns: PoseColumns, request: SolveRequest, plan: SessionPlan) -> UncertaintyState | None:
    """What the result would state if the session ended with these poses; None while none follows from them."""
    try:
        return uncertainty_of(solve_poses(columns, request), plan)
    except (HighsideError, np.linalg.LinAlgError):
        return None


def _contradicted(result: CalibrationResult) -> tuple[tuple[str, Rejection, str], ...]:
    """The poses to measure again: what the solver omitted first, then the worst of each inclination that does not
    close."""
    found: dict[str, tuple[Rejection, str]] = {}
    for remark in result.remarks:
        if remark.refused and remark.reason in (Reason.BAD_POSE, Reason.SWAPPED_POSES):
            for pose in remark.poses:
                found.setdefault(pose, (_REQUEST_AGAIN[remark.reason], remark.text))
    if not found and any(remark.reason is Reason.CLOSURE and remark.refused for remark in result.remarks):
        for closure in result.closures:
            text = next((r.text for r in result.remarks if r.reason is Reason.CLOSURE and r.poses == closure.poses), "")
            if text:
                for pose in suspects(closure.worst_pose, closure.poses):
                    found.setdefault(pose, (Rejection.CLOSURE, text))
    return tuple((pose, reason, text) for pose, (reason, text) in found.items())


def to_measure_again(solved: Solved, ledger: Ledger) -> tuple[tuple[str, Rejection, str], ...]:
    """Of the poses that the solution contradicts those that may be requested once more: all that were omitted, but
    one of an inclination that does not close (the one requested least so far)."""
    may = [
        item
        for item in solved.again
        if (line := ledger.lines.get(item[0])) is not None
        and line.state is PoseState.DONE
        and line.requested_again < ledger.plan.limits.retakes
    ]
    if any(reason is Rejection.CLOSURE for _, reason, _ in may):
        return (min(may, key=lambda item: ledger.lines[item[0]].requested_again),)
    return tuple(may)


def suspects(worst: str, poses: tuple[str, ...]) -> tuple[str, ...]:
    """The poses that `Closure.worst_pose` names ("3", "1 or 3"), or all of the inclination where it cannot tell."""
    return tuple(worst.split(" or ")) if worst else poses


def attitudes_of_use(solution: Solution) -> tuple[Array, Array]:
    """Inclinations and toolfaces (rad), evenly over the sphere where the calibration holds (see `ALL_INC_DEG`)."""
    k = np.arange(ALL_COUNT) + 0.5
    low, high = np.cos(np.deg2rad(ALL_INC_DEG))
    inc = np.arccos(low + (high - low) * k / ALL_COUNT)
    tf = np.mod(k * np.pi * (3.0 - np.sqrt(5.0)), 2.0 * np.pi)
    if any(not zone.is_local for zone in solution.result.zones) or solution.fallback is not None:
        return inc, tf
    inclinations = [zone.inc_center_rad for zone in solution.result.zones if zone.inc_center_rad is not None]
    around = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    return np.repeat(inclinations, around.size), np.tile(around, len(inclinations))


def stated_uncertainty(solution: Solution, temp_c: float | None = None) -> tuple[float, float]:
    """Standard deviations of I and T in degrees by the calibration alone, rms over the attitudes of use, at `temp_c`
    (None: the calibration's own reference)."""
    std_inc, std_tf = _std(solution, *attitudes_of_use(solution), temp_c)
    return float(np.rad2deg(np.sqrt(np.nanmean(std_inc**2)))), float(np.rad2deg(np.sqrt(np.nanmean(std_tf**2))))


def _std(solution: Solution, inc: Array, tf: Array, temp_c: float | None = None) -> tuple[Array, Array]:
    """Standard deviations (rad) of I and T at attitudes (N,), each by the zone that holds there."""
    var_inc, var_tf = np.full(inc.size, np.nan), np.full(inc.size, np.nan)
    result, fallback = solution.result, solution.fallback
    zones = [result.zone_at(float(value)) for value in inc]
    for name in {None if zone is None else zone.name for zone in zones}:
        rows = np.array([(None if zone is None else zone.name) == name for zone in zones])
        source, zone = result, zones[int(np.argmax(rows))]
        if zone is None and fallback is None:
            continue  # it holds nowhere near: no value, and no uncertainty of it
        if zone is None and fallback is not None:
            source, zone = fallback, fallback.main
        one_inc, one_tf = source.predict_std(inc[rows], tf[rows], 0.0, zone=zone, temp_c=temp_c)
        var_inc[rows], var_tf[rows] = one_inc**2, one_tf**2
    return np.sqrt(var_inc), np.sqrt(var_tf)


USE_INC_DEG = (1.0, 5.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
"""Where the curve of uncertainty is shown, but for a local method, which holds at its own inclinations."""


def uncertainty_of(solution: Solution, plan: SessionPlan) -> UncertaintyState:
    """What a solution states of itself: rms over the attitudes of use, and the curve over inclination."""
    around = np.deg2rad(np.arange(0.0, 360.0, 45.0))
    use = sorted({abs(pose.inc_deg) for pose in plan.poses}) if solves_by_inclination(plan.method) else USE_INC_DEG
    shown, inc_std, tf_std = [], [], []
    for inc_deg in use:
        one_inc, one_tf = _std(solution, np.full(around.size, np.deg2rad(inc_deg)), around)
        values = [float(np.rad2deg(np.sqrt(np.mean(one**2)))) for one in (one_inc, one_tf)]
        if np.all(np.isfinite(values)):
            shown.append(inc_deg)
            inc_std.append(values[0])
            tf_std.append(values[1])
    rms_inc, rms_tf = stated_uncertainty(solution)
    return UncertaintyState(
        inc_deg=shown, inc_std_deg=inc_std, tf_std_deg=tf_std, rms_inc_std_deg=rms_inc, rms_tf_std_deg=rms_tf
    )


def errors_against(
    record: CalibrationRecord, matrix: ArrayLike, offset: Array, temp_c: float | None = None
) -> tuple[float, float]:
    """Rms errors of I and T in degrees against a sensor whose truth is known (`m = matrix g + offset`, at `temp_c`),
    without reading noise, over the attitudes of use. What the simulated bench is judged by."""
    from highside.attitude.block import attitude_block
    from highside.calibration.record import correction_from_record
    from highside.calibration.sensor_laws import BlockCorrection, at_rest

    inc, tf = attitudes_of_use(Solution(record.result, record.fallback, record.guide))
    raw = np.asarray(matrix) @ gravity_direction(inc, tf) + offset[:, None]
    temps = None if temp_c is None else np.full(inc.size, temp_c)
    correction = correction_from_record(record)
    if not isinstance(correction, BlockCorrection):
        raise TypeError(f"{type(correction).__name__} cannot be applied in blocks")
    found_inc, found_tf = attitude_block(at_rest(correction).corrected_block(raw, 0.0, temps).g)
    d_tf = np.mod(found_tf - tf + np.pi, 2.0 * np.pi) - np.pi
    return (
        float(np.rad2deg(np.sqrt(np.nanmean((found_inc - inc) ** 2)))),
        float(np.rad2deg(np.sqrt(np.nanmean(d_tf**2)))),
    )


def replay(journal: Journal) -> tuple[Ledger, Solved, CalibrationRecord | None]:
    """The session as its journal tells it: the ledger, its solution, and, if it was accepted, its record.

    Raises InputError where an accepted session does not give the record or the verdict that its end names.
    """
    ledger = journal.ledger()
    solved = solve(ledger, journal.header.judged)
    ended = ledger.ended
    if ended is not None and ended.verdict is not None and ended.verdict != verdict_of(solved):
        raise InputError(
            f"session {journal.header.session} gives the verdict {verdict_of(solved)}, not {ended.verdict} as written",
            remedy=f"replay it with the version that made it ({journal.header.software})",
        )
    made = None if solved.turntable is None else solved.turntable.id
    if ended is not None and ended.how == "accepted" and ended.turntable != made:
        raise InputError(
            f"session {journal.header.session} does not give the fit of the turntable that its end names",
            remedy=f"replay it with the version that made it ({journal.header.software})",
        )
    if ended is None or ended.record is None:
        return ledger, solved, None
    record = make_record(journal.header, ledger, solved, ended.t_wall_s)
    if record.id != ended.record:
        raise InputError(
            f"session {journal.header.session} gives the record {record.id[:12]}, not {ended.record[:12]} as written",
            remedy=f"replay it with the version that made it ({journal.header.software})",
        )
    return ledger, solved, record


def verdict_of(solved: Solved) -> str | None:
    """The word for the journal."""
    return None if solved.verdict is None else solved.verdict.verdict.value


def make_record(header: Header, ledger: Ledger, solved: Solved, t_wall_s: float) -> CalibrationRecord:
    """The record of an accepted session."""
    if solved.solution is None:
        raise ValueError("there is no solution to keep")
    request: SolveRequest = ledger.request()
    environment = header.environment
    return build_record(
        tool_id=header.tool_id,
        serial=header.serial,
        request=request,
        result=solved.solution.result,
        fallback=solved.solution.fallback,
        guide=solved.solution.guide,
        pose_columns=ledger.pose_columns(),
        laws=ledger.plan.laws,
        raw_sha256=ledger.raw_sha256(),
        raw_name=f"session {header.session}",
        environment=environment,
        now_s=t_wall_s,
        expires_s=None if header.expires_days is None else t_wall_s + header.expires_days * DAY_S,
    )
