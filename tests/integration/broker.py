"""Real mosquitto brokers for tests, a TCP proxy that can fall silent, and an independent subscriber."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import aiomqtt
import pytest

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


def require_mosquitto() -> str:
    """The broker's path. Absent: skipped, but a failure under CI."""
    if MOSQUITTO is None:
        if os.environ.get("CI") == "true":
            pytest.fail("mosquitto is not installed, and CI must not skip these tests")
        pytest.skip("needs mosquitto (apt-get install mosquitto)")
    return MOSQUITTO


PORTS = range(12_000, 30_000)
"""Below those that the kernel gives to outgoing connections (`ip_local_port_range`, from 32768 on): between the moment
that a port is found free and its use, a connection of another test must not get it."""


def free_port() -> int:
    """A TCP port of the loopback that nobody uses at the moment."""
    while True:
        port = secrets.choice(PORTS)
        with socket.socket() as sock, contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", port))
            return port


def shipped_config(project_root: Path, folder: Path, port: int, passwords: dict[str, str]) -> Path:
    """`config/mosquitto.conf` with its paths and port moved into `folder`; nothing else is changed."""
    require_mosquitto()
    lines = (project_root / "config" / "mosquitto.conf").read_text()
    acl, passwd, data = folder / "highside.acl", folder / "highside.passwd", folder / "data"
    data.mkdir(exist_ok=True)
    shutil.copy(project_root / "config" / "mosquitto.acl", acl)
    passwd.write_text("")
    for user, password in passwords.items():
        subprocess.run(["mosquitto_passwd", "-b", str(passwd), user, password], check=True, capture_output=True)
    for path in (acl, passwd):
        path.chmod(0o600)
    for old, new in (
        ("listener 1883 127.0.0.1", f"listener {port} 127.0.0.1"),
        ("password_file /etc/mosquitto/highside.passwd", f"password_file {passwd}"),
        ("acl_file /etc/mosquitto/highside.acl", f"acl_file {acl}"),
        ("persistence_location /var/lib/mosquitto/", f"persistence_location {data}/"),
    ):
        assert lines.count(old) == 1, f"config/mosquitto.conf: expected one line {old!r}"
        lines = lines.replace(old, new)
    config = folder / "mosquitto.conf"
    # as root mosquitto would change to a user who may not enter the test's folder
    config.write_text(lines + ("\nuser root\n" if os.geteuid() == 0 else ""))
    return config


class Mosquitto:
    """One mosquitto process on a fixed free port of the loopback; may be killed and started again."""

    def __init__(self, folder: Path, *, config: Path | None = None, port: int | None = None) -> None:
        self._program = require_mosquitto()
        self.port = port or free_port()
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        if config is None:
            # many queued messages and several connections with one client id are what the tests are about
            config = folder / "mosquitto.conf"
            config.write_text(
                f"listener {self.port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 100000\n"
                "persistence false\n" + ("user root\n" if os.geteuid() == 0 else "")
            )
        self._config = config
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start and wait until it accepts connections."""
        with (self._folder / "log.txt").open("ab") as log:
            self._process = subprocess.Popen([self._program, "-c", str(self._config)], stdout=log, stderr=log)
        deadline = time.monotonic() + 10.0
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            except OSError:
                if self._process.poll() is not None or time.monotonic() > deadline:
                    raise RuntimeError(f"mosquitto did not start: {(self._folder / 'log.txt').read_text()}") from None
                time.sleep(0.02)

    def kill(self) -> None:
        """SIGKILL: no will is sent, nothing is saved."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        self._end(signal.SIGTERM)

    def tell(self, number: signal.Signals) -> None:
        """To the process, if it runs: SIGHUP reads the passwords again, SIGUSR1 writes down what is kept."""
        if self._process is not None:
            self._process.send_signal(number)

    def _end(self, number: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(number)
            self._process.wait(10.0)
            self._process = None

    def __enter__(self) -> Mosquitto:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()


class Proxy:
    """A TCP relay to `target`. While `silent` it accepts and reads nothing on, and closes nothing: a black hole."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._passing = asyncio.Event()
        self._passing.set()
        self.refusing = False
        """new connections are closed at once, as by a port that nobody listens on"""
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self.port = 0

    def fall_silent(self) -> None:
        self._passing.clear()

    def speak(self) -> None:
        self._passing.set()

    def cut(self) -> None:
        """Reset every connection."""
        for task in list(self._tasks):
            task.cancel()

    async def __aenter__(self) -> Proxy:
        self._server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            if self.refusing:
                return
            await self._passing.wait()
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target)
            ways = [
                asyncio.create_task(self._relay(reader, far_writer)),
                asyncio.create_task(self._relay(far_reader, writer)),
            ]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                far_writer.close()
        except (OSError, asyncio.CancelledError):
            pass
        finally:
            writer.close()
            self._tasks.discard(task)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                # neither data nor the end of a connection passes a black hole
                await self._passing.wait()
                writer.write(data)
                await writer.drain()
            await self._passing.wait()


class Subscriber:
    """Receives below `prefix` with a durable session (so it misses nothing while the broker lives) and reconnects."""

    def __init__(
        self,
        port: int,
        prefix: str,
        *,
        client_id: str = "watcher",
        username: str | None = None,
        password: str | None = None,
        parse: Callable[[bytes], Any] = json.loads,
    ) -> None:
        self._port, self._prefix, self._client_id, self._parse = port, prefix, client_id, parse
        self._username, self._password = username, password
        self.messages: list[tuple[str, Any]] = []
        """topic (without the prefix) and decoded payload, in the order of arrival"""
        self.statuses: list[tuple[float, str, bool]] = []
        """monotonic time, word, retained flag of what came on the status topic"""
        self.instances: list[str] = []
        """the runs that began or took leave"""
        self.retained: list[tuple[float, str, bytes]] = []
        self.arrived = asyncio.Event()
        self.subscribed = asyncio.Event()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[Subscriber]:
        task = asyncio.create_task(self._run())
        try:
            await asyncio.wait_for(self.subscribed.wait(), 10.0)
            yield self
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            with contextlib.suppress(aiomqtt.MqttError):
                made = aiomqtt.Client(
                    "127.0.0.1",
                    self._port,
                    identifier=self._client_id,
                    username=self._username,
                    password=self._password,
                    clean_session=False,
                    timeout=3.0,
                )
                # as it arrives: what stands in the library's queue when a connection ends was acknowledged, and would
                # be counted as lost by the publisher under test
                made._client.on_message = lambda _paho, _data, message: self._take(message.topic, message)
                async with made as client:
                    await client.subscribe(f"{self._prefix}/#", qos=1)
                    self.subscribed.set()
                    async for _ in client.messages:
                        pass
            await asyncio.sleep(0.05)

    def _take(self, topic: str, message: Any) -> None:
        now = time.monotonic()
        name = topic.removeprefix(f"{self._prefix}/")
        payload = bytes(message.payload)
        if name == "status":
            self.statuses.append((now, payload.decode(), message.retain))
        elif name == "instance":
            self.instances.append(payload.decode().partition(" ")[2])
        elif name == "health":
            self.retained.append((now, name, payload))
        else:
            self.messages.append((name, self._parse(payload)))
        self.arrived.set()

    async def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until `condition` holds, looked at with every arrival; False if it never did."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0.0:
                return False
            self.arrived.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.arrived.wait(), min(left, 0.2))
        return True
