"""The answer to a request of which nothing is made: too long, too slow, under a name that is not ours.

A program gets one line. A person, whose browser asks for a page, gets one in their language, with the way back to the
page on which they wrote: the script of forms finds there what was written (`forms.js`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from starlette.responses import HTMLResponse, PlainTextResponse, Response

from highside.web.plain import HEADERS, render
from highside.web.signin.people import header_of
from highside.web.words import language_of
from highside.words import in_language, told

WRITTEN = "kept"
"""In the query of a page's address: what was written there is to stand there again."""


def turned_away(scope: Mapping[str, Any], status: int, text: str) -> Response:
    """One sentence (`said`), and the end of the connection."""
    closing = {"Connection": "close"}
    with in_language(language_of(scope)):
        if "text/html" not in (header_of(scope, "accept") or ""):
            return PlainTextResponse(f"{told(text)}\n", status, headers=closing)
        page = render("plain/turned_away.html", (), "/", text=told(text), back=way_back(scope))
    return HTMLResponse(page, status, HEADERS | closing)


def way_back(scope: Mapping[str, Any]) -> str:
    """The page of ours that the request comes from, as its browser names it, with `WRITTEN`; empty where it names none
    of ours."""
    try:
        came = urlsplit(header_of(scope, "referer") or "")
    except ValueError:
        return ""
    host = header_of(scope, "host") or ""
    ours = came.scheme in ("http", "https") and came.netloc.lower() == host.lower() != ""
    # two slashes would begin the name of another host
    if not ours or not came.path.startswith("/") or came.path.startswith("//"):
        return ""
    asked = [one for one in came.query.split("&") if one not in ("", WRITTEN)]
    return f"{came.path}?{'&'.join([*asked, WRITTEN])}"
