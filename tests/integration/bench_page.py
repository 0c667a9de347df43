"""A bench session in a process of its own, with its page, for tests and pictures."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
import socket
import sys
import uuid
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import psutil
import pytest
from broker import Mosquitto
from playwright.async_api import Browser, async_playwright

CHROMIUM = shutil.which("chromium")
HIGHSIDE = Path(sys.executable).parent / "highside"

FILE = """
[tool]
id = "tool-7"
serial = "42"
[simulated]
speed = {speed}
[plan]
{plan}
[bench]
name = "simulated bench"
[store]
directory = "state/calibrations"
sessions = "state/sessions"
[web]
port = 0
"""
JOINT = 'kind = "joint"\nposes = 16'
SIX = 'kind = "conventional"\npositions = 6'
TOKEN = "a token of the page"
RING = 'kind = "balance"\ninclinations_deg = [45.0]'


@contextlib.contextmanager
def served_bench(folder: Path) -> Iterator[tuple[Mosquitto, tuple[str, ...]]]:
    """A broker, and the options by which `serve` offers everything: a bench to begin at with `TOKEN`, the diagnosis."""
    (folder / "benches").mkdir()
    (folder / "benches" / "six.toml").write_text(FILE.format(speed=4.0, plan=SIX))
    (folder / "token").write_text(TOKEN + "\n")
    (folder / "token").chmod(0o600)
    broker = Mosquitto(folder / "broker")
    broker.start()
    try:
        yield broker, (
            "--diagnose", "--bench", str(folder / "benches"), "--set", f"bench.state={folder}/pages",
            "--set", f"web.token_file={folder}/token", "--set", f"mqtt.port={broker.port}",
        )  # fmt: skip
    finally:
        broker.stop()


@dataclass
class BenchProcess:
    """The running command: `link` is the page with the right to command."""

    process: asyncio.subprocess.Process
    folder: Path
    link: str
    said: list[str] = field(default_factory=list)

    @property
    def address(self) -> str:
        return self.link.partition("?")[0]

    @property
    def rss_mb(self) -> float:
        return psutil.Process(self.process.pid).memory_info().rss / 1e6

    @property
    def descriptors(self) -> int:
        return psutil.Process(self.process.pid).num_fds()

    @property
    def token(self) -> str:
        return self.link.partition("token=")[2]

    @property
    def port(self) -> int:
        return int(re.search(r":(\d+)/", self.link).group(1))  # type: ignore[union-attr]

    async def state(self) -> dict:  # type: ignore[type-arg]
        async with httpx.AsyncClient(verify=False, timeout=60.0) as client:
            return (await client.get(f"{self.address}api/session/state")).json()  # type: ignore[no-any-return]

    async def command(self, name: str, *, token: str | None = None, **more: str) -> httpx.Response:
        body = {"name": name, "request_id": os.urandom(8).hex(), "operator": "A. Program"} | more
        headers = {"Authorization": f"Bearer {self.token if token is None else token}"}
        async with httpx.AsyncClient(verify=False, timeout=60.0) as client:
            return await client.post(f"{self.address}api/session/command", json=body, headers=headers)

    async def wait_for(self, *states: str, timeout_s: float = 90.0) -> dict:  # type: ignore[type-arg]
        async with asyncio.timeout(timeout_s):
            while (found := await self.state())["state"] not in states:
                await asyncio.sleep(0.1)
        return found

    async def ended(self) -> int:
        """Ctrl-C once the session is over; the exit status."""
        async with asyncio.timeout(30.0):
            while not any("the session is over" in line for line in self.said):
                await asyncio.sleep(0.05)
            self.process.send_signal(signal.SIGINT)
            return await self.process.wait()


@contextlib.asynccontextmanager
async def bench_process(
    folder: Path, *options: str, plan: str = JOINT, speed: float = 10.0, more: str = ""
) -> AsyncIterator[BenchProcess]:
    """`highside calibrate bench --web` on a simulated bench: hands turn the table, the commands are the caller's."""
    config = folder / "bench.toml"
    config.write_text(FILE.format(speed=speed, plan=plan) + more)
    process = await asyncio.create_subprocess_exec(
        HIGHSIDE, "calibrate", "bench", "--config", config, "--web", "--plain", "--operator", "A. Operator", *options,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stderr is not None and process.stdout is not None
    said: list[str] = []
    drains: list[asyncio.Task[None]] = []
    try:
        async with asyncio.timeout(180.0):
            while not (line := (await process.stderr.readline()).decode()).startswith("bench page:"):
                assert line, f"it ended at once: {said}"
                said.append(line)
        made = BenchProcess(process, folder, line.split()[-1], said)
        drains = [asyncio.create_task(_drain(stream, said)) for stream in (process.stdout, process.stderr)]
        yield made
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        await asyncio.gather(*drains, return_exceptions=True)


async def _drain(stream: asyncio.StreamReader, said: list[str]) -> None:
    while line := await stream.readline():
        said.append(line.decode())


@contextlib.asynccontextmanager
async def chromium(*switches: str) -> AsyncIterator[Browser]:
    """A real browser, with further switches of its command line. Absent: skipped, but a failure under CI."""
    if CHROMIUM is None:
        if os.environ.get("CI") == "true":
            pytest.fail("chromium is not installed, and CI must not skip these tests")
        pytest.skip("needs the browser chromium")
    async with async_playwright() as play:
        browser = await play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *switches])
        try:
            yield browser
        finally:
            await browser.close()


async def page_id(bench: BenchProcess, **cookies: str) -> str:
    """The id of a page that was asked for as an onlooker does, or with the operator's cookie."""
    async with httpx.AsyncClient(cookies=cookies, verify=False, timeout=60.0) as client:
        answer = await client.get(bench.address)
    found = re.search(r"client_id&?[^0-9a-f]*([0-9a-f-]{36})", answer.text)
    assert found, f"the page names its client: {answer.status_code} {answer.text[:200]}"
    return found.group(1)


def handshake_of(page: str) -> str:
    """What the page's script opens its socket with."""
    return (
        f"EIO=4&transport=websocket&client_id={page}&next_message_id=0&implicit_handshake=true"
        f"&document_id={uuid.uuid4()}&tab_id={uuid.uuid4()}"
    )


async def slow_viewer(bench: BenchProcess) -> socket.socket:
    """A page that was asked for and a socket that was opened for it, with the smallest buffer, never read again."""
    query = handshake_of(await page_id(bench))
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    raw.settimeout(30.0)
    await asyncio.to_thread(raw.connect, ("127.0.0.1", bench.port))
    raw.sendall(
        f"GET /_nicegui_ws/socket.io/?{query} HTTP/1.1\r\nHost: 127.0.0.1:{bench.port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    answer = await asyncio.to_thread(raw.recv, 4096)
    assert b"101" in answer.split(b"\r\n")[0], answer
    # socket.io: connect to the default namespace ("40"), as a masked text frame
    mask, text = b"\x01\x02\x03\x04", b"40"
    raw.sendall(bytes([0x81, 0x80 | len(text)]) + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(text)))
    # it is shown the session once, so that it counts as a viewer
    seen = b""
    while b"run_javascript" not in seen:
        more = await asyncio.to_thread(raw.recv, 65536)
        assert more, f"the page let it go: {seen[:200]!r}"
        seen += more
    return raw
