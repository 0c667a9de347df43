"""Broker faults against real mosquitto at 100 messages a second: nothing lost, order kept, state back.

The scenarios run at the same time, each with its own broker, outbox and publisher, because most of their time is
waiting. The broker of the outage is configured with the file that is shipped (users, ACL, persistence). A watcher
counts independently, with a connection of its own to the broker. Where a broker forgets its subscribers, the proxy
lets the publisher in only when the watcher has subscribed again: what a broker takes while nobody listens is not the
publisher's loss.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiomqtt
import psutil
import pytest
from broker import Mosquitto, Proxy, Subscriber, free_port, shipped_config

from highside.config.mqtt import MqttSettings
from highside.service.messages import AttitudeMessage, BrokerHealth, attitude_payload
from highside.service.outbox import Outbox, OutboxStats
from highside.service.outputs import AttitudeOutput
from highside.service.publisher import Publisher

TOOL = "rig7"
PREFIX = f"highside/{TOOL}"
TOPIC = f"{PREFIX}/attitude"
RATE_HZ = 100.0
ATTITUDE = AttitudeOutput(
    0.0, 0.0, 12.5, 0.01, 271.5, 0.2, 271.5, 0.0, 1.0001, 1e-4, "identity", "", ("uncalibrated",), 10, 0.1, 25.0
)

pytestmark = [pytest.mark.slow, pytest.mark.timing]


@dataclass
class Outcome:
    """What one scenario left behind."""

    produced: int = 0
    received: list[AttitudeMessage] = field(default_factory=list)
    statuses: list[tuple[float, str, bool]] = field(default_factory=list)
    marks: dict[str, float] = field(default_factory=dict)
    put_costs_s: list[float] = field(default_factory=list)
    delays_s: list[float] = field(default_factory=list)
    outbox: OutboxStats | None = None
    publisher: BrokerHealth | None = None
    extra: dict[str, Any] = field(default_factory=dict)


class Rig:
    """Producer, outbox and publisher on one side, proxy and broker on the other, and the watcher."""

    def __init__(self, folder: Path, mosquitto: Mosquitto, proxy: Proxy, **mqtt: Any) -> None:
        self.outcome = Outcome()
        self.mosquitto, self.proxy = mosquitto, proxy
        settings = MqttSettings(port=proxy.port, **mqtt)
        self.outbox = Outbox(
            folder / "outbox.sqlite",
            max_rows=1_000_000,
            max_age_s=1e6,
            max_bytes=1 << 30,
            historical_after_s=settings.historical_after_s,
        )
        self.publisher = Publisher(settings, self.outbox, tool_id=TOOL)
        self._producing = True

    async def produce(self) -> None:
        """100 messages a second, whatever the broker does; a health message (retained) each second."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while self._producing:
            seq = self.outbox.next_seq(TOPIC)
            now = time.time()
            payload = attitude_payload(seq, now, time.monotonic(), True, ATTITUDE)
            began = time.perf_counter()
            self.outbox.put(TOPIC, payload, created_s=now)
            self.outcome.put_costs_s.append(time.perf_counter() - began)
            self.outcome.produced += 1
            if seq % 100 == 0:
                self.publisher.retained(f"{PREFIX}/health", b'{"n": %d}' % seq)
            due += 1.0 / RATE_HZ
            await asyncio.sleep(max(due - loop.time(), 0.0))

    def stop_producing(self) -> None:
        self._producing = False

    def mark(self, name: str) -> None:
        self.outcome.marks[name] = time.monotonic()


@contextlib.asynccontextmanager
async def rig(folder: Path, mosquitto: Mosquitto, watcher: Subscriber, **mqtt: Any) -> AsyncIterator[Rig]:
    async with Proxy(mosquitto.port) as proxy, watcher.running():
        made = Rig(folder, mosquitto, proxy, **mqtt)
        await asyncio.to_thread(made.outbox.start)
        producer = asyncio.create_task(made.produce())
        sender = asyncio.create_task(made.publisher.run())
        try:
            yield made
            made.stop_producing()
            await producer
            everything = set(range(made.outcome.produced))
            await watcher.wait_for(lambda: {m["seq"] for _, m in watcher.messages} >= everything, 20.0)
            for _ in range(500):
                if not made.outbox.stats.queued:
                    break
                await asyncio.sleep(0.02)
        finally:
            producer.cancel()
            await made.publisher.stop(5.0)
            sender.cancel()
            await asyncio.gather(producer, sender, return_exceptions=True)
            await asyncio.to_thread(made.outbox.stop, 10.0)
        await watcher.wait_for(lambda: watcher.statuses[-1][1] == "offline", 3.0)
        outcome = made.outcome
        outcome.received = [AttitudeMessage.model_validate(m) for name, m in watcher.messages if name == "attitude"]
        outcome.statuses = watcher.statuses
        outcome.outbox, outcome.publisher = made.outbox.stats, made.publisher.stats
        outcome.extra["retained"] = watcher.retained


