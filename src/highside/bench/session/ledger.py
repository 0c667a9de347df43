"""What a session has decided so far: the sum of its journal, and nothing else.

The ledger changes only by `apply(entry)`, live and on replay alike, so that a session replayed from its journal is the
same session, bit for bit: a pose's mean is computed from its raw readings here, with exact sums (`math.fsum`), whether
they have just been measured or were read from a file. Readings are raw: what the codec gave, no calibration applied.

Decisions that `undo` takes back (a pose taken, skipped, opened again) are kept on a stack with what was before.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from highside.bench.session.entries import (
    Began,
    Ended,
    Entry,
    HoldReadings,
    Noted,
    Paused,
    Photographed,
    PlanClosed,
    PutInForce,
    RefusedHold,
    Reopened,
    Resumed,
    Skipped,
    StageReady,
    TakenPose,
    Undone,
)
from highside.bench.session.plans import Reference, SessionPlan
from highside.bench.session.reasons import Rejection
from highside.bench.session.snapshot import PoseState
from highside.calibration.method import SolveRequest
from highside.calibration.methods.joint import METHOD as JOINT
from highside.calibration.poses import PoseSet
from highside.calibration.sensor_laws import AT_REST, SensorLaws, without_laws


@dataclass(frozen=True, slots=True)
class PoseLine:
    """What is known of one pose."""

    id: str
    inc_deg: float | None
    tf_deg: float | None
    stage: int
    state: PoseState = PoseState.OPEN
    readings: HoldReadings | None = None
    sigmas: float | None = None
    attempts: int = 0
    requested_again: int = 0
    reason: Rejection | None = None
    detail: str = ""
    contradicted: HoldReadings | None = None
    """the last readings that were refused because they contradict the other poses"""

    @property
    def open(self) -> bool:
        return self.state in (PoseState.OPEN, PoseState.AGAIN)


class Ledger:
    """See the module's docstring. `lines` holds the poses in the order of the plan (or as they were found)."""

    def __init__(self, plan: SessionPlan) -> None:
        self.plan = plan
        self.lines: dict[str, PoseLine] = {
            pose.id: PoseLine(pose.id, pose.inc_deg, pose.tf_deg, pose.stage) for pose in plan.poses
        }
        self._planned = {pose.id: pose for pose in plan.poses}
        self.operator: str | None = None
        self.holder: str | None = None
        """what proves that a command is the operator's (`commands.holder_of`); None: the name alone"""
        self.began = False
        self.closed = False
        self.stage = 0
        self.stage_ready = plan.stages[0].temp_c is None
        self.ended: Ended | None = None
        self.retaken = 0
        self.refused: dict[Rejection, int] = {}
        self.revision = 0
        """grows whenever the poses that would be solved change"""
        self._order: list[str] = []
        """accepted poses in the order of time"""
        self._undo: list[tuple[str, PoseLine | None, list[str]]] = []

    # --- changing ----------------------------------------------------------------------------------------------

    def apply(self, entry: Entry) -> None:
        """The only way in which a ledger changes."""
        match entry:
            case Began(operator, holder):
                self.began, self.operator, self.holder = True, operator, holder
            case TakenPose():
                self._take(entry)
            case RefusedHold(pose, reason, detail, readings):
                self.refused[reason] = self.refused.get(reason, 0) + 1
                line = self.lines.get(pose) if pose is not None else None
                if line is not None and line.open:
                    self.lines[line.id] = replace(
                        line,
                        attempts=line.attempts + 1,
                        reason=reason,
                        detail=detail,
                        contradicted=readings if reason is Rejection.OUTLIER else line.contradicted,
                    )
            case Skipped(pose):
                self._change(replace(self.lines[pose], state=PoseState.SKIPPED))
            case Reopened(pose, reason, detail, operator):
                line = self.lines[pose]
                by_itself = operator is None
                self._change(
                    replace(
                        line,
                        # what an operator skipped is open as if it had never been
                        state=PoseState.AGAIN if line.state is not PoseState.SKIPPED else PoseState.OPEN,
                        contradicted=None,
                        reason=reason,
                        detail=detail,
                        requested_again=line.requested_again + by_itself,
                    )
                )
            case Undone():
                self._take_back()
            case StageReady(stage):
                self.stage, self.stage_ready = stage, True
            case PlanClosed():
                self.closed = True
                self.revision += 1
            case Resumed(operator, holder):
                self.operator, self.holder = operator, holder
            case Ended():
                self.ended = entry
            case Paused() | Noted() | Photographed() | PutInForce():
                pass
        self._enter_stage()

    def _take(self, entry: TakenPose) -> None:
        before = self.lines.get(entry.pose)
        line = before or PoseLine(entry.pose, entry.inc_deg, entry.tf_deg, entry.stage)
        self.retaken += line.state is PoseState.AGAIN
        self._change(
            replace(
                line,
                state=PoseState.DONE,
                readings=entry.readings,
                sigmas=entry.sigmas,
                attempts=line.attempts + 1,
                reason=None,
                detail=entry.note,
            )
        )

    def _change(self, line: PoseLine) -> None:
        self._undo.append((line.id, self.lines.get(line.id), list(self._order)))
        self.lines[line.id] = line
        self._order = [name for name in self._order if name != line.id]
        if line.state is PoseState.DONE:
            self._order.append(line.id)
        self.revision += 1

    def _take_back(self) -> None:
        name, before, order = self._undo.pop()
        if before is None:
            del self.lines[name]
        else:
            now = self.lines[name]
            # attempts were made, whatever became of them
            self.lines[name] = replace(before, attempts=now.attempts, requested_again=now.requested_again)
        self._order = order
        self.closed = False
        self.revision += 1

    def _enter_stage(self) -> None:
        """The stage of the first open pose counts; a new one must be made ready first."""
        stage = next((line.stage for line in self.lines.values() if line.open), self.stage)
        if stage != self.stage:
            self.stage, self.stage_ready = stage, self.plan.stages[stage].temp_c is None

    # --- asking ------------------------------------------------------------------------------------------------

    @property
    def can_undo(self) -> bool:
        return bool(self._undo)

    @property
    def open_lines(self) -> list[PoseLine]:
        """Poses to be taken now: those of the present stage."""
        return [line for line in self.lines.values() if line.open and line.stage == self.stage]

    @property
    def has_open(self) -> bool:
        if self.plan.open_ended:
            return not self.closed or any(line.open for line in self.lines.values())
        return any(line.open for line in self.lines.values())

    @property
    def waits_for_temperature(self) -> bool:
        return not self.stage_ready

    @property
    def done(self) -> list[PoseLine]:
        """Accepted poses in the order in which they were taken."""
        return [self.lines[name] for name in self._order]

    @property
    def last_taken(self) -> str | None:
        return self._order[-1] if self._order else None

    @property
    def skipped(self) -> int:
        return sum(line.state is PoseState.SKIPPED for line in self.lines.values())

    def request(self) -> SolveRequest:
        """What the solver is asked."""
        plan = self.plan
        method = plan.method if plan.method != "none" else JOINT.name
        return SolveRequest(method, plan.triples, plan.reference, plan.limits.pose_sigma_deg, plan.fallback)

    def pose_columns(self) -> dict[str, list[float] | list[str]]:
        """The pose table (degrees, g) of the accepted poses, in the order of time."""
        lines = [(line, line.readings) for line in self.done if line.readings is not None]
        columns: dict[str, list[float] | list[str]] = {}
        if self.plan.reference == "pose":
            reference = [self._reference(line) for line, _ in lines]
            columns["inc_ref_deg"] = [inc for inc, _ in reference]
            columns["tf_ref_deg"] = [tf for _, tf in reference]
        means, stds = [r.mean() for _, r in lines], [r.std() for _, r in lines]
        for k, axis in enumerate("xyz"):
            columns[f"a{axis}"] = [mean[k] for mean in means]
            # a converter that shows no noise at all still has its step; zero is no standard deviation
            columns[f"std_a{axis}"] = [max(std[k], 1e-9) for std in stds]
        columns["n"] = [r.independent() for _, r in lines]
        temps = [r.temp_c for _, r in lines]
        if temps and all(temp is not None for temp in temps):
            columns["temp_c"] = [float(temp) for temp in temps if temp is not None]
        columns["pose"] = [line.id for line, _ in lines]
        return columns

    def solver_columns(self) -> dict[str, Any]:
        """`pose_columns` without what the plan's laws say; as measured while a temperature that they need lacks."""
        columns = self.pose_columns()
        lacking = [n for n in SensorLaws(self.plan.laws).columns if n not in columns and n not in AT_REST]
        return columns if lacking else without_laws(columns, self.plan.laws)

    def _reference(self, line: PoseLine) -> tuple[float, float]:
        """Where the bench stood, deg."""
        planned = self._planned.get(line.id)
        return (float(line.inc_deg or 0.0), float(line.tf_deg or 0.0)) if planned is None else planned.reference

    def pose_set(self, reference: Reference | None = None) -> PoseSet:
        """The accepted poses as the solvers take them, with the plan's reference or another; at least one must have
        been taken."""
        return PoseSet.from_columns(self.solver_columns(), reference=reference or self.plan.reference)

    def raw_sha256(self) -> str:
        """Hash of the raw readings of the accepted poses, in the order of time."""
        digest = hashlib.sha256()
        for line in self.done:
            if line.readings is not None:
                digest.update(json.dumps([line.id, *line.readings.a], separators=(",", ":")).encode())
        return digest.hexdigest()

    def mean_temp_c(self) -> float | None:
        temps = [line.readings.temp_c for line in self.done if line.readings is not None]
        known = [temp for temp in temps if temp is not None]
        return float(np.mean(known)) if known else None

    def to_plain(self) -> dict[str, Any]:
        """Everything that decides the result, for comparing two ledgers."""
        return {
            "poses": self.pose_columns(),
            "states": {name: line.state.value for name, line in self.lines.items()},
            "retaken": self.retaken,
            "raw": self.raw_sha256(),
        }
