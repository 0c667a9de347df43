"""Serves the bench page in the same process and event loop as the session.

    GET  /                       the page; /?token=TOKEN keeps a cookie and goes to /
    POST /login                  the token by a form
    GET  /report                 at the end of the session
    GET  /certificate            the same, for who has shown the token: it names the customer
    GET  /api/session/state      the snapshot (JSON)
    POST /api/session/command    a Command (JSON), with `Authorization: Bearer TOKEN`; answers a Reply

NiceGUI brings page, sockets and reconnects, uvicorn the server; `front`, `sockets` and `listen` stand before them.
Nothing is fetched from elsewhere: the policy sent with every page forbids it to the browser.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse
from nicegui import background_tasks, core, ui

from highside.bench.session.driver import SessionDriver
from highside.bench.session.snapshot import Command
from highside.config.certificate import CertificateFields
from highside.config.web import WebTable
from highside.errors import HighsideError, InputError
from highside.reading import parse_message
from highside.service.logs import keep_short
from highside.web.access import COOKIE, COOKIE_MAX_AGE_S, Access
from highside.web.documents import Documents
from highside.web.front import Front, HostNames
from highside.web.listen import Server, listening, server_of
from highside.web.page import BenchView, Shared
from highside.web.sockets import Offences, Sockets
from highside.web.viewers import Viewers

RECONNECT_S = 10.0
"""A viewer whose socket was cut finds its page as it left it within this; later the page loads anew."""
LIBRARIES = ("nicegui", "uvicorn.error", "asyncio")
"""Loggers of what speaks with browsers."""
_STYLE = (Path(__file__).parent / "bench.css").read_text(encoding="utf-8")


class BenchPage:
    """The page of one session. One in a process: NiceGUI keeps its pages there. `start` it, `stop` it."""

    def __init__(
        self,
        driver: SessionDriver,
        settings: WebTable,
        *,
        operator: str,
        fields: CertificateFields | None = None,
    ) -> None:
        self._driver = driver
        self._settings = settings
        self._operator = operator
        self._access = Access(settings.read_token())
        self._documents = Documents(driver, fields)
        self._shared = Shared()
        self._viewers = Viewers(settings.viewers)
        self._server: Server | None = None
        self._task: asyncio.Task[None] | None = None
        self._care: asyncio.Task[None] | None = None
        self.port = settings.port

    @property
    def address(self) -> str:
        """Where the page is, without the token."""
        host = "127.0.0.1" if self._settings.host in ("0.0.0.0", "::") else self._settings.host
        scheme = "http" if self._settings.tls is None else "https"
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def link(self) -> str:
        """The page with the right to command."""
        return f"{self.address}?token={self._access.token}"

    async def start(self) -> None:
        """Listen. Raises InputError where that address cannot be had, or [web.tls] not be used."""
        keep_short(*LIBRARIES)
        self._server = server_of(self._app(), self._settings)
        listened = listening(self._settings)
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

    # --- routes ------------------------------------------------------------------------------------------------

    def _app(self) -> Front:
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        app.post("/login")(self._login)
        app.get("/report")(self._report)
        app.get("/certificate")(self._certificate)
        app.get("/api/session/state")(self._state)
        app.post("/api/session/command")(self._command)
        ui.page("/", title=f"Bench: {self._driver.snapshot().tool}", language="en-US", dark=None)(self._page)
        core.app.config.socket_io_js_transports = ["websocket"]
        ui.run_with(
            app,
            tailwind=False,
            show_welcome_message=False,
            reconnect_timeout=RECONNECT_S,
            message_history_length=100,
            binding_refresh_interval=None,
        )
        # the library builds a page, with a viewer, for whatever is not there
        core.app.add_exception_handler(404, _not_found)
        offences = Offences()
        Sockets(self._viewers, self._access, offences).guard()
        return Front(app, HostNames(self._settings), self._viewers, offences, self._gate)

    def _gate(self, request: Request) -> Response | AbstractContextManager[None]:
        """What is answered before a page is built: the token, and that all places are taken; else the place."""
        if request.url.path != "/":
            return nullcontext()
        shown = request.query_params.get("token")
        if shown is not None:
            return self._let_in(shown)
        commands = self._may_command(request)
        if not self._viewers.full(commands=commands):
            return self._viewers.building(commands=commands)
        text = f"All {self._viewers.onlookers_max} places to look on are taken: close the page elsewhere, or wait."
        return _notice("Full", text, 503, headers={"Retry-After": "10"})

    def _may_command(self, request: Request) -> bool:
        return self._access.by_cookie(request.cookies.get(COOKIE))

    async def _page(self, request: Request) -> None:
        client = ui.context.client
        commands = self._may_command(request)
        self._viewers.add(client.id, commands=commands)
        client.on_delete(lambda: self._viewers.remove(client.id))
        ui.add_css(_STYLE)
        view = BenchView(
            self._driver, self._shared, operator=self._operator, commands=commands, rate_hz=self._settings.rate_hz
        )
        view.show(self._driver.snapshot())
        background_tasks.create(view.follow(client), name=f"viewer {client.id}")

    def _let_in(self, shown: str) -> Response:
        if not self._access.by_token(shown):
            return _notice("Refused", "That is not the token of this session.", 403)
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(
            COOKIE,
            self._access.cookie(),
            max_age=COOKIE_MAX_AGE_S,
            httponly=True,
            samesite="strict",
            secure=self._settings.tls is not None,
        )
        return answer

    async def _login(self, request: Request) -> Response:
        from urllib.parse import parse_qs

        body = (await request.body()).decode("utf-8", "replace")
        return self._let_in(parse_qs(body, max_num_fields=20).get("token", [""])[0])

    async def _report(self) -> Response:
        return await _document(self._documents.report)

    async def _certificate(self, request: Request) -> Response:
        if not (self._may_command(request) or self._access.by_header(request.headers.get("authorization"))):
            return PlainTextResponse("The certificate is for who has shown the token of this session.\n", 401)
        return await _document(self._documents.certificate)

    async def _state(self) -> Response:
        return Response(self._driver.snapshot().to_json(), media_type="application/json")

    async def _command(self, request: Request) -> Response:
        if not self._access.by_header(request.headers.get("authorization")):
            text = "commands need the header Authorization: Bearer TOKEN"
            return JSONResponse({"error": text}, 401, headers={"WWW-Authenticate": "Bearer"})
        try:
            command = parse_message(Command, await request.body())
        except InputError as error:
            return JSONResponse({"error": str(error)}, 422)
        reply = await self._driver.command(command)
        return Response(reply.model_dump_json(), 200 if reply.accepted else 409, media_type="application/json")


async def _document(make: Callable[[], Awaitable[str]]) -> Response:
    try:
        return HTMLResponse(await make())
    except HighsideError as error:
        return Response(f"{error}\n", 409, media_type="text/plain")


async def _not_found(request: Request, error: Exception) -> Response:
    return PlainTextResponse("Not found\n", 404)


def _notice(title: str, text: str, status: int, headers: dict[str, str] | None = None) -> Response:
    """A page of one sentence."""
    return HTMLResponse(f'<!DOCTYPE html><html lang="en"><title>{title}</title><p>{text}</p></html>', status, headers)
