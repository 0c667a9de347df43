"""What is published beside what `highside schema --asyncapi` promises: a service with everything on, a bench session.

Every topic that the document names is heard or commanded, no other is, and every payload is valid by its schema.
"""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
from collections import Counter
from pathlib import Path

import jsonschema
import pytest
from bench_page import RING, bench_process
from broker import Mosquitto
from daemon import HIGHSIDE, Operator, Subscriber, running, still_tool, wait_for
from test_session_mqtt import at_broker, operator

import highside
from highside.recording.calibration_store import CalibrationStore
from highside.service.messages import DriftReply
from highside.service.watch_messages import WatchReply
from tests.unit.watch_frames import poses_of_a_good_tool

pytestmark = pytest.mark.slow

MOVES = 'motion = "demo"'
EVERYTHING = (
    '[calibration]\nstore = "{store}"\n[drift]\nazimuth_deg = 10.0\nsave_interval_s = 0.2\n'
    "[watch]\ninterval_s = 0.2\nsave_interval_s = 0.2\n[home_assistant]\n[site]\nlatitude_deg = 50.0\n"
)
UNKNOWN = "no such command"
SCHEMA = "application/schema+json;version=draft-07"


class Document:
    """The AsyncAPI document of the command, and what was found to be as it says."""

    def __init__(self) -> None:
        done = subprocess.run(
            [HIGHSIDE, "schema", "--asyncapi"], capture_output=True, text=True, check=True, timeout=60
        )
        self.whole = json.loads(done.stdout)
        self.actions = {
            operation["channel"]["$ref"].rsplit("/", 1)[1]: (operation["action"], operation["bindings"]["mqtt"])
            for operation in self.whole["operations"].values()
        }
        self.addresses = {key: channel["address"] for key, channel in self.whole["channels"].items()}
        self.heard: Counter[str] = Counter()

    def channel(self, topic: str) -> str:
        found = [
            key
            for key, address in self.addresses.items()
            if re.fullmatch(re.escape(address).replace(r"\{prefix\}", "highside").replace(r"\{tool\}", "[^/]+"), topic)
        ]
        assert len(found) == 1, f"{topic} is named {len(found)} times"
        return found[0]

    def hold(self, topic: str, payload: bytes, retained: bool) -> None:
        """The message against its channel. Raises jsonschema.ValidationError, or AssertionError."""
        key = self.channel(topic)
        message = self.whole["components"]["messages"][key]
        assert message["payload"]["schemaFormat"] == SCHEMA
        if self.actions[key][0] == "receive" and UNKNOWN.encode() in payload:
            return
        is_json = message["contentType"] == "application/json"
        value = json.loads(payload) if is_json else payload.decode()
        schema = {**message["payload"]["schema"], "components": self.whole["components"]}
        jsonschema.Draft7Validator(schema).validate(value)
        if retained:
            assert self.actions[key][1]["retain"], f"{topic} is retained"
        self.heard[key] += 1

    def hold_all(self, ear: Subscriber) -> None:
        for topic, payload, retained, _ in ear.drain():
            self.hold(topic, payload, retained)


def store(folder: Path) -> Path:
    record = highside.calibrate(poses_of_a_good_tool(1), "joint", tool="t1", temp_c=25.0).record
    CalibrationStore(folder).activate(record, now_s=1.7e9)
    return folder


def a_service(folder: Path, document: Document) -> None:
    """A tool that turns and rests, with attitudes, surveys, drift, watch, and the commands of the last two."""
    names = ("attitude", "survey", "latest", "health", "drift", "watch", "watch/history", "status", "instance")
    with Mosquitto(folder / "broker") as broker:
        ear = Subscriber(broker.port)
        extra = EVERYTHING.format(store=store(folder / "calibrations"))
        with running(still_tool(folder / "service", broker.port, extra, MOVES)) as daemon:
            drift: Operator[DriftReply] = Operator(broker.port, "highside/t1/drift", ear, DriftReply)
            watch: Operator[WatchReply] = Operator(broker.port, "highside/t1/watch", ear, WatchReply)
            try:
                for name in names:
                    wait_for(
                        lambda topic=f"highside/t1/{name}": any(found == topic for found, *_ in ear.drain()),  # type: ignore[misc]
                        90,
                        f"a message on {name}",
                        daemon,
                    )
                for one in (drift, watch):
                    assert one.say(daemon, command="restart").ok
                    assert not one.say(daemon, command=UNKNOWN).ok
                late = Subscriber(broker.port)
                wait_for(
                    lambda: any(topic.endswith("/history") for topic, *_ in late.drain()), 10, "what is kept", daemon
                )
                document.hold_all(late)
                late.close()
                assert daemon.terminate() == 0, daemon.log
            finally:
                drift.close()
                watch.close()
        document.hold_all(ear)
        ear.close()


async def a_session(folder: Path, document: Document) -> None:
    with Mosquitto(folder / "broker") as broker:
        ear = Subscriber(broker.port)
        async with (
            bench_process(folder, plan=RING, speed=5.0, more=at_broker(broker.port)) as bench,
            operator(broker.port, "Anna") as anna,
        ):
            await anna.see("idle")
            assert (await anna.say("start"))["accepted"]
            assert not (await anna.say("accept"))["accepted"]
            await anna.see("review")
            assert (await anna.say("accept"))["accepted"]
            await anna.see("accepted")
            await bench.ended()
        document.hold_all(ear)
        ear.close()


async def test_everything_published_is_as_the_document_says_and_all_of_it_is_published(tmp_path: Path) -> None:
    document = Document()
    for name in ("service", "session"):
        (tmp_path / name).mkdir()
    await asyncio.to_thread(a_service, tmp_path / "service", document)
    await a_session(tmp_path / "session", document)
    silent = {document.addresses[key] for key in document.addresses if not document.heard[key]}
    assert not silent, "named in the document, and never published"


def test_a_message_that_is_not_as_promised_is_found() -> None:
    """What the other test rests on."""
    document = Document()
    for topic, payload, retained in (
        ("highside/t1/attitudes", b"{}", False),
        ("highside/t1/attitude", b"{}", False),
        ("highside/t1/status", b"on line", True),
        ("highside/t1/drift/reply", b'{"id": "1", "ok": true, "error": null}', True),
    ):
        with pytest.raises((AssertionError, jsonschema.ValidationError)):
            document.hold(topic, payload, retained)
    document.hold("highside/t1/status", b"online", True)
