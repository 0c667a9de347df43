"""`highside serve` in a real browser, at a real broker: what a tool publishes is shown, what is old is grey at once,
nothing from outside becomes markup, nobody but the page's own machine is asked for anything."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import aiomqtt
import httpx
import pytest
from bench_page import HIGHSIDE, chromium
from broker import Mosquitto, free_port
from playwright.async_api import Page, expect
from test_bench_page import assert_accessible, assert_fits

from highside.service.tasks import ended

CLICK_S = 60_000
SHOTS = os.environ.get("HIGHSIDE_SHOTS")
"""a folder for pictures of what was checked"""
NOISY = ("GPU stall", "WebGL", "Automatic fallback to software")
"""What a browser without a graphics card says of its own"""


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[Mosquitto]:
    broker = Mosquitto(tmp_path / "broker")
    broker.start()
    yield broker
    broker.stop()


@contextlib.asynccontextmanager
async def serve(*options: str) -> AsyncIterator[tuple[str, asyncio.subprocess.Process]]:
    """The running command and its address; must end with 0 when it is asked to."""
    process = await asyncio.create_subprocess_exec(
        HIGHSIDE, "serve", "--set", "web.port=0", *options, stderr=asyncio.subprocess.PIPE
    )
    assert process.stderr is not None
    try:
        async with asyncio.timeout(120.0):
            while not (line := (await process.stderr.readline()).decode()).startswith("tools page:"):
                assert line, "it ended at once"
        yield line.split()[-1], process
        process.terminate()
        async with asyncio.timeout(30.0):
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


def attitude(seq: int, **more: Any) -> bytes:
    made = {
        "seq": seq, "t": time.time(), "t_mono": 1.0, "clock_synced": True, "t_device_s": 1.0, "window_s": 0.1,
        "inc_deg": 31.25, "inc_std_deg": 0.02, "tf_deg": 80.0, "tf_std_deg": 0.2, "motor_toolface_deg": 92.5,
        "toolface_offset_deg": 12.5, "g_total": 1.000123, "cal_id": "c" * 64, "zone": "all", "flags": [],
        "historical": False,
    }  # fmt: skip
    return json.dumps(made | more).encode()


def watch_message(watched_s: float = 86_400.0) -> bytes:
    made = {"value": 8e-4, "std": 5e-5, "unit": "g", "stated_std": 1e-4, "observable": True}
    said = {
        "t": time.time(), "verdict": "departs", "claims": [{"effect": "bias_step", "parameter": "b_x"}],
        "parameters": {"b_x": made}, "advice": ["take a roll test"], "watched_s": watched_s,
        "began": "began from the record",
    }  # fmt: skip
    return json.dumps(said).encode()


def history_message() -> bytes:
    """A day in which the offset of x steps by 0.8 mg at noon."""
    now, count = time.time(), 144
    names = ("b_x", "b_y", "b_z", "S_xx", "S_yy", "S_zz", "S_xz", "S_yz", "S_zx")
    value = {name: [round(5e-5 * math.sin(0.1 * k + i), 8) for k in range(count)] for i, name in enumerate(names)}
    value["b_x"] = [round(one + 8e-4 * (k >= count // 2), 8) for k, one in enumerate(value["b_x"])]
    said = {
        "t": now, "cal_id": "c" * 64, "began": "began from the record", "threshold": 36.0,
        "times": [now - 86_400.0 + 600.0 * (k + 1) for k in range(count)], "inclination_deg": [30.0] * count,
        "evidence": [5.0 + max(0, k - count // 2) * 2.0 for k in range(count)],
        "parameters": {
            name: {"unit": "g", "value": one, "std": [round(2e-5 + 2e-4 / (k + 1), 8) for k in range(count)]}
            for name, one in value.items()
        },
    }  # fmt: skip
    return json.dumps(said).encode()


@contextlib.asynccontextmanager
async def tool(port: int, name: str, **more: Any) -> AsyncIterator[aiomqtt.Client]:
    """A tool that publishes ten attitudes a second for as long as the block lasts."""
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.publish(f"highside/{name}/status", b"online", retain=True)

        async def stream() -> None:
            seq = 0
            while True:
                await client.publish(f"highside/{name}/attitude", attitude(seq, **more))
                seq += 1
                await asyncio.sleep(0.1)

        task = asyncio.create_task(stream())
        try:
            yield client
        finally:
            await ended(task)


async def listed(address: str, wanted: int) -> list[dict[str, Any]]:
    async with httpx.AsyncClient() as client, asyncio.timeout(60.0):
        while len(found := (await client.get(f"{address}api/tools")).json()["tools"]) < wanted:
            await asyncio.sleep(0.1)
    return found  # type: ignore[no-any-return]


def watched(page: Page, hosts: set[str], faults: list[str]) -> None:
    """Note whom the page asks, and what goes wrong in it."""
    page.set_default_timeout(CLICK_S)
    page.on("request", lambda request: hosts.add(urlsplit(request.url).hostname or urlsplit(request.url).scheme))
    page.on("websocket", lambda opened: hosts.add(urlsplit(opened.url).hostname or "?"))
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on(
        "console",
        lambda said: (
            faults.append(said.text) if said.type == "error" and not any(word in said.text for word in NOISY) else None
        ),
    )


async def test_tools_are_shown_and_what_is_old_is_grey(tmp_path: Path, mosquitto: Mosquitto) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    options = ("--set", f"mqtt.port={mosquitto.port}")
    async with serve(*options) as (address, _), chromium() as browser:
        context = await browser.new_context(viewport={"width": 1600, "height": 1000})
        page = await context.new_page()
        watched(page, hosts, faults)
        await page.goto(address)
        await expect(page.locator("h1")).to_have_text("No tool has been heard at this broker yet.")
        async with tool(mosquitto.port, "rig-7") as client:
            await expect(page.locator("h1")).to_have_text("1 tool, nothing needs attention.")
            await expect(page.locator(".card dd").first).to_contain_text("31.250°")
            await client.publish("highside/rig-7/health", b'{"alarms": ["link_stale"], "version": "9"}', retain=True)
            await expect(page.locator("h1")).to_have_text("1 of 1 tool needs attention.")
            await expect(page.locator(".card")).to_contain_text("power and wiring of the tool")
            await client.publish("highside/rig-7/health", b'{"alarms": [], "version": "9"}', retain=True)
            # by the keyboard alone, at a pace at which the list is replaced under the reader
            await page.keyboard.press("Tab")
            await page.wait_for_timeout(2_500)
            await page.keyboard.press("Enter")
            await expect(page.locator("h1")).to_contain_text("rig-7")
            await expect(page.locator("section.figures")).to_contain_text("92.50°")
            await expect(page.locator("section.dial svg")).to_have_attribute(
                "aria-label", "toolface 92.5 degrees, plus or minus 0.4"
            )
            refused = json.loads(attitude(1)) | {"accepted": False, "reasons": ["moved"], "duration_s": 10.0}
            await client.publish("highside/rig-7/survey", json.dumps(refused).encode())
            await expect(page.locator("section.surveys")).to_contain_text("✗ moved")
            await expect(page.locator("section.watch")).to_contain_text("Nothing watches over the calibration")
            assert await page.locator("section.watch canvas").count() == 0
            await client.publish("highside/rig-7/watch", watch_message(), retain=True)
            await client.publish("highside/rig-7/watch/history", history_message(), retain=True)
            await expect(page.locator("section.watch")).to_contain_text("The watch says: departs, watched for 24 h")
            await page.locator("section.watch canvas").wait_for()
            await expect(page.locator("section.watch [aria-label*='bands of 95 percent']")).to_be_visible()
            await page.locator("section.watch summary").click()
            await expect(page.locator("section.watch tbody")).to_contain_text("+0.80 ±\u00a00.10")
            await client.publish("highside/rig-7/watch", watch_message(90_000.0), retain=True)
            await expect(page.locator("section.watch")).to_contain_text("watched for 25 h")
            await expect(page.locator("section.watch tbody")).to_be_visible()
            # the 3-D picture is there: its canvas has been drawn on
            await page.locator("section.space canvas").wait_for()
            await page.locator("section.trend canvas").first.wait_for()
            for scheme in ("light", "dark"):
                await page.emulate_media(color_scheme=scheme)
                for width in (1600, 768, 320):
                    await page.set_viewport_size({"width": width, "height": 900})
                    await assert_accessible(page, f"tool {scheme} {width}")
                    await assert_fits(page, f"tool {scheme} {width}")
                    if SHOTS:
                        await page.screenshot(path=f"{SHOTS}/tool-{scheme}-{width}.png", full_page=True)
            assert await page.locator("section.figures .stale").count() == 0
        # it left without a word: silent after three seconds, and grey
        await expect(page.locator(".badge.silent")).to_be_visible()
        await expect(page.locator("section.figures dl.stale")).to_be_visible()
        async with aiomqtt.Client("127.0.0.1", mosquitto.port) as client:
            await client.publish("highside/rig-7/status", b"offline", retain=True)
        await expect(page.locator(".badge.offline")).to_be_visible()
        await page.goto(address)
        await expect(page.locator(".card.stale")).to_contain_text("offline")
        for width in (1600, 320):
            await page.set_viewport_size({"width": width, "height": 900})
            await assert_accessible(page, f"list {width}")
            await assert_fits(page, f"list {width}")
    assert hosts <= {"127.0.0.1", "data", "blob"}, f"nobody else is asked: {hosts}"
    assert faults == []


async def test_the_broker_goes_and_comes_back(tmp_path: Path, mosquitto: Mosquitto) -> None:
    options = ("--set", f"mqtt.port={mosquitto.port}")
    async with serve(*options) as (address, _), chromium() as browser:
        page = await (await browser.new_context()).new_page()
        page.set_default_timeout(CLICK_S)
        async with tool(mosquitto.port, "rig-7"):
            await listed(address, 1)
            await page.goto(f"{address}tool/rig-7")
            await expect(page.locator(".badge.live")).to_be_visible()
            mosquitto.kill()
            await expect(page.get_by_role("alert")).to_contain_text("No connection to the broker")
            await expect(page.locator("section.figures dl.stale")).to_be_visible()
        mosquitto.start()
        async with tool(mosquitto.port, "rig-7"):
            await expect(page.get_by_role("alert")).to_have_count(0)
            await expect(page.locator(".badge.live")).to_be_visible()
            await expect(page.locator("section.figures .stale")).to_have_count(0)


async def test_strangers_words_are_words_and_a_tool_that_is_none_is_not_found(mosquitto: Mosquitto) -> None:
    evil = '<img src=x onerror="document.title=1">'
    faults: list[str] = []
    options = ("--set", f"mqtt.port={mosquitto.port}")
    async with serve(*options) as (address, _), chromium() as browser:
        async with tool(mosquitto.port, evil, flags=[evil], cal_id=evil) as client:
            await client.publish(f"highside/{evil}/health", json.dumps({"alarms": [evil]}).encode())
            await client.publish(f"highside/{evil}/health/x", b"\xff" * 70_000)
            await client.publish(f"highside/{evil}/drift", b"[" * 50_000)
            await listed(address, 1)
            page = await (await browser.new_context()).new_page()
            watched(page, set(), faults)
            await page.goto(address)
            await page.get_by_role("link", name=evil).click()
            await expect(page.locator("h1")).to_contain_text(evil)
            await expect(page.locator("section.head .warning")).to_contain_text(evil)
            assert await page.title() == evil
        async with httpx.AsyncClient() as client_:
            assert (await client_.get(f"{address}tool/nobody")).status_code == 404
            assert (await client_.get(f"{address}tool/a/b")).status_code == 404
            assert (await client_.post(address)).status_code == 405
            elsewhere = await client_.get(address, headers={"Host": "rig.example.org"})
            assert elsewhere.status_code == 421
    assert [fault for fault in faults if "404" not in fault] == []


async def test_a_real_service_is_seen(tmp_path: Path, mosquitto: Mosquitto) -> None:
    """`highside run` on a simulated tool, through the broker, to the page's figures."""
    config = tmp_path / "tool.toml"
    config.write_text(
        '[tool]\nid = "real"\n[link]\nkind = "simulated"\nmotion = "still"\n[codec]\nname = "tool"\n'
        f'[mqtt]\nport = {mosquitto.port}\n[service]\nstate_dir = "{tmp_path / "state"}"\n'
    )
    (tmp_path / "state").mkdir()
    service = await asyncio.create_subprocess_exec(
        HIGHSIDE, "run", "--config", config, stderr=asyncio.subprocess.DEVNULL, env=os.environ | {}
    )
    try:
        async with serve("--set", f"mqtt.port={mosquitto.port}") as (address, _):
            async with asyncio.timeout(90.0):
                while (found := (await listed(address, 1))[0])["condition"] != "live":
                    await asyncio.sleep(0.2)
            assert found["inc_deg"] == pytest.approx(30.0, abs=0.1)
            assert found["motor_toolface_deg"] == pytest.approx(45.0, abs=0.3)
    finally:
        service.terminate()
        await service.wait()


