"""The pages in a browser: each viewer has one task, which shows what has changed and waits until that is drawn.

A slow viewer sees fewer pictures; nothing waits or piles up for it. What is shown is made once for all viewers.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import fields
from typing import TYPE_CHECKING
from urllib.parse import quote

from markupsafe import Markup
from nicegui import Client, ui

from highside.config.mqtt import MqttSettings
from highside.web.flat import FlatView
from highside.web.host import CONNECT_WITHIN_S, is_drawn, is_there
from highside.web.language import language_line
from highside.web.navigation import Link
from highside.web.plain import navigation_line, person_line
from highside.web.space import PAPER, draw_pipe, orientation
from highside.web.tools.drawings import trend
from highside.web.tools.state import History, Tools, ToolState
from highside.web.tools.views import Broker, ToolPage, list_page, tool_page
from highside.web.tools.watch_chart import watch_chart
from highside.web.viewer import labelled, viewer
from highside.web.words import _

if TYPE_CHECKING:
    from nicegui.elements.echart import EChart
    from nicegui.elements.html import Html

    from highside.web.tools.listener import Listener

TREND_EVERY_S = 2.0
"""A picture of the trend has some 30 KB: not with each attitude."""


class Shown:
    """What the pages show at present, made anew when something was heard, or when a second has passed."""

    def __init__(self, tools: Tools, listener: Listener, settings: MqttSettings, links: tuple[Link, ...] = ()) -> None:
        self.tools = tools
        self.links = links
        """to the other pages"""
        self._listener = listener
        self._where = f"{settings.host}:{settings.port}"
        self._lists: dict[str, tuple[object, str]] = {}
        self._pages: dict[tuple[str, str], tuple[object, ToolPage]] = {}

    def broker(self, now: float) -> Broker:
        """How this page stands with the broker."""
        listener = self._listener
        return Broker(self._where, listener.connected, listener.reason, now - listener.since_mono)

    def list(self, now: float) -> str:
        """The start page."""
        broker = self.broker(now)
        heard = sum(tool.version for tool in self.tools.tools.values())
        key = (int(now), broker.connected, broker.reason, len(self.tools.tools), heard)
        language = viewer().language
        known = self._lists.get(language)
        if known is None or known[0] != key:
            known = self._lists[language] = (key, list_page(self.tools, broker, now))
        return known[1]

    def page(self, tool: ToolState, now: float) -> ToolPage:
        """A tool's page."""
        broker = self.broker(now)
        key = (tool.version, int(now), tool.condition(now), broker.connected, broker.reason)
        known = self._pages.get((tool.tool, viewer().language))
        if known is None or known[0] != key:
            known = self._pages[tool.tool, viewer().language] = (key, tool_page(tool, broker, now))
        return known[1]


class ListView:
    """One viewer's start page."""

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        with ui.element("div").classes("tools-page"):
            ui.html(navigation_line(shown.links, "/") + person_line(), sanitize=False)
            # made by templates that escape: nothing of it needs the browser's sanitiser
            self._place = ui.html("", sanitize=False)
            ui.html(language_line("/"), sanitize=False)
        self.show()

    def show(self) -> bool:
        """Put what has changed into the page; whether anything had."""
        content = self._shown.list(time.monotonic())
        if self._place.content == content:
            return False
        self._place.set_content(content)
        return True


