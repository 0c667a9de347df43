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

import aiomqtt

from highside.config.mqtt import MqttSettings
from highside.errors import InputError
from highside.reading import parse_message, text_member
from highside.service.broker_client import broker_client
from highside.service.messages import OFFLINE, ONLINE
from highside.service.tasks import ended
from highside.session.commands import Origin
from highside.session.driver import SessionDriver
from highside.session.snapshot import Command, Reply

log = logging.getLogger(__name__)

RATE_HZ = 2.0
PAYLOAD_MAX = 10_000
"""Bytes of a command; more is none."""
FAREWELL_S = 1.0
RETAINED = "retained"
MALFORMED = "malformed"


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
        self.connects = 0

    async def run(self) -> None:
        """Connect, show and obey for as long as the session is open. Never raises for a broker that is away."""
        wait_s = self._settings.reconnect_min_s
        while self._driver.open:
            before = self.connects
            try:
                await self._one_connection()
            except (aiomqtt.MqttError, TimeoutError, OSError, InputError, ValueError) as error:
                log.warning("session over mqtt: %s", error)
            wait_s = self._settings.reconnect_min_s if self.connects > before else wait_s
            await asyncio.sleep(wait_s)
            wait_s = min(2.0 * wait_s, self._settings.reconnect_max_s)

    async def _one_connection(self) -> None:
        will = aiomqtt.Will(self._status, OFFLINE, qos=1, retain=True)
        async with await broker_client(self._settings, self._identifier, will=will) as client:
            self.connects += 1
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
            await client.publish(
                self._topics["reply"], reply.model_dump_json(), qos=1, timeout=self._settings.ack_timeout_s
            )

    async def _obey(self, payload: bytes, *, retained: bool) -> Reply:
        """Do what a message asks for, or say why not."""
        if retained:
            text = "A retained command is not obeyed: nobody knows how old it is. Publish it without retain."
            return self._refused(payload, RETAINED, text)
        if len(payload) > PAYLOAD_MAX:
            return self._refused(b"", MALFORMED, f"A command has at most {PAYLOAD_MAX} bytes.")
        try:
            command = parse_message(Command, payload)
        except InputError as error:
            return self._refused(payload, MALFORMED, f"That is no command: {error}.")
        return await self._driver.command(command, Origin.BROKER)

    def _refused(self, payload: bytes, reason: str, text: str) -> Reply:
        snapshot = self._driver.snapshot()
        return Reply(
            request_id=text_member(payload, "request_id"), accepted=False, reason=reason, text=text,
            state=snapshot.state, seq=snapshot.seq,
        )  # fmt: skip
