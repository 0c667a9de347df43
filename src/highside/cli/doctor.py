"""`highside doctor`: what would keep the service from its work on this machine, and what to do about it."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.run import ConfigOption, SetOption, ToolOption
from highside.cli.say import echo, echo_json

if TYPE_CHECKING:
    from highside.service.findings import CheckResult


def doctor(
    config: ConfigOption,
    overrides: SetOption = None,
    tool: ToolOption = None,
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

    from highside.config.tools import chosen_tools, has_tools
    from highside.service.doctor import examine
    from highside.service.findings import Level

    every = chosen_tools(config, overrides, tool)
    several = tool is None and has_tools(config)
    for settings in every:
        settings.codec.build()
    found: dict[str, list[CheckResult]] = {settings.tool.id: [] for settings in every}

    async def collect() -> None:
        for settings in every:
            found[settings.tool.id] += [finding async for finding in examine(settings, queue_messages=queue)]

    with Console(stderr=True).status("examining"):
        asyncio.run(collect())
    failed = [name for name, findings in found.items() if any(one.level is Level.FAIL for one in findings)]
    if as_json:
        lists = {name: [one.as_dict() for one in findings] for name, findings in found.items()}
        # a file of one tool is answered as before there were several
        own = {"tools": lists} if several else {"findings": lists[every[0].tool.id]}
        echo_json(json.dumps({"config": str(config), "ok": not failed, **own}))
    else:
        for name, findings in found.items():
            if several:
                echo(f"tool {name}")
            _print(findings)
    if failed:
        raise typer.Exit(1)


def _print(findings: list[CheckResult]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from highside.printable import printable
    from highside.service.findings import Level

    colours = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "bold red", Level.SKIP: "dim"}
    table = Table(box=None, show_header=False, padding=(0, 1))
    for f in findings:
        remedy = f"\n-> {printable(f.remedy)}" if f.remedy and f.level is not Level.OK else ""
        text = escape(f"{printable(f.found)}{remedy}")
        table.add_row(f"[{colours[f.level]}]{f.level.value.upper()}[/]", f.check, text)
    Console().print(table)
