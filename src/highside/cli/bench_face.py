"""The terminal's faces of a session: a live picture, and plain lines for serial consoles.

Both hold nothing but the session's driver, show its snapshots and send its commands; the web page and MQTT may be used
at the same time. The picture takes single keys, the lines take words.
"""

from __future__ import annotations

import contextlib
import itertools
import sys
from abc import ABC, abstractmethod
from enum import Enum
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ValidationError

from highside.bench.session.labels import LABELS, label, understood
from highside.bench.session.snapshot import (
    Command,
    CommandName,
    PoseState,
    Snapshot,
    VerdictRow,
    VerdictState,
    table_reads,
)
from highside.bench.session.time_to_go import in_words
from highside.cli.say import echo
from highside.cli.typed import typed_keys, typed_lines
from highside.printable import printable

if TYPE_CHECKING:
    from rich.console import Group
    from rich.live import Live
    from rich.table import Table

    from highside.bench.session.driver import SessionDriver

KEYS = {key: name for name, (_, key) in LABELS.items()}
"""Letters of the live picture."""
PLAIN_EVERY_S = 5.0
BAR = 30


class _Face(ABC):
    """What both share: sending commands."""

    def __init__(self, driver: SessionDriver, operator: str) -> None:
        self.driver = driver
        self.operator = operator
        self.answer = ""
        self._ids = itertools.count(1)

    async def send(self, name: CommandName, word: str | None = None) -> None:
        """`word`: the pose, or for `activate` and `rollback` the record that is to be in force."""
        which = "confirm" if name in (CommandName.ACTIVATE, CommandName.ROLLBACK) else "pose"
        try:
            command = Command.model_validate(
                {"name": name, "request_id": f"terminal-{next(self._ids)}", "operator": self.operator}
                | {which: word or None}
            )
        except ValidationError:
            self.answer = f"{word!r} is no name of a {'record' if which == 'confirm' else 'pose'}"
            return
        reply = await self.driver.command(command)
        self.answer = printable(f"{label(name)}: {reply.text}")

    @abstractmethod
    def say(self, text: str) -> None:
        """Tell whoever sits here something that is no part of the session."""

    @abstractmethod
    async def run(self) -> None:
        """Show the session until it has ended."""

    @abstractmethod
    async def typed(self) -> int:
        """Send what is typed until the input ends; how often something was."""


class PlainFace(_Face):
    """Lines: one when something changes, one every few seconds while nothing does; words in (`redo 3`)."""

    def say(self, text: str) -> None:
        echo(text, err=True)

    async def run(self) -> None:
        printed, printed_s = None, -PLAIN_EVERY_S
        async for newest in self.driver.subscribe(5.0):
            snapshot = for_terminal(newest)
            poses = tuple((row.pose, row.state, row.attempts) for row in snapshot.poses)
            key = (snapshot.state, snapshot.target, poses, tuple(f.code for f in snapshot.faults))
            if key != printed or snapshot.elapsed_s - printed_s >= PLAIN_EVERY_S:
                printed, printed_s = key, snapshot.elapsed_s
                self._print(snapshot)

    def _print(self, snapshot: Snapshot) -> None:
        line = describe(snapshot)
        if snapshot.last_rejection:
            line += f"  [{snapshot.last_rejection}]"
        for fault in snapshot.faults:
            line += f"  [{fault.text}{' ' + fault.detail if fault.detail else ''}]"
        echo(line)
        verdict = None if snapshot.result is None else snapshot.result.verdict
        for row in verdict.rows if verdict is not None else ():
            cells = "  ".join(cell for cell in verdict_cells(row) if cell)
            echo(f"           {row.name}: {cells}  {row.verdict}")

    async def typed(self) -> int:
        typed = 0
        async with contextlib.aclosing(typed_lines()) as lines:
            async for line in lines:
                typed += 1
                if not line.strip():
                    continue
                meant = understood(line)
                if meant is None:
                    known = ", ".join(label(name) for name in CommandName)
                    echo(f"? {line.split()[0]!r}: one of {known}")
                    continue
                await self.send(*meant)
                echo(f"> {self.answer}")
        return typed


