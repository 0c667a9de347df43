"""`highside detect`: listens on every port and says which of them speaks what, at which baud rate."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo, echo_json, report_omitted

if TYPE_CHECKING:
    from highside.codec.registry import CodecTable
    from highside.link.detect import PortFinding


def detect(
    ports: Annotated[
        list[str] | None, typer.Option("--port", help="Listen on this port (or URL) only; may be repeated.")
    ] = None,
    bauds: Annotated[
        list[int] | None, typer.Option("--baud", min=1, max=12_000_000, help="Try this rate only; may be repeated.")
    ] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, max=60.0, help="Time to listen at each rate.")] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as one JSON array.")] = False,
) -> None:
    """Find the ports, codecs and baud rates that give valid frames. Exit status 1 when there are none."""
    from concurrent.futures import ThreadPoolExecutor

    from highside.codec.registry import faults
    from highside.errors import InputError, Refused
    from highside.link.detect import BAUDS, can_interfaces, probe_can, probe_serial, serial_ports

    if ports is not None and "" in ports:
        raise InputError("is empty", field="--port", remedy="name a device such as /dev/ttyUSB0, or leave it out")
    known_can = can_interfaces()
    interfaces = known_can if ports is None else [port for port in ports if port in known_can]
    lines = serial_ports() if ports is None else [port for port in ports if port not in known_can]
    rates = tuple(bauds) if bauds else BAUDS
    codecs = _can_codecs() if interfaces else []
    report_omitted("codec", faults())
    with ThreadPoolExecutor(max_workers=16) as pool:
        # all at once: most ports are silent, and waiting for one after the other would take minutes
        work = [pool.submit(probe_serial, line, rates, seconds) for line in lines]
        work += [pool.submit(probe_can, interface, codecs, seconds) for interface in interfaces]
        findings = [done.result() for done in work]
    findings.sort(key=lambda finding: (finding.codec is None, -finding.share, finding.port))
    if as_json:
        echo_json(json.dumps([finding.as_dict() for finding in findings]))
    elif findings:
        _table(findings)
    best = findings[0] if findings else None
    if best is None:
        raise Refused("no serial port and no CAN interface on this machine; name one with --port")
    if best.codec is None:
        raise Refused(f"none of {len(findings)} ports gives valid frames: is the tool powered and connected?")
    if not as_json:
        echo(_configuration(best))


def _can_codecs() -> list[CodecTable]:
    """The CAN codecs that need no set-up; what one of them needs (an extra that reads DBC files) may be missing."""
    from highside.codec.registry import detectable
    from highside.errors import InputError

    found = []
    for name, table in detectable("can").items():
        try:
            settings = table.model_validate({"name": name})
            settings.build()
        except (InputError, ImportError):
            continue
        found.append(settings)
    return found


def _table(findings: list[PortFinding]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading, justify in (
        ("port", "left"),
        ("baud", "right"),
        ("codec", "left"),
        ("frames", "right"),
        ("bytes", "right"),
        ("in frames", "right"),
        ("note", "left"),
    ):
        table.add_column(heading, justify=justify, overflow="fold")  # type: ignore[arg-type]
    for finding in findings:
        table.add_row(
            finding.port,
            str(finding.baud or "-"),
            finding.codec or "-",
            str(finding.frames),
            str(finding.bytes),
            f"{100.0 * finding.share:.0f} %",
            finding.note,
        )
    Console().print(table)


def _configuration(finding: PortFinding) -> str:
    """The tables for the configuration file."""
    if finding.kind == "socketcan":
        link = f'[link]\nkind = "socketcan"\ninterface = "{finding.port}"'
    else:
        link = f'[link]\nkind = "serial"\nport = "{finding.port}"\nbaud = {finding.baud}'
    return f'\nFor the configuration:\n{link}\n\n[codec]\nname = "{finding.codec}"'
