"""The doctor at the broker: whether it answers, what a running service says of itself there, how much it keeps.

Nothing is published unless the queue is to be tried: then with messages on a topic of their own below the tool's, which
every subscriber of the tool sees. They are fetched again.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator

import aiomqtt

from highside.config.mqtt import MqttSettings
from highside.config.settings import Settings
from highside.errors import HighsideError, InputError
from highside.reading import parse_message
from highside.service.broker_client import broker_client
from highside.service.findings import CheckResult, Level
from highside.service.messages import HealthMessage

QUIET_S = 1.0
"""The broker has handed out everything when nothing came for so long."""
RETAINED_S = 2.0
"""A retained message comes at once after the subscription; one that has not come by then is not there."""
OLD_HEALTH_S = 30.0
"""A health message older than this, beyond its interval, is not of a service that is well."""


async def examine_broker(settings: Settings, *, running: bool, queue_messages: int) -> AsyncIterator[CheckResult]:
    """`running`: a service of this tool holds the state directory; `queue_messages` 0: the queue is not tried."""
    mqtt = settings.mqtt
    where = f"{mqtt.host}:{mqtt.port}" if mqtt.transport == "tcp" else mqtt.host
    identifier = f"highside-{settings.tool.id}-doctor"
    try:
        began = time.monotonic()
        async with asyncio.timeout(mqtt.connect_timeout_s + 1.0):
            async with await broker_client(mqtt, identifier):
                pass
    except (aiomqtt.MqttError, OSError, TimeoutError, ValueError, HighsideError) as error:
        yield CheckResult(
            "broker",
            Level.FAIL,
            f"{where}: {str(error) or 'no answer'}",
            "start it, or fix the [mqtt] table; meanwhile messages are kept on disk",
        )
        if running:
            yield CheckResult("health", Level.SKIP, "what the running service says of itself is at the broker")
        return
    yield CheckResult("broker", Level.OK, f"{where} answers, {1e3 * (time.monotonic() - began):.0f} ms")
    if running:
        for finding in await _reported_by_service(settings, identifier):
            yield finding
    if not queue_messages:
        yield CheckResult("broker queue", Level.SKIP, "not tried: --queue N publishes N messages for it")
        return
    yield await _queue(settings, identifier, queue_messages)


# --- what the running service says ---------------------------------------------------------------------------------


async def _reported_by_service(settings: Settings, identifier: str) -> list[CheckResult]:
    """From the retained `health`."""
    topic = settings.mqtt.topic(settings.tool.id, "health")
    try:
        payload = await _retained(settings.mqtt, identifier, topic)
        if payload is None:
            return [
                CheckResult(
                    "health", Level.SKIP, f"nothing is retained on {topic}", "allow this user to read that topic"
                )
            ]
        health = parse_message(HealthMessage, payload)
    except (aiomqtt.MqttError, OSError, TimeoutError) as error:
        return [CheckResult("health", Level.SKIP, f"{topic} cannot be read: {error}")]
    except InputError:
        return [CheckResult("health", Level.SKIP, f"{topic} is of another version of highside")]
    return list(judge_health(health, time.time(), settings.service.health_interval_s))


def judge_health(health: HealthMessage, now_s: float, interval_s: float) -> Iterator[CheckResult]:
    """What the health message of a running service says to whoever asks what is wrong."""
    age = now_s - health.t
    if age > interval_s + OLD_HEALTH_S:
        yield CheckResult(
            "health",
            Level.WARN,
            f"the last word of the running service is {age:.0f} s old",
            "look at its log: it cannot reach this broker, or stands still",
        )
    elif health.alarms:
        yield CheckResult(
            "health",
            Level.WARN,
            f"the running service reports {', '.join(health.alarms)}",
            "the retained `health` says more of each",
        )
    else:
        yield CheckResult("health", Level.OK, f"the running service (version {health.version}) reports no alarm")
    box = health.outbox
    if not box.storage_ok:
        yield CheckResult("outbox", Level.FAIL, f"cannot be written: {box.storage_error}", "free the disk, or fix it")


async def _retained(mqtt: MqttSettings, identifier: str, topic: str) -> bytes | None:
    """The retained message of a topic; None where there is none."""
    async with await broker_client(mqtt, identifier) as client:
        await client.subscribe(topic, qos=1)
        with contextlib.suppress(TimeoutError):
            message = await asyncio.wait_for(anext(aiter(client.messages)), RETAINED_S)
            return message.payload if isinstance(message.payload, bytes) else None
    return None


# --- how much it keeps ---------------------------------------------------------------------------------------------


async def _queue(settings: Settings, identifier: str, count: int) -> CheckResult:
    topic = settings.mqtt.topic(settings.tool.id, "doctor")
    try:
        async with asyncio.timeout(60.0):
            kept = await _queue_depth(settings, identifier, topic, count)
    except (aiomqtt.MqttError, OSError, TimeoutError) as error:
        return CheckResult(
            "broker queue",
            Level.WARN,
            f"could not be tried: {str(error) or 'no answer'}",
            f"allow this client to publish and subscribe {topic}",
        )
    text = f"keeps {kept:,} of {count:,} messages for a subscriber that is away"
    if kept < count:
        return CheckResult(
            "broker queue", Level.WARN, text, "raise max_queued_messages; config/mosquitto.conf shows how"
        )
    return CheckResult("broker queue", Level.OK, text)


async def _queue_depth(settings: Settings, identifier: str, topic: str, count: int) -> int:
    """How many of `count` messages a subscriber gets that was away when they were published."""
    mqtt = settings.mqtt
    subscriber = f"{identifier}-sub"
    async with await broker_client(mqtt, subscriber, clean_session=False) as client:
        await client.subscribe(topic, qos=1)
    try:
        async with await broker_client(mqtt, identifier) as client:
            for start in range(0, count, 50):
                await asyncio.gather(
                    *(client.publish(topic, str(i), qos=1) for i in range(start, min(start + 50, count)))
                )
        return await _fetch(settings, subscriber, count)
    finally:
        # a clean session forgets the subscription and what is still queued for it
        with contextlib.suppress(aiomqtt.MqttError, OSError, TimeoutError):
            async with await broker_client(mqtt, subscriber, clean_session=True):
                pass


async def _fetch(settings: Settings, subscriber: str, count: int) -> int:
    received: set[bytes] = set()
    async with await broker_client(settings.mqtt, subscriber, clean_session=False) as client:
        messages = aiter(client.messages)
        with contextlib.suppress(TimeoutError):
            while len(received) < count:
                message = await asyncio.wait_for(anext(messages), QUIET_S)
                if isinstance(message.payload, bytes):
                    received.add(message.payload)
    return len(received)
