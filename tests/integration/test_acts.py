"""What signed-in people do at `highside serve`: a calibration put in force and taken back after a look at what changes,
commands to a real service's topics; each in the journal, and nothing for whom it is not."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiomqtt
import httpx
import pytest
from bench_page import chromium
from broker import Mosquitto
from playwright.async_api import Page, expect
from signed_in import PASSWORD, make_users, serving, signed_in
from test_bench_page import assert_accessible, assert_fits
from test_records_page import EVIL, record
from test_tools_page import mosquitto, tool, watched

from highside.recording.calibration_store import CalibrationStore
from highside.service.tasks import ended

__all__ = ["mosquitto"]
"""a fixture"""
SENT_MS = 60_000
"""Within which the page that answers a form is there, on a busy machine"""


@pytest.fixture(scope="module")
def users(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_users(tmp_path_factory.mktemp("users"))


@pytest.fixture
def store(tmp_path: Path) -> CalibrationStore:
    """Three records of one tool, the first in force, the last expired."""
    made = CalibrationStore(tmp_path / "calibrations")
    made.activate(record(1), now_s=time.time())
    made.add(record(2))
    made.add(record(3, days=0.5))
    return made


async def in_every_dress(page: Page, name: str) -> None:
    for width in (320, 1400, 3840):
        await page.set_viewport_size({"width": width, "height": 900})
        await assert_accessible(page, f"{name} {width}")
        await assert_fits(page, f"{name} {width}")


async def test_a_calibration_is_put_in_force_and_taken_back(
    tmp_path: Path, users: Path, store: CalibrationStore
) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    first, second = record(1).id, record(2).id
    options = ("--records", str(store.directory))
    async with serving(tmp_path, *options, users=users) as served, chromium() as browser:
        page = await (await browser.new_context(viewport={"width": 1400, "height": 900})).new_page()
        watched(page, hosts, faults)
        await signed_in(page, served, "F. Force", f"calibrations/{second}")
        await page.get_by_role("link", name="put it in force").click()
        await expect(page.locator("h1")).to_have_text("Put this calibration in force?")
        await expect(page.locator(".said").first).to_contain_text(f"In force afterwards: {second[:12]}")
        await expect(page.locator(".said").first).to_contain_text(f"In force now: {first[:12]}")
        assert await page.get_by_role("region", name="What changes").locator("tbody tr").count() > 3
        await in_every_dress(page, "put in force")
        await page.get_by_role("button", name="Put it in force").focus()
        await page.keyboard.press("Enter")
        await expect(page.locator("h1")).to_contain_text(second[:12], timeout=SENT_MS)
        assert store.active_id("tool-7") == second
        await page.get_by_role("link", name="take it back").click()
        await page.get_by_role("button", name="Take it back").click()
        await expect(page.locator("h1")).to_contain_text(first[:12], timeout=SENT_MS)
        assert store.active_id("tool-7") == first
        # and that one too, though none was in force before it
        await page.get_by_role("link", name="take it back").click()
        await expect(page.locator(".said").first).to_contain_text("In force afterwards: none.")
        await expect(page.locator(".warning")).to_contain_text("the tool's readings pass uncorrected")
        await in_every_dress(page, "taken out of force")
        await page.get_by_role("button", name="Take it back").click()
        await expect(page.get_by_role("region", name="history").locator("tbody tr").first).to_contain_text(
            "nothing", timeout=SENT_MS
        )
        assert store.active_id("tool-7") is None
        await page.goto(f"{served.address}calibrations")
        await expect(page.locator("table")).not_to_contain_text("in force")
        await page.goto(f"{served.address}calibrations/{record(3, days=0.5).id}/force")
        await expect(page.locator(".alarm")).to_contain_text("expired")
        assert await page.get_by_role("button", name="Put it in force").count() == 0
        acts = [(act["act"], act["outcome"], act["who"], act.get("record")) for act in served.done()]
        assert acts[1:] == [
            ("put a calibration in force", "begins", "F. Force", second),
            ("put a calibration in force", "done", "F. Force", second),
            ("take back a calibration", "begins", "F. Force", first),
            ("take back a calibration", "done", "F. Force", first),
            ("take back a calibration", "begins", "F. Force", "none"),
            ("take back a calibration", "done", "F. Force", "none"),
        ]
    assert hosts == {"127.0.0.1"} and not faults


async def test_nobody_else_puts_anything_in_force(tmp_path: Path, users: Path, store: CalibrationStore) -> None:
    first, second, expired = record(1).id, record(2).id, record(3, days=0.5).id
    options = ("--records", str(store.directory))
    async with serving(tmp_path, *options, users=users) as served:
        asked = f"calibrations/{second}/force"
        for name in (None, "L. Look", "O. Operate"):
            async with httpx.AsyncClient(base_url=served.address, timeout=60.0) as client:
                if name is not None:
                    await client.post("sign-in", data={"name": name, "password": f"{PASSWORD} of {name}"})
                    assert "put it in force" not in (await client.get(f"calibrations/{second}")).text
                for answer in (await client.get(asked), await client.post(asked, data={"seen": first})):
                    assert answer.status_code == (401 if name is None else 403), name
        async with httpx.AsyncClient(base_url=served.address, timeout=60.0) as client:
            await client.post("sign-in", data={"name": "F. Force", "password": f"{PASSWORD} of F. Force"})
            elsewhere = {"Origin": "https://elsewhere.example"}
            assert (await client.post(asked, data={"seen": first}, headers=elsewhere)).status_code == 403
            assert (await client.post(asked, data={"seen": first}, headers={"Origin": "null"})).status_code == 403
            for seen in ("", "none", second, "0" * 64):
                assert "meanwhile" in (await client.post(asked, data={"seen": seen})).text, seen
            assert "expired" in (await client.post(f"calibrations/{expired}/force", data={"seen": first})).text
            for name in ("..%2f..%2fusers", "0" * 64, "tool-7", "%00"):
                assert (await client.post(f"calibrations/{name}/force", data={"seen": first})).status_code == 404
            assert "meanwhile" in (await client.post(f"calibrations/{first}/back", data={"seen": second})).text
            assert (await client.post(f"calibrations/{second}/back", data={"seen": first})).status_code == 404
            assert (await client.post(asked, content=b"seen=" + b"x" * 2_000)).status_code == 413
            # a journal that cannot be written: nothing is done
            served.acts.unlink()
            served.acts.mkdir()
            answer = await client.post(asked, data={"seen": first})
            assert "nothing was done" in answer.text and answer.status_code == 404
        assert store.active_id("tool-7") == first and len(store.history()) == 1


async def test_only_what_a_trusted_key_signed_is_put_in_force(
    tmp_path: Path, users: Path, store: CalibrationStore
) -> None:
    from highside.calibration.signature import new_key
    from highside.recording.keys import write_key

    key = new_key("A. Laboratory")
    public = write_key(tmp_path / "lab.key", key)
    store.add(record(2).signed(key, now_s=time.time()))
    options = ("--records", str(store.directory), "--set", f"records.trusted_keys={public}")
    unsigned = record(4)
    store.add(unsigned)
    first, second = record(1).id, record(2).id
    async with (
        serving(tmp_path, *options, users=users) as served,
        httpx.AsyncClient(base_url=served.address, timeout=60.0) as client,
    ):
        await client.post("sign-in", data={"name": "F. Force", "password": f"{PASSWORD} of F. Force"})
        refused = await client.post(f"calibrations/{unsigned.id}/force", data={"seen": first})
        assert "only signed" in refused.text and store.active_id("tool-7") == first
        assert (await client.post(f"calibrations/{second}/force", data={"seen": first})).status_code == 303
        assert store.active_id("tool-7") == second
        back = await client.post(f"calibrations/{second}/back", data={"seen": second})
        assert back.status_code == 404 and store.active_id("tool-7") == second, "the one before is not signed"


@contextlib.asynccontextmanager
async def answering(port: int, name: str, heard: list[dict[str, Any]]) -> AsyncIterator[None]:
    """A service that answers commands: the first with a refusal."""
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe(f"highside/{name}/+/command")

        async def answer() -> None:
            async for message in client.messages:
                command = json.loads(bytes(message.payload))  # type: ignore[arg-type]
                heard.append(command)
                ok = len(heard) > 1
                reply = {"id": command["id"], "t": time.time(), "ok": ok, "error": None if ok else "nothing to do"}
                await client.publish(str(message.topic).replace("command", "reply"), json.dumps(reply))

        task = asyncio.create_task(answer())
        try:
            yield
        finally:
            await ended(task)


async def test_who_may_operate_commands_a_tool(tmp_path: Path, users: Path, mosquitto: Mosquitto) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    heard: list[dict[str, Any]] = []
    options = ("--set", f"mqtt.port={mosquitto.port}")
    async with (
        serving(tmp_path, *options, users=users) as served,
        chromium() as browser,
        tool(mosquitto.port, "rig 7"),
        answering(mosquitto.port, "rig 7", heard),
    ):
        page = await (await browser.new_context(viewport={"width": 1400, "height": 900})).new_page()
        watched(page, hosts, faults)
        await signed_in(page, served, "O. Operate")
        await page.locator(".card a").first.click()
        await page.get_by_role("link", name="commands").click()
        await expect(page.locator("h1")).to_have_text("Commands to rig 7")
        await in_every_dress(page, "commands")
        await page.get_by_role("button", name="Acknowledge").click()
        await expect(page.locator(".alarm")).to_contain_text("nothing to do", timeout=SENT_MS)
        faults.clear()  # a browser calls the answer 409 an error
        await page.get_by_label(re.compile("^Azimuth")).fill("123,5")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("status")).to_contain_text("Done: align the azimuth", timeout=SENT_MS)
        assert [(one["command"], one.get("azimuth_deg")) for one in heard] == [("acknowledge", None), ("align", 123.5)]
        outcomes = [(act["act"], act["outcome"], act.get("azimuth_deg")) for act in served.done()][1:]
        assert outcomes == [
            ("acknowledge the departure", "begins", None),
            ("acknowledge the departure", "nothing to do", None),
            ("align the azimuth", "begins", 123.5),
            ("align the azimuth", "done", 123.5),
        ]
        async with httpx.AsyncClient(base_url=served.address, timeout=60.0) as client:
            await client.post("sign-in", data={"name": "L. Look", "password": f"{PASSWORD} of L. Look"})
            for answer in (
                await client.get("command/rig%207"),
                await client.post("command/rig%207", data={"command": "restart"}),
            ):
                assert answer.status_code == 403
            await client.post("sign-in", data={"name": "O. Operate", "password": f"{PASSWORD} of O. Operate"})
            for form, said in (
                ({"command": "align", "azimuth_deg": "NaN"}, "azimuth_deg"),
                ({"command": "align", "azimuth_deg": "north"}, "not a number"),
                ({"command": "align"}, "needs azimuth_deg"),
                ({"command": "align", "azimuth_deg": "400"}, "azimuth_deg"),
            ):
                assert said in (await client.post("command/rig%207", data=form)).text, form
            assert (await client.post("command/nobody", data={"command": "restart"})).status_code == 404
            await client.post("command/rig%207", data={"command": "reset"})
        await asyncio.sleep(0.5)
        assert len(heard) == 2
    assert hosts == {"127.0.0.1"} and not faults


async def test_a_certificate_is_filled_in_and_made(tmp_path: Path, users: Path, store: CalibrationStore) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    first = record(1).id
    fields = tmp_path / "certificate.toml"
    fields.write_text('[issue]\nlaboratory = "Laboratory of the file"\ncustomer = "Customer of the file"\n')
    options = ("--records", str(store.directory), "--set", f"web.certificate={fields}")
    async with serving(tmp_path, *options, users=users) as served, chromium() as browser:
        page = await (await browser.new_context(viewport={"width": 1400, "height": 900})).new_page()
        watched(page, hosts, faults)
        await signed_in(page, served, "O. Operate", f"calibrations/{first}")
        await page.get_by_role("link", name="certificate").click()
        await expect(page.get_by_label("Laboratory", exact=True)).to_have_value("Laboratory of the file")
        await in_every_dress(page, "certificate")
        await page.get_by_label("Customer", exact=True).fill("")
        await page.get_by_label("Who authorises it").fill(EVIL)
        await page.get_by_role("button", name="Digital (DCC)").click()
        await expect(page.locator(".alarm")).to_contain_text("names the laboratory's country", timeout=SENT_MS)
        faults.clear()  # a browser calls the answer 409 an error
        await expect(page.get_by_label("Who authorises it")).to_have_value(EVIL)
        await page.get_by_role("button", name="HTML to print").click()
        await expect(page.locator("h1")).to_have_text("Calibration certificate", timeout=SENT_MS)
        text = await page.locator("main").inner_text()
        assert "Laboratory of the file" in text and "Customer of the file" not in text and EVIL in text
        assert await page.title() != "1"
        async with httpx.AsyncClient(base_url=served.address, timeout=120.0) as client:
            asked = f"calibrations/{first}/certificate"
            await client.post("sign-in", data={"name": "L. Look", "password": f"{PASSWORD} of L. Look"})
            assert (await client.get(asked)).status_code == 403
            assert (await client.post(asked, data={"form": "html"})).status_code == 403
            await client.post("sign-in", data={"name": "O. Operate", "password": f"{PASSWORD} of O. Operate"})
            printed = await client.post(asked, data={"form": "pdf", "issue.laboratory": "L"})
            assert printed.content.startswith(b"%PDF") and printed.headers["content-type"] == "application/pdf"
            digital = await client.post(asked, data={"form": "dcc", "issue.country": "NO"})
            assert b"digitalCalibrationCertificate" in digital.content and first.encode() in digital.content
            for form, said in (
                ({"form": "exe"}, "choose PDF"),
                ({"form": "html", "decision.limit_inc_deg": "often"}, "limit_inc_deg"),
                ({"form": "html", "next.next_calibration": "2027-13-40", "next.agreed_with": "C"}, "next_calibration"),
                ({"form": "html", "issue.logo": "/etc/passwd", "issue.laboratory": "x" * 300}, "laboratory"),
            ):
                assert said in (await client.post(asked, data=form)).text, form
            assert (await client.post(asked, content=b"x=" + b"y" * 40_000)).status_code == 413
        made = [(act["act"], act["who"], act["form"]) for act in served.done() if act["act"] == "make a certificate"]
        assert made == [("make a certificate", "O. Operate", form) for form in ("html", "pdf", "dcc")]
    assert hosts == {"127.0.0.1"} and not faults
