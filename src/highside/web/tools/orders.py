"""Commands to a tool's service, through the broker: for who may operate.

    GET, POST  /command/TOOL     the watch's alarm acknowledged, the watch begun anew, the azimuth aligned

A command is what any client may publish on `watch/command` and `drift/command`; the page's account at the broker needs
that right. The service's answer is waited for and shown; none within `ANSWER_WITHIN_S` is said too.
"""

from __future__ import annotations

import asyncio
import secrets
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import ValidationError

from highside.config.mistakes import input_error
from highside.config.users import Role
from highside.errors import HighsideError, InputError, Refused
from highside.service.messages import DriftCommand
from highside.service.watch_messages import WatchCommand
from highside.web.navigation import Link
from highside.web.plain import FORM_HEADERS, form_of, render
from highside.web.signin.acts import BEGINS, DONE, Acts
from highside.web.tools.listener import Listener
from highside.web.tools.state import Tools
from highside.web.viewer import viewer
from highside.web.words import _, said, told
from highside.words.errors import error_told

ANSWER_WITHIN_S = 5.0
"""A service answers within milliseconds; one behind a satellite within two seconds."""

ORDERS: dict[str, tuple[str, str]] = {
    "acknowledge": ("watch", "acknowledge the departure"),
    "restart": ("watch", "begin the watch anew"),
    "align": ("drift", "align the azimuth"),
}
"""command: its part of the service, and what the journal calls it"""


class OrderPages:
    """Adds the routes."""

    def __init__(self, tools: Tools, listener: Listener, acts: Acts, links: tuple[Link, ...]) -> None:
        self._tools, self._listener, self._acts, self._links = tools, listener, acts, links

    def serve(self, app: FastAPI) -> None:
        """Add the routes."""
        app.get("/command/{tool}")(self._show)
        app.post("/command/{tool}")(self._do)

    async def _show(self, tool: str) -> Response:
        return self._page(tool)

    async def _do(self, tool: str, request: Request) -> Response:
        person = viewer().person
        form = {name: values[0] for name, values in form_of(await request.body()).items()}
        word = form.get("command", "")
        if person is None or not person.may(Role.OPERATE) or tool not in self._tools.tools or word not in ORDERS:
            return self._page(tool)
        part, act = ORDERS[word]
        try:
            command = _command(word, form)
            facts = {"tool": tool} | command.model_dump(exclude={"id", "command"}, exclude_none=True)
            await asyncio.to_thread(self._acts.write, person, act, BEGINS, **facts)
            trouble = await self._sent(tool, part, command)
            await asyncio.to_thread(self._acts.write, person, act, trouble or DONE, **facts)
        except HighsideError as error:
            return self._page(tool, trouble=error_told(error, "settings"), status=409)
        if trouble is not None:
            return self._page(tool, trouble=told(trouble, "refusals"), status=409)
        return self._page(tool, said=_("Done: %s.") % _(act))

    async def _sent(self, tool: str, part: str, command: WatchCommand | DriftCommand) -> str | None:
        """Why it was not done; None: it was."""
        try:
            reply = await self._listener.ask(
                f"{tool}/{part}", command.model_dump_json(exclude_none=True).encode(), command.id, ANSWER_WITHIN_S
            )
        except Refused as error:
            return str(error)
        return None if reply.get("ok") is True else str(reply.get("error") or "refused")[:400]

    def _page(self, tool: str, *, trouble: str | None = None, said: str | None = None, status: int = 200) -> Response:
        person = viewer().person
        if person is None or not person.may(Role.OPERATE):
            status, trouble = 403, _("Commands are for who may operate.")
        elif tool not in self._tools.tools:
            status, trouble = 404, _("No tool of that name has been heard at this broker.")
        page = render(
            "plain/command.html", self._links, "/", tool=tool, trouble=trouble, said=said, may=status in (200, 409)
        )
        return HTMLResponse(page, status, FORM_HEADERS)


def _command(word: str, form: dict[str, str]) -> WatchCommand | DriftCommand:
    """Raises InputError for a number that is none, or beyond what is allowed."""
    made: dict[str, Any] = {"id": f"page-{secrets.token_hex(8)}", "command": word}
    if word != "align":
        return WatchCommand.model_validate(made)
    for name in ("azimuth_deg", "std_deg"):
        given = form.get(name, "").strip().replace(",", ".")
        if given:
            try:
                made[name] = float(given)
            except ValueError:
                what = said("is not a number: %(given)s", given=repr(given[:40]))
                raise InputError(what, field=name, remedy=said("write it as 123.4")) from None
    try:
        return DriftCommand.model_validate(made)
    except ValidationError as error:
        raise input_error(error, "", {}, DriftCommand) from None
