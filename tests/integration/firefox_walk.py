"""Walks the main pages in Firefox: a whole session at the bench with clicks and keys, the live page of a tool, the page
where sessions are begun, the diagnosis; at three widths nothing is wider than the screen, no error is said, nobody else
is asked; with the cable pulled at each step of the session and on the live page it is told, and the page goes on
afterwards. Without a graphics card it has no 3-D: what the picture shows is said in words below it.

    python tests/integration/firefox_walk.py [--firefox PATH] [--shots DIR]

`test_firefox` runs both halves side by side. Ends with 1 where it finds a fault.
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
from pathlib import Path

from bench_page import SIX, TOKEN, bench_process, served_bench
from by_keys import tabbed
from firefox import FIREFOX, FirefoxPage, firefox
from test_tools_page import NOISY, history_message, serve, tool, watch_message

WIDTHS = (360, 820, 1400)


async def fits(page: FirefoxPage, name: str, shots: Path | None, widths: tuple[int, ...]) -> None:
    for width in widths:
        await page.size(width, 900)
        # what is drawn takes its new size a little later
        await asyncio.sleep(0.5)
        wide = await page.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
        assert wide <= 0, f"{name}-{width}: {wide} px wider than the screen"
        _, astray = await tabbed(page)
        assert not astray, (name, width, astray)
        if shots is not None:
            await page.picture(shots / f"firefox-{name}-{width}.png")


LOST = "document.querySelector('#popup[aria-hidden=false]') || document.body.classList.contains('lost')"


async def cut_off(page: FirefoxPage, name: str, back: str) -> None:
    """With the cable pulled it is told at once, and once it is plugged in the page goes on where it was."""
    await page.cable(pulled=True)
    await page.until(LOST, 30.0)
    wide = await page.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
    assert wide <= 0, f"{name}: {wide} px wider without a link"
    await page.cable(pulled=False)
    await page.until(f"!({LOST}) && document.querySelector({back!r})")


def unheard(page: FirefoxPage) -> list[str]:
    """Errors beside what a browser without a graphics card says of its own."""
    return [text for text in page.errors if not any(word in text for word in NOISY)]


async def a_session(tmp_path: Path, browser: str, shots: Path | None, widths: tuple[int, ...] = WIDTHS) -> None:
    """At the bench, from the first click to a calibration in force, and the switch to German."""
    profile = tmp_path / "profile"
    profile.mkdir()
    async with bench_process(tmp_path, plan=SIX, speed=8.0) as bench, firefox(profile, browser) as page:
        await page.goto(bench.link)
        await page.until("document.querySelector('.badge')")
        await page.until("document.querySelector('.guidance').textContent.trim()")
        await fits(page, "idle", shots, widths)
        await cut_off(page, "idle", ".badge")
        await page.click("[data-command=start]")
        await page.until("document.querySelectorAll('tr.done').length > 0")
        await fits(page, "measuring", shots, widths)
        await cut_off(page, "measuring", "tr.done")
        await page.keys("p")
        await page.until("document.querySelector('.badge.paused')")
        await page.click("[data-command=resume]")
        await page.until("document.querySelector('.badge.review')")
        await fits(page, "review", shots, widths)
        await cut_off(page, "review", ".badge.review")
        await page.click("[data-command=accept]")
        await page.until("document.querySelector('.badge.accepted')")
        await cut_off(page, "accepted", ".badge.accepted")
        await page.click("[data-command=activate]")
        # the dialog grows as it comes, and covers the page until it has gone
        await asyncio.sleep(1.0)
        await page.click("[data-command=yes]")
        await page.until("document.querySelector('h1').textContent.includes('is in force')")
        await asyncio.sleep(1.0)
        await page.click(".languages button[value=de]")
        await page.until("document.documentElement?.lang === 'de' && document.querySelector('.badge.accepted')")
        assert "in Kraft" in await page.evaluate("document.querySelector('h1').textContent")
        assert page.hosts <= {"127.0.0.1"} and not unheard(page), (page.hosts, page.errors)


async def the_served_pages(tmp_path: Path, browser: str, shots: Path | None, widths: tuple[int, ...] = WIDTHS) -> None:
    """A tool live, then grey; the page of sessions, signed in with the keyboard; the diagnosis."""
    (tmp_path / "profile").mkdir()
    with served_bench(tmp_path) as (broker, options):
        async with serve(*options) as (address, _), firefox(tmp_path / "profile", browser) as page:
            async with tool(broker.port, "tool-7") as client:
                await client.publish("highside/tool-7/watch", watch_message())
                await client.publish("highside/tool-7/watch/history", history_message())
                await page.goto(address)
                await page.click("li.card a")
                await page.until("document.querySelector('.scene') && document.querySelector('.chart canvas')")
                await page.until("document.querySelector('.figures dd').textContent.startsWith('31.')")
                await fits(page, "tool", shots, widths)
                await cut_off(page, "tool", ".badge.live")
            await page.until("document.querySelector('.figures.stale')")
            await page.goto(f"{address}bench")
            await page.click("#token")
            await page.keys(f"{TOKEN}\ue007")
            await page.until("document.querySelector('[aria-label=\"six.toml\"]')")
            await fits(page, "begin", shots, widths)
            await page.goto(f"{address}diagnosis")
            await page.until("document.querySelector('#recording')")
            await fits(page, "diagnosis", shots, widths)
            assert page.hosts <= {"127.0.0.1"} and not unheard(page), (page.hosts, page.errors)


def main() -> None:
    """Walk. Raises AssertionError, TimeoutError."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--firefox", default=FIREFOX, help="the program; else firefox-esr or firefox of the PATH")
    parser.add_argument("--shots", type=Path, help="a directory for pictures")
    asked = parser.parse_args()
    if asked.firefox is None:
        parser.error("no Firefox was found: give --firefox PATH")
    for walk in (a_session, the_served_pages):
        with tempfile.TemporaryDirectory() as folder:
            asyncio.run(walk(Path(folder), asked.firefox, asked.shots))
        print(f"{walk.__name__.replace('_', ' ')}: walked")


if __name__ == "__main__":
    main()
