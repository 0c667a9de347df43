"""The publisher: one task that brings what is in the outbox to the broker. The only module that knows aiomqtt.

It connects for ever, with back-off and jitter. Each connection is a new client: what an old one still holds in its
own queue is forgotten, because the outbox hands out again everything that was not acknowledged. On every connect the
birth message `online` and the retained state (health and the like) are published first, then the messages: live ones
in order, the backlog in order in the gaps (see `outbox`). Up to `in_flight` messages are under way at once; a PUBACK
deletes the row, and a message without PUBACK within `ack_timeout_s` ends the connection: after a silent broker (a
"black hole") that is noticed before any keep-alive. Delivery is therefore at least once; the sequence number tells a
duplicate.

The backlog is sent at `backlog_per_s` at most: a broker queues for each subscriber in order and cuts the queue, so a
flood would delay the live messages behind it and be lost to a subscriber that is slower.

A connection found dead is reset, not closed: a DISCONNECT that reaches the broker late would cancel the last will.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import socket
import ssl
import struct
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, NamedTuple

import aiomqtt
import paho.mqtt.client as mqtt
from aiomqtt.exceptions import MqttConnectError
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from highside.config.mqtt import MqttSettings, TlsSettings
from highside.errors import InputError
from highside.service.messages import OFFLINE, ONLINE, mark_historical
from highside.service.outbox import Outbox

log = logging.getLogger(__name__)

FAREWELL_SHARE = 0.5
"""Of the time that `stop` is given, the part after which waiting for PUBACKs gives way to the farewell."""


class Retained(NamedTuple):
    """The latest value of a topic, kept by the broker for those who come later."""

    topic: str
    payload: bytes


class LostConnection(Exception):  # noqa: N818 - an event of every day, not an error
    """The connection is of no more use; `reason` is the name under which that is counted."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class PublisherStats(NamedTuple):
    """What the health message says about the broker."""

    connected: bool
    connects: int
    failures: dict[str, int]
    last_error: str
    in_flight: int
    sent: int
    """publishes handed to the network, repetitions included"""


