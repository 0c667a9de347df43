"""Who a request comes from: a session's cookie, or the header of the stated proxy.

The file of users is read anew when it has changed: who was removed, or given another role or password, is signed out
with the next request. A file that cannot be read any more signs everybody out.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any

from highside.config.users import UsersFile, read_users
from highside.config.web import WebProxy, WebTable
from highside.errors import HighsideError, InputError, Refused
from highside.service.quiet_log import QuietLog
from highside.web.signin.acts import Acts, Person
from highside.web.signin.attempts import Attempts
from highside.web.signin.passwords import matches, need_argon2
from highside.web.signin.sessions import COOKIE, Sessions

log = logging.getLogger("highside")

WAITING_MAX = 8
"""Attempts that wait for their turn: each takes some 50 ms of a processor and 64 MB, one after the other."""
Scope = Mapping[str, Any]


class People:
    """The users of a page and who of them is there."""

    def __init__(self, settings: WebTable) -> None:
        assert settings.users is not None
        self._path: Path = settings.users
        self._proxy: WebProxy | None = settings.proxy
        self.acts = Acts(settings.acts_file)
        self.sessions = Sessions()
        self._attempts = Attempts()
        self._quiet = QuietLog(log)
        self._known: tuple[object, UsersFile] | None = None
        self._turn = asyncio.Lock()
        self._waiting = 0

    def check(self) -> None:
        """Raises InputError for a file of users or a journal that cannot be used."""
        need_argon2()
        if not read_users(self._path).user:
            remedy = "highside users add NAME --role 'put in force'"
            raise InputError("has no users: nobody could sign in", where=str(self._path), remedy=remedy)
        self.acts.check()

    def who(self, scope: Scope, *, touch: bool = True) -> Person | None:
        """The person of a request or socket; None for nobody."""
        address = self.address(scope)
        name = self._by_proxy(scope)
        if name is not None:
            user = self.users().find(name)
            return None if user is None else Person(user.name, user.role, "proxy", address)
        known = self.sessions.user(cookie_of(scope, COOKIE), touch=touch)
        if known is None or self.users().find(known.name) != known:
            return None
        return Person(known.name, known.role, "password", address)

    def address(self, scope: Scope) -> str:
        """Where a request comes from: of one that comes through the proxy, what that says."""
        peer = peer_of(scope)
        if self._proxy is not None and peer == self._proxy.address:
            told = _headers(scope, "x-forwarded-for")
            if told:
                # the last is what the proxy itself has seen
                return f"{told[-1].rpartition(',')[2].strip()[:64]} by {peer}"
        return peer

    async def sign_in(self, name: str, password: str, scope: Scope) -> str:
        """The cookie of a new session. Raises Refused in words for the person, InputError where it cannot be noted."""
        address = self.address(scope)
        wait_s = self._attempts.wait_s(name, address)
        if wait_s > 0.0:
            raise Refused(f"too many attempts: try again in {max(1, round(wait_s / 60))} min")
        if self._waiting >= WAITING_MAX:
            raise Refused("too many people sign in at once: try again in a few seconds")
        user = self.users().find(name)
        # counted before it is looked at: who tries many at once gains nothing
        self._attempts.failed(name, address)
        self._waiting += 1
        try:
            async with self._turn:
                right = await asyncio.to_thread(matches, None if user is None else user.password, password)
        finally:
            self._waiting -= 1
        if not right or user is None:
            await asyncio.to_thread(self.acts.failure, name, address, "wrong name or password")
            raise Refused("that is not a name with its password")
        self._attempts.succeeded(name, address)
        await asyncio.to_thread(self.acts.write, Person(user.name, user.role, "password", address), "sign in")
        return self.sessions.begin(user)

    async def sign_out(self, scope: Scope) -> None:
        """End the session of a request."""
        person = self.who(scope)
        self.sessions.end(cookie_of(scope, COOKIE))
        if person is not None:
            await asyncio.to_thread(self.acts.write, person, "sign out")

    def users(self) -> UsersFile:
        """The users now; nobody where the file cannot be read."""
        try:
            found = self._path.stat()
            state = (found.st_mtime_ns, found.st_size, found.st_ino, found.st_mode)
            if self._known is None or self._known[0] != state:
                self._known = (state, read_users(self._path))
        except OSError as error:
            return self._unreadable(str(error.strerror))
        except HighsideError as error:
            return self._unreadable(str(error))
        return self._known[1]

    def _unreadable(self, why: str) -> UsersFile:
        self._quiet.say(logging.ERROR, "users", "the file of users cannot be read, nobody is let in: %s", why)
        self._known = None
        return UsersFile()

    def _by_proxy(self, scope: Scope) -> str | None:
        """The name in the proxy's header: from its address alone, given once."""
        if self._proxy is None or peer_of(scope) != self._proxy.address:
            return None
        return header_of(scope, self._proxy.header) or None


def peer_of(scope: Scope) -> str:
    """The address at the other end of the connection."""
    client = scope.get("client")
    text = str(client[0]) if client else "unknown"
    return text.removeprefix("::ffff:")


def cookie_of(scope: Scope, name: str) -> str | None:
    """A cookie of a request."""
    for line in _headers(scope, "cookie"):
        try:
            found = SimpleCookie(line).get(name)
        except CookieError:
            continue
        if found is not None:
            return found.value
    return None


def header_of(scope: Scope, name: str) -> str | None:
    """A header of a request that may be given once; None where it is not."""
    told = _headers(scope, name.lower())
    return told[0] if len(told) == 1 else None


def _headers(scope: Scope, name: str) -> list[str]:
    wanted = name.encode()
    return [value.decode("latin-1") for key, value in scope.get("headers", ()) if key.lower() == wanted]
