"""Every file of the state directory, damaged in every way, before a real daemon starts: it goes on, and says so."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
from pathlib import Path

import pytest
from broker import Mosquitto, free_port
from daemon import Pty, Subscriber, is_held, running, wait_for

from highside.codec.tool import encode
from highside.errors import InputError
from highside.recording.locks import lock as take_lock
from highside.service.damage import DamageLog
from highside.service.outbox import inspect

pytestmark = pytest.mark.slow

DAMAGES: dict[str, bytes | None] = {
    "nan": b'{"a": NaN}\n{"b": NaN}\n',
    "nested": b"[" * 100_000 + b"\n",
    "nested objects": b'{"a":' * 50_000 + b"\n",
    "nul": b"\0" * 4096 + b"\n",
    "torn": b'{"t": 1.0, "offset_deg": 12.5, "author": "An',
    "not text": bytes(range(128, 256)) * 20 + b"\n",
    "digits": b'{"t": ' + b"1" * 5000 + b"}\n",
    "surrogate": b'{"format": "\\ud800", "t": "\\udfff"}\n',
    "other types": b'{"cal_id": 5, "reasons": 5, "t": [], "g_error_mg": 1.0, "g_noise_mg": 1.0}\n' * 20,
    "empty": b"",
    "directory": None,
}
FILES = ("drift.json", "toolface.jsonl", "surveys.jsonl", "starts.json", "outbox.sqlite", "recordings", "lock")


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    with Mosquitto(tmp_path_factory.mktemp("broker")) as mosquitto:
        yield mosquitto


def configuration(folder: Path, port: str, broker_port: int, extra: str = "") -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "tool"\n[mqtt]\n'
        f'port = {broker_port}\n[drift]\nazimuth_deg = 10.0\n[service]\nstate_dir = "{folder / "state"}"\n'
        f"health_interval_s = 0.1\n{extra}"
    )
    return path


def frames(first: int, last: int) -> bytes:
    return b"".join(
        encode(i % 65536, i / 100.0, (0.1 + 1e-5 * (i % 7), 0.2, 0.97), gyro_dps=(0.0, 0.0, 0.0))
        for i in range(first, last)
    )


def damage(path: Path, content: bytes | None) -> None:
    if content is None:
        path.mkdir()
        (path / "inside").write_text("kept")
    else:
        path.write_bytes(content)


def has_content(path: Path, content: bytes | None) -> bool:
    """Whether it holds (at its beginning) what the damage was."""
    if content is None:
        return (path / "inside").is_file()
    return path.is_file() and path.read_bytes()[: len(content)] == content


def run_with(tmp_path: Path, broker: Mosquitto, contents: dict[str, bytes | None], **environment: str):
    """A run from start to end on these state files; returns the last health and the log."""
    line, subscriber = Pty(), Subscriber(broker.port)
    state = tmp_path / "state"
    state.mkdir()
    for name, content in contents.items():
        damage(state / name, content)
    path = configuration(tmp_path, line.path, broker.port)
    try:
        with running(path, env=environment) as daemon:
            wait_for(
                lambda: (h := subscriber.latest("health")) and h["link"]["opens"] == 1, 30, "the daemon at work", daemon
            )
            line.write_all(frames(0, 200))
            wait_for(lambda: len(subscriber.payloads("attitude")) >= 19, 20, "attitudes", daemon)
            health = wait_for(
                lambda: (h := subscriber.latest("health")) and h["monitor"]["good"] == 200 and h, 10, "health", daemon
            )
            assert all(health["balance"].values())
            assert daemon.terminate() == 0, daemon.log
            assert "Traceback" not in daemon.log, daemon.log
            return health, daemon.log
    finally:
        subscriber.close()
        line.close()


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", DAMAGES)
def test_all_state_files_damaged_at_once_do_not_end_the_service(tmp_path, broker, kind):
    contents = {name: DAMAGES[kind] for name in FILES if name != "recordings" or DAMAGES[kind] is not None}
    health, log = run_with(tmp_path, broker, contents)
    state = tmp_path / "state"
    asides = {path.name.split(".damaged-")[0] for path in state.iterdir() if ".damaged-" in path.name}
    damaged_files = {one["file"] for one in health["damaged"]}
    for name in ("drift.json", "toolface.jsonl"):
        if name == "toolface.jsonl" and kind in ("torn", "empty"):
            continue  # an unfinished last line was never confirmed: no damage
        assert name in damaged_files, health["damaged"]
        assert name in asides
        kept = next(path for path in state.iterdir() if path.name.startswith(f"{name}.damaged-"))
        assert has_content(kept, DAMAGES[kind])
        assert sum(f"{name}" in line and "kept as" in line for line in log.splitlines()) == 1
    if damaged_files:
        assert "damaged_file" in health["alarms"]
    if kind == "directory":
        assert {"surveys.jsonl", "lock"} <= asides
    elif kind != "empty":
        assert {"recordings"} <= asides
        assert "recordings" in damaged_files
    # nothing of it is alarmed as if it still were so
    assert "survey_storage" not in health["alarms"]
    assert "recorder_storage" not in health["alarms"]
    assert "outbox_storage" not in health["alarms"]


@pytest.mark.timeout(120)
def test_state_files_whose_size_is_damaged_are_set_aside_and_not_read(tmp_path, broker):
    """As after a loss of power on some file systems: 1.9 GB of nothing each. A tool may have 512 MB."""
    (tmp_path / "state").mkdir()
    line, subscriber = Pty(), Subscriber(broker.port)
    for name in ("drift.json", "toolface.jsonl", "starts.json"):
        (tmp_path / "state" / name).touch()
        os.truncate(tmp_path / "state" / name, 1_900_000_000)
    try:
        with running(configuration(tmp_path, line.path, broker.port)) as daemon:
            health = wait_for(
                lambda: (h := subscriber.latest("health")) and h["link"]["opens"] == 1 and h, 30, "at work", daemon
            )
            peak = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{daemon.process.pid}/status").read_text())
            assert peak is not None and int(peak[1]) < 400_000
            assert {"drift.json", "toolface.jsonl"} <= {one["file"] for one in health["damaged"]}
            assert daemon.terminate() == 0, daemon.log
            assert "Traceback" not in daemon.log
    finally:
        subscriber.close()
        line.close()


def test_a_lost_toolface_offset_is_reported_until_it_is_set_anew(tmp_path, broker):
    health, _ = run_with(tmp_path, broker, {"toolface.jsonl": b"[" * 100_000 + b"\n{}\n"})
    assert "toolface_offset" in health["alarms"]
    line, subscriber = Pty(), Subscriber(broker.port)
    path = configuration(tmp_path, line.path, broker.port)
    try:
        with running(path) as daemon:
            # also after the next start, when the damaged file is out of the way
            health = wait_for(
                lambda: (h := subscriber.latest("health")) and "toolface_offset" in h["alarms"] and h, 20, "it", daemon
            )
            assert "set it anew" in health["toolface"]["error"]
            with (tmp_path / "state" / "toolface.jsonl").open("w") as file:
                json.dump({"t": 1.0, "offset_deg": 12.5, "author": "A", "note": "", "previous_deg": 0.0}, file)
                file.write("\n")
            health = wait_for(
                lambda: (h := subscriber.latest("health")) and h["toolface"]["offset_deg"] == 12.5 and h,
                5,
                "12.5",
                daemon,
            )
            assert "toolface_offset" not in health["alarms"]
            assert daemon.terminate() == 0
    finally:
        subscriber.close()
        line.close()


def test_a_file_that_this_user_may_not_read_stays_where_it_is(tmp_path, monkeypatch):
    path = tmp_path / "drift.json"
    path.write_bytes(b"of somebody else")
    # root may read everything: what another user would be told
    monkeypatch.setattr(os, "access", lambda *_: False)
    damaged = DamageLog()
    line = damaged.note(path, "cannot be read by this user", "nothing is lost")
    assert "left where it is" in line
    assert damaged.as_list() == [{"file": "drift.json", "what": "cannot be read by this user", "aside": None}]
    assert path.read_bytes() == b"of somebody else"


@pytest.mark.timeout(120)
def test_a_service_that_is_killed_again_and_again_says_so(tmp_path, broker):
    line, subscriber = Pty(), Subscriber(broker.port)
    path = configuration(tmp_path, line.path, broker.port)

    def at_work(daemon):
        pid_run = len(subscriber.payloads("health"))
        return wait_for(
            lambda: (p := subscriber.payloads("health")) and len(p) > pid_run and p[-1],
            20,
            "health of this run",
            daemon,
        )

    try:
        for count in range(3):
            with running(path) as daemon:
                health = at_work(daemon)
                assert health["starts"]["crashes"] == count
                assert "restarting" not in health["alarms"]
                daemon.kill()
        with running(path) as daemon:
            health = at_work(daemon)
            assert health["starts"]["crashes"] == 3
            assert "killed" in health["starts"]["last"]
            assert "restarting" in health["alarms"]
            daemon.process.send_signal(signal.SIGTERM)
            assert daemon.process.wait(10) == 0
        # an end that was asked for is none of them
        with running(path) as daemon:
            assert at_work(daemon)["starts"]["crashes"] == 3
            assert daemon.terminate() == 0
    finally:
        subscriber.close()
        line.close()


def test_a_start_that_fails_again_and_again_is_reported_once_it_succeeds(tmp_path, broker):
    missing = configuration(tmp_path, str(tmp_path / "no-such-port"), broker.port)
    for _ in range(3):
        with running(missing) as daemon:
            assert daemon.process.wait(30) == 2
    line, subscriber = Pty(), Subscriber(broker.port)
    try:
        with running(configuration(tmp_path, line.path, broker.port)) as daemon:
            health = wait_for(
                lambda: (h := subscriber.latest("health")) and "restarting" in h["alarms"] and h, 20, "it", daemon
            )
            assert "no-such-port" in health["starts"]["last"]
            assert daemon.terminate() == 0
    finally:
        subscriber.close()
        line.close()


@pytest.mark.timeout(120)
def test_a_state_directory_deleted_under_the_service_costs_no_message_and_is_told(tmp_path, broker):
    """`rm -rf` of what it has open, while messages wait in it for a broker."""
    line, state = Pty(), tmp_path / "state"
    path = configuration(tmp_path, line.path, free_port(), "[recorder]\nenabled = true\n")
    text = path.read_text()
    try:
        with running(path) as daemon:
            wait_for((state / "outbox.sqlite").exists, 30, "the daemon's outbox", daemon)
            wait_for(lambda: is_held(line.path), 10, "the port", daemon)
            line.write_all(frames(0, 200))
            wait_for(lambda: stored(state) >= 15, 10, "messages that wait", daemon)
            shutil.rmtree(state)
            wait_for(lambda: stored(state) >= 15, 5, "the same messages in a new file", daemon)
            assert len([log for log in daemon.log.splitlines() if "deleted or replaced while in use" in log]) == 1
            wait_for(lambda: another_is_refused(state), 10, "the directory's lock, taken again", daemon)

            subscriber = Subscriber(broker.port)
            try:
                path.write_text(text.replace(re.search(r"(?m)^port = \d+$", text)[0], f"port = {broker.port}"))
                daemon.process.send_signal(signal.SIGHUP)
                line.write_all(frames(200, 400))
                wait_for(lambda: len(seqs(subscriber)) >= 39, 10, "all attitudes", daemon)
                health = wait_for(lambda: subscriber.latest("health"), 10, "health", daemon)
                assert "outbox_replaced" in health["alarms"]
                assert "outbox_storage" not in health["alarms"]
                assert health["outbox"]["replaced"] == 1
                assert not health["outbox"]["dropped"]
                assert all(health["balance"].values())
                assert daemon.terminate() == 0, daemon.log
                found = seqs(subscriber)
                assert found == list(range(len(found)))
            finally:
                subscriber.close()
            assert "Traceback" not in daemon.log
            assert list((state / "recordings").iterdir()), "the recorder went on, too"
    finally:
        line.close()


def another_is_refused(state: Path) -> bool:
    """Whether a second service could not begin in the directory."""
    try:
        with (state / "lock").open("r") as file:
            take_lock(file.fileno(), shared=True)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def seqs(subscriber: Subscriber) -> list[int]:
    return sorted({payload["seq"] for payload in subscriber.payloads("attitude")})


def stored(state: Path) -> int:
    try:
        return inspect(state / "outbox.sqlite").queued
    except InputError:
        return 0
