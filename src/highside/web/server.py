"""Serves the bench page in the same process and event loop as the session.

    GET  /                       the page; /?token=TOKEN keeps a cookie and goes to /
    POST /login                  the token by a form
    GET  /report, /certificate   at the end of the session
    GET  /api/session/state      the snapshot (JSON)
    POST /api/session/command    a Command (JSON), with `Authorization: Bearer TOKEN`; answers a Reply

NiceGUI brings page, sockets and reconnects, uvicorn the server. Nothing is fetched from elsewhere: the policy sent with
every page forbids it to the browser.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from nicegui import background_tasks, core, ui
from pydantic import ValidationError
from starlette.middleware.trustedhost import TrustedHostMiddleware

from highside.config.certificate import CertificateFields
from highside.config.web import WebTable
from highside.errors import HighsideError, InputError
from highside.session.driver import SessionDriver
from highside.session.snapshot import Command
from highside.web.access import COOKIE, Access
from highside.web.documents import Documents
from highside.web.page import BenchView, Shared

RECONNECT_S = 10.0
"""A viewer whose socket was cut finds its page as it left it within this; later the page loads anew."""
BODY_MAX = 10_000
_STYLE = (Path(__file__).parent / "bench.css").read_text(encoding="utf-8")
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline';"
    " img-src 'self' data:; font-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; form-action 'self';"
    " base-uri 'self'"
)


class _Server(uvicorn.Server):
    """Leaves the signals to whoever owns the process."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


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
        self._server: _Server | None = None
        self._task: asyncio.Task[None] | None = None
        self.port = settings.port

    @property
    def address(self) -> str:
        """Where the page is, without the token."""
        host = "127.0.0.1" if self._settings.host in ("0.0.0.0", "::") else self._settings.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def link(self) -> str:
        """The page with the right to command."""
        return f"{self.address}?token={self._access.token}"

    async def start(self) -> None:
        """Listen. Raises InputError where that address cannot be had."""
        listening = _listen(self._settings)
        self.port = listening.getsockname()[1]
        config = uvicorn.Config(
            self._app(), log_level="warning", access_log=False, ws_max_size=2**16, timeout_graceful_shutdown=2
        )
        self._server = _Server(config)
        self._task = asyncio.create_task(self._server.serve([listening]))
        while not self._server.started:
            if self._task.done():
                await self._task
                raise InputError("the page could not be started", where=self.address)
            await asyncio.sleep(0.02)

    async def stop(self) -> None:
        """Say good-bye to the viewers and close."""
        if self._server is not None and self._task is not None:
            self._server.should_exit = True
            await asyncio.gather(self._task, return_exceptions=True)

    # --- routes ------------------------------------------------------------------------------------------------

    def _app(self) -> FastAPI:
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=self._settings.allowed_hosts())
        app.middleware("http")(_guarded)
        app.post("/login")(self._login)
        app.get("/report")(self._report)
        app.get("/certificate")(self._certificate)
        app.get("/api/session/state")(self._state)
        app.post("/api/session/command")(self._command)
        ui.page("/", title=f"Bench: {self._driver.snapshot().tool}", language="en-US", dark=None)(self._page)
        ui.run_with(
            app,
            tailwind=False,
            show_welcome_message=False,
            reconnect_timeout=RECONNECT_S,
            message_history_length=100,
            binding_refresh_interval=None,
        )
        # sockets, too, only from our own page
        core.sio.eio.cors_allowed_origins = None
        return app

    async def _page(self, request: Request) -> Response | None:
        shown = request.query_params.get("token")
        if shown is not None:
            return self._let_in(shown)
        client = ui.context.client
        ui.add_css(_STYLE)
        view = BenchView(
            self._driver,
            self._shared,
            operator=self._operator,
            commands=self._access.by_cookie(request.cookies.get(COOKIE)),
            rate_hz=self._settings.rate_hz,
        )
        view.show(self._driver.snapshot())
        background_tasks.create(view.follow(client), name=f"viewer {client.id}")
        return None

    def _let_in(self, shown: str) -> Response:
        if not self._access.by_token(shown):
            return HTMLResponse("<!DOCTYPE html><title>Refused</title><p>That is not the token of this session.", 403)
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(COOKIE, self._access.cookie, httponly=True, samesite="strict")
        return answer

    async def _login(self, request: Request) -> Response:
        from urllib.parse import parse_qs

        body = (await request.body())[:BODY_MAX].decode("utf-8", "replace")
        return self._let_in(parse_qs(body).get("token", [""])[0])

    async def _report(self) -> Response:
        return await _document(self._documents.report)

    async def _certificate(self) -> Response:
        return await _document(self._documents.certificate)

    async def _state(self) -> Response:
        return Response(self._driver.snapshot().to_json(), media_type="application/json")

    async def _command(self, request: Request) -> Response:
        if not self._access.by_header(request.headers.get("authorization")):
            text = "commands need the header Authorization: Bearer TOKEN"
            return JSONResponse({"error": text}, 401, headers={"WWW-Authenticate": "Bearer"})
        try:
            command = Command.model_validate_json((await request.body())[:BODY_MAX])
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"])) or "the message"
            return JSONResponse({"error": f"{where}: {first['msg']}"}, 422)
        reply = await self._driver.command(command)
        return Response(reply.model_dump_json(), 200 if reply.accepted else 409, media_type="application/json")


async def _document(make: Callable[[], Awaitable[str]]) -> Response:
    try:
        return HTMLResponse(await make())
    except HighsideError as error:
        return Response(f"{error}\n", 409, media_type="text/plain")


async def _guarded(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
    answer = await call_next(request)
    answer.headers.setdefault("Content-Security-Policy", _POLICY)
    answer.headers.setdefault("Referrer-Policy", "no-referrer")
    answer.headers.setdefault("X-Content-Type-Options", "nosniff")
    return answer


def _listen(settings: WebTable) -> socket.socket:
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
