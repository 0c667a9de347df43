"""A bench session over a real broker: state, commands with replies, two operators at once, a broker that goes away."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import uuid
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiomqtt
from bench_page import RING, BenchProcess, bench_process
from broker import Mosquitto
from daemon import Subscriber, running, wait_for

TOPIC = "highside/tool-7/session"


class Operator:
    """Somebody with an MQTT client: sends commands, waits for the reply of each."""

    def __init__(self, client: aiomqtt.Client, name: str) -> None:
        self.name = name
        self._client = client
        self._replies: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self.states: list[dict[str, Any]] = []
        self.statuses: list[str] = []
        self.unknown: list[dict[str, Any]] = []

    async def listen(self) -> None:
        async for message in self._client.messages:
            topic, payload = str(message.topic), bytes(message.payload)  # type: ignore[arg-type]
            if topic.endswith("/state"):
                self.states.append(json.loads(payload))
            elif topic.endswith("/status"):
                self.statuses.append(payload.decode())
            elif topic.endswith("/reply"):
                reply = json.loads(payload)
                waiting = self._replies.get(reply["request_id"])
                if waiting is None or waiting.done():
                    self.unknown.append(reply)
                else:
                    waiting.set_result(reply)

    async def say(self, name: str, request_id: str | None = None, **more: Any) -> dict[str, Any]:
        request = request_id or uuid.uuid4().hex
        body = {"name": name, "request_id": request, "operator": self.name} | more
        return await self.raw(json.dumps(body), request)

    async def raw(self, payload: str | bytes, request: str = "", *, retain: bool = False) -> dict[str, Any]:
        self._replies[request] = asyncio.get_running_loop().create_future()
        await self._client.publish(f"{TOPIC}/command", payload, qos=1, retain=retain)
        async with asyncio.timeout(20.0):
            return await self._replies[request]

    async def see(self, *states: str, timeout_s: float = 60.0) -> dict[str, Any]:
        async with asyncio.timeout(timeout_s):
            while not self.states or self.states[-1]["state"] not in states:
                await asyncio.sleep(0.05)
        return self.states[-1]


@contextlib.asynccontextmanager
async def operator(port: int, name: str) -> AsyncIterator[Operator]:
    async with aiomqtt.Client("127.0.0.1", port, identifier=name.replace(" ", "")) as client:
        for topic in ("state", "reply", "status"):
            await client.subscribe(f"{TOPIC}/{topic}", qos=1)
        person = Operator(client, name)
        listening = asyncio.create_task(person.listen())
        try:
            yield person
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


def at_broker(port: int) -> str:
    return f"\n[mqtt]\nport = {port}\n"


async def test_a_session_is_driven_over_mqtt_by_one_of_two_operators(tmp_path: Path) -> None:
    with Mosquitto(tmp_path / "broker") as broker:
        async with (
            bench_process(tmp_path, plan=RING, speed=5.0, more=at_broker(broker.port)) as bench,
            operator(broker.port, "Anna") as anna,
            operator(broker.port, "Berta") as berta,
        ):
            assert (await anna.see("idle"))["schema"] == "highside.session/1"
            assert anna.statuses == ["online"]
            # both at once: one is let
            first, second = await asyncio.gather(anna.say("start"), berta.say("start"))
            assert sorted([first["accepted"], second["accepted"]]) == [False, True]
            holder, other = (anna, berta) if first["accepted"] else (berta, anna)
            assert (await other.say("pause"))["reason"] in ("held_by_other", "not_now")
            state = await other.see("guiding", "settling", "capturing")
            assert state["operator"] == holder.name

            # the same request twice is done once
            again = uuid.uuid4().hex
            paused = await holder.say("pause", again)
            assert paused["accepted"]
            assert await holder.say("pause", again) == paused
            await holder.see("paused")
            # while it is paused another may go on, and then holds it
            assert (await other.say("resume"))["accepted"]
            await other.see("guiding", "settling", "capturing", "review")
            assert (await holder.say("skip"))["reason"] == "held_by_other"

            await said_wrongly(other)
            state = await other.see("review")
            assert state["plan"]["done"] == 4
            accepted = await other.say("accept")
            assert accepted["accepted"] and accepted["state"] == "accepted"
            state = await other.see("accepted")
            await put_in_force(tmp_path, broker.port, other, holder, state["result"]["record_id"])
            assert await bench.ended() == 0
            async with asyncio.timeout(20.0):
                while other.statuses[-1] != "offline":
                    await asyncio.sleep(0.05)
            await keeps_the_last_state(broker.port)


SERVICE = """
[tool]
id = "tool-7"
serial = "42"
[link]
kind = "simulated"
[codec]
name = "tool"
[calibration]
store = "state/calibrations"
[mqtt]
port = {port}
[service]
state_dir = "service"
"""


async def put_in_force(folder: Path, port: int, holder: Operator, other: Operator, record: str) -> None:
    """By whoever holds the session, if they name it; a running service takes it at its next reload."""
    config = folder / "highside.toml"
    config.write_text(SERVICE.format(port=port))
    subscriber = Subscriber(port)
    try:
        with running(config) as daemon:

            def corrected_by(cal_id: str) -> bool:
                return any(message["cal_id"] == cal_id for message in subscriber.payloads("attitude")[-5:])

            await asyncio.to_thread(wait_for, lambda: subscriber.payloads("attitude"), 30, "attitudes", daemon)
            assert not corrected_by(record)
            assert (await other.say("activate", confirm=record))["reason"] == "held_by_other"
            for confirm in ({}, {"confirm": "000000"}):
                unnamed = await holder.say("activate", **confirm)
                assert unnamed["reason"] == "not_confirmed" and record[:12] in unnamed["text"]
            assert (await holder.say("rollback", confirm=record))["reason"] == "nothing_before"
            assert (await holder.say("activate", confirm=record[:8]))["accepted"]
            async with asyncio.timeout(10.0):
                while (holder.states[-1]["in_force"] or {}).get("present") != record:
                    await asyncio.sleep(0.05)
            daemon.process.send_signal(signal.SIGHUP)
            await asyncio.to_thread(wait_for, lambda: corrected_by(record), 20, "the new calibration", daemon)
    finally:
        subscriber.close()


async def said_wrongly(person: Operator) -> None:
    """What is no command is answered, and changes nothing."""
    for payload in ("", "not json", "[]", '{"name": "start"}', '{"name": "fly", "request_id": "", "operator": "x"}'):
        reply = await person.raw(payload)
        assert not reply["accepted"] and reply["reason"] == "malformed"
    reply = await person.raw(b"\xff" * 20_000)
    assert "longer than" in reply["text"]
    reply = await person.raw('{"name": "fly", "request_id": "r1", "operator": "x"}', "r1")
    assert reply["reason"] == "malformed" and "name" in reply["text"]
    # retained before anybody listened: not obeyed
    reply = await person.raw('{"name": "pause", "request_id": "r9", "operator": "Nobody"}', "r9", retain=False)
    assert reply["reason"] == "held_by_other"


async def keeps_the_last_state(port: int) -> None:
    async with operator(port, "Late") as late:
        assert (await late.see("accepted"))["result"]["record_id"]


async def test_a_retained_command_is_not_obeyed(tmp_path: Path) -> None:
    with Mosquitto(tmp_path / "broker") as broker:
        async with aiomqtt.Client("127.0.0.1", broker.port) as before:
            old = json.dumps({"name": "start", "request_id": "old", "operator": "Yesterday"})
            await before.publish(f"{TOPIC}/command", old, qos=1, retain=True)
        async with (
            operator(broker.port, "Anna") as anna,
            bench_process(tmp_path, plan=RING, more=at_broker(broker.port)) as bench,
        ):
            await anna.see("idle")
            async with asyncio.timeout(20.0):
                while not anna.unknown:
                    await asyncio.sleep(0.05)
            assert anna.unknown[0]["request_id"] == "old" and anna.unknown[0]["reason"] == "retained"
            assert (await bench.state())["state"] == "idle"
            await gone(bench, anna)


async def gone(bench: BenchProcess, person: Operator) -> None:
    """A process that is killed says offline by its last will."""
    bench.process.kill()
    async with asyncio.timeout(20.0):
        while person.statuses[-1] != "offline":
            await asyncio.sleep(0.05)


async def test_a_broker_that_goes_away_costs_nothing_but_this_face(tmp_path: Path) -> None:
    broker = Mosquitto(tmp_path / "broker")
    broker.start()
    try:
        async with bench_process(tmp_path, plan=RING, speed=2.0, more=at_broker(broker.port)) as bench:
            async with operator(broker.port, "Anna") as anna:
                await anna.see("idle")
                assert (await anna.say("start"))["accepted"]
                await anna.see("guiding", "settling", "capturing")
            broker.kill()
            before = (await bench.state())["elapsed_s"]
            async with asyncio.timeout(20.0):  # the session goes on
                while (await bench.state())["elapsed_s"] <= before + 2.0:
                    await asyncio.sleep(0.2)
            broker.start()
            # it comes back empty: state and status are there again
            async with operator(broker.port, "Anna") as anna:
                state = await anna.see("guiding", "settling", "capturing", "review")
                assert state["elapsed_s"] > before
                assert (await anna.say("abort"))["accepted"]
            assert await bench.ended() == 1
    finally:
        broker.kill()


async def test_a_session_taken_at_the_page_is_not_anothers_by_its_name(tmp_path: Path) -> None:
    """The name of who holds a session is public: it must not be enough to end it from the broker."""
    with Mosquitto(tmp_path / "broker") as broker:
        async with (
            bench_process(tmp_path, plan=RING, speed=5.0, more=at_broker(broker.port)) as bench,
            operator(broker.port, "Alice") as stranger,
        ):
            assert (await bench.command("start", operator="Alice")).status_code == 200
            await stranger.see("guiding", "settling", "capturing")
            assert (await stranger.say("abort"))["reason"] == "held_by_other"
            assert (await stranger.say("abort", secret="guessed, not known"))["reason"] == "held_by_other"
            # handed over to the broker, with a secret; at the bench it can still be paused
            assert (await bench.command("pause", operator="Alice")).status_code == 200
            assert (await stranger.say("resume", secret="chosen by who resumes"))["accepted"]
            assert (await stranger.say("pause"))["reason"] == "held_by_other"
            assert (await bench.command("skip", operator="Alice")).status_code == 409
            assert (await bench.command("pause", operator="Alice")).status_code == 200
            assert (await bench.command("abort", operator="Alice")).status_code == 409
            assert (await bench.command("resume", operator="Alice")).status_code == 200
            assert (await bench.command("abort", operator="Alice")).status_code == 200