class RichFace(_Face):
    """The live picture; single keys in. `F` and `B`, which put calibrations in force, are pressed twice."""

    _unconfirmed: tuple[CommandName, str | None] | None = None
    _live: Live | None = None
    _note = ""

    def say(self, text: str) -> None:
        """Within the picture: a line written past it would be in its way, and its head stay behind."""
        self._note = text
        self._draw(self.driver.snapshot())

    def _draw(self, snapshot: Snapshot) -> None:
        if self._live is not None:
            self._live.update(
                picture(for_terminal(snapshot), "\n".join(filter(None, (self.answer, self._note)))), refresh=True
            )

    async def run(self) -> None:
        from rich.console import Console
        from rich.live import Live

        try:
            # what stands in brackets in a name is no mark-up
            console = Console(markup=False, emoji=False)
            with Live(console=console, refresh_per_second=8, auto_refresh=False, transient=False) as self._live:
                async for snapshot in self.driver.subscribe(8.0):
                    self._draw(snapshot)
        finally:
            self._live = None

    async def typed(self) -> int:
        typed = 0
        if not sys.stdin.isatty():
            return typed
        async with contextlib.aclosing(typed_keys()) as keys:
            async for key in keys:
                typed += 1
                if key in KEYS:
                    await self.send(KEYS[key], self._confirmed(KEYS[key]))
        return typed

    def _confirmed(self, name: CommandName) -> str | None:
        """The record meant, where a key that puts one in force is pressed for the second time."""
        snapshot = self.driver.snapshot()
        after = snapshot.meant(name)
        earlier, self._unconfirmed = self._unconfirmed, (name, after)
        if after is None or name not in snapshot.allowed or earlier != self._unconfirmed:
            return None
        self._unconfirmed = None
        return after


def for_terminal(snapshot: Snapshot) -> Snapshot:
    """The same with every text in it printable: names, reasons and remarks come from other faces and from files."""
    return _printable(snapshot)  # type: ignore[no-any-return]


