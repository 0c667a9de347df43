"""Pictures of a session as SVG: bull's-eye, toolface dial, stillness trace, uncertainty over inclination.

Each is drawn from a snapshot alone and carries its meaning as a sentence for those who cannot see it. Colours come from
the page's style sheet (classes), never colour alone: what is good is also filled, what is not is hollow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree.ElementTree import Element, tostring

from markupsafe import Markup

from highside.bench.session.snapshot import (
    AttitudeState,
    Deviation,
    Snapshot,
    StillnessState,
    Target,
    UncertaintyState,
    table_reads,
)
from highside.web.words import _

RADIUS = 100.0
RINGS_DEG = (1.0, 10.0, 90.0)
"""Rings of the bull's-eye beyond that of the tolerance."""
INNER = 0.26
"""Share of the radius that the tolerance takes."""
TRACE_LOW, TRACE_HIGH = 0.1, 100.0


def svg(shapes: Sequence[Element], summary: str, *, box: str, name: str) -> Markup:
    """An SVG element that screen readers take as one image, built as a tree: no word in it becomes markup."""
    fit = {"preserveAspectRatio": "none"} if name == "trace" else {}
    drawn = Element("svg", {"class": name, "viewBox": box, **fit, "role": "img", "aria-label": summary})
    drawn.extend(shapes)
    return Markup(tostring(drawn, encoding="unicode"))


def _shape(tag: str, kind: str, *, text: str | None = None, **at: str | float) -> Element:
    """A shape of a class of the style sheet; numbers to a tenth of a unit."""
    values = {key: value if isinstance(value, str) else _short(value) for key, value in at.items()}
    element = Element(tag, {"class": kind, **values})
    element.text = text
    return element