async def outage(folder: Path, project_root: Path) -> Outcome:
    """SIGKILL of the broker, 30 s without one, the same broker again with what it had on disk."""
    port = free_port()
    config = shipped_config(project_root, folder, port, {TOOL: "pass word", "reader": "r"})
    watcher = Subscriber(port, PREFIX, username="reader", password="r")
    with Mosquitto(folder, config=config, port=port) as mosquitto:
        async with rig(folder, mosquitto, watcher, username=TOOL, password_file=folder / "password") as made:
            await asyncio.sleep(3.0)
            made.mark("killed")
            mosquitto.kill()
            made.proxy.cut()
            await asyncio.sleep(30.0)
            # a broker acknowledges what it has no subscriber for: on a busy machine, too, the watcher comes first
            made.proxy.refusing = True
            watcher.subscribed.clear()
            await asyncio.to_thread(mosquitto.start)
            await asyncio.wait_for(watcher.subscribed.wait(), 20.0)
            made.proxy.refusing = False
            made.mark("back")
            await asyncio.sleep(6.0)
        return made.outcome


async def black_hole(folder: Path) -> Outcome:
    """For 16 s the network takes everything and delivers nothing; no connection is closed."""
    with Mosquitto(folder) as mosquitto:
        watcher = Subscriber(mosquitto.port, PREFIX)
        async with rig(folder, mosquitto, watcher) as made:
            await asyncio.sleep(3.0)
            made.mark("silent")
            made.proxy.fall_silent()
            await asyncio.sleep(16.0)
            made.proxy.speak()
            made.mark("speaks")
            await asyncio.sleep(6.0)
        return made.outcome


async def restarted_empty(folder: Path) -> Outcome:
    """Three times a SIGKILL and a new broker that knows nothing, neither sessions nor retained messages."""
    with Mosquitto(folder) as mosquitto:
        watcher = Subscriber(mosquitto.port, PREFIX)
        late: list[tuple[float, set[str]]] = []
        async with rig(folder, mosquitto, watcher) as made:
            for _ in range(3):
                await asyncio.sleep(2.0)
                made.proxy.refusing = True
                mosquitto.kill()
                made.proxy.cut()
                await asyncio.sleep(1.0)
                watcher.subscribed.clear()
                await asyncio.to_thread(mosquitto.start)
                await asyncio.wait_for(watcher.subscribed.wait(), 10.0)
                began = time.monotonic()
                made.proxy.refusing = False
                late.append(await retained_state(mosquitto.port, began))
            await asyncio.sleep(2.0)
        made.outcome.extra["back"] = late
        return made.outcome


async def retained_state(port: int, began: float) -> tuple[float, set[str]]:
    """How long after `began` a newcomer finds status and health among the retained messages."""
    while True:
        found: dict[str, bytes] = {}
        async with aiomqtt.Client("127.0.0.1", port) as client:
            await client.subscribe(f"{PREFIX}/+", qos=1)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.1):
                    async for message in client.messages:
                        if message.retain:
                            found[str(message.topic).removeprefix(f"{PREFIX}/")] = bytes(message.payload)
        took = time.monotonic() - began
        if found.keys() >= {"status", "health"} or took > 10.0:
            assert found.get("status") == b"online"
            return took, set(found)


async def resets(folder: Path) -> Outcome:
    """The connection is reset twenty times, every other time with the port refused for a while."""
    with Mosquitto(folder) as mosquitto:
        watcher = Subscriber(mosquitto.port, PREFIX)
        # connections that live for less than a second are paused after: what waits for that is not yet history
        async with rig(folder, mosquitto, watcher, historical_after_s=60.0) as made:
            await asyncio.sleep(1.0)
            process = psutil.Process()
            descriptors = process.num_fds()
            for i in range(20):
                made.proxy.refusing = i % 2 == 0
                made.proxy.cut()
                await asyncio.sleep(0.3)
                made.proxy.refusing = False
                await asyncio.sleep(0.7)
            made.outcome.extra["descriptors"] = (descriptors, process.num_fds())
        return made.outcome


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Iterator[dict[str, Outcome]]:
    folder = tmp_path_factory.mktemp("brokers")

    (folder / "outage").mkdir()
    (folder / "outage" / "password").write_text("pass word\n")

    async def together() -> dict[str, Outcome]:
        found = await asyncio.gather(
            outage(folder / "outage", project_root),
            black_hole(folder / "black_hole"),
            restarted_empty(folder / "restarted_empty"),
            resets(folder / "resets"),
        )
        return dict(zip(SCENARIOS, found, strict=True))

    yield asyncio.run(together())
    shutil.rmtree(folder, ignore_errors=True)


