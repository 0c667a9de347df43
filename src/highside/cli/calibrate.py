"""`highside calibrate ...`: poses out of recordings, calibrations out of poses, corrected readings out of both."""

from __future__ import annotations

import json
import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli import bench, bench_sessions, certificate, verification
from highside.cli.say import echo, echo_json
from highside.errors import InputError, Refused

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.calibration.record import CalibrationRecord, Solution
    from highside.recording.calibration_store import CalibrationStore
    from highside.recording.table import Table

    FloatArray = NDArray[np.float64]

app = typer.Typer(
    name="calibrate",
    no_args_is_help=True,
    help="Calibrate the accelerometers: find poses, solve, apply, and keep the records.",
)

app.command()(bench.bench)
app.command()(bench_sessions.sessions)
app.command()(verification.verify)
app.command()(certificate.certificate)

DAY_S = 86400.0
ROWS_AT_ONCE = 65536
DECIMALS = 9
"""of an angle written, deg"""
SUMMARY_INCLINATIONS_DEG = (0.6, 1.2, 3.0, 10.0, 30.0, 45.0, 60.0, 90.0)


class Method(StrEnum):
    """How a pose table is solved."""

    CONVENTIONAL = "conventional"
    BALANCE = "balance"
    JOINT = "joint"


class Triples(StrEnum):
    """Which poses of a ring make the balance matrix."""

    T123 = "1-2-3"
    T234 = "2-3-4"
    T341 = "3-4-1"
    T412 = "4-1-2"
    AVERAGE = "average"
    LEAST_SQUARES = "least-squares"


class Reference(StrEnum):
    """What is known about the poses."""

    POSE = "pose"
    MAGNITUDE = "magnitude"


class Fallback(StrEnum):
    """The global correction between and beyond balance zones."""

    NONE = "none"
    CONVENTIONAL = "conventional"
    JOINT = "joint"


class FrameOfOutput(StrEnum):
    """What inclination and toolface are referred to."""

    GRAVITY = "gravity"
    BENCH = "bench"


StoreOption = Annotated[Path, typer.Option("--store", help="Calibration store (a directory).")]
ToolOption = Annotated[str | None, typer.Option("--tool", help="Name of the tool.")]
SerialOption = Annotated[str | None, typer.Option("--serial", help="Serial number of the tool.")]
TrustedOption = Annotated[
    Path | None, typer.Option("--trusted", help="Only a record signed with one of these public keys.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print as JSON.")]
Output = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]


