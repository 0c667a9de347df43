"""The bench page for who stands at the table: tones, what is old is grey, the cable pulled at each step, a phone, the
keyboard alone, a browser without 3-D."""

from __future__ import annotations

import asyncio
import math
import os
import signal
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.async_playwright import Axe
from bench_page import JOINT, SIX, BenchProcess, bench_process, chromium
from bench_rig import bench_rig
from playwright.async_api import Browser, Page, async_playwright, expect
from test_bench_page import CLICK_S, assert_accessible, assert_fits, badge

from tests.photograph import a_photograph

FURTHER = pytest.mark.further

HEARD = """
  window.tones = [];
  const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (at) {
    window.tones.push(this.frequency.value);
    return start.call(this, at);
  };
"""
"""Which tones a page has played, in order, by their frequency."""
AXES = """() => {
  const scene = window['scene_' + document.querySelector('.scene').id];
  const of = (group) => {
    group.updateMatrixWorld();
    return [...group.matrixWorld.elements].slice(8, 11);
  };
  return scene.children.filter((c) => c.type === 'Group' && c.children.length === 3 && c.visible).map(of);
}"""
"""Which way the pipes in the picture point: the tool, and the ghost, which is a twentieth larger."""
HANDS_OFF, DONE, KNOCK = 880, 990, 196


async def a_page(browser: Browser, bench: BenchProcess, width: int = 1400) -> Page:
    page = await browser.new_page(viewport={"width": width, "height": 860})
    page.set_default_timeout(CLICK_S)
    await page.add_init_script(HEARD)
    await page.goto(bench.link)
    await page.wait_for_selector(".badge")
    return page


@FURTHER
async def test_tones_say_hands_off_done_and_knock_and_can_be_silenced(tmp_path: Path) -> None:
    mistakes = 'simulated.mistakes={2="shock"}'
    async with bench_process(tmp_path, "--set", mistakes, speed=3.0) as bench, chromium() as browser:
        page = await a_page(browser, bench)
        button = page.locator(".sound")
        await expect(button).to_have_text("Sound: off")
        await page.click("[data-command=start]")
        await page.locator("tr.done").first.wait_for()
        assert await page.evaluate("tones") == [], "silent until somebody wishes otherwise"

        await button.click()
        await expect(button).to_have_text("Sound: on")
        await page.wait_for_function(f"tones.includes({KNOCK}) && tones.includes({DONE})", timeout=90_000)
        order = await page.evaluate("tones")
        assert order[0] == HANDS_OFF, "turned on, it is heard"
        assert order.index(KNOCK) > order.index(HANDS_OFF)
        assert order[: order.index(KNOCK)].count(HANDS_OFF) >= 2, "hands off before it was spoilt"

        await button.click()
        await expect(button).to_have_text("Sound: off")
        before = len(await page.evaluate("tones"))
        done = (await bench.state())["plan"]["done"]
        await page.locator("tr.done").nth(done + 1).wait_for()
        assert len(await page.evaluate("tones")) == before
        await button.click()
        await page.reload()
        await expect(page.locator(".sound")).to_have_text("Sound: on"), "the browser remembers it"


async def test_a_bench_that_says_nothing_more_turns_the_page_grey(tmp_path: Path) -> None:
    """The process stands still (its computer sleeps, the network is gone): no number stays as if it were of now."""
    async with bench_process(tmp_path, speed=2.0) as bench, chromium() as browser:
        page = await a_page(browser, bench)
        await page.click("[data-command=start]")
        await badge(page, "capturing").wait_for()
        await expect(page.locator(".lost-said")).to_be_hidden()
        bench.process.send_signal(signal.SIGSTOP)
        try:
            await expect(page.locator(".lost-said")).to_be_visible(timeout=6_000)
            filtered = await page.evaluate("getComputedStyle(document.querySelector('.bench')).filter")
            assert "grayscale" in filtered
            await assert_accessible(page, "lost")
            # what is asked for now is not kept for later, when nobody means it any more
            await page.click("[data-command=pause]")
            await page.keyboard.press("p")
        finally:
            bench.process.send_signal(signal.SIGCONT)
        await expect(page.locator(".lost-said")).to_be_hidden(timeout=30_000)
        await asyncio.sleep(1.0)
        assert (await bench.state())["state"] != "paused"
        # at rest, with nothing that changes, the page is spoken to all the same
        await page.keyboard.press("p")
        await badge(page, "paused").wait_for()
        await asyncio.sleep(5.0)
        await expect(page.locator(".lost-said")).to_be_hidden()


