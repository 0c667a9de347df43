"""While the programs of a live page are on their way it says so, in the reader's language."""

from __future__ import annotations

import asyncio
from pathlib import Path

from bench_page import chromium
from broker import Mosquitto
from playwright.async_api import Route, expect
from test_tools_page import serve

SAID = """[...document.querySelectorAll('#esm-fallback')].map((one) => [
  getComputedStyle(one, '::after').content, getComputedStyle(one).fontSize, getComputedStyle(one).opacity])"""


async def test_a_page_whose_programs_are_late_does_not_blame_the_browser(tmp_path: Path) -> None:
    with Mosquitto(tmp_path / "broker") as broker:
        await look(broker.port)


async def look(port: int) -> None:
    arrived = asyncio.Event()

    async def late(route: Route) -> None:
        await arrived.wait()
        await route.continue_()

    async with serve("--set", f"mqtt.port={port}") as (address, _), chromium() as browser:
        page = await (await browser.new_context(locale="de-DE")).new_page()
        await page.route("**/vue*.js", late)
        await page.goto(address, wait_until="commit")
        async with asyncio.timeout(60.0):
            while await page.evaluate(SAID) != [['"Die Seite wird geladen ..."', "0px", "1"]]:
                await asyncio.sleep(0.1)
        arrived.set()
        await expect(page.locator("h1")).to_have_text("An diesem Broker war noch kein Werkzeug zu hören.")
        assert await page.evaluate(SAID) == []
