"""`highside toolface set | show`: the offset from the sensor's scribe line to the motor's bend, with author and
time."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from typing import Annotated

import typer

from highside.cli.run import ConfigOption, SetOption, ToolOption
from highside.cli.say import echo, echo_json

app = typer.Typer(
    name="toolface",
    no_args_is_help=True,
    help="The offset from the sensor's scribe line to the motor's bend, and its history.",
)


@app.command("set")
def set_offset(
    offset: Annotated[
        float, typer.Argument(help="Degrees, clockwise looking down-hole, from the scribe line to the motor's bend.")
    ],
    config: ConfigOption,
    author: Annotated[str, typer.Option("--author", help="Who sets it.")],
    note: Annotated[str, typer.Option("--note", help="Why, or how it was measured.")] = "",
    tool: Annotated[
        str | None, typer.Option("--tool", metavar="ID", help="Of a file with [[tools]]: which of them.")
    ] = None,
    overrides: SetOption = None,
) -> None:
    """Set the offset. A running service takes it within a second; every setting is kept. Negative: -- -12.5"""
    from highside.config.tools import one_tool
    from highside.service.places import state_dir
    from highside.service.rig.toolface import ToolfaceLog

    setting = ToolfaceLog(state_dir(one_tool(config, overrides, tool))).set(offset, author, time.time(), note)
    echo(f"toolface offset {setting.previous_deg:g} deg -> {setting.offset_deg:g} deg, set by {setting.author}")


@app.command("show")
def show(
    config: ConfigOption,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print all settings as one JSON array; of several tools an object of them.")
    ] = False,
    tool: ToolOption = None,
    overrides: SetOption = None,
) -> None:
    """Show every setting, the last one is in force."""
    from highside.config.tools import chosen_tools, has_tools
    from highside.service.places import state_dir
    from highside.service.rig.toolface import ToolfaceLog

    every = chosen_tools(config, overrides, tool)
    several = tool is None and has_tools(config)
    histories = {one.tool.id: ToolfaceLog(state_dir(one)).history() for one in every}
    if as_json:
        made = {name: [setting.as_dict() for setting in settings] for name, settings in histories.items()}
        echo_json(json.dumps(made if several else made[every[0].tool.id]))
        return
    for name, settings in histories.items():
        if several:
            echo(f"tool {name}:")
        if not settings:
            echo("never set: the offset is 0 deg")
        for setting in settings:
            when = datetime.fromtimestamp(setting.t, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
            note = f"  {setting.note}" if setting.note else ""
            echo(f"{when}  {setting.offset_deg:8.3f} deg  by {setting.author}{note}")
