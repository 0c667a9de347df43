"""The sockets of the page's library, closed to whom they are not for.

NiceGUI takes events, answers, acknowledgements and log messages from any socket that names a page's id. Here a socket
speaks for the one page it was opened for, a page that may command only from a browser that shows the operator's cookie,
and events are taken from such pages alone; who looks on can say that he has drawn what he was sent, and that a 3-D
picture is built, and no more. Log messages are taken from nobody. What is malformed, binary or too much ends the socket
it came by, and of all such one line a minute is logged.
"""

from __future__ import annotations

import logging
import time
import weakref
from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import parse_qs

from nicegui import Client, core, ui
from socketio.exceptions import ConnectionRefusedError as Refused

from highside.printable import one_line
from highside.web.access import Access
from highside.web.viewers import Viewers

log = logging.getLogger("highside")

FRAMES_PER_S = 30.0
FRAMES_AT_ONCE = 200.0
"""A browser sends an answer and an acknowledgement for each picture and a word for each key: some 20 a second."""
SAID_EVERY_S = 60.0
_EVENT_KEYS = frozenset({"id", "client_id", "listener_id", "args"})


class Offences:
    """What strangers try, as one short line a minute."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._next_s = -1e9
        self._held = 0

    def note(self, what: str, sender: object = None) -> None:
        now = self._clock()
        if now < self._next_s:
            self._held += 1
            return
        where = f" from {sender[0]}" if isinstance(sender, tuple | list) and sender else ""
        more = f"; {self._held} more since the last such line" if self._held else ""
        log.warning("%s", one_line(f"bench page: {what}{where} was refused{more}")[:300])
        self._next_s, self._held = now + SAID_EVERY_S, 0


class _Noted(logging.Filter):
    """What a library logs of the frames of strangers is logged as all of theirs is."""

    def __init__(self, offences: Offences) -> None:
        super().__init__()
        self._offences = offences

    def filter(self, record: logging.LogRecord) -> bool:
        if record.levelno >= logging.WARNING:
            self._offences.note("a malformed frame")
        return False


class _Allowance:
    """How many frames a socket may still send."""

    def __init__(self) -> None:
        self.left, self.at_s = FRAMES_AT_ONCE, time.monotonic()

    def take(self) -> bool:
        now = time.monotonic()
        self.left = min(FRAMES_AT_ONCE, self.left + (now - self.at_s) * FRAMES_PER_S)
        self.at_s = now
        self.left -= 1.0
        return self.left >= 0.0


class Sockets:
    """Stands before NiceGUI's handlers. One in a process, as they are."""

    def __init__(self, viewers: Viewers, access: Access, offences: Offences) -> None:
        self._viewers = viewers
        self._access = access
        self._offences = offences
        self._allowances: weakref.WeakKeyDictionary[object, _Allowance] = weakref.WeakKeyDictionary()
        self._theirs: dict[str, Callable[..., Any]] = {}

    def guard(self) -> None:
        """Take the place of the handlers there are."""
        sio = core.sio
        self._theirs = dict(sio.handlers["/"])
        for name in ("socketio.server", "engineio.server"):
            logging.getLogger(name).filters[:] = [_Noted(self._offences)]
        sio.on("connect", self._connect)
        sio.on("disconnect", self._disconnect)
        sio.on("handshake", self._handshake)
        sio.on("event", self._event)
        sio.on("javascript_response", self._drawn)
        sio.on("ack", self._acknowledged)
        sio.on("log", _nothing)
        # each frame has its task already; what a handler raises is to come back to it
        sio.async_handlers = False
        # every viewer is one socket: no polling, which is a request and a body at a time
        sio.eio.transports = ["websocket"]
        # the origin of a socket is judged before it comes here: this library takes every server for one without TLS
        sio.eio.cors_allowed_origins = []
        inner: Callable[[str, Any], Awaitable[None]] = sio.eio.handlers["message"]
        sio.eio.on("message", self._counted(inner))

    def _counted(self, inner: Callable[[str, Any], Awaitable[None]]) -> Callable[[str, Any], Awaitable[None]]:
        async def message(eio_sid: str, data: Any) -> None:
            opened = core.sio.eio.sockets.get(eio_sid)
            if opened is None:
                return
            allowance = self._allowances.setdefault(opened, _Allowance())
            what = None
            if not allowance.take():
                what = "a flood of frames"
            elif not isinstance(data, str) or data[:1] in ("5", "6"):
                # binary parts would be kept until the last of up to 10 milliards has come
                what = "a binary frame"
            else:
                try:
                    await inner(eio_sid, data)
                except Exception as error:
                    what = f"a malformed frame ({type(error).__name__})"
            if what is not None:
                environ = core.sio.environ.get(eio_sid) or {}
                self._offences.note(what, environ.get("asgi.scope", {}).get("client"))
                await core.sio.eio.disconnect(eio_sid)

        return message

    # --- handlers: none raises for what it is given -------------------------------------------------------------

    async def _connect(self, sid: str, *args: Any) -> None:
        environ = core.sio.get_environ(sid)
        if not args or args[0] is not environ or environ is None:
            # a frame may name any handler, this one, too
            self._offences.note("a malformed frame", self._sender(sid))
            return
        query = {name: values[0] for name, values in parse_qs(environ.get("QUERY_STRING", "")).items()}
        # a page that was loaded ahead introduces itself later, by `handshake`
        if query.get("implicit_handshake") == "true" and not await self._handshake(sid, query):
            raise Refused("Implicit handshake failed")

    def _disconnect(self, sid: str, *_: Any) -> None:
        if core.sio.manager.is_connected(sid, "/"):
            # it is not gone: a frame that names this handler
            self._offences.note("a malformed frame", self._sender(sid))
            return
        self._theirs["disconnect"](sid)

    async def _handshake(self, sid: str, *args: Any) -> bool:
        data = args[0] if len(args) == 1 and isinstance(args[0], dict) else {}
        page = data.get("client_id")
        words = [data.get(name, "") for name in ("client_id", "tab_id", "document_id", "old_tab_id")]
        good = (
            isinstance(page, str)
            and page in self._viewers
            and all(word is None or (isinstance(word, str) and len(word) <= 100) for word in words)
            and bool(data.get("tab_id"))
            and bool(data.get("document_id"))
            and str(data.get("next_message_id", "0")).isdecimal()
            and self._access.opens(self._scope(sid), commands=self._viewers.may_command(page))
        )
        if not good:
            return False
        try:
            return bool(await self._theirs["handshake"](sid, data))
        except Exception as error:
            self._offences.note(f"a handshake ({type(error).__name__})", self._sender(sid))
            return False

    def _event(self, sid: str, *args: Any) -> None:
        message = self._from_own_page(sid, args)
        if message is None or not set(message) <= _EVENT_KEYS:
            return
        if not (self._viewers.may_command(message["client_id"]) or _is_scene_built(message)):
            return
        self._pass_on("event", sid, message)

    def _drawn(self, sid: str, *args: Any) -> None:
        """The browser has done what it was asked: that is all we want to know."""
        message = self._from_own_page(sid, args)
        if message is not None and isinstance(message.get("request_id"), str):
            answer = {"request_id": message["request_id"], "client_id": message["client_id"], "result": None}
            self._pass_on("javascript_response", sid, answer)

    def _acknowledged(self, sid: str, *args: Any) -> None:
        message = self._from_own_page(sid, args)
        count = None if message is None else message.get("next_message_id")
        if message is not None and isinstance(count, int) and not isinstance(count, bool):
            self._pass_on("ack", sid, {"client_id": message["client_id"], "next_message_id": count})

    # --- what they share -----------------------------------------------------------------------------------------

    def _from_own_page(self, sid: str, args: tuple[Any, ...]) -> dict[str, Any] | None:
        """The message, where it speaks of the page whose socket this is."""
        message = args[0] if len(args) == 1 else None
        if not isinstance(message, dict) or not isinstance(message.get("client_id"), str):
            self._offences.note("a malformed frame", self._sender(sid))
            return None
        if message["client_id"] not in core.sio.rooms(sid):
            self._offences.note("a frame in the name of another page", self._sender(sid))
            return None
        return message

    def _pass_on(self, name: str, sid: str, message: dict[str, Any]) -> None:
        try:
            self._theirs[name](sid, message)
        except Exception as error:
            self._offences.note(f"a malformed {name} ({type(error).__name__})", self._sender(sid))

    def _scope(self, sid: str) -> dict[str, Any]:
        """The request that opened a socket."""
        found: dict[str, Any] = (core.sio.get_environ(sid) or {}).get("asgi.scope", {})
        return found

    def _sender(self, sid: str) -> object:
        return self._scope(sid).get("client")


def _is_scene_built(message: dict[str, Any]) -> bool:
    """Whether a 3-D picture of the library says that the browser has built it; until then nothing is drawn in it."""
    client = Client.instances.get(message["client_id"])
    element = None if client is None else client.elements.get(message.get("id", -1))
    if not isinstance(element, ui.scene) or not isinstance(message.get("listener_id"), str):
        return False
    listener = element._event_listeners.get(message["listener_id"])
    return listener is not None and listener.type == "init"


def _nothing(*_: Any) -> None:
    """A browser's log is its own."""
