"""What pages without a script have in common: style, headers and template of the frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import parse_qs

from fastapi import Response

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
HEADERS = {
    "Content-Security-Policy": _POLICY,
    "Cache-Control": "no-store",
    # a form of ours names our origin; without a referrer a browser names none
    "Referrer-Policy": "same-origin",
}


def render(template: str, links: Sequence[Link], here: str, **values: object) -> str:
    """A page for the present viewer; `here`: the address in the navigation that it belongs to."""
    found = worded().get_template(template)
    return found.render(links=links, here=here, viewer=viewer(), languages=LANGUAGES, **values)


def form_of(body: bytes) -> dict[str, list[str]]:
    """The fields of a form; none for more than any form of ours has."""
    try:
        return parse_qs(body.decode("utf-8", "replace"), max_num_fields=FIELDS_MAX)
    except ValueError:
        return {}


def person_line(tool: str | None = None) -> str:
    """Who is signed in, and how to sign out; nothing where nobody is. `tool`: whose page it is."""
    return worded().get_template("plain/person.html").render(viewer=viewer(), live_tool=tool)


async def style() -> Response:
    """Answers with the style of plain pages."""
    return Response(STYLE, media_type="text/css", headers={"Cache-Control": "max-age=3600"})
