"""The mosquitto configuration that is shipped, in a real mosquitto: who may do what, and what it keeps."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import aiomqtt
import pytest
from broker import Mosquitto, free_port, shipped_config

USERS = {"rig7": "seven", "rig8": "eight", "reader": "reads", "operator": "acts", "stranger": "nothing"}


@pytest.fixture
def mosquitto(tmp_path: Path, project_root: Path) -> Iterator[Mosquitto]:
    port = free_port()
    config = shipped_config(project_root, tmp_path, port, USERS)
    with Mosquitto(tmp_path, config=config, port=port) as broker:
        yield broker


@contextlib.asynccontextmanager
async def client(
    broker: Mosquitto, user: str, *, identifier: str | None = None, durable: bool = False
) -> AsyncIterator[aiomqtt.Client]:
    async with aiomqtt.Client(
        "127.0.0.1",
        broker.port,
        username=user,
        password=USERS[user],
        identifier=identifier,
        clean_session=not durable,
        max_inflight_messages=200,
    ) as connected:
        connected.pending_calls_threshold = 10_000
        yield connected


async def receive(connected: aiomqtt.Client, n: int, *, quiet_s: float) -> list[tuple[str, bytes]]:
    """Up to `n` messages; ends when nothing comes for `quiet_s`."""
    found: list[tuple[str, bytes]] = []
    with contextlib.suppress(TimeoutError):
        while len(found) < n:
            message = await asyncio.wait_for(anext(aiter(connected.messages)), quiet_s)
            found.append((str(message.topic), bytes(message.payload)))
    return found


async def publish_all(connected: aiomqtt.Client, topic: str, first: int, n: int) -> float:
    """Publish numbers with up to 64 under way, as the publisher does; returns how long the acknowledgements took."""
    began = time.monotonic()
    for chunk in range(first, first + n, 64):
        numbers = range(chunk, min(chunk + 64, first + n))
        await asyncio.gather(*(connected.publish(topic, b"%d" % i, qos=1) for i in numbers))
    return time.monotonic() - began


async def test_nobody_comes_in_without_a_password(mosquitto: Mosquitto) -> None:
    for user, password in ((None, None), ("rig7", "wrong"), ("unknown", "seven")):
        with pytest.raises(aiomqtt.MqttError, match="Not authorized"):
            async with aiomqtt.Client("127.0.0.1", mosquitto.port, username=user, password=password):
                pass


async def test_each_user_does_its_own_part_alone(mosquitto: Mosquitto) -> None:
    async with (
        client(mosquitto, "reader") as reader,
        client(mosquitto, "rig7") as rig7,
        client(mosquitto, "rig8") as rig8,
        client(mosquitto, "stranger") as stranger,
    ):
        await reader.subscribe("#", qos=1)
        await rig8.subscribe("highside/#", qos=1)
        await stranger.subscribe("#", qos=1)
        # denied publishes are acknowledged and thrown away, as MQTT 3.1.1 wants it
        await reader.publish("highside/rig7/attitude", b"forged by reader", qos=1)
        await rig8.publish("highside/rig7/attitude", b"forged by rig8", qos=1)
        await stranger.publish("highside/rig7/attitude", b"forged by stranger", qos=1)
        await rig7.publish("elsewhere", b"outside", qos=1)
        await rig7.publish("highside/rig7/attitude", b"true", qos=1)
        await rig7.publish("highside/rig7/session/state", b"deep", qos=1)
        assert await receive(reader, 9, quiet_s=0.5) == [
            ("highside/rig7/attitude", b"true"),
            ("highside/rig7/session/state", b"deep"),
        ]
        await rig8.publish("highside/rig8/attitude", b"own", qos=1)
        assert await receive(rig8, 9, quiet_s=0.5) == [("highside/rig8/attitude", b"own")]
        # a user has what is below its own name and nothing else
        assert await receive(stranger, 9, quiet_s=0.3) == []


async def test_commands_reach_the_tool_and_nobody_else(mosquitto: Mosquitto) -> None:
    """A command to a session may carry the secret of who holds it: neither readers nor other operators hear it."""
    async with (
        client(mosquitto, "reader") as reader,
        client(mosquitto, "operator", identifier="first") as operator,
        client(mosquitto, "operator", identifier="second") as other,
        client(mosquitto, "rig7") as rig7,
    ):
        for listener in (reader, other):
            await listener.subscribe("#", qos=1)
            await listener.subscribe("highside/rig7/session/command", qos=1)
        await rig7.subscribe("highside/rig7/session/command", qos=1)
        await operator.subscribe("highside/+/session/reply", qos=1)
        await operator.publish("highside/rig7/session/command", b"secret", qos=1)
        await operator.publish("highside/rig7/attitude", b"forged", qos=1)
        assert await receive(rig7, 9, quiet_s=1.0) == [("highside/rig7/session/command", b"secret")]
        await rig7.publish("highside/rig7/session/reply", b"done", qos=1)
        reply = [("highside/rig7/session/reply", b"done")]
        assert await receive(operator, 9, quiet_s=1.0) == reply
        for listener in (reader, other):
            assert await receive(listener, 9, quiet_s=0.5) == reply


async def test_an_absent_durable_subscriber_gets_all_that_was_acknowledged(mosquitto: Mosquitto) -> None:
    async with client(mosquitto, "reader", identifier="archive", durable=True) as archive:
        await archive.subscribe("highside/#", qos=1)
    async with client(mosquitto, "rig7") as tool:
        took_s = await publish_all(tool, "highside/rig7/attitude", 0, 2_600)
    # the broker's own default keeps 1,000
    print(f"2,600 messages acknowledged for an absent subscriber in {took_s:.1f} s: {2_600 / took_s:.0f}/s")
    async with client(mosquitto, "reader", identifier="archive", durable=True) as archive:
        found = await receive(archive, 2_600, quiet_s=3.0)
    assert [int(payload) for _, payload in found] == list(range(2_600))


@pytest.mark.parametrize(("settle_s", "may_be_lost"), [(0.0, 1), (0.3, 0)])
async def test_what_was_acknowledged_survives_a_kill_of_the_broker(
    mosquitto: Mosquitto, settle_s: float, may_be_lost: int
) -> None:
    """The database is saved at the end of a turn of the broker's loop: a kill right after a PUBACK may come first."""
    kills = 4
    async with client(mosquitto, "reader", identifier="archive", durable=True) as archive:
        await archive.subscribe("highside/#", qos=1)
    acknowledged = 0
    for _ in range(kills):
        async with client(mosquitto, "rig7") as tool:
            await tool.publish("highside/rig7/health", b"%d" % acknowledged, qos=1, retain=True)
            await publish_all(tool, "highside/rig7/attitude", acknowledged, 200)
            acknowledged += 200
            await asyncio.sleep(settle_s)
            mosquitto.kill()
            with contextlib.suppress(aiomqtt.MqttError):
                # the connection is noticed to be gone before the client is left
                await asyncio.wait_for(anext(aiter(tool.messages)), 2.0)
        await asyncio.to_thread(mosquitto.start)
    async with client(mosquitto, "reader") as newcomer:
        await newcomer.subscribe("highside/rig7/health", qos=1)
        assert await receive(newcomer, 1, quiet_s=2.0) == [("highside/rig7/health", b"%d" % (acknowledged - 200))]
    async with client(mosquitto, "reader", identifier="archive", durable=True) as archive:
        found = await receive(archive, 2 * acknowledged, quiet_s=2.0)
    numbers = [int(payload) for topic, payload in found if topic.endswith("attitude")]
    lost = acknowledged - len(set(numbers))
    print(f"{kills} kills {settle_s} s after the last PUBACK: {acknowledged} acknowledged, {lost} lost")
    assert lost <= may_be_lost * kills
    assert numbers == sorted(numbers)
