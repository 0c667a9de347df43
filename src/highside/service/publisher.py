"""The publisher: one task that brings what is in the outbox to the broker.

It connects for ever, with back-off and jitter (see `reconnect`). Each connection is a new client: what an old one
still holds in its own queue is forgotten, because the outbox hands out again everything that was not acknowledged. On
every connect the birth message `online` and the retained state (health and the like) are published first, then the
messages: live ones in order, the backlog in order in the gaps (see `outbox`). Up to `in_flight` messages are under way
at once; a PUBACK deletes the row, and a message without PUBACK within `ack_timeout_s` ends the connection: after a
silent broker (a "black hole") that is noticed before any keep-alive. Delivery is therefore at least once; the sequence
number tells a duplicate.

The backlog is sent at `backlog_per_s` at most: a broker queues for each subscriber in order and cuts the queue, so a
flood would delay the live messages behind it and be lost to a subscriber that is slower.

A connection found dead is reset, not closed: a DISCONNECT that reaches the broker late would cancel the last will.

Commands are called in the turn of the loop in which they arrive; one that raises costs itself. Their answers
(`reply`), and what is of the moment only (`passing`), go behind the live messages, from memory.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from typing import NamedTuple

import aiomqtt

from highside.config.mqtt import MqttSettings
from highside.errors import InputError
from highside.service.broker_client import (
    LostConnection,
    broker_client,
    connect,
    connect_reason,
    notice_a_closed_door,
    on_each_message,
    publish,
    reset,
    subscribe,
    write_only_while_open,
)
from highside.service.in_flight import InFlight
from highside.service.messages import OFFLINE, ONLINE, BrokerHealth, mark_historical
from highside.service.outbox import Outbox, StoredMessage
from highside.service.pace import BacklogPace
from highside.service.quiet_log import QuietLog
from highside.service.reconnect import Reconnect, instance_word, new_instance
from highside.service.replies import QueuedReply, ReplyQueue

log = logging.getLogger(__name__)

FAREWELL_SHARE = 0.5
"""Of the time that `stop` is given, the part after which waiting for PUBACKs gives way to the farewell."""


class Retained(NamedTuple):
    """The latest value of a topic, kept by the broker for those who come later."""

    topic: str
    payload: bytes


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
        instance: str | None = None,
    ) -> None:
        self._settings = settings
        self._outbox = outbox
        self._status_topic = settings.topic(tool_id, "status")
        self._instance_topic = settings.topic(tool_id, "instance")
        self._client_id = settings.client_id or f"highside-{tool_id}"
        self.instance = instance or new_instance()
        self._quiet = QuietLog(log)
        self._reconnect = Reconnect(
            self._client_id,
            self.instance,
            min_s=settings.reconnect_min_s,
            max_s=settings.reconnect_max_s,
            rng=rng or random.Random(),
        )
        self._on_connect_payloads = on_connect_payloads
        self._commands = dict(commands or {})
        """by topic: commands to the tool; called with the payload and whether it was retained"""
        self._retained: dict[str, bytes] = {
            self._status_topic: ONLINE,
            self._instance_topic: instance_word(ONLINE, self.instance),
        }
        self._changed: dict[str, None] = {}
        """retained topics whose latest value is still to be sent on this connection"""
        self._passing: dict[str, bytes] = {}
        self._under_way: set[str] = set()
        """topics of both with a message in flight: a newer value waits, so that a flood of values is no flood here"""
        self._replies = ReplyQueue()
        self._replying = False
        self._commands_failed = 0
        self._wake = asyncio.Event()
        self._stopping = asyncio.Event()
        self._stopped = asyncio.Event()
        self._stop_deadline_s = 0.0
        self._running = False
        self._in_flight = InFlight(settings.ack_timeout_s, self._fail)
        self._pending: set[asyncio.Task[None]] = set()
        """what is sent besides the outbox's messages"""
        self._more = False
        """the outbox may hold what there was no room for: the next acknowledgement makes some"""
        self._lost: LostConnection | None = None
        self._backlog_in_flight = 0
        # the backlog may fill half of the window: a live message then never waits for a slot
        self._backlog_slots = max(settings.in_flight // 2, 1)
        self._pace = BacklogPace(settings.backlog_per_s, self._backlog_slots, self._wake.set)
        self._failures: Counter[str] = Counter()
        self.connected = False
        self.connects = 0
        self.last_error = ""

    @property
    def stats(self) -> BrokerHealth:
        return BrokerHealth(
            connected=self.connected,
            connects=self.connects,
            failures=dict(self._failures),
            last_error=self.last_error,
            instance=self.instance,
            short_connections=self._reconnect.short_connections,
            taken=self._reconnect.taken,
            replies=self._replies.made,
            replies_dropped=self._replies.dropped,
            commands_failed=self._commands_failed,
        )

    def retained(self, topic: str, payload: bytes) -> None:
        """Publish a retained value now, or with the next connect. Only the latest of a topic is kept."""
        self._retained[topic] = payload
        self._changed[topic] = None
        self._wake.set()

    def passing(self, topic: str, payload: bytes) -> None:
        """Publish a value of the moment: QoS 0, not kept by anybody; only the latest of a topic, and none from before
        the connection."""
        if self.connected:
            self._passing[topic] = payload
            self._wake.set()

    def reply(self, topic: str, payload: bytes, *, done: bool) -> None:
        """Answer a command that was done, or refused. Beyond some a second answers are dropped and counted."""
        if self._replies.put(QueuedReply(topic, payload), done=done):
            self._wake.set()
        else:
            self._quiet.say(logging.WARNING, "replies", "mqtt: more commands than can be answered on %s", topic)

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
        try:
            while not self._stopping.is_set():
                try:
                    await self._one_connection()
                except LostConnection as lost:
                    self._note(lost)
                pause_s = self._reconnect.pause_s()
                if (taken := self._reconnect.taken) is not None and not self._stopping.is_set():
                    self.last_error = taken
                    self._quiet.say(logging.ERROR, "taken", "mqtt: %s", taken)
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stopping.wait(), pause_s)
        finally:
            self._running = False
            self._stopped.set()

    def _note(self, lost: LostConnection) -> None:
        self._failures[lost.reason] += 1
        text = f"{lost.reason}: {lost}"
        if text != self.last_error:
            # a broker that is away for a day is worth one line, one that comes and goes one a minute
            level = logging.INFO if lost.reason == "stopped" else logging.WARNING
            self._quiet.say(level, lost.reason, "mqtt: %s", text)
        self.last_error = text

    # -- one connection --------------------------------------------------------------------------------------------

    async def _one_connection(self) -> None:
        client = await self._client()
        try:
            await connect(client, self._stopping, timeout_s=self._settings.connect_timeout_s + 1.0)
        except (aiomqtt.MqttError, TimeoutError, OSError, ValueError) as error:
            reset(client)
            raise LostConnection(connect_reason(error), str(error) or "no answer") from error
        except BaseException:
            reset(client)
            raise
        self._lost = None
        self._backlog_in_flight = 0
        self._replying = False
        self._under_way.clear()
        self._passing.clear()
        loop = asyncio.get_running_loop()
        listener = asyncio.create_task(self._listen(client))
        listener.add_done_callback(lambda _: self._fail(LostConnection("connection lost", "nobody listens any more")))
        self._reconnect.connected()
        try:
            # in front of the birth, so that the broker still shows whose `instance` there was before
            self._start(self._subscribe(client))
            await asyncio.sleep(0)
            await self._publish_birth(client)
            self.connected = True
            self.connects += 1
            self.last_error = ""
            self._quiet.say(logging.INFO, "connected", "mqtt: connected to %s", self._settings.host)
            self._in_flight.begin(client)
            self._outbox.begin_delivery(lambda: self._wake_from(loop), lambda: self._on_put(client))
            await self._send_until_lost(client)
            await self._farewell(client)
        except BaseException:
            reset(client)
            raise
        finally:
            self.connected = False
            self._outbox.end_delivery()
            self._in_flight.end()
            listener.cancel()
            for task in self._pending:
                task.cancel()
            await asyncio.gather(listener, *self._pending, return_exceptions=True)
            self._pending.clear()
            # returns at once when the socket was reset; after the farewell it says DISCONNECT
            with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                await asyncio.wait_for(client.__aexit__(None, None, None), self._settings.ack_timeout_s)

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
        notice_a_closed_door(client)
        write_only_while_open(client)
        on_each_message(client, self._on_message)
        return client

    async def _subscribe(self, client: aiomqtt.Client) -> None:
        """To our own words and the topics of commands. A broker that forbids it costs those, not the messages."""
        for topic in (self._instance_topic, self._status_topic, *self._commands):
            refused = await subscribe(client, topic, timeout_s=self._settings.ack_timeout_s)
            if refused is not None:
                self._quiet.say(logging.WARNING, topic, "mqtt: %s", refused)

    async def _listen(self, client: aiomqtt.Client) -> None:
        """Ends when the connection does, and says so at once; what arrives goes to `_on_message`."""
        try:
            async for _ in client.messages:
                pass
        except aiomqtt.MqttError as error:
            cause = error.__cause__ or error
            self._fail(LostConnection("connection lost", str(cause)))

    def _on_message(self, topic: str, payload: bytes, retained: bool) -> None:
        """Never raises: a command that cannot be done must not cost those that follow it."""
        try:
            if topic == self._status_topic:
                self._on_status(payload, retained)
            elif topic == self._instance_topic:
                self._on_instance(payload, retained)
            elif (command := self._commands.get(topic)) is not None:
                command(payload, retained)
        except Exception as error:
            self._commands_failed += 1
            text = "mqtt: a message on %s could not be taken: %s: %s"
            self._quiet.say(logging.ERROR, f"command {type(error).__name__}", text, topic, type(error).__name__, error)

    def _on_status(self, payload: bytes, retained: bool) -> None:
        if payload != ONLINE and not retained and self.connected and not self._stopping.is_set():
            # the will of a connection that the broker has given up late, somebody's who went, or who cleared it
            self._changed[self._status_topic] = None
            self._wake.set()

    def _on_instance(self, payload: bytes, retained: bool) -> None:
        self._reconnect.heard_instance(payload, retained=retained)
        if (
            payload != self._retained[self._instance_topic]
            and self.connected
            and not (retained or self._stopping.is_set())
        ):
            # somebody spoke as this tool, and may have gone again: ours is the last word while we are here
            self._changed[self._instance_topic] = None
            self._wake.set()

    def _fail(self, lost: LostConnection) -> None:
        if self._lost is None:
            self._lost = lost
        self._wake.set()

    async def _publish_birth(self, client: aiomqtt.Client) -> None:
        for topic, payload in self._on_connect_payloads():
            self._retained[topic] = payload
        self._changed.clear()
        # the status is the first of them
        for topic, payload in list(self._retained.items()):
            await self._publish(client, topic, payload, qos=1, retain=True)

    async def _send_until_lost(self, client: aiomqtt.Client) -> None:
        """Keep the window full. Returns when asked to stop, raises `LostConnection` when the connection is."""
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
        for topic in [topic for topic in self._changed if topic not in self._under_way]:
            del self._changed[topic]
            self._under_way.add(topic)
            self._start(self._send_value(client, topic, self._retained[topic], retain=True))

    def _send_what_can_wait(self, client: aiomqtt.Client) -> None:
        """The live messages have left room: values of the moment, and one answer at a time."""
        for topic in [topic for topic in self._passing if topic not in self._under_way]:
            self._under_way.add(topic)
            self._start(self._send_value(client, topic, self._passing.pop(topic), retain=False))
        if not self._replying and (reply := self._replies.first) is not None:
            self._replying = True
            self._start(self._send_reply(client, reply))

    def _fill_window(self, client: aiomqtt.Client) -> None:
        settings = self._settings
        self._pace.grow()
        room = settings.in_flight - len(self._pending)
        self._more = True
        while len(self._in_flight) < room and self._lost is None:
            free = self._backlog_in_flight < self._backlog_slots and self._pace.allowance >= 1.0
            taken = self._outbox.take(backlog=free)
            if taken is None:
                self._more = not free
                break
            self._send(*taken)
        if len(self._in_flight) < room:
            self._send_what_can_wait(client)

    def _on_put(self, client: aiomqtt.Client) -> None:
        """A new message is sent in the callback that made it, unless something is to be looked at first."""
        if self._lost is None and not self._stopping.is_set():
            self._fill_window(client)

    def _start(self, work: Coroutine[None, None, None]) -> None:
        # tasks begin in the order of their making, so publishes keep theirs
        task = asyncio.create_task(work)
        self._pending.add(task)
        task.add_done_callback(self._pending.discard)

    def _send(self, row: StoredMessage, historical: bool) -> None:
        payload = mark_historical(row.payload) if historical else row.payload
        self._pace.allowance -= historical
        try:
            self._in_flight.send(row.topic, payload, row.qos, partial(self._acknowledged, row.id, historical))
        except LostConnection as lost:
            self._fail(lost)
        except ValueError as error:
            # a topic or size that the protocol cannot carry would be refused for ever, and block what follows
            text = "mqtt: a message on %r cannot be sent (%s) and is dropped"
            self._quiet.say(logging.ERROR, row.topic, text, row.topic, error)
            self._outbox.discard(row.id, "refused")
        else:
            self._backlog_in_flight += historical

    def _acknowledged(self, row_id: int, historical: bool) -> None:
        self._outbox.ack(row_id)
        self._backlog_in_flight -= historical
        if self._more:
            self._wake.set()

    async def _send_value(self, client: aiomqtt.Client, topic: str, payload: bytes, *, retain: bool) -> None:
        try:
            await self._settle(client, topic, payload, qos=1 if retain else 0, retain=retain)
        finally:
            self._under_way.discard(topic)
            self._wake.set()

    async def _send_reply(self, client: aiomqtt.Client, reply: QueuedReply) -> None:
        try:
            if await self._settle(client, reply.topic, reply.payload, qos=1, retain=False):
                self._replies.sent(reply)
        finally:
            self._replying = False
            self._wake.set()

    async def _settle(self, client: aiomqtt.Client, topic: str, payload: bytes, *, qos: int, retain: bool) -> bool:
        """Send and wait for the PUBACK. False if the connection was lost; what can never be sent is dropped."""
        try:
            await self._publish(client, topic, payload, qos=qos, retain=retain)
        except LostConnection as lost:
            self._fail(lost)
            return False
        except ValueError as error:
            text = "mqtt: the message on %r cannot be sent (%s) and is dropped"
            self._quiet.say(logging.ERROR, topic, text, topic, error)
            self._retained.pop(topic, None)
        return True

    async def _publish(self, client: aiomqtt.Client, topic: str, payload: bytes, *, qos: int, retain: bool) -> None:
        await publish(client, topic, payload, qos=qos, retain=retain, timeout_s=self._settings.ack_timeout_s)

    async def _farewell(self, client: aiomqtt.Client) -> None:
        self._send_changed(client)  # the last health, with the final counts
        loop = asyncio.get_running_loop()
        left_s = self._stop_deadline_s - loop.time()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(max(left_s, 0.0)):
                await asyncio.gather(*self._pending, self._in_flight.emptied(), return_exceptions=True)
                # of what was under way when its last value came that is sent now
                self._send_changed(client)
                await asyncio.gather(*self._pending, return_exceptions=True)
        gone = instance_word(OFFLINE, self.instance)
        await self._publish(client, self._instance_topic, gone, qos=1, retain=True)
        await self._publish(client, self._status_topic, OFFLINE, qos=1, retain=True)
