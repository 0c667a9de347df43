"""Bench sessions begun at the page of `highside serve`: begun, gone to and come back from, stopped, gone on with; who
may; a page that ends and comes back; what a mistaken file or form is told."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil
import pytest
from bench_page import FILE, RING, SIX, chromium
from playwright.async_api import Page, expect
from signed_in import serving
from signed_in import signed_in as signed_in_as
from test_bench_page import CLICK_S, assert_accessible, assert_fits, badge
from test_tools_page import serve

FURTHER = pytest.mark.further

TOKEN = "a token of the bench's page"
BEGUN_MS = 60_000


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two benches' files, one that is mistaken, and the token."""
    made = tmp_path / "benches"
    made.mkdir()
    (made / "six.toml").write_text(FILE.format(speed=4.0, plan=SIX))
    (made / "ring.toml").write_text(FILE.format(speed=4.0, plan=RING))
    (made / "wrong.toml").write_text(FILE.format(speed=4.0, plan='kind = "jiont"'))
    token = tmp_path / "token"
    token.write_text(TOKEN + "\n")
    token.chmod(0o600)
    return made


def options(folder: Path) -> list[str]:
    state = folder.parent / "pages"
    return ["--bench", str(folder), "--set", f"bench.state={state}", "--set", f"web.token_file={folder.parent}/token"]


