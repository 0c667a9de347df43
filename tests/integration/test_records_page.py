"""What is kept, in a real browser: records with their history and uncertainty, two compared, sessions of a real bench;
no script, nobody else is asked, nothing is written, and no name from outside becomes a path or markup."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from bench_page import FILE, HIGHSIDE, SIX, chromium
from broker import free_port
from playwright.async_api import Page, expect
from test_bench_page import assert_accessible, assert_fits
from test_tools_page import serve, watched

from highside.bench import photographs
from highside.bench.session.entries import Photographed
from highside.bench.session.journal import encode_all, read_journal
from highside.calibration.method import SolveRequest
from highside.calibration.record import CalibrationRecord, Environment, build_record, solve_poses
from highside.physics.gravity import gravity_direction
from highside.recording.calibration_store import CalibrationStore
from tests.photograph import a_photograph

FURTHER = pytest.mark.further

SHOTS = os.environ.get("HIGHSIDE_SHOTS")
NOW = time.time()
EVIL = '<img src=x onerror="document.title=1">'


def record(seed: int, tool: str = "tool-7", days: float | None = None) -> CalibrationRecord:
    """Of a sensor of its own: matrices differ by 2e-3."""
    rng = np.random.default_rng(seed)
    inc, tf = np.repeat((10.0, 45.0, 80.0), 8), np.tile(np.arange(0.0, 360.0, 45.0), 3)
    matrix = np.eye(3) + 2e-3 * rng.standard_normal((3, 3))
    read = matrix @ gravity_direction(np.deg2rad(inc), np.deg2rad(tf)) + 1e-5 * rng.standard_normal((3, inc.size))
    table = {"inc_ref_deg": inc.tolist(), "tf_ref_deg": tf.tolist(), "n": [100.0] * inc.size}
    table |= {name: row.tolist() for name, row in zip(("ax", "ay", "az"), read, strict=True)}
    request = SolveRequest("joint")
    found = solve_poses(table, request)
    return build_record(
        tool_id=tool, serial=None, request=request, result=found.result, pose_columns=table, raw_sha256="0" * 64,
        raw_name="poses.csv", environment=Environment("bench 1", EVIL, 25.0), now_s=NOW - 86_400.0,
        expires_s=None if days is None else NOW - 86_400.0 + days * 86_400.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with three records, two of them put in force one after the other, one damaged, and a bench session."""
    folder = tmp_path_factory.mktemp("kept")
    (folder / "bench.toml").write_text(FILE.format(speed=200.0, plan=SIX))
    subprocess.run(
        [HIGHSIDE, "calibrate", "bench", "--config", folder / "bench.toml", "--auto", "--operator", "A. Operator"],
        check=True, capture_output=True, timeout=240, cwd=folder,
    )  # fmt: skip
    store = CalibrationStore(folder / "state" / "calibrations")
    first, second, other = record(1), record(2), record(3, tool=EVIL, days=0.5)
    for one in (first, second):
        store.activate(one, now_s=NOW)
    store.add(other)
    damaged = store.directory / "records" / f"{'0' * 64}.json"
    damaged.write_text(second.to_json().replace("bench 1", "bench 2"))
    photographed(next((folder / "state" / "sessions").glob("*.journal")))
    (folder / "state" / "sessions" / "tool-7_20261121T024000Z.journal").write_text("not a journal\n")
    return folder


def photographed(path: Path) -> None:
    """Two photographs to a session, one of them changed afterwards."""
    journal = read_journal(path.read_bytes())
    entries = list(zip(journal.entries, journal.times_s, strict=True))
    for height in (300, 310):
        picture = photographs.drawn_anew(a_photograph(400, height))
        photographs.keep(path, picture)
        entries.append((Photographed("A. Operator", EVIL, picture.sha256, picture.width, picture.height), NOW))
    path.write_bytes(encode_all(journal.header, entries))
    with (photographs.folder_of(path) / f"{picture.sha256}.jpg").open("ab") as file:
        file.write(b"more")


def options(kept: Path) -> tuple[str, ...]:
    state = kept / "state"
    return (
        "--set", f"mqtt.port={free_port()}", "--records", str(state / "calibrations"),
        "--sessions", str(state / "sessions"),
    )  # fmt: skip


