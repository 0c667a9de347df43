"""Calibration: poses out of recordings, calibrations out of poses, corrected readings out of both."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, TypedDict, Unpack, overload

import numpy as np

from highside.api.bench import ModelLike, on_true_bench
from highside.arrays import Array
from highside.calibration.applied import Applied, apply_record
from highside.calibration.method import NO_FALLBACK, Solution, SolveRequest
from highside.calibration.methods import get
from highside.calibration.pose_table import require_g, solver_columns, still_poses, tool_of_session
from highside.calibration.record import (
    CalibrationRecord,
    Environment,
    PoseColumns,
    build_record,
    largest_difference,
    parse_record,
    recompute,
    solve_poses,
    verify,
)
from highside.calibration.remark import Remark
from highside.calibration.sensor_laws import pose_covariates, without_laws
from highside.calibration.signature import SigningKey
from highside.calibration.summary import summary
from highside.errors import InputError
from highside.physics.law import Law
from highside.recording.calibration_store import read_record
from highside.recording.files import write_whole
from highside.recording.frames import Columns, File, FrameT, source_of, take
from highside.recording.table import PoseTable, Readings, Recording, SolverTable, Table
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot

if TYPE_CHECKING:
    from highside.rotation import Compensation

__all__ = ["Calibration", "CorrectedReadings", "calibrate", "find_poses", "read_solver_table"]

DAY_S = 86400.0
LARGEST_POSE_SIGMA_DEG = 10.0
"""a standard deviation of a setting from which on it is no bench: 2,000 times that of a rotary table"""
SMALLEST_POSE_SIGMA_DEG = 1e-6
"""a setting that is more certain is of no bench: a five-thousandth of that of a rotary table"""
LONGEST_DAYS = 36_525.0
"""until a record expires: a century. The largest number would be no date."""
GRAVITY_MPS2 = (9.7, 9.9)
"""between these lies gravity anywhere on the Earth, from its highest mountains to its deepest mines"""


class FoundPoses(NamedTuple):
    """A pose table in the requested kind, and what was omitted and why."""

    poses: Any
    omitted: list[str]


@overload
def find_poses(recording: File, *, min_s: float = ..., window_s: float = ...) -> PoseTable: ...
@overload
def find_poses(recording: Columns, *, min_s: float = ..., window_s: float = ...) -> dict[str, Array]: ...
@overload
def find_poses(recording: FrameT, *, min_s: float = ..., window_s: float = ...) -> FrameT: ...
def find_poses(recording: Any, *, min_s: float = 1.5, window_s: float = 0.5) -> Any:
    """The pose table of a recording: one row for each interval in which the tool lay still.

    `recording` (a file, DataFrame, dict of arrays or Recording of N rows) needs `t_s` in s and `ax_g, ay_g, az_g` in g;
    where it has a column `pose`, that says what a pose is. `min_s`: the shortest still interval, `window_s`: the window
    in which stillness is judged, both s. The answer is of the kind that came in (of a file a PoseTable), K rows:
    `ax, ay, az` (means, g), `n`, `std_ax, ...` (of one reading, g) and, where the recording has them, `inc_ref_deg`,
    `tf_ref_deg`, `temp_c`, `pose`, `direction`. Raises InputError for a recording that is not in order, Refused where
    no usable pose is in it.
    """
    return poses_of(recording, min_s=min_s, window_s=window_s).poses


def poses_of(recording: Any, *, min_s: float, window_s: float) -> FoundPoses:
    """As `find_poses`, with what was omitted and why."""
    taken = take(recording, Recording)
    table = taken.table
    a = table.accel()
    found = still_poses(a, table.columns, min_s=min_s, window_s=window_s, where=table.source or "recording")
    kind = PoseTable if {*PoseTable.mandatory} <= set(found.columns) else Table
    return FoundPoses(taken.new(kind(found.columns)), found.omitted)


def calibrate(
    poses: File | Columns | FrameT,
    method: str = "joint",
    *,
    triples: str = "average",
    reference: Literal["pose", "magnitude"] = "pose",
    pose_sigma_deg: float = 0.0052,
    fallback: str = NO_FALLBACK,
    tool: str | None = None,
    serial: str | None = None,
    bench: str | None = None,
    operator: str | None = None,
    gravity_mps2: float | None = None,
    gravity_std_mps2: float = 1e-4,
    temp_c: float | None = None,
    expires_days: float | None = None,
    turntable: Compensation | Path | None = None,
    model: ModelLike | None = None,
    key: SigningKey | None = None,
) -> Calibration:
    """Solve a pose table.

    `poses` (a file, DataFrame, dict of arrays or PoseTable of K rows): `ax, ay, az` in g and, unless `reference` is
    "magnitude" (only |g| is known), `inc_ref_deg, tf_ref_deg`; optional `n`, `std_ax, ...` (g), `temp_c`, `pose`,
    `direction`. `method`: "joint" (all poses at once, the default), "balance" (zones of inclination; `triples` says
    which poses of an inclination, `fallback` what corrects elsewhere) or "conventional". `pose_sigma_deg`: standard
    deviation of a setting of the bench. `tool`, `serial`, `bench`, `operator`, `gravity_mps2` with `gravity_std_mps2`,
    `temp_c` and `expires_days` go into the record. `turntable`: errors of the bench's own encoder and axis; `model`:
    a model (`Diagnosis.write_model`) whose effects and laws of the bench are known; both are taken off the references
    first. Its laws of the sensor are taken off the readings and kept in the record, which takes them off whatever it
    corrects. `key` signs the record.

    A Calibration is made of a pose set that is refused too: see `Calibration.refused`. Raises InputError for a table or
    an argument that is not in order, Refused where no calibration follows at all.
    """
    _require_arguments(pose_sigma_deg, gravity_mps2, expires_days)
    request = SolveRequest(
        method, triples, reference, pose_sigma_deg, fallback if get(method).by_inclination else NO_FALLBACK
    )
    source = read_solver_table(poses)
    where = source.table.source or "pose table"
    tool_id, serial = tool_of_session(source.table.columns, source.table.texts, tool, serial, where)
    table, bench_id, notes, laws = on_true_bench(source.table, turntable, model)
    columns = solver_columns(table.columns, table.texts) | pose_covariates(laws, table.columns, where=where)
    solution = solve_poses(without_laws(columns, laws), request, where=where)
    gravity_std = None if gravity_mps2 is None else gravity_std_mps2
    environment = Environment(bench, operator, temp_c, gravity_mps2, gravity_std, bench_id)
    record = _record(request, solution, source, columns, laws, environment, (tool_id, serial), expires_days, key)
    return Calibration(record, notes=notes, remarks=_remarks(solution))


def _record(
    request: SolveRequest,
    solution: Solution,
    source: SolverSource,
    columns: PoseColumns,
    laws: Sequence[Law],
    environment: Environment,
    tool: tuple[str, str | None],
    expires_days: float | None,
    key: SigningKey | None,
) -> CalibrationRecord:
    """The record of a solution of now, signed where a key is given."""
    now = time.time()
    record = build_record(
        tool_id=tool[0],
        serial=tool[1],
        request=request,
        result=solution.result,
        fallback=solution.fallback,
        guide=solution.guide,
        pose_columns=columns,
        raw_sha256=source.sha256,
        raw_name=source.name,
        environment=environment,
        now_s=now,
        expires_s=None if expires_days is None else now + expires_days * DAY_S,
        laws=laws,
    )
    return record if key is None else record.signed(key, now_s=now)


def _require_arguments(pose_sigma_deg: float, gravity_mps2: float | None, expires_days: float | None) -> None:
    """Raises InputError for what cannot be."""
    if not SMALLEST_POSE_SIGMA_DEG <= pose_sigma_deg < LARGEST_POSE_SIGMA_DEG:
        raise InputError(f"{pose_sigma_deg:g} deg is not a bench", field="pose_sigma_deg")
    if gravity_mps2 is not None and not GRAVITY_MPS2[0] < gravity_mps2 < GRAVITY_MPS2[1]:
        raise InputError(f"{gravity_mps2:g} m/s2 is not on this earth", field="gravity_mps2", remedy="9.780 to 9.832")
    if expires_days is not None and not 0.0 < expires_days <= LONGEST_DAYS:
        raise InputError(f"must be more than 0, at most {LONGEST_DAYS:.0f}", field="expires_days")


class SolverSource(NamedTuple):
    """A pose table to be solved, and what a record says of where it came from."""

    table: SolverTable
    name: str
    sha256: str


def read_solver_table(poses: Any) -> SolverSource:
    """A pose table, its name, and the hash of its file (of a table in memory: of the CSV that it would be)."""
    table = take(poses, SolverTable).table
    return SolverSource(table, *source_of(poses, table))


def _remarks(solution: Solution) -> tuple[Remark, ...]:
    beside = () if solution.fallback is None else solution.fallback.remarks
    return (*solution.result.remarks, *beside)


class CorrectedReadings(NamedTuple):
    """Readings with what a calibration says of them, in the kind that came in, and what must be reported with them."""

    data: Any
    applied: Applied
    """by row: the columns added, which zone made it; how many rows lie outside of what was calibrated"""

    def _repr_html_(self) -> str:
        """What a notebook shows: how many rows each zone corrected, and how many none."""
        done = self.applied
        rows = [[zone, str(count)] for zone, count in done.rows_by_zone.items()]
        outside = (
            ("outside of every zone, without I and T", done.outside_zone),
            ("beyond the calibrated temperatures", done.temperature_outside),
            ("beyond the range of a law", done.law_outside),
            ("without what a law depends on", done.law_not_applied),
        )
        return card(["zone", "rows"], rows + [[word, str(count)] for word, count in outside if count])

    def plot(self) -> Plot:
        """Inclination and toolface with their standard deviations over the rows, deg."""
        along = np.arange(len(self.applied.zones), dtype=float)
        found = self.applied.columns
        panels = []
        for name, word in (("inc", "inclination"), ("tf", "toolface")):
            line = PlotLine(word, found[f"{name}_deg"], found[f"{name}_std_deg"])
            panels.append(PlotPanel(along, (line,), "row", f"{word}, deg"))
        return Plot("Corrected readings", tuple(panels))


class CorrectOptions(TypedDict, total=False):
    """What may be said to `Calibration.correct` beside the readings."""

    frame: Literal["gravity", "bench"]
    noise_g: float | None
    zones: bool
    tool: str | None
    serial: str | None
    allow_expired: bool


@dataclass(frozen=True, slots=True)
class Calibration:
    """A calibration of a tool's accelerometers: a record that keeps its poses, its covariance and its own hash."""

    record: CalibrationRecord
    notes: tuple[str, ...] = ()
    """what was done with the poses before they were solved"""
    remarks: tuple[Remark, ...] = ()
    """what the solver says of the poses"""

    @classmethod
    def load(cls, path: File) -> Self:
        """Read a record file and check its hash, schema and units. Raises InputError, or Refused (tampered, ...)."""
        record = read_record(Path(path))
        return cls(record, remarks=record.result.remarks)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """As `load`, from the text of a record."""
        record = parse_record(text)
        return cls(record, remarks=record.result.remarks)

    def save(self, path: File) -> None:
        """Write the record as a whole (never half). Raises InputError where it cannot be written."""
        write_whole(Path(path), self.record.to_json().encode())

    @property
    def id(self) -> str:
        """SHA-256 of the record's content, 64 hexadecimal digits."""
        return self.record.id

    @property
    def refused(self) -> tuple[Remark, ...]:
        """The remarks for which this calibration must not be used."""
        return tuple(remark for remark in self.remarks if remark.refused)

    @property
    def matrix(self) -> Array:
        """A of the sensor `m = A g + b`, (3, 3): scale factors and misalignments of the main zone."""
        return np.array(self.record.result.A)

    @property
    def bias_g(self) -> Array:
        """b of the sensor `m = A g + b`, (3,) g."""
        return np.array(self.record.result.b)

    @property
    def bias_std_g(self) -> Array:
        """Standard deviations of `bias_g`, (3,) g."""
        return np.array([self.record.result.main.parameters.std(f"b_{axis}") for axis in "xyz"])

    def summary(self) -> dict[str, Any]:
        """Method, residuals, closures, zones, uncertainty and remarks as plain values, degrees and g."""
        return summary(self.record)

    def recomputed(self) -> float:
        """Solve the record's own poses again: the largest difference of a parameter; infinite if of another kind."""
        return largest_difference(self.record, recompute(self.record))

    @overload
    def correct(self, readings: File, **options: Unpack[CorrectOptions]) -> Readings: ...
    @overload
    def correct(self, readings: Columns, **options: Unpack[CorrectOptions]) -> dict[str, Array]: ...
    @overload
    def correct(self, readings: FrameT, **options: Unpack[CorrectOptions]) -> FrameT: ...
    def correct(self, readings: Any, **options: Unpack[CorrectOptions]) -> Any:
        """Readings (N rows, of a file, DataFrame, dict of arrays or Recording) with inclination and toolface.

        They need `ax_g, ay_g, az_g` (or `ax, ay, az` of a pose table) in g, optional `temp_c` and `noise_g`. The answer
        is of the kind that came in, with `inc_deg, tf_deg, inc_std_deg, tf_std_deg` added; rows outside of every zone
        have none. Options: `frame` "gravity" (default) or "bench", what the angles are referred to;
        `noise_g`, the standard deviation of one row in g (else the column, else the record's own); `zones=True` adds
        the text column `zone`; `tool`, `serial`, whom the readings are of; `allow_expired=True` for old readings.
        Raises InputError for readings that are not in order, Refused for a record that is expired or of another tool.
        """
        return self.corrected(readings, **options).data

    def corrected(
        self,
        readings: File | Columns | FrameT,
        *,
        frame: Literal["gravity", "bench"] = "gravity",
        noise_g: float | None = None,
        zones: bool = False,
        tool: str | None = None,
        serial: str | None = None,
        allow_expired: bool = False,
    ) -> CorrectedReadings:
        """As `correct`, with the zones and the counts of rows that lie outside of what was calibrated."""
        if noise_g is not None and not 0.0 <= noise_g < 1.0:
            raise InputError(f"{noise_g:g} g cannot be the noise of a row", field="noise_g")
        verify(self.record, tool_id=tool, serial=serial, now_s=None if allow_expired else time.time())
        taken = take(readings, Readings)
        table = taken.table
        names = ("ax_g", "ay_g", "az_g")
        if not table.has(*names) and table.has("ax", "ay", "az"):
            names = ("ax", "ay", "az")
        a = table.complete(*names)
        require_g(a, table.source)
        noise = self._noise(table, noise_g, of_means=names[0] == "ax")
        done = apply_record(self.record, a, noise, table.columns.get("temp_c"), frame=frame, columns=table.columns)
        texts = {"zone": done.zones} if zones else None
        return CorrectedReadings(taken.with_columns(done.columns, texts), done)

    def _noise(self, table: Table, noise_g: float | None, *, of_means: bool) -> Array | float:
        """Standard deviation of each row, g: as given, of the column `noise_g`, or the record's own."""
        if noise_g is not None:
            return noise_g
        if table.has("noise_g"):
            noise: Array = table.complete("noise_g")[0]
            if np.any(noise < 0.0):
                raise InputError("negative standard deviation", where=table.source, field="noise_g")
            return noise
        own = self.record.result.reading_noise_g
        if of_means and table.has("n"):
            return np.asarray(own / np.sqrt(table.complete("n")[0]))
        return float(own)

    def _repr_html_(self) -> str:
        """What a notebook shows: tool, method, zones and accuracy."""
        s = self.summary()
        rows = [
            [f"{row['inc_deg']:g}", f"{row['inc_std_deg']:.4f}", f"{row['tf_std_deg']:.4f}", str(row["zone"])]
            for row in s["uncertainty"]
        ]
        headline = (
            f"Calibration {s['id'][:12]} of tool {s['tool']}: {s['method']}, {s['poses_used']} of {s['poses']} poses"
        )
        remarks = (f"{'refused: ' if remark.refused else ''}{remark.text}" for remark in self.remarks)
        return card(["I, deg", "std of I, deg", "std of T, deg", "zone"], rows, *remarks, title=headline)

    def plot(self) -> Plot:
        """Residuals of the poses in ug, an axis each, and the standard deviations of I and T over the inclination."""
        fit = self.record.result.poses.residual_g
        accuracy = self.summary()["uncertainty"]
        along = np.array([row["inc_deg"] for row in accuracy], dtype=float)
        residuals = tuple(PlotLine(f"a{axis}", row * 1e6, look="points") for axis, row in zip("xyz", fit, strict=True))
        stated = tuple(
            PlotLine(word, np.array([row[name] for row in accuracy], dtype=float))
            for name, word in (("inc_std_deg", "I"), ("tf_std_deg", "T"))
        )
        poses = PlotPanel(np.arange(1.0, fit.shape[1] + 1.0), residuals, "pose", "residual, ug")
        return Plot(
            f"Calibration {self.id[:12]} of tool {self.record.tool_id}",
            (poses, PlotPanel(along, stated, "inclination, deg", "standard deviation, deg", log=True)),
        )
