"""Serves the tools' pages, in a process that acquires nothing.

    GET  /                every tool at the broker
    GET  /tool/ID         one tool, live
    GET  /api/tools       the same as the start page (JSON), for programs

and the pages of what is kept (`web.records.routes`), where [records] names it, and of a diagnosis
(`web.diagnosis.routes`), where [diagnosis] enables it.

Without a file of users no tool can be commanded here, and whoever reaches the address may look: it listens on this
machine alone unless `[web] host` says otherwise. With one, everybody signs in, and who may operate commands (`orders`).
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from fastapi import Request, Response
from fastapi.responses import JSONResponse
from nicegui import background_tasks, ui

from highside.config.certificate import load_certificate_fields
from highside.config.serve import ServeFile
from highside.service.tasks import ended
from highside.web.benches.routes import BenchPages
from highside.web.diagnosis.routes import DiagnosisPages
from highside.web.front import BODY_WITHIN_S
from highside.web.host import PageHost, notice
from highside.web.navigation import Link
from highside.web.plain import serve_plain
from highside.web.records.certificates import BODY_MAX as CERTIFICATE_BODY_MAX
from highside.web.records.routes import RecordPages
from highside.web.settings.routes import BODY_MAX as SETTINGS_BODY_MAX
from highside.web.settings.routes import BODY_WITHIN_S as SETTINGS_BODY_WITHIN_S
from highside.web.settings.routes import SettingsPages
from highside.web.space import REDRAWN
from highside.web.tools.listener import Listener
from highside.web.tools.orders import OrderPages
from highside.web.tools.pages import ListView, Shown, ToolView, follow
from highside.web.tools.state import Tools, ToolState
from highside.web.words import _

_STYLE = (Path(__file__).parent / "tools.css").read_text(encoding="utf-8")
_SCRIPT = (Path(__file__).parent / "tools.js").read_text(encoding="utf-8")
_KEPT = '<script src="/tools.js"></script>'
"""What keeps a reader's place where what is shown is replaced."""
_TOOL = "/tool/"


def links(settings: ServeFile) -> tuple[Link, ...]:
    """The navigation; empty where there are no pages but those of tools."""
    records = settings.records
    found = [Link("/calibrations", "Calibrations")] if records.store is not None else []
    found += [Link("/sessions", "Bench sessions")] if records.sessions is not None else []
    found += [Link("/diagnosis", "Diagnosis")] if settings.diagnosis.enabled else []
    found += [Link("/bench", "Bench")] if settings.bench.folder is not None else []
    found += [Link("/settings", "Configuration")] if settings.settings is not None else []
    return (Link("/", "Tools"), *found) if found else ()


