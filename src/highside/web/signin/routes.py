"""The pages for signing in and out, and what everybody meets who has not.

GET  /sign-in[?next=PATH]     the form
POST /sign-in                 name and password
POST /sign-out
GET  /acts                    the newest acts, for who may operate
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from urllib.parse import quote

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, PlainTextResponse, RedirectResponse

from highside.config.users import Role
from highside.errors import HighsideError
from highside.web.front import of_our_origin
from highside.web.language import own_path
from highside.web.navigation import Link
from highside.web.plain import FORM_HEADERS, HEADERS, form_of, render, serve_plain
from highside.web.signin.acts import Person
from highside.web.signin.people import People
from highside.web.signin.sessions import AGE_MAX_S, COOKIE
from highside.web.words import _
from highside.words.errors import error_told

OPEN_PATHS = frozenset({"/sign-in", "/style.css", "/forms.js", "/here", "/language"})
"""What is answered to whom nobody knows."""


def unless_signed_in(request: Request, person: Person | None) -> Response | None:
    """The answer to who has to sign in first, or whose form comes from elsewhere; None for everybody else."""
    path = request.url.path
    if request.method not in ("GET", "HEAD") and not of_our_origin(request.scope):
        return PlainTextResponse("This form does not come from a page of this server.\n", 403)
    if person is not None or path in OPEN_PATHS:
        return None
    if request.method == "GET" and "text/html" in request.headers.get("accept", ""):
        asked = path + (f"?{request.url.query}" if request.url.query else "")
        return RedirectResponse(f"/sign-in?next={quote(own_path(asked), safe='')}", 303, HEADERS)
    return PlainTextResponse("Sign in first.\n", 401, HEADERS)


class SignInPages:
    """Adds the routes. `secure`: browsers come by https alone."""

    def __init__(self, people: People, links: Sequence[Link], *, secure: bool) -> None:
        self._people = people
        self._links = tuple(links)
        self._secure = secure

    def serve(self, app: FastAPI) -> None:
        """Add the routes to an application."""
        app.get("/sign-in")(self._form)
        app.post("/sign-in")(self._sign_in)
        app.post("/sign-out")(self._sign_out)
        app.get("/acts")(self._acts)
        serve_plain(app)

    async def _form(self, request: Request) -> Response:
        return _page(after=own_path(request.query_params.get("next", "/")))

    async def _sign_in(self, request: Request) -> Response:
        form = form_of(await request.body())
        name, password, wanted = (form.get(field, [""])[0] for field in ("name", "password", "next"))
        try:
            cookie = await self._people.sign_in(name[:200], password, request.scope)
        except HighsideError as error:
            return _page(403, trouble=error_told(error, "refusals"), name=name[:200], after=own_path(wanted))
        answer = RedirectResponse(own_path(wanted), 303, HEADERS)
        answer.set_cookie(
            COOKIE, cookie, max_age=int(AGE_MAX_S), httponly=True, samesite="strict", secure=self._secure, path="/"
        )
        return answer

    async def _sign_out(self, request: Request) -> Response:
        await self._people.sign_out(request.scope)
        answer = RedirectResponse("/sign-in", 303, {**HEADERS, "Clear-Site-Data": '"cache", "storage"'})
        answer.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=self._secure, path="/")
        return answer

    async def _acts(self, request: Request) -> Response:
        person = self._people.who(request.scope)
        if person is None or not person.may(Role.OPERATE):
            said, text = _("That is not for you."), _("The journal of acts is for who may operate.")
            return HTMLResponse(render("plain/trouble.html", self._links, "/acts", said=said, text=text), 403, HEADERS)
        try:
            rows, trouble = await asyncio.to_thread(self._people.acts.last), None
        except HighsideError as error:
            rows, trouble = [], error_told(error, "refusals")
        page = render("plain/acts.html", self._links, "/acts", rows=rows, trouble=trouble)
        return HTMLResponse(page, headers=HEADERS)


def _page(status: int = 200, *, trouble: str | None = None, name: str = "", after: str = "/") -> Response:
    text = render("plain/sign_in.html", (), "", trouble=trouble, name=name, after=after)
    return HTMLResponse(text, status, FORM_HEADERS)
