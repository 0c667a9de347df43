"""From the columns of a recording to a diagnosis: one entry of `KINDS` for each kind of reference.

A kind says when it is meant, what intake looks at, and how rows become the session of its engine. Whoever adds one
writes these and an entry. Everything is given as values: columns by name, the model's own forward model, what of it may
be refitted, the site; files and model files are the business of those above.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from highside.arrays import Array
from highside.diagnosis.approach import of_sides
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult, Finding
from highside.diagnosis.engine import diagnose_magnitudes, diagnose_poses, diagnose_rotation, diagnose_simulation
from highside.diagnosis.held_poses import with_since_move, without_since_move
from highside.diagnosis.intake.checks import Intake, check, missing_rows, poses_off
from highside.diagnosis.intake.clipped import with_clipping, without_clipped_poses, without_meaning
from highside.diagnosis.intake.long import check_stretches
from highside.diagnosis.poses.session import PoseSession, pose_session, without_outlying_poses
from highside.diagnosis.untimed import WITHOUT_TIMES, without_clock
from highside.errors import InputError
from highside.long_arrays import concatenated, is_long
from highside.physics.effects.dropped_frames import EFFECT as DROPPED_FRAMES
from highside.physics.effects.gyro_bias import EFFECT as GYRO_BIAS
from highside.physics.effects.gyro_scale import EFFECT as GYRO_SCALE
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.plan import Site
from highside.physics.state import differences
from highside.words.said import said

if TYPE_CHECKING:
    from highside.diagnosis.simulation.alignment import Align
    from highside.diagnosis.simulation.session import SimulationSession

__all__ = ["ACCELEROMETERS", "GYROS", "KINDS", "Answer", "Kind", "Request", "diagnose_columns", "rotates"]

Columns = Mapping[str, Array]

ACCELEROMETERS = ("ax_g", "ay_g", "az_g")
GYROS = ("gx_dps", "gy_dps", "gz_dps")
REFERENCES = frozenset({"inc_ref_deg", "tf_ref_deg", "rotor_deg"})
GYRO_FREE = (GYRO_BIAS.id, GYRO_SCALE.id)
"""What is refitted beside the model's own free effects where gyros were recorded."""
TURNING_SHARE = 0.5
"""Share of rows in which the reference turns, from which a recording without stops is one of rotation."""


@dataclass(frozen=True)
class Request:
    """A recording of N rows and what is known of it."""

    columns: Columns
    """(N,) each, by their names in the Recording format"""
    complete: Callable[..., Array]
    """the named columns as one block, every value there; raises InputError that names what is absent or missing"""
    forward: ForwardModel
    """what the model has"""
    free: tuple[str, ...]
    """ids of effects that may be refitted"""
    site: Site
    axes: Sequence[tuple[int, float]] = ((0, 1.0), (1, 1.0), (2, 1.0))
    """which of the maker's channels, with which sign, is the tool's x, y and z"""
    reference: str | None = None
    """what the model says is known of the attitude: "pose", "magnitude", "simulation"; None where it says nothing"""
    predicted: Columns | None = None
    """columns (M,) of another program's prediction, on its own times"""
    align: Align = "auto"
    """whose clock the prediction's times are of"""
    free_of_prediction: tuple[str, ...] = ()
    """as `free`, beside a prediction: nothing unless the model says so"""
    seed: int = 1
    version: str = ""
    method: ProcedureParts = WHOLE
    lacking: tuple[Finding, ...] = ()
    """what is to be said of rows that were left out before"""
    timed: bool = True
    """whether the times are recorded; else they count the rows of a table"""
    where: str | None = None
    """names the recording in errors"""
    predicted_where: str | None = None

    def in_tool_axes(self, channels: Array) -> Array:
        """Three channels (3, N) of the maker as the tool's x, y and z."""
        return concatenated([sign * channels[channel][None] for channel, sign in self.axes])

    @property
    def long(self) -> bool:
        """Whether the rows are not in the memory."""
        return is_long(self.columns["t_s"])


