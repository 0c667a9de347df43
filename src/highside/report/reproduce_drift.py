"""`highside reproduce drift`: the gravity-quaternion paper's three experiments, simulated, and every method on them.

The paper's figures stand beside ours and are never asserted: its attitude, sensors, vibration and stop lengths are not
published. The drifts *before* correction are matched by construction (the constant biases were chosen for that), the
drifts *after* are what the methods do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.attitude.angles import wrap_signed
from highside.drift.filter import Settings
from highside.drift.kinematic import kinematic
from highside.drift.literal import AzimuthPolicy, literal
from highside.drift.recursive import recursive
from highside.drift.result import DriftResult
from highside.physics.drift_scenarios import (
    LATITUDE_RAD,
    DriftData,
    Experiment,
    drilling,
    record,
    turntable,
    vibration_table,
)
from highside.report.page import Page, new_figure, plotting

FloatArray = NDArray[np.float64]

SEED = 2
_PLOTTED = 1500
"""points of a line in a plot"""
_REST_S = 420.0

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
    "The literal algorithm believes gravity wherever the drilling experiment stands still and holds its last drift "
    "estimate between, which is one sample of differentiated accelerometer noise.",
)


@dataclass(frozen=True, slots=True)
class Row:
    """One method on one experiment; drifts in deg/h, errors in deg."""

    method: str
    inc_dph: float
    tf_dph: float
    azi_dph: float
    azi_max_deg: float
    azi_std_deg: float | None
    basis: str
    t_s: FloatArray
    azi_error_deg: FloatArray
    inc_error_deg: FloatArray


@dataclass(frozen=True, slots=True)
class Told:
    """One experiment and its rows, the gyro alone first."""

    experiment: Experiment
    rows: tuple[Row, ...]


def run_experiments(shorten: float = 1.0, seed: int = SEED) -> tuple[Told, ...]:
    """All three experiments; `shorten` < 1 cuts their durations (for checks of the page, not of the figures)."""
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
    return tuple(_told(experiment, seed, shorten) for experiment in experiments)


def _told(experiment: Experiment, seed: int, shorten: float) -> Told:
    data = record(experiment, seed)
    psi0 = float(experiment.psi[0])
    settings = Settings(latitude_rad=LATITUDE_RAD, azimuth_rad=psi0, detect_stops=False)
    gated = experiment.name == "drilling"
    quiet = ~experiment.vibrating if gated else None
    stops = experiment.rest if gated else None
    rest = experiment.rest if gated else np.array([[0.0, _REST_S * shorten]])
    t, w, a = experiment.t_s, data.rate, data.accel

    def by_letter(policy: AzimuthPolicy, *, average: bool = False, correct: bool = True) -> DriftResult:
        return literal(t, w, a, policy=policy, quiet=quiet, azimuth_rad=psi0, average=average, correct=correct,
                       start_s=10.0)  # fmt: skip

    named: list[tuple[str, Callable[[], DriftResult]]] = [
        ("gyro alone", lambda: by_letter(AzimuthPolicy.GYRO, correct=False)),
        ("literal, policy gyro", lambda: by_letter(AzimuthPolicy.GYRO)),
        ("literal, policy prev", lambda: by_letter(AzimuthPolicy.PREV)),
        ("literal, policy hold", lambda: by_letter(AzimuthPolicy.HOLD)),
    ]
    if gated:
        named.append(("literal_block, policy hold", lambda: by_letter(AzimuthPolicy.HOLD, average=True)))
    straight = replace(settings, straight_hole_std_rad=math.radians(0.1))
    when = "at the stops" if gated else f"for the first {_REST_S * shorten:g} s"
    named += [
        ("recursive, gravity alone", lambda: recursive(t, w, a, settings, rest=stops)),
        ("recursive, straight hole", lambda: recursive(t, w, a, settings, hold=True, rest=stops)),
        ("kinematic, gravity alone", lambda: kinematic(t, w, a, settings)),
        (f"kinematic, rest declared {when}", lambda: kinematic(t, w, a, settings, rest=rest)),
        (f"kinematic, rest {when}, straight hole", lambda: kinematic(t, w, a, straight, rest=rest)),
    ]
    if gated:
        found = replace(settings, detect_stops=True)
        named.append(("kinematic, stops detected", lambda: kinematic(t, w, a, found)))
    return Told(experiment, tuple(_row(name, make(), data) for name, make in named))


def _row(name: str, result: DriftResult, data: DriftData) -> Row:
    e = data.experiment
    inc = np.degrees(result.inc_rad - (e.theta + 0.5 * np.pi))
    tf = np.degrees(wrap_signed(result.tf_rad - e.phi))
    azi = np.degrees(wrap_signed(result.azi_rad - e.psi))
    last = e.t_s >= e.t_s[-1] - 10.0
    every = slice(None, None, max(1, e.t_s.size // _PLOTTED))
    std = float(np.degrees(result.azi_std_rad[-1]))
    return Row(
        method=name,
        inc_dph=float(abs(inc[last].mean()) / e.hours),
        tf_dph=float(abs(tf[last].mean()) / e.hours),
        azi_dph=float(abs(azi[last].mean()) / e.hours),
        azi_max_deg=float(np.abs(azi).max()),
        azi_std_deg=std if math.isfinite(std) else None,
        basis=result.basis_words,
        t_s=e.t_s[every],
        azi_error_deg=azi[every],
        inc_error_deg=inc[every],
    )


def as_dict(told: tuple[Told, ...]) -> dict[str, Any]:
    """Everything but the lines of the plots, ready for JSON."""
    return {
        "schema": "highside.reproduce-drift/1",
        "assumptions": list(ASSUMPTIONS),
        "experiments": [
            {
                "experiment": one.experiment.name,
                "seconds": float(one.experiment.t_s[-1]),
                "paper_deg_per_hour": {
                    angle: None if pair is None else {"before": pair[0], "after": pair[1]}
                    for angle, pair in PAPER[one.experiment.name].items()
                },
                "methods": [
                    {
                        "method": row.method,
                        "inc_deg_per_hour": row.inc_dph,
                        "tf_deg_per_hour": row.tf_dph,
                        "azi_deg_per_hour": row.azi_dph,
                        "azi_error_max_deg": row.azi_max_deg,
                        "azi_std_end_deg": row.azi_std_deg,
                        "azimuth_basis": row.basis,
                    }
                    for row in one.rows
                ],
            }
            for one in told
        ],
    }


def page_of(told: tuple[Told, ...]) -> str:
    """The whole page as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        return _page_of(told)


