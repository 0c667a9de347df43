"""The publisher beyond the network's faults: backlog beside live data, leaving, secrets, TLS, the demo's broker."""

from __future__ import annotations

import asyncio
import contextlib
import json
import statistics
import subprocess
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from broker import Mosquitto, Proxy, Subscriber, free_port, shipped_config

from highside.config.mqtt import MqttSettings, TlsSettings
from highside.service.outbox import Outbox
from highside.service.publisher import Publisher, Retained

TOOL = "rig7"
PREFIX = f"highside/{TOOL}"
TOPIC = f"{PREFIX}/attitude"


def make_outbox(path: Path, **changes: Any) -> Outbox:
    options: dict[str, Any] = {"max_rows": 1_000_000, "max_age_s": 1e7, "max_bytes": 1 << 30}
    return Outbox(path, **(options | changes))


def put(outbox: Outbox, *, created_s: float | None = None) -> None:
    now = time.time() if created_s is None else created_s
    payload = b'{"seq":%d,"sent":%.6f,"historical":false}' % (outbox.next_seq(TOPIC), time.monotonic())
    outbox.put(TOPIC, payload, created_s=now)


@contextlib.asynccontextmanager
async def sending(publisher: Publisher) -> AsyncIterator[None]:
    task = asyncio.create_task(publisher.run())
    try:
        yield
    finally:
        await publisher.stop(5.0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def until(condition: Any, timeout_s: float, what: str) -> None:
    for _ in range(int(timeout_s / 0.01)):
        if condition():
            return
        await asyncio.sleep(0.01)
    pytest.fail(f"did not happen within {timeout_s} s: {what}")


@pytest.mark.slow
@pytest.mark.timing
async def test_a_long_backlog_drains_while_live_messages_stay_in_time(tmp_path: Path) -> None:
    backlog = 8_000
    outbox = make_outbox(tmp_path / "outbox.sqlite", max_memory_rows=backlog)
    outbox.start()
    for _ in range(backlog):
        put(outbox, created_s=time.time() - 3600.0)
    await until(lambda: outbox.stats.committed == backlog, 30.0, "commit of the backlog")
    delays: list[float] = []

    def parse(payload: bytes) -> tuple[int, bool]:
        message = json.loads(payload)
        if not message["historical"]:
            delays.append(time.monotonic() - message["sent"])
        return message["seq"], message["historical"]

    with Mosquitto(tmp_path / "broker") as mosquitto:
        watcher = Subscriber(mosquitto.port, PREFIX, parse=parse)
        publisher = Publisher(MqttSettings(port=mosquitto.port), outbox, tool_id=TOOL)
        async with watcher.running(), sending(publisher):
            began = time.monotonic()
            live = 0
            while outbox.stats.queued > 5 and time.monotonic() - began < 60.0:
                put(outbox)
                live += 1
                await asyncio.sleep(0.02)
            took_s = time.monotonic() - began
            await watcher.wait_for(lambda: len(watcher.messages) >= backlog + live, 20.0)
    await asyncio.to_thread(outbox.stop, 10.0)
    late = [seq for _, (seq, historical) in watcher.messages if historical]
    fresh = [seq for _, (seq, historical) in watcher.messages if not historical]
    delays.sort()
    print(
        f"{backlog} messages of backlog in {took_s:.1f} s ({backlog / took_s:.0f}/s), meanwhile {live} live ones:"
        f" delay {statistics.median(delays) * 1e3:.0f} ms, p99 {delays[int(0.99 * len(delays))] * 1e3:.0f} ms"
    )
    assert late == list(range(backlog))
    assert fresh == list(range(backlog, backlog + live))
    assert live > 20
    assert delays[int(0.99 * len(delays))] < 1.0


@pytest.mark.timing
async def test_leaving_says_offline_and_keeps_what_is_not_acknowledged(tmp_path: Path) -> None:
    outbox = make_outbox(tmp_path / "outbox.sqlite", max_memory_rows=50_000)
    outbox.start()
    for _ in range(20_000):
        put(outbox, created_s=time.time() - 3600.0)
    with Mosquitto(tmp_path / "broker") as mosquitto:
        watcher = Subscriber(mosquitto.port, PREFIX)
        async with watcher.running():
            publisher = Publisher(
                MqttSettings(port=mosquitto.port),
                outbox,
                tool_id=TOOL,
                on_connect_payloads=lambda: [Retained(f"{PREFIX}/health", b"{}")],
            )
            task = asyncio.create_task(publisher.run())
            await until(lambda: outbox.stats.acknowledged > 500, 20.0, "sending")
            began = time.monotonic()
            await publisher.stop(5.0)
            await asyncio.wait_for(task, 1.0)
            await asyncio.to_thread(outbox.stop, 5.0)
            took_s = time.monotonic() - began
            assert await watcher.wait_for(
                lambda: [word for _, word, _ in watcher.statuses] == ["online", "offline"], 3.0
            )
            assert watcher.retained[0][1:] == ("health", b"{}")
    stats = outbox.stats
    print(f"left after {took_s:.2f} s with {stats.queued} messages kept")
    assert took_s < 5.0
    assert stats.queued > 0
    assert stats.balanced()
    again = make_outbox(tmp_path / "outbox.sqlite")
    again.start()
    assert again.stats.queued == stats.queued
    again.stop(5.0)


async def test_leaving_sends_the_last_of_a_value_that_was_still_under_way(tmp_path: Path) -> None:
    """The final counts of a service that is asked to end while its health of before is not acknowledged."""
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()
    with Mosquitto(tmp_path / "broker") as mosquitto:
        watcher = Subscriber(mosquitto.port, PREFIX)
        async with watcher.running(), Proxy(mosquitto.port) as proxy:
            publisher = Publisher(MqttSettings(port=proxy.port), outbox, tool_id=TOOL, on_connect_payloads=list)
            task = asyncio.create_task(publisher.run())
            await until(lambda: publisher.connected, 20.0, "the connection")
            proxy.fall_silent()
            publisher.retained(f"{PREFIX}/health", b'{"good":0}')
            await asyncio.sleep(0.1)
            publisher.retained(f"{PREFIX}/health", b'{"good":200}')
            leaving = asyncio.create_task(publisher.stop(8.0))
            await asyncio.sleep(0.2)
            proxy.speak()
            await leaving
            await asyncio.wait_for(task, 1.0)
            assert await watcher.wait_for(lambda: [w for _, w, _ in watcher.statuses] == ["online", "offline"], 5.0)
            assert watcher.retained[-1][1:] == ("health", b'{"good":200}')
    await asyncio.to_thread(outbox.stop, 5.0)


@pytest.mark.timing
async def test_leaving_is_quick_without_a_broker(tmp_path: Path) -> None:
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()
    put(outbox)
    publisher = Publisher(MqttSettings(port=free_port()), outbox, tool_id=TOOL)
    task = asyncio.create_task(publisher.run())
    await until(lambda: publisher.stats.failures.get("no broker", 0) > 2, 5.0, "failures counted")
    began = time.monotonic()
    await publisher.stop(5.0)
    await asyncio.wait_for(task, 1.0)
    await asyncio.to_thread(outbox.stop, 5.0)
    assert time.monotonic() - began < 2.0
    assert outbox.stats.queued == 1


@pytest.mark.timing
async def test_leaving_is_quick_while_the_network_swallows_the_connect(tmp_path: Path) -> None:
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()
    async with Proxy(free_port()) as proxy:
        proxy.fall_silent()
        publisher = Publisher(MqttSettings(port=proxy.port), outbox, tool_id=TOOL)
        task = asyncio.create_task(publisher.run())
        await asyncio.sleep(0.5)
        began = time.monotonic()
        await publisher.stop(5.0)
        await asyncio.wait_for(task, 1.0)
        assert time.monotonic() - began < 1.0
    assert publisher.stats.failures == {"stopped": 1}
    await asyncio.to_thread(outbox.stop, 5.0)


async def test_a_message_that_mqtt_cannot_carry_does_not_block_the_others(tmp_path: Path) -> None:
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()
    with Mosquitto(tmp_path / "broker") as mosquitto:
        publisher = Publisher(MqttSettings(port=mosquitto.port), outbox, tool_id=TOOL)
        async with sending(publisher):
            put(outbox)
            outbox.put("highside/+/attitude", b"a topic with a wildcard", created_s=time.time())
            put(outbox)
            await until(lambda: outbox.stats.queued == 0, 5.0, "delivery of the rest")
    await asyncio.to_thread(outbox.stop, 5.0)
    assert outbox.stats.acknowledged == 2
    assert outbox.stats.dropped == {"refused": 1}
    assert outbox.stats.balanced()
    assert publisher.connects == 1


async def test_a_wrong_password_is_counted_and_a_mended_one_is_taken(tmp_path: Path, project_root: Path) -> None:
    port = free_port()
    config = shipped_config(project_root, tmp_path, port, {TOOL: "right"})
    secret = tmp_path / "secret"
    secret.write_text("wrong\n")
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()
    with Mosquitto(tmp_path, config=config, port=port):
        publisher = Publisher(MqttSettings(port=port, username=TOOL, password_file=secret), outbox, tool_id=TOOL)
        async with sending(publisher):
            put(outbox)
            await until(lambda: publisher.stats.failures.get("refused by broker", 0) >= 2, 5.0, "refusals")
            assert "authori" in publisher.last_error.lower()
            secret.unlink()
            await until(lambda: publisher.stats.failures.get("credentials", 0) >= 1, 5.0, "missing file counted")
            secret.write_text("right\n")
            await until(lambda: outbox.stats.acknowledged == 1, 5.0, "delivery")
    await asyncio.to_thread(outbox.stop, 5.0)


def make_certificates(folder: Path) -> None:
    """An authority, a broker's certificate for localhost, and another authority that signed nothing."""

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    key = ["-newkey", "rsa:2048", "-nodes"]
    for name in ("ca", "other"):
        openssl(
            "req", "-x509", *key, "-keyout", f"{name}.key", "-out", f"{name}.crt", "-subj", f"/CN={name}", "-days", "30"
        )
    openssl("req", *key, "-keyout", "broker.key", "-out", "broker.csr", "-subj", "/CN=localhost")
    (folder / "san").write_text("subjectAltName=DNS:localhost")
    signed = ["-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-days", "30", "-extfile", "san"]
    openssl("x509", "-req", "-in", "broker.csr", *signed, "-out", "broker.crt")


async def test_tls_is_used_and_a_strange_certificate_is_refused(tmp_path: Path) -> None:
    make_certificates(tmp_path)
    port = free_port()
    config = tmp_path / "tls.conf"
    config.write_text(
        f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n"
        f"certfile {tmp_path}/broker.crt\nkeyfile {tmp_path}/broker.key\n"
    )
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()

    def publisher(host: str, ca: str) -> Publisher:
        return Publisher(MqttSettings(host=host, port=port, tls=TlsSettings(ca=tmp_path / ca)), outbox, tool_id=TOOL)

    with Mosquitto(tmp_path, config=config, port=port):
        put(outbox)
        for strange in (publisher("localhost", "other.crt"), publisher("127.0.0.1", "ca.crt")):
            async with sending(strange):
                await until(lambda strange=strange: strange.stats.failures.get("tls", 0) >= 1, 5.0, "refusal")
            assert strange.connects == 0
        assert outbox.stats.acknowledged == 0
        async with sending(publisher("localhost", "ca.crt")):
            await until(lambda: outbox.stats.acknowledged == 1, 5.0, "delivery")
    await asyncio.to_thread(outbox.stop, 5.0)


async def test_a_message_costs_few_turns_of_the_event_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each turn is a call of the system and what the loop does around it: at ten messages a second that is what a
    message costs. Sending is one, writing to the socket another, the PUBACK a third; the rest is this test's sleep."""
    messages, turns = 40, 0
    with Mosquitto(tmp_path / "broker") as broker:
        outbox = make_outbox(tmp_path / "outbox.sqlite")
        outbox.start()
        publisher = Publisher(MqttSettings(host="127.0.0.1", port=broker.port), outbox, tool_id=TOOL)
        try:
            async with sending(publisher):
                await until(lambda: publisher.connected, 10.0, "connected")
                put(outbox)
                await until(lambda: outbox.stats.acknowledged == 1, 10.0, "acknowledged")
                selector: Any = asyncio.get_running_loop()._selector  # type: ignore[attr-defined]
                select = selector.select

                def counted(timeout: float | None = None) -> Any:
                    nonlocal turns
                    turns += 1
                    return select(timeout)

                monkeypatch.setattr(selector, "select", counted)
                for _ in range(messages):
                    put(outbox)
                    await asyncio.sleep(0.02)
                monkeypatch.undo()
                await until(lambda: outbox.stats.acknowledged == messages + 1, 10.0, "all acknowledged")
        finally:
            outbox.stop(5.0)
    assert turns / messages <= 6.0


async def test_what_is_not_acknowledged_in_time_ends_the_connection_and_comes_again(tmp_path: Path) -> None:
    """One timer looks after all that is under way: it must not forget those that were sent after the first."""
    with Mosquitto(tmp_path / "broker") as broker:
        async with Proxy(broker.port) as proxy:
            await one_without_an_answer(tmp_path, proxy)


async def one_without_an_answer(tmp_path: Path, proxy: Proxy) -> None:
    outbox = make_outbox(tmp_path / "outbox.sqlite")
    outbox.start()
    settings = MqttSettings(host="127.0.0.1", port=proxy.port, ack_timeout_s=1.0, keepalive_s=60)
    publisher = Publisher(settings, outbox, tool_id=TOOL)
    try:
        async with sending(publisher):
            for _ in range(3):
                put(outbox)
            await until(lambda: outbox.stats.acknowledged == 3, 10.0, "acknowledged")
            await asyncio.sleep(0.5)
            proxy.fall_silent()
            began = time.monotonic()
            put(outbox)
            await until(lambda: publisher.stats.failures.get("no acknowledgement") == 1, 5.0, "noticed")
            assert 0.9 <= time.monotonic() - began < 3.0
            proxy.speak()
            await until(lambda: outbox.stats.acknowledged == 4, 10.0, "sent again")
    finally:
        outbox.stop(5.0)
