"""`highside calibrate ...`: poses out of recordings, calibrations out of poses, corrected readings out of both."""

from __future__ import annotations

import json
import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli import bench, bench_sessions, certificate, iscwsa, verification
from highside.cli.loading import loading
from highside.cli.options import as_options
from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo, echo_json, report_omitted
from highside.errors import InputError, Refused

if TYPE_CHECKING:
    from highside.api.calibration import Calibration
    from highside.calibration.record import CalibrationRecord
    from highside.recording.calibration_store import CalibrationStore

app = typer.Typer(
    name="calibrate",
    no_args_is_help=True,
    help="Calibrate the accelerometers: find poses, solve, apply, and keep the records.",
)

app.command()(bench.bench)
app.command()(bench_sessions.sessions)
app.command()(verification.verify)
app.command()(certificate.certificate)
app.command()(iscwsa.iscwsa)


class Triples(StrEnum):
    """Which of the four poses at an inclination make the balance matrix."""

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
    from highside.api.calibration import poses_of
    from highside.recording.table import read_recording

    table = read_recording(recording)
    found = poses_of(table, min_s=min_s, window_s=window_s)
    found.poses.write(output)
    if as_json:
        echo_json(json.dumps({"poses": found.poses.n, "dropped": found.omitted, "output": str(output)}))
        return
    echo(f"{output}: {found.poses.n} poses, {int(found.poses['n'].sum())} of {table.n} readings")
    for line in found.omitted:
        echo(f"omitted: {line}", err=True)


Turntable = Annotated[
    Path | None, typer.Option(help="Errors of the bench's own encoder and axis (`rotation turntable`).")
]
ModelOption = Annotated[
    Path | None, typer.Option("--model", help="Model file: its bench, its laws (`diagnose --write-model`).")
]


