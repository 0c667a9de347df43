"""The tool from the side, drawn flat, for a browser that shows nothing in three dimensions: WebGL is switched off, or
its machine has no driver for it. A style sheet shows it there alone; it is sent until the browser says that it has
built the picture in space."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

from markupsafe import Markup

from highside.web.drawings import svg
from highside.web.words import _

if TYPE_CHECKING:
    from nicegui.elements.html import Html
    from nicegui.elements.scene import Scene

    from highside.web.space import Angles

HALF, RADIUS = 78.0, 11.0
"""Half the length of the pipe and its radius, in units of the picture."""
BOX = "-110 -110 220 220"


def side_view(tool: Angles | None, ghost: Angles | None = None) -> Markup:
    """SVG of the tool at (inclination, toolface), deg, in the vertical plane of the hole, more inclined to the left.

    Its scribe line (toolface zero of the sensor) is dashed where it is behind the pipe. `ghost`: where it is wanted;
    with neither, the plumb line alone.
    """
    shapes = [Element("path", {"class": "plumb", "d": "M0 -104V104"})]
    for angles, kind in ((ghost, "ghost"), (tool, "pipe")):
        if angles is not None and all(math.isfinite(angle) for angle in angles):
            shapes += _pipe(angles, kind)
    drawn = svg(shapes, "", box=BOX, name="side")
    # the numbers beside it say the same
    why = _("From the side: this browser shows nothing in three dimensions (WebGL).")
    return Markup('<div aria-hidden="true">{}</div><p class="mute">{}</p>').format(drawn, why)


def _pipe(angles: Angles, kind: str) -> list[Element]:
    """Body, nose down-hole, and the scribe line of a tool that is no ghost."""
    inc, tf = (math.radians(angle) for angle in angles)
    up = (-math.sin(inc), -math.cos(inc))
    high = (math.cos(inc), -math.sin(inc))

    def at(along: float, across: float) -> str:
        x, y = (along * u + across * h for u, h in zip(up, high, strict=True))
        return f"{x:.1f} {y:.1f}"

    corners = [at(HALF, -RADIUS), at(HALF, RADIUS), at(-HALF, RADIUS), at(-HALF - 18.0, 0.0), at(-HALF, -RADIUS)]
    shapes = [Element("path", {"class": kind, "d": f"M{'L'.join(corners)}Z"})]
    if kind == "pipe":
        # clockwise looking down-hole is towards who looks
        behind = "" if math.sin(tf) >= 0.0 else " behind"
        across = RADIUS * math.cos(tf)
        shapes.append(Element("path", {"class": f"scribe{behind}", "d": f"M{at(HALF, across)}L{at(-HALF, across)}"}))
    return shapes


class FlatView:
    """One viewer's flat picture beside `scene`, made where it is to stand."""

    def __init__(self, scene: Scene) -> None:
        from nicegui import ui

        self._built = False
        self._place: Html = ui.html(side_view(None), sanitize=False).classes("flat")
        scene.on("init", self._is_built)

    def _is_built(self) -> None:
        self._built = True
        self._place.set_content("")

    def show(self, tool: Angles | None, ghost: Angles | None = None) -> None:
        """Draw it, unless the browser has the picture in space."""
        if not self._built:
            self._place.set_content(side_view(tool, ghost))