class ToolView:
    """One viewer's page of a tool."""

    def __init__(self, shown: Shown, tool: ToolState) -> None:
        self._shown, self._tool = shown, tool
        self._places: dict[str, Html] = {}
        self._turned: tuple[float, float, float] | None = None
        self._trend_at = -1e9
        self._history: History | None = None
        self._watch_chart: EChart | None = None
        ui.html(navigation_line(shown.links) + person_line(tool.tool), sanitize=False)
        with ui.element("div").classes("tool-page"):
            self._section("head", _("what is going on"))
            self._section("figures", _("inclination and toolface"))
            with ui.element("section").classes("space").props(labelled(_("the tool in space"))):
                self._build_scene()
            self._section("dial", _("toolface"))
            self._section("state", _("readings"), title=_("Readings"), scrolls=True)
            with ui.element("section").classes("trend").props(labelled(_("the last ten minutes"))):
                ui.html(_heading(_("The last ten minutes")), sanitize=False)
                self._chart = ui.echart(trend((), 0.0)).classes("chart")
            self._section("parts", _("parts"), title=_("Parts"), scrolls=True)
            self._section("surveys", _("surveys"), title=_("Surveys"), scrolls=True)
            self._build_watch()
            self._section("events", _("log"), title=_("Log"), scrolls=True)
        ui.html(language_line(f"/tool/{quote(tool.tool, safe='')}"), sanitize=False)
        self.show()

    def _section(self, name: str, label: str, *, title: str = "", scrolls: bool = False) -> None:
        reached = ' tabindex="0"' if scrolls else ""
        with ui.element("section").classes(name).props(f"{labelled(label)}{reached}"):
            if title:
                ui.html(_heading(title), sanitize=False)
            self._places[name] = ui.html("", sanitize=False).classes("drawn" if name == "dial" else "")

    def _build_watch(self) -> None:
        """The calibration over the last day; the picture comes with the first history that holds something."""
        with ui.element("section").classes("watch").props(labelled(_("the calibration")) + ' tabindex="0"'):
            ui.html(_heading(_("The calibration over the last day")), sanitize=False)
            self._places["watch"] = ui.html("", sanitize=False)
            self._watched = ui.element("div")

    def _draw_watch(self) -> bool:
        history = self._tool.history
        if history is None or history is self._history:
            return False
        self._history = history
        if not history.hours:
            # four empty frames say less than the sentence above them
            shown = self._watch_chart is not None
            self._watched.clear()
            self._watch_chart = None
            return shown
        options = watch_chart(history)
        if self._watch_chart is None:
            with self._watched:
                self._watch_chart = ui.echart(options).classes("chart tall")
            return True
        self._watch_chart.options.clear()
        self._watch_chart.options.update(options)
        self._watch_chart.update()
        return True

    def _build_scene(self) -> None:
        """A pipe with its scribe line, the hole ahead below it, over the compass, seen from the high side of a hole to
        the north; without an azimuth it is drawn as if to the north."""
        self._scene = ui.scene(width=360, height=300, grid=(8, 8), background_color=PAPER, click_events=[])
        self._scene.classes("scene")
        self._flat = FlatView(self._scene)
        with self._scene as scene:
            scene.move_camera(x=3.2, y=4.0, z=3.2, look_at_z=1.3, duration=0.0)
            scene.text("N", "color:#46525d").move(0.0, 3.2, 0.0)
            scene.text(_("E"), "color:#46525d").move(3.2, 0.0, 0.0)
            self._body = draw_pipe(scene).move(0.0, 0.0, 2.0)

    def show(self) -> bool:
        """Put what has changed into the page; whether anything had."""
        now = time.monotonic()
        page, changed = self._shown.page(self._tool, now), False
        for field in fields(page):
            place, content = self._places[field.name], getattr(page, field.name)
            if place.content != content:
                place.set_content(content)
                changed = True
        turned, drawn, watched = self._turn(), self._draw_trend(now), self._draw_watch()
        return changed or turned or drawn or watched

    def _turn(self) -> bool:
        reading = self._tool.reading
        if reading is None or reading.inc_deg is None:
            return False
        angles = (reading.inc_deg, reading.tf_deg or 0.0, reading.azi_deg or 0.0)
        if angles == self._turned:
            return False
        self._turned = angles
        self._body.rotate_R(orientation(*angles))
        self._flat.show(angles[:2])
        return True

    def _draw_trend(self, now: float) -> bool:
        if now - self._trend_at < TREND_EVERY_S or not self._tool.trend:
            return False
        self._trend_at = now
        self._chart.options.clear()
        self._chart.options.update(trend(list(self._tool.trend), now))
        self._chart.update()
        return True


def _heading(text: str) -> str:
    return str(Markup("<h2>{}</h2>").format(text))


async def follow(view: ListView | ToolView, client: Client, rate_hz: float) -> None:
    """Show what is new until the viewer is gone."""
    if not await is_there(client, time.monotonic() + CONNECT_WITHIN_S):
        if not client.is_deleted:
            # requested and never opened: a program, or a reader who has gone on
            client.delete()
        return
    while await is_there(client):
        with client:
            if view.show():
                await is_drawn(client)
        await asyncio.sleep(1.0 / rate_hz)
