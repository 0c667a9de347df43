"""The evidence on gyro drift: every scenario over seeds, ours beside vqf, ahrs and imufusion on the same readings.

    python -m studies.drift_scenarios [--seeds 6] [--only NAME ...] [--consistency 100] [--false-stops-h 10]

Prints Markdown: drift in deg/h (mean over the last ten seconds by the hours passed, rms over seeds). Rivals (extra
`rivals`) are measured if installed; they know neither the Earth's rotation nor a starting azimuth, so their azimuth is
set to the truth at ten seconds, and the reading's axes are given as they are: all take +1 g as up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import to_angles
from highside.gyro.blocks import Batch
from highside.gyro.compiled import kernels
from highside.gyro.complementary import complementary
from highside.gyro.filter import FilterSettings
from highside.gyro.frames import to_body
from highside.gyro.gates import Gate, MotionState, quiet_rows
from highside.gyro.literal import AzimuthPolicy, literal
from highside.gyro.recording_filter import error_state_filter
from highside.papers.drift_bound import azimuth_bound
from highside.papers.drift_rivals import Rival, installed
from highside.papers.drift_scenarios import (
    LATITUDE_RAD,
    DriftData,
    DriftExperiment,
    curved_hole,
    drilling,
    record,
    rotating_rod,
    rotating_table,
    turntable,
    vibration_table,
)

Array = NDArray[np.float64]
Angles = tuple[Array, Array, Array]
"""elevation, toolface, azimuth (N,), rad"""
Method = Callable[[DriftData], Angles]

PSI0 = float(np.radians(60.0))
SETTINGS = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=PSI0)
REST: dict[str, Array] = {name: np.array([[0.0, 420.0]]) for name in ("turntable", "vibration table")}

SCENARIOS: dict[str, Callable[[], DriftExperiment]] = {
    "S1 turntable": turntable,
    "S2 vibration table": vibration_table,
    "S3 drilling": drilling,
    "S1r elevation 0": lambda: rotating_table(0.0),
    "S1r elevation 3": lambda: rotating_table(3.0),
    "S1r elevation 30": lambda: rotating_table(30.0),
    "S1r elevation 60": lambda: rotating_table(60.0),
    "S1r elevation 87": lambda: rotating_table(87.0),
    "B4.0 rotating rod": rotating_rod,
    "curved hole": curved_hole,
}


def _ours(result: Any) -> Angles:
    return result.inc_rad - 0.5 * np.pi, result.tf_rad, result.azi_rad


def _rest(data: DriftData) -> Array:
    return REST.get(data.experiment.name, data.experiment.rest)


def _kinematic(settings: FilterSettings, *, stops: str) -> Method:
    own = replace(settings, detect_stops=stops == "detected")

    def run(data: DriftData) -> Angles:
        rest = _rest(data) if stops == "declared" else None
        return _ours(error_state_filter(data.experiment.t_s, data.rate, data.accel, own, rest=rest))

    return run


def _literal(policy: AzimuthPolicy, *, average: bool = False, correct: bool = True, gate: bool = True) -> Method:
    def run(data: DriftData) -> Angles:
        e = data.experiment
        quiet = quiet_rows(e.t_s, data.rate, data.accel, np.zeros((0, 2))) if gate else None
        return _ours(
            literal(
                e.t_s,
                data.rate,
                data.accel,
                policy=policy,
                quiet=quiet,
                azimuth_rad=PSI0,
                average=average,
                correct=correct,
                start_s=10.0,
            )
        )

    return run


def _recursive(*, hold: bool) -> Method:
    def run(data: DriftData) -> Angles:
        e = data.experiment
        rest = e.rest if e.name == "drilling" else None
        return _ours(complementary(e.t_s, data.rate, data.accel, SETTINGS, hold=hold, rest=rest))

    return run


OURS: dict[str, Method] = {
    "gyro alone": _literal(AzimuthPolicy.GYRO, correct=False),
    "literal gyro": _literal(AzimuthPolicy.GYRO),
    "literal prev": _literal(AzimuthPolicy.PREV),
    "literal hold": _literal(AzimuthPolicy.HOLD),
    "literal hold, without its gate": _literal(AzimuthPolicy.HOLD, gate=False),
    "literal_block hold": _literal(AzimuthPolicy.HOLD, average=True),
    "recursive": _recursive(hold=False),
    "recursive hold": _recursive(hold=True),
    "kinematic, gravity alone": _kinematic(SETTINGS, stops="none"),
    "kinematic, rest declared": _kinematic(SETTINGS, stops="declared"),
    "kinematic, stops detected": _kinematic(SETTINGS, stops="detected"),
    "kinematic, rest declared, no scale state": _kinematic(replace(SETTINGS, scale_std=0.0), stops="declared"),
    "kinematic, rest declared, straight hole": _kinematic(
        replace(SETTINGS, straight_hole_std_rad=float(np.radians(0.1))), stops="declared"
    ),
}


def _rival(run: Rival) -> Method:
    def on(data: DriftData) -> Angles:
        rate_hz = 1.0 / float(np.median(np.diff(data.experiment.t_s)))
        return to_angles(run(rate_hz, to_body(data.rate), to_body(data.accel)))

    return on


def rivals() -> dict[str, Method]:
    """Those that are installed."""
    return {name: _rival(run) for name, run in installed().items()}


def drifts(angles: Angles, e: DriftExperiment, *, align: bool) -> Array:
    """Elevation, toolface and azimuth drift in deg/h, and the greatest azimuth error in deg."""
    theta, phi, psi = (
        wrap_signed(np.asarray(ours - true)) for ours, true in zip(angles, (e.theta, e.phi, e.psi), strict=True)
    )
    if align:
        psi = np.asarray(wrap_signed(psi - psi[int(np.searchsorted(e.t_s, 10.0))]))
    last = e.t_s >= e.t_s[-1] - 10.0
    ends = [abs(np.degrees(error[last].mean())) / e.hours for error in (theta, phi, psi)]
    return np.array([*ends, np.degrees(np.abs(psi[e.t_s >= 10.0]).max())])


def table(name: str, seeds: int, *, with_rivals: bool) -> Iterator[str]:
    """Markdown rows of one scenario."""
    experiment = SCENARIOS[name]()
    experiment_rest = REST.get(experiment.name, experiment.rest)
    free, rested = (
        float(np.degrees(azimuth_bound(experiment, rest=known)[-1])) / experiment.hours
        for known in (None, experiment_rest)
    )
    yield f"\n### {name} ({seeds} seeds; rivals seed 0)\n"
    yield f"Cramer-Rao bound of the azimuth, deg/h: {free:.3f} by gravity alone, {rested:.3f} with its rest declared.\n"
    yield "| method | theta | phi | psi (rms) | psi by seed | max psi err deg | us/row |"
    yield "|---|---|---|---|---|---|---|"
    others = rivals() if with_rivals else {}
    for method, run in {**OURS, **others}.items():
        slow = method in others or method.startswith(("literal", "gyro"))
        rows, spent = [], 0.0
        for seed in range(1 if slow else seeds):
            data = record(experiment, seed)
            began = time.perf_counter()
            angles = run(data)
            spent += time.perf_counter() - began
            rows.append(drifts(angles, experiment, align=method in others))
        each = np.array(rows)
        rms = np.sqrt(np.mean(each**2, axis=0))
        by_seed = " ".join(f"{value:.2f}" for value in each[:, 2])
        cost = 1e6 * spent / (len(rows) * experiment.t_s.size)
        ends = " | ".join(f"{value:.3f}" for value in rms[:3])
        yield f"| {method} | {ends} | {by_seed} | {each[:, 3].max():.2f} | {cost:.2f} |"


def efficiency(seeds: int) -> Iterator[str]:
    """How near the filter comes to what is possible, on seeds that nothing was tuned on."""
    cases: dict[str, tuple[DriftExperiment, Array | None]] = {
        "turning table, 0 deg": (rotating_table(0.0, rate_hz=20.0), None),
        "turning table, 30 deg": (rotating_table(30.0, rate_hz=20.0), None),
        "turning table, 60 deg": (rotating_table(60.0, rate_hz=20.0), None),
        "turntable at rest, gravity alone": (turntable(rate_hz=20.0), None),
        "turntable, 420 s of rest declared": (turntable(rate_hz=20.0), REST["turntable"]),
        "drilling, stops declared": (drilling(), drilling().rest),
        "turning rod with 200 ppm, stops declared": (rotating_rod(), drilling().rest),
    }
    yield f"\n### Azimuth drift over its Cramer-Rao bound, {seeds} seeds from 1000 on\n"
    yield "| case | bound, deg/h | rms, deg/h | ratio | stated | share of groups of six with rms <= 0.10 / 0.20 |"
    yield "|---|---|---|---|---|---|"
    for name, (experiment, rest) in cases.items():
        bound = float(np.degrees(azimuth_bound(experiment, rest=rest)[-1])) / experiment.hours
        settings = replace(SETTINGS, detect_stops=False, azimuth_std_rad=1e-5)
        ends, stated = [], 0.0
        for seed in range(seeds):
            data = record(experiment, 1000 + seed)
            result = error_state_filter(experiment.t_s, data.rate, data.accel, settings, rest=rest)
            ends.append(drifts(_ours(result), experiment, align=False)[2])
            stated = float(np.degrees(result.azi_std_rad[-1])) / experiment.hours
        rms = float(np.sqrt(np.mean(np.square(ends))))
        groups = np.sqrt(np.square(ends[: seeds // 6 * 6]).reshape(-1, 6).mean(axis=1))
        share = f"{np.mean(groups <= 0.1):.2f} / {np.mean(groups <= 0.2):.2f}"
        yield f"| {name} | {bound:.3f} | {rms:.3f} | {rms / bound:.2f} | {stated:.3f} | {share} |"


def consistency(runs: int) -> Iterator[str]:
    """Share of runs whose azimuth and biases end within three sigma; starts and latitude wrong within their priors."""
    cases: dict[str, tuple[DriftExperiment, Array | None]] = {
        "rest 120 of 900 s": (turntable(900.0, 20.0), np.array([[0.0, 120.0]])),
        "turning at 30 deg": (rotating_table(30.0, 900.0, 20.0), None),
        "curved hole": (curved_hole(rate_hz=20.0), np.array([[0.0, 300.0]])),
        "drilling": (drilling(3600.0, 20.0, leg_s=900.0), drilling(3600.0, 20.0, leg_s=900.0).rest),
    }
    yield f"\n### Within three sigma at the end, {runs} runs; azimuth wrong by 1 deg, latitude by 0.1 deg (1 sigma)\n"
    yield "| case | azimuth | each bias |"
    yield "|---|---|---|"
    for name, (experiment, rest) in cases.items():
        azimuth = bias = 0
        for seed in range(runs):
            rng = np.random.default_rng(10_000 + seed)
            settings = replace(
                SETTINGS,
                azimuth_std_rad=float(np.radians(1.0)),
                azimuth_rad=PSI0 + float(np.radians(rng.standard_normal())),
                latitude_rad=LATITUDE_RAD + float(np.radians(0.1 * rng.standard_normal())),
                detect_stops=False,
            )
            data = record(experiment, seed)
            result = error_state_filter(experiment.t_s, data.rate, data.accel, settings, rest=rest)
            error = abs(wrap_signed(float(result.azi_rad[-1] - experiment.psi[-1])))
            azimuth += error < 3 * result.azi_std_rad[-1]
            bias += bool(np.all(np.abs(result.bias_radps[:, -1] - data.bias_end) < 3 * result.bias_std_radps[:, -1]))
        yield f"| {name} | {azimuth}/{runs} | {bias}/{runs} |"


def false_stops(hours: float) -> Iterator[str]:
    """Seconds taken for a stop while the tool is shaken at levels between quiet (1 mg of noise) and drilling."""
    yield f"\n### Zero-rate verdicts in {hours:g} h of weak vibration\n"
    yield "| vibration, g rms | false, s |"
    yield "|---|---|"
    for level in (0.003, 0.004, 0.005, 0.007, 0.01, 0.02, 0.05, 0.1, 0.3):
        false = 0
        for hour in range(round(hours)):
            experiment = drilling(3600.0, 50.0, leg_s=1e6, vibration_rms_g=level)
            data = record(experiment, hour)
            gate = Gate()
            blocks = Batch.of(experiment.t_s, to_body(data.rate), to_body(data.accel)).blocks()
            verdicts = [gate.verdict(block) for block in blocks]
            false += sum(verdict is MotionState.STILL for verdict in verdicts[52:])
        yield f"| {level:g} | {false} |"


def main() -> None:
    kernels(10**9)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--only", nargs="*", choices=list(SCENARIOS), default=None)
    parser.add_argument("--no-rivals", action="store_true")
    parser.add_argument("--efficiency", type=int, default=0, metavar="SEEDS", help="rms over the bound, many seeds")
    parser.add_argument("--consistency", type=int, default=0, metavar="RUNS")
    parser.add_argument("--false-stops-h", type=float, default=0.0, metavar="HOURS")
    arguments = parser.parse_args()
    names = list(SCENARIOS) if arguments.only is None else arguments.only
    for name in names:
        for line in table(name, arguments.seeds, with_rivals=not arguments.no_rivals):
            print(line, flush=True)
    if arguments.efficiency:
        for line in efficiency(arguments.efficiency):
            print(line, flush=True)
    if arguments.consistency:
        for line in consistency(arguments.consistency):
            print(line, flush=True)
    if arguments.false_stops_h:
        for line in false_stops(arguments.false_stops_h):
            print(line, flush=True)


if __name__ == "__main__":
    main()
