"""The broker lets the service in again, and which run of a service is the living one. Real mosquitto, real daemons."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path

import pytest
from broker import Mosquitto, require_mosquitto
from daemon import Daemon, Subscriber, running, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

BACK_OFF_S = 1.0
"""mqtt.reconnect_max_s by default: the longest pause between two attempts"""
LOADED_S = 20.0
"""Beside it: a connection, a health message and their way to here on a machine with a load of 10."""


def configured(folder: Path, port: int, mqtt: str = "") -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "simulated"\n[codec]\nname = "tool"\n[mqtt]\nport = {port}\n{mqtt}'
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
    )
    return path


def seen(subscriber: Subscriber, daemon: Daemon, condition, what: str, within_s: float = 60.0):
    return wait_for(lambda: (h := subscriber.latest("health")) and condition(h) and h, within_s, what, daemon)


class Door:
    """A broker that knows the user `tool` by a password; without a name anybody may look on."""

    def __init__(self, folder: Path, password: str) -> None:
        require_mosquitto()
        self._users = folder / "users"
        conf = folder / "mosquitto.conf"
        self.broker = Mosquitto(folder / "broker", config=conf)
        self._log = folder / "broker" / "log.txt"
        self.password(password)
        conf.write_text(
            f"user root\nlistener {self.broker.port} 127.0.0.1\npassword_file {self._users}\nallow_anonymous true\n"
        )

    def password(self, password: str) -> None:
        """As an operator sets it; a broker that runs is told to read it."""
        new = [] if self._users.exists() else ["-c"]
        subprocess.run(["mosquitto_passwd", "-b", *new, self._users, "tool", password], check=True, capture_output=True)
        self._users.chmod(0o600)
        self.broker.tell(signal.SIGHUP)

    def refusals(self) -> int:
        return self._log.read_text().count("not authorised")


def test_a_password_that_is_mended_at_the_broker_lets_the_service_in_without_a_hand(tmp_path: Path) -> None:
    """Wrong from the start, and wrong after hours of good service: the next attempt after the mending is let in."""
    door = Door(tmp_path, "another")
    (tmp_path / "password").write_text("right\n")
    path = configured(tmp_path, door.broker.port, 'username = "tool"\npassword_file = "password"\n')
    with door.broker:
        subscriber = Subscriber(door.broker.port)
        with running(path) as daemon:
            for connects in (1, 2):
                refused = door.refusals()
                # several in a row, so that the pauses have grown to their longest
                wait_for(lambda before=refused: door.refusals() >= before + 6, 90, "refusals", daemon)
                heard = len(subscriber.payloads("attitude"))
                time.sleep(1.0)
                assert len(subscriber.payloads("attitude")) == heard, "it was refused"
                door.password("right")
                mended = time.monotonic()
                found = seen(
                    subscriber, daemon,
                    lambda h, n=connects: h["broker"]["connected"] and h["broker"]["connects"] == n,
                    f"connection {connects}", BACK_OFF_S + LOADED_S,
                )  # fmt: skip
                print(f"connection {connects}: {time.monotonic() - mended:.2f} s after the mending")
                assert found["broker"]["failures"], "the refusals are counted"
                wait_for(lambda n=heard: len(subscriber.payloads("attitude")) > n + 5, 30, "attitudes", daemon)
                if connects == 1:
                    door.password("another")
            assert "client_id_taken" not in found["alarms"]
            seen(subscriber, daemon, lambda h: h["outbox"]["queued"] == 0, "the backlog is sent")
            assert daemon.terminate(15) == 0
        numbers = sorted({message["seq"] for message in subscriber.payloads("attitude")})
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), "what was made meanwhile was kept"
        assert numbers[0] <= 1
        subscriber.close()


def retained(port: int) -> dict[str, bytes]:
    """What a reader who comes now is told at once, by the end of the topic."""
    reader = Subscriber(port, "highside/t1/+")
    wait_for(lambda: reader.subscriptions, 20, "the subscription")
    wait_for(lambda: any(kept for *_, kept, _ in reader.drain()), 20, "what is kept")
    time.sleep(0.5)
    found = {topic.rpartition("/")[2]: payload for topic, payload, kept, _ in reader.drain() if kept}
    reader.close()
    return found


def write_down(broker: Mosquitto, kept: Path) -> None:
    """What the broker keeps, which it does by itself twice an hour."""
    before = time.time_ns() - 10**9
    broker.tell(signal.SIGUSR1)
    wait_for(lambda: kept.exists() and kept.stat().st_mtime_ns >= before, 20, "the broker's file")


@pytest.mark.parametrize("broker_too", [False, True], ids=["killed", "killed-with-the-broker"])
def test_a_reader_can_tell_the_living_run_from_a_dead_one(tmp_path: Path, broker_too: bool) -> None:
    """A run that was killed is followed by another. Killed with its broker (a power cut; the broker keeps what is
    retained) nobody says `offline` for it: `status` stands until the next run replaces it, and health gets no newer."""
    conf = tmp_path / "mosquitto.conf"
    broker = Mosquitto(tmp_path / "broker", config=conf)
    conf.write_text(
        f"user root\nlistener {broker.port} 127.0.0.1\nallow_anonymous true\npersistence true\n"
        f"persistence_location {tmp_path / 'broker'}/\n"
    )
    path = configured(tmp_path, broker.port)
    runs = []
    with broker:
        for run in range(2):
            subscriber = Subscriber(broker.port)
            with running(path) as daemon:
                found = seen(subscriber, daemon, lambda h: h["broker"]["connected"], "the connection")
                runs.append(found["broker"]["instance"])
                wait_for(lambda s=subscriber: s.payloads("attitude"), 30, "attitudes", daemon)
                now = retained(broker.port)
                assert now["status"] == b"online"
                assert now["instance"] == f"online {runs[run]}".encode(), "the dead run's word is replaced"
                assert json.loads(now["health"])["broker"]["instance"] == runs[run]
                assert "client_id_taken" not in found["alarms"], "a dead run is no twin"
                if run == 1:
                    assert daemon.terminate(15) == 0
                    break
                if broker_too:
                    write_down(broker, tmp_path / "broker" / "mosquitto.db")
                    broker.kill()
                daemon.kill()
            subscriber.close()
            if broker_too:
                broker.start()
                left = retained(broker.port)
                assert (left["status"], left["instance"]) == (b"online", f"online {runs[0]}".encode())
                time.sleep(1.0)
                assert retained(broker.port)["health"] == left["health"], "health is what gets no newer"
            else:
                wait_for(lambda: retained(broker.port)["status"] == b"offline", 30, "the last will")
                assert retained(broker.port)["instance"] == f"online {runs[0]}".encode()
        gone = retained(broker.port)
        assert (gone["status"], gone["instance"]) == (b"offline", f"offline {runs[1]}".encode())
        subscriber.close()
    assert runs[0] != runs[1]
