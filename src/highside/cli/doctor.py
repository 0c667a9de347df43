"""`highside doctor`: what would keep the service from its work on this machine, and what to do about it."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated

import typer

from highside.cli.run import ConfigOption, SetOption
from highside.cli.say import echo_json


def doctor(
    config: ConfigOption,
    overrides: SetOption = None,
    queue: Annotated[
        int,
        typer.Option(
            "--queue",
            min=0,
            max=20_000,
            metavar="N",
            help="Also publish N messages below the tool's topics and see how many the broker keeps.",
        ),
    ] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as one JSON object.")] = False,
) -> None:
    """Check permissions, ports, bus, broker, clock, disk and calibration. Exit status 1 if something fails."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from highside.config.settings import load
    from highside.printable import printable
    from highside.service.doctor import examine
    from highside.service.findings import CheckResult, Level

    settings = load(config, overrides)
    settings.codec.build()
    findings: list[CheckResult] = []

    async def collect() -> None:
        findings.extend([finding async for finding in examine(settings, queue_messages=queue)])

    console = Console(stderr=True)
    with console.status("examining"):
        asyncio.run(collect())
    failed = [finding for finding in findings if finding.level is Level.FAIL]
    if as_json:
        echo_json(json.dumps({"config": str(config), "ok": not failed, "findings": [f.as_dict() for f in findings]}))
    else:
        colours = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "bold red", Level.SKIP: "dim"}
        table = Table(box=None, show_header=False, padding=(0, 1))
        for f in findings:
            remedy = f"\n-> {printable(f.remedy)}" if f.remedy and f.level is not Level.OK else ""
            text = escape(f"{printable(f.found)}{remedy}")
            table.add_row(f"[{colours[f.level]}]{f.level.value.upper()}[/]", f.check, text)
        Console().print(table)
    if failed:
        raise typer.Exit(1)
