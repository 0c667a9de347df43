"""`highside reproduce drift`: the gravity-quaternion paper's three experiments, simulated, and every method on them.

The paper's figures stand beside ours and are never asserted: its attitude, sensors, vibration and stop lengths are not
published. The drifts *before* correction are matched by construction (the constant biases were chosen for that), the
drifts *after* are what the methods do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import to_angles, to_body
from highside.gyro.complementary import complementary
from highside.gyro.filter import FilterSettings
from highside.gyro.gates import quiet_rows
from highside.gyro.literal import AzimuthPolicy, literal
from highside.gyro.recording_filter import error_state_filter
from highside.gyro.result import DriftResult
from highside.papers.drift_bound import azimuth_bound
from highside.papers.drift_rivals import Rival, installed, missing
from highside.papers.drift_scenarios import (
    LATITUDE_RAD,
    DriftData,
    DriftExperiment,
    curved_hole,
    drilling,
    record,
    turntable,
    vibration_table,
)
from highside.papers.drift_sweep import ELEVATIONS_DEG, WHY, Point, sweep

SEED = 2
_PLOTTED = 1500
"""points of a line in a plot"""
_REST_S = 420.0
_ALIGNED_S = 10.0
"""when the azimuth of filters that begin with none is set to the truth"""
_SLOW_HZ = 10.0
_SLOW = "ahrs"
"""takes 0.2 ms a row: its readings are averaged to `_SLOW_HZ`"""

PAPER: dict[str, dict[str, tuple[float, float | None] | None]] = {
    "turntable": {"inc": (9.35, 0.17), "tf": (9.35, 0.19), "azi": (9.96, 0.28)},
    "vibration table": {"inc": (11.14, 0.24), "tf": (10.09, 0.42), "azi": (12.63, 0.38)},
    "drilling": {"inc": (11.15, 0.22), "tf": None, "azi": (10.18, 0.46)},
}
"""deg/h, before and after"""

ASSUMPTIONS = (
    "The attitude of the turntable run, the latitude (35.2 deg), the vibration spectrum (white), the rectification, "
    "the length of a stop (120 s) and all sensor errors are ours; the paper does not state them.",
    "The constant gyro biases were chosen so that the gyro alone ends at the paper's drift before correction: these "
    "columns agree by construction and prove nothing.",
    "A drift is the mean error over the last ten seconds divided by the hours passed; one seed, so a figure may be "
    "off by its random walk (0.1 deg/h in the first, 0.2 deg/h in the third experiment).",
    "Gravity does not show a rotation about the vertical. The paper's azimuth figures therefore need something else: a "
    "constraint (the azimuth did not change), a rest at which the gyros are measured, or a tool that turns.",
    "Inclination and toolface end no better than the accelerometer bias allows (3.2 mg: 0.18 deg), by any method.",
    "vqf, imufusion and ahrs know neither the Earth's rotation nor an azimuth at the start: theirs is set to the truth "
    "at ten seconds. ahrs, which takes 0.2 ms a row, is given the readings averaged to 10 Hz.",
    "The least azimuth error that any method can have without a constraint, on average over many runs, is the "
    "Cramer-Rao bound of the experiment; one run may fall on either side of it.",
    "The literal algorithm has the paper's gate: where the readings vibrate the gyro alone carries the attitude, where "
    "they are quiet, and at every stop, gravity shows the drift. The gate works on the data, as `highside drift` does, "
    "and knows nothing of the simulation. Between stops the algorithm holds its last drift estimate, which is one "
    "sample of differentiated accelerometer noise; literal_block holds the average over the stop.",
    "On the vibration table the tool never stands quietly, so that behind its gate the algorithm has no gravity and no "
    "drift estimate: it ends where the gyro alone ends. The paper's figures there need gravity to be believed in the "
    "vibration ('without its gate'), which is right only as long as vibration averages out and rectifies nothing.",
)


@dataclass(frozen=True, slots=True)
class MethodRow:
    """One method on one experiment; drifts in deg/h, errors in deg."""

    method: str
    inc_dph: float
    tf_dph: float
    azi_dph: float
    azi_max_deg: float
    azi_std_deg: float | None
    basis: str
    ours: bool
    t_s: Array
    azi_error_deg: Array
    inc_error_deg: Array


@dataclass(frozen=True, slots=True)
class ExperimentResult:
    """One experiment and its rows, the gyro alone first."""

    experiment: DriftExperiment
    rows: tuple[MethodRow, ...]
    bound_dph: float
    """Cramer-Rao bound of the azimuth's drift with the rest declared as in the rows, deg/h"""


