"""`highside serve` with a file of users, for tests: three people, one for each role, and one whom a proxy signs in."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench_page import HIGHSIDE
from broker import free_port
from playwright.async_api import Page, expect
from test_tools_page import CLICK_S, serve

from highside.config.users import Role, User, changing_users
from highside.web.signin.passwords import hashed

PASSWORD = "correct horse battery"
PEOPLE = {"L. Look": "look", "O. Operate": "operate", "F. Force": "put in force"}


def highside(*arguments: object, said: str | None = None, status: int = 0) -> str:
    """A command; its output. Fails unless it ends with that status."""
    done = subprocess.run(
        [HIGHSIDE, *map(str, arguments)], input=said, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def make_users(folder: Path) -> Path:
    """As `highside users add` writes it, without a process for each (five seconds; `test_sign_in` runs the command)."""
    file = folder / "users.toml"
    with changing_users(file) as users:
        for name, role in PEOPLE.items():
            users.append(User(name=name, role=Role(role), password=hashed(f"{PASSWORD} of {name}")))
    return file


@dataclass(frozen=True)
class Served:
    """The running command."""

    address: str
    users: Path
    acts: Path

    def done(self) -> list[dict[str, Any]]:
        """The journal."""
        return [json.loads(line) for line in self.acts.read_text().splitlines()] if self.acts.exists() else []


@contextlib.asynccontextmanager
async def serving(folder: Path, *options: str, users: Path | None = None) -> AsyncIterator[Served]:
    """`highside serve` where everybody signs in."""
    file = make_users(folder) if users is None else users
    acts = folder / "acts.jsonl"
    given = ("--users", str(file), "--set", f"web.acts={acts}", "--set", f"mqtt.port={free_port()}", *options)
    async with serve(*given) as (address, _):
        yield Served(address, file, acts)


async def sign_in(page: Page, name: str, password: str | None = None) -> None:
    """By the keyboard, where the form is."""
    await page.get_by_label("Name").fill(name)
    await page.get_by_label("Password").fill(f"{PASSWORD} of {name}" if password is None else password)
    await page.keyboard.press("Enter")


async def signed_in(page: Page, served: Served, name: str, path: str = "") -> None:
    """Go there, sign in, be there: a password takes a part of a second of a processor to check, and waits for one."""
    await page.goto(served.address + path)
    await expect(page.locator("h1")).to_have_text("Sign in", timeout=CLICK_S)
    await sign_in(page, name)
    await expect(page.locator(".person")).to_contain_text(name, timeout=CLICK_S)
