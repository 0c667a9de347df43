"""The switch between languages, on every page.

POST /language     the language of the pages from now on, in this browser
"""

from __future__ import annotations

import re

from fastapi import FastAPI, Request, Response
from fastapi.responses import RedirectResponse

from highside.web.front import of_our_origin
from highside.web.plain import HEADERS, form_of
from highside.web.turned_away import turned_away
from highside.web.viewer import viewer
from highside.web.words import COOKIE, COOKIE_MAX_AGE_S, LANGUAGES, said
from highside.words.worded import worded

_NEXT = re.compile(r"/(?![/\\])[A-Za-z0-9_.~%/?=&-]{0,300}")


class LanguageSwitch:
    """Adds the route. `secure`: browsers come by https alone."""

    def __init__(self, *, secure: bool) -> None:
        self._secure = secure

    def serve(self, app: FastAPI) -> None:
        """Add the route to an application."""
        app.post("/language")(self._change)

    async def _change(self, request: Request) -> Response:
        if not of_our_origin(request.scope):
            return turned_away(request.scope, 403, said("This form does not come from a page of this server."))
        form = form_of(await request.body())
        code, after = (form.get(name, [""])[0] for name in ("code", "next"))
        answer = RedirectResponse(own_path(after), 303, HEADERS)
        if code in LANGUAGES:
            answer.set_cookie(
                COOKIE, code, max_age=COOKIE_MAX_AGE_S, httponly=True, samesite="strict", secure=self._secure
            )
        return answer


def language_line(after: str) -> str:
    """The switch as HTML, which leads back to a path."""
    return worded().get_template("plain/languages.html").render(viewer=viewer(), languages=LANGUAGES, here=after)


def own_path(path: str) -> str:
    """A path of this server, or the start page."""
    return path if _NEXT.fullmatch(path) else "/"