@dataclass(frozen=True, slots=True)
class Study:
    """Everything that the page tells."""

    results: tuple[ExperimentResult, ...]
    sweep: tuple[Point, ...]
    curved: tuple[MethodRow, ...]
    missing: tuple[str, ...]
    """packages of others that are not installed"""


def run_study(shorten: float = 1.0, seed: int = SEED) -> Study:
    """All of it; `shorten` < 1 cuts the durations (for checks of the page, not of the figures)."""
    elevations = ELEVATIONS_DEG if shorten == 1.0 else (0.0, 60.0, 87.0)
    points = sweep(6 if shorten == 1.0 else 1, 3600.0 * shorten, elevations)
    return Study(run_experiments(shorten, seed), tuple(points), _curved(seed, shorten), missing())


def _curved(seed: int, shorten: float) -> tuple[MethodRow, ...]:
    """A hole that turns by 5 deg: what the constraints make of it."""
    experiment = curved_hole(rate_hz=50.0, start_s=300.0 * shorten, seconds=600.0 * shorten)
    data = record(experiment, seed)
    t, w, a, psi0 = experiment.t_s, data.rate, data.accel, float(experiment.psi[0])
    settings = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=psi0)
    straight = replace(settings, straight_hole_std_rad=math.radians(0.1))
    rest = experiment.rest
    results = {
        "literal, policy prev": literal(t, w, a, policy=AzimuthPolicy.PREV, azimuth_rad=psi0, start_s=10.0),
        "literal, policy hold": literal(t, w, a, policy=AzimuthPolicy.HOLD, azimuth_rad=psi0, start_s=10.0),
        "recursive, straight hole": complementary(t, w, a, settings, hold=True),
        "kinematic, rest declared, straight hole": error_state_filter(t, w, a, straight, rest=rest),
        "kinematic, rest declared": error_state_filter(t, w, a, settings, rest=rest),
        "kinematic, stops detected": error_state_filter(t, w, a, settings),
    }
    return tuple(_row(name, result, data) for name, result in results.items())


def run_experiments(shorten: float = 1.0, seed: int = SEED) -> tuple[ExperimentResult, ...]:
    """The paper's three experiments."""
    experiments = (
        turntable(3600.0 * shorten),
        vibration_table(3600.0 * shorten),
        drilling(
            10800.0 * shorten,
            start_s=max(50.0 * shorten, 10.0),
            leg_s=1800.0 * shorten,
            stop_s=max(120.0 * shorten, 5.0),
        ),
    )
    return tuple(_result_of(experiment, seed, shorten) for experiment in experiments)


def _result_of(experiment: DriftExperiment, seed: int, shorten: float) -> ExperimentResult:
    data = record(experiment, seed)
    psi0 = float(experiment.psi[0])
    settings = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=psi0, detect_stops=False)
    gated = experiment.name == "drilling"
    stops = experiment.rest if gated else None
    rest = experiment.rest if gated else np.array([[0.0, _REST_S * shorten]])
    t, w, a = experiment.t_s, data.rate, data.accel
    quiet, _ = quiet_rows(t, w, a, np.zeros((0, 2)))

    def by_letter(
        policy: AzimuthPolicy, *, average: bool = False, correct: bool = True, gate: bool = True
    ) -> DriftResult:
        return literal(
            t,
            w,
            a,
            policy=policy,
            quiet=quiet if gate else None,
            azimuth_rad=psi0,
            average=average,
            correct=correct,
            start_s=10.0,
        )

    named: list[tuple[str, Callable[[], DriftResult]]] = [
        ("gyro alone", lambda: by_letter(AzimuthPolicy.GYRO, correct=False)),
        ("literal, policy gyro", lambda: by_letter(AzimuthPolicy.GYRO)),
        ("literal, policy prev", lambda: by_letter(AzimuthPolicy.PREV)),
        ("literal, policy hold", lambda: by_letter(AzimuthPolicy.HOLD)),
    ]
    if gated:
        named.append(("literal_block, policy hold", lambda: by_letter(AzimuthPolicy.HOLD, average=True)))
    if not quiet.all():
        named.append(("literal, policy hold, without its gate", lambda: by_letter(AzimuthPolicy.HOLD, gate=False)))
    straight = replace(settings, straight_hole_std_rad=math.radians(0.1))
    when = "at the stops" if gated else f"for the first {_REST_S * shorten:g} s"
    named += [
        ("recursive, gravity alone", lambda: complementary(t, w, a, settings, rest=stops)),
        ("recursive, straight hole", lambda: complementary(t, w, a, settings, hold=True, rest=stops)),
        ("kinematic, gravity alone", lambda: error_state_filter(t, w, a, settings)),
        (f"kinematic, rest declared {when}", lambda: error_state_filter(t, w, a, settings, rest=rest)),
        (f"kinematic, rest {when}, straight hole", lambda: error_state_filter(t, w, a, straight, rest=rest)),
    ]
    if gated:
        found = replace(settings, detect_stops=True)
        named.append(("kinematic, stops detected", lambda: error_state_filter(t, w, a, found)))
    rows = [_row(name, make(), data) for name, make in named]
    rows += [_other_filter_row(name, run, data) for name, run in installed().items()]
    bound = float(np.degrees(azimuth_bound(experiment, rest=rest)[-1])) / experiment.hours
    return ExperimentResult(experiment, tuple(rows), bound)


