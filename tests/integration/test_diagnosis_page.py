"""A diagnosis in a real browser: a file is sent, what its columns are taken for is shown and confirmed, a child process
works, the report is read; strangers send nothing, nothing they name is a path, and nothing of a job stays behind."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import psutil
import pytest
from bench_page import HIGHSIDE, chromium
from broker import free_port
from playwright.async_api import Error, Page, Route, expect
from test_bench_page import assert_accessible, assert_fits
from test_tools_page import watched

import highside

SHOTS = os.environ.get("HIGHSIDE_SHOTS")
MODEL = Path(__file__).parents[2] / "config" / "model-bench.toml"
JOB_MS = 240_000
SCRIPT = Path(highside.__file__).parent / "web" / "diagnosis" / "diagnosis.js"
RUNNING = '<p id="words" data-stage="running">1 s so far</p><p id="lost" role="alert" hidden>nothing is heard</p>'


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of ours, the same as another program would write it (m/s2, other names), and one of nothing."""
    folder = tmp_path_factory.mktemp("files")
    made = highside.simulate(MODEL, seed=1).recording
    made.write(folder / "own.csv")
    lines = ["time,accel_x,accel_y,accel_z,inc,tf"]
    columns = [made[name] for name in ("t_s", "ax_g", "ay_g", "az_g", "inc_ref_deg", "tf_ref_deg")]
    for t, x, y, z, inc, tf in zip(*columns, strict=True):
        lines.append(f"{t},{x * 9.80665:.7f},{y * 9.80665:.7f},{z * 9.80665:.7f},{inc},{tf}")
    (folder / "theirs <b>.csv").write_text("\n".join(lines) + "\n")
    (folder / "nothing.csv").write_text("a,b\n" + "1,2\n" * 30)
    return folder


def kept_of(folder: Path, name: str = "recording*") -> list[Path]:
    return list(folder.rglob(name))


@contextlib.asynccontextmanager
async def serving(tmp: Path, *options: str) -> AsyncIterator[tuple[str, str, asyncio.subprocess.Process]]:
    """The address, and the link with the token; ends with 0, no file or child of it left."""
    process = await asyncio.create_subprocess_exec(
        HIGHSIDE, "serve", "--diagnose", "--set", "web.port=0", "--set", f"mqtt.port={free_port()}", *options,
        stderr=asyncio.subprocess.PIPE, env=os.environ | {"TMPDIR": str(tmp)},
    )  # fmt: skip
    assert process.stderr is not None
    try:
        async with asyncio.timeout(120.0):
            link = (await process.stderr.readline()).decode().split()[-1]
            address = (await process.stderr.readline()).decode().split()[-1]
        yield address, link, process
        children = psutil.Process(process.pid).children(recursive=True)
        process.terminate()
        async with asyncio.timeout(60.0):
            assert await process.wait() == 0
        assert not [child for child in children if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]
        assert not kept_of(tmp, "*"), "nothing of a job stays behind"
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def looked_at(page: Page, name: str) -> None:
    await assert_accessible(page, name)
    for scheme, width in (("light", 320), ("dark", 1400)):
        await page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        await page.set_viewport_size({"width": width, "height": 900})
        await assert_accessible(page, f"{name} {scheme} {width}")
        await assert_fits(page, f"{name} {scheme} {width}")
        if SHOTS:
            await page.screenshot(path=f"{SHOTS}/diagnosis-{name}-{scheme}-{width}.png", full_page=True)


