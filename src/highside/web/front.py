"""What stands before the page: whom it answers, how much it takes in, and for how long.

Every request passes here before any other code sees it. Its `Host` must be a name of ours: a page elsewhere that has
its own name point to this machine (DNS rebinding) is not answered. Its body is counted while it is read, and is read
whole before anything is made of it, within a limit and a time. Sockets are counted; one that belongs to no page of ours
ends soon. All answers carry the headers that forbid a browser to fetch from, or be framed by, anybody else.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import AbstractContextManager
from typing import Any
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.responses import Response

from highside.config.web import WebProxy, WebTable
from highside.web.signin.people import peer_of
from highside.web.sockets import Offences
from highside.web.turned_away import turned_away
from highside.web.viewers import Viewers
from highside.words import said

Message = MutableMapping[str, Any]
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

Allowed = Callable[[Request], tuple[int, float] | None]
"""Bytes of a body and seconds for it, where they are not those of every request"""
Gate = Callable[[Request], Response | AbstractContextManager[None]]
"""What is answered instead of a page, or what to hold meanwhile"""

BODY_MAX = {"/login": 10_000, "/api/session/command": 16_384, "/diagnosis/look": 60_000} | dict.fromkeys(
    (
        "/diagnosis/run",
        "/diagnosis/forget",
        "/diagnosis/sign-in",
        "/sign-in",
        "/bench/begin",
        "/bench/resume",
        "/bench/close",
        "/bench/sign-in",
    ),
    8_000,
)
"""Bytes of a body: a token has a few dozen, a command with the longest note and names in escaped JSON some 9,000; what
is said of columns has 4,200 letters, each of them twelve bytes at most."""
OTHER_BODY_MAX = 1_000
"""Bytes where nobody reads a body at all."""
BODY_WITHIN_S = 10.0
"""For the whole body; the longest allowed takes that at 6,000 bytes a second."""
LARGE_MAX = 2
"""Bodies beyond those limits that are taken at a time, each of them in the memory while it arrives and is used."""
DISCARDED = 1_000_000
"""Bytes of a body that is too long which are still read and thrown away, so that its sender stops and reads why."""
DISCARDED_LIMITS = 4
"""The same for a long body that would be allowed, as a multiple of its limit."""
STRANGER_S = 5.0
"""A socket of no page of ours lives that long: enough to be asked to load the page anew."""
STRANGERS_MAX = 20

_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline';"
    " img-src 'self' data:; font-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; form-action 'self';"
    " base-uri 'self'"
)
_HEADERS = (
    (b"content-security-policy", _POLICY.encode()),
    # a form of ours names our origin, by which it is told from others'; without a referrer a browser names none
    (b"referrer-policy", b"same-origin"),
    (b"x-content-type-options", b"nosniff"),
)


class HostNames:
    """The names under which the page may be requested."""

    def __init__(self, settings: WebTable) -> None:
        own = socket.gethostname().lower()
        short = own.partition(".")[0]
        names = {"localhost", "127.0.0.1", "::1", settings.host, *settings.allowed_hosts}
        if settings.proxy is not None:
            names.add(_without_port(settings.proxy.origin.partition("://")[2]))
        if not settings.is_loopback:
            names |= {own, short, f"{short}.local"}
        self._names = {_plain(name) for name in names}
        self._loopback = settings.is_loopback

    def answers(self, host: str, reached: str | None) -> bool:
        """`host` as the request has it, with or without a port; `reached`: the address of ours it came in at."""
        name = _plain(_without_port(host))
        if name in self._names:
            return True
        # the address itself: nobody else's name can be made to mean it
        return not self._loopback and reached is not None and _is_address(name) and name == _plain(reached)


class Front:
    """The outermost application; `gate` answers what is requested before anything is built for it, or gives what to
    hold meanwhile."""

    def __init__(
        self,
        app: App,
        names: HostNames,
        viewers: Viewers,
        offences: Offences,
        gate: Gate,
        allowed: Allowed = lambda _request: None,
        proxy: WebProxy | None = None,
    ) -> None:
        # the name by which servers find the application within
        self.app = app
        self._names = names
        self._viewers = viewers
        self._offences = offences
        self._gate = gate
        self._allowed = allowed
        self._proxy = proxy
        self._large = 0
        self._strangers = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        scope = self._as_reached(scope)
        if scope["type"] == "http":
            await self._http(scope, receive, _with_headers(send))
        else:
            await self._socket(scope, receive, send)

    def _by_proxy(self, scope: Scope) -> bool:
        return self._proxy is not None and peer_of(scope) == self._proxy.address

    def _as_reached(self, scope: Scope) -> Scope:
        """What comes from the stated proxy, as the browser has sent it: under the proxy's name and scheme."""
        if self._proxy is None or not self._by_proxy(scope):
            return scope
        scheme, _, host = self._proxy.origin.partition("://")
        secure = {"http": "https", "ws": "wss"} if scheme == "https" else {"https": "http", "wss": "ws"}
        headers = [(name, value) for name, value in scope["headers"] if name != b"host"]
        kind = scope.get("scheme", "http")
        return {**scope, "scheme": secure.get(kind, kind), "headers": [*headers, (b"host", host.encode())]}

    def _is_ours(self, scope: Scope) -> bool:
        hosts = [value for name, value in scope["headers"] if name == b"host"]
        reached = None if scope.get("server") is None else str(scope["server"][0])
        return len(hosts) == 1 and self._names.answers(hosts[0].decode("latin-1"), reached)

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        allowed = self._allowed(Request(scope)) if self._is_ours(scope) else None
        if allowed is None:
            await self._within_limits(scope, receive, send, BODY_MAX.get(scope["path"], OTHER_BODY_MAX), BODY_WITHIN_S)
        elif self._large >= LARGE_MAX:
            text = said("Others are sending files: come back in a minute.")
            await turned_away(scope, 503, text)(scope, receive, send)
        else:
            self._large += 1
            try:
                await self._within_limits(scope, receive, send, *allowed)
            finally:
                self._large -= 1

    async def _within_limits(
        self, scope: Scope, receive: Receive, send: Send, body_max: int, body_within_s: float
    ) -> None:
        answer: Response | None = None
        body = b""
        if not self._is_ours(scope):
            text = said(
                "This server is not known by that name; [web] allowed_hosts says by which others it may be asked."
            )
            answer = turned_away(scope, 421, text)
        else:
            taken = await _body(scope, receive, body_max, body_within_s)
            answer, body = (taken, b"") if isinstance(taken, Response) else (None, taken)
        passed = answer if answer is not None else self._gate(Request(scope))
        if isinstance(passed, Response):
            await passed(scope, receive, send)
            return
        rest = iter([{"type": "http.request", "body": body, "more_body": False}])

        async def replay() -> Message:
            first = next(rest, None)
            return first if first is not None else await receive()

        # what the stated proxy says has been read; from anybody else it is a stranger's word
        headers = scope["headers"] if self._by_proxy(scope) else _without_forwarded(scope["headers"])
        with passed:
            await self.app({**scope, "headers": headers}, replay, send)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        page = parse_qs(scope["query_string"].decode("latin-1")).get("client_id", [""])[0]
        if not self._is_ours(scope):
            await _refuse_socket(scope, send, 421, "not known by that name")
        elif not of_our_origin(scope):
            await _refuse_socket(scope, send, 403, "only for pages of this server")
        elif self._viewers.socket_opened(page):
            try:
                await self._within(scope, receive, send)
            finally:
                self._viewers.socket_closed(page)
        elif self._strangers < STRANGERS_MAX:
            self._strangers += 1
            try:
                await self._within(scope, _until(receive, STRANGER_S), send)
            finally:
                self._strangers -= 1
        else:
            await _refuse_socket(scope, send, 503, "too many sockets")

    async def _within(self, scope: Scope, receive: Receive, send: Send) -> None:
        """What a frame breaks ends its own socket, and is said in one line."""
        try:
            await self.app(scope, receive, send)
        except Exception as error:
            if type(error).__name__ == "ClientDisconnected":
                return
            self._offences.note(f"a frame that cannot be read ({type(error).__name__})", scope.get("client"))
            try:
                await send({"type": "websocket.close", "code": 1008})
            except Exception:
                return


