"""What those who look at the tools' page cost the acquisition: 3,840 frames/s alone, then beside a crowd.

    python -m tests.bench.viewers_cost [--seconds 30] [--viewers 100] [--json]

The same tool on a pty, the same broker, `highside run` once without and once with `highside serve` and its viewers.
They look at the page of the tool with its picture in three dimensions. Half of these read and draw all that they are
sent, in four languages; of the others most opened a socket with the smallest buffer and never read, and a fifth are
hostile: broken frames, long bodies, page after page that is never looked at. Prints frames lost, the loop's lag (99.9
%, and what of it the service itself had computed), the processor that service and page took, and the pictures that a
reading viewer got. Ends with status 1 if a frame was lost, or where there is no mosquitto.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urljoin, urlsplit

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "integration")]

import httpx  # noqa: E402
import psutil  # noqa: E402
import websockets  # noqa: E402
from bench_page import HIGHSIDE, handshake_of, page_id, slow_viewer  # noqa: E402
from broker import MOSQUITTO, Mosquitto  # noqa: E402
from daemon import Subscriber  # noqa: E402
from test_soak import SENDER, SERIAL_RATE  # noqa: E402

WARM_S = 5.0
"""Seconds before the processor is counted: imports and the first pages are over."""


@dataclass
class Page:
    """The address of a page, as the viewers need it."""

    address: str

    @property
    def port(self) -> int:
        return urlsplit(self.address).port or 0


async def _reader(page: Page, drawn: list[int], language: str) -> None:
    """A viewer who takes all that he is sent and says at once that it is drawn; comes again when he is let go."""
    while True:
        with contextlib.suppress(OSError, AssertionError, httpx.HTTPError, websockets.WebSocketException, TimeoutError):
            name = await page_id(page, highside_language=language)  # type: ignore[arg-type]
            url = f"ws://127.0.0.1:{page.port}/_nicegui_ws/socket.io/?{handshake_of(name)}"
            async with websockets.connect(url, max_size=2**24) as socket:
                await socket.send("40")
                async for frame in socket:
                    text = frame if isinstance(frame, str) else ""
                    if text == "2":
                        await socket.send("3")
                    elif '"run_javascript"' in text:
                        for request in _requests(text):
                            answer = {"request_id": request, "client_id": name, "result": None}
                            await socket.send("42" + json.dumps(["javascript_response", answer]))
                            drawn[0] += 1
        await asyncio.sleep(0.5)


def _requests(frame: str) -> list[str]:
    """The ids of what a frame asks the browser to answer."""
    said = json.loads(frame[frame.index("[") :])
    return [item["request_id"] for item in said[1:] if isinstance(item, dict) and item.get("request_id")]


async def _deaf(page: Page) -> None:
    while True:
        with contextlib.suppress(OSError, AssertionError, httpx.HTTPError, TimeoutError):
            socket = await slow_viewer(page)  # type: ignore[arg-type]
            try:
                await asyncio.sleep(60.0)
            finally:
                socket.close()
        await asyncio.sleep(0.5)


async def _hostile(page: Page) -> None:
    """Somebody who means harm: a page that is asked for and left, a body without an end, a frame that is none."""
    while True:
        with contextlib.suppress(OSError, AssertionError, httpx.HTTPError, websockets.WebSocketException, TimeoutError):
            async with httpx.AsyncClient(timeout=10.0) as client:
                await client.get(page.address)
                await client.post(urljoin(page.address, "/language"), content=b"x" * 200_000)
            url = f"ws://127.0.0.1:{page.port}/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
            async with websockets.connect(url) as socket:
                for junk in ("40", '42["event",' + "[" * 2_000, b"\x00" * 4_000, "9" * 4_000):
                    await socket.send(junk)
        await asyncio.sleep(0.2)


async def measured(seconds: float, viewers: int) -> dict[str, Any]:
    """One run of the service; with viewers if there are any. Raises AssertionError where a part does not start."""
    with tempfile.TemporaryDirectory() as name, Mosquitto(Path(name) / "broker") as broker:
        folder = Path(name)
        config, port = folder / "tool.toml", folder / "tty"
        config.write_text(
            f'[tool]\nid = "tool-7"\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "tool"\n'
            f'[mqtt]\nport = {broker.port}\n[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.5\n'
        )
        subscriber = Subscriber(broker.port)
        length = seconds + (15.0 if viewers else 0.0)
        sender = await asyncio.create_subprocess_exec(
            sys.executable, "-c", SENDER, str(port), str(SERIAL_RATE), str(length),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        assert sender.stdin is not None and sender.stdout is not None
        service = page_process = None
        crowd: list[asyncio.Task[None]] = []
        drawn = [0]
        try:
            assert (await sender.stdout.readline()).strip() == b"plugged"
            service = await asyncio.create_subprocess_exec(
                HIGHSIDE, "run", "--config", config, stderr=asyncio.subprocess.DEVNULL
            )
            await _until(lambda: bool((h := subscriber.latest("health")) and h["link"]["opens"] >= 1), 60.0)
            sender.stdin.write(b"go\n")
            if viewers:
                page_process = await asyncio.create_subprocess_exec(
                    HIGHSIDE, "serve", "--set", "web.port=0", "--set", f"mqtt.port={broker.port}",
                    "--set", f"web.viewers={viewers + 20}", stderr=asyncio.subprocess.PIPE,
                )  # fmt: skip
                assert page_process.stderr is not None
                page = Page((await page_process.stderr.readline()).decode().split()[-1])
                await asyncio.sleep(1.0)
                page.address += "tool/tool-7"
                reading, hostile = viewers // 2, viewers // 10
                languages = itertools.cycle(("en", "de", "nb", "es"))
                crowd = [asyncio.create_task(_reader(page, drawn, next(languages))) for _ in range(reading)]
                crowd += [asyncio.create_task(_deaf(page)) for _ in range(viewers - reading - hostile)]
                crowd += [asyncio.create_task(_hostile(page)) for _ in range(hostile)]
            await asyncio.sleep(WARM_S)
            counted = [psutil.Process(p.pid) for p in (service, page_process) if p is not None]
            before, begun = [_cpu(process) for process in counted], time.monotonic()
            drawn[0] = 0
            sent = int(await asyncio.wait_for(sender.stdout.readline(), length + 60.0))
            took = time.monotonic() - begun
            shares = [(_cpu(process) - was) / took for process, was in zip(counted, before, strict=True)]
            await _until(lambda: subscriber.latest("health")["monitor"]["received"] >= sent, 30.0)
            health = subscriber.latest("health")
        finally:
            for task in crowd:
                task.cancel()
            await asyncio.gather(*crowd, return_exceptions=True)
            for process in (service, page_process, sender):
                if process is not None and process.returncode is None:
                    process.kill()
                    await process.wait()
            subscriber.close()
    return {
        "viewers": viewers,
        "frames": sent,
        "lost": sent - health["monitor"]["good"],
        "lag_p999_ms": health["loop"]["lag_p999_ms"],
        "own_p999_ms": health["loop"]["own_p999_ms"],
        "service_cpu": shares[0],
        "page_cpu": shares[1] if viewers else 0.0,
        "pictures_per_s": drawn[0] / took / max(1, viewers // 2),
    }


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


async def _until(holds: Any, within_s: float) -> None:
    async with asyncio.timeout(within_s):
        while not holds():
            await asyncio.sleep(0.1)


def main() -> int:
    """Run both; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--viewers", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if MOSQUITTO is None:
        print("needs mosquitto", file=sys.stderr)
        return 1
    runs = [asyncio.run(measured(asked.seconds, viewers)) for viewers in (0, asked.viewers)]
    if asked.json:
        print(json.dumps(runs))
    for run in () if asked.json else runs:
        print(
            f"{run['viewers']:4d} viewers: {run['frames']} frames, {run['lost']} lost; loop lag p99.9"
            f" {run['lag_p999_ms']:.1f} ms, of its own {run['own_p999_ms']:.1f} ms; of a core service"
            f" {100 * run['service_cpu']:.1f} %, page {100 * run['page_cpu']:.1f} %;"
            f" {run['pictures_per_s']:.2f} pictures/s a reading viewer"
        )
    return 1 if any(run["lost"] for run in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