@dataclass(frozen=True)
class Answer:
    """A diagnosis, what a report draws of it, and what must be reported beside it."""

    diagnosis: DiagnosisResult
    report_data: ReportData | None
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Kind:
    """One kind of reference."""

    name: str
    meant: Callable[[Request], bool]
    diagnose: Callable[[Request], Answer]


def diagnose_columns(request: Request) -> Answer:
    """Diagnose a recording by the first of `KINDS` that is meant. Raises InputError for columns that do not do."""
    kind = next(kind for kind in KINDS if kind.meant(request))
    answer = kind.diagnose(request)
    if not request.timed:
        answer = replace(answer, diagnosis=without_clock(answer.diagnosis), notes=(*answer.notes, WITHOUT_TIMES))
    if np.isnan(request.site.latitude_rad) and "inc_ref_deg" in request.columns:
        from highside.diagnosis.rotation.unknown_site import without_site

        answer = replace(answer, diagnosis=without_site(answer.diagnosis, request.columns["inc_ref_deg"]))
    # another program's prediction holds effects of its own, not those of the model
    known = {} if request.predicted is not None else request.forward.parameters()
    known = {effect: values for effect, values in known.items() if any(values.values())}
    claims = tuple(replace(claim, simulated=known.get(claim.effect, {})) for claim in answer.diagnosis.claims)
    return replace(answer, diagnosis=replace(answer.diagnosis, claims=claims))


# --- what kinds share ----------------------------------------------------------------------------------------


def _bad_data(request: Request, findings: Intake) -> Answer:
    bad = DiagnosisResult("bad_data", intake=findings.findings, seed=request.seed, version=request.version)
    return Answer(bad, None)


def _of_recording(request: Request, error: InputError) -> InputError:
    """An error of the numerics, with the recording's name."""
    return InputError(error.what, where=request.where, field=error.field, remedy=error.remedy)


def _without_missing(request: Request, *needed: str) -> tuple[Request, tuple[Finding, ...]]:
    """The request without the rows that lack a value, for averages; and what to say of them."""
    lost, finding = missing_rows(request.columns, needed)
    if finding is None:
        return request, ()
    columns = {name: column[~lost] for name, column in request.columns.items()}

    def complete(*names: str) -> Array:
        return np.stack([columns[name] for name in names])

    return replace(request, columns=columns, complete=complete), (finding,)


def _with_lacking(found: Intake, lacking: tuple[Finding, ...]) -> Intake:
    """Rows that were left out are no frames that the link lost."""
    kept = tuple(f for f in found.findings if not (lacking and f.check == DROPPED_FRAMES.id))
    return replace(found, findings=(*kept, *lacking))


def _checked_reference(request: Request, *, every_row: bool = True) -> Intake:
    """Intake of a recording with a reference attitude. Raises InputError where nothing is known of one."""
    if request.reference is None and not REFERENCES & set(request.columns):
        raise InputError(
            "nothing says where the tool was, and the model does not say what else is known",
            where=request.where,
            field="inc_ref_deg, tf_ref_deg or rotor_deg",
            remedy="add these columns; or put [reference] kind = "
            '"magnitude" into the model if only |g| is known; or give another program\'s output with simulation=',
        )
    needed = ("inc_ref_deg", _toolface(request.columns))
    if request.long:
        return check_stretches(request.columns, needed, request.axes)
    return check(request.columns, needed, request.axes, every_row=every_row)


def _toolface(columns: Columns) -> str:
    return "rotor_deg" if "rotor_deg" in columns and "tf_ref_deg" not in columns else "tf_ref_deg"


# --- the kinds -----------------------------------------------------------------------------------------------