def test_what_cannot_be_served_is_one_line(tmp_path: Path) -> None:
    import socket
    import subprocess

    def said(*options: str) -> str:
        done = subprocess.run([HIGHSIDE, "serve", *options], capture_output=True, text=True, timeout=120)
        assert done.returncode == 2, done.stderr
        assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr
        return done.stderr

    wrong = tmp_path / "serve.toml"
    wrong.write_text("[mqtt]\nprot = 1883\n")
    assert "prot" in said("--config", str(wrong)) and "serve.toml" in said("--config", str(wrong))
    assert "no such file" in said("--config", str(tmp_path / "missing.toml")).lower()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert "cannot be listened on" in said("--set", f"web.port={taken.getsockname()[1]}")
    assert "web.tls" in said("--set", f"web.tls.certificate={wrong}", "--set", f"web.tls.key={wrong}")


def test_without_a_broker_it_starts_and_says_so() -> None:
    async def seen() -> dict[str, Any]:
        async with serve("--set", f"mqtt.port={free_port()}") as (address, _), httpx.AsyncClient() as client:
            async with asyncio.timeout(30.0):
                while (said := (await client.get(f"{address}api/tools")).json())["broker"]["reason"] == (
                    "not connected yet"
                ):
                    await asyncio.sleep(0.1)
            return said  # type: ignore[no-any-return]

    assert asyncio.run(seen()) == {"broker": {"connected": False, "reason": "no broker"}, "tools": []}