def _printable(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_copy(update={name: _printable(getattr(value, name)) for name in type(value).model_fields})
    if isinstance(value, str) and not isinstance(value, Enum):
        return printable(value)
    return [_printable(item) for item in value] if isinstance(value, list) else value


def picture(snapshot: Snapshot, answer: str = "") -> Group:
    """Everything a technician needs, drawn for a terminal of 80 columns."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.text import Text

    head = Text()
    total = snapshot.plan.poses
    count = f"{snapshot.plan.done}{'' if total is None else f' of {total}'} poses"
    to_go = "" if snapshot.to_go_s is None else f"  {in_words(snapshot.to_go_s)} to go"
    head.append(f"{snapshot.tool}  {snapshot.plan.title}  {count}{to_go}  {snapshot.elapsed_s:.0f} s\n", style="dim")
    head.append(snapshot.prompt, style="bold")
    if snapshot.last_rejection:
        head.append(f"\n{snapshot.last_rejection}", style="yellow")
    for fault in snapshot.faults:
        head.append(f"\n{fault.text} {fault.detail}".rstrip(), style="red")
    keys = "  ".join(
        f"[{'space' if key == ' ' else key}] {label(name)}" for key, name in KEYS.items() if name in snapshot.allowed
    )
    foot = Text(keys, style="dim")
    if answer:
        foot.append(f"\n{answer}")
    result = _verdict(snapshot.result.verdict) if snapshot.result and snapshot.result.verdict else _poses(snapshot)
    return Group(Panel(head, title=f"highside  {snapshot.state.value}"), _gauges(snapshot), foot, result)


def _verdict(verdict: VerdictState) -> Table:
    """The comparisons of a verification or roll test."""
    from rich.table import Table

    limits = f"I {verdict.limit_inc_deg:g}°"
    limits += "" if verdict.limit_tf_deg is None else f", T {verdict.limit_tf_deg:g}°"
    limits += "" if verdict.limit_g_total_g is None else f", Gtotal {1e3 * verdict.limit_g_total_g:g} mg"
    table = Table(box=None, pad_edge=False, title=f"{verdict.verdict.upper()}  calibration {verdict.record[:12]}")
    table.caption = f"limits {limits}; ± is U (k = 2)"
    for name in ("", "I error", "T error", "Gtotal", ""):
        table.add_column(name, justify="right" if name else "left")
    for row in verdict.rows:
        table.add_row(row.name, *verdict_cells(row), row.verdict)
    return table


def verdict_cells(row: VerdictRow) -> tuple[str, str, str]:
    """Error and U of I, T (deg) and Gtotal (mg)."""

    def cell(error: float | None, u: float | None, unit: str, scale: float = 1.0) -> str:
        return "" if error is None or u is None else f"{scale * error:+.4f} ± {scale * u:.4f}{unit}"

    return (
        cell(row.inc_error_deg, row.inc_u_deg, "°"),
        cell(row.tf_error_deg, row.tf_u_deg, "°"),
        cell(row.g_error_g, row.g_u_g, " mg", 1e3),
    )


def _gauges(snapshot: Snapshot) -> Table:
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    attitude, deviation = snapshot.attitude, snapshot.deviation
    if attitude is not None:
        inc, tf = table_reads(attitude, snapshot.target)
        shown = "undefined" if tf is None else f"{tf:7.2f}°"
        table.add_row("now", f"I {inc:7.2f}°   T {shown}   |g| {attitude.g_total:.5f}")
    else:
        table.add_row("now", "no reading")
    if deviation is not None:
        table.add_row("off target", f"{deviation.angle_deg:.3f}° (taken within {deviation.tolerance_deg:.2f}°)")
    if snapshot.stillness is not None:
        share = min(1.0, snapshot.stillness.value / 2.0)
        table.add_row("stillness", f"{_bar(share)} {'still' if snapshot.stillness.still else 'moving'}")
    if snapshot.capture is not None:
        error = snapshot.capture.std_error_g
        text = "" if error is None else f" ± {1e6 * error:.1f} ug"
        table.add_row("hold", f"{_bar(snapshot.capture.progress)} {snapshot.capture.readings} readings{text}")
    if snapshot.temp_c is not None:
        table.add_row("temperature", f"{snapshot.temp_c:.1f} deg C")
    if snapshot.uncertainty is not None:
        inc_std, tf_std = snapshot.uncertainty.rms_inc_std_deg, snapshot.uncertainty.rms_tf_std_deg
        table.add_row("calibration", f"± {inc_std:.4f}° I, ± {tf_std:.4f}° T (1 sigma)")
    return table


def _bar(share: float) -> str:
    full = round(BAR * max(0.0, min(1.0, share)))
    return "█" * full + "░" * (BAR - full)


_MARKS = {PoseState.OPEN: " ", PoseState.DONE: "✓", PoseState.SKIPPED: "-", PoseState.AGAIN: "↺"}
SHOWN = 16


def _poses(snapshot: Snapshot) -> Table:
    """The poses round the one requested; all of them are on the page and in the journal."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for name in ("", "pose", "I", "T", "readings", "± ug", "sigma", ""):
        table.add_column(name, justify="right" if name in ("I", "T", "readings", "± ug", "sigma") else "left")
    rows = snapshot.poses
    at = next((k for k, row in enumerate(rows) if snapshot.target and row.pose == snapshot.target.pose), len(rows))
    first = max(0, min(at - SHOWN // 2, len(rows) - SHOWN))
    for row in rows[first : first + SHOWN]:
        here = snapshot.target is not None and row.pose == snapshot.target.pose
        table.add_row(
            "▶" if here else _MARKS[row.state],
            row.pose,
            "" if row.inc_deg is None else f"{row.inc_deg:.3f}",
            "" if row.tf_deg is None else f"{row.tf_deg:.3f}",
            str(row.readings or ""),
            "" if row.std_error_g is None else f"{1e6 * row.std_error_g:.1f}",
            "" if row.sigmas is None else f"{row.sigmas:.1f}",
            row.reason or "",
            style="bold" if here else None,
        )
    return table


def describe(snapshot: Snapshot) -> str:
    """One line of a session, for consoles that cannot draw."""
    parts = [f"{snapshot.elapsed_s:7.1f} s", snapshot.state.value.ljust(9)]
    total = snapshot.plan.poses
    parts.append(f"{snapshot.plan.done}{'' if total is None else f'/{total}'} poses")
    if snapshot.capture is not None:
        error = snapshot.capture.std_error_g
        parts.append(f"{100 * snapshot.capture.progress:3.0f} %" + ("" if error is None else f" {1e6 * error:.1f} ug"))
    return "  ".join([*parts, snapshot.prompt])
