"""No word of the pages escapes the catalogue: a language is made in which every message stands in brackets, and what is
then seen of a page without brackets is a name, a number or a unit."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from bench_page import TOKEN, chromium, served_bench
from page_states import PAGES
from playwright.async_api import Page
from test_page_pictures import slides
from test_tools_page import attitude, history_message, serve, tool, watch_message

from tests.brackets import put_in_brackets

SEEN = """() => {
  const out = [];
  const foreign = 'code, kbd, [lang]:not(html, [lang=de]), .languages button, [id*=popup], .q-icon, script, style,'
    + ' noscript, .scene, .chart, textarea';
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walk.nextNode());) {
    const at = node.parentElement;
    if (!at.closest(foreign) && at.checkVisibility()) out.push(node.textContent);
  }
  for (const name of ['aria-label', 'placeholder', 'title', 'alt'])
    for (const at of document.querySelectorAll(`[${name}]`)) if (!at.closest(foreign)) out.push(at.getAttribute(name));
  return [document.title, ...out].map((text) => text.trim()).filter(Boolean);
}"""
"""What is read or read out, but for what is marked as of another language or as code."""
HEALTH = json.dumps(
    {
        "version": "1", "link": {"state": "up", "data_age_s": 0.1}, "outbox": {"queued": 0},
        "recorder": {"state": "recording", "bytes_written": 1, "bytes_dropped": 0},
        "surveys": {"accepted": 0, "refused": 1}, "alarms": [],
    }
).encode()  # fmt: skip
WORD = re.compile(r"[^\W\d_]{3,}")
NAMES = re.compile(
    # of the tool, of people and files, of what the tests say in place of a session, of methods and quantities
    r"\b(tool|bench|simulated|six|toml|state|tcp|min|sqrt|Gtotal|UTC|highside|Technician|Operator|joint|conventional"
    r"|recording|csv|jiont|bias|step|all|ready|sigma|MB|deg|north"
    # what the operating system says of a port
    r"|ttyUSB0 is gone)\b"
)


@pytest.fixture(scope="module")
def brackets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The catalogues, German in brackets: ⟦message⟧."""
    folder = tmp_path_factory.mktemp("locale")
    put_in_brackets(folder)
    return folder


async def escaped(page: Page) -> set[str]:
    """What stands outside of all brackets and is no name."""
    out = set()
    for text in await page.evaluate(SEEN):
        left = text
        while (shorter := re.sub("⟦[^⟦⟧]*⟧", "", left)) != left:
            left = shorter
        if WORD.search(NAMES.sub("", left)):
            out.add(text)
    return out


async def test_no_word_of_the_bench_page_escapes(brackets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIGHSIDE_LOCALE", str(brackets))
    found = {}
    async with slides() as (link, say), chromium() as browser:
        page = await (await browser.new_context(locale="de-DE")).new_page()
        await page.goto(link)
        await page.wait_for_selector(".badge")
        assert await page.locator("html").get_attribute("lang") == "de"
        for name in PAGES:
            say.write(f"{name}\n".encode())
            await say.drain()
            await page.wait_for_function(f"document.querySelector('.foot').textContent.includes('session {name}⟧')")
            found[name] = await escaped(page)
        for role in ("note", "photograph", "phone"):
            await page.click(f"[data-role={role}]")
            await page.wait_for_timeout(500)
            found[role] = await escaped(page)
            await page.keyboard.press("Escape")
            await page.wait_for_timeout(500)
    assert not any(found.values()), {name: texts for name, texts in found.items() if texts}


async def test_no_word_of_the_served_pages_escapes(
    brackets: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HIGHSIDE_LOCALE", str(brackets))
    found = {}
    with served_bench(tmp_path) as (broker, options):
        async with serve(*options) as (address, _), chromium() as browser:
            page = await (await browser.new_context(locale="de-DE")).new_page()
            for name in ("bench", "diagnosis", ""):
                await page.goto(f"{address}{name}")
                await page.wait_for_selector("h1")
                found[name or "no tools"] = await escaped(page)
            async with tool(broker.port, "tool-7") as client:
                await client.publish("highside/tool-7/watch", watch_message())
                await client.publish("highside/tool-7/watch/history", history_message())
                await client.publish("highside/tool-7/attitude", attitude(0, flags=["uncorrected"]))
                await client.publish("highside/tool-7/health", HEALTH, retain=True)
                await client.publish("highside/tool-7/drift", b'{"motion": "turning", "azi_std_deg": 0.2}')
                refused = json.loads(attitude(1)) | {"accepted": False, "reasons": ["moved", "g_total_high"]}
                await client.publish("highside/tool-7/survey", json.dumps(refused).encode())
                await page.wait_for_selector("li.card")
                found["tools"] = await escaped(page)
                await page.goto(f"{address}tool/tool-7")
                await page.wait_for_selector(".log li")
                await page.wait_for_selector(".surveys .bad")
                found["tool"] = await escaped(page)
            await page.goto(f"{address}bench")
            await page.fill("#token", TOKEN)
            await page.keyboard.press("Enter")
            await page.wait_for_selector("text=six.toml")
            found["bench, signed in"] = await escaped(page)
            await page.goto(f"{address}diagnosis")
            found["diagnosis, signed in"] = await escaped(page)
            rows = "".join(f"{0.1 * k},{0.001 * (k % 7)},0.0,1.0\n" for k in range(200))
            await page.set_input_files(
                "#recording",
                {"name": "recording.csv", "mimeType": "text/csv", "buffer": f"t_s,ax_g,ay_g,az_g\n{rows}".encode()},
            )
            await page.click("button[type=submit]:not(.quiet):not([name=code])")
            await page.wait_for_selector(".warning, table.rows, .alarm", timeout=60_000)
            found["diagnosis, looked at"] = await escaped(page)
    assert not any(found.values()), {name: texts for name, texts in found.items() if texts}


def test_what_escapes_is_seen(brackets: Path) -> None:
    """The brackets are there, and what has none is no name by accident."""
    assert os.environ.get("HIGHSIDE_LOCALE") is None
    assert (brackets / "de" / "LC_MESSAGES" / "highside.mo").read_bytes().count("⟦".encode()) > 500
    for text in ("hands off", "Nothing watches", "inclination", "poses done"):
        assert WORD.search(NAMES.sub("", text)), text
