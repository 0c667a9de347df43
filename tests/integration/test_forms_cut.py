"""Forms of the served pages with the cable pulled: nothing leaves the page, what was written stays, what to do is told,
and it can be sent when the link is back; so with a sign-in that ended meanwhile, a file that is too large, a link that
breaks while it is sent, and a second click."""

from __future__ import annotations

from pathlib import Path

from bench_page import chromium
from playwright.async_api import Locator, Page, expect
from signed_in import make_users, serving, sign_in, signed_in
from test_settings_page import FILE

ROWS = "".join(f"{0.1 * k},{0.001 * (k % 7)},0.0,1.0\n" for k in range(50))
RECORDING = {"name": "recording.csv", "mimeType": "text/csv", "buffer": ("a,b,c,d\n" + ROWS).encode()}
CUT = "The server does not answer: nothing was sent"


async def told(page: Page, words: str) -> None:
    await expect(page.get_by_role("alert")).to_contain_text(words)
    assert await page.evaluate("document.scrollingElement.scrollWidth - window.innerWidth") <= 0


async def too_long(page: Page, text: Locator, save: Locator) -> None:
    """What is longer than is taken is not sent; what the server turns away stands there again, on the way back."""
    # by hand it is pasted; to type it takes minutes
    await text.evaluate("at => { at.value = '#'.repeat(1e6); }")
    await save.click()
    await told(page, "This has 1000000 characters, and at most 100000 are taken")
    await expect(text).to_be_focused()
    await text.evaluate("at => { at.value = '\u00fc'.repeat(3e5); at.removeAttribute('data-longest'); }")
    await page.context.add_cookies([{"name": "highside_language", "value": "de", "url": page.url}])
    await save.click()
    await expect(page.locator("h1")).to_have_text("Nichts wurde angenommen.")
    await page.get_by_role("link", name="zurück zu dem, was geschrieben wurde").click()
    await expect(page.get_by_role("status")).to_contain_text("hier steht es wieder")
    assert await page.locator("#text").evaluate("at => at.value === '\u00fc'.repeat(3e5)")
    assert page.url.endswith("/settings")
    await page.context.clear_cookies(name="highside_language")


async def test_what_is_sent_without_a_link_stays_and_is_sent_when_it_is_back(tmp_path: Path) -> None:
    file = tmp_path / "highside.toml"
    file.write_text(FILE)
    options = ("--settings", str(file), "--diagnose", "--set", "diagnosis.upload_mb=1")
    async with serving(tmp_path, *options, users=make_users(tmp_path)) as served, chromium() as browser:
        context = await browser.new_context(viewport={"width": 360, "height": 800})
        page = await context.new_page()
        await signed_in(page, served, "O. Operate", "settings")
        text, save = page.get_by_label("The file"), page.get_by_role("button", name="Check and save")
        await text.fill(FILE + "# as it is on the rig\n")
        await context.set_offline(True)
        await save.click()
        await told(page, CUT)
        assert (await text.input_value()).endswith("# as it is on the rig\n") and file.read_text() == FILE
        await context.set_offline(False)
        # who signed out elsewhere meanwhile
        cookies = await context.cookies()
        await context.clear_cookies()
        await save.click()
        await told(page, "The server does not know you here any more")
        await context.add_cookies(cookies)  # type: ignore[arg-type]
        await save.dblclick()
        await expect(page.get_by_role("status")).to_contain_text("Saved", timeout=60_000)
        assert file.read_text() == FILE + "# as it is on the rig\n"
        assert [act["outcome"] for act in served.done() if act["act"].startswith("change")] == ["begins", "done"]

        await too_long(page, text, save)

        await page.goto(f"{served.address}diagnosis")
        look = page.get_by_role("button", name="Look at it")
        await page.set_input_files("#recording", {**RECORDING, "buffer": b"1" * 1_000_001})  # type: ignore[arg-type]
        await look.click()
        await told(page, "larger than this page takes")
        await page.set_input_files("#recording", RECORDING)  # type: ignore[arg-type]
        await page.route("**/diagnosis/file", lambda route: route.abort())
        await look.click()
        await told(page, "The link broke while the file was sent")
        await page.unroute("**/diagnosis/file")
        await look.click()
        table = page.locator("#map")
        await expect(table).to_be_visible(timeout=60_000)
        await table.fill("t_s=a:s")
        await context.set_offline(True)
        await page.get_by_role("button", name="Look again").click()
        await told(page, CUT)
        await expect(table).to_have_value("t_s=a:s")
        await context.set_offline(False)
        # 4,000 letters are taken, each of which may be twelve bytes on its way; more are not sent
        await table.fill("\U0001f600" * 4_001)
        await page.get_by_role("button", name="Look again").click()
        await told(page, "This has 4001 characters, and at most 4000 are taken")
        assert await table.evaluate("at => at === document.activeElement && at.getAttribute('aria-invalid')") == "true"
        await table.fill("\U0001f600" * 4_000)
        await page.get_by_role("button", name="Look again").click()
        await expect(page.locator("main .alarm").first).to_contain_text("\U0001f600", timeout=60_000)
        await table.fill("t_s=a:s\n" * 41)
        await page.get_by_role("button", name="Look again").click()
        await expect(page.locator("section .alarm")).to_contain_text("41 columns are named")
        await expect(table).to_have_value("t_s=a:s\n" * 41)
        await table.fill("t_s=a:s")
        await page.get_by_role("button", name="Look again").click()
        # the answer is a page's that asks for a diagnosis, and is looked at in `test_diagnosis_page`
        await page.get_by_role("button", name="Cancel").click()
        await expect(page.locator("#recording")).to_be_visible()

        await page.goto(f"{served.address}sign-in")
        await context.clear_cookies()
        await page.reload()
        await context.set_offline(True)
        await sign_in(page, "L. Look")
        await told(page, CUT)