async def test_a_foreign_file_is_confirmed_and_diagnosed(files: Path, tmp_path: Path) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    async with serving(tmp_path) as (_, link, _), chromium() as browser:
        page = await (await browser.new_context(viewport={"width": 1400, "height": 900})).new_page()
        watched(page, hosts, faults)
        await page.goto(link)
        await page.get_by_role("link", name="Diagnosis").click()
        await looked_at(page, "begin")
        await page.set_input_files("#recording", files / "theirs <b>.csv")
        await page.set_input_files("#model", MODEL)
        await page.get_by_role("button", name="Look at it").press("Enter")
        await expect(page.locator("h1")).to_have_text("The file leaves something open.", timeout=JOB_MS)
        await expect(page.locator("#words")).to_contain_text("theirs <b>.csv")
        row = page.get_by_role("region", name="columns").locator("tr", has_text="accel_x")
        await expect(row).to_contain_text("ax_g")
        await expect(row).to_contain_text("m/s2")
        await expect(page.locator(".alarm")).to_contain_text("t_s from time: its unit may be s or ms")
        assert await page.get_by_role("button", name="Yes: diagnose it").count() == 0
        await looked_at(page, "open")
        await page.locator("#map").fill("t_s=time:s\ninc_ref_deg=inc:deg\ntf_ref_deg=tf:deg")
        await page.get_by_role("button", name="Look again").press("Enter")
        await expect(page.locator("h1")).to_have_text("Is this what the file holds?", timeout=JOB_MS)
        await expect(page.locator("#map")).to_have_value("t_s=time:s\ninc_ref_deg=inc:deg\ntf_ref_deg=tf:deg")
        await looked_at(page, "looked")
        await page.get_by_role("button", name="Yes: diagnose it").press("Enter")
        await expect(page.locator("h1")).to_have_text("The diagnosis is in progress.", timeout=JOB_MS)
        first = await page.locator("#words").inner_text()
        await expect(page.locator("#words")).not_to_have_text(first, timeout=JOB_MS)
        await looked_at(page, "running")
        await expect(page.locator("h1")).to_have_text("The diagnosis is done.", timeout=JOB_MS)
        await expect(page.locator("section.card").first).to_contain_text("nothing_left_out")
        await looked_at(page, "done")
        await page.get_by_role("link", name="the report").click()
        await expect(page.locator("h1").first).to_be_visible()
        assert await page.evaluate("self.origin") == "null", "a report is of no origin of ours"
        await expect(page.locator("body")).to_contain_text("theirs <b>.csv")
        assert "recording.csv" not in await page.content(), "the file has its own name, not the one it is kept under"
        await page.go_back()
        await page.get_by_role("button", name="Another file").click()
        await expect(page.locator("#recording")).to_be_visible()

        # in which nothing is found
        await page.set_input_files("#recording", files / "nothing.csv")
        await page.get_by_role("button", name="Look at it").click()
        await expect(page.locator(".alarm").first).to_contain_text("no column is a time", timeout=JOB_MS)
        await page.locator("#map").fill("t_s=nowhere:s")
        await page.get_by_role("button", name="Look again").click()
        await expect(page.locator("h1")).to_have_text("It could not be done.", timeout=JOB_MS)
        await expect(page.locator(".alarm")).to_contain_text("nothing.csv")
        await looked_at(page, "failed")
    assert hosts <= {"127.0.0.1", "data", "blob"}, f"nobody else is asked: {hosts}"
    assert faults == []


async def test_strangers_send_nothing_and_forms_come_from_our_own_pages(files: Path, tmp_path: Path) -> None:
    sent = {"recording": ("x.csv", (files / "own.csv").read_bytes())}
    async with (
        serving(tmp_path, "--set", "diagnosis.upload_mb=1") as (address, link, _),
        httpx.AsyncClient(timeout=60.0) as client,
    ):
        for path in ("", "/report", "/diagnosis.json", "/state"):
            assert (await client.get(f"{address}diagnosis{path}")).status_code == 401
        # its body is not even read
        assert (await client.post(f"{address}diagnosis/file", files=sent)).status_code == 413
        for path in ("look", "run", "forget"):
            assert (await client.post(f"{address}diagnosis/{path}")).status_code == 401
        wrong = await client.post(f"{address}diagnosis/sign-in", data={"token": "x" * 24})
        assert wrong.status_code == 403 and "set-cookie" not in wrong.headers
        token = link.partition("token=")[2]
        right = await client.post(f"{address}diagnosis/sign-in", data={"token": token})
        assert right.status_code == 303 and right.headers["location"] == "/diagnosis"
        shown = right.headers["set-cookie"].lower()
        assert "httponly" in shown and "samesite=strict" in shown
        # a page elsewhere, and one of another program on this machine, which SameSite does not tell apart
        for origin in ("http://evil.example", "http://127.0.0.1:1", "null"):
            answer = await client.post(f"{address}diagnosis/file", files=sent, headers={"Origin": origin})
            assert answer.status_code == 403, origin
        large = {"recording": ("x.csv", b"1," * 700_000)}
        assert (await client.post(f"{address}diagnosis/file", files=large)).status_code in (409, 413)
        model = {**sent, "model": ("m.toml", b"#" * 250_000)}
        assert (await client.post(f"{address}diagnosis/file", files=model)).status_code in (409, 413)
        assert (await client.post(f"{address}diagnosis/file", data={"recording": "x"})).status_code == 409
        assert not kept_of(tmp_path), "none of that was kept"