@app.command()
def poses(
    recording: Annotated[Path, typer.Argument(help="Recording (CSV) with t_s, ax_g, ay_g, az_g.")],
    output: Output,
    min_s: Annotated[float, typer.Option("--min-s", help="Shortest still interval, seconds.")] = 1.5,
    window_s: Annotated[float, typer.Option("--window-s", help="Window in which stillness is judged, seconds.")] = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Find the still intervals of a recording and write one row a pose."""
    from highside.recording.table import Table, read_recording

    table = read_recording(recording)
    columns, dropped = _poses_of_recording(table, min_s, window_s)
    Table(columns).write(output)
    count = columns["ax"].size
    if as_json:
        echo_json(json.dumps({"poses": count, "dropped": dropped, "output": str(output)}))
        return
    echo(f"{output}: {count} poses, {int(columns['n'].sum())} of {table.n} readings")
    for line in dropped:
        echo(f"left out: {line}", err=True)


@app.command()
def solve(
    poses_file: Annotated[Path, typer.Argument(metavar="POSES", help="Pose table (CSV).")],
    method: Annotated[Method, typer.Option(help="How to solve.")],
    output: Output,
    triples: Annotated[Triples, typer.Option(help="For balance: which poses of a ring.")] = Triples.AVERAGE,
    reference: Annotated[Reference, typer.Option(help="Attitude of the poses known, or only |g|.")] = Reference.POSE,
    pose_sigma_deg: Annotated[float, typer.Option(help="Standard deviation of a setting of the bench, deg.")] = 0.0052,
    fallback: Annotated[Fallback, typer.Option(help="For balance: correction beyond the zones.")] = Fallback.NONE,
    store: Annotated[Path | None, typer.Option("--store", help="Also keep the record in this store.")] = None,
    tool: ToolOption = None,
    serial: SerialOption = None,
    bench: Annotated[str | None, typer.Option(help="Name of the bench.")] = None,
    operator: Annotated[str | None, typer.Option(help="Who measured.")] = None,
    gravity_mps2: Annotated[float | None, typer.Option(help="Local gravity at the bench, m/s2.")] = None,
    gravity_std_mps2: Annotated[float, typer.Option(help="Its standard deviation, m/s2.")] = 1e-4,
    temp_c: Annotated[float | None, typer.Option(help="Temperature, where the table has no temp_c.")] = None,
    expires_days: Annotated[float | None, typer.Option(help="Days until the record expires.")] = None,
    turntable: Annotated[
        Path | None, typer.Option(help="Errors of the bench's own encoder and axis (`rotation turntable`).")
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model file: its bench effects (`diagnose --write-model`).")
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", help="Sign the record with this key (`highside keys`).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a pose table and write a calibration record. Exit 1: something was refused (see what is said)."""
    from highside.calibration.record import Environment, SolveRequest, build_record, solve_poses

    if not 0.0 < pose_sigma_deg < 10.0:
        raise InputError(f"{pose_sigma_deg:g} deg is not a bench", field="--pose-sigma-deg")
    if gravity_mps2 is not None and not 9.7 < gravity_mps2 < 9.9:
        raise InputError(f"{gravity_mps2:g} m/s2 is not on this earth", field="--gravity-mps2", remedy="9.780 to 9.832")
    if expires_days is not None and not expires_days > 0.0:
        raise InputError("must be more than 0", field="--expires-days")
    private = None
    if key is not None:
        from highside.cli.keys import signing_key

        # before the work: a key that cannot be used is known at once
        private = signing_key(key)
    request = SolveRequest(
        method.value,
        triples.value,
        reference.value,
        pose_sigma_deg,
        fallback.value if method is Method.BALANCE else "none",
    )
    table, sha256 = _read_pose_table(poses_file)
    tool_id, serial = _tool_of_session(table, tool, serial, poses_file)
    turntable_id = None
    if turntable is not None:
        from highside.cli.turntable import correct_poses

        table, turntable_id = correct_poses(table, turntable)
    if model is not None:
        from highside.cli.bench_model import correct_poses_by_model

        table, model_id, left = correct_poses_by_model(table, model)
        turntable_id = model_id if turntable_id is None else f"{turntable_id} {model_id}"
        if left:
            echo(f"of {model} only the bench is used; estimated anew: {', '.join(left)}", err=True)
    columns = _pose_columns(table)
    solution = solve_poses(columns, request, where=str(poses_file))
    now = time.time()
    record = build_record(
        tool_id=tool_id,
        serial=serial,
        request=request,
        result=solution.result,
        fallback=solution.fallback,
        guide=solution.guide,
        pose_columns=columns,
        raw_sha256=sha256,
        raw_name=poses_file.name,
        environment=Environment(
            bench, operator, temp_c, gravity_mps2, None if gravity_mps2 is None else gravity_std_mps2, turntable_id
        ),
        now_s=now,
        expires_s=None if expires_days is None else now + expires_days * DAY_S,
    )
    if private is not None:
        record = record.signed(private, now_s=now)
    _write_record(record, output)
    if store is not None:
        from highside.recording.calibration_store import CalibrationStore

        CalibrationStore(store).add(record)
    _show_record(record, as_json)
    refused = [remark for remark in _all_remarks(solution) if remark.refused]
    if refused:
        for remark in refused:
            echo(f"highside: refused ({remark.reason.value}): {remark.text}", err=True)
        raise typer.Exit(1)


@app.command()
def apply(
    record_file: Annotated[Path, typer.Argument(metavar="CAL", help="Calibration record (JSON).")],
    readings: Annotated[Path, typer.Argument(help="Readings (CSV) with ax_g, ay_g, az_g.")],
    output: Output,
    frame: Annotated[
        FrameOfOutput, typer.Option(help="Refer I and T to gravity or to the bench.")
    ] = FrameOfOutput.GRAVITY,
    noise_g: Annotated[float | None, typer.Option(help="Standard deviation of one row, g.")] = None,
    tool: ToolOption = None,
    serial: SerialOption = None,
    zones: Annotated[bool, typer.Option("--zones", help="Add the column zone: which correction made the row.")] = False,
    allow_expired: Annotated[
        bool, typer.Option("--allow-expired", help="For old readings: use an expired record.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Correct readings: adds inc_deg, tf_deg, inc_std_deg, tf_std_deg. Rows outside of every zone stay empty."""
    from highside.calibration.record import verify
    from highside.recording.calibration_store import read_record

    if noise_g is not None and not 0.0 <= noise_g < 1.0:
        raise InputError(f"{noise_g:g} g cannot be the noise of a row", field="--noise-g")
    record = read_record(record_file)
    verify(record, tool_id=tool, serial=serial, now_s=None if allow_expired else time.time())
    table, _ = _read_readings(readings)
    out = _apply(record, table, frame.value, noise_g)
    added = table.with_columns(out.columns)
    if zones:
        added.texts["zone"] = out.zones
        added.order = (*(name for name in added.order if name != "zone"), "zone")
        added.columns.pop("zone", None)
    added.write(output)
    if as_json:
        echo_json(json.dumps({"rows": table.n, "output": str(output), "cal_id": record.id, **out.counts}))
        return
    made = ", ".join(f"{name} {count}" for name, count in out.counts["zones"].items())
    echo(f"{output}: {table.n} rows corrected by {record.id[:12]} ({made or 'none'})")
    if out.counts["outside_zone"]:
        echo(f"{out.counts['outside_zone']} rows lie outside of every zone and have no inclination or toolface")
    if out.counts["temperature_outside"]:
        echo(f"{out.counts['temperature_outside']} rows lie outside of the calibrated temperatures: uncertainty grown")


@app.command()
def show(
    target: Annotated[
        str | None, typer.Argument(help="Record file, or id in the store; the one in force if absent.")
    ] = None,
    store: Annotated[Path | None, typer.Option("--store", help="Calibration store.")] = None,
    tool: ToolOption = None,
    check: Annotated[bool, typer.Option("--recompute", help="Solve the record's own poses again and compare.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Print a record: method, residuals, closures, uncertainty. A damaged record is refused."""
    record = _find_record(target, store, tool)
    _show_record(record, as_json)
    if check:
        _recompute(record, as_json)


@app.command()
def activate(
    target: Annotated[str, typer.Argument(help="Record file, or id (or its beginning) in the store.")],
    store: StoreOption,
    tool: ToolOption = None,
    serial: SerialOption = None,
    force: Annotated[bool, typer.Option("--force", help="Even if the poses contradict one another.")] = False,
    trusted: TrustedOption = None,
    as_json: JsonOption = False,
) -> None:
    """Put a record in force for its tool."""
    from highside.recording.calibration_store import CalibrationStore, contradiction
    from highside.recording.keys import read_trusted_keys

    record = _find_record(target, store, None)
    doubt = contradiction(record)
    if doubt is not None and not force:
        raise Refused(f"{doubt} (or --force)")
    keys = None if trusted is None else read_trusted_keys(trusted)
    entry = CalibrationStore(store).activate(record, now_s=time.time(), tool_id=tool, serial=serial, trusted=keys)
    _say_entry(entry, as_json)


@app.command()
def history(store: StoreOption, tool: ToolOption = None, as_json: JsonOption = False) -> None:
    """What was in force, when; the present one is marked."""
    from highside.calibration.record import to_utc
    from highside.recording.calibration_store import CalibrationStore

    kept = CalibrationStore(store)
    entries = kept.history(tool)
    active = {name: kept.active_id(name) for name in {entry.tool_id for entry in entries}}
    last = {entry.tool_id: entry.number for entry in entries}
    rows = [
        {
            "number": entry.number,
            "at": to_utc(entry.at_s),
            "tool": entry.tool_id,
            "action": entry.action,
            "id": entry.record_id,
            "active": last[entry.tool_id] == entry.number and active[entry.tool_id] == entry.record_id,
        }
        for entry in entries
    ]
    if as_json:
        echo_json(json.dumps({"history": rows, "records": kept.ids()}))
        return
    for row in rows:
        mark = "*" if row["active"] else " "
        echo(f"{mark} {row['number']:>4}  {row['at']}  {row['tool']:<12} {row['action']:<9} {str(row['id'])[:12]}")
    if not rows:
        echo(f"nothing was put in force; {len(kept.ids())} records are kept")


@app.command()
def rollback(
    store: StoreOption, tool: ToolOption = None, trusted: TrustedOption = None, as_json: JsonOption = False
) -> None:
    """Put the record in force that was so before the present one."""
    from highside.recording.calibration_store import CalibrationStore
    from highside.recording.keys import read_trusted_keys

    kept = CalibrationStore(store)
    keys = None if trusted is None else read_trusted_keys(trusted)
    _say_entry(kept.rollback(_only_tool(kept, tool), now_s=time.time(), trusted=keys), as_json)


# --- poses ---------------------------------------------------------------------------------------------------


def _poses_of_recording(table: Table, min_s: float, window_s: float) -> tuple[dict[str, FloatArray], list[str]]:
    """Columns of the pose table, and what was left out and why."""
    import numpy as np

    from highside.calibration.poses import find_still_intervals, labelled_intervals, poses_from_intervals

    a = table.complete("ax_g", "ay_g", "az_g")
    _require_g(a, table.source)
    t = table.columns["t_s"]
    steps = np.diff(t)
    if not steps.size or not np.median(steps) > 0.0:
        raise InputError("time does not advance", where=table.source, field="t_s")
    rate = 1.0 / float(np.median(steps))
    labels = table.columns["pose"] if table.has("pose") else None
    codes = None if labels is None else np.where(np.isnan(labels), -1.0, labels)
    if codes is not None and bool((codes >= 0).any()):
        found = labelled_intervals(a, codes)
    else:
        found = find_still_intervals(a, rate, min_s=min_s, window_s=window_s)
    dropped: list[str] = []
    kept = []
    has_reference = table.has("inc_ref_deg", "tf_ref_deg")
    for interval in found:
        rows = slice(interval.start, interval.stop)
        when = f"{t[interval.start]:.3f} to {t[interval.stop - 1]:.3f} s"
        if has_reference:
            inc, tf = table.columns["inc_ref_deg"][rows], table.columns["tf_ref_deg"][rows]
            if np.isnan(inc).any() or np.isnan(tf).any():
                dropped.append(f"{when}: still, but no reference attitude")
                continue
            if np.ptp(inc) > 0.01 or np.ptp(np.unwrap(tf, period=360.0)) > 0.01:
                dropped.append(f"{when}: the reference attitude changes while the tool lies still")
                continue
        kept.append(interval)
    if not kept:
        raise Refused(f"{table.source}: no usable pose: {'; '.join(dropped[:3])}")
    found_poses = poses_from_intervals(a, kept, temp_c=table.columns.get("temp_c"))
    columns: dict[str, FloatArray] = {}
    starts = np.array([interval.start for interval in kept])
    for name in ("inc_ref_deg", "tf_ref_deg") if has_reference else ():
        columns[name] = table.columns[name][starts]
    columns |= {"ax": found_poses.a[0], "ay": found_poses.a[1], "az": found_poses.a[2], "n": found_poses.n}
    columns |= {f"std_a{axis}": found_poses.std[i] for i, axis in enumerate("xyz")}
    if found_poses.temp_c is not None and not np.isnan(found_poses.temp_c).any():
        columns["temp_c"] = found_poses.temp_c
    for name in ("pose", "direction"):
        if table.has(name) and not np.isnan(table.columns[name][starts]).any():
            columns[name] = table.columns[name][starts]
    return columns, dropped


def _require_g(a: FloatArray, where: str | None) -> None:
    """Refuse units that cannot be g, judged by at most a thousand rows."""
    from highside.calibration.poses import PoseSet

    PoseSet.build(a[:, :: max(1, a.shape[1] // 1000)], where=where)


def _read_pose_table(path: Path) -> tuple[Table, str]:
    from highside.recording.table import POSE_COLUMNS, Table

    return _read_table(path, Table, POSE_COLUMNS)


def _read_readings(path: Path) -> tuple[Table, str]:
    from highside.recording.table import POSE_COLUMNS, RECORDING_COLUMNS, Table

    return _read_table(path, Table, (*RECORDING_COLUMNS, *POSE_COLUMNS))


def _read_table(path: Path, kind: type[Table], known: tuple[str, ...]) -> tuple[Table, str]:
    """A table whose mandatory columns are asked for later (they depend on the request), and the hash of its file."""
    import hashlib

    from highside.reading import read_bytes

    asked: type[Table] = type("Asked", (kind,), {"known": known, "mandatory": (), "rows_are": "rows"})
    return asked.read(path), hashlib.sha256(read_bytes(path)).hexdigest()


def _tool_of_session(table: Table, tool: str | None, serial: str | None, path: Path) -> tuple[str, str | None]:
    """Tool and serial number of a session: as given, checked against the table's own columns `tool` and `serial`."""
    from highside.calibration.record import RecordError, RecordReason

    named = {}
    for column, given in (("tool", tool), ("serial", serial)):
        values = set(table.texts.get(column, ()))
        if column in table.columns:
            values = {f"{value:g}" for value in table.columns[column].tolist()}
        if len(values) > 1:
            raise InputError(f"poses of {len(values)} tools in one session", where=str(path), field=column)
        of_table = next(iter(values), None)
        if of_table is not None and given is not None and of_table != given:
            raise RecordError(
                RecordReason.WRONG_TOOL, f"{path}: the poses are of {column} {of_table!r}, not of {given!r}"
            )
        named[column] = given if given is not None else of_table
    return named["tool"] or "tool", named["serial"]


def _pose_columns(table: Table) -> dict[str, list[float] | list[str]]:
    """The columns that a solver may use, as plain values for the record."""
    import numpy as np

    from highside.recording.table import POSE_COLUMNS

    columns: dict[str, list[float] | list[str]] = {}
    for name in (*POSE_COLUMNS, "direction"):
        if name in table.columns and not (name not in ("ax", "ay", "az") and np.isnan(table.columns[name]).all()):
            columns[name] = table.columns[name].tolist()
    if "pose" in table.columns:
        columns["pose"] = [f"{value:g}" for value in table.columns["pose"].tolist()]
    elif "pose" in table.texts:
        columns["pose"] = list(table.texts["pose"])
    return columns


# --- apply ---------------------------------------------------------------------------------------------------


class _Applied:
    """Columns to add, the zone of each row, and what to report."""

    def __init__(self, count: int) -> None:
        import numpy as np

        self.columns = {name: np.full(count, np.nan) for name in ("inc_deg", "tf_deg", "inc_std_deg", "tf_std_deg")}
        self.zone_names = np.full(count, "none", dtype=object)
        self.temperature_outside = 0

    @property
    def zones(self) -> tuple[str, ...]:
        return tuple(self.zone_names.tolist())

    @property
    def counts(self) -> dict[str, Any]:
        from collections import Counter

        zones = Counter(self.zone_names.tolist())
        outside = zones.pop("none", 0)
        return {
            "zones": dict(sorted(zones.items())),
            "outside_zone": outside,
            "temperature_outside": self.temperature_outside,
        }


def _apply(record: CalibrationRecord, table: Table, frame: str, noise_g: float | None) -> _Applied:
    import numpy as np

    from highside.attitude.block import attitude_block, attitude_std_block
    from highside.calibration.correction import LinearCorrection
    from highside.calibration.record import correction_from_record
    from highside.calibration.schedule import ScheduledCorrection

    names = ("ax_g", "ay_g", "az_g")
    if not table.has(*names) and table.has("ax", "ay", "az"):
        names = ("ax", "ay", "az")
    a = table.complete(*names)
    _require_g(a, table.source)
    noise: FloatArray | float = record.result.reading_noise_g if noise_g is None else noise_g
    if noise_g is None and table.has("noise_g"):
        noise = table.complete("noise_g")[0]
        if np.any(noise < 0.0):
            raise InputError("negative standard deviation", where=table.source, field="noise_g")
    elif noise_g is None and names[0] == "ax" and table.has("n"):
        noise = noise / np.sqrt(table.complete("n")[0])
    temp = table.columns.get("temp_c")
    correction = correction_from_record(record)
    if not isinstance(correction, LinearCorrection | ScheduledCorrection):
        raise TypeError(f"{type(correction).__name__} cannot be applied in blocks")
    out = _Applied(table.n)
    for start in range(0, table.n, ROWS_AT_ONCE):
        rows = slice(start, min(start + ROWS_AT_ONCE, table.n))
        own = noise[rows] if isinstance(noise, np.ndarray) else noise
        done = correction.corrected_block(a[:, rows], own, None if temp is None else temp[rows])
        inc, tf = attitude_block(done.g)
        inc_std, tf_std, _ = attitude_std_block(done.g, done.cov)
        if frame == "bench":
            inc, tf, inc_std, tf_std = _in_bench_frame(record, inc, tf, inc_std, tf_std, own)
        inc_std[done.zone < 0] = np.nan
        tf_std[done.zone < 0] = np.nan
        for name, values in zip(out.columns, (inc, tf, inc_std, tf_std), strict=True):
            # a millionth of what the best sensor tells: more digits only make the file larger
            out.columns[name][rows] = np.round(np.rad2deg(values), DECIMALS)
        out.zone_names[rows] = np.array([*done.names, "none"], dtype=object)[done.zone]
        out.temperature_outside += int(np.count_nonzero(done.temperature_outside & (done.zone >= 0)))
    return out


def _in_bench_frame(
    record: CalibrationRecord,
    inc: FloatArray,
    tf: FloatArray,
    inc_std: FloatArray,
    tf_std: FloatArray,
    noise: FloatArray | float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """I and T as the bench reads them. The tilt's error is correlated with the vector's: both are taken together."""
    import numpy as np

    from highside.attitude.angles import wrap_positive

    result = record.result
    if result.frame != "gravity":
        return inc, tf, inc_std, tf_std  # the bench was taken as level: its frame is all there is
    alone = result.predict_std(inc, tf, noise)
    together = result.predict_std(inc, tf, noise, frame="bench")
    bench_inc, bench_tf = result.to_bench_frame(inc, tf)
    stds = [
        np.sqrt(np.maximum(total**2 - without**2 + with_tilt**2, 0.0))
        for total, without, with_tilt in zip((inc_std, tf_std), alone, together, strict=True)
    ]
    return bench_inc, wrap_positive(bench_tf), stds[0], stds[1]


# --- records -------------------------------------------------------------------------------------------------


def _write_record(record: CalibrationRecord, path: Path) -> None:
    from highside.recording.files import write_whole

    write_whole(path, record.to_json().encode())


def _find_record(target: str | None, store: Path | None, tool: str | None) -> CalibrationRecord:
    """A record by file, by id in a store, or the one in force."""
    from highside.recording.calibration_store import CalibrationStore, read_record

    if target is not None and (store is None or Path(target).is_file()):
        return read_record(Path(target))
    if store is None:
        raise InputError("which record?", remedy="give a file, or --store")
    kept = CalibrationStore(store)
    return kept.active(_only_tool(kept, tool)) if target is None else kept.get(target)


def _only_tool(kept: CalibrationStore, tool: str | None) -> str:
    if tool is not None:
        return tool
    from highside.calibration.record import RecordError, RecordReason

    tools = kept.tools()
    if not tools:
        raise RecordError(RecordReason.NONE_ACTIVE, f"nothing was put in force in {kept.directory}; calibrate activate")
    if len(tools) > 1:
        raise InputError(f"the store holds several tools ({', '.join(tools)})", remedy="give --tool")
    return tools[0]


def _say_entry(entry: Any, as_json: bool) -> None:
    if as_json:
        echo_json(
            json.dumps({"number": entry.number, "action": entry.action, "tool": entry.tool_id, "id": entry.record_id})
        )
    else:
        echo(f"in force for tool {entry.tool_id}: {entry.record_id}")


def _recompute(record: CalibrationRecord, as_json: bool) -> None:
    from highside.calibration.record import largest_difference, recompute

    difference = largest_difference(record, recompute(record))
    if not difference <= 1e-12:
        raise Refused(
            f"record {record.id[:12]} does not follow from its own poses: parameters differ by {difference:.3g}"
        )
    if not as_json:
        echo(f"recomputed from its {record.pose_count} poses: parameters equal within {difference:.1e}")


def _all_remarks(solution: Solution) -> list[Any]:
    remarks = list(solution.result.remarks)
    return remarks + (list(solution.fallback.remarks) if solution.fallback is not None else [])


def _show_record(record: CalibrationRecord, as_json: bool) -> None:
    summary = _summary(record)
    if as_json:
        echo_json(json.dumps(summary))
        return
    echo("\n".join(_summary_lines(summary)))


def _summary(record: CalibrationRecord) -> dict[str, Any]:
    """What a reader wants to know of a record, as plain values; degrees and g."""
    import numpy as np

    result = record.result
    fit = result.poses
    used = fit.used
    worst = int(np.argmax(np.abs(fit.studentised))) if fit.studentised.size else 0
    tilt = result.tilt_rad
    return {
        "id": record.id,
        "tool": record.tool_id,
        "serial": record.serial,
        "method": result.method,
        "options": dict(result.options),
        "frame": result.frame,
        "created": record.content["created"],
        "expires": record.content["expires"],
        "environment": dict(record.content["environment"]),
        "raw": dict(record.content["raw"]),
        "signature": None if record.signature is None else record.signature.to_dict(),
        "software": dict(record.content["software"]),
        "poses": len(fit.ids),
        "poses_used": int(np.count_nonzero(used)),
        "rms_residual_g": float(np.sqrt(np.mean(fit.residual_g[:, used] ** 2))) if used.any() else None,
        "worst_pose": {"pose": fit.ids[worst], "sigmas": float(abs(fit.studentised[worst]))} if fit.ids else None,
        "reading_noise_g": result.reading_noise_g,
        "tilt_deg": [float(np.rad2deg(value)) for value in tilt],
        "A": result.A.tolist(),
        "b_g": result.b.tolist(),
        "zones": [
            {
                "name": zone.name,
                "center_deg": None if zone.inc_center_rad is None else float(np.rad2deg(zone.inc_center_rad)),
                "from_deg": float(np.rad2deg(zone.inc_min_rad)),
                "to_deg": float(np.rad2deg(zone.inc_max_rad)),
                "condition": zone.condition,
            }
            for zone in result.zones
        ],
        "fallback": None if record.fallback is None else record.fallback.method,
        "closures": [
            {
                "inc_deg": float(np.rad2deg(closure.inc_rad)),
                "size_g": float(np.linalg.norm(closure.value)),
                "chi2": closure.chi2,
                "p": closure.p,
                "worst_pose": closure.worst_pose,
            }
            for closure in result.closures
        ],
        "uncertainty": _uncertainty(record),
        "remarks": [
            {"reason": remark.reason.value, "text": remark.text, "poses": list(remark.poses), "refused": remark.refused}
            for remark in result.remarks
        ],
    }


def _uncertainty(record: CalibrationRecord) -> list[dict[str, float | str]]:
    """Standard deviations of I and T over inclination (root mean square over toolface), calibration alone."""
    import numpy as np

    result = record.result
    tf = np.deg2rad(np.arange(0.0, 360.0, 45.0))
    rows: list[dict[str, float | str]] = []
    for inc_deg in SUMMARY_INCLINATIONS_DEG:
        inc = np.full_like(tf, np.deg2rad(inc_deg))
        source = result
        zone = result.zone_at(float(inc[0]))
        if zone is None and record.fallback is not None:
            source, zone = record.fallback, record.fallback.main
        if zone is None:
            continue
        inc_std, tf_std = source.predict_std(inc, tf, 0.0, zone=zone)
        rows.append(
            {
                "inc_deg": inc_deg,
                "inc_std_deg": float(np.rad2deg(np.sqrt(np.mean(inc_std**2)))),
                "tf_std_deg": float(np.rad2deg(np.sqrt(np.mean(tf_std**2)))),
                "zone": zone.name,
            }
        )
    return rows


def _summary_lines(s: dict[str, Any]) -> list[str]:
    options = ", ".join(f"{key} {value}" for key, value in s["options"].items())
    lines = [
        f"record    {s['id']}",
        f"tool      {s['tool']}" + (f", serial {s['serial']}" if s["serial"] else ""),
        f"made      {s['created']}, " + (f"expires {s['expires']}" if s["expires"] else "does not expire"),
        f"method    {s['method']}" + (f" ({options})" if options else "") + f"; angles referred to {s['frame']}",
        f"poses     {s['poses_used']} of {s['poses']} used, rms residual {_ug(s['rms_residual_g'])},"
        f" noise of a reading {_ug(s['reading_noise_g'])}",
    ]
    if s["signature"]:
        lines.append(f"signed    {s['signature']['time']} by {s['signature']['signer']} (see `highside keys verify`)")
    worst = s["worst_pose"]
    if worst and worst["sigmas"] > 0.0:
        lines.append(f"worst     pose {worst['pose']}, {worst['sigmas']:.1f} sigma")
    if any(s["tilt_deg"]):
        lines.append(
            f"bench     tilt {s['tilt_deg'][0]:+.4f} deg in the plane of inclination, {s['tilt_deg'][1]:+.4f} across"
        )
    lines += [
        f"zone      {zone['name']}: {zone['from_deg']:.2f} to {zone['to_deg']:.2f} deg,"
        f" condition {zone['condition']:.3g}"
        for zone in s["zones"]
    ]
    if s["fallback"]:
        lines.append(f"elsewhere {s['fallback']}")
    for closure in s["closures"]:
        again = f", measure pose {closure['worst_pose']} again" if closure["p"] < 1e-3 and closure["worst_pose"] else ""
        lines.append(
            f"closure   {closure['inc_deg']:7.3f} deg: {_ug(closure['size_g'])}, p = {closure['p']:.3g}{again}"
        )
    if s["uncertainty"]:
        lines.append("accuracy  (one standard deviation, the calibration alone)")
        lines += [
            f"          I {row['inc_deg']:5.1f} deg: I {row['inc_std_deg']:.4f}, T {row['tf_std_deg']:.4f} deg"
            f"  ({row['zone']})"
            for row in s["uncertainty"]
        ]
    lines += [f"{'refused' if remark['refused'] else 'note':<10}{remark['text']}" for remark in s["remarks"]]
    return lines


def _ug(value: float | None) -> str:
    return "not known" if value is None else f"{value * 1e6:.1f} ug"
