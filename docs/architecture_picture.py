"""Draws `docs/architecture-layers.svg` and `docs/architecture-reading.svg`. Run it again when what they show changes.

The layers are those of the import contract in `pyproject.toml`. No font is named and nothing is fetched; the colours
follow the viewer's dark or light scheme, on a ground of the picture's own.
"""

from __future__ import annotations

import re
import tomllib
from html import escape
from pathlib import Path

HERE = Path(__file__).parent
STYLE = """
  .ground { fill: #ffffff } .box { fill: #eef3f8; stroke: #4a6785 } .pure { fill: #edf6ee; stroke: #4c7a52 }
  .disk { fill: #fbf3e4; stroke: #93703a } .out { fill: #f6eef8; stroke: #77528a }
  text { fill: #1c2733; font-family: sans-serif; font-size: 14px } .name { font-weight: bold }
  .small { font-size: 12px } .line { stroke: #44576b; fill: none; stroke-width: 1.6 } .tip { fill: #44576b }
  .edge { stroke-dasharray: 6 4 }
  @media (prefers-color-scheme: dark) {
    .ground { fill: #12181f } .box { fill: #1f2c3a; stroke: #7f9fc0 } .pure { fill: #1d3023; stroke: #84b48b }
    .disk { fill: #342a17; stroke: #c9a463 } .out { fill: #2f2136; stroke: #b48cc7 }
    text { fill: #e7edf3 } .line { stroke: #a9bccf } .tip { fill: #a9bccf }
  }
"""
PURPOSE = {
    "cli": "the highside command: one file a group of commands",
    "web": "the bench page",
    "api": "what `import highside` gives",
    "fleet": "many recordings: distributed, and what lots share",
    "papers": "the three papers' tables beside ours",
    "report": "HTML reports, certificates, plots",
    "bench": "the bench session, pure, and what drives it",
    "service": "the daemon; service.rig: surveys, WITS, metrics",
    "config": "what a file of settings may say",
    "importing": "recordings of other programs, with evidence",
    "link": "serial, SocketCAN, python-can, replay, simulated tool",
    "recording": "files: recordings, wire segments, calibration store",
    "codec": "bytes or CAN frames to Frames, without input or output",
    "watch": "whether a calibration still holds, from the hole alone",
    "diagnosis": "which physics a recording asks for that the model lacks",
    "calibration": "methods, records, correction",
    "rotation": "errors by the rotor angle",
    "gyro": "azimuth and gyro bias",
    "physics": "forward model, one library of effects",
    "attitude": "I, T, azimuth and their covariance",
    "shown": "results in a notebook, plots for screen and paper",
    "reading": "everything from outside, read with bounds",
    "errors": "what a user is told, in one line",
    "plugins": "entry points of other packages",
    "words": "what is said, in the reader's language",
    "printable": "text from outside, harmless to a terminal",
}


class Picture:
    """Shapes of one SVG, in the order in which they are drawn."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
            f' role="img" aria-label="{escape(title)}">',
            f"<title>{escape(title)}</title>",
            f"<style>{STYLE}</style>",
            f'<rect class="ground" width="{width}" height="{height}"/>',
        ]

    def box(self, x: int, y: int, width: int, lines: tuple[str, ...], kind: str = "box", height: int = 0) -> None:
        """A box whose first line is its name."""
        height = height or 20 + 17 * len(lines)
        self._parts.append(f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="6"/>')
        for number, line in enumerate(lines):
            weight = "name" if number == 0 else "small"
            self._parts.append(f'<text class="{weight}" x="{x + 10}" y="{y + 23 + 17 * number}">{escape(line)}</text>')

    def text(self, x: int, y: int, line: str) -> None:
        self._parts.append(f'<text class="small" x="{x}" y="{y}">{escape(line)}</text>')

    def arrow(self, *points: tuple[int, int]) -> None:
        """A line through the points, which are at right angles, with a tip at the last."""
        (x0, y0), (x, y) = points[-2], points[-1]
        path = " L".join(f"{a} {b}" for a, b in points)
        self._parts.append(f'<path class="line" d="M{path}"/>')
        if x != x0:
            back = x - 9 if x > x0 else x + 9
            tip = f"{x},{y} {back},{y - 5} {back},{y + 5}"
        else:
            back = y - 9 if y > y0 else y + 9
            tip = f"{x},{y} {x - 5},{back} {x + 5},{back}"
        self._parts.append(f'<polygon class="tip" points="{tip}"/>')

    def frame(self, x: int, y: int, width: int, height: int, label: str) -> None:
        """What belongs together."""
        self._parts.append(f'<rect class="line edge" x="{x}" y="{y}" width="{width}" height="{height}" rx="8"/>')
        self.text(x + 10, y + 18, label)

    def svg(self) -> str:
        return "\n".join([*self._parts, "</svg>"]) + "\n"


def layers() -> list[list[str]]:
    """The contract's layers, highest first; those of one line may not use each other."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text())
    contracts = project["tool"]["importlinter"]["contracts"]
    reported = next(contract["layers"] for contract in contracts if "containers" not in contract)
    return [[name.strip().removeprefix("highside.") for name in re.split("[:|]", line)] for line in reported]


