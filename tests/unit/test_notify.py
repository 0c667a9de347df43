"""The service's messages to systemd, received on a real datagram socket."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from highside.service.notify import Notifier


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """A manager's socket and the value of NOTIFY_SOCKET that leads to it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.settimeout(5.0)
        if request.param == "path":
            address = str(tmp_path / "notify")
            receiver.bind(address)
            yield receiver, address
        else:
            name = f"highside-test-{os.getpid()}-{time.monotonic_ns()}"
            receiver.bind("\0" + name)
            yield receiver, "@" + name


def test_each_state_reaches_the_manager_in_its_own_datagram(manager: tuple[socket.socket, str]) -> None:
    receiver, address = manager
    with Notifier({"NOTIFY_SOCKET": address}) as notifier:
        assert notifier.connected
        assert notifier.ready("12 frames/s")
        assert notifier.status("two\nlines")
        assert notifier.watchdog()
        assert notifier.stopping()
        assert [receiver.recv(4096) for _ in range(4)] == [
            b"READY=1\nSTATUS=12 frames/s",
            b"STATUS=two lines",
            b"WATCHDOG=1",
            b"STOPPING=1",
        ]


def test_a_reload_carries_the_monotonic_time_at_which_it_began(manager: tuple[socket.socket, str]) -> None:
    receiver, address = manager
    with Notifier({"NOTIFY_SOCKET": address}) as notifier:
        before = time.monotonic_ns() // 1_000
        notifier.reloading("reading the configuration")
        after = time.monotonic_ns() // 1_000
    lines = receiver.recv(4096).decode().splitlines()
    assert lines[0] == "RELOADING=1"
    assert lines[2] == "STATUS=reading the configuration"
    key, stamp = lines[1].split("=")
    assert key == "MONOTONIC_USEC"
    assert before <= int(stamp) <= after


@pytest.mark.parametrize("environ", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1"}])
def test_outside_of_systemd_nothing_happens(environ: dict[str, str]) -> None:
    notifier = Notifier(environ)
    assert not notifier.connected
    assert not notifier.ready()
    assert notifier.lost == 0
    assert notifier.watchdog_interval_s is None
    notifier.close()


def test_a_manager_that_does_not_read_never_holds_up_the_service(manager: tuple[socket.socket, str]) -> None:
    _, address = manager
    with Notifier({"NOTIFY_SOCKET": address}) as notifier:
        begin = time.monotonic()
        sent = sum(notifier.watchdog() for _ in range(20_000))
        assert time.monotonic() - begin < 30.0
        assert 0 < sent < 20_000
        assert notifier.lost == 20_000 - sent


def test_that_the_service_is_ready_arrives_when_the_manager_reads_again(
    manager: tuple[socket.socket, str],
) -> None:
    """Type=notify: who is not heard to be ready is ended."""
    receiver, address = manager
    with Notifier({"NOTIFY_SOCKET": address}) as notifier:
        while notifier.watchdog():
            pass
        assert not notifier.ready("tool t1")
        assert not notifier.status("12 frames/s")
        received = _all(receiver)
        assert set(received) == {b"WATCHDOG=1"}
        assert notifier.watchdog()
        assert _all(receiver) == [b"READY=1\nSTATUS=tool t1", b"WATCHDOG=1"]
        assert notifier.watchdog()
        assert _all(receiver) == [b"WATCHDOG=1"], "once"


def test_a_reload_that_a_full_socket_did_not_take_is_told_whole_and_in_order(
    manager: tuple[socket.socket, str],
) -> None:
    receiver, address = manager
    with Notifier({"NOTIFY_SOCKET": address}) as notifier:
        while notifier.watchdog():
            pass
        notifier.ready("begun")
        for _ in range(3):
            notifier.reloading()
            notifier.ready("reloaded")
        _all(receiver)
        notifier.status("12 frames/s")
        words = [message.split(b"\n")[0] for message in _all(receiver)]
        assert words == [b"READY=1", b"RELOADING=1", b"READY=1", b"STATUS=12 frames/s"]


def test_a_manager_that_comes_late_hears_that_the_service_is_ready(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    with Notifier({"NOTIFY_SOCKET": address}) as notifier:
        assert not notifier.ready()
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
            receiver.bind(address)
            assert notifier.status("on")
            assert _all(receiver) == [b"READY=1", b"STATUS=on"]


def _all(receiver: socket.socket) -> list[bytes]:
    """What waits in the socket."""
    receiver.setblocking(False)
    received = []
    with contextlib.suppress(BlockingIOError):
        while True:
            received.append(receiver.recv(4096))
    return received


def test_a_manager_that_has_gone_is_counted_not_raised(tmp_path: Path) -> None:
    with Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}) as notifier:
        assert not notifier.ready()
        assert notifier.lost == 1


@pytest.mark.parametrize(
    ("environ", "interval_s"),
    [
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}, 30.0),
        ({"WATCHDOG_USEC": "1500000"}, 1.5),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid() + 1)}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_interval_is_that_of_this_process(environ: dict[str, str], interval_s: float | None) -> None:
    assert Notifier(environ).watchdog_interval_s == interval_s
