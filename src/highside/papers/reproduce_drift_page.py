"""The page of `highside reproduce drift`: tables beside the paper's, errors over time, the inclination sweep."""

from __future__ import annotations

from typing import Any

import numpy as np

from highside.arrays import Array
from highside.papers.drift_sweep import WHY
from highside.papers.reproduce_drift import ASSUMPTIONS, PAPER, ExperimentResult, MethodRow, Study
from highside.report.document import Page
from highside.report.plots import new_figure, plotting

_POINTS = 180
_POINTS_IN = "a 180th"


def page_of(study: Study) -> str:
    """The whole page as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        return _page_of(study)


def _page_of(study: Study) -> str:
    page = Page("Gyro drift from gravity: the paper's three experiments, simulated")
    page.paragraph(
        "Yang and Yang (2017) estimate gyro drift by comparing the attitude of the gyros with that of gravity, and "
        "report what is left on a turntable, on a vibration table and in simulated drilling. The same three "
        "experiments are simulated here and every method of highside is run on the same readings, beside filters of "
        "others."
    )
    page.heading("What was assumed")
    page.bullets(ASSUMPTIONS)
    if study.missing:
        page.paragraph(f"Not installed and omitted: {', '.join(study.missing)}.", look="soft")
    for one in study.results:
        _experiment(page, one)
    page.heading("A hole that turns by 5 deg")
    page.paragraph(
        "After five minutes of rest the azimuth turns by 5 deg in ten minutes. What asserts that it does not change "
        "reports none of it, or takes it for gyro bias; the method says so in its basis."
    )
    page.table(
        ["", "azimuth error at the end, deg", "stated std, deg", "azimuth comes from"],
        [[row.method, f"{row.azi_error_deg[-1]:.2f}", _std(row), row.basis] for row in study.curved],
        words=(3,),
    )
    page.heading("Where the azimuth correction weakens")
    for words in WHY:
        page.paragraph(words)
    page.table(
        ["elevation, deg", "inclination from vertical", "turning: bound", "filter, rms", "stated", "at rest: bound"],
        [
            [
                f"{p.theta_deg:g}",
                _from_vertical(p.theta_deg),
                f"{p.rotating_bound_deg:.3f}",
                f"{p.rotating_deg:.3f}",
                f"{p.rotating_stated_deg:.3f}",
                f"{p.at_rest_bound_deg:.2f}" if p.theta_deg < 88.0 else "no azimuth",
            ]
            for p in study.sweep
        ],
        f"Rotation about the vertical after an hour, deg, one standard deviation; gravity alone. The filter's rms is "
        f"over {study.sweep[0].seeds} seeds each and may be off by 30 %. At rest within 2 deg of the vertical the "
        "toolface, and with it the azimuth, is not known to begin with.",
    )
    page.figure(_sweep_figure(study), "The same, beside N sqrt(t) / cos(theta).")
    return page.html()


def _experiment(page: Page, one: ExperimentResult) -> None:
    """Table and figures of one experiment."""
    name = one.experiment.name
    page.heading(name.capitalize())
    page.table(
        [
            "",
            "inclination",
            "toolface",
            "azimuth",
            "max azimuth error",
            "stated std",
            "azimuth comes from",
        ],
        [*_published(name), *([*_cells(row)] for row in one.rows)],
        "Drift in deg/h; greatest error and stated standard deviation at the end in deg. Before: the gyro alone, "
        "whose bias was chosen to match the paper's before: by construction. "
        f"Least azimuth drift that the rest and gravity allow on average: {one.bound_dph:.2f} deg/h.",
        words=(6,),
    )
    ours = [row for row in one.rows if row.ours]
    page.figure(
        _figure(ours),
        f"{name.capitalize()}, the methods of highside: errors over time, each point the median of {_POINTS_IN} of "
        "the run; logarithmic beyond 0.1 deg.",
    )
    theirs = [row for row in one.rows if not row.ours]
    if theirs:
        beside = [ours[0], next(row for row in ours if row.method.startswith("kinematic, rest"))]
        page.figure(_figure([*beside, *theirs]), f"{name.capitalize()}, filters of others beside two of these.")


def _published(name: str) -> list[list[str]]:
    rows = []
    for index, when in enumerate(("before", "after")):
        cells = []
        for angle in ("inc", "tf", "azi"):
            pair = PAPER[name][angle]
            value = None if pair is None else pair[index]
            cells.append("not given" if value is None else f"{value:.2f}")
        rows.append([f"the paper, {when}", *cells, "", "", "not stated" if index else ""])
    return rows


def _from_vertical(theta_deg: float) -> str:
    """An elevation, up or down, as inclinations from the vertical."""
    return " or ".join(dict.fromkeys(f"{90 + side * theta_deg:g}" for side in (-1, 1)))


def _std(row: MethodRow) -> str:
    return "none" if row.azi_std_deg is None else f"{row.azi_std_deg:.2f}"


def _cells(row: MethodRow) -> list[str]:
    drifts = [f"{value:.3f}" for value in (row.inc_dph, row.tf_dph, row.azi_dph)]
    return [row.method, *drifts, f"{row.azi_max_deg:.2f}", _std(row), row.basis]


def _figure(rows: list[MethodRow]) -> Any:
    figure, axes = new_figure(1, 2, height=4.0)
    left, right = axes[0]
    for index, row in enumerate(rows):
        style: dict[str, Any] = {"color": f"C{index % 10}", "linestyle": "-" if index < 10 else "--"}
        if row.method.startswith("kinematic"):
            style |= {"linewidth": 1.6, "zorder": 3}
        else:
            style |= {"linewidth": 0.9, "alpha": 0.75}
        minutes = _medians(row.t_s) / 60
        left.plot(minutes, _medians(row.azi_error_deg), label=row.method, **style)
        right.plot(minutes, _medians(row.inc_error_deg), **style)
    for ax, title in ((left, "Azimuth error, deg"), (right, "Inclination error, deg")):
        ax.set_yscale("symlog", linthresh=0.1)
        ax.set_xlabel("minutes")
        ax.set_title(title)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _medians(values: Array) -> Array:
    """The medians of `_POINTS` equal parts."""
    return np.array([np.median(part) for part in np.array_split(values, min(_POINTS, values.size))])


def _sweep_figure(study: Study) -> Any:
    figure, axes = new_figure(1, 1, width=7.0, height=3.4)
    ax = axes[0][0]
    theta = [point.theta_deg for point in study.sweep]
    at_rest = [point for point in study.sweep if point.theta_deg < 88.0]
    ax.plot(theta, [point.rotating_bound_deg for point in study.sweep], label="turning: Cramer-Rao bound")
    ax.plot(theta, [point.rotating_deg for point in study.sweep], "o", label="turning: filter, rms of the seeds")
    ax.plot(theta, [point.rotating_stated_deg for point in study.sweep], "x", label="turning: filter, stated")
    ax.plot([p.theta_deg for p in at_rest], [p.at_rest_bound_deg for p in at_rest], "--", label="at rest: bound")
    fine = np.linspace(0.0, 86.0, 200)
    ax.plot(fine, study.sweep[0].rotating_bound_deg / np.cos(np.radians(fine)), ":", label="N sqrt(t) / cos(theta)")
    ax.set_yscale("log")
    ax.set_xlabel("elevation of the tool axis, deg (90: vertical)")
    ax.set_ylabel("deg after an hour")
    ax.legend()
    return figure