class ToolsPage:
    """The pages of all tools at a broker. One in a process, as its host. `start` it, `stop` it."""

    def __init__(self, settings: ServeFile) -> None:
        self._settings = settings
        self._tools = Tools(settings.mqtt.prefix)
        self._listener = Listener(settings.mqtt, self._tools)
        self._links = links(settings)
        self._shown = Shown(self._tools, self._listener, settings.mqtt, self._links)
        # made when it is started: it has a folder of its own
        self._diagnosis: DiagnosisPages | None = None
        self._host = PageHost(
            settings.web, is_page=_is_page, instead=self._unknown, allowed=self._allowed, links=self._links
        )
        self._listening: asyncio.Task[None] | None = None

    @property
    def address(self) -> str:
        """Where the start page is."""
        return self._host.address

    async def start(self) -> None:
        """Listen to the broker and serve. Raises InputError where the address cannot be had, or [web.tls] not be
        used; a broker that is away is no error, the page says so."""
        self._host.app.get("/api/tools")(self._api)
        self._host.app.get("/tools.js")(_script)
        self._add_plain_pages()
        ui.page("/", title="highside", language="en-US", dark=None)(self._list)
        ui.page("/tool/{tool}", title="highside", language="en-US", dark=None)(self._tool)
        await self._host.start()
        self._listening = asyncio.create_task(self._listener.run())

    async def stop(self) -> None:
        """Say good-bye to the viewers and the broker."""
        if self._listening is not None:
            await ended(self._listening)
        await self._host.stop()
        if self._diagnosis is not None:
            await self._diagnosis.close()

    @property
    def link(self) -> str:
        """The start page with the right to send files."""
        return self._host.link

    def _add_plain_pages(self) -> None:
        """What is kept, and a diagnosis, as far as they are configured."""
        app = self._host.app
        if self._links and self._host.people is None:
            # with people it is the style of their pages, too
            serve_plain(app)
        named = self._settings.web.certificate
        fields = None if named is None else load_certificate_fields(named)
        RecordPages(self._settings.records, self._links, self._host.people, fields).serve(app)
        if self._host.people is not None:
            if self._settings.settings is not None:
                SettingsPages(self._settings.settings, self._host.people.acts, self._links).serve(app)
            OrderPages(self._tools, self._listener, self._host.people.acts, self._links).serve(app)
        bench = self._settings.bench
        if bench.folder is not None:
            BenchPages(bench.folder, bench.state, self._links, self._host).serve()
        if self._settings.diagnosis.enabled:
            self._diagnosis = DiagnosisPages(self._settings.diagnosis, self._links)
            self._diagnosis.serve(self._host)

    def _allowed(self, request: Request) -> tuple[int, float] | None:
        if request.url.path.endswith("/certificate") and self._host.may_command(request):
            return CERTIFICATE_BODY_MAX, BODY_WITHIN_S
        if request.url.path == "/settings" and self._settings.settings is not None and self._host.may_command(request):
            return SETTINGS_BODY_MAX, SETTINGS_BODY_WITHIN_S
        return None if self._diagnosis is None else self._diagnosis.allowed(request)

    def _unknown(self, request: Request) -> Response | None:
        path = request.url.path
        if path.startswith(_TOOL) and self._of(path) is None:
            return notice(_("Not found"), _("No tool of that name has been heard at this broker."), 404)
        return None

    def _of(self, path: str) -> ToolState | None:
        return self._tools.tools.get(unquote(path.removeprefix(_TOOL)))

    async def _list(self, request: Request) -> None:
        client, _commands = self._host.admit(request)
        ui.add_css(_STYLE)
        ui.add_head_html(_KEPT)
        view = ListView(self._shown)
        background_tasks.create(follow(view, client, self._settings.web.rate_hz), name=f"viewer {client.id}")

    async def _tool(self, request: Request, tool: str) -> None:
        client, _commands = self._host.admit(request)
        ui.add_css(_STYLE)
        ui.add_head_html(REDRAWN)
        ui.add_head_html(_KEPT)
        ui.page_title(tool)
        view = ToolView(self._shown, self._tools.tools[tool])
        background_tasks.create(follow(view, client, self._settings.web.rate_hz), name=f"viewer {client.id}")

    async def _api(self) -> Response:
        now = time.monotonic()
        return JSONResponse(
            {
                "broker": {"connected": self._listener.connected, "reason": self._listener.reason},
                "tools": [_summary(tool, now) for tool in self._tools.in_order(now)],
            }
        )


async def _script() -> Response:
    return Response(_SCRIPT, media_type="text/javascript", headers={"Cache-Control": "no-cache"})


def _is_page(path: str) -> bool:
    return path == "/" or path.startswith(_TOOL)


def _summary(tool: ToolState, now: float) -> dict[str, Any]:
    reading = tool.reading
    return {
        "tool": tool.tool,
        "condition": tool.condition(now),
        "age_s": tool.age_s(now),
        "inc_deg": None if reading is None else reading.inc_deg,
        "motor_toolface_deg": None if reading is None else reading.motor_toolface_deg,
        "alarms": list(tool.alarms),
    }