def _poses(request: Request) -> Answer:
    """Stops at known attitudes."""
    request, lacking = _without_missing(request, "inc_ref_deg", _toolface(request.columns))
    found = _checked_reference(request, every_row=False)
    found = _with_lacking(found, lacking)
    if found.spoiled:
        return _bad_data(request, found)
    raw = request.complete(*ACCELEROMETERS)
    columns, accel = without_clipped_poses(request.columns, raw, found), request.in_tool_axes(raw)
    since = None

    def poses(readings: Array) -> PoseSession:
        site = request.site
        return pose_session(
            columns,
            readings,
            gravity_mps2=site.gravity_mps2,
            latitude_rad=site.latitude_rad,
            azimuth_rad=site.azimuth_rad,
        )

    try:
        session = poses(accel)
    except InputError as error:
        raise _of_recording(request, error) from None
    sure = without_outlying_poses(session, request.forward, request.free)[0]
    expected = np.asarray(gravity_direction(sure.state.inc_rad, sure.state.tf_rad), dtype=float)
    if (off := poses_off(sure.mean, expected, sure.label)) is not None:
        return _bad_data(request, replace(found, findings=(*found.findings, off)))
    if request.method.laws:

        def of_means(made: PoseSession) -> DiagnosisResult:
            return _diagnosed_poses(request, made)[0]

        session, since = without_since_move(session, columns, accel, request.forward, poses, of_means)
    diagnosis, report_data, outlying = _diagnosed_poses(request, session)
    diagnosis, report_data = with_since_move(diagnosis, report_data, since)
    every = (*found.findings, *outlying, *diagnosis.intake)
    made = with_clipping(replace(diagnosis, intake=every), found, request.axes)
    return Answer(made, report_data, of_sides(made.claims, columns))


def _diagnosed_poses(request: Request, session: PoseSession) -> tuple[DiagnosisResult, ReportData, tuple[Finding, ...]]:
    """What is found in the means of poses, and which of these were left out."""
    session, outlying = without_outlying_poses(session, request.forward, request.free)
    diagnosis, report_data = diagnose_poses(
        session, request.forward, request.free, seed=request.seed, version=request.version, method=request.method
    )
    return diagnosis, report_data, outlying


def rotates(columns: Columns) -> bool:
    """Whether the reference turns in most rows: no session of stops."""
    name = _toolface(columns)
    if "pose" in columns or name not in columns:
        return False
    turns = differences(columns[name]) != 0
    return turns.size > 0 and bool(np.mean(turns) > TURNING_SHARE)


def _rotation(request: Request) -> Answer:
    """Continuous rotation with a known reference, row by row."""
    from highside.diagnosis.rows.session import rotation_session

    lacking: tuple[Finding, ...] = request.lacking
    if not request.long:
        request, lacking = _without_missing(request, "inc_ref_deg", _toolface(request.columns))
    found = _with_lacking(_checked_reference(request), lacking)
    if found.spoiled:
        return _bad_data(request, found)
    raw = request.complete(*ACCELEROMETERS)
    gyro = _gyro(request)
    try:
        session = rotation_session(
            request.columns,
            request.in_tool_axes(raw),
            gyro,
            gravity_mps2=request.site.gravity_mps2,
            latitude_rad=request.site.latitude_rad,
            azimuth_rad=request.site.azimuth_rad,
            omitted=without_meaning(raw, found),
        )
    except InputError as error:
        raise _of_recording(request, error) from None
    free = request.free
    if gyro is not None:
        free = (*free, *(name for name in GYRO_FREE if name not in free))
    diagnosis, report_data = diagnose_rotation(
        session, request.forward, free, seed=request.seed, version=request.version, method=request.method
    )
    return Answer(with_clipping(replace(diagnosis, intake=found.findings), found, request.axes), report_data)


def _gyro(request: Request) -> Array | None:
    """Rates about the tool's axes, (3, N) rad/s, where they were recorded."""
    if not all(name in request.columns for name in GYROS):
        return None
    return request.in_tool_axes(np.radians(request.complete(*GYROS)))


