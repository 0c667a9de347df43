"""The server of the page: its socket, its connections and how long each may do nothing."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from highside.config.web import WebTable
from highside.errors import InputError

CONNECTIONS_MAX = 256
"""Of all kinds at once: a browser opens up to six, and the process needs descriptors for link, journal and broker."""
REQUEST_WITHIN_S = 10.0
"""A connection without a whole head of a request for so long is cut, before its first one as between two."""
UNSENT_S = 30.0
"""A peer that has not taken for so long what was sent to it is cut: its buffers are ours."""
LOOK_EVERY_S = 1.0
_FULL = (
    b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: text/plain; charset=utf-8\r\nretry-after: 10\r\n"
    b"connection: close\r\n\r\nToo many connections to the bench page at once. Close some, or come back later.\n"
)


class _Connection(H11Protocol):
    """Beyond the limit refused and closed. h11 bounds the head of a request, which other parsers do not."""

    _refused = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > CONNECTIONS_MAX:
            self._refused = True
            transport.write(_FULL)
            transport.close()

    def data_received(self, data: bytes) -> None:
        if not self._refused:
            super().data_received(data)


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


def server_of(app: object, settings: WebTable) -> Server:
    """The server, not yet started. Raises InputError where [web.tls] cannot be used."""
    config = uvicorn.Config(
        app,  # type: ignore[arg-type]
        http=_Connection,
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
    config.ssl = settings.tls_context()
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
