"""A tool in space, for every page that draws one: its direction cosines, and the pipe itself (three.js by NiceGUI)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nicegui.elements.scene import Scene
    from nicegui.elements.scene.scene_object3d import Object3D

Matrix = list[list[float]]
Angles = tuple[float, float]
"""Inclination and toolface, deg"""

REDRAWN = """<script>
  // a picture in three dimensions is empty after a change of size until it is drawn again: draw it before that is seen
  addEventListener("resize", () => requestAnimationFrame(() => {
    for (const { id } of document.querySelectorAll(".scene")) {
      const drawn = window.getElement?.(id.slice(1));
      drawn?.renderer?.render(drawn.scene, drawn.camera);
    }
  }));
</script>"""
"""For the head of a page that draws one: a window that is drawn wider sends a change of size for each step of it."""
LENGTH, RADIUS = 3.0, 0.28
"""Of the tool in the picture, in units of its scene."""
PAPER = "#dfe6ec"
"""Behind the tool; a style sheet inverts the picture where the browser wishes dark."""
METAL, NOSE, SCRIBE = "#7c8b99", "#3b4650", "#d02c2f"


def orientation(inc_deg: float, tf_deg: float, azi_deg: float) -> Matrix:
    """Direction cosines (3 x 3) from the tool frame (z along the axis, up-hole) to east, north, up.

    The third row is the upward direction in the tool frame, (sin I cos T, sin I sin T, cos I): what the accelerometers
    report. `azi_deg` is that of the hole's down direction, clockwise from north. A negative inclination leans the other
    way: (-I, T + 180) is the attitude (I, T).
    """
    inc, tf, azi = (math.radians(angle) for angle in (inc_deg, tf_deg, azi_deg))
    si, ci, st, ct, sa, ca = math.sin(inc), math.cos(inc), math.sin(tf), math.cos(tf), math.sin(azi), math.cos(azi)
    # columns: the high side (toolface zero), its right, up-hole
    high = (ci * sa, ci * ca, si)
    right = (-ca, sa, 0.0)
    up_hole = (-si * sa, -si * ca, ci)
    return [[h * ct - r * st, h * st + r * ct, u] for h, r, u in zip(high, right, up_hole, strict=True)]


def draw_pipe(scene: Scene, *, colour: str | None = None, opacity: float = 1.0) -> Object3D:
    """A pipe about the origin of a group of its own, which is returned: its scribe line along +x of the sensor, its
    nose down-hole. `colour` in the place of all its own: a ghost."""
    with scene.group() as body:
        for part, own in (
            (scene.cylinder(RADIUS, RADIUS, LENGTH, 48).rotate(math.pi / 2, 0.0, 0.0), METAL),
            (scene.box(0.05, 0.08, LENGTH).move(RADIUS, 0.0, 0.0), SCRIBE),
            (
                scene.cylinder(0.0, RADIUS, 0.5, 48).rotate(-math.pi / 2, 0.0, 0.0).move(0.0, 0.0, -LENGTH / 2 - 0.25),
                NOSE,
            ),
        ):
            part.material(colour or own, opacity)
    return body


def pointing(direction: Sequence[float]) -> Matrix:
    """Rotation (3 x 3) that turns the axis of a cone of the scene (+y) to `direction` (3,)."""
    size = math.hypot(*direction)
    y = [value / size for value in direction]
    other = (1.0, 0.0, 0.0) if abs(y[0]) < 0.9 else (0.0, 0.0, 1.0)
    x = _cross(y, other)
    length = math.hypot(*x)
    x = [value / length for value in x]
    z = _cross(x, y)
    return [[x[k], y[k], z[k]] for k in range(3)]


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
