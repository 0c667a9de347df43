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
from highside.words import _, from_to, told
from highside.words.marked import in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["page_of_records", "read_history", "sentence_of_records", "to_dict"]

SCHEMA = "highside.fleet-records/1"
DAY_S = 86400.0
BESIDE_RECORDS = ("activations", "turntables")
"""folders of a store beside `records`"""
MOST_CHARTS = 12
"""tools of which a control chart is drawn: those that departed first, then those that are due first"""


def read_history(folder: Path, limit_deg: float) -> tuple[Stability, dict[str, str]]:
    """Judge all records (`*.json`) below a folder; with the files that were left out, and why.

    Raises InputError where no record is there. What a store keeps beside its records is none and no word is said of it.
    """
    points, omitted = {}, {}
    for path in sorted(folder.rglob("*.json")):
        if path.parent.name in BESIDE_RECORDS and path.parent.with_name("records").is_dir():
            continue
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
    calibrations = _(
        "Calibrations: %(count)s, tools: %(tools)s",
        count=sum(len(tool.points) for tool in found.tools),
        tools=len(found.tools),
    )
    if found.refused:
        return f"{calibrations}. {_sentence(told(found.refused))}."
    departed = [tool.tool for tool in found.tools if tool.departures]
    due = [tool for tool in found.tools if tool.due_s is not None]
    if departed:
        words = [_("These departed: %(tools)s", tools=", ".join(departed))]
    else:
        words = [_("Every calibration agrees with the one before")]
    if due:
        first = min(due, key=lambda tool: tool.due_s or 0.0)
        words.append(
            _("The first that is due is %(tool)s, on %(day)s", tool=first.tool, day=_utc(first.due_s or 0.0)[:10])
        )
    return ". ".join([calibrations, *words]) + "."


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def page_of_records(found: Stability, omitted: dict[str, str], title: str) -> str:
    """The report as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        page = Page(_("Calibrations over time: %(title)s", title=title))
        departed = [tool for tool in found.tools if tool.departures]
        kind = "open" if found.refused else "found" if departed else "good"
        page.badge(_("%(count)s departed", count=len(departed)), kind, sentence_of_records(found))
        if found.random_walks:
            _walks(page, found)
        page.heading(_("Tools"))
        page.table(
            [_("tool"), _("calibrations"), _("last calibration"), _("next due"), _("departures")],
            [_row(tool) for tool in found.tools],
            caption=_(
                "due: when gravity's direction is uncertain by %(limit)s deg (k = 2) at worst",
                limit=f"{found.limit_deg:g}",
            ),
            words=(0, 2, 3, 4),
        )
        for tool in _charted(found):
            caption = _("%(tool)s: each calibration less the first, with twice its own error.", tool=tool.tool)
            page.figure(_chart(tool, found), caption)
        if omitted:
            with page.folded(_("Files that are left out: %(count)s", count=len(omitted))):
                rows = [[path, in_words(why)] for path, why in omitted.items()]
                page.table([_("file"), _("why")], rows, words=(0, 1))
        return page.html()


def _walks(page: Page, found: Stability) -> None:
    page.heading(_("Random walk of the sensors"))
    year = np.sqrt(365)
    page.table(
        [_("parameter"), _("after a day"), _("after a year"), _("95 %% of it, after a year") % {}, _("unit")],
        [
            [
                one.parameter,
                f"{one.rate:.2g}",
                f"{one.rate * year:.2g}",
                from_to(f"{one.low * year:.2g}", f"{one.high * year:.2g}"),
                _unit(one.parameter),
            ]
            for one in found.random_walks
        ],
        caption=_("one standard deviation, from repeated calibrations: %(count)s", count=found.pairs),
        words=(0, 4),
    )


def _row(tool: ToolHistory) -> list[str]:
    departures = [
        _(
            "%(parameter)s by %(size)s on %(day)s",
            parameter=one.parameter,
            size=f"{one.change:.2g}",
            day=_utc(one.at_s)[:10],
        )
        for one in tool.departures
    ]
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
        axes.set(title=f"{name}, m{_unit(name)}", xlabel=_("days"))
    return figure
