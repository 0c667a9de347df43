"""A real `highside run` in a process of its own, and a subscriber that keeps what it publishes."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
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
from typing import Any, Generic, TypeVar

import paho.mqtt.client as mqtt
from pydantic import BaseModel

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


Reply = TypeVar("Reply", bound=BaseModel)


class Operator(Generic[Reply]):
    """Says commands to a part of a tool, `highside/TOOL/PART`, and hears its replies."""

    _ids = itertools.count()

    def __init__(self, port: int, topic: str, ear: Subscriber, reply: type[Reply]) -> None:
        self._topic, self._ear, self._reply = topic, ear, reply
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def say(self, daemon: Daemon, **command: Any) -> Reply:
        """The reply, within ten seconds."""
        name = f"c{next(self._ids)}"
        self._client.publish(f"{self._topic}/command", json.dumps({"id": name, **command}), qos=1)
        replies = f"{self._topic.rsplit('/', 1)[1]}/reply"

        def replied() -> dict[str, Any] | None:
            return next((reply for reply in self._ear.payloads(replies) if reply["id"] == name), None)

        return self._reply.model_validate(wait_for(replied, 10.0, f"a reply to {command}", daemon))

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def is_held(path: str) -> bool:
    """Whether somebody has the port open for himself alone."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def still_tool(folder: Path, port: int, extra: str = "", motion: str = 'motion = "still"') -> Path:
    """The configuration of a simulated tool at rest, its broker at `port`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\nserial = "SN 7"\n[link]\nkind = "simulated"\n{motion}\nnoise_density_g = 2e-5\n'
        f'[codec]\nname = "tool"\n[survey]\nstill_s = 2.0\n[mqtt]\nport = {port}\n'
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n{extra}'
    )
    return path


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
