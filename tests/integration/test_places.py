"""What two daemons cannot both have: the loser ends with one line and never speaks at the broker. Real processes."""

from __future__ import annotations

import subprocess
import time
from itertools import islice
from pathlib import Path

import pytest
from broker import Mosquitto
from daemon import HIGHSIDE, Pty, Subscriber, running, wait_for

from highside.codec.tool import encode
from highside.config.mqtt import MqttSettings
from highside.errors import InputError
from highside.service.places import ToolLock

pytestmark = pytest.mark.slow


@pytest.fixture
def broker(tmp_path):
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


def configuration(folder: Path, port: str, broker_port: int, *, tool: str = "t1", host: str = "127.0.0.1") -> Path:
    folder.mkdir(parents=True)
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "{tool}"\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "tool"\n'
        f'[mqtt]\nhost = "{host}"\nport = {broker_port}\n'
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
    )
    return path


def connects(broker_folder: Path) -> int:
    """Connections that the broker has seen, accepted or not."""
    return (broker_folder / "log.txt").read_text().count("New connection from")


def test_whoever_loses_state_directory_tool_or_port_never_speaks_at_the_broker(tmp_path, broker):
    line, other_line = Pty(), Pty()
    subscriber = Subscriber(broker.port)
    first = configuration(tmp_path / "first", line.path, broker.port)
    try:
        with running(first) as daemon:
            wait_for(
                lambda: (h := subscriber.latest("health")) and h["link"]["opens"] == 1, 20, "the first daemon", daemon
            )
            losers = {
                "service.state_dir": first,
                # a state directory and a port of its own, the broker by another name, but the same tool
                "tool.id": configuration(tmp_path / "tool", other_line.path, broker.port, host="localhost"),
                # another tool, but on the same port
                "[link]": configuration(tmp_path / "port", line.path, broker.port, tool="t2"),
            }
            before = connects(tmp_path / "broker")
            assert before >= 2  # the daemon and the subscriber: the broker does log them
            for named, path in losers.items():
                run = subprocess.run(
                    [str(HIGHSIDE), "run", "--config", str(path)], capture_output=True, text=True, timeout=30
                )
                assert run.returncode == 2, run.stderr
                lines = run.stderr.strip().splitlines()
                assert named in lines[-1]
                assert not any("Traceback" in one for one in lines)
                if named == "tool.id":
                    assert f"process {daemon.process.pid}" in lines[-1]
            time.sleep(0.5)
            assert connects(tmp_path / "broker") == before
            statuses = {payload for topic, payload, _, _ in subscriber.drain() if topic.endswith("/status")}
            assert len(statuses) == 1
            assert statuses.pop() == b"online"
            assert not [t for t, *_ in subscriber.drain() if "/t2/" in t]
            # the first one did not notice; a silent line is opened anew every 10 s, and what it holds then thrown away
            frames = (encode(i, i / 100.0, (0.1, 0.2, 0.97)) for i in range(60_000))
            wait_for(
                lambda: line.write_all(b"".join(islice(frames, 20))) or len(subscriber.payloads("attitude")) >= 19,
                20, "attitudes", daemon,
            )  # fmt: skip
            assert subscriber.latest("health")["broker"]["connects"] == 1
            assert daemon.terminate() == 0
        # what was held is free again, however the holder ended
        with running(losers["tool.id"]) as daemon:
            wait_for(lambda: "mqtt: connected" in daemon.log, 20, "the other daemon, now alone", daemon)
            daemon.kill()
        with running(losers["tool.id"]) as daemon:
            wait_for(lambda: daemon.log.count("mqtt: connected") == 2, 20, "the next after a kill", daemon)
            assert daemon.terminate() == 0
    finally:
        subscriber.close()
        line.close()
        other_line.close()


def test_a_tool_is_spoken_for_at_one_broker_and_under_one_prefix_only():
    here = MqttSettings(port=18830)
    lock = ToolLock("t1", here)
    others = [
        ToolLock("t2", here),
        ToolLock("t1", MqttSettings(port=18831)),
        ToolLock("t1", MqttSettings(port=18830, host="broker.example")),
        ToolLock("t1", MqttSettings(port=18830, prefix="drill")),
    ]
    with pytest.raises(InputError, match="spoken for"):
        ToolLock("t1", MqttSettings(port=18830, host="localhost", client_id="another"))
    lock.release()
    ToolLock("t1", here).release()
    for other in others:
        other.release()
