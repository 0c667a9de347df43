"""The bench page in a real browser: a whole session by clicks and keys, who may command, cut sockets, slow viewers."""

from __future__ import annotations

import asyncio
import os
import re
import socket
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
import websockets
from axe_playwright_python.async_playwright import Axe
from bench_page import RING, SIX, BenchProcess, bench_process, chromium, slow_viewer
from broker import Proxy
from playwright.async_api import Page, expect

from highside.recording.calibration_store import CalibrationStore

BADGE = ".badge"
CLICK_S = 60_000
STILL = """document.getAnimations().every(
    (a) => a.playState !== "running" || a.effect?.getComputedTiming().endTime === Infinity)"""
"""nothing moves but what moves for ever"""


def badge(page: Page, state: str) -> Any:
    return page.locator(f"{BADGE}.{state}")


async def assert_accessible(page: Page, where: str) -> None:
    """No violation of axe's rules: contrast, names, labels, landmarks, roles; of what stands, not of what is fading."""
    await page.wait_for_function(STILL)
    found = await Axe().run(page)
    assert found.violations_count == 0, f"{where}: {found.generate_report()}"


async def assert_fits(page: Page, where: str) -> None:
    wide = await page.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
    assert wide <= 0, f"{where}: the page is {wide} px wider than the screen"


async def test_a_whole_session_is_clicked_through(tmp_path: Path) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    async with bench_process(tmp_path, speed=6.0) as bench, chromium() as browser:
        context = await browser.new_context(viewport={"width": 1600, "height": 900})
        page = await context.new_page()
        page.set_default_timeout(CLICK_S)
        page.on("request", lambda request: hosts.add(urlsplit(request.url).hostname or urlsplit(request.url).scheme))
        page.on("websocket", lambda opened: hosts.add(urlsplit(opened.url).hostname or "?"))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
        await page.goto(bench.link)
        assert page.url == bench.address, "the token does not stay in the address"
        await page.click("[data-command=start]")
        await badge(page, "capturing").wait_for()

        # keys: pause, and while it stands still look at it in every dress
        await page.keyboard.press("p")
        await badge(page, "paused").wait_for()
        await expect(page.locator("h1")).to_contain_text("Paused")
        for scheme in ("light", "dark"):
            await page.emulate_media(color_scheme=scheme)
            for size in ((1600, 900), (390, 844)):
                await page.set_viewport_size({"width": size[0], "height": size[1]})
                await assert_accessible(page, f"{scheme} {size}")
                await assert_fits(page, f"{scheme} {size}")
        await page.set_viewport_size({"width": 1600, "height": 900})
        height = await page.evaluate("parseFloat(getComputedStyle(document.querySelector('h1')).fontSize)")
        assert height >= 38, "a centimetre on a usual screen: readable at two metres"
        smallest = await page.evaluate(
            "Math.min(...[...document.querySelectorAll('.command')].map(b => b.offsetHeight || 999))"
        )
        assert smallest >= 48, "a gloved finger"

        # focus goes from control to control and is seen
        await page.keyboard.press("Tab")
        ring = await page.evaluate("getComputedStyle(document.activeElement).boxShadow")
        assert ring.count("0px 0px 0px") == 2, f"a ring about what has the focus: {ring}"
        assert await page.evaluate("document.activeElement !== document.body")
        await page.evaluate("document.activeElement.blur()")

        await page.keyboard.press("g")
        await page.locator("tr.done").nth(2).wait_for()
        # one pose again, by name
        await page.locator('[data-role="again"]').click()
        await page.get_by_role("option", name="1", exact=True).click()
        await expect(page.locator(".answer")).to_contain_text("Redo last:")
        # asked about once more, and not done
        await page.click("[data-command=abort]")
        await page.get_by_role("button", name="No, go back").click()

        await badge(page, "review").wait_for(timeout=180_000)
        await expect(page.locator("section.end")).to_contain_text("Result (joint)")
        await assert_accessible(page, "review")
        assert (await bench.state())["result"]["retaken"] >= 1
        report = await context.request.get(f"{bench.address}report", timeout=120_000)
        text = await report.text()
        assert report.ok and "Is it the bench or the sensor?" in text and "conventional" in text
        assert not (await context.request.get(f"{bench.address}certificate")).ok, "nothing is accepted yet"

        await page.click("[data-command=accept]")
        await badge(page, "accepted").wait_for()
        await page.get_by_role("link", name="Certificate").wait_for()
        made = await context.request.get(f"{bench.address}certificate", timeout=120_000)
        snapshot = await bench.state()
        record = snapshot["result"]["record_id"]
        assert made.ok and record in await made.text()
        assert (tmp_path / "state" / "calibrations" / "records" / f"{record}.json").is_file()

        # in force: asked about once more, then done, and seen
        store = CalibrationStore(tmp_path / "state" / "calibrations")
        await page.click("[data-command=activate]")
        await expect(page.locator(".question")).to_contain_text(record[:12])
        await page.get_by_role("button", name="No, go back").click()
        assert store.active_id("tool-7") is None
        await page.click("[data-command=activate]")
        await page.click("[data-command=yes]")
        await expect(page.locator("section.end")).to_contain_text("in force")
        await expect(page.locator("h1")).to_contain_text("is in force")
        assert store.active_id("tool-7") == record
        await expect(page.locator("[data-command=activate]")).to_be_hidden()
        await expect(page.locator(".question")).to_be_hidden()
        await assert_accessible(page, "in force")
        # and taken back, though nothing was in force before
        other = await bench.command("rollback", confirm=record, operator="A. Operator")
        assert other.status_code == 409 and other.json()["reason"] == "not_confirmed"
        await page.click("[data-command=rollback]")
        await expect(page.locator(".question")).to_contain_text("There was none before")
        await page.click("[data-command=yes]")
        await expect(page.locator("h1")).to_contain_text("It is not in force")
        assert store.active_id("tool-7") is None
        assert [entry.record_id for entry in store.history("tool-7")] == [record, ""]
        assert (await bench.command("activate", confirm=record, token="x")).status_code == 401
        assert faults == [], "nothing went wrong in the browser"
        assert await bench.ended() == 0
    assert hosts <= {"127.0.0.1", "data", "blob"}, "no request leaves the host"