def _short(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def radius_of(angle_deg: float, tolerance_deg: float) -> float:
    """Where an angle lies on the bull's-eye, 0 to 1: linear within the tolerance, logarithmic beyond, 1 at 180 deg."""
    angle, tolerance = max(0.0, angle_deg), max(1e-6, tolerance_deg)
    if angle <= tolerance:
        return INNER * angle / tolerance
    span = math.log(max(180.0, 2.0 * tolerance) / tolerance)
    return min(1.0, INNER + (1.0 - INNER) * math.log(angle / tolerance) / span)


def bulls_eye(deviation: Deviation | None, target: Target | None) -> Markup:
    """The tool as a dot, the requested pose as the centre: up is more inclined, right is clockwise."""
    shapes = [_shape("circle", "ring", r=RADIUS)]
    if deviation is None or target is None:
        why = _("no pose requested") if target is None else _("no readings")
        shapes.append(_shape("text", "scale mid", text=why, y=6.0))
        return svg(shapes, why, box="-112 -112 224 224", name="bullseye")
    good = " hit" if deviation.angle_deg <= deviation.tolerance_deg else ""
    for ring in RINGS_DEG:
        if ring > 1.6 * deviation.tolerance_deg:
            r = RADIUS * radius_of(ring, deviation.tolerance_deg)
            # within its ring, unless the goal is drawn there
            y = 12.0 - r if r - 14.0 > RADIUS * INNER else -3.0 - r
            shapes += [_shape("circle", "ring", r=r), _shape("text", "scale", text=f"{ring:g}°", x=3.0, y=y)]
    x, y = place(deviation, target)
    shapes += [
        _shape("path", "ring", d="M-100 0H100M0 -100V100"),
        _shape("circle", f"goal{good}", r=RADIUS * INNER),
        _shape("line", "way", x1=x, y1=y, x2=0.0, y2=0.0),
        _shape("circle", f"tool{good}", cx=x, cy=y, r=9.0),
    ]
    summary = _("the tool is %(angle)s degrees from the pose; within %(tolerance)s it is taken") % {
        "angle": f"{deviation.angle_deg:.2f}",
        "tolerance": f"{deviation.tolerance_deg:.2f}",
    }
    return svg(shapes, summary, box="-112 -112 224 224", name="bullseye")


def place(deviation: Deviation, target: Target) -> tuple[float, float]:
    """Where the tool is drawn: opposite to what is missing, at the distance of the angle. x right, y down."""
    across = 0.0 if deviation.tf_deg is None else deviation.tf_deg * abs(math.sin(math.radians(target.inc_deg)))
    size = math.hypot(across, deviation.inc_deg)
    r = RADIUS * radius_of(deviation.angle_deg, deviation.tolerance_deg)
    if size < 1e-9:
        return 0.0, -r
    return -r * across / size, r * deviation.inc_deg / size


def dial(attitude: AttitudeState | None, target: Target | None) -> Markup:
    """The gravity toolface looking down-hole, clockwise from the high side: needle where it is, wedge where it goes."""
    shapes = [_shape("circle", "ring", r=RADIUS)]
    for k in range(24):
        angle = 15.0 * k
        (x1, y1), (x2, y2) = _at(angle, 88.0 if k % 3 == 0 else 94.0), _at(angle, 100.0)
        shapes.append(_shape("line", "tick", x1=x1, y1=y1, x2=x2, y2=y2))
        if k % 6 == 0:
            x, y = _at(angle, 74.0)
            shapes.append(_shape("text", "scale mid", text=f"{angle:g}°", x=x, y=y + 5))
    now = None if attitude is None else table_reads(attitude, target)[1]
    goal = None if target is None else target.tf_deg
    if goal is not None and abs(math.sin(math.radians(target.inc_deg if target else 0.0))) > 1e-3:
        corners = (_at(goal - 6, 112.0), _at(goal + 6, 112.0), _at(goal, 90.0))
        shapes.append(_shape("path", "wedge", d="M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in corners) + "Z"))
    if now is not None:
        x, y = _at(now, 62.0)
        shapes += [_shape("line", "needle", x1=0.0, y1=0.0, x2=x, y2=y), _shape("circle", "hub", r=7.0)]
        words = _("toolface %(angle)s degrees") % {"angle": f"{now:.1f}"}
    else:
        words = _("toolface not known") if attitude is None else _("toolface not defined: the tool is vertical")
    if goal is not None:
        words += ", " + _("requested %(angle)s") % {"angle": f"{goal % 360.0:.1f}"}
    return svg(shapes, words, box="-118 -118 236 236", name="dial")


def trace(stillness: StillnessState | None) -> Markup:
    """The last stillness values against the limit, logarithmic; below the line is still."""
    width, height = 300.0, 90.0
    box = f"0 0 {width:g} {height:g}"
    shapes = [_shape("rect", "pane", width=width, height=height)]
    if stillness is None or not stillness.trace:
        return svg(shapes, _("no readings yet"), box=box, name="trace")
    y_limit = height * (1.0 - _share(stillness.limit))
    points = _polyline([height * (1.0 - _share(value)) for value in stillness.trace], width)
    shapes += [
        _shape("rect", "calm", y=y_limit, width=width, height=height - y_limit),
        _shape("line", "limit", x1=0.0, x2=width, y1=y_limit, y2=y_limit),
        _shape("polyline", "line hit" if stillness.still else "line", points=points),
    ]
    summary = _("%(state)s: %(times)s times what its own noise allows") % {
        "state": _("still") if stillness.still else _("moving"),
        "times": f"{stillness.value:.1f}",
    }
    return svg(shapes, summary, box=box, name="trace")


def uncertainty_curve(uncertainty: UncertaintyState | None) -> Markup:
    """Standard deviations of I and T over inclination, both logarithmic on one scale."""
    width, height, left, low = 300.0, 120.0, 56.0, 16.0
    box = f"0 0 {width:g} {height:g}"
    shapes = [_shape("rect", "pane", x=left, width=width - left, height=height - low)]
    if uncertainty is None or not uncertainty.inc_deg:
        why = _("no uncertainty yet")
        shapes.append(_shape("text", "scale mid", text=why, x=(left + width) / 2, y=(height - low) / 2))
        return svg(shapes, why, box=box, name="curve")
    values = [v for v in (*uncertainty.inc_std_deg, *uncertainty.tf_std_deg) if v > 0]
    bottom = max(-9, math.floor(math.log10(min(values, default=1e-3))))
    top = max(bottom + 1, math.ceil(math.log10(max(values, default=1.0))))
    span_deg = max(max(uncertainty.inc_deg), 1.0)

    def point(inc: float, value: float) -> str:
        share = (math.log10(max(value, 10.0**bottom)) - bottom) / (top - bottom)
        return f"{left + (width - left) * inc / span_deg:.1f},{(height - low) * (1 - share):.1f}"

    for power in range(bottom, top + 1):
        y = (height - low) * (1 - (power - bottom) / (top - bottom))
        shapes.append(_shape("line", "grid", x1=left, x2=width, y1=y, y2=y))
        y = min(max(y + 4.0, 10.0), height - low)
        shapes.append(_shape("text", "scale right", text=f"{10.0**power:g}°", x=left - 4, y=y))
    for kind, stds in (("line i", uncertainty.inc_std_deg), ("line t", uncertainty.tf_std_deg)):
        points = " ".join(point(inc, std) for inc, std in zip(uncertainty.inc_deg, stds, strict=True))
        shapes.append(_shape("polyline", kind, points=points))
    shapes += [
        _shape("text", "scale", text="0°", x=left, y=height - 3),
        _shape("text", "scale right", text=f"I = {span_deg:g}°", x=width, y=height - 3),
    ]
    summary = _("uncertainty of the calibration: I %(inc)s, T %(tf)s degrees, one standard deviation") % {
        "inc": f"{uncertainty.rms_inc_std_deg:.4f}",
        "tf": f"{uncertainty.rms_tf_std_deg:.4f}",
    }
    return svg(shapes, summary, box=box, name="curve")


def pictures(snapshot: Snapshot) -> dict[str, Markup]:
    """All of them by name."""
    return {
        "bullseye": bulls_eye(snapshot.deviation, snapshot.target),
        "dial": dial(snapshot.attitude, snapshot.target),
        "trace": trace(snapshot.stillness),
        "curve": uncertainty_curve(snapshot.uncertainty),
    }


def _share(value: float) -> float:
    """0 to 1 on the logarithmic scale of the trace."""
    held = min(max(value, TRACE_LOW), TRACE_HIGH)
    return math.log(held / TRACE_LOW) / math.log(TRACE_HIGH / TRACE_LOW)


def _polyline(heights: Sequence[float], width: float) -> str:
    step = width / max(1, len(heights) - 1)
    return " ".join(f"{k * step:.1f},{y:.1f}" for k, y in enumerate(heights))


def _at(angle_deg: float, r: float) -> tuple[float, float]:
    """A point on the dial: 0 up, clockwise."""
    angle = math.radians(angle_deg)
    return r * math.sin(angle), -r * math.cos(angle)
