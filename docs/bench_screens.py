"""Makes the pictures of the bench page: a real session on the simulated bench, photographed by a real browser.

python docs/bench_screens.py            (needs the extras web and test, and the browser chromium)
"""

from __future__ import annotations

import io
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, StorageState, sync_playwright

DOCS = Path(__file__).resolve().parent
HIGHSIDE = Path(sys.executable).parent / "highside"
COLOURS = 96
WAIT_MS = 120_000

BENCH = """
[tool]
id = "tool-7"
[simulated]
speed = 1.5
[plan]
kind = "joint"
poses = 12
inclinations_deg = [5.0, 45.0, 120.0]
toolfaces_deg = [45.0, 135.0, 225.0, 315.0]
[bench]
name = "simulated bench"
[store]
directory = "calibrations"
sessions = "sessions"
[web]
port = 0
"""


def main() -> None:
    """Run the session and write docs/bench-*.png."""
    # where a shell had it ignored, as for what runs in the background, the session would not end by it either
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "bench.toml"
        config.write_text(BENCH)
        command = [HIGHSIDE, "calibrate", "bench", "--config", config, "--web", "--plain", "--operator", "Technician"]
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        assert process.stderr is not None
        try:
            found = re.search(r"http\S+", process.stderr.readline().decode())
            assert found is not None, "the page did not start"
            with sync_playwright() as play:
                browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
                photograph(browser, found.group(0))
                browser.close()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30)


def photograph(browser: Browser, link: str) -> None:
    """The moments of a session."""
    page = browser.new_page(viewport={"width": 1440, "height": 860})
    page.set_default_timeout(WAIT_MS)
    page.goto(link)
    page.click("[data-command=start]")
    # the others are there before there is something to see: the session does not wait for a browser
    signed_in: StorageState = page.context.storage_state()
    dark = other(browser, link, signed_in, 1440, 860, "dark")
    phone = other(browser, link, signed_in, 390, 844, "light")
    page.locator("tr.done").nth(4).wait_for()
    page.wait_for_selector(".badge.guiding")
    page.wait_for_timeout(250)
    keep(page, "bench-guiding")
    dark.wait_for_selector(".badge.capturing")
    dark.wait_for_timeout(300)
    keep(dark, "bench-measuring")
    phone.wait_for_selector(".badge.capturing")
    phone.wait_for_timeout(300)
    keep(phone, "bench-phone")
    page.wait_for_selector(".badge.review")
    page.wait_for_selector("section.end .big")
    page.wait_for_timeout(300)
    keep(page, "bench-review")
    page.click("[data-command=accept]")
    page.wait_for_selector(".badge.accepted")


def other(browser: Browser, link: str, signed_in: StorageState, width: int, height: int, scheme: str) -> Page:
    """A second viewer of the same session."""
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark" if scheme == "dark" else "light",
        storage_state=signed_in,
    )
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.goto(link.partition("?")[0])
    return page


def keep(page: Page, name: str) -> None:
    """Write a small PNG."""
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB").quantize(COLOURS)
    picture.save(DOCS / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