@pytest.mark.timeout(600)
async def test_the_cable_is_pulled_at_each_step(tmp_path: Path) -> None:
    """In every state that looks at the tool: at once no number, no needle, no arrow; then it goes on where it was."""
    async with bench_rig(tmp_path, plan=SIX) as rig, chromium() as browser:
        page = await a_page(browser, rig)
        for state in ("idle", "guiding", "settling", "capturing", "paused", "review"):
            if state == "guiding":
                await page.click("[data-command=start]")
            elif state == "paused":
                await page.keyboard.press("p")
            await rig.unplug_in(state)
            await expect(page.locator(".figures")).to_have_class("figures stale", timeout=4_000)
            numbers = await page.locator(".figures dd:not(.goal-of)").all_inner_texts()
            if state != "review":
                assert numbers == ["–", "–"], state
                assert await page.locator(".needle, circle.tool").count() == 0, state
                assert "°C" not in await page.locator(".numbers").inner_text(), state
                await expect(page.locator(".space")).to_have_class("drawn space stale")
                await expect(page.locator(".guidance")).to_contain_text("no readings")
            if state in ("guiding", "settling", "capturing"):
                await badge(page, "no_data").wait_for()
                await assert_accessible(page, f"no data, pulled in {state}")
            kept = (await rig.state())["plan"]["done"]
            await rig.plug()
            if state == "review":
                continue
            await expect(page.locator(".figures")).to_have_class("figures", timeout=30_000)
            assert (await rig.state())["plan"]["done"] >= kept
            if state == "paused":
                await expect(page.locator("h1")).to_contain_text("Paused")
                await page.keyboard.press("g")
        await page.click("[data-command=accept]")
        await badge(page, "accepted").wait_for()
        assert (await rig.state())["result"]["record_id"]


async def test_a_whole_session_by_the_keyboard_alone(tmp_path: Path) -> None:
    async with bench_process(tmp_path, plan=SIX, speed=10.0) as bench, chromium() as browser:
        page = await a_page(browser, bench)
        press = page.keyboard.press
        await press("s")
        await page.locator("tr.done").first.wait_for()
        await press("p")
        await badge(page, "paused").wait_for()

        # every control can be reached, is seen to have the focus, and is left again
        await page.evaluate("document.activeElement.blur()")
        reached = []
        for _ in range(40):
            await press("Tab")
            name = await page.evaluate(
                """() => { const e = document.activeElement, style = getComputedStyle(e);
                   const seen = e.closest('.q-field')?.querySelector('.q-field__control') ?? e;
                   return [e.dataset?.command ?? e.dataset?.role ?? e.className.split(' ')[0] ?? e.tagName,
                           (style.boxShadow + getComputedStyle(seen).boxShadow).includes('0px 0px 0px')
                           || style.outlineStyle !== 'none']; }"""
            )
            if name in reached or await page.evaluate("document.activeElement === document.body"):
                break
            reached.append(name)
        names = {name for name, _ in reached}
        assert {"resume", "undo", "abort", "sound", "phone"} <= names, reached
        assert not (dark := [name for name, ring in reached if not ring]), dark

        # the dialog of the phone: opened, read, closed, and the focus is back where it was
        await page.locator("[data-role=phone]").focus()
        await press("Enter")
        await expect(page.get_by_role("button", name="Close")).to_be_focused()
        await press("Escape")
        await expect(page.get_by_role("button", name="Close")).to_be_hidden()
        await page.evaluate("document.activeElement.blur()")
        await press("g")
        await badge(page, "review").wait_for()
        await press("a")
        await badge(page, "accepted").wait_for()
        # what puts something in force asks first, and stands on No
        await press("F")
        await expect(page.get_by_role("button", name="No, go back")).to_be_focused()
        await press("Enter")
        assert (await bench.state())["in_force"]["present"] is None
        await page.evaluate("document.activeElement.blur()")
        await press("F")
        await expect(page.get_by_role("button", name="No, go back")).to_be_focused()
        await press("Tab")
        await press("Enter")
        await expect(page.locator("h1")).to_contain_text("is in force")
        assert await bench.ended() == 0


