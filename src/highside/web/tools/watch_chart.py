"""The calibration over the last day: how far each parameter is from it by the tool's watch, with bands of 95 %.

Numbers in, the options of an ECharts picture out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from highside.web.tools.drawings import BAND_SIGMAS, INK
from highside.web.tools.state import History
from highside.web.words import _, said_later

PANELS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (said_later("offset, mg"), ("b_x", "b_y", "b_z")),
    (said_later("scale, mg/g"), ("S_xx", "S_yy", "S_zz")),
    (said_later("misalignment, mg/g"), ("S_xz", "S_yz", "S_zx")),
)
"""Of the report of a recording, too; `S_xy - S_yx` is nothing that a hole shows."""
COLOURS = ("#0b57a4", "#b35c00", "#0b6e31")
DASHES = ("solid", "dashed", "dotted")
"""beside the colour, for those who cannot tell it"""
TOPS = (6, 30, 54, 78)
HEIGHT = 17
"""of a panel, in percent of the picture"""
LEAST_EVIDENCE = 1.0
"""shown: evidence grows to thousands, the threshold is 36, and both are to be seen"""


def watch_chart(history: History) -> dict[str, Any]:
    """A panel for each of `PANELS`, and one of the evidence of a departure against its threshold."""
    count = len(PANELS) + 1
    series: list[dict[str, Any]] = []
    for k, (_label, names) in enumerate(PANELS):
        for name, colour, dash in zip(names, COLOURS, DASHES, strict=True):
            if name in history.parameters:
                series += _banded(k, name, history, colour, dash)
    series += _evidence(count - 1, history)
    for k in range(count):
        series += _changes(k, history)
    labels = [*(_(label) for label, _names in PANELS), _("evidence")]
    legends = [[*names] for _label, names in PANELS] + [[_("evidence"), _("threshold")]]
    return {
        "animation": False,
        "aria": {"enabled": True, "label": {"description": _words(history)}},
        "tooltip": {"trigger": "axis"},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "dataZoom": [{"type": "inside", "xAxisIndex": list(range(count))}],
        "legend": [
            {
                "data": names,
                "top": f"{top - 5}%",
                "left": 64,
                "itemHeight": 8,
                "itemWidth": 18,
                "itemGap": 6,
                "textStyle": {"color": INK},
            }
            for names, top in zip(legends, TOPS, strict=True)
        ],
        "grid": [{"top": f"{top}%", "height": f"{HEIGHT}%", "left": 64, "right": 14} for top in TOPS],
        "xAxis": [
            {
                "gridIndex": k,
                "type": "value",
                "min": math.floor(history.hours[0]) if history.hours else -1,
                "max": 0,
                "axisLabel": {"show": k == count - 1, "color": INK, "formatter": "{value} h", "hideOverlap": True},
            }
            for k in range(count)
        ],
        "yAxis": [
            {
                "gridIndex": k,
                **({"type": "log", "min": LEAST_EVIDENCE} if k == count - 1 else {"type": "value", "scale": True}),
                "name": label,
                "nameLocation": "middle",
                "nameGap": 44,
                "nameTextStyle": {"color": INK},
                "axisLabel": {"color": INK, "hideOverlap": True},
                "splitNumber": 4,
                # at the left, whatever zero of the time is
                "axisLine": {"onZero": False},
            }
            for k, label in enumerate(labels)
        ],
        "series": series,
    }


def _words(history: History) -> str:
    """What the picture shows, for those who cannot see it; the table below it has the numbers."""
    if not history.hours:
        return _("The calibration over the last day: nothing was measured yet.")
    message = _(
        "Deviation of %(count)s parameters from the calibration with bands of 95 percent, over the last %(hours)s"
        " hours."
    )
    since = message % {"count": len(history.parameters), "hours": f"{-history.hours[0]:.1f}"}
    changed = [
        _("%(hours)s hours ago calibration %(cal_id)s came into force.") % {"hours": f"{-hours:.1f}", "cal_id": cal_id}
        for hours, cal_id in history.changes
    ]
    return " ".join([since, *changed])


def _banded(k: int, name: str, history: History, colour: str, dash: str) -> list[dict[str, Any]]:
    """A line, and its band as two stacked lines of which the upper has an area."""
    hours, trace = history.hours, history.parameters[name]
    place: dict[str, Any] = {"xAxisIndex": k, "yAxisIndex": k, "type": "line", "showSymbol": len(hours) == 1}
    quiet = {
        "lineStyle": {"opacity": 0},
        "showSymbol": False,
        "stack": f"band {name}",
        "stackStrategy": "all",
        "tooltip": {"show": False},
        "silent": True,
    }
    both = list(zip(trace.value, trace.std, strict=True))
    low = [None if v is None or s is None else 1e3 * (v - BAND_SIGMAS * s) for v, s in both]
    wide = [None if v is None or s is None else 2e3 * BAND_SIGMAS * s for v, s in both]
    line = [None if v is None else 1e3 * v for v in trace.value]
    look = {"itemStyle": {"color": colour}, "lineStyle": {"color": colour, "type": dash}, "z": 3}
    return [
        place | quiet | {"name": _("%(name)s, lower end") % {"name": name}, "data": _broken(history, low)},
        place | quiet | {"name": _("%(name)s, width") % {"name": name}, "data": _broken(history, wide)}
        | {"areaStyle": {"color": colour, "opacity": 0.18}},
        place | look | {"name": name, "data": _broken(history, line)},
    ]  # fmt: skip


def _changes(k: int, history: History) -> list[dict[str, Any]]:
    """Upright lines in a panel where another calibration came into force."""
    if not history.changes:
        return []
    lines = [
        {"xAxis": hours, "label": {"formatter": _("calibration %(cal_id)s") % {"cal_id": cal_id} if k == 0 else ""}}
        for hours, cal_id in history.changes
    ]
    look = {"symbol": "none", "silent": True, "lineStyle": {"color": INK, "type": "solid", "width": 1}}
    label = {"color": INK, "position": "insideEndTop", "rotate": 0, "align": "right"}
    place = {"xAxisIndex": k, "yAxisIndex": k, "type": "line", "data": []}
    return [place | {"name": "", "markLine": look | {"label": label, "data": lines}}]


def _evidence(k: int, history: History) -> list[dict[str, Any]]:
    place: dict[str, Any] = {"xAxisIndex": k, "yAxisIndex": k, "type": "line", "showSymbol": len(history.hours) == 1}
    level = [history.threshold] * len(history.hours)
    return [
        place
        | {
            "name": _("evidence"),
            "data": _broken(history, [None if v is None else max(v, LEAST_EVIDENCE) for v in history.evidence]),
            "itemStyle": {"color": COLOURS[0]},
        },
        place
        | {
            "name": _("threshold"),
            "data": _pairs(history.hours, level),
            "showSymbol": False,
            "itemStyle": {"color": "#a4161a"},
            "lineStyle": {"color": "#a4161a", "type": "dashed"},
        },
    ]


def _broken(history: History, values: Sequence[float | None]) -> list[list[float | None]]:
    """As `_pairs`, with a gap where another calibration came into force: deviations before it are from another one."""
    gaps: list[list[float | None]] = [[hours, None] for hours, _ in history.changes]
    # a gap after the measurement of the same time
    return sorted([*_pairs(history.hours, values), *gaps], key=lambda pair: (pair[0] or 0.0, pair[1] is None))


def _pairs(hours: Sequence[float], values: Sequence[float | None]) -> list[list[float | None]]:
    return [[t, None if v is None else float(f"{v:.5g}")] for t, v in zip(hours, values, strict=True)]