def contents(kept: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in kept.rglob("*")}


async def in_every_dress(page: Page, name: str) -> None:
    for scheme in ("light", "dark"):
        await page.emulate_media(color_scheme=scheme)
        for width in (3840, 320) if scheme == "light" else (1400,):
            await page.set_viewport_size({"width": width, "height": 900})
            await assert_accessible(page, f"{name} {scheme} {width}")
            await assert_fits(page, f"{name} {scheme} {width}")
            if SHOTS:
                await page.screenshot(path=f"{SHOTS}/{name}-{scheme}-{width}.png", full_page=True)
    await page.set_viewport_size({"width": 1400, "height": 900})


@FURTHER
async def test_what_is_kept_is_read_in_a_browser_by_the_keyboard(kept: Path) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    before = contents(kept)
    store = CalibrationStore(kept / "state" / "calibrations")
    first, second = (entry.record_id for entry in store.history("tool-7"))
    async with serve(*options(kept)) as (address, _), chromium() as browser:
        page = await (await browser.new_context(viewport={"width": 1400, "height": 900})).new_page()
        watched(page, hosts, faults)
        await page.goto(address)
        await page.get_by_role("link", name="Calibrations").click()
        await expect(page.locator("h1")).to_have_text("5 calibrations kept.")
        await expect(page.locator("tr", has=page.get_by_role("link", name=second[:12]))).to_contain_text("in force")
        await expect(page.locator("tr", has=page.get_by_role("link", name=first[:12]))).not_to_contain_text("in force")
        await expect(page.locator("tr", has_text=EVIL)).to_contain_text("expired")
        await expect(page.locator("tr.bad")).to_contain_text("tampered")
        await in_every_dress(page, "calibrations")

        # two of them, by the keyboard alone
        await page.locator(f"input[name=before][value='{first}']").focus()
        await page.keyboard.press("Space")
        await page.locator(f"input[name=after][value='{second}']").focus()
        await page.keyboard.press("Space")
        await page.keyboard.press("Enter")
        await expect(page.locator("h1")).to_have_text(f"From {first[:12]} to {second[:12]}")
        change = 1e3 * (store.get(second).result.b[0] - store.get(first).result.b[0])
        row = page.get_by_role("region", name="coefficients").locator("tr", has_text="b_x")
        shown = (await row.locator("td").nth(3).inner_text()).split()[0]
        assert float(shown) == pytest.approx(change, abs=0.6 * 10.0 ** -len(shown.partition(".")[2]))
        await in_every_dress(page, "comparison")

        await page.get_by_role("link", name=second[:12]).click()
        await expect(page.locator("h1")).to_contain_text("in force")
        await expect(page.get_by_role("region", name="history").locator("tbody tr")).to_have_count(2)
        await expect(page.locator("dl.facts")).to_contain_text(EVIL)
        await page.locator("summary").click()
        await expect(page.get_by_role("region", name="poses").locator("tbody tr")).to_have_count(24)
        await in_every_dress(page, "calibration")

        await page.get_by_role("link", name="Bench sessions").click()
        await expect(page.locator("h1")).to_have_text("2 bench sessions kept.")
        await expect(page.locator("tr", has_text="damaged")).to_have_count(1)
        await in_every_dress(page, "sessions")
        await page.locator("tr", has_text="accepted").get_by_role("link").click()
        await expect(page.locator("h1")).to_contain_text("accepted")
        await expect(page.get_by_role("region", name="poses").locator("tbody tr")).to_have_count(6)
        await expect(page.get_by_role("columnheader", name="attempts")).to_be_visible()
        taken = page.locator("figure.photograph")
        await expect(taken).to_have_count(1)
        await taken.scroll_into_view_if_needed()
        await expect(taken.locator("img")).to_have_js_property("naturalWidth", 300)
        await expect(taken.locator("figcaption")).to_contain_text(EVIL)
        await expect(page.locator(".alarm")).to_contain_text("was changed after it was taken")
        await in_every_dress(page, "session")
        await page.get_by_role("link", name="report").click()
        await expect(page.locator("h1")).to_contain_text("Session tool-7")
        assert await page.locator("svg, img").count() > 0
    assert hosts <= {"127.0.0.1", "data", "blob"}, f"nobody else is asked: {hosts}"
    assert faults == []
    assert contents(kept) == before, "looking changes nothing"