async def test_a_phone_is_shown_the_way_and_opens_it(tmp_path: Path) -> None:
    async with bench_process(tmp_path, "--set", "web.host=0.0.0.0", speed=2.0) as bench, chromium() as browser:
        page = await a_page(browser, bench, width=390)
        await page.click("[data-role=phone]")
        await expect(page.locator(".code svg")).to_be_visible()
        await assert_accessible(page, "the code")
        await assert_fits(page, "the code")
        shown = (await page.locator(".phone .answer").first.inner_text()).strip()
        line = next(text for text in bench.said if "from a phone" in text)
        elsewhere = line.split()[-1]
        assert shown == elsewhere.partition("?")[0] and bench.token not in shown, "the right is in the code alone"
        # by the address of the network and with the code's right, as the phone asks
        async with httpx.AsyncClient(follow_redirects=True) as phone:
            answer = await phone.get(elsewhere)
            assert answer.status_code == 200 and "highside_operator" in phone.cookies
        # who only looks on is given no right
        other = await (await browser.new_context()).new_page()
        await other.goto(bench.address)
        await other.wait_for_selector(".sound")
        assert await other.locator("[data-role=phone]").count() == 0
        assert bench.token not in await other.content()
    async with bench_process(tmp_path, speed=2.0) as bench, chromium() as browser:
        page = await a_page(browser, bench)
        await page.click("[data-role=phone]")
        await expect(page.locator(".phone")).to_contain_text("web.host=0.0.0.0")
        assert await page.locator(".code").count() == 0


async def test_the_tool_stands_in_the_picture_as_it_stands(tmp_path: Path) -> None:
    """What three.js has in its scene: the pipe turned as the snapshot says, the ghost as the pose wanted."""
    async with bench_process(tmp_path, speed=1.0) as bench, chromium() as browser:
        page = await a_page(browser, bench)
        await page.click("[data-command=start]")
        await page.locator("[data-command=pause]").wait_for()
        await page.keyboard.press("p")
        await badge(page, "paused").wait_for()
        await page.wait_for_selector(".scene:not([data-initializing])")
        async with asyncio.timeout(30.0):
            # the table comes to rest, and so does the picture
            while True:
                state, axes = await bench.state(), await page.evaluate(AXES)
                side = -1.0 if state["target"] and state["target"]["inc_deg"] < 0 else 1.0
                inc = side * math.radians(state["attitude"]["inc_deg"])
                # the ghost is drawn anew, and so last, where the pose wanted changes; it is a twentieth larger
                if any(axis == pytest.approx([-math.sin(inc), 0.0, math.cos(inc)], abs=0.01) for axis in axes):
                    break
                await asyncio.sleep(0.3)
        await page.keyboard.press("g")


async def test_without_3d_everything_else_works(tmp_path: Path) -> None:
    path = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    async with bench_process(tmp_path, plan=JOINT, speed=3.0) as bench, async_playwright() as play:
        browser = await play.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-3d-apis"])
        page = await a_page(browser, bench)
        assert not await page.evaluate("!!document.createElement('canvas').getContext('webgl2')")
        await page.click("[data-command=start]")
        await page.locator("tr.done").nth(1).wait_for()
        await expect(page.locator(".guidance")).not_to_be_empty()
        await browser.close()