async def test_a_verification_shows_its_verdict_and_a_roll_back_its_record(tmp_path: Path) -> None:
    """Two calibrations put in force one after the other, the later taken back, the one in force verified."""
    store = CalibrationStore(tmp_path / "state" / "calibrations")
    async with chromium() as browser:
        page = await browser.new_page(viewport={"width": 1440, "height": 860})
        page.set_default_timeout(CLICK_S)
        records = []
        for seed in (1, 2):
            async with bench_process(tmp_path, "--set", f"simulated.seed={seed}", plan=SIX, speed=20.0) as bench:
                await page.goto(bench.link)
                await page.click("[data-command=start]")
                await page.click("[data-command=accept]")
                await expect(page.locator("[data-command=activate]")).to_be_visible()
                await page.keyboard.press("F")
                await page.click("[data-command=yes]")
                await expect(page.locator("h1")).to_contain_text("is in force")
                records.append((await bench.state())["result"]["record_id"])
                if seed == 2:
                    assert store.active_id("tool-7") == records[1]
                    await page.click("[data-command=rollback]")
                    await expect(page.locator(".question")).to_contain_text(records[0][:12])
                    await page.click("[data-command=yes]")
                    await expect(page.locator("section.end")).to_contain_text(
                        f"not in force; in force is {records[0][:12]}"
                    )
                    assert store.active_id("tool-7") == records[0]
                assert await bench.ended() == 0
        plan = 'kind = "verification"\ninclinations_deg = [45.0]\nlimit_inc_deg = 0.3\nlimit_tf_deg = 1.0'
        async with bench_process(tmp_path, plan=plan, speed=20.0) as bench:
            await page.goto(bench.link)
            await expect(page.locator("h1")).to_contain_text(records[0][:12])
            await page.click("[data-command=start]")
            await badge(page, "review").wait_for()
            await expect(page.locator("section.end")).to_contain_text("Verdict")
            await expect(page.locator("section.end tbody tr")).to_have_count(3)
            for size in ((1440, 860), (390, 844)):
                await page.set_viewport_size({"width": size[0], "height": size[1]})
                await assert_accessible(page, f"verdict {size}")
                await assert_fits(page, f"verdict {size}")
                if (shots := os.environ.get("HIGHSIDE_SHOTS")) is not None:
                    await page.screenshot(path=f"{shots}/verdict-{size[0]}.png")
            verdict = (await bench.state())["result"]["verdict"]
            assert (verdict["verdict"], verdict["record"]) == ("pass", records[0])
            report = await page.context.request.get(f"{bench.address}report")
            assert report.ok and "Pass: all 3 poses" in await report.text()
            await page.click("[data-command=accept]")
            await expect(page.locator("h1")).to_contain_text("the verdict on calibration")
            await expect(page.locator("[data-command=activate]")).to_be_hidden()
            assert await bench.ended() == 0


