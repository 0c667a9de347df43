"""Looks for what keeps people out, by axe's rules, in every state of every page, light and dark, narrow and wide.

    python tests/integration/axe_walk.py [--shots DIR]

The bench page in all states of `page_states` in two languages; signing in, live pages (none, some, with alarms, old),
records, comparisons, putting in force, sessions with a photograph, settings, sessions to begin, the diagnosis in its
stages. A program and no test: it takes minutes, and the tests of each page look at a part of it. Ends with 1 where
there is a violation.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

from axe_playwright_python.async_playwright import Axe
from bench_page import FILE, HIGHSIDE, SIX, chromium
from broker import Mosquitto
from page_states import PAGES
from playwright.async_api import Browser, Page
from playwright.async_api import Error as PlaywrightError
from signed_in import PASSWORD, make_users, serving
from test_bench_page import STILL
from test_page_pictures import slides
from test_records_page import photographed, record
from test_tools_page import attitude, history_message, tool, watch_message

from highside.recording.calibration_store import CalibrationStore

SCHEMES = ("light", "dark")
WIDTHS = (360, 1400)


class Walk:
    """Counts what was looked at and what was found."""

    def __init__(self, shots: Path | None) -> None:
        self.looked = 0
        self.found: list[str] = []
        self._shots = shots

    async def look(self, page: Page, name: str) -> None:
        """A page as it stands, in all dresses."""
        for scheme in SCHEMES:
            await page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            for width in WIDTHS:
                await page.set_viewport_size({"width": width, "height": 900})
                await page.wait_for_timeout(150)
                await page.wait_for_function(STILL)
                found = await Axe().run(page)
                self.looked += 1
                wide = await page.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
                where = f"{name}, {scheme}, {width}"
                self.found += [f"{where}: {wide} px wider than the screen"] if wide > 0 else []
                self.found += [
                    f"{where}: {one['id']}: {node['html'][:160]}" for one in found.response["violations"]
                    for node in one["nodes"]
                ]  # fmt: skip
                if self._shots is not None:
                    shot = self._shots / f"{name.replace(' ', '-')}-{width}-{scheme}.png"
                    await page.screenshot(path=str(shot), full_page=width < 1000)


async def bench_page(walk: Walk, browser: Browser) -> None:
    async with slides() as (link, say):
        for locale in ("en-US", "de-DE"):
            page = await (await browser.new_context(locale=locale)).new_page()
            await page.goto(link)
            await page.wait_for_selector(".badge")
            for name in PAGES:
                say.write(f"{name}\n".encode())
                await say.drain()
                await page.wait_for_function(f"document.querySelector('.foot').textContent.includes(' {name}')")
                await walk.look(page, f"bench {locale[:2]} {name}")
            for role in ("note", "photograph", "phone"):
                await page.click(f"[data-role={role}]")
                await page.wait_for_timeout(600)
                await walk.look(page, f"bench {locale[:2]} dialog {role}")
                await page.keyboard.press("Escape")
                await page.wait_for_timeout(600)
            await page.close()


@contextlib.asynccontextmanager
async def kept(folder: Path) -> AsyncIterator[tuple[tuple[str, ...], int]]:
    """A store, sessions, files to begin with, a configuration and a broker: the options, and the broker's port."""
    (folder / "bench.toml").write_text(FILE.format(speed=200.0, plan=SIX))
    command = [HIGHSIDE, "calibrate", "bench", "--config", folder / "bench.toml", "--auto", "--operator", "A. Operator"]
    await asyncio.to_thread(subprocess.run, command, check=True, capture_output=True, cwd=folder)
    store = CalibrationStore(folder / "state" / "calibrations")
    for seed in (1, 2):
        store.activate(record(seed), now_s=1_790_000_000.0)
    store.add(record(3, days=0.5))
    photographed(next((folder / "state" / "sessions").glob("*.journal")))
    (folder / "benches").mkdir()
    (folder / "benches" / "six.toml").write_text(FILE.format(speed=4.0, plan=SIX))
    (folder / "benches" / "wrong.toml").write_text(FILE.format(speed=4.0, plan='kind = "jiont"'))
    broker = Mosquitto(folder / "broker")
    broker.start()
    (folder / "highside.toml").write_text(f'[tool]\nid = "tool-7"\n[mqtt]\nport = {broker.port}\n')
    state = folder / "state"
    try:
        yield (
            "--records", str(state / "calibrations"), "--sessions", str(state / "sessions"), "--diagnose",
            "--bench", str(folder / "benches"), "--set", f"bench.state={folder}/pages",
            "--settings", str(folder / "highside.toml"), "--set", f"mqtt.port={broker.port}",
        ), broker.port  # fmt: skip
    finally:
        broker.stop()


