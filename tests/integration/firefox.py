"""Firefox, driven by WebDriver BiDi over the socket that it opens itself: no driver of another maker is needed."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import json
import os
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import websockets

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
ANSWER_S = 60.0
START_S = 240.0
"""Until it listens, and for its first answer: on two processors shared by ten, 60 s passed before it had begun
(2026-11-27)"""


class FirefoxPage:
    """One tab. Raises AssertionError with the browser's words where a command fails."""

    def __init__(self, socket: websockets.ClientConnection) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._tab = ""
        self.errors: list[str] = []
        """what the console said of errors"""
        self.hosts: set[str] = set()
        """hosts that anything was requested from"""

    async def open(self) -> None:
        await self.command("session.new", START_S, capabilities={})
        await self.command("session.subscribe", events=["log.entryAdded", "network.beforeRequestSent"])
        self._tab = (await self.command("browsingContext.create", type="tab"))["context"]

    async def command(self, method: str, within_s: float = ANSWER_S, /, **params: Any) -> dict[str, Any]:
        number = next(self._numbers)
        await self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        async with asyncio.timeout(within_s):
            while True:
                said = json.loads(await self._socket.recv())
                if said.get("id") == number:
                    assert said["type"] == "success", said
                    return said["result"]  # type: ignore[no-any-return]
                self._heard(said)

    def _heard(self, said: dict[str, Any]) -> None:
        params = said.get("params", {})
        if said.get("method") == "log.entryAdded" and params.get("level") == "error":
            self.errors.append(str(params.get("text")))
        elif said.get("method") == "network.beforeRequestSent":
            asked = urlsplit(params["request"]["url"])
            self.hosts |= (
                {asked.hostname} if asked.scheme in ("http", "https", "ws", "wss") and asked.hostname else set()
            )

    async def goto(self, address: str) -> None:
        await self.command("browsingContext.navigate", context=self._tab, url=address, wait="complete")

    async def size(self, width: int, height: int) -> None:
        size = {"width": width, "height": height}
        await self.command("browsingContext.setViewport", context=self._tab, viewport=size, devicePixelRatio=1)

    async def evaluate(self, expression: str) -> Any:
        """The value of an expression, of plain types; of a promise, what it gives."""
        asked = f"Promise.resolve({expression}).then((value) => JSON.stringify(value ?? null))"
        said = await self.command("script.evaluate", expression=asked, target={"context": self._tab}, awaitPromise=True)
        assert said["type"] == "success", said
        return json.loads(said["result"]["value"])

    async def until(self, expression: str, within_s: float = 60.0) -> None:
        """Wait until it is true."""
        async with asyncio.timeout(within_s):
            while not await self.evaluate(f"!!({expression})"):
                await asyncio.sleep(0.1)

    async def click(self, selector: str) -> None:
        """With the mouse, in the middle of it."""
        await self.until(f"document.querySelector({selector!r})?.checkVisibility()")
        box = await self.evaluate(
            f"(e => {{ e.scrollIntoView({{block: 'center', behavior: 'instant'}}); const b = e.getBoundingClientRect();"
            f" return [b.x + b.width / 2, b.y + b.height / 2]; }})(document.querySelector({selector!r}))"
        )
        x, y = (round(value) for value in box)
        steps: list[dict[str, Any]] = [{"type": "pointerMove", "x": x, "y": y}]
        steps += [{"type": kind, "button": 0} for kind in ("pointerDown", "pointerUp")]
        await self.command(
            "input.performActions", context=self._tab, actions=[{"type": "pointer", "id": "mouse", "actions": steps}]
        )

    async def keys(self, text: str) -> None:
        """Typed."""
        steps = [{"type": kind, "value": letter} for letter in text for kind in ("keyDown", "keyUp")]
        await self.command(
            "input.performActions", context=self._tab, actions=[{"type": "key", "id": "keys", "actions": steps}]
        )

    async def cable(self, *, pulled: bool) -> None:
        conditions = {"type": "offline"} if pulled else None
        await self.command("emulation.setNetworkConditions", networkConditions=conditions, contexts=[self._tab])

    async def picture(self, path: Path) -> None:
        said = await self.command("browsingContext.captureScreenshot", context=self._tab)
        await asyncio.to_thread(path.write_bytes, base64.b64decode(said["data"]))


@contextlib.asynccontextmanager
async def firefox(folder: Path, program: str) -> AsyncIterator[FirefoxPage]:
    """The browser with a profile of its own in `folder`, without a window."""
    process = await asyncio.create_subprocess_exec(
        program, "--headless", "--no-remote", "--remote-debugging-port", "0", "--profile", str(folder), "about:blank",
        stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        env=os.environ | {"MOZ_DISABLE_CONTENT_SANDBOX": "1"},
    )  # fmt: skip
    assert process.stderr is not None
    try:
        async with asyncio.timeout(START_S):
            while b"WebDriver BiDi listening on " not in (line := await process.stderr.readline()):
                assert line, "firefox ended at once"
        address = line.decode().split()[-1]
        drain = asyncio.create_task(process.stderr.read())
        async with websockets.connect(f"{address}/session", max_size=50_000_000) as socket:
            page = FirefoxPage(socket)
            await page.open()
            yield page
        drain.cancel()
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()
