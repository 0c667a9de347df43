"""Messages that were given to the broker and have no PUBACK yet.

Each costs one call when it is sent and one when it is acknowledged: the library's own `publish` waits in two tasks and
with a timer for each message, which takes six turns of the event loop. The time allowed for an answer is that of the
oldest; one timer looks after all of them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import aiomqtt
import paho.mqtt.client as mqtt

from highside.service.broker_client import LostConnection


class InFlight:
    """Belongs to the event loop's thread. `on_lost` is told once an acknowledgement has not come in `timeout_s`."""

    def __init__(self, timeout_s: float, on_lost: Callable[[LostConnection], None]) -> None:
        self._timeout_s = timeout_s
        self._on_lost = on_lost
        self._paho: mqtt.Client | None = None
        self._sent: dict[int, tuple[float, Callable[[], None]]] = {}
        """by the protocol's number, oldest first: until when the answer must have come, and who is told of it"""
        self._timer: asyncio.TimerHandle | None = None
        self._emptied: asyncio.Future[None] | None = None

    def __len__(self) -> int:
        return len(self._sent)

    def begin(self, client: aiomqtt.Client) -> None:
        """Send with this client, which is connected, until `end`."""
        self.end()
        paho = self._paho = client._client
        others = client._on_publish

        def on_publish(sender: mqtt.Client, userdata: Any, number: int, reason: Any, properties: Any) -> None:
            sent = self._sent.pop(number, None) if sender is self._paho else None
            if sent is None:
                others(sender, userdata, number, reason, properties)
                return
            sent[1]()
            if not self._sent and self._emptied is not None and not self._emptied.done():
                self._emptied.set_result(None)

        paho.on_publish = on_publish

    def end(self) -> None:
        """The connection is gone: nobody is told of what was sent with it."""
        self._paho = None
        self._sent.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def send(self, topic: str, payload: bytes, qos: int, done: Callable[[], None]) -> None:
        """Send, and call `done` with the acknowledgement (QoS 0: when it is written). Raises `LostConnection` if the
        connection is of no more use, ValueError for what the protocol cannot carry."""
        if self._paho is None:
            raise LostConnection("connection lost", "not connected")
        info = self._paho.publish(topic, payload, qos)
        if info.rc != mqtt.MQTT_ERR_SUCCESS:
            raise LostConnection("connection lost", str(aiomqtt.MqttCodeError(info.rc, "Could not publish message")))
        if info.is_published():
            done()
            return
        loop = asyncio.get_running_loop()
        until_s = loop.time() + self._timeout_s
        self._sent[info.mid] = until_s, done
        if self._timer is None:
            self._timer = loop.call_at(until_s, self._look)

    async def emptied(self) -> None:
        """Wait until everything is acknowledged."""
        if self._sent:
            self._emptied = asyncio.get_running_loop().create_future()
            await self._emptied

    def _look(self) -> None:
        """Whether the oldest has waited too long; else until when it may."""
        self._timer = None
        if not self._sent:
            return
        loop = asyncio.get_running_loop()
        until_s, _ = next(iter(self._sent.values()))
        if until_s <= loop.time():
            self._on_lost(LostConnection("no acknowledgement", "Operation timed out"))
        else:
            self._timer = loop.call_at(until_s, self._look)
