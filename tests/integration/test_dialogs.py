"""Dialogs of the bench page, in a real browser: what is behind one is inert for keys, clicks and screen readers, no key
of the page commands the session, and who closes it is where he was before."""

from __future__ import annotations

from pathlib import Path

from bench_page import SIX, bench_process, chromium
from playwright.async_api import Page, expect

BEHIND = "document.getElementById('app').inert"
FOCUS = "document.getElementById('app').contains(document.activeElement)"


async def tabbed_through(page: Page) -> list[bool]:
    """Whether the focus is behind the dialog, key by key, once round and back."""
    inside = []
    for key in ["Tab"] * 8 + ["Shift+Tab"] * 8:
        await page.keyboard.press(key)
        inside.append(await page.evaluate(FOCUS))
    return inside


async def buttons(page: Page) -> list[str]:
    """The buttons that a screen reader is told of."""
    session = await page.context.new_cdp_session(page)
    tree = await session.send("Accessibility.getFullAXTree")
    named = [node for node in tree["nodes"] if not node["ignored"] and node["role"]["value"] == "button"]
    return [node["name"]["value"] for node in named]


async def test_what_is_behind_an_open_dialog_is_inert(tmp_path: Path) -> None:
    async with bench_process(tmp_path, plan=SIX, speed=8.0) as bench, chromium() as browser:
        page = await browser.new_page()
        await page.goto(bench.link)
        await expect(page.locator(".badge")).to_have_text("ready")
        assert not await page.evaluate(BEHIND)
        assert any("Start" in name for name in await buttons(page))
        for role in ("note", "photograph", "phone"):
            opener = page.locator(f"[data-role={role}]")
            await opener.focus()
            await page.keyboard.press("Enter")
            await page.wait_for_selector("[role=dialog]")
            await page.wait_for_function(BEHIND)
            assert not any(await tabbed_through(page)), role
            # nothing behind is named to a screen reader: the buttons of the session are not in the tree
            assert not any("Start" in name for name in await buttons(page)), role
            close = page.get_by_role("button", name="Close")
            await close.focus()
            # the keys of Start, and of Abort, which asks
            for key in ("s", "Shift+Q"):
                await page.keyboard.press(key)
            await page.wait_for_timeout(300)
            assert await page.locator("[role=dialog]").count() == 1, f"{role}: a key asked behind the dialog"
            await page.keyboard.press("Escape")
            await page.wait_for_function(f"!{BEHIND}")
            await expect(page.locator("[role=dialog]")).to_have_count(0)  # it fades, and is not behind while it does
            await expect(opener).to_be_focused()
            await expect(page.locator(".badge")).to_have_text("ready")
        # with none open the keys count again; the question before a command is a dialog too
        await page.keyboard.press("s")
        await expect(page.locator(".badge")).not_to_have_text("ready")
        await page.click("[data-command=abort]")
        await page.wait_for_function(BEHIND)
        assert not any(await tabbed_through(page))
        await page.get_by_role("button", name="No, go back").click()
        await page.wait_for_function(f"!{BEHIND}")
        await expect(page.locator("[data-command=abort]")).to_be_focused()