SCENARIOS = ["outage", "black_hole", "restarted_empty", "resets"]


def first_deliveries(received: list[AttitudeMessage], *, historical: bool) -> list[int]:
    """Sequence numbers of one stream, repetitions left out."""
    seen: set[int] = set()
    order = []
    for message in received:
        if message.seq not in seen:
            seen.add(message.seq)
            if message.historical == historical:
                order.append(message.seq)
    return order


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_nothing_is_lost(outcomes: dict[str, Outcome], scenario: str) -> None:
    outcome = outcomes[scenario]
    lost = set(range(outcome.produced)) - {message.seq for message in outcome.received}
    repeated = len(outcome.received) - len({message.seq for message in outcome.received})
    print(f"{scenario}: {outcome.produced} produced, {len(lost)} lost, {repeated} repeated, {outcome.publisher}")
    assert outcome.produced > 1_000
    assert not lost
    assert outcome.outbox is not None
    assert outcome.outbox.balanced()
    assert outcome.outbox.dropped == {}
    assert outcome.outbox.queued == 0
    assert outcome.outbox.acknowledged == outcome.produced
    # at least once, but not wildly: a window a lost connection
    assert outcome.publisher is not None
    assert repeated <= 64 * outcome.publisher.connects


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_each_stream_keeps_its_order(outcomes: dict[str, Outcome], scenario: str) -> None:
    outcome = outcomes[scenario]
    live = first_deliveries(outcome.received, historical=False)
    backlog = first_deliveries(outcome.received, historical=True)
    assert live == sorted(live)
    assert backlog == sorted(backlog)
    if scenario in ("outage", "black_hole"):
        assert len(backlog) > 500
        # what is measured after the fault does not wait for the backlog
        assert live[-1] == outcome.produced - 1


def test_a_broker_that_is_away_for_a_moment_leaves_one_ordered_stream(outcomes: dict[str, Outcome]) -> None:
    outcome = outcomes["resets"]
    assert first_deliveries(outcome.received, historical=False) == list(range(outcome.produced))


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_producer_is_not_disturbed(outcomes: dict[str, Outcome], scenario: str) -> None:
    costs = sorted(outcomes[scenario].put_costs_s)
    p999 = costs[int(0.999 * len(costs))]
    median = costs[len(costs) // 2]
    print(f"{scenario}: put {median * 1e6:.1f} us, p99.9 {p999 * 1e6:.0f} us, slowest {costs[-1] * 1e3:.2f} ms")
    # ten times the median on a machine that was busy with other tests (202 us, 29 November 2026)
    assert median < 2e-3
    assert p999 < 0.05


def test_the_last_will_is_seen_when_the_network_swallows_everything(outcomes: dict[str, Outcome]) -> None:
    outcome = outcomes["black_hole"]
    wills = [t for t, word, _ in outcome.statuses if word == "offline"]
    silent, speaks = outcome.marks["silent"], outcome.marks["speaks"]
    assert any(silent < t < speaks for t in wills), (outcome.statuses, outcome.marks)
    back = [t for t, word, _ in outcome.statuses if word == "online" and t > speaks]
    assert back[0] - speaks < 5.0
    print(f"will {wills[0] - silent:.1f} s into the silence, online {back[0] - speaks:.2f} s after it")
    # the last word before the farewell is `online`: no will of an old connection came after the birth of the new
    assert [word for _, word, _ in outcome.statuses][-2:] == ["online", "offline"]


def test_birth_and_retained_state_are_back_within_two_seconds(outcomes: dict[str, Outcome]) -> None:
    back = outcomes["restarted_empty"].extra["back"]
    assert len(back) == 3
    for took_s, topics in back:
        print(f"retained {sorted(topics)} back after {took_s:.2f} s")
        assert topics >= {"status", "health"}
        assert took_s < 2.0
    outage = outcomes["outage"]
    online = [t for t, word, _ in outage.statuses if word == "online" and t > outage.marks["back"]]
    print(f"after the outage: online after {online[0] - outage.marks['back']:.2f} s")
    assert online[0] - outage.marks["back"] < 2.0


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_farewell_is_retained(outcomes: dict[str, Outcome], scenario: str) -> None:
    assert outcomes[scenario].statuses[-1][1] == "offline"


def test_reconnecting_leaks_no_descriptor(outcomes: dict[str, Outcome]) -> None:
    before, after = outcomes["resets"].extra["descriptors"]
    # the other scenarios open and close a few at the same time
    assert after - before <= 8