async def test_names_and_words_are_no_paths_and_no_options(files: Path, tmp_path: Path) -> None:
    async with (
        serving(tmp_path) as (address, link, _),
        httpx.AsyncClient(timeout=120.0, follow_redirects=True) as client,
    ):
        await client.get(link)
        for name in ("../../../../tmp/x.csv", "/etc/passwd", "a\nb.csv", "--output=x.csv", "x" * 500 + ".csv"):
            files_ = {"recording": (name, (files / "own.csv").read_bytes())}
            answer = await client.post(f"{address}diagnosis/file", files=files_)
            assert answer.status_code == 200
        assert [path.name for path in kept_of(tmp_path)] == ["recording.csv"], "one job a viewer, under a name of ours"
        words = {"map": "--output=/tmp/x\nax_g=accel_x:m/s2", "axes": "--yes", "units": "-o", "rate": "--help"}
        await _settled(client, address)
        await client.post(f"{address}diagnosis/look", data=words)
        said = await _settled(client, address)
        assert "It could not be done." in said and str(tmp_path) not in said and "Traceback" not in said
        assert (await client.get(f"{address}diagnosis/report")).url.path == "/diagnosis", "there is none"


async def test_a_job_is_cancelled_and_its_child_is_gone(files: Path, tmp_path: Path) -> None:
    async with (
        serving(tmp_path) as (address, link, process),
        httpx.AsyncClient(timeout=120.0, follow_redirects=True) as client,
    ):
        await client.get(link)
        sent = {"recording": ("own.csv", (files / "own.csv").read_bytes()), "model": ("m", MODEL.read_bytes())}
        await client.post(f"{address}diagnosis/file", files=sent)
        await _settled(client, address)
        await client.post(f"{address}diagnosis/run")
        async with asyncio.timeout(60.0):
            while not (children := psutil.Process(process.pid).children(recursive=True)):
                await asyncio.sleep(0.05)
        await client.post(f"{address}diagnosis/forget")
        _, alive = psutil.wait_procs(children, timeout=30.0)
        assert alive == []
        assert "Send a recording" in (await client.get(f"{address}diagnosis")).text
        assert not kept_of(tmp_path)


async def _settled(client: httpx.AsyncClient, address: str) -> str:
    """The page, once no child works."""
    async with asyncio.timeout(240.0):
        while (await client.get(f"{address}diagnosis/state")).json()["stage"] in ("looking", "waiting", "running"):
            await asyncio.sleep(0.2)
    return (await client.get(f"{address}diagnosis")).text


async def test_a_server_that_answers_no_more_is_told_in_words_and_answers_again() -> None:
    answers = asyncio.Event()

    async def state(route: Route) -> None:
        await answers.wait()
        with contextlib.suppress(Error):  # those that were given up
            await route.fulfill(json={"stage": "running", "words": "3 s so far"})

    async with chromium() as browser:
        page = await browser.new_page()
        await page.add_init_script(
            "const t = AbortSignal.timeout; AbortSignal.timeout = ms => t.call(AbortSignal, ms / 50)"
        )
        await page.route("**/*", lambda route: route.fulfill(content_type="text/html", body=RUNNING))
        await page.route("**/diagnosis/state", state)
        await page.goto("http://bench.test/diagnosis")
        await page.add_script_tag(path=SCRIPT)
        lost = page.locator("#lost")
        await expect(lost).to_be_hidden()
        await expect(lost).to_be_visible()
        answers.set()
        await expect(lost).to_be_hidden()
        await expect(page.locator("#words")).to_have_text("3 s so far")


async def test_without_it_there_is_no_such_page(tmp_path: Path) -> None:
    from test_tools_page import serve

    async with serve("--set", f"mqtt.port={free_port()}") as (address, _), httpx.AsyncClient(timeout=60.0) as client:
        assert (await client.get(f"{address}diagnosis")).status_code == 404
        assert (await client.post(f"{address}diagnosis/file", content=b"x" * 2_000)).status_code in (404, 413)
