"""Makes the pictures of the served pages, each one once, and of the bench page in German. The live page of a tool is
made by `tools_page_pictures.py`, the bench page by `bench_screens.py`.

    python docs/pages_pictures.py            (needs the extras web and test, mosquitto and the browser chromium)
"""

from __future__ import annotations

import asyncio
import io
import sys
import tempfile
from math import cos, sin
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "integration")]

from axe_walk import kept, sign_in  # noqa: E402
from bench_page import chromium  # noqa: E402
from PIL import Image  # noqa: E402
from playwright.async_api import Page  # noqa: E402
from signed_in import make_users, serving  # noqa: E402
from test_page_pictures import slides  # noqa: E402
from test_records_page import record  # noqa: E402
from test_settings_page import FILE as CONFIGURATION  # noqa: E402
from test_tools_page import tool  # noqa: E402

import highside  # noqa: E402

DOCS = Path(__file__).resolve().parent
COLOURS = 96
SIZE = {"width": 1400, "height": 860}
FILE = b"time_ms,acc_x,acc_y,acc_z,temperature\n" + b"".join(
    b"%d,%.4f,%.4f,%.4f,%.2f\n" % (10 * k, 9.81 * sin(k / 99), 0.02, 9.81 * cos(k / 99), 24 + k / 500)
    for k in range(500)
)
"""A foreign recording: what its units are has to be found out."""


async def keep(page: Page, name: str) -> None:
    """Write a small PNG."""
    shot = Image.open(io.BytesIO(await page.screenshot()))
    shot.convert("RGB").quantize(COLOURS).save(DOCS / f"{name}.png", optimize=True)


async def what_is_kept(page: Page, at: str) -> None:
    """Calibrations, their certificate, sessions, what was done."""
    first = f"{at}calibrations/{record(1).id}"
    await page.goto(f"{at}calibrations")
    await keep(page, "page-calibrations")
    # of the simulated session: what its operator is called was thought of to break pages in the others
    measured = page.locator("tr", has_text="conventional").locator("a").first
    address = f"{at}{(await measured.get_attribute('href') or '').lstrip('/')}"
    await page.goto(address)
    await keep(page, "page-calibration")
    await page.goto(f"{address}/certificate")
    await keep(page, "page-certificate")
    await page.goto(f"{first}/force")
    await keep(page, "page-force")
    await page.goto(f"{at}calibrations/compare?before={record(1).id}&after={record(2).id}")
    await keep(page, "page-compare")
    await page.goto(f"{first}/force")
    await page.click("main form button")
    await page.wait_for_url(f"{at}calibrations/{record(1).id}")
    await page.goto(f"{at}acts")
    await keep(page, "page-acts")
    await page.goto(f"{at}sessions")
    await keep(page, "page-sessions")
    await page.click("tbody a")
    await keep(page, "page-session")


async def a_diagnosis(page: Page, at: str) -> None:
    """From the choice of a file to its report."""
    await page.goto(f"{at}diagnosis")
    await keep(page, "page-diagnosis")
    await page.set_input_files("#recording", {"name": "bench.csv", "mimeType": "text/csv", "buffer": FILE})
    await page.click("main button[type=submit]:not(.quiet)")
    await page.wait_for_selector("table.rows", timeout=120_000)
    await keep(page, "page-import")
    await page.click("main button.quiet")
    seen = highside.simulate(ROOT / "config" / "model-bench.toml", seed=1).recording
    with tempfile.TemporaryDirectory() as folder:
        seen.write(Path(folder) / "session-12.csv")
        await page.set_input_files("#recording", Path(folder) / "session-12.csv")
        await page.set_input_files("#model", ROOT / "config" / "model-known.toml")
        await page.click("main button[type=submit]:not(.quiet)")
        await page.click("text=Yes: diagnose it", timeout=120_000)
        await page.wait_for_selector("#words[data-stage=running] ~ progress", timeout=60_000)
        await keep(page, "page-running")
        await page.wait_for_selector("[data-stage=done]", timeout=300_000)
        await keep(page, "page-done")
        await page.goto(f"{at}diagnosis/report")
        await page.wait_for_timeout(2_000)
        await keep(page, "page-report")


async def a_rig(page: Page, at: str, port: int) -> None:
    """The start page with one tool that is live, one with an alarm and one that has gone, and what may be ordered."""
    async with tool(port, "tool-9"):
        await asyncio.sleep(1.0)
    async with tool(port, "tool-7"), tool(port, "tool-8", inc_deg=64.5, motor_toolface_deg=211.0) as other:
        await other.publish("highside/tool-8/health", b'{"alarms": ["frozen"], "link": {"state": "up"}}')
        await page.goto(at)
        await page.wait_for_timeout(8_000)
        await keep(page, "page-tools")
        await page.goto(f"{at}command/tool-7")
        await keep(page, "page-commands")


async def pictures() -> None:
    """Write docs/page-*.png and docs/bench-german.png."""
    async with chromium() as browser:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            async with kept(folder) as (options, port), serving(folder, *options, users=make_users(folder)) as served:
                page, at = await browser.new_page(viewport=SIZE), served.address
                await page.goto(f"{at}sign-in")
                await keep(page, "page-sign-in")
                await sign_in(page, at, "F. Force")
                await page.goto(f"{at}bench")
                await keep(page, "page-begin")
                (folder / "highside.toml").write_text(CONFIGURATION)
                await page.goto(f"{at}settings")
                await page.fill("#text", CONFIGURATION.replace("10.0", "5.0"))
                await page.click("button[value=check]")
                await page.wait_for_selector("table.rows", timeout=60_000)
                await keep(page, "page-settings")
                await what_is_kept(page, at)
                await a_diagnosis(page, at)
                await a_rig(page, at, port)
        async with slides() as (link, say):
            page = await (await browser.new_context(locale="de-DE", viewport=SIZE)).new_page()
            await page.goto(link)
            say.write(b"guiding\n")
            await say.drain()
            await page.wait_for_function("document.querySelector('.foot').textContent.includes(' guiding')")
            await page.wait_for_timeout(2_000)
            await keep(page, "bench-german")


if __name__ == "__main__":
    asyncio.run(pictures())
