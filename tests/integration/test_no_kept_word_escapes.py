"""No word of the pages of what is kept (calibrations, sessions, comparison, putting in force, certificate, settings)
escapes the catalogue: as `test_no_word_escapes`, with a language in brackets; and each page names its language."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from bench_page import chromium
from signed_in import PASSWORD, make_users, serving
from test_no_word_escapes import brackets, escaped
from test_records_page import EVIL, kept
from test_settings_page import FILE

__all__ = ["brackets", "kept"]
SAID_BY_OTHERS = re.compile(
    # names that the tests give, a stranger's words, what `highside check` says, names of methods, files and units
    rf"{re.escape(EVIL)}|poses\.csv|bench 1|A\. Operator|O\. Operate|F\. Force|(?:joint|conventional) \(.*?\)"
    r"|session tool-\w+|conventional|balance|all|SHA|log|serial|tool\.toml|global|PDF|HTML|DCC"
    # ids, and names of fields and coefficients
    r"|[0-9a-f]{12,}|\b[a-z_]+(?:\.[a-z_]+)+\b|\b\w+_\w+\b"
)


@pytest.fixture(scope="module")
def users(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_users(tmp_path_factory.mktemp("users"))


async def test_no_word_of_what_is_kept_escapes(
    brackets: Path, kept: Path, users: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HIGHSIDE_LOCALE", str(brackets))
    config = tmp_path / "tool.toml"
    config.write_text(FILE)
    state = kept / "state"
    options = (
        "--records", str(state / "calibrations"), "--sessions", str(state / "sessions"), "--settings", str(config),
    )  # fmt: skip
    found: dict[str, set[str]] = {}
    async with serving(tmp_path, *options, users=users) as served, chromium() as browser:
        page = await (await browser.new_context(locale="de-DE")).new_page()

        async def look(name: str, path: str | None = None) -> None:
            if path is not None:
                await page.goto(f"{served.address}{path}")
            assert await page.locator("html").get_attribute("lang") == "de", name
            found[name] = {text for text in await escaped(page) if await rest(text)}

        async def rest(text: str) -> bool:
            return bool(re.search(r"[^\W\d_]{3,}", SAID_BY_OTHERS.sub("", re.sub("⟦[^⟦⟧]*⟧", "", text))))

        await look("sign in", "calibrations")
        await page.fill("#name", "F. Force")
        await page.fill("#password", f"{PASSWORD} of F. Force")
        await page.keyboard.press("Enter")
        await page.wait_for_selector("table.rows")
        await look("calibrations")
        # a word of two letters, which the look above passes by
        assert "⟦" in await page.locator("tbody tr td:nth-child(7)").last.inner_text()
        ids = list(await page.locator("input[name=before]").evaluate_all("all => all.map((one) => one.value)"))
        for one in (ids[0], ids[-1]):
            await look(f"calibration {one[:4]}", f"calibrations/{one}")
        await look("comparison", f"calibrations/compare?before={ids[0]}&after={ids[1]}")
        await look("two tools", f"calibrations/compare?before={ids[0]}&after={ids[2]}")
        for one, what in ((ids[0], "force"), (ids[1], "back"), (ids[-1], "force"), (ids[0], "certificate")):
            await look(f"{what} {one[:4]}", f"calibrations/{one}/{what}")
        await look("no such", "calibrations/abc")
        await look("sessions", "sessions")
        for link in await page.locator("td a").evaluate_all("all => all.map((one) => one.getAttribute('href'))"):
            await look(f"session {link[-20:]}", link.lstrip("/"))
        await look("settings", "settings")
        await page.fill("#text", FILE.replace("rate", "raet", 1) + "\nnonsense = 1\n")
        await page.locator("button[value=check]").click()
        await page.wait_for_selector("main .alarm", timeout=60_000)
        await look("settings refused")
        await look("acts", "acts")
    assert {name: texts for name, texts in found.items() if texts} == {}
    assert len(found) > 12
