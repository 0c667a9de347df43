"""Telling systemd how the service is: the sd_notify protocol, spoken without a library.

systemd hands the service the address of a datagram socket in NOTIFY_SOCKET and takes lines `KEY=VALUE` from it. Outside
of systemd the variable is absent and every call here does nothing, so the service need not know where it runs.
A message is sent without waiting: a manager that does not read must not hold up the acquisition; what could not be
sent is counted. That the service is ready, and that a reload began, is owed until it was taken: a manager that has not
heard of it ends the service after `TimeoutStartSec`. It goes before the next status or sign of life.

Protocol: sd_notify(3), sd_watchdog_enabled(3), systemd.service(5) (`Type=notify`, `Type=notify-reload`).
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Self


class Notifier:
    """The service's line to its manager. Also a context manager that closes the socket."""

    def __init__(self, environ: Mapping[str, str] | None = None) -> None:
        """`environ` defaults to the process environment. An address that is no socket address is taken as absent."""
        environ = os.environ if environ is None else environ
        self.lost = 0
        """messages that the manager's socket did not take"""
        self.watchdog_interval_s = _watchdog_interval_s(environ)
        """longest allowed time between two `watchdog()` calls, None where nobody watches this process"""
        self._owed: list[tuple[str, ...]] = []
        """what changes the manager's mind, in its order, and was not taken yet: at most READY, RELOADING, READY"""
        self._address = _socket_address(environ.get("NOTIFY_SOCKET", ""))
        self._socket: socket.socket | None = None
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    @property
    def connected(self) -> bool:
        """Whether a manager gave us an address."""
        return self._socket is not None

    def ready(self, status: str = "") -> bool:
        """The service does its work now (also: a reload has ended)."""
        return self._owe("READY=1", *_status_lines(status))

    def status(self, text: str) -> bool:
        """One line for `systemctl status`."""
        self._pay()
        return self._send(*_status_lines(text))

    def watchdog(self) -> bool:
        """The pipeline has made progress since the last call."""
        self._pay()
        return self._send("WATCHDOG=1")

    def reloading(self, status: str = "") -> bool:
        """A reload begins; `ready()` ends it, whether the new configuration was taken or not."""
        # systemd pairs the message with its own SIGHUP by this time stamp of CLOCK_MONOTONIC
        stamp_us = time.monotonic_ns() // 1_000
        # a reload that the manager has not heard of is over for it, too; that the service began is not
        self._owed = self._owed[:1] if self._owed and self._owed[0][0] == "READY=1" else []
        return self._owe("RELOADING=1", f"MONOTONIC_USEC={stamp_us}", *_status_lines(status))

    def stopping(self, status: str = "") -> bool:
        """The service is on its way out."""
        self._owed.clear()
        return self._send("STOPPING=1", *_status_lines(status))

    def close(self) -> None:
        """Give the socket back; later calls do nothing."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _owe(self, *lines: str) -> bool:
        """Send what must arrive, now or with a later message. Returns whether it was taken now."""
        if self._socket is None:
            return False
        self._owed.append(lines)
        return self._pay()

    def _pay(self) -> bool:
        """Send what is owed, in its order. Returns whether nothing is left."""
        while self._owed and self._send(*self._owed[0]):
            del self._owed[0]
        return not self._owed

    def _send(self, *lines: str) -> bool:
        """Send one datagram. Returns whether the manager's socket took it (False outside of systemd)."""
        if self._socket is None or self._address is None or not lines:
            return False
        try:
            self._socket.sendto("\n".join(lines).encode(), self._address)
        except OSError:
            # full, gone or forbidden: the watchdog decides what silence means, not we
            self.lost += 1
            return False
        return True


def _status_lines(text: str) -> tuple[str, ...]:
    """`STATUS=` with the text held to one line, or nothing."""
    return (f"STATUS={' '.join(text.split())}",) if text else ()


def _socket_address(value: str) -> str | None:
    """The address as the socket module wants it: a leading `@` stands for the abstract name space."""
    if value.startswith("@") and len(value) > 1:
        return "\0" + value[1:]
    return value if value.startswith("/") else None


def _watchdog_interval_s(environ: Mapping[str, str]) -> float | None:
    """The interval that the manager set for this very process, in seconds."""
    try:
        interval_us = int(environ.get("WATCHDOG_USEC", ""))
        # the variable is inherited by children, whom it does not concern
        pid = int(environ.get("WATCHDOG_PID") or os.getpid())
    except ValueError:
        return None
    return interval_us / 1e6 if interval_us > 0 and pid == os.getpid() else None
