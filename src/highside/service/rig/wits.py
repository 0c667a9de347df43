"""WITS level 0 to the rig: a record every few seconds over a serial line, to peers that connect, or to one we call.

A peer that is absent, slow or dead never holds anything up. Each has room for one record: while that has not left,
newer ones are counted as dropped, and a record is never cut in the middle. What cannot be opened is tried again for
ever, with back-off. The rig may tell us the depth in items of its own; it is passed on as long as it is fresh.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from highside.codec import wits0
from highside.config.rig import WitsClient, WitsConfig, WitsItem, WitsSerial, WitsServer
from highside.service.quiet_log import QuietLog

log = logging.getLogger(__name__)

BACKOFF_FIRST_S = 0.2
BACKOFF_MOST_S = 5.0
STUCK_AFTER_S = 30.0
"""A TCP peer that has taken nothing for so long is let go."""
DEPTH_FRESH_S = 600.0


@dataclass(slots=True)
class Latest:
    """What there is to send: the newest readings, put here by the service."""

    attitude: dict[str, float | None] = field(default_factory=dict)
    """value by the names of `WitsValue`"""
    attitude_s: float = float("-inf")
    """monotonic"""
    attitude_t: float = 0.0
    """UTC epoch seconds"""
    watch: dict[str, float | None] = field(default_factory=dict)
    """the same of the watch; it stands until it says something else"""
    survey: dict[str, float | None] = field(default_factory=dict)
    survey_t: float = 0.0
    depth: str | None = None
    depth_s: float = float("-inf")


def record(items: tuple[WitsItem, ...], latest: Latest, now_s: float, stale_after_s: float) -> wits0.Items:
    """The items that can be sent now: what is unknown or stale is omitted. `now_s` monotonic."""
    fresh = now_s - latest.attitude_s <= stale_after_s
    found: list[tuple[str, str]] = []
    for item in items:
        from_survey = item.source == "survey"
        if item.value in latest.watch:
            value = latest.watch[item.value]
            if value is not None:
                found.append((item.code, f"{value:.{item.digits}f}"))
            continue
        if not from_survey and not fresh:
            continue
        if item.value in ("date", "time"):
            t = latest.survey_t if from_survey else latest.attitude_t
            if t:
                found.append((item.code, datetime.fromtimestamp(t, UTC).strftime(_CLOCK[item.value])))
        elif item.value == "depth":
            if latest.depth is not None and now_s - latest.depth_s <= DEPTH_FRESH_S:
                found.append((item.code, latest.depth))
        else:
            value = (latest.survey if from_survey else latest.attitude).get(item.value)
            if value is not None and value - value == 0.0:
                found.append((item.code, _angle_text(item.value, value, item.digits)))
    # a date alone says nothing
    return tuple(found) if any(code not in _clock_codes(items) for code, _ in found) else ()


_CLOCK = {"date": "%y%m%d", "time": "%H%M%S"}


def _clock_codes(items: tuple[WitsItem, ...]) -> set[str]:
    return {item.code for item in items if item.value in ("date", "time", "depth")}


def _angle_text(name: str, value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    if name in ("azi_deg", "motor_toolface_deg", "tf_deg") and float(text) >= 360.0:
        return f"{0.0:.{digits}f}"
    return text


@dataclass(slots=True)
class WitsStats:
    """Counters of one output; `made == sent + dropped + 1 under way at most`, for each peer."""

    made: int = 0
    sent: int = 0
    dropped: int = 0
    opened: int = 0
    lost: int = 0
    peers: int = 0
    last_error: str = ""

    def as_dict(self) -> dict[str, Any]:
        return {
            "made": self.made,
            "sent": self.sent,
            "dropped": self.dropped,
            "opened": self.opened,
            "lost": self.lost,
            "peers": self.peers,
            "last_error": self.last_error,
        }


class WitsOutput:
    """One `[[wits]]` table at work. `run` is its task; it never raises for a peer."""

    def __init__(self, settings: WitsConfig, latest: Latest, clock: Callable[[], float] = time.monotonic) -> None:
        self.settings = settings
        self.stats = WitsStats()
        self.port: int | None = None
        """where a server listens, once it does"""
        self._latest = latest
        self._clock = clock
        self._peers: set[_Peer] = set()
        self._quiet = QuietLog(log)

    @property
    def name(self) -> str:
        """How logs and health call it."""
        s = self.settings
        return f"wits {s.port}" if isinstance(s, WitsSerial) else f"wits {s.host}:{s.port}"

    async def run(self) -> None:
        """Send until cancelled."""
        ticking = asyncio.create_task(self._tick(), name="wits-tick")
        try:
            if isinstance(self.settings, WitsServer):
                await self._listen(self.settings)
            else:
                await self._keep_open(self.settings)
        finally:
            ticking.cancel()
            for peer in list(self._peers):
                peer.close()
            await asyncio.gather(ticking, return_exceptions=True)

    async def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            items = record(self.settings.items, self._latest, self._clock(), self.settings.stale_after_s)
            if items:
                data = wits0.encode(items)
                for peer in list(self._peers):
                    self.stats.made += 1
                    peer.offer(data)
            due = max(due + self.settings.interval_s, loop.time())
            await asyncio.sleep(due - loop.time())

    def greeting(self) -> bytes:
        return wits0.encode(self.settings.greeting) if self.settings.greeting else b""

    def on_items(self, items: wits0.Items) -> None:
        """A record of the rig: it may tell the depth."""
        values = dict(items)
        for code in self.settings.depth_codes:
            text = values.get(code)
            if text is None:
                continue
            try:
                number = float(text)
            except ValueError:
                continue
            if number - number == 0.0:
                self._latest.depth, self._latest.depth_s = text, self._clock()
                return

    def _note(self, what: str) -> None:
        if what != self.stats.last_error:
            self._quiet.say(logging.WARNING, what, "%s: %s", self.name, what)
        self.stats.last_error = what

    def _joined(self, peer: _Peer) -> None:
        self._peers.add(peer)
        self.stats.opened += 1
        self.stats.last_error = ""
        self.stats.peers = len(self._peers)
        self._quiet.say(logging.INFO, "connected", "%s: connected", self.name)

    def _left(self, peer: _Peer, why: str) -> None:
        self._peers.discard(peer)
        self.stats.lost += 1
        self.stats.peers = len(self._peers)
        self._note(why)

    # --- kinds -------------------------------------------------------------------------------------------------

    async def _listen(self, settings: WitsServer) -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            if len(self._peers) >= settings.max_peers:
                self._note(f"more than {settings.max_peers} peers: one was turned away")
                writer.close()
                return
            await self._serve_tcp(reader, writer)

        wait_s = BACKOFF_FIRST_S
        while True:
            try:
                server = await asyncio.start_server(serve, settings.host, settings.port)
            except OSError as error:
                self._note(f"cannot listen: {error.strerror or error}")
                await asyncio.sleep(wait_s)
                wait_s = min(2 * wait_s, BACKOFF_MOST_S)
                continue
            self.port = server.sockets[0].getsockname()[1]
            try:
                await server.serve_forever()
            finally:
                server.close()
                # a server waits for its connections to end before it is closed
                for peer in list(self._peers):
                    peer.close()

    async def _keep_open(self, settings: WitsSerial | WitsClient) -> None:
        wait_s = BACKOFF_FIRST_S
        while True:
            before = self.stats.opened
            try:
                if isinstance(settings, WitsSerial):
                    await self._serve_serial(settings)
                else:
                    async with asyncio.timeout(BACKOFF_MOST_S):
                        reader, writer = await asyncio.open_connection(settings.host, settings.port)
                    await self._serve_tcp(reader, writer)
            except (OSError, TimeoutError) as error:
                self._note(f"cannot be opened: {getattr(error, 'strerror', None) or error or 'no answer'}")
            if self.stats.opened > before:
                wait_s = BACKOFF_FIRST_S
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, BACKOFF_MOST_S)

    async def _serve_tcp(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = _TcpPeer(self, writer)
        self._joined(peer)
        peer.greet(self.greeting())
        why = "the peer has gone"
        try:
            parser = wits0.Parser()
            while data := await reader.read(4096):
                for items in parser.receive(data):
                    self.on_items(items)
        except (OSError, asyncio.IncompleteReadError) as error:
            why = f"the peer was lost: {getattr(error, 'strerror', None) or error}"
        finally:
            peer.close()
            self._left(peer, peer.why or why)

    async def _serve_serial(self, settings: WitsSerial) -> None:
        import serial

        try:
            port = serial.Serial(
                settings.port, settings.baud, parity=settings.parity, timeout=0, write_timeout=0, exclusive=True
            )
        except serial.SerialException as error:
            raise OSError(getattr(error, "errno", None) or 0, str(error.args[-1])) from None
        peer = _SerialPeer(self, port.fileno())
        loop = asyncio.get_running_loop()
        self._joined(peer)
        peer.greet(self.greeting())
        gone: asyncio.Future[str] = loop.create_future()
        parser = wits0.Parser()

        def readable() -> None:
            try:
                data = os.read(port.fileno(), 4096)
            except BlockingIOError:
                return
            except OSError as error:
                data = b""
                peer.why = error.strerror or ""
            if not data:
                loop.remove_reader(port.fileno())
                if not gone.done():
                    gone.set_result(peer.why or "the line is gone")
                return
            for items in parser.receive(data):
                self.on_items(items)

        def lost(why: str) -> None:
            if not gone.done():
                gone.set_result(why)

        peer.on_lost = lost
        loop.add_reader(port.fileno(), readable)
        why = "stopped"
        try:
            why = await gone
        finally:
            loop.remove_reader(port.fileno())
            peer.close()
            port.close()
            self._left(peer, why)


class _Peer(ABC):
    """Somebody who is sent records. `offer` never waits."""

    def __init__(self, output: WitsOutput) -> None:
        self._stats = output.stats
        self.why = ""

    @abstractmethod
    def greet(self, data: bytes) -> None: ...

    @abstractmethod
    def offer(self, data: bytes) -> None: ...

    @abstractmethod
    def close(self) -> None: ...


class _TcpPeer(_Peer):
    def __init__(self, output: WitsOutput, writer: asyncio.StreamWriter) -> None:
        super().__init__(output)
        self._writer = writer
        self._loop = asyncio.get_running_loop()
        self._stuck_since: float | None = None

    def greet(self, data: bytes) -> None:
        if data:
            self._writer.write(data)

    def offer(self, data: bytes) -> None:
        transport = self._writer.transport
        if transport.is_closing():
            self._stats.dropped += 1
            return
        if transport.get_write_buffer_size():
            self._stats.dropped += 1
            now = self._loop.time()
            if self._stuck_since is None:
                self._stuck_since = now
            elif now - self._stuck_since > STUCK_AFTER_S:
                self.why = "the peer takes nothing any more: let go"
                transport.abort()
            return
        self._stuck_since = None
        self._writer.write(data)
        self._stats.sent += 1

    def close(self) -> None:
        with contextlib.suppress(OSError, RuntimeError):
            self._writer.close()


class _SerialPeer(_Peer):
    """Writes to a descriptor without waiting; what did not fit goes when the line takes it."""

    def __init__(self, output: WitsOutput, fd: int) -> None:
        super().__init__(output)
        self._fd = fd
        self._rest = b""
        self._loop = asyncio.get_running_loop()
        self.on_lost: Callable[[str], object] = lambda why: None

    def greet(self, data: bytes) -> None:
        if data:
            self._write(data)

    def offer(self, data: bytes) -> None:
        if self._rest:
            self._stats.dropped += 1
        elif self._write(data):
            self._stats.sent += 1
        else:
            self._stats.dropped += 1

    def _write(self, data: bytes) -> bool:
        try:
            done = os.write(self._fd, data)
        except BlockingIOError:
            done = 0
        except OSError as error:
            self.on_lost(error.strerror or errno.errorcode.get(error.errno or 0, "error"))
            return False
        self._rest = data[done:]
        if self._rest:
            self._loop.add_writer(self._fd, self._flush)
        return True

    def _flush(self) -> None:
        self._loop.remove_writer(self._fd)
        rest, self._rest = self._rest, b""
        self._write(rest)

    def close(self) -> None:
        self._loop.remove_writer(self._fd)
