"""What every page of ours needs: its server, its guards, its viewers. One in a process: NiceGUI keeps its pages there.

NiceGUI brings pages, sockets and reconnects, uvicorn the server; `front`, `sockets` and `listen` stand before them.
Nothing is fetched from elsewhere: the policy sent with every page forbids it to the browser.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, PlainTextResponse, RedirectResponse
from markupsafe import Markup
from nicegui import Client, core, ui

from highside.config.web import WebTable
from highside.errors import InputError
from highside.service.logs import keep_short
from highside.web.access import COOKIE, COOKIE_MAX_AGE_S, Access
from highside.web.front import Allowed, Front, HostNames
from highside.web.listen import Server, listening, server_of
from highside.web.sockets import Offences, Sockets
from highside.web.viewers import Viewers

_NOTICE = Markup('<!DOCTYPE html><html lang="en"><title>{title}</title><p>{text}</p></html>')
RECONNECT_S = 10.0
"""A viewer whose socket was cut finds its page as it left it within this; later the page loads anew."""
CONNECT_WITHIN_S = 15.0
"""A page whose socket has not come within this is forgotten: each holds some 0.4 MB. A phone on a bad line takes 5."""
ALIVE_TIMEOUT_S = 10.0
"""A browser that has not drawn for so long is queried again."""
LIBRARIES = ("nicegui", "uvicorn.error", "asyncio")
"""Loggers of what speaks with browsers."""

Answer = Callable[[Request], Response | None]
"""What a request for a page is answered instead of one; None: the page"""


class PageHost:
    """Serves the pages that are registered with NiceGUI and the routes of `app`. `start` it, `stop` it."""

    def __init__(
        self,
        settings: WebTable,
        *,
        is_page: Callable[[str], bool],
        instead: Answer = lambda _request: None,
        allowed: Allowed = lambda _request: None,
    ) -> None:
        self.settings = settings
        self.app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        self.access = Access(settings.read_token())
        self._is_page, self._instead, self._allowed = is_page, instead, allowed
        self._viewers = Viewers(settings.viewers)
        self._server: Server | None = None
        self._task: asyncio.Task[None] | None = None
        self._care: asyncio.Task[None] | None = None
        self.port = settings.port

    @property
    def address(self) -> str:
        """Where the page is, without the token."""
        host = "127.0.0.1" if self.settings.host in ("0.0.0.0", "::") else self.settings.host
        scheme = "http" if self.settings.tls is None else "https"
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def link(self) -> str:
        """The page with the right to command."""
        return f"{self.address}?token={self.access.token}"

    async def start(self) -> None:
        """Listen. Raises InputError where that address cannot be had, or [web.tls] not be used."""
        keep_short(*LIBRARIES)
        self._server = server_of(self._guarded(), self.settings)
        listened = listening(self.settings)
        self.port = listened.getsockname()[1]
        self._task = asyncio.create_task(self._server.serve([listened]))
        while not self._server.started:
            if self._task.done():
                await self._task
                raise InputError("the page could not be started", where=self.address)
            await asyncio.sleep(0.02)
        self._care = asyncio.create_task(self._server.look_after())

    async def stop(self) -> None:
        """Say good-bye to the viewers and close."""
        if self._server is not None and self._task is not None:
            if self._care is not None:
                self._care.cancel()
            self._server.should_exit = True
            await asyncio.gather(self._task, return_exceptions=True)

    def admit(self, request: Request) -> tuple[Client, bool]:
        """The client of the page that is being built, counted as a viewer, and whether it may command."""
        client = ui.context.client
        commands = self.may_command(request)
        self._viewers.add(client.id, commands=commands)
        client.on_delete(lambda: self._viewers.remove(client.id))
        return client, commands

    def may_command(self, request: Request) -> bool:
        """Whether the browser has shown the token before."""
        return self.access.by_cookie(request.cookies.get(COOKIE))

    def let_in(self, shown: str) -> Response:
        """The answer to a token: a cookie and the first page, or a refusal."""
        if not self.access.by_token(shown):
            return notice("Refused", "That is not the token of this session.", 403)
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(
            COOKIE,
            self.access.cookie(),
            max_age=COOKIE_MAX_AGE_S,
            httponly=True,
            samesite="strict",
            secure=self.settings.tls is not None,
        )
        return answer

    def _guarded(self) -> Front:
        core.app.config.socket_io_js_transports = ["websocket"]
        ui.run_with(
            self.app,
            tailwind=False,
            show_welcome_message=False,
            reconnect_timeout=RECONNECT_S,
            message_history_length=100,
            binding_refresh_interval=None,
        )
        # the library builds a page, with a viewer, for whatever is not there
        core.app.add_exception_handler(404, _not_found)
        offences = Offences()
        Sockets(self._viewers, self.access, offences).guard()
        return Front(self.app, HostNames(self.settings), self._viewers, offences, self._gate, self._allowed)

    def _gate(self, request: Request) -> Response | AbstractContextManager[None]:
        """What is answered before a page is built: the token, and that all places are taken; else the place."""
        if not self._is_page(request.url.path):
            return nullcontext()
        shown = request.query_params.get("token")
        if shown is not None:
            return self.let_in(shown)
        instead = self._instead(request)
        if instead is not None:
            return instead
        commands = self.may_command(request)
        if not self._viewers.full(commands=commands):
            return self._viewers.building(commands=commands)
        text = f"All {self._viewers.onlookers_max} places to look on are taken: close the page elsewhere, or wait."
        return notice("Full", text, 503, headers={"Retry-After": "10"})


async def is_there(client: Client, until_s: float = math.inf) -> bool:
    """Wait for the viewer's socket; False once he is gone, or where it has not come by then."""
    while not client.has_socket_connection:
        if client.is_deleted or time.monotonic() > until_s:
            return False
        await asyncio.sleep(0.2)
    return True


async def is_drawn(client: Client) -> None:
    """Wait until the browser has done all that it was sent, for `ALIVE_TIMEOUT_S` at most."""
    with contextlib.suppress(TimeoutError):
        await client.run_javascript("return 0", timeout=ALIVE_TIMEOUT_S)


async def _not_found(request: Request, error: Exception) -> Response:
    return PlainTextResponse("Not found\n", 404)


def notice(title: str, text: str, status: int, headers: dict[str, str] | None = None) -> Response:
    """A page of one sentence."""
    return HTMLResponse(_NOTICE.format(title=title, text=text), status, headers)
