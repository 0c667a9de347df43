"""Calibration records of many tools: read, judged by `stability`, told as JSON and as a page."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from highside.errors import HighsideError, InputError
from highside.fleet.stability import NAMES, Stability, ToolHistory, point_of, stability
from highside.recording.calibration_store import read_record
from highside.report.document import Page
from highside.report.plots import new_figure, plotting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["page_of_records", "read_history", "sentence_of_records", "to_dict"]

SCHEMA = "highside.fleet-records/1"
DAY_S = 86400.0
MOST_CHARTS = 12
"""tools of which a control chart is drawn: those that departed first, then those that are due first"""


def read_history(folder: Path, limit_deg: float) -> tuple[Stability, dict[str, str]]:
    """Judge all records (`*.json`) below a folder; with the files that were left out, and why.

    Raises InputError where no record is there. A store keeps other JSON files too: those are left out in words.
    """
    points, omitted = {}, {}
    for path in sorted(folder.rglob("*.json")):
        try:
            point = point_of(read_record(path))
        except HighsideError as error:
            omitted[str(path)] = str(error).replace(str(path), path.name)
            continue
        points[point.record] = point
    if not points:
        raise InputError(
            "holds no calibration record that can be used", where=str(folder), remedy="name the folder of a store"
        )
    return stability(list(points.values()), limit_deg), omitted


def to_dict(found: Stability, omitted: dict[str, str]) -> dict[str, Any]:
    """What `--json` prints."""
    return {
        "schema": SCHEMA,
        "limit_deg": found.limit_deg,
        "pairs": found.pairs,
        "refused": found.refused or None,
        "walk_per_root_day": {
            random_walk.parameter: {
                "value": random_walk.rate,
                "low": random_walk.low,
                "high": random_walk.high,
                "unit": _unit(random_walk.parameter),
            }
            for random_walk in found.random_walks
        },
        "tools": [
            {
                "tool": tool.tool,
                "records": [point.record for point in tool.points],
                "last": _utc(tool.points[-1].at_s),
                "due": None if tool.due_s is None else _utc(tool.due_s),
                "departures": [
                    {
                        "record": one.record,
                        "at": _utc(one.at_s),
                        "parameter": one.parameter,
                        "change": one.change,
                        "unit": _unit(one.parameter),
                        "deviations": one.deviations,
                        "p": one.p,
                    }
                    for one in tool.departures
                ],
            }
            for tool in found.tools
        ],
        "omitted": omitted,
    }


def _unit(parameter: str) -> str:
    return "g" if parameter.startswith("b_") else "g/g"


def _utc(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def sentence_of_records(found: Stability) -> str:
    """The answer in one sentence."""
    count = sum(len(tool.points) for tool in found.tools)
    if found.refused:
        return f"{count} calibrations of {len(found.tools)} tools: {found.refused}."
    departed = [tool.tool for tool in found.tools if tool.departures]
    due = [tool for tool in found.tools if tool.due_s is not None]
    said = f"{count} calibrations of {len(found.tools)} tools: "
    said += f"{', '.join(departed)} departed" if departed else "every calibration agrees with the one before"
    if due:
        first = min(due, key=lambda tool: tool.due_s or 0.0)
        said += f"; the first that is due is {first.tool}, on {_utc(first.due_s or 0.0)[:10]}"
    return said + "."


def page_of_records(found: Stability, omitted: dict[str, str], title: str) -> str:
    """The report as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        page = Page(f"Calibrations over time: {title}")
        departed = [tool for tool in found.tools if tool.departures]
        kind = "open" if found.refused else "found" if departed else "good"
        page.badge(f"{len(departed)} departed", kind, sentence_of_records(found))
        if found.random_walks:
            page.heading("Random walk of the sensors")
            page.table(
                ["parameter", "after a day", "after a year", "95 %, after a year", "unit"],
                [
                    [
                        random_walk.parameter,
                        f"{random_walk.rate:.2g}",
                        f"{random_walk.rate * np.sqrt(365):.2g}",
                        f"{random_walk.low * np.sqrt(365):.2g} to {random_walk.high * np.sqrt(365):.2g}",
                        _unit(random_walk.parameter),
                    ]
                    for random_walk in found.random_walks
                ],
                caption=f"one standard deviation, from {found.pairs} repeated calibrations",
                words=(0, 4),
            )
        page.heading("Tools")
        page.table(
            ["tool", "calibrations", "last", "next due", "departures"],
            [_row(tool) for tool in found.tools],
            caption=f"due: when gravity's direction is uncertain by {found.limit_deg:g} deg (k = 2) at worst",
            words=(0, 2, 3, 4),
        )
        for tool in _charted(found):
            page.figure(_chart(tool, found), f"{tool.tool}: each calibration less the first, with twice its own error.")
        if omitted:
            with page.folded(f"{len(omitted)} files that are left out"):
                page.table(["file", "why"], [list(pair) for pair in omitted.items()], words=(0, 1))
        return page.html()


def _row(tool: ToolHistory) -> list[str]:
    departures = [f"{one.parameter} by {one.change:.2g} on {_utc(one.at_s)[:10]}" for one in tool.departures]
    due = "-" if tool.due_s is None else _utc(tool.due_s)[:10]
    return [tool.tool, str(len(tool.points)), _utc(tool.points[-1].at_s)[:10], due, "; ".join(departures) or "-"]


def _charted(found: Stability) -> list[ToolHistory]:
    several = [tool for tool in found.tools if len(tool.points) > 1]
    several.sort(key=lambda tool: (not tool.departures, tool.due_s if tool.due_s is not None else np.inf))
    return several[:MOST_CHARTS]


def _chart(tool: ToolHistory, found: Stability) -> Figure:
    """Offsets and diagonal of A over time; the band is what random walk and the first record's error explain."""
    shown = ("b_x", "b_y", "b_z", "A_xx", "A_yy", "A_zz")
    figure, grid = new_figure(2, 3, height=2.2)
    days = np.array([(point.at_s - tool.points[0].at_s) / DAY_S for point in tool.points])
    rates = {random_walk.parameter: random_walk.rate for random_walk in found.random_walks}
    for name, axes in zip(shown, [axes for row in grid for axes in row], strict=True):
        k = NAMES.index(name)
        moved = 1e3 * np.array([point.values[k] - tool.points[0].values[k] for point in tool.points])
        std = 1e3 * np.sqrt([point.covariance[k, k] for point in tool.points])
        axes.errorbar(days, moved, 2 * std, fmt="o-", markersize=3, linewidth=0.8)
        if name in rates:
            over = np.linspace(0, max(float(days[-1]), 1.0), 50)
            band = 2 * np.sqrt(std[0] ** 2 + (1e3 * rates[name]) ** 2 * over)
            axes.fill_between(over, -band, band, alpha=0.15)
        for one in tool.departures:
            if one.parameter == name:
                axes.axvline((one.at_s - tool.points[0].at_s) / DAY_S, color="#c2447d", linestyle=":")
        axes.set(title=f"{name}, m{_unit(name)}", xlabel="days")
    return figure
