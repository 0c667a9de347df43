"""Begins bench sessions, leads to their pages, ends their processes; for who may.

    GET   /bench                               what runs, what was left unfinished, and what may be begun
    POST  /bench/begin, /bench/resume          a session of one of the folder's files: by name, never by a path
    POST  /bench/close                         ends the process; the journal keeps what was measured

Where people sign in it is for those who may put in force, since the page of a session does; else for who has the token.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fastapi import Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from highside.bench.driver import kept_by
from highside.bench.journal_file import FoundJournal, sessions
from highside.bench.setup import plan_of
from highside.config.bench import BenchFile, load_bench
from highside.config.users import Role
from highside.errors import HighsideError, InputError, Refused
from highside.web.benches.children import Children, Running
from highside.web.front import of_our_origin
from highside.web.host import PageHost, notice
from highside.web.navigation import Link
from highside.web.plain import FORM_HEADERS, HEADERS, form_of, render
from highside.web.signin.acts import Person
from highside.web.words import _
from highside.words.errors import error_told

FILES_MAX = 100
SHOWN_MAX = 5
"""Unfinished sessions of one file that are offered."""


@dataclass(frozen=True, slots=True)
class Offer:
    """A file of the folder: what it would begin, or why it cannot."""

    file: str
    tool: str = ""
    serial: str = ""
    bench: str = ""
    plan: str = ""
    unfinished: tuple[FoundJournal, ...] = ()
    trouble: str = ""


class BenchPages:
    """Adds the routes of one folder of session files."""

    def __init__(self, folder: Path, state: Path, links: tuple[Link, ...], host: PageHost) -> None:
        self._folder, self._links, self._host = folder, links, host
        token = host.access.token if host.people is None else None
        self._children = Children(state, host.settings, token, lambda: host.port)

    def serve(self) -> None:
        """Add the routes."""
        app = self._host.app
        app.get("/bench")(self._show)
        app.post("/bench/begin")(self._begin)
        app.post("/bench/resume")(self._resume)
        app.post("/bench/close")(self._close)
        app.post("/bench/sign-in")(self._sign_in)

    # --- who ---------------------------------------------------------------------------------------------------

    def _person(self, request: Request) -> Person | None:
        person = self._host.person(request)
        return person if person is not None and person.may(Role.FORCE) else None

    async def _sign_in(self, request: Request) -> Response:
        if not of_our_origin(request.scope):
            return notice(_("Refused"), _("This form does not come from a page of this server."), 403)
        answer = self._host.let_in(form_of(await request.body()).get("token", [""])[0])
        if answer.status_code == 303:
            answer.headers["location"] = "/bench"
        return answer

    # --- what is shown -----------------------------------------------------------------------------------------

    async def _show(self, request: Request) -> Response:
        return await self._page(request)

    async def _page(self, request: Request, trouble: str = "", status: int = 200) -> Response:
        may = self._person(request) is not None
        running = await self._children.running()
        offers = await asyncio.to_thread(self._offers) if may else []
        host = request.headers.get("host", "")
        page = render(
            "plain/bench.html",
            self._links,
            "/bench",
            may=may,
            token_wanted=self._host.people is None,
            trouble=trouble,
            running=[self._row(one, host, may=may) for one in running],
            offers=offers,
            operator=self._operator(request),
        )
        return HTMLResponse(page, status, FORM_HEADERS)

    def _operator(self, request: Request) -> str:
        person = self._person(request)
        return "" if person is None else person.name

    def _row(self, one: Running, host: str, *, may: bool) -> dict[str, object]:
        scheme = "https" if self._host.settings.is_https else "http"
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
        address = f"{scheme}://{name}:{one.begun.port}/"
        # where one token opens all, the browser has shown it
        right = f"?token={self._children.token_of(one.begun)}" if may and self._host.people is not None else ""
        return {"begun": one.begun, "s": one.snapshot, "ended": one.ended, "address": address + right}

    def _offers(self) -> list[Offer]:
        return [self._offer(path) for path in self._files()]

    def _files(self) -> list[Path]:
        found = sorted(path for path in self._folder.glob("*.toml") if path.is_file())
        return found[:FILES_MAX]

    def _offer(self, path: Path) -> Offer:
        try:
            settings = load_bench(path)
            title = plan_of(settings).title
        except HighsideError as error:
            return Offer(path.name, trouble=error_told(error, "refusals").replace(f"{self._folder}/", ""))
        bench = settings.bench.name or ("simulated" if settings.simulated is not None else "")
        left = tuple(one for one in self._sessions(settings) if one.resumable)[:SHOWN_MAX]
        return Offer(path.name, settings.tool.id, settings.tool.serial or "", bench, title, left)

    def _sessions(self, settings: BenchFile) -> list[FoundJournal]:
        return list(sessions(settings.store.sessions, settings.tool.id, kept_by(settings.store.directory)))

    # --- what is done ------------------------------------------------------------------------------------------

    async def _begin(self, request: Request) -> Response:
        return await self._do(request, "begin a bench session", self._new)

    async def _resume(self, request: Request) -> Response:
        return await self._do(request, "go on with a bench session", self._unfinished)

    async def _do(
        self, request: Request, act: str, arguments: Callable[[dict[str, str]], tuple[Path, list[str]]]
    ) -> Response:
        person = self._person(request)
        if person is None or not of_our_origin(request.scope):
            return await self._page(request, _("Sessions are begun by who may put calibrations in force."), 403)
        form = {name: values[0].strip() for name, values in form_of(await request.body()).items()}
        try:
            file, told = await asyncio.to_thread(arguments, form)
            operator = person.name or form.get("operator", "")
            if not operator or len(operator) > 64 or not operator.isprintable():
                raise InputError(_("Say who you are: the field Operator is empty or too long."))
            await self._noted(person, act, file=file.name)
            await self._children.begin(file, operator, told)
        except HighsideError as error:
            return await self._page(request, error_told(error, "refusals").replace(f"{self._folder}/", ""), 409)
        return RedirectResponse("/bench", 303, headers=HEADERS)

    async def _close(self, request: Request) -> Response:
        person = self._person(request)
        if person is None or not of_our_origin(request.scope):
            return await self._page(request, _("Sessions are ended by who may put calibrations in force."), 403)
        name = form_of(await request.body()).get("id", [""])[0]
        try:
            await self._noted(person, "end the process of a bench session")
            await self._children.end(name)
        except HighsideError as error:
            return await self._page(request, error_told(error, "refusals"), 409)
        return RedirectResponse("/bench", 303, headers=HEADERS)

    async def _noted(self, person: Person, act: str, **details: str) -> None:
        if self._host.people is not None:
            await asyncio.to_thread(lambda: self._host.people.acts.write(person, act, **details))  # type: ignore[union-attr]

    def _file(self, name: str) -> Path:
        """One of those that are there. Raises Refused."""
        found = next((path for path in self._files() if path.name == name), None)
        if found is None:
            raise Refused(_("there is no such file in the folder of this page any more"))
        return found

    def _new(self, form: dict[str, str]) -> tuple[Path, list[str]]:
        file, plan = self._file(form.get("file", "")), form.get("plan", "")
        told = ["--plan-of", str(self._file(plan))] if plan not in ("", file.name) else []
        for field in ("id", "serial"):
            if value := form.get(field, ""):
                told += ["--set", f"tool.{field}={json.dumps(value)}"]
        return file, told

    def _unfinished(self, form: dict[str, str]) -> tuple[Path, list[str]]:
        file = self._file(form.get("file", ""))
        wanted = form.get("session", "")
        if wanted not in {one.name for one in self._sessions(load_bench(file)) if one.resumable}:
            raise Refused(_("that session cannot be gone on with: it is over, or runs already"))
        return file, ["--resume", wanted]