def _magnitude(request: Request) -> Answer:
    """Still readings of which only |g| is known; without enough of them the verdict is `not_testable`."""
    from highside.diagnosis.magnitude.outlying import too_few, without_outlying_readings
    from highside.diagnosis.magnitude.session import magnitude_session, nothing_testable

    request, lacking = _without_missing(request)
    found = check(request.columns, (), request.axes, attitude=False, every_row=False)
    found = _with_lacking(found, lacking)
    if found.spoiled:
        return _bad_data(request, found)
    accel = request.in_tool_axes(request.complete(*ACCELEROMETERS))
    session = magnitude_session(request.columns, accel, gravity_mps2=request.site.gravity_mps2)
    if isinstance(session, str):
        return Answer(nothing_testable(session, found.findings, request.seed, request.version), None)
    if (lacks := too_few(session, request.forward, request.free)) is not None:
        answer = nothing_testable(lacks[0], found.findings, request.seed, request.version, lacks[1])
        return Answer(answer, None)
    session, outlying = without_outlying_readings(session, request.forward, request.free)
    diagnosis, report_data = diagnose_magnitudes(
        session, request.forward, request.free, seed=request.seed, version=request.version
    )
    return Answer(replace(diagnosis, intake=(*found.findings, *outlying)), report_data)


def _beside(request: Request) -> Answer:
    """Any channels beside another program's prediction of them."""
    from highside.diagnosis.simulation.intake import check_prediction
    from highside.diagnosis.simulation.session import simulation_session

    if request.predicted is None:
        raise InputError(
            "the model says that another program predicts the recording",
            where=request.where,
            field="reference.kind",
            remedy="give its output with simulation=",
        )
    try:
        session = simulation_session(request.columns, request.predicted, request.align)
    except InputError as error:
        raise InputError(error.what, where=request.predicted_where, field=error.field, remedy=error.remedy) from None
    found = check_prediction(session)
    if found:
        bad = DiagnosisResult("bad_data", intake=found, seed=request.seed, version=request.version)
        return Answer(bad, None, (_aligned(session),))
    diagnosis, report_data = diagnose_simulation(
        session, request.free_of_prediction, seed=request.seed, version=request.version
    )
    return Answer(diagnosis, report_data, (_aligned(session),))


def _aligned(session: SimulationSession) -> str:
    """What was compared, and how the two were brought together."""
    a = session.alignment
    if not a.same_clock:
        how = said(
            "each file has its own zero of time: the prediction was shifted by %(shift)s s", shift=f"{a.shift_s:+.5g}"
        )
    elif a.rate:
        how = said(
            "one clock: the recording lags by %(lag)s s at the start, and the rate of the clock or of the motion is off"
            " by %(rate)s",
            lag=f"{a.lag_s:+.4g}",
            rate=f"{a.rate:+.3%}",
        )
    elif a.lag_s >= 0.0:
        how = said(
            "one clock: the recording is %(lag)s s after the prediction, which is left to be diagnosed",
            lag=f"{a.lag_s:.4g}",
        )
    else:
        how = said(
            "one clock: the recording is %(lag)s s before the prediction, which is left to be diagnosed",
            lag=f"{-a.lag_s:.4g}",
        )
    return said(
        "%(channels)s: %(span)s s compared, %(rate)s rows/s, up to %(band)s Hz; %(how)s (correlation %(correlation)s)",
        channels=", ".join(session.names),
        span=f"{session.n * session.step_s:.1f}",
        rate=f"{1 / session.step_s:.3g}",
        band=f"{session.band_hz:.3g}",
        how=how,
        correlation=f"{a.correlation:.3f}",
    )


KINDS = (
    Kind("simulation", lambda r: r.predicted is not None or r.reference == "simulation", _beside),
    Kind("magnitude", lambda r: r.reference == "magnitude", _magnitude),
    Kind("rotation", lambda r: rotates(r.columns), _rotation),
    Kind("pose", lambda r: True, _poses),
)
"""The kinds of reference; the first that is meant diagnoses."""
