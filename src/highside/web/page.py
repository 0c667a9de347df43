"""What a browser sees of a session, and what its buttons and keys do.

Each viewer has one task that shows the newest snapshot, waits until the browser says that it has drawn it, and only
then looks again: a slow viewer sees fewer pictures, and nothing waits or piles up for it.
"""

from __future__ import annotations

import asyncio
import itertools
import secrets
import time
from collections.abc import Awaitable, Callable
from dataclasses import fields
from functools import partial, wraps
from typing import Any

from nicegui import Client, ui
from nicegui.elements.button import Button
from nicegui.elements.html import Html
from nicegui.events import KeyEventArguments
from pydantic import ValidationError

from highside.bench.session.driver import Kept, SessionDriver
from highside.bench.session.force import NOTHING
from highside.bench.session.labels import LABELS
from highside.bench.session.snapshot import Command, CommandName, PoseState, SessionState, Snapshot
from highside.config.users import Role
from highside.web.bench_scene import BenchScene, Seen, seen
from highside.web.beside import build_beside
from highside.web.cues import cue
from highside.web.host import CONNECT_WITHIN_S, is_drawn, is_there
from highside.web.parts import PageParts, markup, parts_of
from highside.web.signin.acts import Person
from highside.web.viewer import in_language, labelled, viewer
from highside.web.words import _, said_later, told

GO = frozenset({CommandName.START, CommandName.ACCEPT, CommandName.RESUME, CommandName.CAPTURE, CommandName.ACTIVATE})
QUESTIONS = {
    CommandName.ABORT: said_later("End the session without a result? What was measured stays in the journal."),
    CommandName.REJECT: said_later("End the session and keep no calibration?"),
    CommandName.ACTIVATE: said_later(
        "Put calibration %(record)s in force for %(tool)s? A service takes it at its next reload."
    ),
    CommandName.ROLLBACK: said_later("Put the earlier calibration %(record)s in force again for %(tool)s?"),
}
"""Commands that are asked about once more."""
TO_NOTHING = said_later(
    "Take the calibration back out of force for %(tool)s? There was none before: the tool's readings pass uncorrected."
)
"""Asked in place of the roll back's question where there is no earlier calibration."""
STOP = frozenset({CommandName.ABORT, CommandName.REJECT, CommandName.ROLLBACK})
BEAT_S = 1.0
"""A page is spoken to as often, changed or not: one that hears nothing for three times that says so (`bench.js`)."""
OVER = frozenset({SessionState.REVIEW, SessionState.ACCEPTED, SessionState.REJECTED, SessionState.ABORTED})
"""Nothing is measured: the result takes the place of the pose."""
FORCING = frozenset({CommandName.ACTIVATE, CommandName.ROLLBACK})
"""what changes the calibration that is in force for a tool, and so its readings"""
NOT_YOURS = said_later("that is for who has signed in with the role for it ('put in force' changes what a tool reads).")
NO_TOKEN = said_later(
    "You are looking on: commands need the token of this session (see the terminal where it was started)."
)


class Shared:
    """The parts of the newest snapshot, made once for all viewers of a language."""

    def __init__(self) -> None:
        self._seq = -1
        self._parts: dict[str, PageParts] = {}
        self._seen = (-1, Seen(None, None))

    def of(self, snapshot: Snapshot) -> PageParts:
        if self._seq != snapshot.seq:
            self._seq = snapshot.seq
            self._parts.clear()
        language = viewer().language
        if language not in self._parts:
            self._parts[language] = parts_of(snapshot)
        return self._parts[language]

    def seen(self, snapshot: Snapshot) -> Seen:
        """What the picture of the tool shows."""
        if self._seen[0] != snapshot.seq:
            self._seen = (snapshot.seq, seen(snapshot))
        return self._seen[1]