@app.command()
def solve(
    poses_file: Annotated[Path, typer.Argument(metavar="POSES", help="Pose table (CSV).")],
    method: Annotated[str, typer.Option(help="How to solve: conventional, balance, joint or an installed one.")],
    output: Output,
    triples: Annotated[Triples, typer.Option(help="For balance: which of the four poses.")] = Triples.AVERAGE,
    reference: Annotated[Reference, typer.Option(help="Attitude of the poses known, or only |g|.")] = Reference.POSE,
    pose_sigma_deg: Annotated[float, typer.Option(help="Standard deviation of a setting of the bench, deg.")] = 0.0052,
    fallback: Annotated[str, typer.Option(help="For balance: method of the correction beyond the zones.")] = "none",
    store: Annotated[Path | None, typer.Option("--store", help="Also keep the record in this store.")] = None,
    tool: ToolOption = None,
    serial: SerialOption = None,
    bench: Annotated[str | None, typer.Option(help="Name of the bench.")] = None,
    operator: Annotated[str | None, typer.Option(help="Who measured.")] = None,
    gravity_mps2: Annotated[float | None, typer.Option(help="Local gravity at the bench, m/s2.")] = None,
    gravity_std_mps2: Annotated[float, typer.Option(help="Its standard deviation, m/s2.")] = 1e-4,
    temp_c: Annotated[float | None, typer.Option(help="Temperature, where the table has no temp_c.")] = None,
    expires_days: Annotated[float | None, typer.Option(help="Days until the record expires.")] = None,
    turntable: Turntable = None,
    model: ModelOption = None,
    effects: EffectFolders = None,
    key: Annotated[Path | None, typer.Option("--key", help="Sign the record with this key (`highside keys`).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a pose table and write a calibration record. Exit 1: something was refused (see what is said)."""
    with loading():
        from highside.api.calibration import calibrate
        from highside.calibration.methods import faults
        from highside.cli.keys import signing_key_if_any
    report_omitted("calibration method", faults())
    if model is not None:
        take_in(effects)
    private = signing_key_if_any(key)  # before the work: a key that cannot be used is known at once
    with as_options("method", "fallback", "reference", "pose_sigma_deg", "gravity_mps2", "expires_days"):
        made = calibrate(
            poses_file,
            method,
            triples=triples.value,
            reference=reference.value,
            pose_sigma_deg=pose_sigma_deg,
            fallback=fallback,
            tool=tool,
            serial=serial,
            bench=bench,
            operator=operator,
            gravity_mps2=gravity_mps2,
            gravity_std_mps2=gravity_std_mps2,
            temp_c=temp_c,
            expires_days=expires_days,
            turntable=turntable,
            model=model,
            key=private,
        )
    _keep(made, output, store)
    _show_record(made.record, as_json)
    for remark in made.refused:
        echo(f"highside: refused ({remark.reason.value}): {remark.text}", err=True)
    if made.refused:
        raise typer.Exit(1)


def _keep(made: Calibration, output: Path, store: Path | None) -> None:
    """Print the notes; write the record, and put it in a store too where one is named."""
    for note in made.notes:
        echo(note, err=True)
    made.save(output)
    if store is not None:
        from highside.recording.calibration_store import CalibrationStore

        CalibrationStore(store).add(made.record)


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
    from highside.api.calibration import Calibration

    calibration = Calibration.load(record_file)
    with as_options("noise_g"):
        data, done = calibration.corrected(
            readings,
            frame=frame.value,
            noise_g=noise_g,
            zones=zones,
            tool=tool,
            serial=serial,
            allow_expired=allow_expired,
        )
    data.write(output)
    if as_json:
        counts = {
            "zones": done.rows_by_zone,
            "outside_zone": done.outside_zone,
            "temperature_outside": done.temperature_outside,
            "law_outside_range": done.law_outside,
            "law_not_applied": done.law_not_applied,
        }
        echo_json(json.dumps({"rows": data.n, "output": str(output), "cal_id": calibration.id, **counts}))
        return
    made = ", ".join(f"{name} {count}" for name, count in done.rows_by_zone.items())
    echo(f"{output}: {data.n} rows corrected by {calibration.id[:12]} ({made or 'none'})")
    if done.outside_zone:
        echo(f"{done.outside_zone} rows lie outside of every zone and have no inclination or toolface")
    if done.temperature_outside:
        echo(f"{done.temperature_outside} rows lie outside of the calibrated temperatures: uncertainty grown")
    if done.law_outside:
        echo(f"{done.law_outside} rows lie outside of what a law was learnt in: it falls to 0 there, uncertainty grown")
    if done.law_not_applied:
        echo(
            f"{done.law_not_applied} rows lack what a law depends on: it is not applied, uncertainty grown by its size"
        )


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
    _print_entry(entry, as_json)


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
        what = f"{row['tool']:<12} {row['action']:<9} {str(row['id'])[:12] or 'nothing'}"
        echo(f"{mark} {row['number']:>4}  {row['at']}  {what}")
    if not rows:
        echo(f"nothing was put in force; {len(kept.ids())} records are kept")


@app.command()
def rollback(
    store: StoreOption,
    tool: ToolOption = None,
    trusted: TrustedOption = None,
    to_nothing: Annotated[
        bool, typer.Option("--to-nothing", help="Take the only record out of force: none is from then on.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Put the record in force that was so before the present one."""
    from highside.recording.calibration_store import CalibrationStore
    from highside.recording.keys import read_trusted_keys

    kept = CalibrationStore(store)
    keys = None if trusted is None else read_trusted_keys(trusted)
    name, now_s = _only_tool(kept, tool), time.time()
    _print_entry(
        kept.take_out(name, now_s=now_s) if to_nothing else kept.rollback(name, now_s=now_s, trusted=keys), as_json
    )


# --- records -------------------------------------------------------------------------------------------------


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


def _print_entry(entry: Any, as_json: bool) -> None:
    if as_json:
        echo_json(
            json.dumps({"number": entry.number, "action": entry.action, "tool": entry.tool_id, "id": entry.record_id})
        )
    else:
        echo(f"in force for tool {entry.tool_id}: {entry.record_id or 'nothing'}")


def _recompute(record: CalibrationRecord, as_json: bool) -> None:
    from highside.calibration.record import largest_difference, recompute

    difference = largest_difference(record, recompute(record))
    if not difference <= 1e-12:
        raise Refused(
            f"record {record.id[:12]} does not follow from its own poses: parameters differ by {difference:.3g}"
        )
    if not as_json:
        echo(f"recomputed from its {record.pose_count} poses: parameters equal within {difference:.1e}")


def _show_record(record: CalibrationRecord, as_json: bool) -> None:
    from highside.calibration.summary import summary

    known = summary(record)
    if as_json:
        echo_json(json.dumps(known))
        return
    echo("\n".join(_summary_lines(known)))


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
    lines += [
        f"law       {law['slug']}: {law['place']} {', '.join(law['channels'])}, by {', '.join(law['depends_on'])}"
        for law in s["laws"]
    ]
    if s["parent"]:
        lines.append(f"in hole   made of {s['parent'][:12]} and of what the watch saw down there")
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
