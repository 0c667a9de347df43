"""Signing in at `highside serve`, in a real browser and by hostile requests: who is not signed in sees nothing, who was
removed or has signed out sees nothing any more, nobody guesses, forges, or comes by a header from a wrong address."""

from __future__ import annotations

import asyncio
import base64
import time
from pathlib import Path

import httpx
import pytest
from bench_page import chromium, handshake_of
from playwright.async_api import expect
from signed_in import PASSWORD, Served, highside, make_users, serving, sign_in, signed_in
from test_bench_page import assert_accessible, assert_fits
from test_tools_page import watched
from websockets.asyncio.client import connect

NAME = "O. Operate"


@pytest.fixture(scope="module")
def users(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_users(tmp_path_factory.mktemp("users"))


async def post(client: httpx.AsyncClient, name: str, password: str, **more: str) -> httpx.Response:
    return await client.post("sign-in", data={"name": name, "password": password, "next": "/"} | more)


def client_of(served: Served, **more: object) -> httpx.AsyncClient:
    return httpx.AsyncClient(base_url=served.address, timeout=60.0, **more)  # type: ignore[arg-type]


async def test_a_person_signs_in_by_the_keyboard_and_out_again(tmp_path: Path, users: Path) -> None:
    hosts: set[str] = set()
    faults: list[str] = []
    async with serving(tmp_path, users=users) as served, chromium() as browser:
        context = await browser.new_context(viewport={"width": 1400, "height": 900})
        page = await context.new_page()
        watched(page, hosts, faults)
        await page.goto(f"{served.address}acts")
        await expect(page.locator("h1")).to_have_text("Sign in")
        for width in (320, 1400, 3840):
            await page.set_viewport_size({"width": width, "height": 900})
            await assert_accessible(page, f"sign in {width}")
            await assert_fits(page, f"sign in {width}")
        await sign_in(page, NAME, "not this one, surely")
        await expect(page.locator(".alarm")).to_contain_text("that is not a name with its password")
        faults.clear()  # a browser calls the answer 403 an error
        await sign_in(page, NAME)
        await expect(page.locator("h1")).to_have_text("What was done here")
        await expect(page.locator("tbody tr")).to_have_count(2)
        for width in (320, 1400, 3840):
            await page.set_viewport_size({"width": width, "height": 900})
            await assert_accessible(page, f"acts {width}")
            await assert_fits(page, f"acts {width}")

        # two live pages of one browser; what one signs out ends the other
        live = await context.new_page()
        watched(live, hosts, faults)
        await live.goto(served.address)
        await expect(live.locator("h1")).to_contain_text("broker")
        await expect(live.locator(".person")).to_contain_text(f"{NAME} may operate")
        for width in (320, 1400, 3840):
            await live.set_viewport_size({"width": width, "height": 900})
            await assert_accessible(live, f"start {width}")
            await assert_fits(live, f"start {width}")
        await page.get_by_role("button", name="Sign out").click()
        await expect(page.locator("h1")).to_have_text("Sign in")
        await expect(live.locator("h1")).to_have_text("Sign in", timeout=30_000)
        assert await context.cookies() == []
        done = [(act["act"], act["outcome"], act["who"], act["from"]) for act in served.done()]
        assert done == [
            ("sign in", "wrong name or password", NAME, "127.0.0.1"),
            ("sign in", "done", NAME, "127.0.0.1"),
            ("sign out", "done", NAME, "127.0.0.1"),
        ]
    assert hosts == {"127.0.0.1"} and not faults


async def test_a_role_shows_what_it_may(tmp_path: Path, users: Path) -> None:
    async with serving(tmp_path, "--diagnose", users=users) as served, chromium() as browser:
        page = await (await browser.new_context()).new_page()
        await signed_in(page, served, "L. Look", "diagnosis")
        await expect(page.locator("h1")).to_have_text("A diagnosis is for who may operate.")
        assert (await page.goto(f"{served.address}acts")).status == 403  # type: ignore[union-attr]
        page = await (await browser.new_context()).new_page()
        await signed_in(page, served, NAME, "diagnosis")
        await expect(page.locator("h1")).to_have_text("What does the simulation leave out?")


async def test_who_was_removed_or_changed_is_out_at_once(tmp_path: Path) -> None:
    async with serving(tmp_path) as served, client_of(served) as client, client_of(served) as other:
        for browser, name in ((client, NAME), (other, "L. Look")):
            assert (await post(browser, name, f"{PASSWORD} of {name}")).status_code == 303
            assert (await browser.get("api/tools")).status_code == 200
        assert (await client.get("acts")).status_code == 200
        highside("users", "role", NAME, "--role", "look", "--file", served.users)
        assert (await client.get("api/tools")).status_code == 401, "another role: sign in anew"
        highside("users", "remove", "L. Look", "--file", served.users)
        assert (await other.get("api/tools")).status_code == 401
        assert (await post(other, "L. Look", f"{PASSWORD} of L. Look")).status_code == 403
        assert (await post(client, NAME, f"{PASSWORD} of {NAME}")).status_code == 303
        assert (await client.get("acts")).status_code == 403
        served.users.chmod(0o644)
        assert (await client.get("api/tools")).status_code == 401, "a file that others may read signs nobody in"


async def answer_to(address: str, headers: dict[str, str]) -> str:
    """What a socket is answered that says whose page it belongs to: socket.io's 40 is yes, 44 no."""
    async with asyncio.timeout(20.0), connect(address, additional_headers=headers) as opened:
        await opened.recv()
        await opened.send("40")
        return str(await opened.recv())


PATHS = ("", "api/tools", "tool/rig-7", "acts", "calibrations", "sessions", "diagnosis", "diagnosis/report",
         "_nicegui/3.18.0/components/x.js", "style.css/../acts", "sign-in/../api/tools", "?token=anything")  # fmt: skip


async def test_nobody_sees_anything_without_signing_in(tmp_path: Path, users: Path) -> None:
    async with serving(tmp_path, "--diagnose", users=users) as served, client_of(served) as client:
        for path in PATHS:
            assert (await client.get(path)).status_code == 401, path
            found = await client.get(path, headers={"Accept": "text/html"})
            assert found.status_code == 303 and found.headers["location"].startswith("/sign-in?next="), path
        for path in ("diagnosis/file", "diagnosis/run", "sign-out"):
            assert (await client.post(path, content=b"x")).status_code == 401, path
        # a socket of a page that somebody else was given
        signed = await post(client, NAME, f"{PASSWORD} of {NAME}")
        page = (await client.get("", headers={"Accept": "text/html"})).text
        known = page.partition('"query": {')[2] or page
        ident = known.partition("client_id")[2]
        ident = "".join(letter for letter in ident if letter in "0123456789abcdef-&:;\"' quot")[:80]
        words = [word for word in ident.replace("&quot;", '"').replace("'", '"').split('"') if len(word) == 36]
        assert signed.status_code == 303 and words, page[:400]
        socket = served.address.replace("http", "ws") + "_nicegui_ws/socket.io/?" + handshake_of(words[0])
        assert (await answer_to(socket, {})).startswith("44"), "refused"
        own = {"Cookie": f"highside_session={client.cookies['highside_session']}"}
        assert (await answer_to(socket, own)).startswith("40"), "his own page is his"


FORGED = ("", "x", "a" * 43, "a" * 5_000, "highside", "\u00e9" * 20, '"; highside_session="', "../../users.toml")


async def test_forged_and_stolen_cookies_are_worth_nothing(tmp_path: Path, users: Path) -> None:
    async with serving(tmp_path, users=users) as served, client_of(served) as client:
        for value in FORGED:
            headers = {"Cookie": f"highside_session={value}".encode("latin-1", "replace")}
            assert (await client.get("api/tools", headers=headers)).status_code == 401, value
        signed = await post(client, NAME, f"{PASSWORD} of {NAME}")
        cookie = signed.headers["set-cookie"]
        assert "HttpOnly" in cookie and "SameSite=strict" in cookie and "Max-Age=43200" in cookie
        kept = client.cookies["highside_session"]
        assert len(kept) >= 43 and kept not in served.acts.read_text() and kept not in served.users.read_text()
        for k in range(0, len(kept), 7):
            wrong = kept[:k] + ("A" if kept[k] != "A" else "B") + kept[k + 1 :]
            answer = await httpx.AsyncClient().get(
                f"{served.address}api/tools", headers={"Cookie": f"highside_session={wrong}"}
            )
            assert answer.status_code == 401
        assert (await client.post("sign-out")).status_code == 303
        answer = await client.get("api/tools", headers={"Cookie": f"highside_session={kept}"})
        assert answer.status_code == 401, "signed out there, not only forgotten here"
        basic = base64.b64encode(f"{NAME}:{PASSWORD} of {NAME}".encode()).decode()
        for said in (f"Basic {basic}", "Bearer", "Bearer x"):
            assert (await client.get("api/tools", headers={"Authorization": said})).status_code == 401


async def test_who_guesses_is_held_up_and_the_person_is_not(tmp_path: Path, users: Path) -> None:
    async with serving(tmp_path, users=users) as served, client_of(served) as client:
        answers = [await post(client, NAME, f"guess number {k}") for k in range(7)]
        assert all("not a name with its password" in answer.text for answer in answers[:5])
        assert all("too many attempts" in answer.text for answer in answers[5:])
        right = await post(client, NAME, f"{PASSWORD} of {NAME}")
        assert "too many attempts" in right.text, "nor with the right one, while it is held up"
        # at once, under names that there are not: 20 from one address, then nobody is looked at
        many = await asyncio.gather(*(post(client, f"Nobody {k}", "guess number 1") for k in range(40)))
        assert sum("not a name" in answer.text for answer in many) <= 15
        assert all(answer.status_code == 403 for answer in many)
        # another address of this machine: the person himself
        transport = httpx.AsyncHTTPTransport(local_address="127.0.0.2")
        async with client_of(served, transport=transport) as elsewhere:
            assert (await post(elsewhere, NAME, f"{PASSWORD} of {NAME}")).status_code == 303
        assert len(served.done()) < 40


async def test_a_name_that_is_not_there_takes_as_long(tmp_path: Path, users: Path) -> None:
    """The work of argon2 is done all the same: no list of users can be made by a clock."""
    async with serving(tmp_path, users=users) as served, client_of(served) as client:
        took: dict[str, list[float]] = {"there": [], "not there": []}
        await post(client, "warm", "up and up and up")
        for k in range(4):
            for what, name in (("there", NAME), ("not there", f"Nobody {k}")):
                begun = time.perf_counter()
                await post(client, name, f"guess number {k}")
                took[what].append(time.perf_counter() - begun)
        assert min(took["not there"]) > 0.4 * min(took["there"])


async def test_forms_from_elsewhere_and_hostile_bodies_do_nothing(tmp_path: Path, users: Path) -> None:
    async with serving(tmp_path, users=users) as served, client_of(served) as client:
        right = {"name": NAME, "password": f"{PASSWORD} of {NAME}"}
        for origin in ("https://elsewhere.example", "null", served.address.rstrip("/").replace("http:", "https:")):
            answer = await client.post("sign-in", data=right, headers={"Origin": origin})
            assert answer.status_code == 403 and "set-cookie" not in answer.headers, origin
        elsewhere = "elsewhere.example"
        for wanted in (f"//{elsewhere}", f"https://{elsewhere}", f"/\\{elsewhere}", "/a\r\nSet-Cookie: a"):
            answer = await post(client, NAME, right["password"], next=wanted)
            assert answer.headers["location"] == "/", wanted
        assert (await client.post("sign-out", headers={"Origin": "https://elsewhere.example"})).status_code == 403
        assert (await client.get("api/tools")).status_code == 200, "still signed in"
        assert (await client.post("sign-in", content=b"name=" + b"x" * 9_000)).status_code == 413
        for body in (b"\xff\xfe", b"&" * 5_000, b"name=%00&password=%ff", b"password=" + b"x" * 7_000):
            assert (await client.post("sign-in", content=body)).status_code in (400, 403), body[:20]
        evil = '<img src=x onerror="document.title=1">'
        assert "<img" not in (await post(client, evil, "guess number 1")).text
        assert "<img" not in (await client.get("acts")).text


async def test_a_proxy_is_believed_by_its_address_alone(tmp_path: Path, users: Path) -> None:
    """The proxy connects from 127.0.0.9 here, a stranger from 127.0.0.1."""
    proxy = ("web.proxy.address=127.0.0.9", "web.proxy.origin=https://rig.example")
    options = [word for setting in proxy for word in ("--set", setting)]
    transport = httpx.AsyncHTTPTransport(local_address="127.0.0.9")
    async with (
        serving(tmp_path, *options, users=users) as served,
        client_of(served) as stranger,
        client_of(served, transport=transport) as through,
    ):
        named = {"X-Auth-Request-User": "F. Force", "X-Forwarded-For": "10.1.1.1, 10.2.2.2"}
        assert (await stranger.get("api/tools", headers=named)).status_code == 401
        assert (await through.get("api/tools")).status_code == 401
        assert (await through.get("api/tools", headers={"X-Auth-Request-User": "Nobody"})).status_code == 401
        assert (await through.get("api/tools", headers=named)).status_code == 200
        twice = [("X-Auth-Request-User", "F. Force"), ("X-Auth-Request-User", "L. Look")]
        assert (await through.get("api/tools", headers=twice)).status_code == 401
        # forms come from the address that the browser knows
        here = named | {"Origin": "https://rig.example"}
        assert (await through.post("sign-out", headers=here)).status_code == 303
        assert (await through.post("sign-out", headers=named | {"Origin": served.address[:-1]})).status_code == 403
        assert [(act["who"], act["via"], act["from"]) for act in served.done()] == [
            ("F. Force", "proxy", "10.2.2.2 by 127.0.0.9")
        ]


def test_mistakes_of_whoever_keeps_the_users_are_one_line(tmp_path: Path) -> None:
    file = tmp_path / "users.toml"
    add = ("users", "add", "A. Person", "--file", file, "--stdin")
    assert "is no role; one of 'look'" in highside(*add, "--role", "chief", said="x\n", status=2)
    assert "has 5 characters: 10 to 200" in highside(*add, "--role", "look", said="short\n", status=2)
    assert not file.exists()
    highside(*add, "--role", "put-in-force", said="long enough, surely\n")
    assert file.stat().st_mode & 0o777 == 0o600 and "long enough" not in file.read_text()
    assert "is there already" in highside(*add, "--role", "look", said="long enough, surely\n", status=2)
    assert highside("users", "list", "--file", file) == "A. Person: put in force\n"
    assert "'B' is no user" in highside("users", "remove", "B", "--file", file, status=2)
    file.chmod(0o640)
    assert "may be read by others; chmod 600" in highside("users", "list", "--file", file, status=2)
    file.chmod(0o600)
    file.write_text('[[user]]\nname = "A"\nrole = "chief"\n')
    assert "user[0].role" in highside("users", "list", "--file", file, status=2).replace("user.0.role", "user[0].role")
    file.write_text("")
    served = highside("serve", "--users", file, "--set", "web.port=0", status=2)
    assert "has no users: nobody could sign in" in served
    proxy = ("--set", "web.proxy.address=127.0.0.9", "--set", "web.proxy.origin=https://rig.example")
    assert "[web.proxy] needs users" in highside("serve", *proxy, status=2)