def _own_language(do: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    """What a viewer's click or key does, in the language of the page that it came from."""

    @wraps(do)
    async def done(view: BenchView, *args: Any, **kwargs: Any) -> Any:
        with in_language(view._language):
            return await do(view, *args, **kwargs)

    return done


class BenchView:
    """One viewer's page."""

    def __init__(
        self,
        driver: SessionDriver,
        shared: Shared,
        *,
        operator: str,
        commands: bool,
        rate_hz: float,
        link_elsewhere: str | None = None,
        home: str | None = None,
        who: Callable[[], Person | None],
    ) -> None:
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
        self._before: Snapshot | None = None
        self._link_elsewhere, self._home = link_elsewhere, home
        self._who = who
        self._language = viewer().language
        # who has signed in acts in their own name; another is who held the token
        self._signed_in = (person.name if (person := who()) is not None else "") or None
        self._operator = self._signed_in or operator
        self._build()

    # --- what stands where -------------------------------------------------------------------------------------

    def _place(self, name: str, *, tag: str = "div", classes: str = "", props: str = "") -> Html:
        # templates have escaped what is in the parts: nothing of theirs needs the browser's sanitiser
        made = ui.html("", sanitize=False, tag=tag).classes(f"{name} {classes}").props(props)
        self._places[name] = made
        return made

    def _build(self) -> None:
        ui.html(markup("lost"), sanitize=False)
        with ui.element("div").classes("bench") as self._root:
            with ui.element("section").classes("top").props(labelled(_("what to do next"))):
                self._place("sign")
                self._place("prompt", tag="h1")
                self._place("spoken", classes="unseen", props='aria-live="polite"')
                self._place("alarms", props='role="alert"')
            with ui.element("section").classes("pose").props(labelled(_("where the tool is"))):
                self._place("numbers")
                with ui.element("div").classes("drawn space") as self._space:
                    self._scene = BenchScene()
                    self._place("guidance")
                self._place("bullseye", classes="drawn")
                self._place("dial", classes="drawn")
            with ui.element("section").classes("measure").props(labelled(_("measurement"))):
                self._place("hold")
                self._place("still", classes="drawn")
            with ui.element("section").classes("commands").props(labelled(_("commands"))) as self._given:
                if self._commands:
                    self._build_buttons()
                else:
                    # nothing here that a click or a key could reach
                    ui.html(markup("looking_on", _(NO_TOKEN)), sanitize=False)
            with ui.element("section").classes("end").props(labelled(_("result"))) as self._end:
                self._place("result")
                with ui.element("p").classes("links"):
                    ui.link(_("Report: all methods side by side"), "/report", new_tab=True)
                    self._certificate = ui.link(_("Certificate"), "/certificate", new_tab=True)
            with ui.element("section").classes("list").props(labelled(_("poses")) + ' tabindex="0"'):
                self._place("poses")
            with ui.element("section").classes("quality").props(labelled(_("calibration so far"))):
                self._place("calibration")
        with ui.element("div").classes("foot-line"):
            self._place("foot")
            with ui.element("div").classes("beside"):
                self._beside = build_beside(
                    link_elsewhere=self._link_elsewhere,
                    commands=self._commands,
                    note=self._note,
                    operator=self._name_of_operator,
                    home=self._home,
                )
        if self._commands:
            ui.keyboard(self._on_key, repeating=False, ignore=["input", "select", "textarea"])

    def _build_buttons(self) -> None:
        with ui.element("div").classes("keys"):
            for name, (label, key) in LABELS.items():
                kind = "go" if name in GO else "stop" if name in STOP else "plain"
                shown = _("space") if key == " " else key
                button = ui.button(color=None, on_click=partial(self._clicked, name)).classes(f"command {kind}")
                button.props(f'no-caps unelevated no-wrap data-command="{name.value}"')
                with button:
                    ui.html(markup("key", _(label), shown), sanitize=False, tag="span")
                self._buttons[name] = button
        with ui.element("div").classes("redo-one"):
            self._again = ui.select([], label=_("Redo one pose")).props(
                'dense outlined options-dense data-role="again"'
            )
            self._again.on_value_change(lambda event: self._redo(event.value))
            self._name = ui.input(_("Operator"), value=self._operator).props('dense outlined maxlength="64"')
            if self._signed_in:
                self._name.props("readonly")
        self._answer = ui.label("").classes("answer").props('role="status"')
        with ui.dialog().props(labelled(_("are you sure?"))) as self._dialog, ui.card().classes("ask"):
            self._question = ui.label().classes("question")
            with ui.row():
                ui.button(_("No, go back"), color=None, on_click=lambda: self._dialog.submit(False)).props(
                    "no-caps unelevated autofocus"
                ).classes("command plain")
                ui.button(_("Yes"), color=None, on_click=lambda: self._dialog.submit(True)).props(
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
        self._show_space(snapshot)
        over = snapshot.state in OVER
        if over is not self._over:
            self._over = over
            self._root.classes(add="over" if over else None, remove=None if over else "over")
            # what was not to be seen has no size until it is told that it has one
            ui.run_javascript("setTimeout(() => window.dispatchEvent(new Event('resize')), 50)")
        self._end.set_visibility(snapshot.result is not None or snapshot.state.ended)
        certified = snapshot.result is not None and snapshot.result.record_id is not None
        self._certificate.set_visibility(certified and self._commands)
        target = None if snapshot.target is None else snapshot.target.pose
        if target != self._target:
            self._target = target
            ui.run_javascript(_SCROLL)

    def _show_space(self, snapshot: Snapshot) -> None:
        """The tool in space, in grey while nobody knows where it is; and what is to be heard."""
        self._scene.show(self._shared.seen(snapshot))
        stale = snapshot.attitude is None
        self._space.classes(add="stale" if stale else None, remove=None if stale else "stale")
        if self._before is not None and (heard := cue(self._before, snapshot)) is not None:
            ui.run_javascript(f"window.highside?.cue({heard.value!r})")
        self._before = snapshot

    def _show_commands(self, snapshot: Snapshot) -> None:
        """Those that would not be refused now; where there will be none any more, nothing of them."""
        if not self._commands:
            return
        allowed = {name for name in snapshot.allowed if self._may(name)}
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
        with client:
            ui.run_javascript("window.highside?.show()")
        shown, spoken_s = -1, 0.0
        while self._driver.open and await is_there(client):
            snapshot, now_s = self._driver.snapshot(), time.monotonic()
            if snapshot.seq != shown or now_s - spoken_s >= BEAT_S:
                shown, spoken_s = snapshot.seq, now_s
                with client:
                    self.show(snapshot)
                    # waits for a browser that is slow, and tells it that it is not alone
                    await is_drawn(client, "window.highside?.beat()")
            await asyncio.sleep(1.0 / self._rate_hz)
        if not client.is_deleted:
            with client:
                self.show(self._driver.snapshot())

    # --- commanding --------------------------------------------------------------------------------------------

    def _asking(self) -> bool:
        """Whether a dialog is open: what is behind it takes no keys."""
        return self._dialog.value or any(dialog.value for dialog in self._beside)

    @_own_language
    async def _clicked(self, name: CommandName) -> None:
        record = None
        if name in QUESTIONS:
            snapshot = self._driver.snapshot()
            record = snapshot.meant(name)
            question = TO_NOTHING if name is CommandName.ROLLBACK and record == NOTHING else QUESTIONS[name]
            self._question.set_text(_(question) % {"record": (record or "")[:12], "tool": snapshot.tool})
            if not await self._dialog:
                return
        await self.send(name, confirm=record)

    @_own_language
    async def _redo(self, pose: str | None) -> None:
        if pose is not None:
            self._again.set_value(None)
            await self.send(CommandName.REDO, pose)

    @_own_language
    async def _on_key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown or event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta:
            return
        for name, (_word, key) in LABELS.items():
            if event.key.name == key and self._buttons[name].visible and not self._asking():
                await self._clicked(name)
                return

    @_own_language
    async def _note(self, text: str) -> Kept:
        kept = await self._driver.remark(self._name_of_operator(), text)
        return Kept(kept.done, told(kept.text))

    def _name_of_operator(self) -> str:
        return self._signed_in or (self._name.value or "").strip()

    def _may(self, name: CommandName) -> bool:
        """Whether the role allows it, as it is now: a person's role may change while the page is open."""
        person = self._who()
        return person is not None and person.may(Role.FORCE if name in FORCING else Role.OPERATE)

    @_own_language
    async def send(self, name: CommandName, pose: str | None = None, *, confirm: str | None = None) -> None:
        """Give a command in the operator's name and show the answer; `confirm`: the record that was asked about."""
        if not self._commands:
            self._answer.set_text(_(NO_TOKEN))
            return
        if not self._may(name):
            self._answer.set_text(f"{_(LABELS[name][0])}: {_(NOT_YOURS)}")
            return
        try:
            command = Command(
                name=name,
                request_id=next(self._request),
                operator=self._name_of_operator(),
                pose=pose,
                confirm=confirm,
            )
        except ValidationError:
            self._answer.set_text(_("Say who you are: the field Operator is empty."))
            return
        reply = await self._driver.command(command)
        self._answer.set_text(f"{_(LABELS[name][0])}: {told(reply.text)}")


_SCROLL = """
const list = document.querySelector('section.list'), row = list && list.querySelector('tr.here');
if (row) list.scrollTop = row.offsetTop - list.clientHeight / 2;
"""