async def sign_in(page: Page, address: str, name: str) -> None:
    await page.context.clear_cookies()
    await page.goto(f"{address}sign-in")
    await page.fill("#name", name)
    await page.fill("#password", f"{PASSWORD} of {name}")
    await page.keyboard.press("Enter")
    # the form has a heading, too: of who is signed in is told on the page that comes
    await page.wait_for_selector(".person")


async def served_pages(walk: Walk, browser: Browser, folder: Path) -> None:
    first, second = record(1).id, record(2).id
    async with kept(folder) as (options, port), serving(folder, *options, users=make_users(folder)) as served:
        page, at = await browser.new_page(), served.address
        await page.goto(f"{at}sign-in")
        await walk.look(page, "sign in")
        await page.fill("#name", "Nobody")
        await page.fill("#password", "wrong")
        await page.keyboard.press("Enter")
        await page.wait_for_selector(".alarm")
        await walk.look(page, "sign in refused")
        for name in ("L. Look", "O. Operate", "F. Force"):
            await sign_in(page, at, name)
            for path in ("bench", "diagnosis", "acts", "settings"):
                await page.goto(f"{at}{path}")
                await walk.look(page, f"{path} as {name[0]}")
        for path in (
            "calibrations", f"calibrations/{first}", f"calibrations/{second}", f"calibrations/{first}/force",
            f"calibrations/{second}/back", f"calibrations/{second}/certificate", "sessions", "calibrations/nothing",
            f"calibrations/compare?before={first}&after={second}", "command/tool-7",
        ):  # fmt: skip
            await page.goto(f"{at}{path}")
            await walk.look(page, path.replace("/", " ").replace(first, "first").replace(second, "second"))
        await page.goto(f"{at}sessions")
        await page.click("tbody a")
        await walk.look(page, "session")
        await diagnosis(walk, page, at)
        await live(walk, page, at, port)


async def diagnosis(walk: Walk, page: Page, at: str) -> None:
    rows = "".join(f"{0.1 * k},{0.001 * (k % 7)},0.0,1.0\n" for k in range(200))
    for name, head in (("open", "a,b,c,d\n"), ("looked at", "t_s,ax_g,ay_g,az_g\n")):
        await page.goto(f"{at}diagnosis")
        file = {"name": "recording.csv", "mimeType": "text/csv", "buffer": (head + rows).encode()}
        await page.set_input_files("#recording", file)  # type: ignore[arg-type]
        await page.click("main button[type=submit]:not(.quiet)")
        await page.wait_for_selector("table.rows, .alarm", timeout=90_000)
        await walk.look(page, f"diagnosis {name}")
        if name == "looked at":
            await page.click("text=Yes: diagnose it")
            await page.wait_for_selector("progress, .alarm, .said a", timeout=60_000)
            # it is loaded anew whenever it comes to another stage, under whoever looks at it
            with contextlib.suppress(PlaywrightError):
                await walk.look(page, "diagnosis in progress")
            await page.wait_for_selector("[data-stage=done], [data-stage=failed]", timeout=120_000)
            await walk.look(page, "diagnosis ended")
        await page.click("main button.quiet")
        await page.wait_for_selector("#recording")


async def live(walk: Walk, page: Page, at: str, port: int) -> None:
    await page.goto(at)
    await walk.look(page, "live none")
    async with tool(port, "tool-7") as client:
        await client.publish("highside/tool-7/watch", watch_message())
        await client.publish("highside/tool-7/watch/history", history_message())
        await client.publish(
            "highside/tool-7/health", b'{"alarms": ["link_down", "frozen"], "link": {"state": "down"}}'
        )
        await client.publish("highside/tool-7/attitude", attitude(0, flags=["uncorrected"]))
        await page.wait_for_selector("li.card")
        await walk.look(page, "live some")
        await page.goto(f"{at}tool/tool-7")
        await page.wait_for_selector(".chart canvas")
        await walk.look(page, "live tool")
        await page.goto(f"{at}command/tool-7")
        await walk.look(page, "live commands")
        await page.goto(f"{at}tool/tool-7")
    await page.wait_for_selector(".figures.stale")
    await walk.look(page, "live tool old")
    await page.goto(at)
    await walk.look(page, "live old")


async def walked(shots: Path | None) -> Walk:
    walk = Walk(shots)
    async with chromium() as browser:
        with tempfile.TemporaryDirectory() as folder:
            await served_pages(walk, browser, Path(folder))
        await bench_page(walk, browser)
    return walk


def main() -> int:
    """Walk; the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shots", type=Path, help="a directory for pictures")
    walk = asyncio.run(walked(parser.parse_args().shots))
    print(f"{walk.looked} pages looked at, {len(walk.found)} violations")
    for line in walk.found:
        print(f"  {line}")
    return 1 if walk.found else 0


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    sys.exit(main())
