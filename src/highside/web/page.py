"""What a browser sees of a session, and what its buttons and keys do.

Each viewer has one task that shows the newest snapshot, waits until the browser says that it has drawn it, and only
then looks again: a slow viewer sees fewer pictures, and nothing waits or piles up for it.
"""

from __future__ import annotations

import itertools
import secrets
import time
from dataclasses import fields
from functools import partial

from nicegui import Client, ui
from nicegui.elements.button import Button
from nicegui.elements.html import Html
from nicegui.events import KeyEventArguments
from pydantic import ValidationError

from highside.bench.session.driver import SessionDriver
from highside.bench.session.labels import LABELS
from highside.bench.session.snapshot import Command, CommandName, PoseState, SessionState, Snapshot
from highside.web.host import CONNECT_WITHIN_S, is_drawn, is_there
from highside.web.parts import PageParts, markup, parts_of

GO = frozenset({CommandName.START, CommandName.ACCEPT, CommandName.RESUME, CommandName.CAPTURE, CommandName.ACTIVATE})
QUESTIONS = {
    CommandName.ABORT: "End the session without a result? What was measured stays in the journal.",
    CommandName.REJECT: "End the session and keep no calibration?",
    CommandName.ACTIVATE: "Put calibration {record} in force for {tool}? A service takes it at its next reload.",
    CommandName.ROLLBACK: "Put the earlier calibration {record} in force again for {tool}?",
}
"""Commands that are asked about once more."""
STOP = frozenset({CommandName.ABORT, CommandName.REJECT, CommandName.ROLLBACK})
OVER = frozenset({SessionState.REVIEW, SessionState.ACCEPTED, SessionState.REJECTED, SessionState.ABORTED})
"""Nothing is measured: the result takes the place of the pose."""
NO_TOKEN = "You are looking on: commands need the token of this session (see the terminal where it was started)."


class Shared:
    """The parts of the newest snapshot, made once for all viewers."""

    def __init__(self) -> None:
        self._seq = -1
        self._parts: PageParts | None = None

    def of(self, snapshot: Snapshot) -> PageParts:
        if self._parts is None or self._seq != snapshot.seq:
            self._seq, self._parts = snapshot.seq, parts_of(snapshot)
        return self._parts


