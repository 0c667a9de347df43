"""Serves the bench page in the same process and event loop as the session.

    GET  /                       the page; /?token=TOKEN keeps a cookie and goes to /
    POST /login                  the token by a form
    GET  /report                 at the end of the session
    GET  /certificate            the same, for who has shown the token: it names the customer
    GET  /api/session/state      the snapshot (JSON)
    POST /photograph             a file with what it shows (`operator`, `text`), for who may command
    POST /api/session/command    a Command (JSON), with `Authorization: Bearer TOKEN`; answers a Reply

`host` brings server, guards and viewers.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

from fastapi import Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse
from nicegui import background_tasks, ui

from highside.bench.photographs import SENT_MAX
from highside.bench.session.driver import SessionDriver
from highside.bench.session.snapshot import Command
from highside.config.certificate import CertificateFields
from highside.config.web import WebTable
from highside.errors import HighsideError, InputError
from highside.reading import parse_message
from highside.web.documents import Documents
from highside.web.front import of_our_origin
from highside.web.host import PageHost
from highside.web.page import BenchView, Shared
from highside.web.plain import form_of
from highside.web.space import REDRAWN
from highside.web.words import _, told
from highside.words.errors import error_told

_STYLE = (Path(__file__).parent / "bench.css").read_text(encoding="utf-8")
PHOTOGRAPH_WITHIN_S = 120.0
"""For a whole photograph; the largest takes that at 130,000 bytes a second."""
_SCRIPT = (Path(__file__).parent / "bench.js").read_text(encoding="utf-8")


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
        self._host = PageHost(settings, is_page=lambda path: path == "/", allowed=self._allowed)
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
    def link_elsewhere(self) -> str | None:
        """The same for a phone; None where the page listens for this machine alone."""
        return self._host.link_elsewhere

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._host.port

    async def start(self) -> None:
        """Listen. Raises InputError where that address cannot be had, or [web.tls] not be used."""
        app = self._host.app
        app.post("/login")(self._login)
        app.get("/bench.js")(_script)
        app.get("/report")(self._report)
        app.get("/certificate")(self._certificate)
        app.post("/photograph")(self._photograph)
        app.get("/api/session/state")(self._state)
        app.post("/api/session/command")(self._command)
        ui.page("/", title="highside", language="en-US", dark=None)(self._page)
        await self._host.start()

    async def stop(self) -> None:
        """Say good-bye to the viewers and close."""
        await self._host.stop()

    # --- routes ------------------------------------------------------------------------------------------------

    async def _page(self, request: Request) -> None:
        client, commands = self._host.admit(request)
        ui.add_css(_STYLE)
        ui.page_title(_("Bench: %(tool)s") % {"tool": self._driver.snapshot().tool})
        ui.add_head_html('<script src="/bench.js"></script>')
        ui.add_head_html(REDRAWN)
        view = BenchView(
            self._driver,
            self._shared,
            operator=self._operator,
            commands=commands,
            rate_hz=self._settings.rate_hz,
            link_elsewhere=self._host.link_elsewhere,
            home=self._home(request),
            who=lambda: self._host.person(request),
        )
        view.show(self._driver.snapshot())
        background_tasks.create(view.follow(client), name=f"viewer {client.id}")

    def _home(self, request: Request) -> str | None:
        """The page where sessions are begun, under the name that this one was asked for by."""
        if self._settings.home_port is None:
            return None
        return str(request.url.replace(port=self._settings.home_port, path="/bench", query=""))

    async def _login(self, request: Request) -> Response:
        return self._host.let_in(form_of(await request.body()).get("token", [""])[0])

    async def _report(self) -> Response:
        return await _document(self._documents.report)

    async def _certificate(self, request: Request) -> Response:
        if not (self._host.may_command(request) or self._host.access.by_header(request.headers.get("authorization"))):
            return PlainTextResponse(_("The certificate is for who has shown the token of this session.") + "\n", 401)
        return await _document(self._documents.certificate)

    def _allowed(self, request: Request) -> tuple[int, float] | None:
        """A photograph is longer than other requests, and only who may command sends one."""
        sends = request.method == "POST" and request.url.path == "/photograph" and self._host.may_command(request)
        return (SENT_MAX, PHOTOGRAPH_WITHIN_S) if sends else None

    async def _photograph(self, request: Request) -> Response:
        if not (self._host.may_command(request) and of_our_origin(request.scope)):
            return PlainTextResponse(_("Photographs are for who may command this session.") + "\n", 403)
        person = self._host.person(request)
        operator = (person.name if person is not None else "") or request.query_params.get("operator", "")
        kept = await self._driver.photograph(operator, request.query_params.get("text", ""), await request.body())
        return PlainTextResponse(told(kept.text, "refusals"), 200 if kept.done else 422)

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


async def _script() -> Response:
    # asked for anew after an update: the page speaks with its own version alone
    return Response(_SCRIPT, media_type="text/javascript", headers={"Cache-Control": "no-cache"})


async def _document(make: Callable[[], Awaitable[str]]) -> Response:
    try:
        return HTMLResponse(await make())
    except HighsideError as error:
        return Response(f"{error_told(error, 'refusals')}\n", 409, media_type="text/plain")