def processes(folder: Path) -> list[psutil.Process]:
    """The sessions that run with files of this folder."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            line = process.cmdline()
            if "calibrate" in line and any(str(folder) in word for word in line):
                found.append(process)
    return found


@pytest.fixture
def ended_afterwards(folder: Path) -> object:
    yield
    for process in processes(folder):
        process.kill()


async def signed_in(page: Page, address: str) -> None:
    page.set_default_timeout(CLICK_S)
    await page.goto(f"{address}bench")
    await page.fill("#token", TOKEN)
    await page.get_by_role("button", name="Sign in").click()
    await page.wait_for_url("**/bench")


@pytest.mark.timeout(600)
@pytest.mark.usefixtures("ended_afterwards")
async def test_a_session_is_begun_stopped_and_gone_on_with(folder: Path) -> None:
    hosts: set[str] = set()
    async with chromium() as browser:
        context = await browser.new_context(viewport={"width": 1280, "height": 900})
        page = await context.new_page()
        page.on("request", lambda request: hosts.add(urlsplit(request.url).hostname or urlsplit(request.url).scheme))
        async with serve(*options(folder)) as (address, server):
            await signed_in(page, address)
            for width in (320, 820, 1400):
                await page.set_viewport_size({"width": width, "height": 900})
                await assert_accessible(page, f"bench {width}")
                await assert_fits(page, f"bench {width}")
            await expect(page.get_by_role("region", name="wrong.toml")).to_contain_text("'jiont' is unknown")

            # another tool on that bench, by the other file's plan
            card = page.get_by_role("region", name="six.toml")
            await card.get_by_label("Tool").fill("tool-9")
            await card.get_by_label("Serial number").fill("00-17")
            await card.get_by_label("Plan").select_option("ring.toml")
            await card.get_by_label("Operator").fill("A. Technician")
            await card.get_by_role("button", name="Begin a session (six.toml)").click()
            await expect(page.get_by_role("region", name="session of tool-9")).to_be_visible(timeout=BEGUN_MS)
            assert len(processes(folder)) == 1
            assert processes(folder)[0].pid != server.pid, "who acquires is not who shows"
            await assert_accessible(page, "one runs")

            # to its page, with the right to command, and back
            await page.get_by_role("link", name="To the page of this session").click()
            await badge(page, "idle").wait_for()
            await expect(page.locator("caption")).to_contain_text("0 of 4")
            await page.click("[data-command=start]")
            await page.locator("tr.done").first.wait_for()
            await page.keyboard.press("p")
            await badge(page, "paused").wait_for()
            await assert_accessible(page, "a session that was begun here")
            await page.get_by_role("link", name="All sessions").click()
            await expect(page.locator("h1")).to_have_text("Bench")

        # the page has ended: the session has not
        assert [p.status() for p in processes(folder)], "it goes on"
        async with serve(*options(folder)) as (address, _):
            await page.goto(f"{address}bench")
            running = page.get_by_role("region", name="session of tool-9")
            await expect(running).to_contain_text("of 4 poses")
            await running.get_by_role("button", name="Stop").click()
            await expect(page.get_by_text("No session that was begun here runs.")).to_be_visible(timeout=BEGUN_MS)
            assert processes(folder) == [] and not list((folder.parent / "pages").glob("*"))
        (folder / "six.toml").write_text(FILE.format(speed=4.0, plan=SIX).replace("tool-7", "tool-9"))
        async with serve(*options(folder)) as (address, _):
            await page.goto(f"{address}bench")
            card = page.get_by_role("region", name="six.toml")
            await card.get_by_label("Operator").first.fill("B. Technician")
            await card.get_by_role("button", name="Go on with tool-9").click()
            await page.get_by_role("link", name="To the page of this session").click()
            await badge(page, "paused").wait_for()
            await page.keyboard.press("g")
            await badge(page, "review").wait_for()
            await page.keyboard.press("a")
            await badge(page, "accepted").wait_for()
            await page.get_by_role("link", name="All sessions").click()
            await page.get_by_role("button", name="Close").click()
            await expect(page.get_by_text("No session that was begun here runs.")).to_be_visible(timeout=BEGUN_MS)
    assert hosts <= {"127.0.0.1", "data", "blob"}, "no request leaves the host"
    records = list((folder / "state" / "calibrations" / "records").glob("*.json"))
    assert len(records) == 1 and '"tool-9"' in records[0].read_text()


@pytest.mark.usefixtures("ended_afterwards")
async def test_only_who_has_the_token_begins_and_a_mistake_is_one_line(folder: Path) -> None:
    async with serve(*options(folder)) as (address, _), httpx.AsyncClient(timeout=90.0) as client:
        form = {"file": "six.toml", "operator": "Eve", "id": "tool-7", "plan": "six.toml"}
        for path in ("begin", "resume", "close"):
            assert (await client.post(f"{address}bench/{path}", data=form)).status_code == 403
        shown = (await client.get(f"{address}bench")).text
        assert "six.toml" not in shown, "who only looks is shown no files"
        assert (await client.post(f"{address}bench/sign-in", data={"token": "wrong"})).status_code == 403
        assert (await client.post(f"{address}bench/sign-in", data={"token": TOKEN})).status_code == 303
        elsewhere = {"Origin": "http://elsewhere.example"}
        assert (await client.post(f"{address}bench/begin", data=form, headers=elsewhere)).status_code == 403
        for wrong, said in (
            ({"file": "../benches/six.toml"}, "there is no such file"),
            ({"plan": "wrong.toml"}, "is unknown; allowed"),
            ({"operator": ""}, "Say who you are"),
            ({"id": 'x"\nweb.port=1'}, "tool.id"),
            ({"plan": "/etc/passwd"}, "there is no such file"),
        ):
            answer = await client.post(f"{address}bench/begin", data=form | wrong)
            assert answer.status_code == 409 and said in answer.text, (wrong, answer.text[-1500:])
            assert str(folder) not in answer.text, wrong
        wrong_one = {"file": "six.toml", "session": "../x", "operator": "Eve"}
        assert "cannot be gone on with" in (await client.post(f"{address}bench/resume", data=wrong_one)).text
        assert processes(folder) == []

        # one that dies is forgotten; a token file of a session is for its user alone
        assert (await client.post(f"{address}bench/begin", data=form)).status_code == 303
        kept = folder.parent / "pages"
        assert [path.stat().st_mode & 0o077 for path in kept.glob("*.token")] == [0]
        assert kept.stat().st_mode & 0o077 == 0
        for process in processes(folder):
            os.kill(process.pid, signal.SIGKILL)
        async with asyncio.timeout(30.0):
            while "No session that was begun here runs." not in (await client.get(f"{address}bench")).text:
                await asyncio.sleep(0.2)
            # one that was killed is still there until the kernel and its parent are done with it
            while list(kept.glob("*")):
                await client.get(f"{address}bench")
                await asyncio.sleep(0.2)


@FURTHER
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("ended_afterwards")
async def test_with_people_the_role_decides_and_the_name_is_theirs(folder: Path, tmp_path: Path) -> None:
    """Who looks or operates sees what runs and begins nothing; who may put in force begins in their own name."""
    given = ("--bench", str(folder), "--set", f"bench.state={tmp_path}/pages")
    async with chromium() as browser, serving(tmp_path, *given) as served:
        for name in ("L. Look", "O. Operate"):
            page = await browser.new_page()
            await signed_in_as(page, served, name, "bench")
            await expect(page.locator("main")).to_contain_text(
                "Sessions are begun by who may put calibrations in force."
            )
            assert await page.locator("main form").count() == 0
            form = {"file": "six.toml", "id": "tool-7"}
            refused = await page.request.post(f"{served.address}bench/begin", form=form)
            assert refused.status == 403 and not processes(folder)
            await page.close()
        page = await browser.new_page()
        page.set_default_timeout(CLICK_S)
        await signed_in_as(page, served, "F. Force", "bench")
        card = page.get_by_role("region", name="six.toml")
        assert await card.get_by_label("Operator").count() == 0, "the name is that of who has signed in"
        await assert_accessible(page, "begin with people")
        if (shots := os.environ.get("HIGHSIDE_SHOTS")) is not None:
            await page.screenshot(path=f"{shots}/begin-with-people.png")
        # a name in the form counts for nothing
        form = {"file": "six.toml", "id": "tool-9", "operator": "Somebody Else"}
        begun = await page.request.post(f"{served.address}bench/begin", form=form, timeout=CLICK_S)
        assert begun.ok
        await page.goto(f"{served.address}bench")
        running = page.get_by_role("region", name="session of tool-9")
        await expect(running).to_contain_text("begun by F. Force with six.toml")
        await running.get_by_role("button", name="Stop").click()
        await expect(page.get_by_role("region", name="session of tool-9")).to_have_count(0)
        acts = [(act["who"], act["act"], act.get("file")) for act in served.done() if "bench session" in act["act"]]
        assert acts == [
            ("F. Force", "begin a bench session", "six.toml"),
            ("F. Force", "end the process of a bench session", None),
        ]
