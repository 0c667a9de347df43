"""`highside init`: a few questions, and a configuration that works."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.options import as_options
from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.config.first import Answers

BROKER_WITHIN_S = 0.5
"""A broker of this network that has not answered a connection by then is not taken for one."""


def init(
    file: Annotated[Path, typer.Argument(help="Where to write it.")] = Path("highside.toml"),
    yes: Annotated[
        bool, typer.Option("--yes", help="Ask nothing: take what is found, and what the options say.")
    ] = False,
    tool: Annotated[str | None, typer.Option("--tool", help="Its id, part of the MQTT topics.")] = None,
    port: Annotated[
        str | None, typer.Option("--port", help='Serial port, CAN interface, socket://HOST:PORT or "simulated".')
    ] = None,
    broker: Annotated[str | None, typer.Option("--broker", help="HOST or HOST:PORT of the MQTT broker.")] = None,
    latitude_deg: Annotated[
        float | None, typer.Option("--latitude-deg", min=-90.0, max=90.0, help="Of the site, degrees north.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
) -> None:
    """Write a first configuration of the service, with comments: looks for ports and a broker, asks what is left.

    Nothing is asked where an option says it, and nothing at all with `--yes`.
    """
    from highside.config.first import Answers, first_configuration
    from highside.errors import InputError
    from highside.link.detect import can_interfaces, serial_ports
    from highside.recording.files import write_whole

    if file.exists() and not force:
        raise InputError("is there already", where=str(file), remedy="name another, or overwrite it with --force")
    ports, buses = serial_ports(), can_interfaces()
    found = [*ports, *buses]
    default = replace(Answers(), port=found[0] if found else Answers().port)
    echo(f"found: {', '.join(found) if found else 'no serial port and no CAN interface'}", err=True)
    said = _broker(broker) if broker is not None else (default.broker, default.broker_port)
    heard = _listens(*said)
    echo(f"found: {'a' if heard else 'no'} broker at {said[0]}:{said[1]}", err=True)
    answers = replace(
        default,
        tool=tool or default.tool,
        port=port or default.port,
        broker=said[0],
        broker_port=said[1],
        latitude_deg=latitude_deg,
    )
    if not yes:
        answers = _ask(
            answers,
            tool=tool is None,
            port=port is None,
            broker=broker is None and not heard,
            latitude=latitude_deg is None,
        )
    with as_options("tool", "port", "broker", "latitude_deg"):
        text = first_configuration(answers, can=answers.port in buses)
    write_whole(file, text.encode())
    echo(f"{file}: written. Next: highside check {file}; highside run --config {file}")
    if not heard and answers.broker == said[0]:
        echo("note: without a broker nothing is lost: messages wait in the outbox until there is one", err=True)


def _ask(found: Answers, *, tool: bool, port: bool, broker: bool, latitude: bool) -> Answers:
    """The questions that are left, each with its default."""
    answers = found
    if tool:
        answers = replace(answers, tool=typer.prompt("Name of the tool", default=answers.tool, err=True))
    if port:
        question = 'Port (a serial port, a CAN interface, socket://HOST:PORT, or "simulated")'
        answers = replace(answers, port=typer.prompt(question, default=answers.port, err=True))
    if broker:
        host, number = _broker(typer.prompt("MQTT broker", default=answers.broker, err=True))
        answers = replace(answers, broker=host, broker_port=number)
    if latitude:
        said = typer.prompt(
            "Latitude of the site, degrees north (empty: unknown)", default="", show_default=False, err=True
        )
        answers = replace(answers, latitude_deg=_latitude(said))
    return answers


def _latitude(said: str) -> float | None:
    from highside.errors import InputError

    if not said.strip():
        return None
    try:
        return float(said.replace(",", "."))
    except ValueError:
        raise InputError(f"{said!r} is no number", field="latitude_deg", remedy="give degrees, such as 52.5") from None


def _broker(said: str) -> tuple[str, int]:
    from highside.errors import InputError

    host, _, number = said.rpartition(":") if said.count(":") == 1 else (said, "", "1883")
    if not host or not number.isdigit():
        raise InputError(f"{said!r} is no broker", field="--broker", remedy="give HOST or HOST:PORT")
    return host, int(number)


def _listens(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), BROKER_WITHIN_S):
            return True
    except OSError:
        return False
