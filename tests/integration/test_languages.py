"""The pages in each language, in a real browser: by what the browser asks for, and by the switch; axe finds the
language of the page and of its parts."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_page import chromium
from broker import free_port
from playwright.async_api import expect
from signed_in import PASSWORD, make_users, serving
from test_acts import in_every_dress
from test_tools_page import serve, watched

ASKED = {"de-DE": ("de", "Anmelden", "Was hier getan wurde"), "nb-NO": ("nb", "Logg inn", "Hva som er gjort her")}


@pytest.fixture(scope="module")
def users(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_users(tmp_path_factory.mktemp("users"))


async def test_a_browser_is_answered_in_its_language_and_the_switch_changes_it(tmp_path: Path, users: Path) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    async with serving(tmp_path, users=users) as served, chromium() as browser:
        for locale, (code, heading, acts) in ASKED.items():
            page = await (await browser.new_context(locale=locale)).new_page()
            watched(page, hosts, faults)
            await page.goto(f"{served.address}acts")
            await expect(page.locator("h1")).to_have_text(heading)
            assert await page.locator("html").get_attribute("lang") == code
            await in_every_dress(page, f"sign in {code}")
            await page.locator("#name").fill("O. Operate")
            await page.locator("#password").fill(f"{PASSWORD} of O. Operate")
            await page.keyboard.press("Enter")
            await expect(page.locator("h1")).to_have_text(acts)
            await in_every_dress(page, f"acts {code}")
        await page.get_by_role("button", name="Español").click()
        await expect(page.locator("h1")).to_have_text("Lo que se ha hecho aquí")
        await expect(page.get_by_role("button", name="Español")).to_have_attribute("aria-current", "true")
        await expect(page.locator("tbody")).to_contain_text("iniciar sesión")
        await page.get_by_role("button", name="English").click()
        await expect(page.locator("h1")).to_have_text("What was done here")
    assert hosts == {"127.0.0.1"} and not faults


async def test_a_live_page_has_the_switch_too_and_it_needs_nobody_signed_in() -> None:
    async with serve("--set", f"mqtt.port={free_port()}") as (address, _), chromium() as browser:
        page = await browser.new_page()
        await page.goto(address)
        await expect(page.locator("h1")).to_have_text("No broker, no tools.")
        await page.get_by_role("button", name="Norsk").click()
        await expect(page.locator("h1")).to_have_text("Ingen broker, ingen verktøy.")
        assert await page.locator("html").get_attribute("lang") == "nb-NO"
        await in_every_dress(page, "no tools nb")
