"""Pictures of a session as SVG: bull's-eye, toolface dial, stillness trace, uncertainty over inclination.

Each is drawn from a snapshot alone and carries its meaning as a sentence for those who cannot see it. Colours come from
the page's style sheet (classes), never colour alone: what is good is also filled, what is not is hollow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from highside.bench.session.snapshot import (
    AttitudeState,
    Deviation,
    Snapshot,
    StillnessState,
    Target,
    UncertaintyState,
    table_reads,
)

RADIUS = 100.0
RINGS_DEG = (1.0, 10.0, 90.0)
"""Rings of the bull's-eye beyond that of the tolerance."""
INNER = 0.26
"""Share of the radius that the tolerance takes."""
TRACE_LOW, TRACE_HIGH = 0.1, 100.0


def svg(content: str, summary: str, *, box: str, name: str) -> str:
    """An SVG element that screen readers take as one image."""
    fit = ' preserveAspectRatio="none"' if name == "trace" else ""
    label = escape(summary, quote=True)
    return f'<svg class="{name}" viewBox="{box}"{fit} role="img" aria-label="{label}">{content}</svg>'


def radius_of(angle_deg: float, tolerance_deg: float) -> float:
    """Where an angle lies on the bull's-eye, 0 to 1: linear within the tolerance, logarithmic beyond, 1 at 180 deg."""
    angle, tolerance = max(0.0, angle_deg), max(1e-6, tolerance_deg)
    if angle <= tolerance:
        return INNER * angle / tolerance
    span = math.log(max(180.0, 2.0 * tolerance) / tolerance)
    return min(1.0, INNER + (1.0 - INNER) * math.log(angle / tolerance) / span)


def bulls_eye(deviation: Deviation | None, target: Target | None) -> str:
    """The tool as a dot, the requested pose as the centre: up is more inclined, right is clockwise."""
    if deviation is None or target is None:
        why = "no pose requested" if target is None else "no readings"
        empty = f'<circle class="ring" r="{RADIUS:g}"/><text class="scale mid" y="6">{why}</text>'
        return svg(empty, why, box="-112 -112 224 224", name="bullseye")
    good = deviation.angle_deg <= deviation.tolerance_deg
    parts = [f'<circle class="ring" r="{RADIUS:g}"/>']
    for ring in RINGS_DEG:
        if ring > 1.6 * deviation.tolerance_deg:
            r = RADIUS * radius_of(ring, deviation.tolerance_deg)
            # within its ring, unless the goal is drawn there
            y = 12.0 - r if r - 14.0 > RADIUS * INNER else -3.0 - r
            parts.append(f'<circle class="ring" r="{r:.1f}"/><text class="scale" x="3" y="{y:.1f}">{ring:g}°</text>')
    parts.append('<path class="ring" d="M-100 0H100M0 -100V100"/>')
    parts.append(f'<circle class="goal{" hit" if good else ""}" r="{RADIUS * INNER:.1f}"/>')
    x, y = place(deviation, target)
    parts.append(f'<line class="way" x1="{x:.1f}" y1="{y:.1f}" x2="0" y2="0"/>')
    parts.append(f'<circle class="tool{" hit" if good else ""}" cx="{x:.1f}" cy="{y:.1f}" r="9"/>')
    summary = (
        f"the tool is {deviation.angle_deg:.2f} degrees from the pose; within {deviation.tolerance_deg:.2f} it is taken"
    )
    return svg("".join(parts), summary, box="-112 -112 224 224", name="bullseye")


def place(deviation: Deviation, target: Target) -> tuple[float, float]:
    """Where the tool is drawn: opposite to what is missing, at the distance of the angle. x right, y down."""
    across = 0.0 if deviation.tf_deg is None else deviation.tf_deg * abs(math.sin(math.radians(target.inc_deg)))
    size = math.hypot(across, deviation.inc_deg)
    r = RADIUS * radius_of(deviation.angle_deg, deviation.tolerance_deg)
    if size < 1e-9:
        return 0.0, -r
    return -r * across / size, r * deviation.inc_deg / size


