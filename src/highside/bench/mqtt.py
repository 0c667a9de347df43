"""The MQTT face of a bench session: state out, commands in, a reply to each.

    <prefix>/<tool>/session/state     retained: the newest snapshot, `rate_hz` a second at most
    <prefix>/<tool>/session/command   a Command (JSON) with its `request_id` and `operator`; QoS 1
    <prefix>/<tool>/session/reply     a Reply (JSON) with the `request_id` of the command
    <prefix>/<tool>/session/status    retained: `online`, or `offline` by farewell or last will

After the end, while the bench command stays (until Ctrl-C), `activate` and `rollback` put the calibration in force or
take that back: {"name": "activate", "confirm": "<first digits of the record's id>", ...}.

A command that was retained is not obeyed: nobody knows how old it is. One that the broker delivers twice is done once
(the session knows its `request_id`). Who may publish commands is the broker's access list. Who holds the session among
them is the session's business: whoever gives `start` or `resume` may choose a `secret` (16 characters or more) and send
it with every command; from then on only commands with it are theirs. A session that was taken at the bench obeys
nothing from the broker, whatever name a command bears. A broker that is away costs this face and nothing else: it
connects again for ever, and publishes the present state first.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random

import aiomqtt

from highside.bench.session.commands import Origin
from highside.bench.session.driver import SessionDriver
from highside.bench.session.snapshot import Command, Reply, Snapshot
from highside.config.mqtt import MqttSettings
from highside.errors import InputError
from highside.reading import parse_message, text_member
from highside.service.broker_client import broker_client
from highside.service.messages import OFFLINE, ONLINE, WORDS
from highside.service.quiet_log import QuietLog
from highside.service.reconnect import Reconnect
from highside.service.replies import TokenBucket
from highside.service.tasks import ended
from highside.service.topics import Topic

log = logging.getLogger(__name__)

RATE_HZ = 2.0
PAYLOAD_MAX = 10_000
"""Bytes of a command; more is none."""
TEXT_MAX = 400
"""Characters of a refusal."""
FAREWELL_S = 1.0
WAITING_MAX = 64
"""Commands that wait to be done, one by one; more are thrown away by the client library. An operator sends one and
waits for its answer."""
REFUSALS_PER_S = 5.0
REFUSALS_AT_ONCE = 20
"""Commands refused without an operator's word being weighed (malformed, retained) are answered at this rate; beyond,
they are counted. What an operator asks is always answered."""
SESSION_TOPICS: tuple[Topic, ...] = (
    Topic("session/state", "The newest snapshot of a bench session, twice a second at most.", Snapshot, retained=True),
    Topic("session/command", "A command to the session; one that is retained is not obeyed.", Command, to_us=True),
    Topic("session/reply", "The answer to each command.", Reply),
    Topic(
        "session/status", "Whether the session speaks; last will and farewell `offline`.", WORDS[0][1], retained=True
    ),
)
"""What `highside calibrate bench` with `[mqtt]` sends and obeys."""

RETAINED = "retained"
MALFORMED = "malformed"
FAILED = "failed"


class SessionMqtt:
    """`run` is the task; it ends when the session is no longer open."""

    def __init__(
        self, driver: SessionDriver, settings: MqttSettings, *, tool_id: str, rate_hz: float = RATE_HZ
    ) -> None:
        self._driver = driver
        self._settings = settings
        self._identifier = f"{settings.client_id or f'highside-{tool_id}'}-session"
        self._rate_hz = rate_hz
        self._topics = {name: settings.topic(tool_id, f"session/{name}") for name in ("state", "command", "reply")}
        self._status = settings.topic(tool_id, "session/status")
        self._refusals = TokenBucket(REFUSALS_PER_S, REFUSALS_AT_ONCE)
        self._quiet = QuietLog(log)
        self.connects = 0
        self.unanswered = 0

    async def run(self) -> None:
        """Connect, show and obey for as long as the session is open. Never raises for a broker that is away."""
        settings = self._settings
        pauses = Reconnect(
            self._identifier,
            "",
            min_s=settings.reconnect_min_s,
            max_s=settings.reconnect_max_s,
            rng=random.Random(),
        )
        while self._driver.open:
            try:
                await self._one_connection(pauses)
            except Exception as error:  # whatever it was: this face connects again, the session goes on
                text = "session over mqtt: %s"
                self._quiet.say(logging.WARNING, type(error).__name__, text, error or type(error).__name__)
            pause_s = pauses.pause_s()
            if pauses.taken is not None:
                self._quiet.say(logging.ERROR, "taken", "session over mqtt: %s", pauses.taken)
            await asyncio.sleep(pause_s)

    async def _one_connection(self, pauses: Reconnect) -> None:
        will = aiomqtt.Will(self._status, OFFLINE, qos=1, retain=True)
        made = await broker_client(self._settings, self._identifier, will=will, max_queued_incoming=WAITING_MAX)
        async with made as client:
            self.connects += 1
            pauses.connected()
            await client.subscribe(self._topics["command"], qos=1)
            await client.publish(self._status, ONLINE, qos=1, retain=True)
            listening = asyncio.create_task(self._listen(client))
            showing = asyncio.create_task(self._show(client))
            try:
                done, _ = await asyncio.wait({listening, showing}, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
            finally:
                await ended(listening, showing)
                # whoever ends this task waits for it: time enough for the last state and a farewell
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    last = self._driver.snapshot().to_json()
                    await client.publish(self._topics["state"], last, qos=1, retain=True, timeout=FAREWELL_S)
                    await client.publish(self._status, OFFLINE, qos=1, retain=True, timeout=FAREWELL_S)

    async def _show(self, client: aiomqtt.Client) -> None:
        timeout = self._settings.ack_timeout_s
        async for snapshot in self._driver.subscribe(self._rate_hz):
            await client.publish(self._topics["state"], snapshot.to_json(), qos=1, retain=True, timeout=timeout)

    async def _listen(self, client: aiomqtt.Client) -> None:
        async for message in client.messages:
            payload = message.payload if isinstance(message.payload, bytes) else bytes(str(message.payload), "utf-8")
            reply = await self._obey(payload, retained=message.retain)
            if reply is None:
                continue
            await client.publish(
                self._topics["reply"], reply.model_dump_json(), qos=1, timeout=self._settings.ack_timeout_s
            )

    async def _obey(self, payload: bytes, *, retained: bool) -> Reply | None:
        """Do what a message requests, or say why not; None: one wrong message too many, it is only counted."""
        if retained:
            text = "A retained command is not obeyed: nobody knows how old it is. Publish it without retain."
            return self._refused(payload, RETAINED, text)
        try:
            command = parse_message(Command, payload, max_bytes=PAYLOAD_MAX)
        except InputError as error:
            return self._refused(payload, MALFORMED, f"That is no command: {error}.")
        try:
            return await self._driver.command(command, Origin.BROKER)
        except Exception as error:
            self._quiet.say(logging.ERROR, command.name, "session over mqtt: %s failed: %r", command.name, error)
            text = f"{command.name.capitalize()} failed ({type(error).__name__}): see the log of the bench."
            return self._refused(payload, FAILED, text)

    def _refused(self, payload: bytes, reason: str, text: str) -> Reply | None:
        if not self._refusals.take():
            self.unanswered += 1
            self._quiet.say(logging.WARNING, "refusals", "session over mqtt: more wrong commands than can be answered")
            return None
        snapshot = self._driver.snapshot()
        return Reply(
            request_id=text_member(payload, "request_id"),
            accepted=False,
            reason=reason,
            text=text[:TEXT_MAX],
            state=snapshot.state,
            seq=snapshot.seq,
        )
