"""Answers requests for what is kept.

    GET  /calibrations[?first=N]                     records of the store, those in force marked
    GET  /calibrations/ID, /calibrations/ID.json     one of them: as a page, as the file
    GET  /calibrations/compare?before=ID&after=ID    what the second changes
    GET  /sessions[?first=N]                         bench sessions
    GET  /sessions/NAME, /sessions/NAME/report       one of them: its state, its report
    GET  /sessions/NAME/photographs/N                the N-th photograph of it, from 0

Nothing is kept of a viewer and nothing is written but what signed-in people do (`force`). The work is done in a thread,
one request at a time, and only so many may wait: whoever asks faster is told to come back.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse

from highside.bench.photographs import photographs
from highside.calibration.change import change
from highside.config.certificate import CertificateFields
from highside.config.serve import RecordsTable
from highside.errors import HighsideError, InputError
from highside.recording.calibration_store import Activation, CalibrationStore
from highside.service.quiet_log import QuietLog
from highside.web.navigation import Link
from highside.web.plain import HEADERS
from highside.web.records.certificates import CertificatePages
from highside.web.records.force import ForcePages
from highside.web.records.shelf import CalibrationShelf, SessionShelf, file_state, told
from highside.web.records.views import Pages, Views
from highside.web.signin.people import People
from highside.web.viewer import viewer
from highside.web.words import _

log = logging.getLogger("highside")

COUNT = 50
"""Lines of one page of a list."""
WAITING_MAX = 20
"""Requests that wait for their turn; a page takes some 10 ms, a report seconds."""
REPORTS_KEPT = 4
"""Reports in the memory, some 0.5 MB each."""
_ID = re.compile(r"[0-9a-f]{64}")


class RecordPages:
    """The pages of one store and one directory of journals. `serve` adds them to an application."""

    def __init__(
        self,
        settings: RecordsTable,
        links: tuple[Link, ...],
        people: People | None = None,
        fields: CertificateFields | None = None,
    ) -> None:
        self._settings, self._people = settings, people
        self._fields = fields or CertificateFields()
        self._calibrations = None if settings.store is None else CalibrationShelf(settings.store)
        self._sessions = None if settings.sessions is None else SessionShelf(settings.sessions, self._calibrations)
        self._views = Views(links)
        self._quiet = QuietLog(log)
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._reports: OrderedDict[tuple[Path, object, str], str] = OrderedDict()

    def serve(self, app: FastAPI) -> None:
        """Add the routes of what there is."""
        if self._calibrations is not None:
            shelf = self._calibrations
            if self._people is not None:
                self._serve_acts(app, shelf, self._people)

            @app.get("/calibrations")
            async def calibrations(request: Request) -> Response:
                return await self._answer(lambda: self._list(shelf, _first(request)))

            @app.get("/calibrations/compare")
            async def comparison(request: Request) -> Response:
                before, after = (request.query_params.get(name, "") for name in ("before", "after"))
                return await self._answer(lambda: self._compare(shelf, before, after))

            @app.get("/calibrations/{name}")
            async def calibration(name: str) -> Response:
                if name.endswith(".json"):
                    return await self._answer(lambda: _file(shelf, name.removesuffix(".json")))
                return await self._answer(lambda: self._record(shelf, name))

        if self._sessions is not None:
            journals = self._sessions

            @app.get("/sessions")
            async def sessions(request: Request) -> Response:
                return await self._answer(lambda: self._session_list(journals, _first(request)))

            @app.get("/sessions/{name}")
            async def session(name: str) -> Response:
                return await self._answer(lambda: self._session(journals, name))

            @app.get("/sessions/{name}/photographs/{number}")
            async def photograph(name: str, number: int) -> Response:
                return await self._answer(lambda: _photograph(journals, name, number))

            @app.get("/sessions/{name}/report")
            async def report(name: str) -> Response:
                return await self._answer(lambda: self._report(journals, name))

    def _serve_acts(self, app: FastAPI, shelf: CalibrationShelf, people: People) -> None:
        """What signed-in people do with the store."""
        store = CalibrationStore(shelf.directory)
        trusted = self._settings.read_trusted_keys()
        ForcePages(store, self._views, people.acts, trusted, self._answer).serve(app)
        CertificatePages(store, self._sessions, self._views, people.acts, self._fields, self._answer).serve(app)

    async def _answer(self, make: Callable[[], Response]) -> Response:
        if self._waiting >= WAITING_MAX:
            page = self._views.trouble(_("Too many requests at once."), _("Come back in a few seconds."))
            return HTMLResponse(page, 503, {**HEADERS, "Retry-After": "5"})
        self._waiting += 1
        try:
            async with self._turn:
                return await asyncio.to_thread(make)
        except HighsideError as error:
            return HTMLResponse(self._views.trouble(_("That cannot be shown."), self._told(error)), 404, HEADERS)
        except Exception as error:  # a defect of ours is one line of the log and one sentence to its reader
            self._quiet.say(logging.ERROR, "defect", "records page: a page failed (%r)", error)
            why = _("It is a defect of highside; the log has a line of it.")
            page = self._views.trouble(_("That cannot be shown."), why)
            return HTMLResponse(page, 500, HEADERS)
        finally:
            self._waiting -= 1

    def _told(self, error: HighsideError) -> str:
        place = None if self._calibrations is None else self._calibrations.directory
        return told(error, place)

    def _page(self, html: str) -> Response:
        return HTMLResponse(html, headers=HEADERS)

    def _list(self, shelf: CalibrationShelf, first: int) -> Response:
        listed = shelf.listed(first, COUNT)
        in_force, trouble = {}, None
        try:
            in_force = shelf.in_force()
        except HighsideError as error:
            trouble = _("What is in force is not known: %(why)s") % {"why": told(error, shelf.directory)}
        pages = Pages("/calibrations", first, COUNT, listed.total)
        return self._page(self._views.calibrations(listed, pages, in_force, time.time(), trouble))

    def _record(self, shelf: CalibrationShelf, name: str) -> Response:
        record = shelf.record(_id(name))
        history: list[Activation] = []
        trouble = None
        try:
            history = shelf.history(record.tool_id)
        except HighsideError as error:
            trouble = _("What is in force is not known: %(why)s") % {"why": told(error, shelf.directory)}
        return self._page(self._views.calibration(record, history, time.time(), trouble))

    def _compare(self, shelf: CalibrationShelf, before: str, after: str) -> Response:
        one, other = shelf.record(_id(before)), shelf.record(_id(after))
        return self._page(self._views.comparison(one, other, change(one, other)))

    def _session_list(self, journals: SessionShelf, first: int) -> Response:
        found, total = journals.listed(first, COUNT)
        return self._page(self._views.sessions(found, Pages("/sessions", first, COUNT, total)))

    def _session(self, journals: SessionShelf, name: str) -> Response:
        found, journal = journals.session(name)
        taken = [] if journal is None else photographs(journal, found.path)
        return self._page(self._views.session(found, journal, taken))

    def _report(self, journals: SessionShelf, name: str) -> Response:
        found, journal = journals.session(name)
        if journal is None or found.state == "in use":
            raise InputError(_("there is no report of a session that is being measured, or whose journal is damaged"))
        key = (found.path, file_state(found.path), viewer().language)
        if key not in self._reports:
            # a slow import that lists do not need
            from highside.report.session_page import session_page

            self._reports[key] = session_page(journal, photographs(journal, found.path))
            while len(self._reports) > REPORTS_KEPT:
                self._reports.popitem(last=False)
        # a document of its own with its own styles: the policy of all pages holds
        return HTMLResponse(self._reports[key], headers={"Cache-Control": "no-store"})


def _file(shelf: CalibrationShelf, name: str) -> Response:
    record = shelf.record(_id(name))
    shown = {"Content-Disposition": f'attachment; filename="{record.id[:12]}.json"'}
    return Response(record.to_json(), media_type="application/json", headers={**HEADERS, **shown})


def _photograph(journals: SessionShelf, name: str, number: int) -> Response:
    """One of a session's photographs, by its place among them."""
    found, journal = journals.session(name)
    taken = [] if journal is None else photographs(journal, found.path)
    if not 0 <= number < len(taken) or taken[number].trouble:
        raise InputError(_("there is no such photograph of this session, or its file was changed"))
    return Response(taken[number].data, media_type="image/jpeg", headers=HEADERS)


def _id(name: str) -> str:
    if _ID.fullmatch(name) is None:
        raise InputError(_("a calibration is named by the 64 digits of its id"))
    return name


def _first(request: Request) -> int:
    """Which line a list begins with; the beginning for what is no such number."""
    given = request.query_params.get("first", "0")
    return int(given) if given.isascii() and given.isdigit() and len(given) < 8 else 0