async def test_the_tool_in_space_is_drawn_at_each_size_of_the_window(mosquitto: Mosquitto) -> None:
    """Drawn again before a change of size is seen, and as high as it was: its canvas stood on a line of text, which
    added six points to it at each change."""
    drawn_at_once = """async () => {
      const canvas = document.querySelector('.scene canvas'), sizes = [];
      for (let k = 0; k < 12; k++) {
        dispatchEvent(new Event('resize'));
        await new Promise(requestAnimationFrame);
        sizes.push(canvas.toDataURL().length);
      }
      return [sizes, canvas.height];
    }"""
    async with serve("--set", f"mqtt.port={mosquitto.port}") as (address, _), chromium() as browser:
        page = await browser.new_page(viewport={"width": 1400, "height": 900})
        async with tool(mosquitto.port, "tool-7"):
            await page.goto(f"{address}tool/tool-7")
            await page.wait_for_selector(".scene:not([data-initializing]) canvas")
            await page.wait_for_timeout(1_000)
            for width in (320, 1920):
                await page.set_viewport_size({"width": width, "height": 900})
                await page.wait_for_timeout(300)
                high = await page.evaluate("document.querySelector('.scene canvas').height")
                sizes, after = await page.evaluate(drawn_at_once)
                # a picture of nothing is a few hundred letters
                assert after == high and min(sizes) > max(sizes) / 2 > 2_000, (width, high, after, sizes)


