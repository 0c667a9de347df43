"""The page of a service's configuration: for who may operate.

    GET   /settings       the file
    POST  /settings       `do` check: what is wrong with the text, or what a reload would change; save: put it in place

What decides which calibration counts is saved only by who may put in force. A running service takes the file at its
next reload, which is not this page's to order.
"""

from __future__ import annotations

import asyncio
import subprocess
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse

from highside.config.users import Role
from highside.errors import HighsideError, Refused
from highside.web.navigation import Link
from highside.web.plain import FORM_HEADERS, form_of, render
from highside.web.settings.proposal import TEXT_MAX, Proposal, propose, read_text, save
from highside.web.signin.acts import BEGINS, DONE, Acts, Person
from highside.web.viewer import viewer
from highside.web.words import _, said
from highside.words.errors import error_told

BODY_MAX = 12 * TEXT_MAX + 1_000
"""Bytes of the form: each letter of the text is twelve at most."""
BODY_WITHIN_S = 30.0


class SettingsPages:
    """Adds the routes; one check at a time."""

    def __init__(self, path: Path, acts: Acts, links: tuple[Link, ...]) -> None:
        self._path, self._acts, self._links = path, acts, links
        self._turn = asyncio.Lock()

    def serve(self, app: FastAPI) -> None:
        """Add the routes."""
        app.get("/settings")(self._show)
        app.post("/settings")(self._do)

    async def _show(self) -> Response:
        if self._person() is None:
            return self._page(403, trouble=_("The configuration is for who may operate."))
        try:
            text, seen = await asyncio.to_thread(read_text, self._path)
        except HighsideError as error:
            return self._page(409, trouble=error_told(error, "settings"))
        return self._page(text=text, seen=seen)

    async def _do(self, request: Request) -> Response:
        person = self._person()
        if person is None:
            return self._page(403, trouble=_("The configuration is for who may operate."))
        form = {name: values[0] for name, values in form_of(await request.body()).items()}
        # a browser sends lines as the mail does
        text, seen = form.get("text", "").replace("\r\n", "\n"), form.get("seen", "")
        async with self._turn:
            try:
                found = await asyncio.to_thread(propose, self._path, text)
            except subprocess.TimeoutExpired:
                found = Proposal(_("the check did not end within a minute"), "")
            except HighsideError as error:
                found = Proposal(error_told(error, "settings"), "")
            saved, trouble = None, found.trouble
            if form.get("do") == "save" and trouble is None:
                try:
                    kept = await asyncio.to_thread(self._save, person, text, seen, found)
                    answer = _("Saved; the old file is %(file)s. A running service takes it at its next reload.")
                    saved = answer % {"file": kept.name}
                    seen = (await asyncio.to_thread(read_text, self._path))[1]
                except HighsideError as error:
                    trouble = error_told(error, "settings")
        return self._page(
            200 if trouble is None else 409, text=text, seen=seen, found=found, trouble=trouble, said=saved
        )

    def _save(self, person: Person, text: str, seen: str, found: Proposal) -> Path:
        changes = {"fields": [change.field for change in found.changes][:50], "file": self._path.name}
        self._acts.write(person, "change the configuration", BEGINS, **changes)
        try:
            if found.for_force and not person.may(Role.FORCE):
                raise Refused(
                    said("this changes which calibration counts: that is for who has the role 'put in force'")
                )
            kept = save(self._path, text, seen)
        except HighsideError as error:
            self._acts.write(person, "change the configuration", str(error), **changes)
            raise
        self._acts.write(person, "change the configuration", DONE, kept=kept.name, **changes)
        return kept

    def _person(self) -> Person | None:
        person = viewer().person
        return person if person is not None and person.may(Role.OPERATE) else None

    def _page(
        self,
        status: int = 200,
        *,
        text: str = "",
        seen: str = "",
        found: Proposal | None = None,
        trouble: str | None = None,
        said: str | None = None,
    ) -> Response:
        page = render(
            "plain/settings.html",
            self._links,
            "/settings",
            name=self._path.name,
            text=text,
            text_max=TEXT_MAX,
            seen=seen,
            found=None if trouble or said else found,
            trouble=trouble,
            trouble_in="en" if found is not None and found.by_check and trouble == found.trouble else "",
            said=said,
            may=status != 403,
        )
        return HTMLResponse(page, status, FORM_HEADERS)
