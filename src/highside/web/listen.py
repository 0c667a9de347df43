"""The server of the page: its socket, its connections and how long each may do nothing.

There are places for so many connections. Once they are taken, the next one gets the place of a connection that asks for
nothing: one that has sent no whole request, or does not take what it is sent. Those of people who are known go last,
and of the others first those of whom too many come from one address; so a crowd that opens connections and holds them
shuts out itself. TLS begins only when a connection has its place, so that one which never says a word of it is cut
like any other.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
import ssl
import traceback
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from typing import Any, cast

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from highside.config.web import WebTable
from highside.errors import InputError

CONNECTIONS_MAX = 256
"""Of all kinds at once: a browser opens up to six, and the process needs descriptors for link, journal and broker."""
CONNECTIONS_EACH = 32
"""Of one address, before those beyond are the first to go: five browsers behind one router."""
HANDSHAKES_MAX = 64
"""Connections of which TLS has begun and not yet ended: the library has 256 KiB for each from its first moment."""
REQUEST_WITHIN_S = 10.0
"""A connection without a whole head of a request for so long is cut, before its first one as between two."""
UNSENT_S = 30.0
"""A peer that has not taken for so long what was sent to it is cut: its buffers are ours."""
LOOK_EVERY_S = 1.0
_FULL = (
    b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: text/plain; charset=utf-8\r\nretry-after: 10\r\n"
    b"connection: close\r\n\r\nToo many connections to the bench page at once. Close some, or come back later.\n"
)
_NUMBERS = itertools.count()

Known = Callable[[Mapping[str, Any]], bool]
"""Whether a request comes from somebody who has signed in or shown the token"""


class _Connection(H11Protocol):
    """Takes the place of an idle one where all are taken. h11 bounds the head of a request, which other parsers do
    not."""

    def __init__(self, *args: Any, known: Known, tls: ssl.SSLContext | None, **more: Any) -> None:
        super().__init__(*args, **more)
        self.number = next(_NUMBERS)
        self.is_cut = False
        self._known, self._tls = known, tls
        self._handshake: asyncio.Task[None] | None = None
        self._early: list[bytes] | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        here = [one for one in self.connections if not getattr(one, "is_cut", False)]
        ours = [one for one in here if isinstance(one, _Connection) and one is not self]
        if len(here) > CONNECTIONS_MAX:
            least = least_needed(ours)
            if least is None:
                self.is_cut = True
                if self._tls is None:
                    transport.write(_FULL)
                transport.close()
                return
            least.cut()
        begun = [one for one in ours if one.in_handshake]
        if len(begun) >= HANDSHAKES_MAX and (least := least_needed(begun)) is not None:
            least.cut()
        if self._tls is not None:
            self._early = []
            self._handshake = asyncio.create_task(self._secure(transport, self._tls))

    async def _secure(self, transport: asyncio.Transport, tls: ssl.SSLContext) -> None:
        if self.is_cut:
            return  # of a crowd that came at once
        try:
            secured = await self.loop.start_tls(
                transport, self, tls, server_side=True, ssl_handshake_timeout=REQUEST_WITHIN_S
            )
        except (OSError, TimeoutError) as error:
            secured = None
            # its frames hold the buffers of the handshake in a circle, which would wait for a full collection
            traceback.clear_frames(error.__traceback__)
        if secured is None:
            self.connections.discard(self)
            transport.abort()
            return
        early, self._early = self._early or [], None
        if self in self.connections:
            super().connection_made(secured)
            for data in early:
                self.data_received(data)

    def data_received(self, data: bytes) -> None:
        if self._early is not None:
            self._early.append(data)  # with the end of the handshake, before that is known here
        elif not self.is_cut:
            super().data_received(data)

    @property
    def in_handshake(self) -> bool:
        return self._early is not None and not self.is_cut

    def cut(self) -> None:
        self.is_cut = True
        self.transport.abort()

    @property
    def is_known(self) -> bool:
        """Whether its last request came from somebody known."""
        return self.scope is not None and self._known(cast("Mapping[str, Any]", self.scope))

    @property
    def needless(self) -> int | None:
        """How little it is needed, 0 the least; None while it is worked for."""
        cycle: RequestResponseCycle | None = self.cycle
        if cycle is None:
            return 0
        if self.transport.get_write_buffer_size() > 0:
            return 3
        if cycle.response_complete:
            return 1
        return 2 if cycle.more_body else None


def least_needed(connections: Collection[_Connection]) -> _Connection | None:
    """The one whose place another may have."""
    of_peer = Counter(_address(one) for one in connections)

    def order(one: _Connection) -> tuple[bool, int, int, int]:
        several = of_peer[_address(one)]
        return several <= CONNECTIONS_EACH, one.needless or 0, -several, one.number

    spare = sorted((one for one in connections if one.needless is not None), key=order)
    return next((one for one in spare if not one.is_known), spare[0] if spare else None)


def _address(connection: _Connection) -> str:
    return "" if connection.client is None else connection.client[0]


class Server(uvicorn.Server):
    """Leaves the signals to whoever owns the process, and looks after its connections."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def look_after(self) -> None:
        """Cut who is idle or does not read, for ever."""
        since: dict[tuple[object, object], float] = {}
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            now = asyncio.get_running_loop().time()
            alive = set()
            for connection in list(self.server_state.connections):
                transport = connection.transport
                # a connection is idle anew after each request, and unsent anew once all had gone
                for state, limit_s in ((_waits_after(connection), REQUEST_WITHIN_S), (_unsent(transport), UNSENT_S)):
                    if state is None:
                        continue
                    key = (connection, state)
                    alive.add(key)
                    if now - since.setdefault(key, now) > limit_s:
                        transport.abort()
            for gone in since.keys() - alive:
                del since[gone]


def _waits_after(connection: object) -> object | None:
    """The request after which a connection has sent no whole head of another; None while it is being answered."""
    if not isinstance(connection, H11Protocol):
        return None
    cycle: RequestResponseCycle | None = connection.cycle
    return "none yet" if cycle is None else cycle if cycle.response_complete else None


def _unsent(transport: asyncio.Transport) -> str | None:
    return "unsent" if transport.get_write_buffer_size() > 0 else None


def server_of(app: object, settings: WebTable, known: Known) -> Server:
    """The server, not yet started. Raises InputError where [web.tls] cannot be used."""
    connection = partial(_Connection, known=known, tls=settings.tls_context())
    config = uvicorn.Config(
        app,  # type: ignore[arg-type]
        http=connection,  # type: ignore[arg-type]
        log_config=None,
        log_level="warning",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        ws_max_size=2**16,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=2,
    )
    config.load()
    return Server(config)


def listening(settings: WebTable) -> socket.socket:
    """The listening socket. Raises InputError."""
    try:
        found = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        made = socket.socket(family, kind, protocol)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen(64)
        made.setblocking(False)
    except OSError as error:
        raise InputError(
            f"cannot be listened on: {error.strerror or error}",
            where=f"{settings.host}:{settings.port}",
            field="web",
            remedy="choose another with --set web.port=...",
        ) from None
    return made
