"""`highside calibrate verify`: an existing calibration against a few poses, or rolled at one inclination."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.options import as_options
from highside.cli.say import echo, echo_json
from highside.errors import InputError

if TYPE_CHECKING:
    from highside.calibration.poses import PoseSet
    from highside.calibration.record import CalibrationRecord
    from highside.calibration.roll_test import RollTest
    from highside.calibration.verification import Verification, VerifiedQuantity


PosesFile = Annotated[
    Path, typer.Argument(metavar="POSES", help="Pose table (CSV) of raw means, or the journal of a bench session.")
]
LimitGtotalMg = Annotated[float, typer.Option("--limit-gtotal-mg", help="Roll test: limit on the range of Gtotal, mg.")]
RollOption = Annotated[
    bool, typer.Option("--roll", help="Field roll test: no bench, at least 8 toolfaces at one inclination.")
]
TiltSigmaDeg = Annotated[
    float,
    typer.Option(help="How well the bench is level (std dev of each tilt), where the poses do not tell, deg."),
]
SameBench = Annotated[bool, typer.Option("--same-bench", help="The bench of the record: its tilt is known from there.")]
ToolfaceZeroSigmaDeg = Annotated[
    float, typer.Option(help="How well the tool is clamped in toolface (standard deviation), deg.")
]
FreeToolfaceZero = Annotated[
    bool, typer.Option("--free-toolface-zero", help="Estimate the toolface zero of this clamping, take it off.")
]


def verify(
    record_file: Annotated[Path, typer.Argument(metavar="RECORD", help="Calibration record (JSON) to be checked.")],
    poses_file: PosesFile,
    limit_inc_deg: Annotated[float, typer.Option(help="Limit on the error of I (roll test: on its range), deg.")],
    limit_tf_deg: Annotated[float | None, typer.Option(help="Limit on the error of T, deg.")] = None,
    limit_gtotal_mg: LimitGtotalMg = 2.5,
    roll: RollOption = False,
    pose_sigma_deg: Annotated[float, typer.Option(help="Standard deviation of a setting of the bench, deg.")] = 0.0052,
    tilt_sigma_deg: TiltSigmaDeg = 0.05,
    same_bench: SameBench = False,
    toolface_zero_sigma_deg: ToolfaceZeroSigmaDeg = 0.0,
    free_toolface_zero: FreeToolfaceZero = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Also write the result (JSON).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Judge a calibration at a few poses: pass, fail or undecided, with the uncertainty of the comparison in it.

    Exit 0: pass; 1: fail or undecided.
    """
    from highside.calibration.roll_test import roll_test
    from highside.calibration.verification import Conformity
    from highside.recording.calibration_store import read_record
    from highside.recording.files import write_whole

    _require_deviations(pose_sigma_deg, tilt_sigma_deg, toolface_zero_sigma_deg)
    record = read_record(record_file)
    poses = read_poses(poses_file, reference="magnitude" if roll else "pose")
    found: Verification | RollTest
    if roll:
        with as_options(limit_inc_deg="--limit-inc-deg", limit_g_total_g="--limit-gtotal-mg"):
            found = roll_test(
                record,
                poses,
                limit_inc_deg=limit_inc_deg,
                limit_g_total_g=1e-3 * limit_gtotal_mg,
                inc_sigma_deg=pose_sigma_deg,
            )
    else:
        found = _verified(
            record,
            poses,
            limits_deg=(limit_inc_deg, limit_tf_deg),
            pose_sigma_deg=pose_sigma_deg,
            tilt_sigma_deg=tilt_sigma_deg,
            same_bench=same_bench,
            toolface_zero_sigma_deg=toolface_zero_sigma_deg,
            free_toolface_zero=free_toolface_zero,
        )
    plain = found.to_dict()
    if output is not None:
        write_whole(output, (json.dumps(plain, indent=1, allow_nan=False) + "\n").encode())
    if as_json:
        echo_json(json.dumps(plain, allow_nan=False))
    else:
        echo("\n".join(lines(found)))
    if found.verdict is not Conformity.PASS:
        raise typer.Exit(1)


def _require_deviations(pose_deg: float, tilt_deg: float, toolface_zero_deg: float) -> None:
    """Raises InputError for what is no standard deviation of a bench."""
    for name, value in (
        ("--pose-sigma-deg", pose_deg),
        ("--tilt-sigma-deg", tilt_deg),
        ("--toolface-zero-sigma-deg", toolface_zero_deg),
    ):
        if not (math.isfinite(value) and 0.0 <= value < 10.0):
            raise InputError(f"{value:g} is no standard deviation of a bench", field=name, remedy="give 0 to 10 deg")


