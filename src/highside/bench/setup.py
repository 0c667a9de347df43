"""From a session's configuration to its parts: plan, journal header, simulated bench."""

from __future__ import annotations

import hashlib
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from highside.bench.session import plans
from highside.bench.session.journal import Header
from highside.bench.session.turntable import at_true_settings
from highside.bench.session.verdict import require_judgeable
from highside.bench.simulated_bench import SimulatedBench
from highside.bench.simulated_operator import Habits, OperatorMistake
from highside.calibration.record import CalibrationRecord, Environment, verify
from highside.calibration.sensor_laws import AT_REST, SensorLaws
from highside.config import bench as config
from highside.config.model import load_model
from highside.config.model_bench import bench_columns, bench_of, laws_of_the_sensor, true_references
from highside.errors import InputError
from highside.link.device import DeviceSettings
from highside.link.tcp_wire import local_wire
from highside.physics.motion import still
from highside.reading import read_document
from highside.recording.calibration_store import CalibrationStore, read_record
from highside.recording.table import Table
from highside.rotation.compensation import Compensation
from highside.version import __version__


def plan_of(settings: config.BenchFile) -> plans.SessionPlan:
    """The plan that the file requests. Raises InputError for one that cannot be."""
    limits = plans.Limits(pose_sigma_deg=settings.bench.pose_sigma_deg)
    plan = _plan(settings.plan, limits)
    given = {name: value for name, value in settings.session.model_dump().items() if value is not None}
    changed = {field.name: given[field.name] for field in fields(plan.limits) if field.name in given}
    return replace(plan, limits=replace(plan.limits, **changed)) if changed else plan


def _plan(plan: config.PlanConfig, limits: plans.Limits) -> plans.SessionPlan:
    match plan:
        case config.BalancePlan():
            made = plans.balance_plan(plan.inclinations_deg, limits, triples=plan.triples)
            return replace(made, fallback=plan.fallback)
        case config.ConventionalPlan():
            return plans.conventional_plan(plan.positions, limits)
        case config.JointPlan():
            return plans.joint_plan(
                plan.poses, limits, inclinations_deg=plan.inclinations_deg, toolfaces_deg=plan.toolfaces_deg
            )
        case config.TurntablePlan():
            return plans.turntable_plan(plan.inclinations_deg, plan.stations, limits)
        case config.OvenPlan():
            return plans.soak_plan(plan.temperatures_c, plan.inclinations_deg, plan.toolfaces_deg, limits)
        case config.HeatedRollPlan():
            return plans.heated_roll_plan(plan.temperatures_c, plan.inclination_deg, plan.toolfaces_deg, limits)
        case config.CustomPlan():
            columns = _reference_columns(plan)
            return plans.custom_plan(columns, plan.method, limits, title=f"poses of {plan.file.name}")
        case config.UnguidedPlan():
            return plans.unguided_plan(min_poses=plan.min_poses)
        case config.VerificationPlan():
            # with the table turned the other way the toolfaces are set half a turn on: the attitudes are the same
            poses = [
                (inc, tf if inc >= 0 else (tf + 180.0) % 360.0)
                for inc in plan.inclinations_deg
                for tf in plan.toolfaces_deg
            ]
            return plans.verification_plan(poses, limits)
        case config.RollTestPlan():
            return plans.roll_test_plan(plan.inclination_deg, plan.toolfaces, limits)


def judged_by(settings: config.BenchFile) -> tuple[CalibrationRecord, plans.Criterion] | None:
    """The calibration that a session judges, and how; None for one that calibrates. Raises InputError, RecordError."""
    plan, tool = settings.plan, settings.tool
    if not isinstance(plan, config.VerificationPlan | config.RollTestPlan):
        return None
    if plan.record_file is not None:
        record = read_record(plan.record_file)
    else:
        store = CalibrationStore(settings.store.directory)
        record = store.active(tool.id) if plan.record == "active" else store.get(plan.record)
    # an expired calibration may be judged: that is what such a session is for
    verify(record, tool_id=tool.id, serial=tool.serial, now_s=None)
    if isinstance(plan, config.RollTestPlan):
        return record, plans.Criterion(record.id, plan.limit_inc_deg, limit_g_total_g=1e-3 * plan.limit_gtotal_mg)
    criterion = plans.Criterion(
        record.id,
        plan.limit_inc_deg,
        plan.limit_tf_deg,
        tilt_sigma_deg=plan.tilt_sigma_deg,
        same_bench=plan.same_bench,
        toolface_zero_sigma_deg=plan.toolface_zero_sigma_deg,
        free_toolface_zero=plan.free_toolface_zero,
    )
    require_judgeable(record, plan_of(settings), criterion)
    return record, criterion


class _PosesToSet(Table):
    """A table of poses to set: only the bench's settings are requested."""

    mandatory = ("inc_ref_deg", "tf_ref_deg")
    known = ("inc_ref_deg", "tf_ref_deg")
    rows_are = "poses"


def _reference_columns(plan: config.CustomPlan) -> list[tuple[float, float]]:
    table = _PosesToSet.read(plan.file)
    inc, tf = table.complete("inc_ref_deg", "tf_ref_deg")
    return list(zip(inc.tolist(), tf.tolist(), strict=True))


