"""What plain pages have in common: style, headers, the script of their forms and the template of the frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import parse_qs

from fastapi import FastAPI, Response
from fastapi.responses import JSONResponse

from highside.web.navigation import Link
from highside.web.viewer import viewer
from highside.web.words import LANGUAGES
from highside.words.worded import worded

FIELDS_MAX = 80
"""Of a form: a certificate has some fifty."""
_FOLDER = Path(__file__).parent
STYLE = "".join((_FOLDER / name).read_text(encoding="utf-8") for name in ("tools/tools.css", "plain.css"))
_POLICY = (
    "default-src 'none'; style-src 'self'; img-src 'self' data:; form-action 'self'; frame-ancestors 'none';"
    " base-uri 'none'"
)
_SCRIPT = (_FOLDER / "forms.js").read_text(encoding="utf-8")
HEADERS = {
    "Content-Security-Policy": _POLICY,
    "Cache-Control": "no-store",
    # a form of ours names our origin; without a referrer a browser names none
    "Referrer-Policy": "same-origin",
}
FORM_HEADERS = {**HEADERS, "Content-Security-Policy": f"{_POLICY}; script-src 'self'; connect-src 'self'"}
"""Of a page with a form: its script asks whether the server is there before anything is sent."""


def render(template: str, links: Sequence[Link], here: str, **values: object) -> str:
    """A page for the present viewer; `here`: the address in the navigation that it belongs to."""
    found = worded().get_template(template)
    return found.render(links=links, here=here, viewer=viewer(), who=_who(), languages=LANGUAGES, **values)


def form_of(body: bytes) -> dict[str, list[str]]:
    """The fields of a form; none for more than any form of ours has."""
    try:
        return parse_qs(body.decode("utf-8", "replace"), max_num_fields=FIELDS_MAX)
    except ValueError:
        return {}


def navigation_line(links: Sequence[Link], here: str = "") -> str:
    """What leads to the other pages; `here`: the address of the one where it stands."""
    return worded().get_template("plain/navigation.html").render(links=links, here=here)


def person_line(tool: str | None = None) -> str:
    """Who is signed in, and how to sign out; nothing where nobody is. `tool`: whose page it is."""
    return worded().get_template("plain/person.html").render(viewer=viewer(), live_tool=tool)


def serve_plain(app: FastAPI) -> None:
    """Add what all plain pages load."""

    @app.get("/style.css")
    async def style() -> Response:
        return Response(STYLE, media_type="text/css", headers={"Cache-Control": "max-age=3600"})

    @app.get("/forms.js")
    async def script() -> Response:
        return Response(_SCRIPT, media_type="text/javascript", headers={"Cache-Control": "max-age=3600"})

    @app.get("/here")
    async def here() -> Response:
        return JSONResponse({"who": _who()}, headers=HEADERS)


def _who() -> str:
    """Whom a page was made for; nobody: who has not signed in, nor shown the token."""
    person = viewer().person
    return "" if person is None else f"{person.via} {person.name}"
