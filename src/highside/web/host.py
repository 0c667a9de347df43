"""What every page of ours needs: its server, its guards, its viewers. One in a process: NiceGUI keeps its pages there.

NiceGUI brings pages, sockets and reconnects, uvicorn the server; `front`, `sockets` and `listen` stand before them.
Nothing is fetched from elsewhere: the policy sent with every page forbids it to the browser.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, PlainTextResponse, RedirectResponse
from markupsafe import Markup
from nicegui import Client, core, ui
from nicegui.language import Language

from highside.config.web import WebTable
from highside.errors import InputError
from highside.service.logs import keep_short
from highside.web.access import COOKIE, COOKIE_MAX_AGE_S, Access
from highside.web.front import Allowed, Front, HostNames
from highside.web.language import LanguageSwitch
from highside.web.listen import Server, listening, server_of
from highside.web.loading import say_while_it_loads
from highside.web.navigation import Link
from highside.web.phone import reachable_host
from highside.web.signin.acts import Person
from highside.web.signin.people import People, Scope
from highside.web.signin.routes import SignInPages, unless_signed_in
from highside.web.sockets import Offences, Sockets
from highside.web.viewer import answer_for, viewer
from highside.web.viewers import Viewers
from highside.web.words import _, language_of

_NOTICE = Markup('<!DOCTYPE html><html lang="{language}"><title>{title}</title><p>{text}</p></html>')
RECONNECT_S = 10.0
"""A viewer whose socket was cut finds its page as it left it within this; later the page loads anew."""
CONNECT_WITHIN_S = 15.0
"""A page whose socket has not come within this is forgotten: each holds some 0.4 MB. A phone on a bad line takes 5."""
LOOK_EVERY_S = 2.0
"""Seconds after which the open page of who has signed out ends."""
ALIVE_TIMEOUT_S = 10.0
"""A browser that has not drawn for so long is queried again."""
LIBRARY_LANGUAGES: dict[str, Language] = {"en": "en-US", "de": "de", "nb": "nb-NO", "es": "es"}
"""What the library calls our languages."""
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
        links: Sequence[Link] = (),
    ) -> None:
        self.settings = settings
        self.app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        self.people = None if settings.users is None else People(settings)
        self.access = Access(settings.read_token(), people=self.people)
        self.links = tuple(links)
        self._pages: dict[str, tuple[Client, Scope]] = {}
        self._is_page, self._instead, self._allowed = is_page, instead, allowed
        self._viewers = Viewers(settings.viewers)
        self._server: Server | None = None
        self._task: asyncio.Task[None] | None = None
        self._care: list[asyncio.Task[None]] = []
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

    @property
    def link_elsewhere(self) -> str | None:
        """The same for a phone or another machine, without a token where people sign in; None where the page listens
        for this machine alone."""
        host = reachable_host(self.settings)
        if host is None:
            return None
        scheme = "http" if self.settings.tls is None else "https"
        return f"{scheme}://{host}:{self.port}/" + ("" if self.people is not None else f"?token={self.access.token}")

    async def start(self) -> None:
        """Listen. Raises InputError where that address cannot be had, or [web.tls] not be used."""
        keep_short(*LIBRARIES)
        LanguageSwitch(secure=self.settings.is_https).serve(self.app)
        if self.people is not None:
            self.people.check()
            SignInPages(self.people, self.links, secure=self.settings.is_https).serve(self.app)
        self._server = server_of(self._guarded(), self.settings, self.access.knows)
        listened = listening(self.settings)
        self.port = listened.getsockname()[1]
        self._task = asyncio.create_task(self._server.serve([listened]))
        while not self._server.started:
            if self._task.done():
                await self._task
                raise InputError("the page could not be started", where=self.address)
            await asyncio.sleep(0.02)
        self._care = [asyncio.create_task(self._server.look_after()), asyncio.create_task(self._end_signed_out())]

    async def stop(self) -> None:
        """Say good-bye to the viewers and close."""
        if self._server is not None and self._task is not None:
            for task in self._care:
                task.cancel()
            self._server.should_exit = True
            await asyncio.gather(self._task, return_exceptions=True)

    def admit(self, request: Request) -> tuple[Client, bool]:
        """The client of the page that is being built, counted as a viewer, and whether it may command."""
        client = ui.context.client
        # what the library says by itself, and the page's `lang`, are the viewer's too: of this page alone
        client.page = copy.copy(client.page)
        client.page.language = LIBRARY_LANGUAGES[viewer().language]
        commands = self.may_command(request)
        self._viewers.add(client.id, commands=commands)
        self._pages[client.id] = (client, dict(request.scope))
        client.on_delete(lambda: self._forget(client.id))
        say_while_it_loads()
        return client, commands

    def _forget(self, page: str) -> None:
        self._viewers.remove(page)
        self._pages.pop(page, None)

    def person(self, request: Request) -> Person | None:
        """Whom a request comes from."""
        return self.access.who(request.scope)

    def may_command(self, request: Request) -> bool:
        """Whether the person may, or the browser has shown the token before."""
        return self.access.opens(request.scope, commands=True)

    def let_in(self, shown: str) -> Response:
        """The answer to a token: a cookie and the first page, or a refusal."""
        if self.people is not None:
            text = _("People sign in here with a name and a password: no token opens this page.")
            return notice(_("Refused"), text, 403)
        if not self.access.by_token(shown):
            return notice(_("Refused"), _("That is not the token of this session."), 403)
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(
            COOKIE,
            self.access.cookie(),
            max_age=COOKIE_MAX_AGE_S,
            httponly=True,
            samesite="strict",
            secure=self.settings.is_https,
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
        names = HostNames(self.settings)
        proxy = self.settings.proxy
        return Front(self.app, names, self._viewers, offences, self._gate, self._allowed, proxy)

    async def _end_signed_out(self) -> None:
        """End the open pages of who has signed out, was removed, or may no longer what the page offers."""
        while self.people is not None:
            await asyncio.sleep(LOOK_EVERY_S)
            for client, scope in list(self._pages.values()):
                if not self.access.opens(scope, commands=self._viewers.may_command(client.id)):
                    with client:
                        ui.run_javascript("location.reload()")
                    await asyncio.sleep(0.2)
                    client.delete()

    def _gate(self, request: Request) -> Response | AbstractContextManager[None]:
        """What is answered before a page is built: that one has to sign in, the token, and that all places are taken;
        else the place."""
        person = self.person(request)
        answer_for(person, signs_in=self.people is not None, language=language_of(request.scope))
        if self.people is not None:
            refused = unless_signed_in(request, person)
            if refused is not None:
                return refused
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
        text = _("All %(most)s places to look on are taken: close the page elsewhere, or wait.")
        text %= {"most": self._viewers.onlookers_max}
        return notice(_("Full"), text, 503, headers={"Retry-After": "10"})


async def is_there(client: Client, until_s: float = math.inf) -> bool:
    """Wait for the viewer's socket; False once he is gone, or where it has not come by then."""
    while not client.has_socket_connection:
        if client.is_deleted or time.monotonic() > until_s:
            return False
        await asyncio.sleep(0.2)
    return True


async def is_drawn(client: Client, last: str = "") -> None:
    """Wait until the browser has done all that it was sent, for `ALIVE_TIMEOUT_S` at most; `last`: a statement that it
    then carries out."""
    with contextlib.suppress(TimeoutError):
        await client.run_javascript(f"{last}; return 0", timeout=ALIVE_TIMEOUT_S)


async def _not_found(request: Request, error: Exception) -> Response:
    return PlainTextResponse("Not found\n", 404)


def notice(title: str, text: str, status: int, headers: dict[str, str] | None = None) -> Response:
    """A page of one sentence."""
    return HTMLResponse(_NOTICE.format(title=title, text=text, language=viewer().language), status, headers)
