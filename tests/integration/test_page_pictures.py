"""Every state of the bench page at three widths, in a real browser, compared with how it is kept: where everything
stands (pictures/layout.json), and what it looks like from afar (pictures/STATE-WIDTH.png).

To renew them after a change that is meant: `make pictures`, then look at each before it is committed.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_page import chromium
from page_states import PAGES
from PIL import Image, ImageFilter
from playwright.async_api import Browser, Page

from highside.bench.session.snapshot import SessionState

KEPT = Path(__file__).parent / "pictures"
LAYOUT = KEPT / "layout.json"
SHOTS = os.environ.get("HIGHSIDE_SHOTS")
"""A folder for the pictures in full, to look at."""
RENEW = os.environ.get("HIGHSIDE_RENEW_PICTURES") == "1"
SIZES = {360: 780, 820: 1180, 1400: 860}
"""A phone, a tablet on end, a screen: width and height in px."""

SCALE = 4
"""A kept picture is the screen made smaller by this: shapes and colours stay, how a font is smoothed goes."""
COLOURS = 64
LEVEL = 40
"""Of 255, after a blur of a pixel: what differs by more is another colour or another thing there."""
SHARE = 0.01
"""Of a picture's pixels that may differ by more. Four states at three widths: 0.0006 at most from run to run (what the
few colours of a kept picture cost), 0.0007 with fonts hinted and smoothed otherwise; 0.023 to 0.13 with the rules of
OLD_FAULT, 0.028 and more in another font."""
MOVED_PX = 12.0
MOVED_SHARE = 0.03
"""A box may stand elsewhere by so much, or by this share of its own distance from the top: fonts of another version
set lines a little higher, which adds up down the page. A cell that falls out of its row moves by 30 and more."""

BOXES = """
() => {
  const names = ['section', 'h1', '.badge', '.alarm', '.warning', '.figures dd', '.drawn svg', '.bar', '.command',
    '.redo-one', '.answer', '.login', 'caption', 'section.list tr', 'section.list td', 'section.list th',
    '.closures li', 'section.end h2', 'section.end p', 'section.end td', '.foot'];
  const out = {};
  for (const name of names) {
    const boxes = [...document.querySelectorAll(name)].map(e => e.getBoundingClientRect())
      .filter(b => b.width > 1.5 && b.height > 1.5)
      .map(b => [b.x + scrollX, b.y + scrollY, b.width, b.height].map(Math.round));
    if (boxes.length) out[name] = boxes;
  }
  return out;
}"""
FONT = "*:not(.q-icon) { font-family: Roboto, sans-serif !important; }"
"""The one font that comes with the page's library: what a machine has besides must not count."""
OLD_FAULT = ".again { display: flex; flex-wrap: wrap; gap: 10px; align-items: center; } .again > * { flex: 1 1 160px; }"
"""Rules of a box of the page, which once had the name of a row's state."""

Boxes = dict[str, list[list[int]]]


