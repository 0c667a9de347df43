"""The tool on its table: the pipe as it stands, the ghost of the pose wanted, and which way to turn.

`seen` says what is to be drawn of a snapshot, once for all viewers; `BenchScene` is one viewer's picture of it. The
tilt of the table is seen from the side, more inclined to the left; the arrow at the upper end turns the pipe, the one
above it tilts the table. Nothing can be touched in it, so that a finger on a phone moves the page.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from highside.bench.session.guidance import instruction
from highside.bench.session.snapshot import SessionState, Snapshot, table_reads
from highside.web.flat import FlatView
from highside.web.space import LENGTH, PAPER, RADIUS, Angles, draw_pipe, orientation, pointing

if TYPE_CHECKING:
    from nicegui.elements.scene.scene_object3d import Object3D

FRAMES_PER_S = 10
"""Of the browser; the tool is turned by hand, and a phone's battery lasts a shift."""
STEP_DEG = 0.2
"""A turn that no eye sees is not drawn: a tool at rest costs its viewers nothing."""
AZIMUTH_DEG = 90.0
HEIGHT = 2.3
"""Of the table's axis above the floor."""
GHOST, WAY, TABLE = "#0b57a4", "#c2410c", "#aab6c1"


@dataclass(frozen=True, slots=True)
class Seen:
    """What a picture shows, angles as the table counts them. `turn` and `tilt`: +1 clockwise and more inclined, -1 the
    other way, 0 no arrow."""

    tool: Angles | None
    ghost: Angles | None
    turn: int = 0
    tilt: int = 0
    said: str = "no readings"


def seen(snapshot: Snapshot) -> Seen:
    """Of the present snapshot."""
    target, attitude, deviation = snapshot.target, snapshot.attitude, snapshot.deviation
    ghost = None if target is None else (target.inc_deg, target.tf_deg)
    if attitude is None:
        return Seen(None, ghost)
    inc, tf = table_reads(attitude, target)
    # a vertical tool has no toolface: it is drawn as if it had the one wanted
    tool = (inc, tf if tf is not None else 0.0 if ghost is None else ghost[1])
    if deviation is None or target is None:
        return Seen(tool, ghost, said="no pose requested")
    if snapshot.state in (SessionState.SETTLING, SessionState.CAPTURING):
        # it has arrived: two pipes in one place would flicker
        return Seen(tool, None, said="at the pose")
    turn, tilt = (_sign(angle, deviation.tolerance_deg) for angle in (deviation.tf_deg or 0.0, deviation.inc_deg))
    return Seen(tool, ghost, turn, tilt, instruction(deviation, reversed_side=target.inc_deg < 0))


def _sign(angle_deg: float, tolerance_deg: float) -> int:
    return 0 if abs(angle_deg) <= tolerance_deg else 1 if angle_deg > 0 else -1


class BenchScene:
    """One viewer's picture, built where it is made."""

    def __init__(self) -> None:
        from nicegui import ui

        self._shown = Seen(None, None)
        self._scene = ui.scene(
            width=320,
            height=260,
            grid=(8, 8),
            background_color=PAPER,
            click_events=[],
            fps=FRAMES_PER_S,
            camera=ui.scene.perspective_camera(fov=50),
        ).classes("scene")
        # the sentence below it says the same
        self._scene.props('aria-hidden="true"')
        self._flat = FlatView(self._scene)
        with self._scene as scene:
            scene.move_camera(x=-1.6, y=-5.6, z=4.2, look_at_z=2.1, duration=0.0)
            scene.box(1.6, 1.6, 0.1).move(0.0, 0.0, 0.05).material(TABLE)
            scene.box(0.25, 0.5, HEIGHT).move(0.0, 0.75, HEIGHT / 2).material(TABLE)
            with scene.group() as self._cradle:
                # on the low side of the pipe, and tilted with it
                scene.box(0.08, 0.75, 0.8 * LENGTH).move(-RADIUS - 0.06, 0.0, 0.0).material("#8a98a5")
                self._turns = {sign: self._turn_arrow(sign) for sign in (1, -1)}
                self._tilts = {sign: self._tilt_arrow(sign) for sign in (1, -1)}
            self._ghost = draw_pipe(scene, colour=GHOST, opacity=0.4).scale(1.05)
            self._tool = draw_pipe(scene)
            for part in (self._cradle, self._ghost, self._tool):
                part.move(0.0, 0.0, HEIGHT)
            for part in (self._ghost, self._tool, *self._turns.values(), *self._tilts.values()):
                part.visible(False)

    def _turn_arrow(self, sign: int) -> Object3D:
        """About the upper end; +1 is clockwise looking down-hole, which is against +z."""
        r, half = 0.8, math.radians(60.0)
        c, s = math.cos(half), math.sin(half)
        with self._scene.group() as arrow:
            arrow.move(0.0, 0.0, LENGTH / 2 + 0.1)
            # on the side that is seen (-y): from one side of it to the other
            self._arrow([sign * r * s, -r * c, 0.0], [0.0, -r / c, 0.0], [-sign * r * s, -r * c, 0.0])
        return arrow

    def _tilt_arrow(self, sign: int) -> Object3D:
        """Above the upper end; more inclined moves it away from its high side (+x)."""
        z = LENGTH / 2 + 0.45
        with self._scene.group() as arrow:
            self._arrow([0.0, 0.0, z], [-sign * 0.6, 0.0, z], [-sign * 1.1, 0.0, z - 0.35])
        return arrow

    def _arrow(self, start: list[float], mid: list[float], end: list[float]) -> None:
        self._scene.quadratic_bezier_tube(start, mid, end, radius=0.06).material(WAY)
        way = [b - a for a, b in zip(mid, end, strict=True)]
        self._scene.cylinder(0.0, 0.18, 0.36, 24).move(*end).rotate_R(pointing(way)).material(WAY)

    def show(self, now: Seen) -> None:
        """Draw what has changed by more than an eye sees."""
        before = self._shown
        tool, ghost = _kept(before.tool, now.tool), _kept(before.ghost, now.ghost)
        for part, was, angles in ((self._tool, before.tool, tool), (self._ghost, before.ghost, ghost)):
            part.visible(angles is not None)
            if angles is not None and angles != was:
                part.rotate_R(orientation(*angles, AZIMUTH_DEG))
        if (tool, ghost) != (before.tool, before.ghost):
            self._flat.show(tool, ghost)
        leaning = tool or ghost
        if leaning is not None:
            self._cradle.rotate_R(orientation(leaning[0], 0.0, AZIMUTH_DEG))
        for arrows, sign in ((self._turns, now.turn), (self._tilts, now.tilt)):
            for of, arrow in arrows.items():
                arrow.visible(of == sign)
        self._shown = Seen(tool, ghost, now.turn, now.tilt)


def _kept(before: Angles | None, now: Angles | None) -> Angles | None:
    """The same angles as before where the difference is not seen."""
    if before is None or now is None or any(abs(a - b) >= STEP_DEG for a, b in zip(before, now, strict=True)):
        return now
    return before
