"""`highside toolface set | show`: the offset from the sensor's scribe line to the motor's bend, with author and
time."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from typing import Annotated

import typer

from highside.cli.run import ConfigOption, SetOption
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
    overrides: SetOption = None,
) -> None:
    """Set the offset. A running service takes it within a second; every setting is kept. Negative: -- -12.5"""
    from highside.config.settings import load
    from highside.service.places import state_dir
    from highside.service.rig.toolface import ToolfaceLog

    setting = ToolfaceLog(state_dir(load(config, overrides))).set(offset, author, time.time(), note)
    echo(f"toolface offset {setting.previous_deg:g} deg -> {setting.offset_deg:g} deg, set by {setting.author}")


@app.command("show")
def show(
    config: ConfigOption,
    as_json: Annotated[bool, typer.Option("--json", help="Print all settings as one JSON array.")] = False,
    overrides: SetOption = None,
) -> None:
    """Show every setting, the last one is in force."""
    from highside.config.settings import load
    from highside.service.places import state_dir
    from highside.service.rig.toolface import ToolfaceLog

    settings = ToolfaceLog(state_dir(load(config, overrides))).history()
    if as_json:
        echo_json(json.dumps([setting.as_dict() for setting in settings]))
        return
    if not settings:
        echo("never set: the offset is 0 deg")
    for setting in settings:
        when = datetime.fromtimestamp(setting.t, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        note = f"  {setting.note}" if setting.note else ""
        echo(f"{when}  {setting.offset_deg:8.3f} deg  by {setting.author}{note}")
