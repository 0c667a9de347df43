"""A finished hold becomes a pose, or is refused with a reason; and what a new pose says about the others.

Order of the questions: can the readings be believed (`Hold.verdict`), do rate sensors and accelerometers agree about
the sense of turning, does the pose contradict the others? A contradiction that repeats within its own uncertainty is
taken: then it is not this setting that was wrong, and the end of the session has to say what is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.bench.session import checks
from highside.bench.session.entries import HoldReadings, RefusedHold, Reopened, TakenPose
from highside.bench.session.guidance import angle_between_deg
from highside.bench.session.hold import Hold
from highside.bench.session.ledger import Ledger, PoseLine
from highside.bench.session.outcome import suspects
from highside.bench.session.reasons import Rejection
from highside.bench.session.snapshot import PoseState

REPEATS_SIGMAS = 5.0
UNDISTURBED_SHARE = 0.3
"""Closer than this share of what tells attitudes apart, two holds are one that was disturbed (a touch)."""


@dataclass(frozen=True, slots=True)
class JudgedHold:
    """`entry` None: nothing new was learnt (a shorter hold in the attitude taken last)."""

    entry: TakenPose | RefusedHold | None
    agreement: checks.Agreement | None = None

    @property
    def good(self) -> bool:
        return isinstance(self.entry, TakenPose)


def judge_hold(ledger: Ledger, hold: Hold, *, mirrored: bool, same_deg: float) -> JudgedHold:
    """What becomes of a hold; changes nothing."""
    wrong = hold.verdict()
    if wrong is not None:
        return JudgedHold(RefusedHold(hold.pose, *wrong))
    if mirrored:
        return JudgedHold(RefusedHold(hold.pose, Rejection.MIRRORED))
    readings = hold.result()
    if hold.pose is None:
        return _by_hand(ledger, readings, same_deg)
    line = ledger.lines[hold.pose]
    taken = TakenPose(line.id, readings, None, line.inc_deg, line.tf_deg, line.stage)
    trial = trial_of(ledger, taken)
    found = checks.agreement(trial.pose_set(), line.id, ledger.plan.limits)
    taken = TakenPose(line.id, readings, found.sigmas, line.inc_deg, line.tf_deg, line.stage)
    if found.sigmas is None or found.sigmas <= ledger.plan.limits.outlier_sigmas or not found.is_worst:
        return JudgedHold(taken, found)
    detail = f"{found.sigmas:.1f} standard deviations from what the other poses predict"
    if _repeats(ledger, line, readings):
        note = f"{detail}, twice alike: taken"
        return JudgedHold(
            TakenPose(line.id, readings, found.sigmas, line.inc_deg, line.tf_deg, line.stage, note), found
        )
    return JudgedHold(RefusedHold(line.id, Rejection.OUTLIER, detail, readings, found.sigmas), found)


def trial_of(ledger: Ledger, taken: TakenPose) -> Ledger:
    """A copy of the ledger with one more pose."""
    out = Ledger(ledger.plan)
    for line in ledger.done:
        if line.id != taken.pose and line.readings is not None:
            out.apply(TakenPose(line.id, line.readings, None, line.inc_deg, line.tf_deg, line.stage))
    out.apply(taken)
    return out


def _repeats(ledger: Ledger, line: PoseLine, readings: HoldReadings) -> bool:
    """Whether the last refusal of this pose read the same, within the repeatability of bench and noise."""
    before = line.contradicted
    if before is None:
        return False
    spread = np.deg2rad(ledger.plan.limits.pose_sigma_deg)
    sigma = np.sqrt(np.square(before.std_error_g) + np.square(readings.std_error_g) + 2.0 * spread**2)
    apart = np.abs(np.subtract(before.mean(), readings.mean()))
    return bool(np.all(apart <= REPEATS_SIGMAS * sigma))


def _by_hand(ledger: Ledger, readings: HoldReadings, same_deg: float) -> JudgedHold:
    """A pose found by itself: a new one, or the last one held longer."""
    last = ledger.last_taken
    before = ledger.lines[last].readings if last is not None else None
    if last is not None and before is not None:
        apart = angle_between_deg(np.array(before.mean()), np.array(readings.mean()))
        if apart < same_deg * UNDISTURBED_SHARE:
            return JudgedHold(TakenPose(last, _joined(before, readings), None))
        if apart < same_deg:
            return JudgedHold(TakenPose(last, readings, None)) if readings.n > before.n else JudgedHold(None)
    number = 1 + max((int(name) for name in ledger.lines), default=0)
    return JudgedHold(TakenPose(str(number), readings, None))


def _joined(first: HoldReadings, second: HoldReadings) -> HoldReadings:
    """One hold from two, disturbed in between."""
    n = (first.n, second.n)
    temps = [(r.temp_c, r.n) for r in (first, second) if r.temp_c is not None]
    errors = [
        float(np.hypot(n[0] * a, n[1] * b) / sum(n)) for a, b in zip(first.std_error_g, second.std_error_g, strict=True)
    ]
    ax, ay, az = (a + b for a, b in zip(first.a, second.a, strict=True))
    return HoldReadings(
        (ax, ay, az),
        first.t_start_s,
        second.t_stop_s,
        sum(t * m for t, m in temps) / sum(m for _, m in temps) if temps else None,
        (errors[0], errors[1], errors[2]),
    )


def contradictions(ledger: Ledger, judged: JudgedHold) -> list[Reopened]:
    """After a pose was taken: the poses that it shows to be wrong, to be measured again now, while the table is near.

    An inclination that does not close, or another pose that departs most from all the others.
    """
    entry = judged.entry
    if not isinstance(entry, TakenPose) or ledger.plan.open_ended:
        return []
    limits = ledger.plan.limits

    def may_request(pose: str) -> bool:
        line = ledger.lines[pose]
        return line.state is PoseState.DONE and line.requested_again < limits.retakes

    found = judged.agreement
    other = found.worst if found is not None and found.worst != entry.pose else None
    away = (found.worst_sigmas or 0.0) if found is not None else 0.0
    if other is not None and away > limits.outlier_sigmas and may_request(other):
        return [Reopened(other, Rejection.OUTLIER, f"{away:.1f} standard deviations from what the other poses predict")]
    limit = checks.closure_limit(ledger.plan)
    for closure in checks.inclination_closures(ledger.pose_set(), limits):
        if entry.pose in closure.poses and closure.p < limit:
            suspected = [pose for pose in suspects(closure.worst_pose, closure.poses) if may_request(pose)]
            if suspected:
                pose = min(suspected, key=lambda name: ledger.lines[name].requested_again)
                size = float(np.linalg.norm(closure.value)) * 1e3
                return [
                    Reopened(
                        pose, Rejection.CLOSURE, f"the four poses of this inclination do not close by {size:.2f} mg"
                    )
                ]
    return []