def _other_filter_row(name: str, run: Rival, data: DriftData) -> MethodRow:
    """Another filter on the same readings."""
    e, rate_hz = data.experiment, 1.0 / float(np.median(np.diff(data.experiment.t_s)))
    rates, readings, t = to_body(data.rate), to_body(data.accel), e.t_s
    n = round(rate_hz / _SLOW_HZ) if name.startswith(_SLOW) else 1
    if n > 1:
        whole = t.size // n * n
        rates, readings = (x[:, :whole].reshape(3, -1, n).mean(axis=2) for x in (rates, readings))
        t = t[n - 1 : whole : n]
    theta, phi, psi = to_angles(run(rate_hz / n, rates, readings))
    at = np.clip(np.searchsorted(e.t_s, t), 0, e.t_s.size - 1)
    azi = np.degrees(wrap_signed(psi - e.psi[at]))
    azi = np.asarray(wrap_signed(azi - azi[int(np.searchsorted(t, _ALIGNED_S))], 360.0))
    azi = np.where(t < _ALIGNED_S, 0.0, azi)
    inc, tf = np.degrees(theta - e.theta[at]), np.degrees(wrap_signed(phi - e.phi[at]))
    return _method_row(name, t, inc, tf, azi, math.nan, "not stated", e, ours=False)


def _row(name: str, result: DriftResult, data: DriftData) -> MethodRow:
    e = data.experiment
    inc = np.degrees(result.inc_rad - (e.theta + 0.5 * np.pi))
    tf = np.degrees(wrap_signed(result.tf_rad - e.phi))
    azi = np.degrees(wrap_signed(result.azi_rad - e.psi))
    std = float(np.degrees(result.azi_std_rad[-1]))
    return _method_row(name, e.t_s, inc, tf, azi, std, result.basis_words, e, ours=True)


def _method_row(
    name: str,
    t: Array,
    inc: Array,
    tf: Array,
    azi: Array,
    std: float,
    basis: str,
    e: DriftExperiment,
    *,
    ours: bool,
) -> MethodRow:
    last = t >= t[-1] - 10.0
    every = slice(None, None, max(1, t.size // _PLOTTED))
    return MethodRow(
        method=name,
        inc_dph=float(abs(inc[last].mean()) / e.hours),
        tf_dph=float(abs(tf[last].mean()) / e.hours),
        azi_dph=float(abs(azi[last].mean()) / e.hours),
        azi_max_deg=float(np.abs(azi).max()),
        azi_std_deg=std if math.isfinite(std) else None,
        basis=basis,
        ours=ours,
        t_s=t[every],
        azi_error_deg=azi[every],
        inc_error_deg=inc[every],
    )


def as_dict(study: Study) -> dict[str, Any]:
    """Everything but the lines of the plots, ready for JSON."""
    return {
        "schema": "highside.reproduce-drift/2",
        "assumptions": list(ASSUMPTIONS),
        "not_installed": list(study.missing),
        "experiments": [
            {
                "experiment": one.experiment.name,
                "seconds": float(one.experiment.t_s[-1]),
                "azimuth_bound_deg_per_hour": one.bound_dph,
                "paper_deg_per_hour": {
                    angle: None if pair is None else {"before": pair[0], "after": pair[1]}
                    for angle, pair in PAPER[one.experiment.name].items()
                },
                "methods": [_row_dict(row) for row in one.rows],
            }
            for one in study.results
        ],
        "curved_hole": {"turn_deg": 5.0, "methods": [_row_dict(row) for row in study.curved]},
        "inclination_sweep": {"why": list(WHY), "points": [asdict(point) for point in study.sweep]},
    }


def _row_dict(row: MethodRow) -> dict[str, Any]:
    return {
        "method": row.method,
        "ours": row.ours,
        "inc_deg_per_hour": row.inc_dph,
        "tf_deg_per_hour": row.tf_dph,
        "azi_deg_per_hour": row.azi_dph,
        "azi_error_max_deg": row.azi_max_deg,
        "azi_std_end_deg": row.azi_std_deg,
        "azimuth_basis": row.basis,
    }