def _without_forwarded(headers: list[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    return [(name, value) for name, value in headers if not name.startswith(b"x-forwarded-")]


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = list(message.get("headers", []))
            there = {name.lower() for name, _ in headers}
            message = {**message, "headers": headers + [header for header in _HEADERS if header[0] not in there]}
        await send(message)

    return sent


def of_our_origin(scope: Scope) -> bool:
    """Whether a page of ours opens this socket or sends this form, or a program, which has no origin."""
    given = [value for name, value in scope["headers"] if name == b"origin"]
    host = next(value for name, value in scope["headers"] if name == b"host")
    scheme = b"https" if scope.get("scheme") in ("wss", "https") else b"http"
    return all(origin.lower() == b"%s://%s" % (scheme, host.lower()) for origin in given)


def _declared(scope: Scope) -> int:
    """The length that the request says its body has; 0 where it says none."""
    given = [value for name, value in scope["headers"] if name == b"content-length"]
    return int(given[0]) if given and given[0].isdigit() and len(given[0]) < 20 else 0


async def _body(scope: Scope, receive: Receive, limit: int, within_s: float) -> bytes | Response:
    """The whole body, counted while it is read; or the answer to one that is too long or too slow."""
    got, size, declared = bytearray(), 0, _declared(scope)
    try:
        async with asyncio.timeout(within_s):
            while max(size, declared) <= limit or size <= max(DISCARDED, DISCARDED_LIMITS * limit):
                message = await receive()
                if message["type"] == "http.disconnect":
                    return turned_away(scope, 400, said("The request was not finished."))
                size += len(message.get("body", b""))
                if max(size, declared) <= limit:
                    got += message.get("body", b"")
                if not message.get("more_body", False):
                    break
    except TimeoutError:
        return turned_away(scope, 408, said("The request was not whole within %(seconds)s s.", seconds=f"{within_s:g}"))
    if max(size, declared) > limit:
        return turned_away(
            scope, 413, said("The request is too long: at most %(most)s bytes are read here.", most=limit)
        )
    return bytes(got)


def _until(receive: Receive, within_s: float) -> Receive:
    """The same, with a disconnect once the time is over."""
    end_s = asyncio.get_running_loop().time() + within_s

    async def received() -> Message:
        try:
            async with asyncio.timeout_at(end_s):
                return await receive()
        except TimeoutError:
            return {"type": "websocket.disconnect", "code": 1008}

    return received


async def _refuse_socket(scope: Scope, send: Send, status: int, text: str) -> None:
    if "websocket.http.response" not in scope.get("extensions", {}):
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
    await send({"type": "websocket.http.response.start", "status": status, "headers": headers})
    await send({"type": "websocket.http.response.body", "body": f"{text}\n".encode(), "more_body": False})


def _without_port(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0] if host.count(":") == 1 else host


def _plain(name: str) -> str:
    """As it is compared: small letters, no last dot, an IPv4 address in IPv6's clothes as itself, no zone."""
    text = name.lower().removesuffix(".").strip("[]").partition("%")[0]
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        return text
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