class BenchView:
    """One viewer's page."""

    def __init__(self, driver: SessionDriver, shared: Shared, *, operator: str, commands: bool, rate_hz: float) -> None:
        self._driver = driver
        self._shared = shared
        self._commands = commands
        self._rate_hz = rate_hz
        self._request = (f"web-{secrets.token_hex(4)}-{k}" for k in itertools.count(1))
        self._places: dict[str, Html] = {}
        self._buttons: dict[CommandName, Button] = {}
        self._target: str | None = None
        self._over = False
        self._done: tuple[str, ...] = ()
        self._operator = operator
        self._build()

    # --- what stands where -------------------------------------------------------------------------------------

    def _place(self, name: str, *, tag: str = "div", classes: str = "", props: str = "") -> Html:
        # templates have escaped what is in the parts: nothing of theirs needs the browser's sanitiser
        made = ui.html("", sanitize=False, tag=tag).classes(f"{name} {classes}").props(props)
        self._places[name] = made
        return made

    def _build(self) -> None:
        with ui.element("div").classes("bench") as self._root:
            with ui.element("section").classes("top").props('aria-label="what to do next"'):
                self._place("sign")
                self._place("prompt", tag="h1")
                self._place("spoken", classes="unseen", props='aria-live="polite"')
                self._place("alarms", props='role="alert"')
            with ui.element("section").classes("pose").props('aria-label="where the tool is"'):
                self._place("numbers")
                self._place("bullseye", classes="drawn")
                self._place("dial", classes="drawn")
            with ui.element("section").classes("measure").props('aria-label="measurement"'):
                self._place("hold")
                self._place("still", classes="drawn")
            with ui.element("section").classes("commands").props('aria-label="commands"') as self._given:
                if self._commands:
                    self._build_buttons()
                else:
                    # nothing here that a click or a key could reach
                    ui.html(markup("looking_on", NO_TOKEN), sanitize=False)
            with ui.element("section").classes("end").props('aria-label="result"') as self._end:
                self._place("result")
                with ui.element("p").classes("links"):
                    ui.link("Report: all methods side by side", "/report", new_tab=True)
                    self._certificate = ui.link("Certificate", "/certificate", new_tab=True)
            with ui.element("section").classes("list").props('aria-label="poses" tabindex="0"'):
                self._place("poses")
            with ui.element("section").classes("quality").props('aria-label="calibration so far"'):
                self._place("calibration")
        with ui.element("div").classes("foot-line"):
            self._place("foot")
        if self._commands:
            ui.keyboard(self._on_key, repeating=False, ignore=["input", "select", "textarea"])

    def _build_buttons(self) -> None:
        with ui.element("div").classes("keys"):
            for name, (label, key) in LABELS.items():
                kind = "go" if name in GO else "stop" if name in STOP else "plain"
                shown = "space" if key == " " else key
                button = ui.button(color=None, on_click=partial(self._clicked, name)).classes(f"command {kind}")
                button.props(f'no-caps unelevated no-wrap data-command="{name.value}"')
                with button:
                    ui.html(markup("key", label, shown), sanitize=False, tag="span")
                self._buttons[name] = button
        with ui.element("div").classes("redo-one"):
            self._again = ui.select([], label="Redo one pose").props('dense outlined options-dense data-role="again"')
            self._again.on_value_change(lambda event: self._redo(event.value))
            self._name = ui.input("Operator", value=self._operator).props('dense outlined maxlength="64"')
        self._answer = ui.label("").classes("answer").props('role="status"')
        with ui.dialog().props('aria-label="are you sure?"') as self._dialog, ui.card().classes("ask"):
            self._question = ui.label().classes("question")
            with ui.row():
                ui.button("No, go back", color=None, on_click=lambda: self._dialog.submit(False)).props(
                    "no-caps unelevated autofocus"
                ).classes("command plain")
                ui.button("Yes", color=None, on_click=lambda: self._dialog.submit(True)).props(
                    'no-caps unelevated data-command="yes"'
                ).classes("command stop")

    # --- showing -----------------------------------------------------------------------------------------------

    def show(self, snapshot: Snapshot) -> None:
        """Put what has changed into the page."""
        parts = self._shared.of(snapshot)
        for field in fields(parts):
            place, content = self._places[field.name], getattr(parts, field.name)
            if place.content != content:
                place.set_content(content)
        self._show_commands(snapshot)
        over = snapshot.state in OVER
        if over is not self._over:
            self._over = over
            self._root.classes(add="over" if over else None, remove=None if over else "over")
        self._end.set_visibility(snapshot.result is not None or snapshot.state.ended)
        certified = snapshot.result is not None and snapshot.result.record_id is not None
        self._certificate.set_visibility(certified and self._commands)
        target = None if snapshot.target is None else snapshot.target.pose
        if target != self._target:
            self._target = target
            ui.run_javascript(_SCROLL)

    def _show_commands(self, snapshot: Snapshot) -> None:
        """Those that would not be refused now; where there will be none any more, nothing of them."""
        if not self._commands:
            return
        allowed = set(snapshot.allowed)
        self._given.set_visibility(bool(allowed) or not snapshot.state.ended)
        for name, button in self._buttons.items():
            if button.visible is not (name in allowed):
                button.set_visibility(name in allowed)
        done = tuple(row.pose for row in snapshot.poses if row.state is PoseState.DONE)
        self._again.set_visibility(CommandName.REDO in allowed and bool(done))
        if done != self._done:
            self._done = done
            self._again.set_options(list(done), value=None)

    async def follow(self, client: Client) -> None:
        """Show the session until the viewer is gone or the session is over."""
        if not await is_there(client, time.monotonic() + CONNECT_WITHIN_S):
            if not client.is_deleted:
                # requested and never opened: a program, or a reader who has gone on
                client.delete()
            return
        async for snapshot in self._driver.subscribe(self._rate_hz):
            if not await is_there(client):
                return
            with client:
                self.show(snapshot)
                await is_drawn(client)
        if not client.is_deleted:
            with client:
                self.show(self._driver.snapshot())

    # --- commanding --------------------------------------------------------------------------------------------

    async def _clicked(self, name: CommandName) -> None:
        record = None
        if name in QUESTIONS:
            snapshot = self._driver.snapshot()
            record = snapshot.meant(name)
            self._question.set_text(QUESTIONS[name].format(record=(record or "")[:12], tool=snapshot.tool))
            if not await self._dialog:
                return
        await self.send(name, confirm=record)

    async def _redo(self, pose: str | None) -> None:
        if pose is not None:
            self._again.set_value(None)
            await self.send(CommandName.REDO, pose)

    async def _on_key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown or event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta:
            return
        for name, (_, key) in LABELS.items():
            if event.key.name == key and self._buttons[name].visible and not self._dialog.value:
                await self._clicked(name)
                return

    async def send(self, name: CommandName, pose: str | None = None, *, confirm: str | None = None) -> None:
        """Give a command in the operator's name and show the answer; `confirm`: the record that was asked about."""
        if not self._commands:
            self._answer.set_text(NO_TOKEN)
            return
        try:
            command = Command(
                name=name,
                request_id=next(self._request),
                operator=(self._name.value or "").strip(),
                pose=pose,
                confirm=confirm,
            )
        except ValidationError:
            self._answer.set_text("Say who you are: the field Operator is empty.")
            return
        reply = await self._driver.command(command)
        label = LABELS[name][0]
        self._answer.set_text(f"{label}: {reply.text}")


_SCROLL = """
const list = document.querySelector('section.list'), row = list && list.querySelector('tr.here');
if (row) list.scrollTop = row.offsetTop - list.clientHeight / 2;
"""