def dial(attitude: AttitudeState | None, target: Target | None) -> str:
    """The gravity toolface looking down-hole, clockwise from the high side: needle where it is, wedge where it goes."""
    parts = [f'<circle class="ring" r="{RADIUS:g}"/>']
    for k in range(24):
        angle = 15.0 * k
        inner = 88.0 if k % 3 == 0 else 94.0
        parts.append(f'<line class="tick" {_ends(angle, inner, 100.0)}/>')
        if k % 6 == 0:
            x, y = _at(angle, 74.0)
            parts.append(f'<text class="scale mid" x="{x:.1f}" y="{y + 5:.1f}">{angle:g}°</text>')
    now = None if attitude is None else table_reads(attitude, target)[1]
    goal = None if target is None else target.tf_deg
    if goal is not None and abs(math.sin(math.radians(target.inc_deg if target else 0.0))) > 1e-3:
        (x1, y1), (x2, y2), (x3, y3) = _at(goal - 6, 112.0), _at(goal + 6, 112.0), _at(goal, 90.0)
        parts.append(f'<path class="wedge" d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}L{x3:.1f} {y3:.1f}Z"/>')
    if now is not None:
        x, y = _at(now, 62.0)
        parts.append(f'<line class="needle" x1="0" y1="0" x2="{x:.1f}" y2="{y:.1f}"/><circle class="hub" r="7"/>')
        words = f"toolface {now:.1f} degrees"
    else:
        words = "toolface not known" if attitude is None else "toolface not defined: the tool is vertical"
    if goal is not None:
        words += f", requested {goal % 360.0:.1f}"
    return svg("".join(parts), words, box="-118 -118 236 236", name="dial")


def trace(stillness: StillnessState | None) -> str:
    """The last stillness values against the limit, logarithmic; below the line is still."""
    width, height = 300.0, 90.0
    if stillness is None or not stillness.trace:
        parts = f'<rect class="pane" width="{width:g}" height="{height:g}"/>'
        return svg(parts, "no readings yet", box=f"0 0 {width:g} {height:g}", name="trace")
    y_limit = height * (1.0 - _share(stillness.limit))
    points = _polyline([height * (1.0 - _share(value)) for value in stillness.trace], width)
    parts = (
        f'<rect class="pane" width="{width:g}" height="{height:g}"/>'
        f'<rect class="calm" y="{y_limit:.1f}" width="{width:g}" height="{height - y_limit:.1f}"/>'
        f'<line class="limit" x1="0" x2="{width:g}" y1="{y_limit:.1f}" y2="{y_limit:.1f}"/>'
        f'<polyline class="line{" hit" if stillness.still else ""}" points="{points}"/>'
    )
    summary = f"{'still' if stillness.still else 'moving'}: {stillness.value:.1f} times what its own noise allows"
    return svg(parts, summary, box=f"0 0 {width:g} {height:g}", name="trace")


def uncertainty_curve(uncertainty: UncertaintyState | None) -> str:
    """Standard deviations of I and T over inclination, both logarithmic on one scale."""
    width, height, left, low = 300.0, 120.0, 56.0, 16.0
    if uncertainty is None or not uncertainty.inc_deg:
        pane = f'<rect class="pane" x="{left:g}" width="{width - left:g}" height="{height - low:g}"/>'
        return svg(pane, "no uncertainty yet", box=f"0 0 {width:g} {height:g}", name="curve")
    values = [v for v in (*uncertainty.inc_std_deg, *uncertainty.tf_std_deg) if v > 0]
    bottom = max(-9, math.floor(math.log10(min(values, default=1e-3))))
    top = max(bottom + 1, math.ceil(math.log10(max(values, default=1.0))))
    span_deg = max(max(uncertainty.inc_deg), 1.0)

    def point(inc: float, value: float) -> str:
        share = (math.log10(max(value, 10.0**bottom)) - bottom) / (top - bottom)
        return f"{left + (width - left) * inc / span_deg:.1f},{(height - low) * (1 - share):.1f}"

    parts = [f'<rect class="pane" x="{left:g}" width="{width - left:g}" height="{height - low:g}"/>']
    for power in range(bottom, top + 1):
        y = (height - low) * (1 - (power - bottom) / (top - bottom))
        parts.append(f'<line class="grid" x1="{left:g}" x2="{width:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        y = min(max(y + 4.0, 10.0), height - low)
        parts.append(f'<text class="scale right" x="{left - 4:g}" y="{y:.1f}">{10.0**power:g}°</text>')
    for name, stds in (("line i", uncertainty.inc_std_deg), ("line t", uncertainty.tf_std_deg)):
        points = " ".join(point(inc, std) for inc, std in zip(uncertainty.inc_deg, stds, strict=True))
        parts.append(f'<polyline class="{name}" points="{points}"/>')
    parts.append(f'<text class="scale" x="{left:g}" y="{height - 3:g}">0°</text>')
    parts.append(f'<text class="scale right" x="{width:g}" y="{height - 3:g}">I = {span_deg:g}°</text>')
    summary = (
        f"uncertainty of the calibration: I {uncertainty.rms_inc_std_deg:.4f}, T"
        f" {uncertainty.rms_tf_std_deg:.4f} degrees, one standard deviation"
    )
    return svg("".join(parts), summary, box=f"0 0 {width:g} {height:g}", name="curve")


def pictures(snapshot: Snapshot) -> dict[str, str]:
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


def _ends(angle_deg: float, inner: float, outer: float) -> str:
    (x1, y1), (x2, y2) = _at(angle_deg, inner), _at(angle_deg, outer)
    return f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