@pytest.mark.parametrize("language", ["en", "de"])
async def test_without_three_dimensions_the_tool_is_drawn_from_the_side(mosquitto: Mosquitto, language: str) -> None:
    """A browser without WebGL has a picture, and one with it is sent none."""
    async with serve("--set", f"mqtt.port={mosquitto.port}") as (address, _), tool(mosquitto.port, "rig-7"):
        await listed(address, 1)
        async with chromium("--disable-gpu", "--disable-3d-apis") as browser:
            page = await (await browser.new_context(locale=language, viewport={"width": 320, "height": 640})).new_page()
            await page.goto(f"{address}tool/rig-7")
            await expect(page.locator("section.space svg.side .pipe")).to_be_visible(timeout=CLICK_S)
            word = {"en": "From the side", "de": "Von der Seite"}[language]
            await expect(page.locator("section.space p")).to_contain_text(word)
            assert "WebGL renderer" not in await page.locator("section.space").inner_text()
            await assert_fits(page, language)
            await assert_accessible(page, language)
        async with chromium() as browser:
            page = await browser.new_page()
            await page.goto(f"{address}tool/rig-7")
            await page.locator("section.space canvas").wait_for(timeout=CLICK_S)
            await expect(page.locator("section.space .flat")).to_be_empty(timeout=CLICK_S)
            await expect(page.locator("section.space .flat")).to_be_hidden()