async def send_photograph(page: Page, bench: BenchProcess, folder: Path) -> None:
    """One of a phone, beside what is none, what is too large, and what nobody may send."""
    large = folder / "large.jpg"
    await page.click("[data-role=photograph]")
    await page.wait_for_selector(".q-dialog")
    # the dialog fades in by a transition that begins a frame late
    await page.wait_for_timeout(600)
    # the dialog alone: of what it covers axe takes the dialog's ground for its own
    found = await Axe().run(page, ".q-dialog")
    assert found.violations_count == 0, found.generate_report()
    answer, send = page.locator("form.photograph [role=status]"), page.locator("[data-role=send]")
    await page.get_by_label("Photograph (JPEG").set_input_files(
        {"name": "clamp.jpg", "mimeType": "image/jpeg", "buffer": b"<svg onload=alert(1)>"}
    )
    await send.click()
    await expect(answer).to_contain_text("Not kept: that is no photograph that can be read")
    await page.get_by_label("Photograph (JPEG").set_input_files(
        {"name": "clamp.jpg", "mimeType": "image/jpeg", "buffer": a_photograph()}
    )
    # 50 MB, which a browser cannot read as a picture, and then one which it can
    for content, said in ((b"\xff\xd8", "this browser cannot make it smaller"), (a_photograph(), "is kept with")):
        large.write_bytes(content + b"\0" * 50_000_000)
        await page.get_by_label("Photograph (JPEG").set_input_files(large)
        await send.click()
        await expect(answer).to_contain_text(said)
    large.unlink()
    await page.get_by_label("Photograph (JPEG").set_input_files(
        {"name": "clamp.jpg", "mimeType": "image/jpeg", "buffer": a_photograph()}
    )
    await page.get_by_label("What it shows").fill("Clamp 2 <i>seen</i> from above")
    await send.click()
    await expect(answer).to_contain_text("The photograph is kept with the session")
    await page.get_by_role("button", name="Close").click()
    async with httpx.AsyncClient() as nobody:
        refused = await nobody.post(f"{bench.address}photograph?operator=x", content=b"x" * 900)
        assert (refused.status_code, refused.text[:11]) == (403, "Photographs")
        refused = await nobody.post(f"{bench.address}photograph?operator=x", content=a_photograph())
        assert refused.status_code == 413, "of who may not command not even that much is read"


@FURTHER
async def test_notes_and_photographs_are_kept_with_the_journal_and_stand_in_the_report(tmp_path: Path) -> None:
    from highside.bench.photographs import photographs
    from highside.bench.session.entries import Noted
    from highside.bench.session.journal import read_journal

    said = "Clamp 2 slipped <b>once</b>; set again."
    async with bench_process(tmp_path, plan=SIX, speed=10.0) as bench, chromium() as browser:
        page = await a_page(browser, bench)
        await send_photograph(page, bench, tmp_path)
        await page.click("[data-command=start]")
        await page.click("[data-role=note]")
        field = page.get_by_label("Note for the journal and the report")
        await expect(field).to_be_focused()
        await page.keyboard.type(said)
        # the dialog fades in by a transition that begins a frame late
        await page.wait_for_timeout(600)
        await assert_accessible(page, "a note")
        assert (await bench.state())["state"] != "paused", "what is typed is no command"
        leaves = "dispatchEvent(new Event('beforeunload', { cancelable: true }))"
        assert not await page.evaluate(leaves), "a page that is loaded anew would lose what is written"
        # what is too long for the journal stays, to be made shorter
        await field.evaluate("field => field.removeAttribute('maxlength')")
        await field.fill("x" * 2_000)
        await page.click("[data-role=keep]")
        await expect(page.get_by_text("A note has 1 to 500 letters")).to_be_visible()
        await expect(field).to_have_value("x" * 2_000)
        await field.fill(said)
        await page.click("[data-role=keep]")
        await expect(page.get_by_text("The note is in the journal.")).to_be_visible()
        await page.click("[data-role=keep]")
        await expect(page.get_by_text("A note has 1 to 500 letters")).to_be_visible()
        await page.keyboard.press("Escape")
        await badge(page, "review").wait_for()
        assert await page.evaluate(leaves)
        await page.keyboard.press("a")
        await badge(page, "accepted").wait_for()
        await page.goto(f"{bench.address}report", timeout=120_000)
        assert "slipped &lt;b&gt;once&lt;/b&gt;; set again." in await page.content()
        picture = page.locator("figure.photograph img").last
        assert await picture.evaluate("image => [image.naturalWidth, image.naturalHeight]") == [300, 400]
        words = page.locator("figure.photograph figcaption").last
        await expect(words).to_contain_text("Clamp 2 <i>seen</i> from above")
        assert await bench.ended() == 0
    journal = next((tmp_path / "state" / "sessions").glob("*.journal"))
    read = read_journal(journal.read_bytes())
    kept = [one for one in read.entries if isinstance(one, Noted)]
    photograph = photographs(read, journal)[-1]
    assert photograph.data.startswith(b"\xff\xd8") and photograph.entry.operator == "A. Operator"
    assert [(one.code, one.text) for one in kept] == [("remark", f"A. Operator: {said}")]