async def test_names_from_outside_are_looked_up_and_nothing_else(kept: Path) -> None:
    store = CalibrationStore(kept / "state" / "calibrations")
    name = store.active_id("tool-7")
    wrong = [
        "calibrations/0000", f"calibrations/{'1' * 64}", "calibrations/..%2f..%2fbench.toml",
        f"calibrations/{'0' * 64}",
        "calibrations/compare", f"calibrations/compare?before={name}&after=../x", f"calibrations/{name}x.json",
        "sessions/..%2f..%2fbench", "sessions/nobody", "sessions/nobody/report", "sessions/%00",
        "sessions/tool-7_20261121T024000Z/report", f"sessions/{'a' * 3000}",
    ]  # fmt: skip
    async with serve(*options(kept)) as (address, _), httpx.AsyncClient(timeout=60.0) as client:
        for path in wrong:
            answer = await client.get(address + path)
            assert answer.status_code == 404, path
            assert "Traceback" not in answer.text and "[tool]" not in answer.text and str(kept) not in answer.text
        answer = await client.get(f"{address}calibrations/{name}")
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        assert "<script" not in answer.text and EVIL not in answer.text
        itself = await client.get(f"{address}calibrations/{name}.json")
        assert json.loads(itself.text) == json.loads(store.get(str(name)).to_json())
        for first in ("-1", "x", "9" * 30, "0", "3", "\u0663"):
            assert (await client.get(f"{address}calibrations", params={"first": first})).status_code == 200
        for method in ("POST", "PUT", "DELETE"):
            assert (await client.request(method, f"{address}calibrations/{name}")).status_code in (404, 405)
        elsewhere = await client.get(f"{address}calibrations", headers={"Host": "rig.example.org"})
        assert elsewhere.status_code == 421


async def test_a_crowd_is_told_to_come_back_and_each_answer_is_whole(kept: Path) -> None:
    async with serve(*options(kept)) as (address, _):
        limits = httpx.Limits(max_connections=100)
        async with httpx.AsyncClient(timeout=120.0, limits=limits) as client:
            answers = await asyncio.gather(*(client.get(f"{address}calibrations") for _ in range(100)))
            codes = {answer.status_code for answer in answers}
            assert 200 in codes and codes <= {200, 503}
            assert all("calibrations kept" in answer.text for answer in answers if answer.status_code == 200)
            assert (await client.get(f"{address}api/tools")).status_code == 200


async def test_without_records_there_are_no_such_pages(kept: Path) -> None:
    async with serve("--set", f"mqtt.port={free_port()}") as (address, _), httpx.AsyncClient(timeout=60.0) as client:
        for path in ("calibrations", "sessions", "style.css"):
            assert (await client.get(address + path)).status_code == 404


async def test_a_damaged_history_is_said_and_the_records_are_shown(kept: Path) -> None:
    entry = kept / "state" / "calibrations" / "activations" / "00000003.json"
    entry.write_text("{}")
    try:
        async with serve(*options(kept)) as (address, _), httpx.AsyncClient(timeout=60.0) as client:
            answer = await client.get(f"{address}calibrations")
            assert "What is in force is not known" in answer.text and "5 calibrations kept" in answer.text
            assert str(kept) not in answer.text, "where it is kept is its owner's business"
    finally:
        entry.unlink()


def test_a_directory_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    for option in ("--records", "--sessions"):
        command = [str(HIGHSIDE), "serve", option, str(tmp_path / "nowhere")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        assert "nowhere" in done.stderr and "no such directory" in done.stderr
    wrong = tmp_path / "serve.toml"
    for text in ("web = 5\n", "records = 5\n", '[records]\nstor = "x"\n'):
        wrong.write_text(text)
        done = subprocess.run(
            [str(HIGHSIDE), "serve", "--config", str(wrong)], capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