@contextlib.asynccontextmanager
async def slides() -> AsyncIterator[tuple[str, asyncio.StreamWriter]]:
    """The page in a process of its own: its link, and where to say what it shows."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, Path(__file__).parent / "page_states.py",
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None
    try:
        link = (await asyncio.wait_for(process.stdout.readline(), 60.0)).decode().strip()
        assert link.startswith("http"), "the page did not start"
        yield link, process.stdin
        process.stdin.close()
        await asyncio.wait_for(process.wait(), 20.0)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


@contextlib.asynccontextmanager
async def a_page(browser: Browser, link: str) -> AsyncIterator[Page]:
    """Signed in, in one font, nothing moving."""
    context = await browser.new_context(reduced_motion="reduce", color_scheme="light", device_scale_factor=1)
    page = await context.new_page()
    page.set_default_timeout(60_000)
    await page.goto(link)
    await page.wait_for_selector(".badge")
    await page.wait_for_selector(".scene:not([data-initializing])", state="attached")
    await page.wait_for_timeout(1_000)
    await page.add_style_tag(content=FONT)
    yield page
    await context.close()


async def show(page: Page, say: asyncio.StreamWriter, name: str, width: int) -> None:
    """The state `name` at a width, once it stands."""
    say.write(f"{name}\n".encode())
    await say.drain()
    await page.set_viewport_size({"width": width, "height": SIZES[width]})
    await page.wait_for_function(f"document.querySelector('.foot').textContent.endsWith('session {name}')")
    await page.evaluate(
        """async () => {
          scrollTo(0, 0); document.querySelector('section.list').scrollTop = 0; document.activeElement.blur();
          await document.fonts.ready;
          // what is drawn in three dimensions is turned a little after the words, and drawn ten times a second
          await new Promise((done) => setTimeout(done, 250));
          dispatchEvent(new Event("resize"));
          for (let k = 0; k < 3; k++) await new Promise(requestAnimationFrame);
        }"""
    )


async def look(page: Page) -> tuple[Boxes, Image.Image]:
    """Where everything stands, and the picture from afar."""
    boxes: Boxes = await page.evaluate(BOXES)
    shot = Image.open(io.BytesIO(await page.screenshot(full_page=True, animations="disabled", caret="hide")))
    whole = shot.convert("RGB")
    return boxes, whole.resize((whole.width // SCALE, whole.height // SCALE), Image.Resampling.BOX)


def moved(kept: Boxes, now: Boxes) -> list[str]:
    """What does not stand where it did, in words."""
    counts = {name: (len(kept.get(name, [])), len(now.get(name, []))) for name in sorted(kept.keys() | now.keys())}
    out = [f"{name}: {before} became {after}" for name, (before, after) in counts.items() if before != after]
    for name in kept.keys() & now.keys():
        for k, (before, after) in enumerate(zip(kept[name], now[name], strict=False)):
            allowed = [MOVED_PX, MOVED_PX + MOVED_SHARE * before[1], MOVED_PX + MOVED_SHARE * before[2], MOVED_PX]
            allowed[3] += MOVED_SHARE * before[3]
            if any(abs(a - b) > limit for a, b, limit in zip(before, after, allowed, strict=True)):
                out.append(f"{name} {k}: {before} became {after}")
    return out


def share_changed(kept: Image.Image, now: Image.Image) -> float:
    """Share of pixels that are another colour; what only one picture has counts whole."""
    size = (max(kept.width, now.width), max(kept.height, now.height))
    both = []
    for picture in (kept, now):
        canvas = Image.new("RGB", size, (255, 0, 255))
        canvas.paste(picture.convert("RGB"))
        both.append(np.asarray(canvas.filter(ImageFilter.BoxBlur(1)), dtype=np.int16))
    return float(np.mean(np.max(np.abs(both[0] - both[1]), axis=2) > LEVEL))


def kept_picture(name: str, width: int) -> Image.Image:
    return Image.open(KEPT / f"{name}-{width}.png").convert("RGB")


def test_no_state_of_a_session_is_without_a_picture() -> None:
    """But the one that takes no time."""
    assert {shown.state for shown in PAGES.values()} == set(SessionState) - {SessionState.CHECKING}


@pytest.mark.timeout(600)
async def test_every_state_at_three_widths_is_as_it_is_kept() -> None:
    layout: dict[str, Boxes] = {} if RENEW else json.loads(LAYOUT.read_text())
    wrong: list[str] = []
    async with slides() as (link, say), chromium() as browser, a_page(browser, link) as page:
        for name in PAGES:
            for width in SIZES:
                await show(page, say, name, width)
                boxes, picture = await look(page)
                wide = await page.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
                if wide > 0:
                    wrong.append(f"{name}-{width}: {wide} px wider than the screen")
                if SHOTS is not None:
                    await page.screenshot(path=f"{SHOTS}/{name}-{width}.png", full_page=True)
                if RENEW:
                    keep(layout, name, width, boxes, picture)
                    continue
                key = f"{name}-{width}"
                wrong += [f"{key}: {text}" for text in moved(layout[key], boxes)]
                if (share := share_changed(kept_picture(name, width), picture)) > SHARE:
                    wrong.append(f"{key}: {share:.3f} of the picture is another")
    if RENEW:
        LAYOUT.write_text(written(layout))
        for old in KEPT.glob("*.png"):
            if old.stem not in layout:
                old.unlink()
    assert not wrong, "\n".join(wrong[:30])
    assert RENEW or {path.stem for path in KEPT.glob("*.png")} == layout.keys() == {
        f"{name}-{width}" for name in PAGES for width in SIZES
    }
    assert sum(path.stat().st_size for path in KEPT.iterdir()) < 1_500_000


ABOVE = """() => {
  const buttons = document.querySelector('.commands .keys').getBoundingClientRect().top;
  const ends = {};
  for (const name of ['h1.prompt', '.bar', '.figures', '.scene']) {
    ends[name] = buttons - document.querySelector(name).getBoundingClientRect().bottom;
  }
  return ends;
}"""


async def test_on_a_phone_all_that_is_looked_at_while_turning_is_seen_without_scrolling() -> None:
    """Sentence, hold, angles and picture, above the buttons at the foot of a screen of 360 by 740."""
    async with slides() as (link, say), chromium() as browser, a_page(browser, link) as page:
        for name in ("guiding", "measuring", "again"):
            await show(page, say, name, 360)
            await page.set_viewport_size({"width": 360, "height": 740})
            room = await page.evaluate(ABOVE)
            assert all(left >= 0.0 for left in room.values()), (name, room)


async def test_rules_meant_for_a_box_that_reach_a_row_are_seen() -> None:
    """The fault that was there: the row of a pose to be set again fell apart, its cells under one another."""
    layout = json.loads(LAYOUT.read_text())
    async with slides() as (link, say), chromium() as browser, a_page(browser, link) as page:
        await page.add_style_tag(content=OLD_FAULT)
        for width in SIZES:
            await show(page, say, "again", width)
            boxes, picture = await look(page)
            found = moved(layout[f"again-{width}"], boxes)
            assert any(text.startswith("section.list tr") for text in found), "where it stands"
            assert share_changed(kept_picture("again", width), picture) > SHARE, "what it looks like"
            await show(page, say, "done", width)
            assert not moved(layout[f"done-{width}"], (await look(page))[0]), "and nowhere else"


def keep(layout: dict[str, Boxes], name: str, width: int, boxes: Boxes, picture: Image.Image) -> None:
    KEPT.mkdir(exist_ok=True)
    layout[f"{name}-{width}"] = boxes
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(KEPT / f"{name}-{width}.png", optimize=True)


def written(layout: dict[str, Any]) -> str:
    """One line a kind of box, so that a change can be read."""
    pages = []
    for key, boxes in sorted(layout.items()):
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(found)}" for name, found in boxes.items())
        pages.append(f" {json.dumps(key)}: {{\n{lines}\n }}")
    return "{\n" + ",\n".join(pages) + "\n}\n"


async def test_without_three_dimensions_the_table_is_drawn_from_the_side() -> None:
    """A browser without WebGL: the tool and the pose wanted, and no empty card."""
    async with slides() as (link, say), chromium("--disable-gpu", "--disable-3d-apis") as browser:
        page = await browser.new_page(viewport={"width": 320, "height": 640})
        await page.goto(link)
        say.write(b"guiding\n")
        await say.drain()
        await page.locator(".space svg.side .ghost").wait_for(timeout=60_000)
        box = await page.locator(".space svg.side .pipe").bounding_box()
        assert box is not None
        assert box["height"] > 40.0
        assert "From the side" in await page.locator(".space").inner_text()
        assert "WebGL renderer" not in await page.locator(".space").inner_text()