class Publisher:
    """Sends what the outbox holds. `run` is the task; everything else may be called from the same event loop."""

    def __init__(
        self,
        settings: MqttSettings,
        outbox: Outbox,
        *,
        tool_id: str,
        on_connect_payloads: Callable[[], list[Retained]] = list,
        commands: Mapping[str, Callable[[bytes, bool], None]] | None = None,
        rng: random.Random | None = None,
    ) -> None:
        self._settings = settings
        self._outbox = outbox
        self._status_topic = settings.topic(tool_id, "status")
        self._client_id = settings.client_id or f"highside-{tool_id}"
        self._on_connect_payloads = on_connect_payloads
        self._commands = dict(commands or {})
        """by topic: what is said to the tool; called with the payload and whether it was retained"""
        self._rng = rng or random.Random()
        self._retained: dict[str, bytes] = {}
        self._changed: dict[str, None] = {}
        """retained topics whose latest value is still to be sent on this connection"""
        self._wake = asyncio.Event()
        self._stopping = asyncio.Event()
        self._stopped = asyncio.Event()
        self._stop_deadline_s = 0.0
        self._running = False
        self._pending: set[asyncio.Task[None]] = set()
        self._lost: LostConnection | None = None
        self._backlog_in_flight = 0
        self._allowance = 0.0
        self._allowance_at_s = 0.0
        self._pace: asyncio.TimerHandle | None = None
        self._failures: Counter[str] = Counter()
        self._sent = 0
        self.connected = False
        self.connects = 0
        self.last_error = ""

    @property
    def stats(self) -> PublisherStats:
        return PublisherStats(
            self.connected, self.connects, dict(self._failures), self.last_error, len(self._pending), self._sent
        )

    def retained(self, topic: str, payload: bytes) -> None:
        """Publish a retained value now, or with the next connect. Only the latest of a topic is kept."""
        self._retained[topic] = payload
        self._changed[topic] = None
        self._wake.set()

    async def stop(self, timeout_s: float) -> None:
        """Say `offline` and leave; what is not acknowledged stays in the outbox."""
        self._stop_deadline_s = asyncio.get_running_loop().time() + timeout_s * FAREWELL_SHARE
        self._stopping.set()
        self._wake.set()
        if self._running:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopped.wait(), timeout_s)

    async def run(self) -> None:
        """Connect and send until `stop`. Never raises for a broker that is away, wrong or rude."""
        self._running = True
        wait_s = self._settings.reconnect_min_s
        try:
            while not self._stopping.is_set():
                before = self.connects
                try:
                    await self._one_connection()
                except LostConnection as lost:
                    self._note(lost)
                if self.connects > before:
                    wait_s = self._settings.reconnect_min_s
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stopping.wait(), wait_s * self._rng.uniform(0.5, 1.0))
                wait_s = min(2.0 * wait_s, self._settings.reconnect_max_s)
        finally:
            self._running = False
            self._stopped.set()

    def _note(self, lost: LostConnection) -> None:
        self._failures[lost.reason] += 1
        text = f"{lost.reason}: {lost}"
        if text != self.last_error:
            # a broker that is away for a day is worth one line, not one a second
            log.log(logging.INFO if lost.reason == "stopped" else logging.WARNING, "mqtt: %s", text)
        self.last_error = text

    # -- one connection --------------------------------------------------------------------------------------------

    async def _one_connection(self) -> None:
        client = await self._client()
        try:
            await self._connect(client)
        except (aiomqtt.MqttError, TimeoutError, OSError, ValueError) as error:
            _reset(client)
            raise LostConnection(_connect_reason(error), str(error) or "no answer") from error
        except BaseException:
            _reset(client)
            raise
        self._lost = None
        self._backlog_in_flight = 0
        loop = asyncio.get_running_loop()
        listener = asyncio.create_task(self._listen(client))
        try:
            await self._publish_birth(client)
            self.connected = True
            self.connects += 1
            self.last_error = ""
            log.info("mqtt: connected to %s", self._settings.host)
            self._outbox.begin_delivery(lambda: self._wake_from(loop))
            if self._commands:
                self._start(self._subscribe(client))
            await self._send_until_lost(client)
            await self._farewell(client)
        except BaseException:
            _reset(client)
            raise
        finally:
            self.connected = False
            self._outbox.end_delivery()
            listener.cancel()
            for task in self._pending:
                task.cancel()
            await asyncio.gather(listener, *self._pending, return_exceptions=True)
            self._pending.clear()
            # returns at once when the socket was reset; after the farewell it says DISCONNECT
            with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                await asyncio.wait_for(client.__aexit__(None, None, None), self._settings.ack_timeout_s)

    async def _connect(self, client: aiomqtt.Client) -> None:
        """Raises what aiomqtt raises, TimeoutError, or `LostConnection` when `stop` was called meanwhile."""
        connect = asyncio.create_task(client.__aenter__())
        stop = asyncio.create_task(self._stopping.wait())
        try:
            await asyncio.wait(
                {connect, stop},
                timeout=self._settings.connect_timeout_s + 1.0,
                return_when=asyncio.FIRST_COMPLETED,
            )
        finally:
            stop.cancel()
            if not connect.done():
                connect.cancel()
                await asyncio.gather(connect, return_exceptions=True)
        if not connect.cancelled():
            connect.result()
        elif self._stopping.is_set():
            raise LostConnection("stopped", "told to stop while connecting")
        else:
            raise TimeoutError

    def _wake_from(self, loop: asyncio.AbstractEventLoop) -> None:
        """Called in the outbox's thread."""
        loop.call_soon_threadsafe(self._wake.set)

    async def _client(self) -> aiomqtt.Client:
        settings = self._settings
        try:
            will = aiomqtt.Will(self._status_topic, OFFLINE, qos=1, retain=True)
            client = await broker_client(settings, self._client_id, will=will)
        except (InputError, OSError) as error:
            # a certificate or a credential that is being exchanged: try again
            raise LostConnection("credentials", str(error)) from error
        client.pending_calls_threshold = settings.in_flight + 8
        client._client.connect_timeout = settings.connect_timeout_s
        _notice_a_closed_door(client)
        return client

    async def _subscribe(self, client: aiomqtt.Client) -> None:
        """To the topics of commands. A broker that forbids it costs the commands, not the messages."""
        for topic in self._commands:
            try:
                granted = await client.subscribe(topic, qos=1, timeout=self._settings.ack_timeout_s)
            except (aiomqtt.MqttError, ValueError) as error:
                log.warning("mqtt: commands on %s cannot be heard: %s", topic, error)
                continue
            codes = [code if isinstance(code, int) else code.value for code in granted]
            if any(code >= 0x80 for code in codes):
                log.warning("mqtt: the broker does not let us hear commands on %s: see its access list", topic)

    async def _listen(self, client: aiomqtt.Client) -> None:
        """Hands over commands; ends when the connection does, and says so at once."""
        try:
            async for message in client.messages:
                command = self._commands.get(str(message.topic))
                if command is not None and isinstance(message.payload, bytes | bytearray):
                    command(bytes(message.payload), message.retain)
        except aiomqtt.MqttError as error:
            cause = error.__cause__ or error
            self._fail(LostConnection("connection lost", str(cause)))

    def _fail(self, lost: LostConnection) -> None:
        if self._lost is None:
            self._lost = lost
        self._wake.set()

    async def _publish_birth(self, client: aiomqtt.Client) -> None:
        for topic, payload in self._on_connect_payloads():
            self._retained[topic] = payload
        self._changed.clear()
        await self._publish(client, self._status_topic, ONLINE, qos=1, retain=True)
        for topic, payload in self._retained.items():
            await self._publish(client, topic, payload, qos=1, retain=True)

    async def _send_until_lost(self, client: aiomqtt.Client) -> None:
        """Keep the window full. Returns when told to stop, raises `LostConnection` when the connection is."""
        while True:
            self._wake.clear()
            if self._lost is not None:
                raise self._lost
            if self._stopping.is_set():
                return
            self._send_changed(client)
            self._fill_window(client)
            await self._wake.wait()

    def _send_changed(self, client: aiomqtt.Client) -> None:
        for topic in list(self._changed):
            del self._changed[topic]
            self._start(self._send_retained(client, topic, self._retained[topic]))

    def _fill_window(self, client: aiomqtt.Client) -> None:
        settings = self._settings
        # the backlog may fill half of the window: a live message then never waits for a slot
        backlog_slots = max(settings.in_flight // 2, 1)
        self._grow_allowance(backlog_slots)
        while len(self._pending) < settings.in_flight:
            free = self._backlog_in_flight < backlog_slots and self._allowance >= 1.0
            taken = self._outbox.take(backlog=free)
            if taken is None:
                break
            row, historical = taken
            payload = mark_historical(row.payload) if historical else row.payload
            self._backlog_in_flight += historical
            self._allowance -= historical
            self._start(self._send(client, row.id, row.topic, payload, row.qos, historical))

    def _grow_allowance(self, most: float) -> None:
        """The pace of the backlog: an allowance that grows with time; while it is not full the sender looks again."""
        loop = asyncio.get_running_loop()
        now_s, rate = loop.time(), self._settings.backlog_per_s
        self._allowance = min(self._allowance + (now_s - self._allowance_at_s) * rate, most)
        self._allowance_at_s = now_s
        if self._allowance < most and (self._pace is None or self._pace.when() <= now_s):
            self._pace = loop.call_later(max(0.5 * most / rate, 0.005), self._wake.set)

    def _start(self, work: Coroutine[None, None, None]) -> None:
        # tasks begin in the order of their making, so publishes keep theirs
        task = asyncio.create_task(work)
        self._pending.add(task)
        task.add_done_callback(self._pending.discard)

    async def _send(
        self, client: aiomqtt.Client, row_id: int, topic: str, payload: bytes, qos: int, historical: bool
    ) -> None:
        try:
            await self._publish(client, topic, payload, qos=qos, retain=False)
        except LostConnection as lost:
            self._fail(lost)
        except ValueError as error:
            # a topic or size that the protocol cannot carry would be refused for ever, and block what follows
            log.error("mqtt: a message on %r cannot be sent (%s) and is dropped", topic, error)
            self._outbox.discard(row_id, "refused")
        else:
            self._outbox.ack(row_id)
        finally:
            self._backlog_in_flight -= historical
            self._wake.set()

    async def _send_retained(self, client: aiomqtt.Client, topic: str, payload: bytes) -> None:
        try:
            await self._publish(client, topic, payload, qos=1, retain=True)
        except LostConnection as lost:
            self._fail(lost)
        except ValueError as error:
            log.error("mqtt: the retained message on %r cannot be sent (%s)", topic, error)
            self._retained.pop(topic, None)

    async def _publish(self, client: aiomqtt.Client, topic: str, payload: bytes, *, qos: int, retain: bool) -> None:
        self._sent += 1
        try:
            await client.publish(topic, payload, qos=qos, retain=retain, timeout=self._settings.ack_timeout_s)
        except aiomqtt.MqttCodeError as error:
            raise LostConnection("connection lost", str(error)) from error
        except aiomqtt.MqttError as error:
            raise LostConnection("no acknowledgement", str(error)) from error
        except RuntimeError as error:
            raise LostConnection("refused by client", str(error)) from error

    async def _farewell(self, client: aiomqtt.Client) -> None:
        self._send_changed(client)  # the last health, with the final counts
        loop = asyncio.get_running_loop()
        left_s = self._stop_deadline_s - loop.time()
        if self._pending and left_s > 0.0:
            await asyncio.wait(self._pending, timeout=left_s)
        await self._publish(client, self._status_topic, OFFLINE, qos=1, retain=True)


def _notice_a_closed_door(client: aiomqtt.Client) -> None:
    """End `connect` when the peer closes before it has answered; aiomqtt would wait for its whole timeout."""
    loop = asyncio.get_running_loop()
    told = client._on_disconnect

    def end_connect() -> None:
        if not client._connected.done():
            client._connected.set_exception(aiomqtt.MqttError("closed by peer before an answer"))

    def on_disconnect(
        paho: mqtt.Client, userdata: Any, flags: mqtt.DisconnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        told(paho, userdata, flags, reason, properties)
        loop.call_soon_threadsafe(end_connect)

    client._client.on_disconnect = on_disconnect


def _reset(client: aiomqtt.Client) -> None:
    """End the TCP connection without a word (RST), so that the broker sends the last will and nothing arrives late."""
    paho = client._client
    sock = paho.socket()
    if not isinstance(sock, socket.socket):
        return
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    # paho's own way to close: it also takes the descriptor out of the event loop
    paho._sock_close()
    if client._misc_task is not None:
        client._misc_task.cancel()
    if client._connected.done() and not client._disconnected.done():
        client._disconnected.set_result(None)


def check_secrets(mqtt: MqttSettings) -> None:
    """Read the files with password and certificates once. Raises `InputError` that names the file and the field."""
    mqtt.read_password()
    tls = mqtt.tls
    if tls is None:
        return
    for name, path in (("ca", tls.ca), ("cert", tls.cert), ("key", tls.key)):
        if path is not None:
            try:
                path.read_bytes()
            except OSError as error:
                raise InputError(
                    f"cannot be read ({error.strerror})",
                    where=str(path),
                    field=f"mqtt.tls.{name}",
                    remedy="name a file that this user may read",
                ) from None
    try:
        _tls_context(tls)
    except OSError as error:
        # ssl does not say which of the files it could not understand
        named = [str(path) for path in (tls.ca, tls.cert, tls.key) if path is not None]
        raise InputError(
            f"is no certificate or key that can be used ({error.strerror or error})",
            where=" or ".join(named) or None,
            field="mqtt.tls",
            remedy="give PEM files that belong together",
        ) from None


async def broker_client(
    settings: MqttSettings, identifier: str, *, will: aiomqtt.Will | None = None, clean_session: bool = True
) -> aiomqtt.Client:
    """A client of the configured broker, not yet connected. Raises InputError or OSError if a secret cannot be read."""
    password = settings.read_password()
    # reading the system's certificates takes tens of milliseconds
    context = None if settings.tls is None else await asyncio.to_thread(_tls_context, settings.tls)
    return aiomqtt.Client(
        settings.host,
        settings.port,
        transport=settings.transport,
        identifier=identifier,
        username=settings.username,
        password=password.get_secret_value() if password is not None else None,
        will=will,
        clean_session=clean_session,
        keepalive=settings.keepalive_s,
        timeout=settings.connect_timeout_s,
        tls_context=context,
        max_inflight_messages=settings.in_flight + 8,
        logger=_client_log,
    )


_client_log = logging.getLogger("highside.mqtt.client")
"""Of the client library: it counts every message under way as a warning, on stderr where nothing else is set up."""
_client_log.setLevel(logging.CRITICAL)


def _tls_context(tls: TlsSettings) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str(tls.ca) if tls.ca is not None else None)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if tls.cert is not None and tls.key is not None:
        # an encrypted key is refused: without this word OpenSSL would ask for one at the terminal
        context.load_cert_chain(tls.cert, tls.key, password="")
    return context


def _connect_reason(error: BaseException) -> str:
    if isinstance(error, MqttConnectError):
        return "refused by broker"
    text = str(error).lower()
    if "refused" in text:
        return "no broker"
    if "closed by peer" in text:
        return "closed by peer"
    if isinstance(error, TimeoutError) or "timed out" in text:
        return "no answer"
    if "certificate" in text or "ssl" in text:
        return "tls"
    return "cannot connect"
