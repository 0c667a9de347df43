"""Serves the bench page in the same process and event loop as the session.

    GET  /                       the page; /?token=TOKEN keeps a cookie and goes to /
    POST /login                  the token by a form
    GET  /report                 at the end of the session
    GET  /certificate            the same, for who has shown the token: it names the customer
    GET  /api/session/state      the snapshot (JSON)
    POST /api/session/command    a Command (JSON), with `Authorization: Bearer TOKEN`; answers a Reply

`host` brings server, guards and viewers.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from urllib.parse import parse_qs

from fastapi import Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse
from nicegui import background_tasks, ui

from highside.bench.session.driver import SessionDriver
from highside.bench.session.snapshot import Command
from highside.config.certificate import CertificateFields
from highside.config.web import WebTable
from highside.errors import HighsideError, InputError
from highside.reading import parse_message
from highside.web.documents import Documents
from highside.web.host import PageHost
from highside.web.page import BenchView, Shared

_STYLE = (Path(__file__).parent / "bench.css").read_text(encoding="utf-8")


class BenchPage:
    """The page of one session. One in a process, as its host. `start` it, `stop` it."""

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
        self._host = PageHost(settings, is_page=lambda path: path == "/")
        self._documents = Documents(driver, fields)
        self._shared = Shared()

    @property
    def address(self) -> str:
        """Where the page is, without the token."""
        return self._host.address

    @property
    def link(self) -> str:
        """The page with the right to command."""
        return self._host.link

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._host.port

    async def start(self) -> None:
        """Listen. Raises InputError where that address cannot be had, or [web.tls] not be used."""
        app = self._host.app
        app.post("/login")(self._login)
        app.get("/report")(self._report)
        app.get("/certificate")(self._certificate)
        app.get("/api/session/state")(self._state)
        app.post("/api/session/command")(self._command)
        ui.page("/", title=f"Bench: {self._driver.snapshot().tool}", language="en-US", dark=None)(self._page)
        await self._host.start()

    async def stop(self) -> None:
        """Say good-bye to the viewers and close."""
        await self._host.stop()

    # --- routes ------------------------------------------------------------------------------------------------

    async def _page(self, request: Request) -> None:
        client, commands = self._host.admit(request)
        ui.add_css(_STYLE)
        view = BenchView(
            self._driver, self._shared, operator=self._operator, commands=commands, rate_hz=self._settings.rate_hz
        )
        view.show(self._driver.snapshot())
        background_tasks.create(view.follow(client), name=f"viewer {client.id}")

    async def _login(self, request: Request) -> Response:
        body = (await request.body()).decode("utf-8", "replace")
        return self._host.let_in(parse_qs(body, max_num_fields=20).get("token", [""])[0])

    async def _report(self) -> Response:
        return await _document(self._documents.report)

    async def _certificate(self, request: Request) -> Response:
        if not (self._host.may_command(request) or self._host.access.by_header(request.headers.get("authorization"))):
            return PlainTextResponse("The certificate is for who has shown the token of this session.\n", 401)
        return await _document(self._documents.certificate)

    async def _state(self) -> Response:
        return Response(self._driver.snapshot().to_json(), media_type="application/json")

    async def _command(self, request: Request) -> Response:
        if not self._host.access.by_header(request.headers.get("authorization")):
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
