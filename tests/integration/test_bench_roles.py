"""The bench page where people sign in: each acts in their own name, and the role decides what is put in force."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bench_page import SIX, BenchProcess, bench_process, chromium
from playwright.async_api import Browser, Page, expect
from signed_in import highside, make_users, sign_in


async def page_of(browser: Browser, bench: BenchProcess, name: str) -> Page:
    page = await (await browser.new_context()).new_page()
    await page.goto(bench.address)
    await sign_in(page, name)
    await expect(page.locator(".bench")).to_be_visible(timeout=30_000)
    return page


@pytest.mark.timeout(240)
async def test_what_is_put_in_force_needs_the_role_and_the_journal_has_the_name(tmp_path: Path) -> None:
    users = make_users(tmp_path)
    async with (
        bench_process(tmp_path, plan=SIX, speed=20.0, more=f'users = "{users}"\n') as bench,
        chromium() as browser,
    ):
        looks, operates, forces = [await page_of(browser, bench, n) for n in ("L. Look", "O. Operate", "F. Force")]
        await expect(looks.locator("[data-command=start]")).to_have_count(0)
        operator = operates.get_by_label("Operator")
        await expect(operator).to_have_value("O. Operate")
        await expect(operator).not_to_be_editable()
        await operates.click("[data-command=start]")
        await expect(operates.locator("[data-command=accept]")).to_be_visible(timeout=120_000)
        await operates.click("[data-command=accept]")
        await expect(forces.locator("[data-command=activate]")).to_be_visible(timeout=30_000)
        await expect(operates.locator("[data-command=activate]")).to_be_hidden()
        # a role that is taken away counts at once, on a page that is open
        highside("users", "role", "F. Force", "--role", "operate", "--file", users)
        await expect(forces.locator("[data-command=activate]")).to_be_hidden(timeout=30_000)
        highside("users", "role", "F. Force", "--role", "put in force", "--file", users)
        forces = await page_of(browser, bench, "F. Force")
        await forces.click("[data-command=activate]")
        await forces.click("[data-command=yes]")
        await expect(forces.locator(".answer").first).to_contain_text("Put in force: done", timeout=30_000)
    (journal,) = (tmp_path / "state" / "sessions").glob("*.journal")
    entries = [json.loads(line) for line in journal.read_text().splitlines()]
    who = {entry["e"]: entry["d"]["operator"] for entry in entries if entry["d"].get("operator")}
    assert (who["began"], entries[-1]["d"]["operator"]) == ("O. Operate", "F. Force")
