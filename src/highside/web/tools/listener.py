"""Listens at the broker for what every tool publishes, and connects again whenever that ends."""

from __future__ import annotations

import asyncio
import logging
import random
import secrets
import time
from typing import Any

import aiomqtt

from highside.config.mqtt import MqttSettings
from highside.errors import InputError, Refused
from highside.reading import MALFORMED, parse_json
from highside.service.broker_client import (
    broker_client,
    connect_reason,
    notice_a_closed_door,
    on_each_message,
    write_only_while_open,
)
from highside.service.quiet_log import QuietLog
from highside.service.reconnect import Reconnect
from highside.web.tools.state import PAYLOAD_MAX, TOPICS, Tools

log = logging.getLogger("highside")

PACKET_MAX = PAYLOAD_MAX + 4096
"""Bytes of a packet that are kept: a payload and its topic; of a longer one the page counts that it is unreadable."""


class Listener:
    """Feeds `tools`; `connected` and `reason` say how it stands with the broker."""

    def __init__(self, settings: MqttSettings, tools: Tools) -> None:
        self._settings = settings
        self._tools = tools
        self._identifier = settings.client_id or f"highside-page-{secrets.token_hex(4)}"
        self._quiet = QuietLog(log)
        self._never_connected = True
        """in this attempt"""
        self.connected = False
        self.reason = "not connected yet"
        """why there is no connection; empty while there is one"""
        self._client: aiomqtt.Client | None = None
        self._asked: dict[str, tuple[str, asyncio.Future[dict[str, Any]]]] = {}
        self.since_mono = time.monotonic()
        """when the connection began or was lost"""

    async def run(self) -> None:
        """Connect and listen for ever. Never raises for a broker that is away, or a secret that cannot be read."""
        settings = self._settings
        pauses = Reconnect(
            self._identifier,
            "",
            min_s=settings.reconnect_min_s,
            max_s=settings.reconnect_max_s,
            rng=random.Random(),
        )
        while True:
            try:
                await self._one_connection(pauses)
            except Exception as error:  # whatever it was: the page says so, and connects again
                self._lost(error)
            await asyncio.sleep(pauses.pause_s())

    async def _one_connection(self, pauses: Reconnect) -> None:
        self._never_connected = True
        made = await broker_client(self._settings, self._identifier, incoming_max=PACKET_MAX)
        # before the first of them can arrive: what is retained comes with the answer to a subscription
        notice_a_closed_door(made)
        write_only_while_open(made)
        on_each_message(made, self._take)
        try:
            async with made as client:
                pauses.connected()
                prefix = self._settings.prefix
                granted = await client.subscribe([(f"{prefix}/+/{name}", 0) for name in TOPICS])
                if any(_code(code) >= 0x80 for code in granted):
                    raise _RefusedError(f"the broker refuses the subscription to {prefix}/+: see its access list")
                self._never_connected, self._client = False, client
                self.connected, self.reason, self.since_mono = True, "", time.monotonic()
                # ends, with an error, when the connection does; messages go to `_take` and not here
                async for _ in client.messages:
                    pass
        finally:
            self._client = None
            if self.connected:
                self.connected, self.since_mono = False, time.monotonic()

    async def ask(self, topic: str, payload: bytes, identifier: str, within_s: float) -> dict[str, Any]:
        """Publish a command below `topic` and wait for the answer that carries its id. Raises Refused where there is no
        connection, or no answer within that time."""
        client = self._client
        if client is None:
            raise Refused(f"no connection to the broker: {self.reason}")
        place = f"{self._settings.prefix}/{topic}"
        if len(self._asked) >= ASKED_MAX:
            raise Refused("too many commands at once: try again in a few seconds")
        answered: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._asked[identifier] = (f"{place}/reply", answered)
        try:
            async with asyncio.timeout(within_s):
                granted = await client.subscribe(f"{place}/reply", 0)
                if any(_code(code) >= 0x80 for code in granted):
                    raise Refused(f"the broker refuses the subscription to {place}/reply: see its access list")
                await client.publish(f"{place}/command", payload, qos=1)
                return await answered
        except TimeoutError:
            raise Refused(
                "the service gave no answer: it is away, or this page may not command at the broker"
            ) from None
        except aiomqtt.MqttError as error:
            raise Refused(
                f"the connection to the broker was lost ({error}): it is not known whether it was done"
            ) from None
        finally:
            del self._asked[identifier]

    def _answered(self, topic: str, payload: bytes) -> bool:
        """Whether this is an answer; who waits for it has it."""
        if not topic.endswith("/reply"):
            return False
        reply = _reply(payload)
        place, waiting = self._asked.get(str(reply.get("id")), (None, None))
        if place == topic and waiting is not None and not waiting.done():
            waiting.set_result(reply)
        return True

    def _take(self, topic: str, payload: bytes, retained: bool) -> None:
        try:
            if self._answered(topic, payload):
                return
            self._tools.take(topic, payload, retained=retained, mono=time.monotonic(), utc=time.time())
        except Exception as error:
            # a defect of ours must not end the client's loop
            self._quiet.say(logging.ERROR, "defect", "tools page: a message failed (%r)", error)

    def _lost(self, error: Exception) -> None:
        if isinstance(error, _RefusedError | InputError):
            self.reason = str(error)
        else:
            self.reason = connect_reason(error) if self._never_connected else "connection lost"
        where = f"{self._settings.host}:{self._settings.port}"
        self._quiet.say(logging.WARNING, self.reason, "tools page: broker %s: %s (%s)", where, self.reason, error)


ASKED_MAX = 20
"""Commands that wait for their answers."""


class _RefusedError(Exception):
    """The broker takes the connection and not the subscription."""


def _reply(payload: bytes) -> dict[str, Any]:
    """An answer; empty for what is none."""
    try:
        found = parse_json(payload)
    except (*MALFORMED, InputError):
        return {}
    return found if isinstance(found, dict) else {}


def _code(code: object) -> int:
    return code if isinstance(code, int) else int(getattr(code, "value", 0))
