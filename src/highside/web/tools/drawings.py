"""What is drawn of a tool: the toolface dial, the trend. Numbers in, shapes out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from highside.web.tools.state import Point
from highside.web.words import _, said_later

PAST_SHOWN = 8
"""Earlier toolfaces on the dial, the newest outermost, as a driller's display has them."""
BAND_SIGMAS = 2.0
"""Bands are of 95 %."""
INK = "#46525d"
"""Words in a picture, on light paper; the style sheet inverts the picture where the browser wishes dark."""


@dataclass(frozen=True, slots=True)
class DialMark:
    """A point on the dial, x right and y down from its centre, with its place among its like (0: the oldest)."""

    x: float
    y: float
    share: float


@dataclass(frozen=True, slots=True)
class Dial:
    """The toolface looking down-hole, 0 at the top, clockwise."""

    needle: DialMark | None
    band: str
    """path of the 95 % band; empty where the uncertainty is not known"""
    past: tuple[DialMark, ...]
    summary: str


def dial(tf_deg: float | None, tf_std_deg: float | None, past_deg: Sequence[float]) -> Dial:
    """The dial on a circle of radius 100. `past_deg`: the toolfaces before, oldest first."""
    shown = past_deg[-PAST_SHOWN:]
    marks = tuple(
        _mark(angle, 30.0 + 50.0 * (k + 1) / (len(shown) + 1), (k + 1) / len(shown)) for k, angle in enumerate(shown)
    )
    if tf_deg is None:
        return Dial(None, "", marks, _("toolface not known"))
    half = None if tf_std_deg is None else BAND_SIGMAS * tf_std_deg
    words = _("toolface %(angle)s degrees") % {"angle": f"{tf_deg % 360.0:.1f}"}
    if half is not None:
        words += ", " + _("plus or minus %(band)s") % {"band": f"{half:.2g}"}
    return Dial(_mark(tf_deg, 92.0, 1.0), "" if half is None else _sector(tf_deg, half), marks, words)


def _mark(angle_deg: float, radius: float, share: float) -> DialMark:
    angle = math.radians(angle_deg)
    return DialMark(radius * math.sin(angle), -radius * math.cos(angle), share)


def _sector(centre_deg: float, half_deg: float) -> str:
    """An SVG path; of a half circle and more, the ring."""
    if half_deg >= 90.0:
        return "M0 -100A100 100 0 1 1 0 100A100 100 0 1 1 0 -100Z"
    # what is narrower than a line cannot be seen
    half = max(half_deg, 0.6)
    first, last = _mark(centre_deg - half, 100.0, 1.0), _mark(centre_deg + half, 100.0, 1.0)
    return f"M0 0L{first.x:.2f} {first.y:.2f}A100 100 0 0 1 {last.x:.2f} {last.y:.2f}Z"


ROWS: tuple[tuple[str, str, str | None, str], ...] = (
    ("inc_deg", said_later("inclination, deg"), "inc_std_deg", "#0b57a4"),
    ("motor_toolface_deg", said_later("toolface, deg"), "tf_std_deg", "#b35c00"),
    ("g_total", said_later("|g|, local g"), None, "#0b6e31"),
)
"""Panels of the trend: member of the reading, its name, its standard deviation, its colour"""


TURNING = frozenset({"motor_toolface_deg"})
"""Angles that go round: 0 to 360"""


def trend(points: Sequence[Point], now: float) -> dict[str, Any]:
    """The options of an ECharts picture: a panel for each of `ROWS` over the last ten minutes, with 95 % bands."""
    heights = [f"{2 + 33 * k}%" for k in range(len(ROWS))]
    series: list[dict[str, Any]] = []
    for k, (name, label, std, colour) in enumerate(ROWS):
        series += _lines(k, points, now, name, _(label), std, colour)
    return {
        "animation": False,
        "aria": {"enabled": True},
        "tooltip": {"trigger": "axis"},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "dataZoom": [{"type": "inside", "xAxisIndex": list(range(len(ROWS)))}],
        "grid": [{"top": top, "height": "24%", "left": 64, "right": 12} for top in heights],
        "xAxis": [
            {
                "gridIndex": k,
                "type": "value",
                "min": "dataMin",
                "max": 0,
                "axisLabel": {
                    "show": k == len(ROWS) - 1,
                    # where the first row happens to be is no round number, and stands on the one beside it
                    "showMinLabel": False,
                    "hideOverlap": True,
                    "color": INK,
                    "formatter": "{value} s",
                },
            }
            for k in range(len(ROWS))
        ],
        "yAxis": [
            {
                "gridIndex": k,
                "type": "value",
                "scale": True,
                "name": _(label),
                "nameLocation": "middle",
                "nameGap": 48,
                "nameTextStyle": {"color": INK},
                "axisLabel": {"color": INK},
            }
            | ({"min": 0, "max": 360, "interval": 90} if name in TURNING else {})
            for k, (name, label, _std, _colour) in enumerate(ROWS)
        ],
        "series": series,
    }


def _lines(
    k: int, points: Sequence[Point], now: float, name: str, label: str, std: str | None, colour: str
) -> list[dict[str, Any]]:
    """The line of one panel, and its band as two stacked lines of which the upper has an area."""
    place = {"xAxisIndex": k, "yAxisIndex": k, "type": "line", "showSymbol": False}
    times = [round(point.mono - now, 1) for point in points]
    values: list[float | None] = [getattr(point.reading, name) for point in points]
    if name in TURNING:
        values = [None if value is None else value % 360.0 for value in values]
    made = [
        place
        | {
            "name": label,
            "data": _broken(_pairs(times, values), name in TURNING),
            "itemStyle": {"color": colour},
            "z": 3,
        }
    ]
    if std is None:
        return made
    halves = [None if (s := getattr(point.reading, std)) is None else BAND_SIGMAS * s for point in points]
    low = [None if v is None or h is None else v - h for v, h in zip(values, halves, strict=True)]
    wide = [None if v is None or h is None else 2.0 * h for v, h in zip(values, halves, strict=True)]
    # a lower end below zero is stacked on too
    stacked = {"stack": f"band {k}", "stackStrategy": "all"}
    quiet = {"lineStyle": {"opacity": 0}, "tooltip": {"show": False}, "silent": True} | stacked
    return [
        place | quiet | {"name": _("%(name)s, lower end") % {"name": label}, "data": _pairs(times, low)},
        place | quiet | {"name": _("%(name)s, width") % {"name": label}, "data": _pairs(times, wide)}
        | {"areaStyle": {"color": colour, "opacity": 0.25}},
        *made,
    ]  # fmt: skip


def _broken(pairs: list[list[float | None]], turning: bool) -> list[list[float | None]]:
    """An angle that passes north or the high side is two lines and not one across the whole panel."""
    if not turning:
        return pairs
    made: list[list[float | None]] = []
    for pair in pairs:
        last = made[-1][1] if made else None
        if last is not None and pair[1] is not None and abs(pair[1] - last) > 180.0:
            made.append([pair[0], None])
        made.append(pair)
    return made


def _pairs(times: Sequence[float], values: Sequence[float | None]) -> list[list[float | None]]:
    return [[t, None if v is None else round(v, 6)] for t, v in zip(times, values, strict=True)]
