"""Makes the pictures of the served pages: a bench to begin at, a calibration about to be put in force, two compared,
what a file is taken for, and the bench page in German.

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


async def pictures() -> None:
    """Write docs/page-*.png."""
    async with chromium() as browser:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            async with kept(folder) as (options, _), serving(folder, *options, users=make_users(folder)) as served:
                page = await browser.new_page(viewport=SIZE)
                await sign_in(page, served.address, "F. Force")
                await page.goto(f"{served.address}bench")
                await keep(page, "page-begin")
                await page.goto(f"{served.address}calibrations/{record(1).id}/force")
                await keep(page, "page-force")
                await page.goto(f"{served.address}calibrations/compare?before={record(1).id}&after={record(2).id}")
                await keep(page, "page-compare")
                await page.goto(f"{served.address}diagnosis")
                await page.set_input_files("#recording", {"name": "bench.csv", "mimeType": "text/csv", "buffer": FILE})
                await page.click("main button[type=submit]:not(.quiet)")
                await page.wait_for_selector("table.rows", timeout=120_000)
                await keep(page, "page-import")
        async with slides() as (link, say):
            page = await (await browser.new_context(locale="de-DE", viewport=SIZE)).new_page()
            await page.goto(link)
            say.write(b"guiding\n")
            await say.drain()
            await page.wait_for_function("document.querySelector('.foot').textContent.endsWith('guiding')")
            await page.wait_for_timeout(2_000)
            await keep(page, "bench-german")


if __name__ == "__main__":
    asyncio.run(pictures())
