"""`highside doctor` on real parts: mosquitto, a pty, a service that runs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from pathlib import Path

import pytest
from broker import Mosquitto, free_port
from daemon import HIGHSIDE, Pty, Subscriber, running, still_tool, wait_for

pytestmark = pytest.mark.slow


@pytest.fixture
def broker(tmp_path):
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


def plain_broker(folder: Path) -> Mosquitto:
    """As distributions ship it: 1,000 messages for a subscriber that is away."""
    folder.mkdir(parents=True)
    port = free_port()
    shipped = folder / "mosquitto.conf"
    shipped.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
    return Mosquitto(folder, config=shipped, port=port)


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "COLUMNS": "250"}
    return subprocess.run(
        [str(HIGHSIDE), *arguments], capture_output=True, text=True, timeout=120, check=False, env=env
    )


def test_doctor_beside_a_healthy_service_finds_no_fault_and_says_nothing_at_the_broker(tmp_path: Path) -> None:
    with plain_broker(tmp_path / "broker") as broker:
        path = still_tool(tmp_path / "service", broker.port)
        subscriber = Subscriber(broker.port, "#")
        try:
            with running(path) as daemon:
                wait_for(lambda: (subscriber.latest("health") or {}).get("broker", {}).get("connected"), 20,
                         "health", daemon)  # fmt: skip
                answer = command("doctor", "--config", str(path))
                assert answer.stderr == ""
                assert answer.returncode == 0, answer.stdout
                assert "FAIL" not in answer.stdout
                report = [
                    " ".join(line.split()[1:]) for line in answer.stdout.splitlines() if line.split()[:1] == ["OK"]
                ]
                assert any(line.startswith("service") and "is running" in line for line in report), answer.stdout
                assert any(line.startswith("health") and "no alarm" in line for line in report), answer.stdout
                assert any(line.startswith("outbox") and "in use by the running service" in line for line in report)
                assert any(line.startswith("broker ") and "answers" in line for line in report), answer.stdout
                time.sleep(0.5)
                after = subscriber.drain()
                own = {
                    f"highside/t1/{name}" for name in ("attitude", "survey", "status", "instance", "health", "drift")
                }
                assert {topic for topic, *_ in after} <= own, "doctor publishes nothing unless it is asked to"
                assert b"offline" not in {payload for topic, payload, *_ in after if topic.endswith("status")}
                health = subscriber.latest("health")
                assert health is not None
                assert health["outbox"]["storage_ok"] is True
                assert health["broker"]["connects"] == 1
                assert daemon.terminate() == 0
        finally:
            subscriber.close()


def test_the_brokers_queue_is_tried_without_a_word_on_stderr(tmp_path: Path) -> None:
    """The client library counts messages under way as warnings: 960 lines for 1,200 messages."""
    with plain_broker(tmp_path / "broker") as broker:
        answer = command("doctor", "--config", str(still_tool(tmp_path / "c", broker.port)), "--queue", "1200")
        assert answer.stderr == ""
        assert re.search(r"broker queue\s+keeps 1,0\d\d of 1,200", answer.stdout), answer.stdout


def test_a_tool_that_was_never_calibrated_is_reported_to_be_calibrated(tmp_path: Path, broker: Mosquitto) -> None:
    store = tmp_path / "calibrations"
    (store / "records").mkdir(parents=True)
    path = still_tool(tmp_path / "c", broker.port, f'[calibration]\nstore = "{store}"\n')
    answer = command("doctor", "--config", str(path), "--json")
    found = {finding["check"]: finding for finding in json.loads(answer.stdout)["findings"]}
    assert answer.returncode == 0
    assert found["calibration"]["level"] == "warn"
    assert "highside calibrate bench" in found["calibration"]["remedy"]
    assert "roll back" not in found["calibration"]["remedy"], "there is nothing to roll back to"

    checked = command("check", str(path))
    assert checked.returncode == 0
    said = checked.stdout + checked.stderr
    assert "calibration none yet" in checked.stdout
    assert "run `highside calibrate bench`" in said
    assert "refused" not in said, "nothing was refused"

    path = still_tool(tmp_path / "c", broker.port, f'[calibration]\nstore = "{tmp_path / "nope"}"\n')
    checked = command("check", str(path))
    assert checked.returncode == 2
    assert checked.stderr.startswith(
        f"highside: {path}: calibration.store: {tmp_path / 'nope'}: no such calibration store"
    )
    answer = command("doctor", "--config", str(path), "--json")
    found = {finding["check"]: finding for finding in json.loads(answer.stdout)["findings"]}
    assert answer.returncode == 1
    assert "calibration.store" in found["calibration"]["found"]


def test_doctor_says_what_is_wrong_and_what_to_do(tmp_path: Path, broker: Mosquitto) -> None:
    path = still_tool(tmp_path / "doctor", broker.port, "")
    answer = command("doctor", "--config", str(path), "--json", "--queue", "300")
    report = json.loads(answer.stdout)
    found = {finding["check"]: finding for finding in report["findings"]}
    assert answer.returncode == 0, report
    assert found["broker"]["level"] == "ok"
    assert found["broker queue"]["found"] == "keeps 300 of 300 messages for a subscriber that is away"
    assert found["calibration"]["level"] == "warn"

    text = path.read_text().replace('kind = "simulated"\nmotion = "still"\nnoise_density_g = 2e-5',
                                    f'kind = "serial"\nport = "{tmp_path / "ttyNONE"}"')  # fmt: skip
    path.write_text(text.replace(f"port = {broker.port}", f"port = {free_port()}"))
    answer = command("doctor", "--config", str(path), "--json")
    report = json.loads(answer.stdout)
    assert (answer.returncode, report["ok"]) == (1, False)
    bad = {finding["check"]: finding for finding in report["findings"] if finding["level"] == "fail"}
    assert set(bad) == {"link", "broker"}
    assert all(finding["remedy"] for finding in bad.values())
    assert "does not exist" in bad["link"]["found"]
    people = command("doctor", "--config", str(path))
    assert people.returncode == 1
    assert "FAIL" in people.stdout


def test_doctor_finds_the_brokers_queue_limit(tmp_path: Path) -> None:
    """A broker as distributions ship it keeps 1,000 messages for a subscriber that is away."""
    folder = tmp_path / "default"
    folder.mkdir()
    port = free_port()
    shipped = folder / "mosquitto.conf"
    shipped.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
    with Mosquitto(folder, config=shipped, port=port) as broker:
        path = still_tool(tmp_path / "c", broker.port, "")
        report = json.loads(command("doctor", "--config", str(path), "--json", "--queue", "1200").stdout)
        queue = next(f for f in report["findings"] if f["check"] == "broker queue")
        assert queue["level"] == "warn"
        assert re.search(r"keeps 1,0\d\d of 1,200", queue["found"]), queue
        assert "max_queued_messages" in queue["remedy"]
        # nothing is left behind: a second try finds the same
        again = json.loads(command("doctor", "--config", str(path), "--json", "--queue", "1200").stdout)
        assert next(f for f in again["findings"] if f["check"] == "broker queue")["found"] == queue["found"]


def test_doctor_sees_a_service_that_runs_and_leaves_its_port_alone(tmp_path: Path, broker: Mosquitto) -> None:
    line = Pty()
    path = still_tool(tmp_path / "r", broker.port, "")
    path.write_text(path.read_text().replace('kind = "simulated"\nmotion = "still"\nnoise_density_g = 2e-5',
                                             f'kind = "serial"\nport = "{line.path}"'))  # fmt: skip
    subscriber = Subscriber(broker.port)
    try:
        with running(path) as daemon:
            wait_for(lambda: (subscriber.latest("health") or {}).get("link", {}).get("opens"), 20, "the link", daemon)
            report = json.loads(command("doctor", "--config", str(path), "--json", "--queue", "0").stdout)
            found = {finding["check"]: finding for finding in report["findings"]}
            assert found["service"]["level"] == "ok"
            assert found["link"]["found"].endswith("the running service holds it")
            health = subscriber.latest("health")
            assert health is not None
            assert health["link"]["opens"] == 1
            assert daemon.terminate() == 0
    finally:
        subscriber.close()
        line.close()