def _page_of(told: tuple[Told, ...]) -> str:
    page = Page("Gyro drift from gravity: the paper's three experiments, simulated")
    page.paragraph(
        "Yang and Yang (2017) estimate gyro drift by comparing the attitude of the gyros with that of gravity, and "
        "report what is left on a turntable, on a vibration table and in simulated drilling. The same three "
        "experiments are simulated here and every method of highside is run on the same readings."
    )
    page.heading("What was assumed")
    page.bullets(ASSUMPTIONS)
    for one in told:
        name = one.experiment.name
        page.heading(name.capitalize())
        page.table(
            ["", "inclination", "toolface", "azimuth", "max azimuth error, deg", "azimuth comes from"],
            [*_published(name), *([*_cells(row)] for row in one.rows)],
            "Drift in deg/h. Before: the gyro alone. Its bias was chosen to match the paper's before: by construction.",
            words=(5,),
        )
        page.figure(_figure(one), f"{name.capitalize()}: errors over time (logarithmic beyond 0.1 deg).")
    return page.html()


def _published(name: str) -> list[list[str]]:
    rows = []
    for index, when in enumerate(("before", "after")):
        cells = []
        for angle in ("inc", "tf", "azi"):
            pair = PAPER[name][angle]
            value = None if pair is None else pair[index]
            cells.append("not given" if value is None else f"{value:.2f}")
        rows.append([f"the paper, {when}", *cells, "", "not stated" if index else ""])
    return rows


def _cells(row: Row) -> list[str]:
    drifts = [f"{value:.3f}" for value in (row.inc_dph, row.tf_dph, row.azi_dph)]
    return [row.method, *drifts, f"{row.azi_max_deg:.2f}", row.basis]


def _figure(one: Told) -> Any:
    figure, axes = new_figure(1, 2, height=3.6)
    for index, row in enumerate(one.rows):
        colour = f"C{index % 10}"
        axes[0][0].plot(row.t_s / 60, row.azi_error_deg, color=colour, label=row.method, linewidth=0.9)
        axes[0][1].plot(row.t_s / 60, row.inc_error_deg, color=colour, linewidth=0.9)
    for ax, title in zip(axes[0], ("Azimuth error, deg", "Inclination error, deg"), strict=True):
        ax.set_yscale("symlog", linthresh=0.1)
        ax.set_xlabel("minutes")
        ax.set_title(title)
    axes[0][0].legend(fontsize=6)
    return figure
