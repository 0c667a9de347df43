"""A first configuration of the service, from a few answers: what `highside init` writes.

Comments are a part of it: each says what the value below it is for and what else it may be. What is written is read
back as the service reads it before anybody gets it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from highside.config.settings import Settings, validate
from highside.reading import parse_toml

SIMULATED = "simulated"
"""The link of whoever has no hardware at hand."""


@dataclass(frozen=True, slots=True)
class Answers:
    """What somebody said, or what stands where they said nothing."""

    tool: str = "tool-1"
    port: str = SIMULATED
    """A serial port, a CAN interface, a URL of pyserial, or "simulated"."""
    baud: int = 921600
    broker: str = "127.0.0.1"
    broker_port: int = 1883
    latitude_deg: float | None = None


def first_configuration(answers: Answers, *, can: bool = False) -> str:
    """The text of the file. `can`: the port is a CAN interface. Raises InputError for an answer that cannot be."""
    text = "\n".join(_lines(answers, can)) + "\n"
    settings_of(text, where="the answers")
    return text


def settings_of(text: str, *, where: str) -> Settings:
    """The file as the service understands it, whatever the environment says. Raises InputError."""
    return validate(parse_toml(text, where=where), where=where, environment=False)


def _lines(of: Answers, can: bool) -> list[str]:
    return [
        "# The service on a tool. `highside check FILE` validates it, `highside run --config FILE` runs it, and",
        "# `highside doctor --config FILE` says what is wrong here. Every field not named has a default:",
        "# `highside check FILE --json` shows them all.",
        "",
        "[tool]",
        "# part of the MQTT topics: highside/ID/attitude",
        f"id = {_text(of.tool)}",
        "",
        "[link]",
        *_link(of, can),
        "",
        "[codec]",
        '# what the tool speaks: "tool" (our own), "vn100", "delimited" (lines of text), "dbc" (CAN);',
        "# `highside detect` tries which gives valid frames",
        f"name = {_text('dbc' if can else 'tool')}",
        "",
        "[pipeline]",
        "# attitudes per second",
        "output_rate_hz = 10.0",
        "",
        "[site]",
        *_site(of),
        "",
        "[mqtt]",
        f"host = {_text(of.broker)}",
        f"port = {of.broker_port}",
        '# username = "tool"             # and password_file = "..."',
        "",
        "# Uncalibrated readings pass with the flag `uncalibrated`. `highside calibrate bench` makes a record,",
        "# `highside calibrate activate RECORD --store FOLDER` puts it in force:",
        "# [calibration]",
        '# store = "calibrations"',
        "",
        "# [metrics]                     # for Prometheus, at http://127.0.0.1:9479/metrics",
    ]


def _link(of: Answers, can: bool) -> list[str]:
    if of.port == SIMULATED:
        return [
            "# a tool inside the program; a real one:",
            '# kind = "serial"',
            '# port = "/dev/serial/by-id/..."',
            f"# baud = {of.baud}",
            'kind = "simulated"',
        ]
    if can:
        return [
            "# up first: ip link set IFACE up type can bitrate 500000",
            'kind = "socketcan"',
            f"interface = {_text(of.port)}",
            "wait_at_start = true",
        ]
    return [
        "# a name below /dev/serial/by-id stays the same whatever else is plugged in",
        'kind = "serial"',
        f"port = {_text(of.port)}",
        f"baud = {of.baud}",
        "# a tool that is not there yet is waited for",
        "wait_at_start = true",
    ]


def _site(of: Answers) -> list[str]:
    if of.latitude_deg is None:
        return ["# of gyros the Earth's rotation is taken off only where this is known", "# latitude_deg = 52.0"]
    return ["# for the Earth's rotation in the gyros, degrees north", f"latitude_deg = {of.latitude_deg!r}"]


def _text(value: str) -> str:
    """A string of TOML: JSON's are."""
    return json.dumps(value)