def pure() -> set[str]:
    """Packages that know no link, no service and no event loop, by the contract."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text())
    contracts = project["tool"]["importlinter"]["contracts"]
    reported = next(contract["source_modules"] for contract in contracts if contract["type"] == "forbidden")
    return {name.removeprefix("highside.") for name in reported}


def draw_layers() -> str:
    rows, core, step = layers(), pure(), 54
    picture = Picture(760, 60 + step * len(rows), "Layers of highside, and which way imports go")
    for number, row in enumerate(rows):
        width = (640 - 10 * (len(row) - 1)) // len(row)
        for place, name in enumerate(row):
            kind = "pure" if name in core else "box"
            lines = (name, PURPOSE.get(name, ""))
            picture.box(90 + place * (width + 10), 20 + step * number, width, lines, kind, step - 6)
    picture.arrow((50, 30), (50, 4 + step * len(rows)))
    picture.text(16, 20, "imports")
    picture.text(90, 42 + step * len(rows), "Green: no asyncio, socket, serial, can, MQTT or logging inside.")
    return picture.svg()


def draw_reading() -> str:
    picture = Picture(960, 640, "The way of a reading, from the wire to whoever needs it")
    picture.frame(220, 20, 520, 410, "service.pipeline: synchronous, on the device's time")
    picture.box(20, 60, 170, ("link", "serial, CAN, replay,", "simulated tool"), "box", 76)
    picture.box(20, 180, 170, ("service.recorder", "the wire as it came,", "a thread of its own"), "disk", 76)
    picture.arrow((105, 136), (105, 180))
    picture.arrow((190, 98), (240, 98))
    picture.text(112, 162, "Batch")
    column = (
        ("codec", "Frames, and every byte counted"),
        ("service.monitor", "gaps, repeats, range, stuck bits"),
        ("calibration.correction", "matrix and offset by inclination, temperature"),
        ("attitude", "I and T of the window's mean, with covariance"),
    )
    for number, lines in enumerate(column):
        picture.box(240, 70 + 90 * number, 310, lines, "pure" if number != 1 else "box", 56)
        if number:
            picture.arrow((395, 36 + 90 * number), (395, 70 + 90 * number))
    picture.text(402, 146, "Frame")
    picture.text(402, 236, "good frames, in order; averaging window")
    picture.text(402, 326, "gravity in the tool frame")
    picture.box(580, 160, 140, ("shock", "rms, peaks"), "box", 56)
    picture.box(580, 250, 140, ("drift_stage", "azimuth, gyro bias"), "box", 56)
    picture.box(580, 340, 140, ("rotation.live", "rotor's error off"), "pure", 56)
    picture.arrow((550, 188), (580, 188))
    picture.arrow((650, 306), (650, 340))
    picture.arrow((550, 278), (580, 278))
    picture.arrow((580, 368), (550, 368))
    picture.arrow((395, 396), (395, 470))
    picture.text(402, 460, "Attitude, Survey")
    picture.box(240, 470, 200, ("service.outbox", "numbers; on disk what has", "no PUBACK within 50 ms"), "disk", 76)
    picture.box(500, 470, 180, ("service.publisher", "one task, at least once", "connects for ever"), "box", 76)
    picture.box(770, 470, 170, ("MQTT broker",), "out", 76)
    picture.arrow((440, 508), (500, 508))
    picture.arrow((680, 508), (770, 508))
    picture.box(770, 340, 170, ("service.rig", "surveys, WITS, metrics,", "toolface of the bend"), "out", 76)
    picture.arrow((395, 442), (855, 442), (855, 416))
    picture.box(20, 340, 170, ("bench.session", "bench.driver: instead", "of all that follows"), "pure", 76)
    picture.arrow((240, 188), (205, 188), (205, 378), (190, 378))
    picture.text(20, 434, "raw, never corrected")
    picture.box(
        240, 576, 440, ("health: at an interval, and when the link changes", "the counters of every box"), "out", 52
    )
    picture.arrow((590, 576), (590, 546))
    return picture.svg()


def main() -> None:
    """Write both pictures."""
    (HERE / "architecture-layers.svg").write_text(draw_layers())
    (HERE / "architecture-reading.svg").write_text(draw_reading())


if __name__ == "__main__":
    main()
