"""What comes from outside to a running service: a real `highside run`, a real mosquitto, commands that are none."""

from __future__ import annotations

import json
import random
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from broker import Mosquitto
from daemon import Daemon, Subscriber, running, wait_for

pytestmark = pytest.mark.slow

COMMAND = "highside/t1/drift/command"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


@pytest.fixture
def ear(broker: Mosquitto) -> Iterator[Subscriber]:
    found = Subscriber(broker.port, "highside/#")
    yield found
    found.close()


@pytest.fixture
def mouth(broker: Mosquitto) -> Iterator[mqtt.Client]:
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    yield client
    client.disconnect()
    client.loop_stop()


def config(folder: Path, broker: Mosquitto, mqtt_lines: str = "", *, rate_hz: int = 20) -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "simulated"\n[codec]\nname = "tool"\n'
        f"[pipeline]\noutput_rate_hz = {rate_hz}\n[drift]\n[mqtt]\nport = {broker.port}\n{mqtt_lines}\n"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.3\n'
    )
    return path


def reply(ear: Subscriber, name: str) -> dict[str, Any] | None:
    return next((found for found in ear.payloads("drift/reply") if found["id"] == name), None)


def ask(mouth: mqtt.Client, ear: Subscriber, daemon: Daemon, name: str) -> dict[str, Any]:
    mouth.publish(COMMAND, json.dumps({"id": name, "command": "connection", "seconds": 0}), qos=1)
    return wait_for(lambda: reply(ear, name), 20.0, f"the answer to {name}", daemon)


def alarms(ear: Subscriber) -> list[str]:
    return (ear.latest("health") or {"alarms": []})["alarms"]


def test_no_message_deafens_the_service(tmp_path: Path, broker: Mosquitto, ear: Subscriber, mouth: mqtt.Client) -> None:
    with running(config(tmp_path, broker)) as daemon:
        wait_for(lambda: ear.latest("attitude"), 30, "an attitude", daemon)
        ask(mouth, ear, daemon, "before")
        mouth.publish(COMMAND, rb'{"command":"align","id":"\ud800","azimuth_deg":10}', qos=1)
        wait_for(lambda: [r for r in ear.payloads("drift/reply") if not r["ok"] and r["error"]], 10, "a no", daemon)
        ask(mouth, ear, daemon, "after")
        rng = random.Random(3)
        for _ in range(300):
            data = bytearray(b'{"id":"x","command":"align","azimuth_deg":12.5}')
            for _ in range(rng.randrange(1, 6)):
                data[rng.randrange(len(data))] = rng.randrange(256)
            mouth.publish(COMMAND, bytes(data), qos=1)
        time.sleep(1.0)
        ask(mouth, ear, daemon, "at the end")
        health = wait_for(lambda: ear.latest("health"), 5, "health", daemon)
        assert health["broker"]["commands_failed"] == 0
        assert health["broker"]["connects"] == 1
        assert "Traceback" not in daemon.log
        assert daemon.terminate() == 0


@pytest.mark.timing
def test_a_flood_of_wrong_commands_leaves_the_attitudes_alone(
    tmp_path: Path, broker: Mosquitto, mouth: mqtt.Client
) -> None:
    flood = tmp_path / "flood"
    flood.write_bytes(b'{"id":"x","command":"fly"}\n' * 20_000)
    # not all topics: the flood itself would keep the watcher busy
    watcher, state, answers = (
        Subscriber(broker.port, f"highside/t1/{name}") for name in ("attitude", "health", "drift/reply")
    )
    try:
        with running(config(tmp_path, broker)) as daemon:
            # what was made before the broker was connected has come
            wait_for(lambda: time.time() - (watcher.latest("attitude") or {"t": 0.0})["t"] < 0.5, 60, "calm", daemon)
            time.sleep(2.0)
            before, began, log = len(watcher.payloads("attitude")), time.monotonic(), len(daemon.log)
            with flood.open("rb") as lines:
                subprocess.run(
                    ["mosquitto_pub", "-p", str(broker.port), "-t", COMMAND, "-q", "0", "-l"],
                    stdin=lines, check=True, timeout=60,
                )  # fmt: skip
            time.sleep(10.0)
            found, took = watcher.payloads("attitude")[before:], time.monotonic() - began
            aged_s = time.time() - found[-1]["t"]
            wait_for(lambda: "commands_unanswered" in alarms(state), 10, "the alarm", daemon)
            health = state.latest("health") or {}
            print(
                f"{len(found) / took:.1f} attitudes/s of 20, {health['outbox']['queued']} rows wait,"
                f" {health['drift']['commands']} commands, {health['broker']['replies']} answers,"
                f" {len(daemon.log) - log} bytes of log, lag p99.9 {health['loop']['lag_p999_ms']} ms"
            )
            assert len({message["seq"] for message in found}) >= 0.95 * 20 * took

            def all_have_come() -> bool:
                numbers = {message["seq"] for message in watcher.payloads("attitude")[before:]}
                return numbers == set(range(min(numbers), max(numbers) + 1))

            wait_for(all_have_come, 10, "each at least once, none missing", daemon)
            assert aged_s < 5.0
            assert not any(message["historical"] for message in found)
            assert health["outbox"]["queued"] < 100
            assert health["drift"]["commands"] > 2_000
            assert health["broker"]["replies"] <= 20 + 5 * took
            assert len(daemon.log) - log < 2_000
            # and a right one is answered at once
            began = time.monotonic()
            ask(mouth, answers, daemon, "right")
            assert time.monotonic() - began < 5.0
    finally:
        for subscriber in (watcher, state, answers):
            subscriber.close()


def test_what_is_dropped_is_an_alarm_and_one_line_a_minute(tmp_path: Path, broker: Mosquitto, ear: Subscriber) -> None:
    with running(config(tmp_path, broker, "[mqtt.outbox]\nmax_rows = 100\n", rate_hz=50)) as daemon:
        wait_for(lambda: ear.latest("attitude"), 30, "an attitude", daemon)
        broker.kill()
        wait_for(lambda: "messages are dropped (max_rows)" in daemon.log, 30, "the line", daemon)
        time.sleep(3.0)
        assert daemon.log.count("messages are dropped") == 1
        broker.start()
        wait_for(lambda: "outbox_dropping" in alarms(ear), 15, "the alarm", daemon)
        health = ear.latest("health") or {}
        assert health["outbox"]["dropped"]["max_rows"] > 50
        assert health["balance"]["messages"]


def test_a_client_that_takes_our_name_is_an_alarm_and_few_lines(
    tmp_path: Path, broker: Mosquitto, ear: Subscriber
) -> None:
    with running(config(tmp_path, broker)) as daemon:
        wait_for(lambda: ear.latest("health"), 30, "health", daemon)
        instance = (ear.latest("health") or {})["broker"]["instance"]
        assert ("highside/t1/instance", f"online {instance}".encode()) in [message[:2] for message in ear.drain()]
        log = len(daemon.log)
        thief = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="highside-t1")
        thief.reconnect_delay_set(1, 1)
        thief.connect("127.0.0.1", broker.port)
        thief.loop_start()
        try:
            wait_for(lambda: "client_id_taken" in alarms(ear), 60, "the alarm", daemon)
        finally:
            thief.disconnect()
            thief.loop_stop()
        assert "another client uses highside-t1" in (ear.latest("health") or {})["broker"]["taken"]
        lines = [line for line in daemon.log[log:].splitlines() if "mqtt" in line]
        assert len(lines) <= 6, lines
        before = len(ear.payloads("attitude"))
        wait_for(lambda: len(ear.payloads("attitude")) > before + 20, 30, "attitudes again", daemon)
