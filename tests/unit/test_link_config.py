"""The [link] table: every kind makes its transport, and what cannot be is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from highside.config.links import LinkConfig, SimulatedLink
from highside.link.device import SimulatedTransport
from highside.link.pythoncan import PythonCanTransport
from highside.link.replay import ReplayTransport
from highside.link.serial import SerialTransport
from highside.link.socketcan import SocketCanTransport

ADAPTER: TypeAdapter[Any] = TypeAdapter(LinkConfig)


@pytest.mark.parametrize(
    ("table", "transport", "carries"),
    [
        ({"kind": "serial", "port": "/dev/ttyUSB0", "baud": 921600}, SerialTransport, "bytes"),
        ({"kind": "serial", "port": "rfc2217://h:1", "parity": "E", "stopbits": 1.5}, SerialTransport, "bytes"),
        ({"kind": "socketcan", "interface": "can0", "can_ids": [0x24, 0x18FF50E5]}, SocketCanTransport, "can"),
        ({"kind": "python-can", "interface": "virtual", "channel": 0, "options": {"a": 1}}, PythonCanTransport, "can"),
        ({"kind": "simulated"}, SimulatedTransport, "bytes"),
        ({"kind": "simulated", "interface": "vcan0", "motion": "still"}, SimulatedTransport, "can"),
    ],
)
def test_each_kind_makes_a_fresh_transport_of_its_own(table: dict[str, Any], transport: type, carries: str) -> None:
    link = ADAPTER.validate_python(table)
    first, second = link.transport(), link.transport()
    assert type(first) is type(second) is transport
    assert first is not second
    assert link.carries == carries


def test_a_replay_needs_its_file_and_is_never_reopened_for_silence(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    with pytest.raises(ValidationError, match=r"no such file: .*a\.log"):
        ADAPTER.validate_python({"kind": "replay", "path": str(path)})
    path.write_text("")
    link = ADAPTER.validate_python({"kind": "replay", "path": str(path), "speed": 0})
    assert isinstance(link.transport(), ReplayTransport)
    assert link.supervisor().stale_after_s == 0.0
    assert link.carries is None


def test_the_defaults_report_silence_within_2_s_and_reopen_within_10_s() -> None:
    settings = ADAPTER.validate_python({"kind": "serial", "port": "x"}).supervisor()
    assert 0.0 < settings.stale_after_s <= 2.0
    assert settings.stale_after_s < settings.reopen_after_s <= 10.0


@pytest.mark.parametrize(
    ("change", "same"),
    [({"stale_after_s": 1.0}, True), ({"wait_at_start": True}, True), ({"baud": 9600}, False), ({"port": "y"}, False)],
)
def test_limits_alone_leave_a_line_what_it_is(change: dict[str, Any], same: bool) -> None:
    table = {"kind": "serial", "port": "x"}
    before, after = ADAPTER.validate_python(table), ADAPTER.validate_python(table | change)
    assert before != after
    assert after.same_line(before) is same
    assert not ADAPTER.validate_python({"kind": "simulated"}).same_line(before)


def test_the_simulated_tool_is_the_same_for_every_attempt() -> None:
    link = SimulatedLink(kind="simulated", seed=3)
    assert link.transport().device is link.transport().device  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ({"kind": "serial"}, "port"),
        ({"kind": "serial", "port": "x", "bauds": 9600}, "bauds"),
        ({"kind": "serial", "port": "x", "stopbits": 3}, "1, 1.5 or 2"),
        ({"kind": "serial", "port": "x", "parity": "odd"}, "parity"),
        ({"kind": "serial", "port": "x", "stale_after_s": 5.0, "reopen_after_s": 3.0}, "reopen_after_s must not"),
        ({"kind": "serial", "port": "x", "backoff_initial_s": 5.0, "backoff_max_s": 1.0}, "backoff_max_s must not"),
        ({"kind": "socketcan", "interface": "a name that is too long"}, "interface"),
        ({"kind": "socketcan", "interface": "can0", "can_ids": [0x20000000]}, "can_ids"),
        ({"kind": "bluetooth"}, "does not match any of the expected tags"),
        ({"port": "x"}, "Unable to extract tag"),
    ],
)
def test_what_cannot_be_is_refused_by_its_name(table: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValidationError, match=complaint):
        ADAPTER.validate_python(table)
