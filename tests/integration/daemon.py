"""A real `highside run` in a process of its own, and a subscriber that keeps what it publishes."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import queue
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt

HIGHSIDE = Path(sys.executable).parent / "highside"


class Subscriber:
    """Independent of the product's client library wrapper: paho, QoS 1, its own thread."""

    def __init__(self, port: int, topics: str = "highside/#", *, client_id: str = "", clean: bool = True) -> None:
        self.messages: queue.Queue[tuple[str, bytes, bool, float]] = queue.Queue()
        self.all: list[tuple[str, bytes, bool, float]] = []
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=client_id, clean_session=clean)
        self.subscriptions = 0
        """times that a broker took the subscription: after the start, and after each return of the broker"""
        self._client.on_message = self._on_message
        self._client.on_subscribe = self._on_subscribe
        self._client.on_connect = lambda client, *_: client.subscribe(topics, qos=1)
        self._client.reconnect_delay_set(1, 1)
        self._client.connect_async("127.0.0.1", port, keepalive=30)
        self._client.loop_start()

    def _on_message(self, _client: Any, _data: Any, message: mqtt.MQTTMessage) -> None:
        self.messages.put((message.topic, message.payload, message.retain, time.monotonic()))

    def _on_subscribe(self, *_: Any) -> None:
        self.subscriptions += 1

    def drain(self) -> list[tuple[str, bytes, bool, float]]:
        """Everything received so far."""
        with contextlib.suppress(queue.Empty):
            while True:
                self.all.append(self.messages.get_nowait())
        return self.all

    def payloads(self, name: str) -> list[dict[str, Any]]:
        """All JSON payloads on topics that end with `/name`; what an earlier daemon left retained is no news."""
        return [
            json.loads(payload)
            for topic, payload, retained, _ in self.drain()
            if topic.endswith(f"/{name}") and not retained
        ]

    def latest(self, name: str) -> dict[str, Any] | None:
        found = self.payloads(name)
        return found[-1] if found else None

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Daemon:
    """`highside run` as a child process. Its log is kept for the failure message."""

    def __init__(self, config: Path, *arguments: str, env: dict[str, str] | None = None) -> None:
        self.log_path = config.with_suffix(".log")
        self._log = self.log_path.open("ab")
        self.process = subprocess.Popen(
            [str(HIGHSIDE), "run", "--config", str(config), *arguments],
            stdout=self._log,
            stderr=self._log,
            env={**os.environ, **(env or {})},
        )

    def terminate(self, timeout_s: float = 10.0) -> int:
        """SIGTERM; returns the exit status. Fails if it takes longer."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout_s)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10)

    @property
    def log(self) -> str:
        return self.log_path.read_text(errors="replace")

    def close(self) -> None:
        if self.process.poll() is None:
            self.kill()
        self._log.close()


@contextlib.contextmanager
def running(config: Path, *arguments: str, env: dict[str, str] | None = None) -> Iterator[Daemon]:
    daemon = Daemon(config, *arguments, env=env)
    try:
        yield daemon
    finally:
        daemon.close()


def wait_for(condition: Callable[[], Any], timeout_s: float, what: str = "the condition", daemon: Daemon | None = None):
    """Poll until `condition()` is true and return its value; fail with the daemon's log after `timeout_s`."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if value := condition():
            return value
        if daemon is not None and daemon.process.poll() is not None:
            raise AssertionError(f"the daemon ended while waiting for {what}:\n{daemon.log[-4000:]}")
        time.sleep(0.02)
    log = f"\n{daemon.log[-4000:]}" if daemon is not None else ""
    raise AssertionError(f"waited {timeout_s} s for {what}{log}")


class Pty:
    """A pseudo-terminal whose master end the test plays."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)

    def write_all(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[os.write(self.master, view) :]

    def close(self) -> None:
        with contextlib.suppress(OSError):
            os.close(self.master)