def _verified(
    record: CalibrationRecord,
    poses: PoseSet,
    *,
    limits_deg: tuple[float, float | None],
    pose_sigma_deg: float,
    tilt_sigma_deg: float,
    same_bench: bool,
    toolface_zero_sigma_deg: float,
    free_toolface_zero: bool,
) -> Verification:
    """The record at poses of known attitude. Raises InputError for options that cannot be met."""
    from highside.calibration.linear_errors import BenchAccuracy
    from highside.calibration.verification import tilt_of, verify_poses

    limit_inc_deg, limit_tf_deg = limits_deg
    if limit_tf_deg is None:
        raise InputError("is missing", field="--limit-tf-deg", remedy="give the limit on T, or --roll")
    tilt = tilt_of(record) if same_bench else None
    if same_bench and tilt is None:
        raise InputError(
            f"the method {record.result.method} of this record takes the bench as level and knows no tilt",
            field="--same-bench",
            remedy="leave it out, and state --tilt-sigma-deg",
        )
    with as_options("limit_inc_deg", "limit_tf_deg"):
        found = verify_poses(
            record,
            poses,
            limit_inc_deg=limit_inc_deg,
            limit_tf_deg=limit_tf_deg,
            bench=BenchAccuracy(math.radians(tilt_sigma_deg), math.radians(pose_sigma_deg)),
            tilt=tilt,
            toolface_zero_std_deg=toolface_zero_sigma_deg,
            free_toolface_zero=free_toolface_zero,
        )
    _require_attainable(found)
    return found


def _require_attainable(found: Verification) -> None:
    """Raises InputError for a limit that no error at all could pass; a tool that fails it fails nevertheless, and where
    poses from the other side would help the verdict says so."""
    from highside.calibration.verification import Conformity

    width = found.widest_on_a_level_bench if found.one_sided else found.widest
    if found.verdict is Conformity.UNDECIDED and width.hopeless:
        field = "--limit-inc-deg" if width.name == "I" else "--limit-tf-deg"
        raise InputError(f"no tool could pass: {width.text}", field=field)


def read_poses(path: Path, *, reference: str = "pose") -> PoseSet:
    """The poses of a table, or those that a bench session accepted. Raises InputError."""
    from highside.api.calibration import read_solver_table
    from highside.bench.journal_file import is_journal
    from highside.bench.session.journal import read_journal
    from highside.calibration.pose_table import solver_columns
    from highside.calibration.poses import PoseSet
    from highside.reading import read_bytes

    data = read_bytes(path)
    if is_journal(path, data):
        columns = read_journal(data, where=str(path)).ledger().pose_columns()
        if not columns["ax"]:
            raise InputError("no pose was accepted in this session", where=str(path))
    else:
        table = read_solver_table(path).table
        columns = solver_columns(table.columns, table.texts)
    return PoseSet.from_columns(columns, where=str(path), reference=reference)  # type: ignore[arg-type]


def lines(found: Verification | RollTest) -> list[str]:
    """What a person reads."""
    from highside.calibration.roll_test import RollTest

    if isinstance(found, RollTest):
        return [
            f"roll test at I = {found.mean_inc_deg:.3f} deg, {found.toolfaces} toolfaces",
            f"I        range {found.inc.error:.4f} deg, limit {found.inc.limit:g}: {found.inc.verdict}; harmonics "
            f"{found.inc_first_deg:.4f}, {found.inc_second_deg:.4f} deg",
            f"Gtotal   range {1e3 * found.g_total.error:.3f} mg, limit {1e3 * found.g_total.limit:g}:"
            f" {found.g_total.verdict}; harmonics {1e3 * found.g_first:.3f}, {1e3 * found.g_second:.3f} mg;"
            f" mean {found.mean_g_total:.6f}",
            found.text,
        ]
    out = ["pose       I set    T set    I error ± 2u   (limit)    T error ± 2u   (limit)"]
    out += [
        f"{pose.pose:<8} {pose.inc_ref_deg:8.3f} {pose.tf_ref_deg:8.3f}  {_cell(pose.inc)}  {_cell(pose.tf)}"
        f"  {pose.verdict}"
        for pose in found.poses
    ]
    out.append(_level(found))
    if found.toolface_zero_deg is not None:
        out.append(f"toolface zero of this clamping: {found.toolface_zero_deg:+.4f} deg, taken off")
    if not found.consistent:
        out.append("errors are larger than the record's own stated uncertainty lets expect: the sensor has changed")
    return [*out, found.text]


def _level(found: Verification) -> str:
    level = found.level
    tilts = ", ".join(
        f"{word} {math.degrees(value):+.4f} ± {math.degrees(std):.4f} deg"
        for word, value, std in (
            ("in the plane of inclination", level.x_rad, level.x_std_rad),
            ("across it", level.y_rad, level.y_std_rad),
        )
    )
    otherwise = "; it leans otherwise than was said" if found.leans else ""
    return f"level of the bench, {level.source.text}: {tilts} (1 sigma){otherwise}"


def _cell(one: VerifiedQuantity | None) -> str:
    return "-".center(26) if one is None else f"{one.error:+9.4f} ± {2 * one.std:6.4f} ({one.limit:g})".ljust(26)