def turntable_path(settings: config.BenchFile) -> Path:
    """Where the fit of the bench's turntable is kept. Raises InputError for a bench without a name."""
    bench = settings.bench
    if bench.turntable is not None:
        return bench.turntable
    if bench.name is None:
        raise InputError(
            "is missing: the fit of a turntable is kept under the name of its bench",
            field="bench.name",
            remedy="name the bench, or give bench.turntable = FILE",
        )
    slug = re.sub(r"[^A-Za-z0-9._-]+", "-", bench.name).strip("-.") or "bench"
    return settings.store.directory / "turntables" / f"{slug}.json"


def turntable_of(settings: config.BenchFile) -> Compensation | None:
    """The fit of the bench's turntable, if there is one and it is to be used. Raises InputError, Refused."""
    bench = settings.bench
    if not bench.use_turntable or (bench.name is None and bench.turntable is None):
        return None
    path = turntable_path(settings)
    if not path.exists():
        if bench.turntable is None:
            return None
        raise InputError(
            "no such file", where=str(path), field="bench.turntable", remedy="run a plan `turntable` first"
        )
    return Compensation.from_json(read_document(path), where=str(path))


def by_model(plan: plans.SessionPlan, path: Path) -> plans.SessionPlan:
    """The plan with where a model says that the bench truly stands, and with its laws of the sensor.

    Raises InputError for a model that says neither, and for laws that depend on what a session does not measure.
    """
    knows = load_model(path)
    laws, bench = laws_of_the_sensor(knows, str(path)), bench_of(knows)
    for name in (*SensorLaws(laws).columns, *bench_columns(bench)):
        if name not in AT_REST and not (name == "temp_c" and name not in bench_columns(bench)):
            raise InputError(
                f"a law of this model depends on {name}, which a bench session does not tell",
                where=str(path),
                field="laws",
                remedy="leave that law out, or use `calibrate solve` with a table that has the column",
            )
    if not laws and not bench.effects:
        raise InputError("knows no effect of the bench, and no law", where=str(path), field="effects.included")
    if bench.effects and plan.reference == "pose" and plan.poses:
        inc, tf = (np.array(values) for values in zip(*(pose.reference for pose in plan.poses), strict=True))
        true = true_references(bench, {"inc_ref_deg": inc, "tf_ref_deg": tf})
        settings = zip(plan.poses, *(values.tolist() for values in true), strict=True)
        plan = replace(plan, poses=tuple(replace(p, true_inc_deg=i, true_tf_deg=t) for p, i, t in settings))
    return replace(plan, laws=laws)


def header_of(settings: config.BenchFile, name: str, t_wall_s: float, operator: str | None) -> Header:
    """The first line of a new journal."""
    bench, judged, plan = settings.bench, judged_by(settings), plan_of(settings)
    table = None
    if plan.kind is plans.SessionKind.TURNTABLE:
        turntable_path(settings)  # it has to be kept somewhere: better refused now than after seventy poses
    else:
        table = turntable_of(settings)
    if table is not None and plan.reference == "pose" and plan.poses:
        plan = at_true_settings(plan, table)
    ids = [] if table is None else [table.id]
    if bench.model is not None and judged is None:
        plan = by_model(plan, bench.model)
        ids.append("model:" + hashlib.sha256(read_document(bench.model)).hexdigest())
    return Header(
        session=name,
        tool_id=settings.tool.id,
        serial=settings.tool.serial,
        plan=plan if judged is None else replace(plan, criterion=judged[1]),
        environment=Environment(
            bench.name,
            operator,
            bench.temp_c,
            bench.gravity_mps2,
            None if bench.gravity_mps2 is None else bench.gravity_std_mps2,
            " ".join(ids) or None,
        ),
        expires_days=settings.store.expires_days,
        software=__version__,
        t_wall_s=t_wall_s,
        judged=None if judged is None else judged[0],
    )


def simulated_bench(table: config.SimulatedTable, *, attempt: int = 0) -> SimulatedBench:
    """The bench of `[simulated]`. `attempt` counts the times a session was gone on with: its noise is not repeated."""
    device = DeviceSettings(
        rate_hz=table.rate_hz,
        motion=still(12.0, 20.0),
        matrix=table.matrix,
        offset_g=table.offset_g,
        noise_density_g=table.noise_density_g,
        temp_c=table.temp_c,
        seed=table.seed + 1_000_003 * attempt,
        speed=table.speed,
    )
    return SimulatedBench(device, table, local_wire())


def habits_of(table: config.SimulatedTable) -> Habits:
    """The operator of `--auto`. Raises InputError for a mistake that nobody makes."""
    found = []
    for number, name in table.mistakes.items():
        try:
            found.append((int(number), OperatorMistake(name)))
        except ValueError:
            raise InputError(
                f"{number} = {name!r}",
                field="simulated.mistakes",
                remedy=f"a number of a pose and one of {', '.join(OperatorMistake)}",
            ) from None
    return Habits(mistakes=tuple(found), seed=table.seed)
