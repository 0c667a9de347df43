"""Putting a calibration of the store in force, and taking it back: for who has the role, after a page that shows what
changes.

    GET, POST  /calibrations/ID/force    put this one in force
    GET, POST  /calibrations/ID/back     this one is in force: put the one before in force again, or none

What is written is what `highside calibrate activate` and `rollback` write; a running service takes it at its next
reload. The form carries what was in force when it was shown: if that has changed since, nothing is done.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from highside.calibration.change import change
from highside.calibration.record import verify
from highside.calibration.signature import TrustedKeys
from highside.config.users import Role
from highside.errors import HighsideError, Refused
from highside.recording.calibration_store import CalibrationStore, contradiction
from highside.web.plain import FORM_HEADERS, HEADERS, form_of
from highside.web.records.shelf import written
from highside.web.records.views import Views
from highside.web.records.wanted import Wanted
from highside.web.signin.acts import BEGINS, DONE, Acts, Person
from highside.web.viewer import viewer
from highside.web.words import _, said

NONE = "none"
"""In the form, where nothing is in force"""


class ForcePages:
    """Adds the routes; `answer` makes an answer in a thread, in its turn."""

    def __init__(
        self,
        store: CalibrationStore,
        views: Views,
        acts: Acts,
        trusted: TrustedKeys | None,
        answer: Callable[[Callable[[], Response]], Awaitable[Response]],
    ) -> None:
        self._store, self._views, self._acts, self._trusted = store, views, acts, trusted
        self._answer = answer

    def serve(self, app: FastAPI) -> None:
        """Add the routes, before that of a record."""
        for word, back in (("force", False), ("back", True)):
            app.get(f"/calibrations/{{name}}/{word}")(self._asking(back=back))
            app.post(f"/calibrations/{{name}}/{word}")(self._doing(back=back))

    def _asking(self, *, back: bool) -> Callable[[str], Awaitable[Response]]:
        async def asked(name: str) -> Response:
            if self._person() is None:
                return self._not_for_you()
            return await self._answer(lambda: self._ask(name, back=back))

        return asked

    def _doing(self, *, back: bool) -> Callable[[str, Request], Awaitable[Response]]:
        async def done(name: str, request: Request) -> Response:
            seen = form_of(await request.body()).get("seen", [""])[0]
            person = self._person()
            if person is None:
                return self._not_for_you()
            return await self._answer(lambda: self._do(person, name, seen, back=back))

        return done

    def _person(self) -> Person | None:
        """Who asks, if that is somebody who may."""
        person = viewer().person
        return person if person is not None and person.may(Role.FORCE) else None

    def _not_for_you(self) -> Response:
        page = self._views.trouble(
            _("That is not for you."), _("It is for who has the role %(role)s.") % {"role": _("put in force")}
        )
        return HTMLResponse(page, 403, HEADERS)

    def _ask(self, name: str, *, back: bool) -> Response:
        wanted = self._wanted(name, back=back)
        found = None if wanted.now is None or wanted.to_nothing else change(wanted.now, wanted.then)
        return HTMLResponse(self._views.force(wanted, found), headers=FORM_HEADERS)

    def _do(self, person: Person, name: str, seen: str, *, back: bool) -> Response:
        wanted = self._wanted(name, back=back)
        act = "take back a calibration" if back else "put a calibration in force"
        after = NONE if wanted.to_nothing else wanted.then.id
        facts = {"tool": wanted.then.tool_id, "record": after, "replaces": wanted.now_id}
        self._acts.write(person, act, BEGINS, **facts)
        try:
            if seen != wanted.now_id:
                raise Refused(said("another calibration was put in force meanwhile: look again at what would change"))
            if wanted.doubt is not None:
                raise Refused(wanted.doubt)
            self._change(wanted, seen)
        except HighsideError as error:
            self._acts.write(person, act, written(error, self._store.directory), **facts)
            raise
        self._acts.write(person, act, DONE, **facts)
        return RedirectResponse(f"/calibrations/{wanted.then.id}", 303, HEADERS)

    def _change(self, wanted: Wanted, seen: str) -> None:
        now_s = time.time()
        if wanted.to_nothing:
            self._store.take_out(wanted.then.tool_id, now_s=now_s, expected=seen)
        elif wanted.back:
            self._store.rollback(wanted.then.tool_id, now_s=now_s, expected=wanted.then.id, trusted=self._trusted)
        else:
            replaces = None if seen == NONE else seen
            self._store.activate(wanted.then, now_s=now_s, trusted=self._trusted, replaces=(replaces,))

    def _wanted(self, name: str, *, back: bool) -> Wanted:
        given = self._store.get(name)
        now_id = self._store.active_id(given.tool_id)
        then = given
        if back:
            before = self._store.before_id(given.tool_id)
            if now_id != given.id:
                raise Refused(said("this calibration is not in force"))
            if before is None:
                return Wanted(given, given, now_id, back, None, to_nothing=True)
            then = self._store.get(before)
        elif now_id == given.id:
            raise Refused(said("this calibration is in force already"))
        now, doubt = None, contradiction(then)
        if now_id is not None:
            try:
                now = self._store.get(now_id)
            except HighsideError as error:
                # what is in force cannot be read: no comparison, and good reason to replace it
                doubt = doubt if not back else written(error, self._store.directory)
        try:
            verify(then, tool_id=then.tool_id, now_s=time.time(), trusted=self._trusted)
        except HighsideError as error:
            doubt = str(error)
        return Wanted(then, now, now_id or NONE, back, doubt)
