"""Calibration methods judged against the truth: the reference scenario, a few hundred simulated instruments.

Every instrument is calibrated on its bench by every method, and then read at known attitudes that no bench touches. The
error of inclination and toolface is compared with the Cramer-Rao total: reading noise and the best that the calibration
poses allow, pose errors of the bench included. Run it by itself (a few minutes at 200 instruments):

    python -m studies.calibration_montecarlo --sensors 200 [--only KIND] [--first-seed N] [--json FILE]
                                             [--workers 0 --parts DIR]

The result is Markdown on standard output. imucal (extra `rivals`) is measured beside ours if it is installed.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.advice import bound_of_angles, plan_information
from highside.calibration.balance import balance
from highside.calibration.conventional import conventional, least_squares, position_plan
from highside.calibration.forward import BASE_NAMES, GROUPS, Variances
from highside.calibration.joint import joint
from highside.calibration.magnitude import magnitude
from highside.calibration.poses import PoseSet
from highside.calibration.result import CalibrationResult
from highside.calibration.sensor import SensorModel
from highside.physics.gravity import gravity_direction
from highside.physics.plan import BALANCE_TOOLFACES_DEG, PUBLISHED_INCLINATIONS_DEG, pose_grid
from studies import over_seeds
from studies.scenario import PoseData, Scenario, reference_scenario

INCLINATIONS = np.deg2rad(np.array(PUBLISHED_INCLINATIONS_DEG))
ASCENDING = np.sort(INCLINATIONS)
TOOLFACES = np.deg2rad(np.arange(2.5, 360.0, 5.0))
NEARLY_VERTICAL = np.deg2rad(np.array([0.02, 0.1]))


def _wide_plan() -> tuple[Array, Array]:
    """138 poses: eleven inclinations times twelve toolfaces, and six beyond horizontal."""
    inc, tf = pose_grid(PUBLISHED_INCLINATIONS_DEG, [15.0 + 30.0 * k for k in range(12)])
    beyond, around = pose_grid([120.0, 150.0], [45.0, 165.0, 285.0])
    return np.append(inc, beyond), np.append(tf, around)


@dataclass(frozen=True)
class Kind:
    """A kind of session: how the instruments and benches are drawn, and what the joint estimator has to find."""

    name: str
    scenario: Mapping[str, Any]
    variances: Variances
    groups: tuple[str, ...] = ()
    plan: Callable[[], tuple[Array, Array]] = lambda: pose_grid(PUBLISHED_INCLINATIONS_DEG, BALANCE_TOOLFACES_DEG)

    @property
    def names(self) -> tuple[str, ...]:
        return BASE_NAMES + tuple(name for group in self.groups for name in GROUPS[group])


_POSE = float(np.deg2rad(0.009) ** 2 / 3.0)
_INDEPENDENT = Variances(_POSE, _POSE, 0.0, 0.0)
_COMMON = Variances(1e-18, 1e-18, _POSE, _POSE)
_COMMON_BENCH = {"pose_error_deg": 0.0, "inc_station_error_deg": 0.009, "tf_station_error_deg": 0.009}
_NONLINEAR = {"nonlinearity_g": 2e-3}
_TERMS = ("quadratic", "cubic", "cross")

KINDS = {
    kind.name: kind
    for kind in (
        Kind("independent", {}, _INDEPENDENT),
        Kind("common", _COMMON_BENCH, _COMMON),
        Kind("nonlinear", _NONLINEAR, _INDEPENDENT, _TERMS, _wide_plan),
        Kind("nonlinear-common", _NONLINEAR | _COMMON_BENCH, _COMMON, _TERMS, _wide_plan),
    )
}


@dataclass
class Study:
    """What came out for one kind. Arrays over the eleven inclinations, ascending; rms in rad."""

    kind: str
    sensors: int
    ratio_inc: Array
    ratio_tf: Array
    rms_inc: Array
    rms_tf: Array
    limit_tf: Array
    """toolface limit of a perfect calibration: reading noise alone"""
    coverage_inc: Array
    coverage_tf: Array
    coverage_std: tuple[float, float]
    """standard deviation of a share, the largest over inclinations: readings of one sensor share its calibration"""
    coverage_vertical: tuple[float, float]
    """of I and T over nearly vertical attitudes"""
    methods: dict[str, tuple[float, float, float]]
    """rms of I over all inclinations, of T at 0.612 and at 45 deg, in deg"""
    admitted: dict[str, int]
    remarks: dict[str, int]
    joint_ms: float
    closure_p: Array = field(default_factory=lambda: np.zeros(0))


def pose_set(data: PoseData) -> PoseSet:
    """A measured pose table of the simulation as the solver takes it."""
    return PoseSet.build(
        data.mean, inc_ref_rad=data.inc_ref, tf_ref_rad=data.tf_ref, n=data.n.astype(float), std=data.std
    )


def angles(g: Array) -> tuple[Array, Array]:
    """I and T (rad) of gravity vectors (3, ...)."""
    return np.arctan2(np.hypot(g[0], g[1]), g[2]), np.arctan2(g[1], g[0])


def wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi


CELLS = (ASCENDING.size, TOOLFACES.size)


def judged(kind: Kind, seed: int, *, rivals: bool, solve: Callable[[PoseSet], CalibrationResult]) -> dict[str, Any]:
    """One instrument, calibrated and read at known attitudes. Of I and T, over inclinations: mean squares of the errors
    of ours and of every other method (2, inclinations), and the shares that lie in their intervals."""
    inc, tf = (x.ravel() for x in np.meshgrid(ASCENDING, TOOLFACES, indexing="ij"))
    steep, around = (x.ravel() for x in np.meshgrid(NEARLY_VERTICAL, TOOLFACES, indexing="ij"))
    scenario = reference_scenario(seed, poses_rad=kind.plan(), **kind.scenario)
    rng = np.random.default_rng([seed, 99])
    poses = pose_set(scenario.poses)
    started = time.process_time()
    result = solve(poses)
    spent = time.process_time() - started
    noisy = scenario.read(inc, tf, rng)
    error = _errors(result.correct(noisy), inc, tf)
    inside = _within(error, result.predict_std(inc, tf, scenario.reading_sigma_g))
    v_error = _errors(result.correct(scenario.read(steep, around, rng)), steep, around)
    vertical = _within(v_error, result.predict_std(steep, around, scenario.reading_sigma_g))
    squares = {"ours": _mean_squares(error)}
    if rivals:
        for name, corrected in _rivals(scenario, poses, noisy, inc, rng).items():
            squares[name] = _mean_squares(_errors(corrected, inc, tf))
        squares["joint with tilt"] = squares["ours"]
        ideal = gravity_direction(inc, tf) + scenario.reading_sigma_g * rng.standard_normal((3, inc.size))
        squares["limit: perfect calibration"] = _mean_squares(_errors(ideal, inc, tf))
    return {
        "squares": squares,
        "inside": inside.reshape(2, *CELLS).mean(axis=2),
        "vertical": vertical.mean(axis=1),
        "admitted": str(result.options["admitted"]),
        "remarks": [remark.reason.value for remark in result.remarks],
        "closures": [closure.p for closure in result.closures],
        "spent_s": spent,
    }


def _within(error: tuple[Array, Array], std: tuple[Array, Array]) -> NDArray[np.bool_]:
    """(2, N) whether I and T lie in their intervals of 95 %."""
    return np.stack([np.abs(one) <= 1.96 * of for one, of in zip(error, std, strict=True)])


def _mean_squares(error: tuple[Array, Array]) -> Array:
    """(2, inclinations) over toolfaces."""
    return np.asarray(np.mean(np.stack(error).reshape(2, *CELLS) ** 2, axis=2))


def one_sensor(kind: str, seed: int, rivals: bool) -> dict[str, Any]:
    """As `judged`, of a kind by its name."""
    return judged(KINDS[kind], seed, rivals=rivals, solve=joint)


def run(
    kind: Kind,
    sensors: int,
    *,
    rivals: bool = True,
    first_seed: int = 0,
    solve: Callable[[PoseSet], CalibrationResult] = joint,
    over: over_seeds.Over | None = None,
) -> Study:
    """Calibrate and judge `sensors` instruments; `over`: by what, where they are calibrated by `joint`."""
    seeds = range(first_seed, first_seed + sensors)
    if over is None:
        found = [judged(kind, seed, rivals=rivals, solve=solve) for seed in seeds]
    else:
        found = over(one_sensor, [(kind.name, seed, rivals) for seed in seeds])
    squares = {name: np.mean([one["squares"][name] for one in found], axis=0) for name in found[0]["squares"]}
    (rms_inc, rms_tf), best, reading_g = np.sqrt(squares.pop("ours")), *_bound(kind, seeds[-1])
    by_sensor = np.array([one["inside"] for one in found])
    scatter = by_sensor.std(axis=0, ddof=1).max(axis=1) / np.sqrt(sensors)
    vertical = np.mean([one["vertical"] for one in found], axis=0)
    middle = int(np.argmin(np.abs(ASCENDING - np.deg2rad(45.0))))
    methods = {}
    for name, total in squares.items():
        deg = np.rad2deg(np.sqrt(total))
        methods[name] = (float(np.rad2deg(np.sqrt(np.nanmean(total[0])))), float(deg[1, 0]), float(deg[1, middle]))
    inside_inc, inside_tf = by_sensor.mean(axis=0)
    return Study(
        kind=kind.name,
        sensors=sensors,
        ratio_inc=rms_inc / best[0],
        ratio_tf=rms_tf / best[1],
        rms_inc=rms_inc,
        rms_tf=rms_tf,
        limit_tf=reading_g / np.sin(ASCENDING),
        coverage_inc=inside_inc,
        coverage_tf=inside_tf,
        coverage_std=(float(scatter[0]), float(scatter[1])),
        coverage_vertical=(float(vertical[0]), float(vertical[1])),
        methods=methods,
        admitted=dict(Counter(one["admitted"] for one in found)),
        remarks=dict(Counter(remark for one in found for remark in one["remarks"])),
        joint_ms=1e3 * float(np.median([one["spent_s"] for one in found])),
        closure_p=np.array([p for one in found for p in one["closures"]]),
    )


def _bound(kind: Kind, seed: int) -> tuple[Array, float]:
    """(2, inclinations) the Cramer-Rao total of I and T, rms over toolfaces, and the noise of a reading, g."""
    inc, tf = (x.ravel() for x in np.meshgrid(ASCENDING, TOOLFACES, indexing="ij"))
    plan = kind.plan()
    scenario = reference_scenario(seed, poses_rad=plan, **kind.scenario)
    F = plan_information(
        *plan, names=kind.names, noise_g=scenario.pose_sigma_g, variances=kind.variances, with_prior=False
    )
    bounds = bound_of_angles(np.linalg.inv(F), kind.names, inc, tf, noise_g=scenario.reading_sigma_g)
    return np.sqrt(_mean_squares(bounds)), scenario.reading_sigma_g


def _errors(g: Array, inc: Array, tf: Array) -> tuple[Array, Array]:
    found_inc, found_tf = angles(g)
    return found_inc - inc, wrapped(found_tf - tf)


def _rivals(
    scenario: Scenario, poses: PoseSet, reading: Array, inc: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """The readings corrected by every other method."""
    three = conventional(pose_set(scenario.measure(*position_plan(3), rng)))
    six = pose_set(scenario.measure(*position_plan(6), rng))
    many = pose_set(scenario.measure(*position_plan(24), rng))
    out = {
        "conventional, 3 positions": three.correct(reading),
        "conventional, 6 positions": conventional(six).correct(reading),
        "|g| alone, 24 positions, aligned afterwards": _aligned(many).correct(reading),
        "plain 12-parameter least squares, the same poses": least_squares(poses).correct(reading),
        "balance, a matrix a zone (without 90 deg)": _by_zone(balance(poses), reading, inc),
    }
    rival = _imucal(six, reading)
    if rival is not None:
        out["imucal 2.6, six positions"] = rival
    return out


def _by_zone(result: CalibrationResult, reading: Array, inc: Array) -> Array:
    """Each inclination corrected by its own matrix; no value where there is none (90 deg)."""
    out = np.full_like(reading, np.nan)
    for value in np.unique(inc):
        zone = result.zone_at(float(value))
        if zone is not None:
            at = inc == value
            out[:, at] = result.correct(reading[:, at], zone=zone)
    return out


def _aligned(poses: PoseSet) -> SensorModel:
    """Calibrated by |g| alone, then turned as a whole to the attitudes of the bench (orthogonal Procrustes)."""
    model = magnitude(poses).main.model()
    U, _, Vt = np.linalg.svd(gravity_direction(*poses.reference()) @ model.correct(poses.a).T)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return SensorModel(model.A @ R.T, model.b)


def _imucal(six: PoseSet, reading: Array) -> Array | None:
    """The readings corrected by imucal's Ferraris calibration from the same six positions (its gyro part is fed zeros
    and a clean turn about each axis)."""
    try:
        from imucal import FerrarisCalibration, FerrarisSignalRegions
    except ImportError:
        return None
    acc = {name: six.a[:, [k]].T for k, name in enumerate(("x_p", "y_p", "z_p", "x_a", "y_a", "z_a"))}
    still = np.full((10, 3), 1e-6)
    turn = {axis: np.eye(3)[k] * np.full((100, 1), -360.0) for k, axis in enumerate("xyz")}
    regions = FerrarisSignalRegions(
        **{f"acc_{name}": value for name, value in acc.items()},
        **{f"gyr_{name}": still for name in acc},
        **{f"acc_{axis}_rot": np.tile(acc[f"{axis}_a"], (100, 1)) for axis in "xyz"},
        **{f"gyr_{axis}_rot": value for axis, value in turn.items()},
    )
    found = FerrarisCalibration().compute(regions, 100.0, from_acc_unit="g", from_gyr_unit="deg/s")
    corrected, _ = found.calibrate(reading.T, np.zeros_like(reading.T), acc_unit="g", gyr_unit="deg/s")
    return np.asarray(corrected).T


def to_markdown(studies: list[Study]) -> str:
    lines: list[str] = []
    for study in studies:
        lines += [f"## {study.kind}: {study.sensors} instruments", ""]
        if study.methods:
            lines += ["| method | I, deg rms | T at 0.612, deg rms | T at 45, deg rms |", "|---|---|---|---|"]
            ordered = sorted(study.methods.items(), key=lambda item: -item[1][0])
            lines += [f"| {name} | {v[0]:.4f} | {v[1]:.3f} | {v[2]:.4f} |" for name, v in ordered]
            lines.append("")
        lines += [
            "| inclination, deg | I rms | I / bound | T rms | T / bound | T / limit | I in 95 % | T in 95 % |",
            "|---|---|---|---|---|---|---|---|",
        ]
        for k, value in enumerate(np.rad2deg(ASCENDING)):
            lines.append(
                f"| {value:.3f} | {np.rad2deg(study.rms_inc[k]):.5f} | {study.ratio_inc[k]:.3f} "
                f"| {np.rad2deg(study.rms_tf[k]):.5f} | {study.ratio_tf[k]:.3f} "
                f"| {study.rms_tf[k] / study.limit_tf[k]:.3f} "
                f"| {100 * study.coverage_inc[k]:.1f} | {100 * study.coverage_tf[k]:.1f} |"
            )
        lines += [
            "",
            f"Two standard deviations of a share: I {200 * study.coverage_std[0]:.1f} %, "
            f"T {200 * study.coverage_std[1]:.1f} % at most. "
            f"Nearly vertical (0.02 and 0.1 deg): I in 95 % {100 * study.coverage_vertical[0]:.1f}, "
            f"T {100 * study.coverage_vertical[1]:.1f}. Median solve {study.joint_ms:.1f} ms of CPU time. "
            f"Terms admitted: {study.admitted}. Remarks: {study.remarks or 'none'}. "
            f"Closures below p = 0.01: {100 * float(np.mean(study.closure_p < 0.01)):.2f} %.",
            "",
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="calibration methods judged against the truth")
    parser.add_argument("--sensors", type=int, default=200)
    parser.add_argument("--only", choices=sorted(KINDS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--first-seed", type=int, default=0, help="sensors of another number are other sensors")
    over_seeds.add_options(parser)
    chosen = parser.parse_args()
    over = over_seeds.chosen(chosen, seconds=0.1)
    kinds = [KINDS[chosen.only]] if chosen.only else list(KINDS.values())
    studies = [run(kind, chosen.sensors, first_seed=chosen.first_seed, over=over) for kind in kinds]
    print(to_markdown(studies))
    if chosen.json:
        plain = [
            {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in vars(study).items()}
            for study in studies
        ]
        chosen.json.write_text(json.dumps(plain, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