async def test_commands_need_the_token(tmp_path: Path) -> None:
    async with bench_process(tmp_path, plan=RING) as bench, chromium() as browser:
        page = await browser.new_page()
        page.set_default_timeout(CLICK_S)
        await page.goto(bench.address)
        await expect(page.locator(".answer")).to_contain_text("commands need the token")
        await expect(page.locator("[data-command]")).to_have_count(0)
        await page.keyboard.press("s")
        assert (await bench.state())["state"] == "idle"
        assert bench.token not in await page.content()

        # programs
        for token in ("x", bench.token[:-1], bench.token.swapcase()):
            assert (await bench.command("start", token=token)).status_code == 401
        async with httpx.AsyncClient() as client:
            assert (await client.post(f"{bench.address}api/session/command", json={"name": "start"})).status_code == 401
            assert (await client.get(f"{bench.address}?token=wrong")).status_code == 403
            assert (await client.post(f"{bench.address}login", data={"token": "wrong"})).status_code == 403
            # a name that is not ours: the page of somebody else who had it point here
            assert (await client.get(bench.address, headers={"Host": "elsewhere.example"})).status_code == 421
            assert (await client.get(f"{bench.address}docs")).status_code == 404
        assert (await bench.state())["state"] == "idle"
        answer = await bench.command("begin")
        assert answer.status_code == 422 and "name" in answer.text

        # a page of another origin gets no socket
        with pytest.raises((websockets.InvalidStatus, websockets.ConnectionClosed, TimeoutError)):
            async with websockets.connect(
                f"ws://127.0.0.1:{bench.port}/_nicegui_ws/socket.io/?EIO=4&transport=websocket",
                origin="http://elsewhere.example",  # type: ignore[arg-type]
            ) as opened:
                await asyncio.wait_for(opened.recv(), 3.0)

        # the form gives the controls; wrong commands are answered, right ones done
        await page.fill(".login input", bench.token)
        await page.click(".login button")
        await page.wait_for_selector("[data-command=start]")
        await expect(page.locator(".login")).to_have_count(0)
        refused = await bench.command("accept")
        assert refused.status_code == 409 and refused.json()["reason"]
        await page.click("[data-command=start]")
        await badge(page, "guiding").or_(badge(page, "capturing")).or_(badge(page, "settling")).first.wait_for()
        cookies = await page.context.cookies()
        assert [(c["httpOnly"], c["sameSite"]) for c in cookies if c["name"] == "highside_operator"] == [
            (True, "Strict")
        ]
        # two operators at once: the one at the page holds it
        other = await bench.command("pause", operator="B. Other")
        assert other.status_code == 409 and other.json()["reason"] == "held_by_other"
        await bench.command("abort", operator="A. Operator")
        await badge(page, "aborted").wait_for()
        assert await bench.ended() == 1


async def test_a_cut_socket_is_mended_and_the_session_went_on(tmp_path: Path) -> None:
    async with bench_process(tmp_path, speed=3.0) as bench, Proxy(bench.port) as proxy, chromium() as browser:
        page = await browser.new_page()
        page.set_default_timeout(CLICK_S)
        address = bench.link.replace(f":{bench.port}/", f":{proxy.port}/")
        await page.goto(address)
        await page.click("[data-command=start]")
        await page.locator("tr.done").first.wait_for()
        loads: list[str] = []
        page.on("framenavigated", lambda frame: loads.append(frame.url))
        for _ in range(3):
            proxy.cut()
            before = (await bench.state())["plan"]["done"]
            await bench_past(bench, before + 1)
            # what it shows now is what is now
            await expect(page.locator("section.list caption")).to_contain_text(
                re.compile(rf"^({'|'.join(str(k) for k in range(before + 1, 17))}) of"), timeout=30_000
            )
        await page.click("[data-command=pause]")
        await badge(page, "paused").wait_for()
        assert len(loads) <= 3


async def bench_past(bench: BenchProcess, done: int) -> None:
    async with asyncio.timeout(60.0):
        while (await bench.state())["plan"]["done"] < done:
            await asyncio.sleep(0.1)


@pytest.mark.timing
async def test_viewers_who_do_not_read_disturb_nobody(tmp_path: Path) -> None:
    """Thirty viewers open the page and its socket and stop reading. Acquisition keeps its pace, nothing is lost."""
    async with bench_process(tmp_path, speed=1.0) as bench, chromium() as browser:
        page = await browser.new_page()
        page.set_default_timeout(CLICK_S)
        await page.goto(bench.link)
        await page.click("[data-command=start]")
        slow = [await slow_viewer(bench) for _ in range(30)]
        try:
            start, begun = await bench.state(), time.monotonic()
            drawn = []
            while time.monotonic() - begun < 12.0:
                drawn.append(await page.locator(".figures").inner_text())
                await asyncio.sleep(0.25)
            now, lasted = await bench.state(), time.monotonic() - begun
        finally:
            for opened in slow:
                opened.close()
        # the session's time is that of the readings that came
        assert now["elapsed_s"] - start["elapsed_s"] == pytest.approx(lasted, abs=1.5)
        assert now["faults"] == []
        assert now["plan"]["done"] > start["plan"]["done"]
        assert len(set(drawn)) >= 5, "the one who looks sees it move"


async def test_the_page_needs_its_own_address(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(AssertionError, match=f"127.0.0.1:{port}: web: cannot be listened on"):
            async with bench_process(tmp_path, "--set", f"web.port={port}"):
                pass
