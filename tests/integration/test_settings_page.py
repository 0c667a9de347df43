"""The configuration of a service at `highside serve`: checked before it is saved, with what a reload would change, the
old file kept; a mistake is told by file and field, and who may not put in force changes no calibration by this way."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
from bench_page import chromium
from playwright.async_api import expect
from signed_in import PASSWORD, highside, make_users, serving, signed_in
from test_acts import in_every_dress
from test_tools_page import watched

FILE = """# of the rig
[tool]
id = "tool-7"
[link]
kind = "serial"
port = "/dev/null"
baud = 115200
[codec]
name = "tool"
[pipeline]
output_rate_hz = 10.0
"""


@pytest.fixture(scope="module")
def users(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_users(tmp_path_factory.mktemp("users"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    made = tmp_path / "etc" / "highside.toml"
    made.parent.mkdir()
    made.write_text(FILE)
    made.chmod(0o640)
    return made


def told(file: Path) -> str:
    return file.read_text()


def mode_of(file: Path) -> int:
    return file.stat().st_mode & 0o777


def names_beside(file: Path) -> list[str]:
    return sorted(path.name for path in file.parent.iterdir())


async def test_a_change_is_shown_checked_and_saved(tmp_path: Path, users: Path, file: Path) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    async with serving(tmp_path, "--settings", str(file), users=users) as served, chromium() as browser:
        page = await (await browser.new_context(viewport={"width": 1400, "height": 900})).new_page()
        watched(page, hosts, faults)
        await signed_in(page, served, "O. Operate")
        await page.get_by_role("link", name="Configuration").click()
        text = page.get_by_label("The file")
        assert await text.input_value() == FILE
        await text.fill(FILE.replace("baud", "buad"))
        await page.get_by_role("button", name="Check and save").click()
        await expect(page.locator(".alarm")).to_contain_text("highside.toml: link.buad: is not a known field")
        faults.clear()  # a browser calls the answer 409 an error
        assert told(file) == FILE
        new = FILE.replace("10.0", "5.0").replace('"tool-7"', '"tool-8"')
        await text.fill(new)
        await page.get_by_role("button", name="Check", exact=True).click()
        rows = page.get_by_role("region", name="What a reload would change").locator("tbody tr")
        await expect(rows.filter(has_text="pipeline.output_rate_hz")).to_contain_text("5.0")
        await expect(rows.filter(has_text="pipeline.output_rate_hz")).to_contain_text("a reload")
        await expect(rows.filter(has_text="tool.id")).to_contain_text("a restart only")
        await in_every_dress(page, "settings")
        assert told(file) == FILE and names_beside(file) == ["highside.toml"]
        await page.get_by_role("button", name="Check and save").click()
        await expect(page.get_by_role("status")).to_contain_text("Saved; the old file is highside.toml.")
        assert told(file) == new and mode_of(file) == 0o640
        kept = file.with_name(names_beside(file)[1])
        assert told(kept) == FILE and mode_of(kept) == 0o640
        acts = [act for act in served.done() if act["act"] == "change the configuration"]
        assert [act["outcome"] for act in acts] == ["begins", "done"]
        assert "pipeline.output_rate_hz" in acts[1]["fields"] and acts[1]["kept"] == kept.name
    assert hosts == {"127.0.0.1"} and not faults


async def test_nobody_saves_what_is_not_theirs(tmp_path: Path, users: Path, file: Path) -> None:
    async with (
        serving(tmp_path, "--settings", str(file), users=users) as served,
        httpx.AsyncClient(base_url=served.address, timeout=120.0) as client,
    ):
        form = {"do": "save", "text": FILE.replace("10.0", "5.0"), "seen": "0" * 64}
        assert (await client.post("settings", data={"do": "save"})).status_code == 401
        await client.post("sign-in", data={"name": "L. Look", "password": f"{PASSWORD} of L. Look"})
        for answer in (await client.get("settings"), await client.post("settings", data={"do": "save"})):
            assert answer.status_code == 403 and "baud" not in answer.text
        await client.post("sign-in", data={"name": "O. Operate", "password": f"{PASSWORD} of O. Operate"})
        assert "changed meanwhile" in (await client.post("settings", data=form)).text
        seen = (await client.get("settings")).text.partition('name="seen" value="')[2][:64]
        (tmp_path / "etc" / "store").mkdir()
        for table in ('[calibration]\nstore = "store"\n', "[watch]\nthreshold = 900.0\n"):
            answer = await client.post("settings", data={"do": "save", "seen": seen, "text": FILE + table})
            assert "put in force" in answer.text and answer.status_code == 409, table
        elsewhere = {"Origin": "https://elsewhere.example"}
        right = form | {"seen": seen}
        assert (await client.post("settings", data=right, headers=elsewhere)).status_code == 403
        for text in ("", "[", "\x00", "x" * 100_001, "[plan]\n", 'a = "' + "[" * 9_000):
            assert (await client.post("settings", data={"do": "save", "seen": seen, "text": text})).status_code == 409
        assert (await client.post("settings", content=b"text=" + b"x" * 1_300_000)).status_code == 413
        assert told(file) == FILE and names_beside(file) == ["highside.toml", "store"]
        # a calibration: who may put in force may
        await client.post("sign-in", data={"name": "F. Force", "password": f"{PASSWORD} of F. Force"})
        text = FILE + "[watch]\nthreshold = 900.0\n"
        assert (await client.post("settings", data={"do": "save", "seen": seen, "text": text})).status_code == 200
        assert told(file) == text


def test_settings_without_users_are_refused(file: Path) -> None:
    said = highside("serve", "--settings", file, "--set", "web.port=0", status=2)
    assert "settings needs [web] users" in said
