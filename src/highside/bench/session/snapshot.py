"""What a session shows and which commands it takes: the contract with every face (terminal, web page, MQTT).

`Snapshot` is the whole public state in one message, schema `highside.session/1`; a face needs nothing else, and one
that missed a hundred of them loses nothing by reading only the newest. `Command` is what a face sends, `Reply` the
answer. Angles in degrees, accelerations in g, times in seconds. JSON knows no NaN: what is not known is null.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, SecretStr

SCHEMA: Literal["highside.session/1"] = "highside.session/1"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class SessionState(StrEnum):
    """The step a session is in. `machine` holds what leads from one to the next."""

    IDLE = "idle"
    """not begun: waits for `start`"""
    SOAKING = "soaking"
    """waits for the temperature of this step to be reached and steady"""
    GUIDING = "guiding"
    """the tool is not at an open pose: the prompt leads it there"""
    SETTLING = "settling"
    """at an open pose, not still yet"""
    CAPTURING = "capturing"
    """still at an open pose: readings are averaged"""
    CHECKING = "checking"
    """a pose has been averaged and is compared with the others (takes no time that a face could see)"""
    SOLVING = "solving"
    """all poses are done: the calibration is computed"""
    REVIEW = "review"
    """there is a result: waits for `accept` or `reject`"""
    PAUSED = "paused"
    NO_DATA = "no_data"
    """nothing comes from the tool: waits, and goes on where it was"""
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    ABORTED = "aborted"

    @property
    def ended(self) -> bool:
        return self in (SessionState.ACCEPTED, SessionState.REJECTED, SessionState.ABORTED)


class CommandName(StrEnum):
    """What an operator may request."""

    START = "start"
    CAPTURE = "capture"
    """end the hold now and take what has been averaged (at least the plan's shortest hold)"""
    REDO = "redo"
    """measure a pose again; without `pose` the last one taken"""
    SKIP = "skip"
    """omit a pose; without `pose` the one requested"""
    UNDO = "undo"
    """take the last decision back: a pose taken, skipped or opened again"""
    PAUSE = "pause"
    RESUME = "resume"
    """go on; while paused any operator may, and then holds the session"""
    ABORT = "abort"
    """end without a result; what was measured stays in the journal"""
    ACCEPT = "accept"
    """in review: keep the result. While measuring with a plan of no fixed length: that was the last pose"""
    REJECT = "reject"
    """in review: end without keeping the result"""
    ACTIVATE = "activate"
    """accepted: put the calibration in force for its tool; `confirm` names it"""
    ROLLBACK = "rollback"
    """accepted: put the calibration in force that was so before; `confirm` names that one"""


class PoseState(StrEnum):
    OPEN = "open"
    DONE = "done"
    SKIPPED = "skipped"
    AGAIN = "again"
    """requested a second time: see `reason`"""


class AttitudeState(_Model):
    """Where the tool is now, by its nominal or provisionally corrected readings."""

    inc_deg: float
    tf_deg: float | None = Field(description="null where it is not defined (vertical).")
    g_total: float


class Target(_Model):
    """The pose requested."""

    pose: str
    inc_deg: float = Field(description="Setting of the bench; negative: the table turned the other way.")
    tf_deg: float
    temp_c: float | None = None


class Deviation(_Model):
    """What is missing to the target: positive values are to be added to the present setting."""

    inc_deg: float = Field(description="To be added to the inclination; positive: more inclined.")
    tf_deg: float | None = Field(description="To turn; positive: clockwise looking down-hole. null: vertical, any.")
    angle_deg: float = Field(ge=0, description="Angle between the gravity directions: the radius of a bull's-eye.")
    tolerance_deg: float = Field(gt=0, description="Within this the pose is taken.")


class StillnessState(_Model):
    """How still the tool is, in units of what its own noise allows: `value` <= `limit` is still."""

    value: float = Field(ge=0)
    limit: float = Field(default=1.0, gt=0)
    still: bool
    noise_g: tuple[float, float, float] | None = Field(description="Noise of one reading at rest, each axis.")
    trace: list[float] = Field(description="The last values, oldest first.")
    trace_step_s: float = Field(gt=0)


class Capture(_Model):
    """The hold under way."""

    progress: float = Field(ge=0, le=1)
    elapsed_s: float = Field(ge=0)
    readings: int = Field(ge=0)
    std_error_g: float | None = Field(description="Standard error of the mean so far (worst axis), coloured noise in.")
    target_std_error_g: float | None


class PoseRow(_Model):
    """One pose of the plan, or one found, as faces show it: a `ledger.PoseLine` in figures and sentences."""

    pose: str
    inc_deg: float | None = Field(description="The bench's setting; null in a session without reference.")
    tf_deg: float | None
    temp_c: float | None = Field(default=None, description="Temperature requested, or measured.")
    stage: int = Field(default=0, ge=0)
    state: PoseState
    attempts: int = Field(ge=0, description="Times it has been taken or refused.")
    std_error_g: float | None = None
    readings: int = 0
    sigmas: float | None = Field(default=None, description="Departure from what the other poses predict.")
    reason: str | None = Field(default=None, description="Code of the last rejection (`reasons.Rejection`).")
    text: str | None = Field(default=None, description="The same as a sentence.")


class UncertaintyState(_Model):
    """Standard deviation of I and T by the calibration as the plan's method solves it from the poses taken so far: over
    inclination, and rms over all attitudes of use, which is what the result states at the end."""

    inc_deg: list[float]
    inc_std_deg: list[float]
    tf_std_deg: list[float]
    rms_inc_std_deg: float
    rms_tf_std_deg: float


class ClosureState(_Model):
    """The closure of an inclination of four."""

    inc_deg: float
    size_g: float
    p: float
    good: bool
    poses: list[str]
    worst: str = ""


class FaultState(_Model):
    code: str
    text: str
    since_s: float = Field(description="Seconds of session time at which it began.")
    detail: str = ""


class VerdictRow(_Model):
    """One comparison with a limit: a pose of a verification, or a range of a roll test."""

    name: str
    inc_error_deg: float | None = None
    inc_u_deg: float | None = Field(default=None, description="Expanded uncertainty (k = 2) of the comparison.")
    tf_error_deg: float | None = None
    tf_u_deg: float | None = None
    g_error_g: float | None = None
    g_u_g: float | None = None
    verdict: str


class VerdictState(_Model):
    """What a verification or a roll test says of an existing calibration."""

    kind: Literal["verification", "roll_test"]
    record: str = Field(description="Id of the calibration judged.")
    verdict: Literal["pass", "fail", "undecided", "not_covered"]
    text: str
    consistent: bool | None = Field(description="Errors as large as the record's stated uncertainty lets expect.")
    limit_inc_deg: float
    limit_tf_deg: float | None = None
    limit_g_total_g: float | None = None
    rows: list[VerdictRow]


class ForceState(_Model):
    """Calibrations in the store, by id."""

    present: str | None = Field(description="In force for this tool.")
    before: str | None = Field(description="What a roll back puts in force; 'nothing': it leaves none.")


class ResultState(_Model):
    """The solution under review, or kept."""

    method: str
    record_id: str | None = Field(description="Id of the record; its content is fixed when the session is accepted.")
    inc_std_deg: float | None
    tf_std_deg: float | None
    poses: int
    retaken: int
    refused: list[str] = Field(description="What the solver refused, one sentence each; empty is good.")
    remarks: list[str] = Field(default_factory=list)
    verdict: VerdictState | None = Field(default=None, description="Of a session that judges a calibration.")
    turntable_id: str | None = Field(default=None, description="The fit of the bench's turntable, kept on `accept`.")


class PlanState(_Model):
    kind: str
    title: str
    method: str
    poses: int | None = Field(description="null: of no fixed length.")
    done: int
    skipped: int
    stage: int = 0
    stages: int = 1
    stage_temp_c: float | None = None
    judges: str | None = Field(default=None, description="Id of the calibration that this session judges.")


class Snapshot(_Model):
    """The whole public state of a session."""

    schema_: Literal["highside.session/1"] = Field(default=SCHEMA, alias="schema")
    seq: int = Field(ge=0, description="Grows with every change; a smaller one is older.")
    session: str = Field(description="Id of the session, the name of its journal.")
    tool: str
    serial: str | None = None
    state: SessionState
    back_to: SessionState | None = Field(default=None, description="While paused or without data: where it goes on.")
    plan: PlanState
    prompt: str = Field(description="What to do next, one sentence.")
    target: Target | None
    attitude: AttitudeState | None
    deviation: Deviation | None
    stillness: StillnessState | None
    capture: Capture | None
    temp_c: float | None
    poses: list[PoseRow]
    uncertainty: UncertaintyState | None
    closures: list[ClosureState]
    faults: list[FaultState]
    last_rejection: str | None = Field(default=None, description="Sentence of the last rejection, until the next pose.")
    operator: str | None = Field(description="Who holds the session.")
    allowed: list[CommandName] = Field(description="Commands that would not be refused now.")
    result: ResultState | None
    in_force: ForceState | None = Field(default=None, description="Known once a record was accepted.")
    to_go_s: float | None = Field(
        default=None, ge=0, description="What the open poses will take at the pace so far; null: not known yet."
    )
    elapsed_s: float = Field(ge=0, description="Session time: that of the tool's own clock while data came.")

    def to_json(self) -> str:
        return self.model_dump_json(by_alias=True)

    def meant(self, name: CommandName) -> str | None:
        """The record that is in force after `activate` or `rollback`: what a face has to name to confirm it."""
        if name is CommandName.ACTIVATE:
            return None if self.result is None else self.result.record_id
        if name is CommandName.ROLLBACK:
            return None if self.in_force is None else self.in_force.before
        return None


def table_reads(attitude: AttitudeState, target: Target | None) -> tuple[float, float | None]:
    """I and T as the bench's scales count them on the way to a target: a table that is to turn the other way (negative
    inclination) has the opposite toolface. What every face shows as the present setting."""
    if target is None or target.inc_deg >= 0:
        return attitude.inc_deg, attitude.tf_deg
    return -attitude.inc_deg, None if attitude.tf_deg is None else (attitude.tf_deg + 180.0) % 360.0


Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]


class Command(_Model):
    """What a face sends. The same command again is answered as before and not done twice; another one with the
    `request_id` of an earlier is refused."""

    name: CommandName
    request_id: Name
    operator: Name
    pose: Name | None = Field(default=None, description="For redo and skip.")
    note: str | None = Field(default=None, max_length=500, description="Kept in the journal.")
    confirm: Name | None = Field(
        default=None,
        description="For activate and rollback: id (its first 6 digits or more) of the record meant, or 'nothing'.",
    )
    secret: Annotated[SecretStr, Field(min_length=16, max_length=128)] | None = Field(
        default=None,
        description="Chosen by who starts or resumes the session; from then on only commands with it are obeyed.",
    )


class Reply(_Model):
    """The answer to one command."""

    request_id: str
    accepted: bool
    reason: str | None = Field(default=None, description="Code of the refusal (`reasons.Refusal`).")
    text: str
    state: SessionState
    seq: int
