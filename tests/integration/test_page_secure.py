"""The bench page by https in a real browser, and who holds a session that was begun there."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_page import RING, BenchProcess, bench_process, chromium
from page_pair import make_pair
from playwright.async_api import expect

SECRET = "chosen by who resumes it"


def is_in_a_file(text: str, folder: Path) -> bool:
    return any(text.encode() in path.read_bytes() for path in folder.rglob("*") if path.is_file())


async def reason(bench: BenchProcess, name: str, **more: str) -> str:
    """Why a command of a program that has the token is refused; "" where it is done."""
    answer = await bench.command(name, **more)
    assert answer.status_code == (200 if answer.json()["accepted"] else 409)
    return answer.json()["reason"] or ""


@pytest.mark.timeout(120)
async def test_a_browser_begins_a_session_by_https_and_holds_it(tmp_path: Path) -> None:
    pair = make_pair(tmp_path)
    files = ("--set", f"web.tls.certificate={pair.certificate}", "--set", f"web.tls.key={pair.key}")
    opened: list[str] = []
    async with bench_process(tmp_path, *files, plan=RING, speed=4.0) as bench, chromium() as browser:
        context = await browser.new_context(ignore_https_errors=True)
        page = await context.new_page()
        page.set_default_timeout(60_000)
        page.on("websocket", lambda made: opened.append(made.url))
        await page.goto(bench.link)
        assert page.url == bench.address and page.url.startswith("https://")
        (cookie,) = [one for one in await context.cookies() if one["name"] == "highside_operator"]
        assert cookie["secure"] and cookie["httpOnly"] and cookie["sameSite"] == "Strict"
        await page.click("[data-command=start]")
        await page.locator(".badge.capturing").wait_for()
        assert opened and all(url.startswith("wss://") for url in opened)

        # the token lets a program command; it is not the operator who began
        assert await reason(bench, "abort", operator="Somebody else") == "held_by_other"
        await page.keyboard.press("p")
        await page.locator(".badge.paused").wait_for()
        assert await reason(bench, "resume", operator="A. Operator", secret=SECRET) == ""
        # now it is his who knows the secret: the same name, with the token, is not enough
        for secret in ({}, {"secret": "guessed, and not known"}):
            assert await reason(bench, "abort", operator="A. Operator", **secret) == "held_by_other"
        await page.click("[data-command=abort]")
        await page.get_by_role("button", name="Yes").click()
        await expect(page.locator(".answer")).to_contain_text("Another holds this session")
        assert (await bench.state())["state"] not in ("aborted", "idle")
        # a secret that is lost holds nobody up at the bench
        await page.keyboard.press("p")
        await page.locator(".badge.paused").wait_for()
        told = f"{await bench.state()} {await page.content()} {' '.join(bench.said)}"
        assert SECRET not in told and not is_in_a_file(SECRET, tmp_path)
        assert not any("Traceback" in line for line in bench.said)
