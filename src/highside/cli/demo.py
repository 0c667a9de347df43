"""`highside demo`: a simulated tool through the production path, as a live table."""

from __future__ import annotations

import asyncio
import json
import math
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.linux import linux_alone
from highside.cli.say import echo, echo_json

if TYPE_CHECKING:
    from rich.table import Table

    from highside.service.demo import DemoState

LINE_EVERY_S = 1.0


def demo(
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.5, max=86_400.0, help="End by itself after S seconds.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="End with one line of JSON.")] = False,
) -> None:
    """Simulated tool -> pty -> the real pipeline -> its outbox: I and T, live. Needs no hardware and no broker."""
    linux_alone("demo")
    from rich.console import Console
    from rich.live import Live

    from highside.errors import InputError
    from highside.service.demo import run_demo

    if seconds is not None and not math.isfinite(seconds):
        raise InputError(f"{seconds} is no finite number", where="--seconds", remedy="give a number such as 10")
    console = Console(stderr=as_json)
    if console.is_terminal:
        with Live(console=console, refresh_per_second=8, transient=False) as live:
            last = asyncio.run(run_demo(seconds, lambda snapshot: live.update(live_table(snapshot))))
    else:
        printed_s = 0.0
        printed = 0

        def line(snapshot: DemoState) -> None:
            nonlocal printed_s, printed
            for at_s, text in snapshot.events[printed:]:
                echo(f"{at_s:7.1f} s  {text}", err=as_json)
            printed = len(snapshot.events)
            if snapshot.elapsed_s - printed_s >= LINE_EVERY_S and snapshot.latest is not None:
                printed_s = snapshot.elapsed_s
                echo(one_line(snapshot), err=as_json)

        last = asyncio.run(run_demo(seconds, line))
    if as_json:
        echo_json(json.dumps(last.summary()))
    else:
        console.print(
            f"{last.frames} frames, {last.published} attitudes delivered, {last.lost} lost,"
            f" {_rms_text(last)} against the truth",
            soft_wrap=True,
        )


def _rms_text(snapshot: DemoState) -> str:
    summary = snapshot.summary()
    inc, tf = summary["inc_error_rms_deg"], summary["tf_error_rms_deg"]
    if inc is None:
        return "no attitude"
    said = f"rms error I {inc:.4f} deg, T {tf:.4f} deg"
    raw_inc, raw_tf = summary["inc_error_rms_uncorrected_deg"], summary["tf_error_rms_uncorrected_deg"]
    if raw_inc is not None:
        said += f" (uncorrected: I {raw_inc:.4f} deg, T {raw_tf:.4f} deg)"
    shaken = summary["inc_error_rms_shaken_deg"]
    return said if shaken is None else f"{said}, I {shaken:.2f} deg while shaken,"


def one_line(snapshot: DemoState) -> str:
    """The state as a line, for consoles that cannot draw."""
    latest = snapshot.latest or {}
    if not snapshot.linked:
        return f"{snapshot.elapsed_s:7.1f} s  no data from the tool"
    return (
        f"{snapshot.elapsed_s:7.1f} s  I {_angle(latest, 'inc')}  T {_angle(latest, 'tf')}"
        f"  uncorrected I {snapshot.raw_inc_deg:.3f} T {snapshot.raw_tf_deg:.2f} deg"
        f"  |g| {latest.get('g_total', 0.0):.5f}  {snapshot.frames} frames  {snapshot.published} published"
        f"  {snapshot.lost} lost  {' '.join(latest.get('flags', []))}"
    )


def _angle(payload: dict[str, object], name: str) -> str:
    value, std = payload.get(f"{name}_deg"), payload.get(f"{name}_std_deg")
    if not isinstance(value, float) or not isinstance(std, float):
        return "   unknown         "
    return f"{value:8.3f} ± {std:.3f} deg"


def _errors(table: Table, snapshot: DemoState) -> None:
    """What the calibration buys: rms errors against the truth, with it and without."""
    summary = snapshot.summary()
    for label, key in (("error of I, rms", "inc"), ("error of T, rms", "tf")):
        with_it, without = summary[f"{key}_error_rms_deg"], summary[f"{key}_error_rms_uncorrected_deg"]
        if with_it and without:
            table.add_row(label, f"{with_it:.4f}°", "", f"{without:.4f}°", f"{without / with_it:.0f} times less")


def live_table(snapshot: DemoState) -> Table:
    """The live picture: attitude with uncertainty beside the truth, rates, counts, health."""
    from rich.table import Table

    latest = snapshot.latest or {}
    p99 = snapshot.latency_p99_ms()
    table = Table(title=f"highside demo   {snapshot.elapsed_s:6.1f} s", title_justify="left", min_width=74)
    for name, justify in (
        ("", "left"), ("corrected", "right"), ("± 1 sigma", "right"), ("uncorrected", "right"), ("truth", "right")
    ):  # fmt: skip
        table.add_column(name, justify=justify)  # type: ignore[arg-type]

    def row(label: str, key: str, raw: float, truth: float) -> None:
        # what came before the plug was pulled is no reading of now
        value, std = (latest.get(f"{key}_deg"), latest.get(f"{key}_std_deg")) if snapshot.linked else (None, None)
        raw, truth = (raw, truth) if snapshot.linked else (math.nan, math.nan)
        table.add_row(
            label,
            "-" if value is None else f"{value:.3f}°",
            "-" if std is None else f"{std:.3f}°",
            "-" if raw != raw else f"{raw:.3f}°",
            "-" if truth != truth else f"{truth:.3f}°",
        )

    row("[bold]inclination I[/]", "inc", snapshot.raw_inc_deg, snapshot.truth_inc_deg)
    row("[bold]toolface T[/]", "tf", snapshot.raw_tf_deg, snapshot.truth_tf_deg)
    _errors(table, snapshot)
    g_total = latest.get("g_total")
    table.add_row("|g|", "-" if g_total is None else f"{g_total:.5f} g", "", "", "1.00000 g")
    table.add_section()
    rate = snapshot.frames / snapshot.elapsed_s if snapshot.elapsed_s else 0.0
    table.add_row("frames", f"{snapshot.frames}", f"{rate:.0f} /s", "", "")
    out = snapshot.published / snapshot.elapsed_s if snapshot.elapsed_s else 0.0
    table.add_row("attitudes delivered", f"{snapshot.published}", f"{out:.1f} /s", "", f"{snapshot.lost} lost")
    table.add_row("last byte to delivery", "-" if p99 is None else f"{p99:.1f} ms", "p99", "", "")
    if snapshot.survey is not None:
        survey = snapshot.survey
        table.add_row(
            f"survey {snapshot.surveys}",
            f"I {survey['inc_deg']:.3f}°  T {survey['tf_deg']:.2f}°",
            f"{survey['inc_std_deg']:.4f}° {survey['tf_std_deg']:.3f}°",
            "",
            f"{survey['n']} readings",
        )
    health = snapshot.health or {}
    state = health.get("link", {}).get("state", "-")
    balance = health.get("balance", {})
    table.add_row(
        "health",
        f"link {state}",
        "counters add up" if balance and all(balance.values()) else "-",
        "",
        ", ".join(health.get("alarms", [])) or "no alarm",
    )
    used = " ".join([*latest.get("flags", []), f"calibration {str(latest.get('cal_id', '-'))[:12]}"])
    table.caption = "\n".join([used, *(f"{at_s:5.1f} s  {text}" for at_s, text in snapshot.events)])
    table.caption_justify = "left"
    return table
