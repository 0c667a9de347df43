"""What stands beside the session on its page: the sound, and the way to a phone."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui
from nicegui.elements.dialog import Dialog

from highside.bench.photographs import SENT_MAX, SIDE_MAX
from highside.bench.session.driver import REMARK_MAX, Kept
from highside.web.language import language_line
from highside.web.parts import markup
from highside.web.phone import qr_svg
from highside.web.viewer import in_language, labelled, viewer
from highside.web.words import _, said_later

ONLY_HERE = said_later(
    "This page listens for this machine alone. Begin the session with --set web.host=0.0.0.0 (and [web.tls]), and a"
    " code stands here that a phone opens it by."
)


Note = Callable[[str], Awaitable[Kept]]
"""Keeps a note, or says why not."""


def build_beside(
    *,
    link_elsewhere: str | None,
    commands: bool,
    note: Note,
    operator: Callable[[], str],
    home: str | None = None,
) -> tuple[Dialog, ...]:
    """The row of buttons. `link_elsewhere`: the page as a phone reaches it, with the right to command; `operator`: in
    whose name things are kept; `home`: where sessions are begun. Who only looks on has nothing but the sound: his
    clicks are not listened to. Returns what it opens: behind that no key of the page counts."""
    language = viewer().language
    if home is not None:
        ui.link(_("All sessions"), home).classes("home")
    ui.html(markup("sound"), sanitize=False, tag="span")
    ui.html(language_line("/"), sanitize=False)
    if not commands:
        return ()
    beside = (_build_note(note), _build_photograph(operator))
    with ui.dialog().props(labelled(_("open this page on a phone"))) as dialog, ui.card().classes("ask phone"):
        if link_elsewhere is None:
            ui.html(markup("only_here", _(ONLY_HERE)), sanitize=False)
        else:
            code = ui.html("", sanitize=False)
        ui.button(_("Close"), color=None, on_click=dialog.close).props("no-caps unelevated autofocus").classes(
            "command plain"
        )

    def show() -> None:
        # not in the page before it is asked for: who commands shows the right to it with the code
        if link_elsewhere is not None:
            address, _, right = link_elsewhere.partition("?")
            with in_language(language):
                code.set_content(markup("phone", address, qr_svg(link_elsewhere), bool(right)))
        dialog.open()

    button = ui.button(_("On a phone"), color=None, on_click=show).classes("command plain small")
    button.props('no-caps unelevated no-wrap data-role="phone"')
    return (*beside, dialog)


def _build_note(note: Note) -> Dialog:
    """What the reader of the journal and of the report should know."""
    with ui.dialog().props(labelled(_("a note to this session"))) as dialog, ui.card().classes("ask"):
        text = ui.textarea(_("Note for the journal and the report")).classes("note")
        text.props(f'outlined autofocus maxlength="{REMARK_MAX}"')
        answer = ui.label("").classes("answer").props('role="status"')

        async def keep() -> None:
            kept = await note(text.value or "")
            answer.set_text(kept.text)
            # what was not kept stays to be mended, and not to be written again
            if kept.done:
                text.set_value("")

        with ui.row():
            ui.button(_("Keep it"), color=None, on_click=keep).props('no-caps unelevated data-role="keep"').classes(
                "command go"
            )
            ui.button(_("Close"), color=None, on_click=dialog.close).props("no-caps unelevated").classes(
                "command plain"
            )

    def show() -> None:
        answer.set_text("")
        dialog.open()

    button = ui.button(_("Note"), color=None, on_click=show).classes("command plain small")
    button.props('no-caps unelevated no-wrap data-role="note"')
    return dialog


def _build_photograph(operator: Callable[[], str]) -> Dialog:
    """A file or, on a phone, its camera: the browser offers both."""
    language = viewer().language
    with ui.dialog().props(labelled(_("a photograph to this session"))) as dialog, ui.card().classes("ask"):
        form = ui.html("", sanitize=False)
        ui.button(_("Close"), color=None, on_click=dialog.close).props("no-caps unelevated").classes("command plain")

    def show() -> None:
        with in_language(language):
            form.set_content(markup("photograph", operator(), SENT_MAX // 1_000_000, SIDE_MAX))
        dialog.open()

    button = ui.button(_("Photograph"), color=None, on_click=show).classes("command plain small")
    button.props('no-caps unelevated no-wrap data-role="photograph"')
    return dialog
