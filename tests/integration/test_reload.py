"""Reloads of a real daemon: bad ones of every kind while frames flow, refused calibrations, what systemd is told."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from bad_reloads import bad_files
from broker import Mosquitto
from daemon import Daemon, Pty, Subscriber, running, wait_for

from highside.calibration.record import (
    CalibrationRecord,
    Environment,
    RecordReason,
    SolveRequest,
    build_record,
    solve_poses,
)
from highside.codec.tool import encode
from highside.config.settings import Settings, validate
from highside.recording.calibration_store import CalibrationStore
from highside.service.demo import factory_record
from highside.service.in_force import calibration_for
from highside.service.known_time import Present

pytestmark = pytest.mark.slow

ANSWER = re.compile(r" (?:INFO|ERROR) +reload(?: refused|ed).*")
NAN_COMPENSATION = '{"schema":"highside.rotation/1","id":"x","unit":"arcmin","a":NaN}'


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    with Mosquitto(tmp_path_factory.mktemp("broker")) as mosquitto:
        yield mosquitto


class Manager:
    """Stands in for systemd: keeps what the service says, but for its regular status."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._socket.setblocking(False)
        self._heard: list[str] = []

    def heard(self) -> list[str]:
        with contextlib.suppress(BlockingIOError):
            while True:
                self._heard.append(self._socket.recv(4096).decode())
        return [text for text in self._heard if not text.startswith(("STATUS=", "WATCHDOG="))]


class Tool(threading.Thread):
    """Sends frames on a line at 500/s until stopped."""

    def __init__(self, line: Pty, rate_hz: float = 500.0) -> None:
        super().__init__(daemon=True)
        self._line, self._rate, self._ending = line, rate_hz, threading.Event()
        self.sent = 0

    def run(self) -> None:
        begin = time.monotonic()
        while not self._ending.wait(0.004):
            due = int((time.monotonic() - begin) * self._rate)
            self._line.write_all(b"".join(frame(i, self._rate) for i in range(self.sent, due)))
            self.sent = due

    def stop(self) -> None:
        self._ending.set()
        self.join()


def frame(i: int, rate_hz: float) -> bytes:
    return encode(i % 65536, i / rate_hz, (0.1 + 1e-5 * (i % 7), 0.2, 0.97), temp_c=25.0)


def text(
    folder: Path, port: str, broker_port: int, *, tool: str = 'id = "t1"', rate: object = 10, extra: str = ""
) -> str:
    return (
        f'[tool]\n{tool}\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "tool"\n'
        f"[pipeline]\noutput_rate_hz = {rate}\n[mqtt]\nport = {broker_port}\n"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.1\n{extra}'
    )


class Reloads:
    """Writes a file, says SIGHUP, and waits for the answer in `health`."""

    def __init__(self, daemon: Daemon, subscriber: Subscriber, path: Path) -> None:
        self.daemon, self.subscriber, self._path = daemon, subscriber, path

    def __call__(self, content: str | None = None) -> dict:
        if content is not None:
            self._path.write_text(content)
        log, before = len(self.daemon.log), self.health()
        self.daemon.process.send_signal(signal.SIGHUP)
        health = wait_for(lambda: (h := self.health())["reload"] != before["reload"] and h, 20, "reload", self.daemon)
        assert len(ANSWER.findall(self.daemon.log, log)) <= 1, self.daemon.log[log:]
        end = time.time()
        before = max(before["t"], health["t"])
        return wait_for(lambda: (h := self.health())["t"] > max(before, end) and h, 10, "the next health", self.daemon)

    def health(self) -> dict:
        return self.subscriber.latest("health")


@contextlib.contextmanager
def at_work(folder: Path, broker: Mosquitto, content: Callable[[str], str]):
    """A daemon on a line, with a stand-in for systemd."""
    line, subscriber, manager = Pty(), Subscriber(broker.port), Manager(folder)
    path = folder / "highside.toml"
    path.write_text(content(line.path))
    try:
        with running(path, env={"NOTIFY_SOCKET": manager.address}) as daemon:
            wait_for(lambda: (h := subscriber.latest("health")) and h["link"]["opens"] == 1, 30, "the link", daemon)
            yield Reloads(daemon, subscriber, path), line, manager
            assert daemon.terminate() == 0, daemon.log
            assert "Traceback" not in daemon.log
    finally:
        subscriber.close()
        line.close()


@pytest.mark.timeout(240)
def test_twenty_bad_reloads_of_every_kind_while_frames_flow_lose_nothing(tmp_path, broker):
    with socket.create_server(("127.0.0.1", 0)) as taken, at_work(
        tmp_path, broker, lambda port: text(tmp_path, port, broker.port)
    ) as (reload, line, manager):  # fmt: skip
        good = (tmp_path / "highside.toml").read_text()
        bad = bad_files(good, line.path, taken.getsockname()[1], tmp_path)
        assert len(bad) == 20
        tool = Tool(line)
        tool.start()
        for kind, content in bad.items():
            assert content != good, kind
            health = reload(content)
            reload_state = health["reload"]
            assert reload_state["refused"], kind
            assert (reload_state["count"], "reload_refused" in health["alarms"]) == (0, True), kind
            assert "\n" not in reload_state["refused"], kind
            answer = [message for message in manager.heard() if "READY=1" in message][-1]
            assert answer.startswith("READY=1\nSTATUS=reload refused: "), (kind, answer)
        (tmp_path / "highside.toml").unlink()
        assert "no such file" in reload()["reload"]["refused"]
        health = reload(good.replace("= 10", "= 20"))
        assert health["reload"] == {"count": 1, "refused": None}
        assert "reload_refused" not in health["alarms"]
        # other limits of the link leave it open: not a frame is lost
        health = reload(good.replace("[codec]", "stale_after_s = 1.5\n[codec]"))
        assert (health["reload"]["count"], health["link"]["opens"]) == (2, 1)
        tool.stop()
        health = wait_for(
            lambda: (h := reload.health())["monitor"]["good"] == tool.sent and h, 20, "all frames", reload.daemon
        )
        assert health["monitor"]["gap"] == 0
        assert health["codec"]["bytes_junk"] == 0
        assert health["link"]["opens"] == 1
        assert all(health["balance"].values())
        heard = [message.split("\n")[0] for message in manager.heard()]
        # 20 bad ones, one without a file, two good ones: each is answered, and says when it began
        assert heard == ["READY=1", *["RELOADING=1", "READY=1"] * 23]
        assert all("MONOTONIC_USEC=" in message for message in manager.heard() if message.startswith("RELOADING"))


@pytest.mark.timeout(120)
def test_what_was_refused_takes_effect_once_it_is_mended(tmp_path, broker):
    """An error that nobody expects, in the middle of a file that changes more; then the same file without it."""
    (tmp_path / "c.json").write_text(NAN_COMPENSATION)
    with at_work(tmp_path, broker, lambda port: text(tmp_path, port, broker.port)) as (reload, line, _):
        port = line.path
        bad = text(tmp_path, port, broker.port, rate=2, extra='[rotation]\ncompensation = "c.json"\n')
        health = reload(bad)
        # the compensation is refused and said so; file, health and behaviour agree
        assert "rotation_refused" in health["alarms"]
        assert health["reload"] == {"count": 1, "refused": None}
        tool = Tool(line)
        tool.start()
        time.sleep(3.0)
        tool.stop()
        made = wait_for(
            lambda: (h := reload.health())["monitor"]["good"] == tool.sent and h, 20, "all frames", reload.daemon
        )["pipeline"]["attitudes"]
        assert abs(made - 2 * tool.sent / 500.0) <= 2
        # a number of 5,000 digits refuses all of it; the mended file is then applied although it was seen before
        health = reload(bad.replace("= 2\n", f"= {'1' * 5000}\n"))
        assert health["reload"]["refused"]
        health = reload(text(tmp_path, port, broker.port, rate=50))
        assert health["reload"] == {"count": 2, "refused": None}
        assert health["rotation"] is None
        for i in range(tool.sent, tool.sent + 500):
            line.write_all(frame(i, 500.0))
        health = wait_for(
            lambda: (h := reload.health())["monitor"]["good"] == tool.sent + 500 and h, 20, "all", reload.daemon
        )
        assert abs(health["pipeline"]["attitudes"] - made - 50) <= 2


@pytest.mark.timeout(120)
def test_a_calibration_that_is_refused_at_a_reload_leaves_the_one_in_force(tmp_path, broker):
    record = factory_record()
    file = tmp_path / "cal.json"
    whole = record.to_json()
    file.write_text(whole)
    tool = f'id = "{record.tool_id}"'
    with at_work(
        tmp_path, broker,
        lambda port: text(tmp_path, port, broker.port, tool=tool, extra='[calibration]\nrecord = "cal.json"\n'),
    ) as (reload, line, _):  # fmt: skip
        assert reload.health()["calibration"]["cal_id"] == record.id
        damaged = {
            "torn": whole[:-400],
            "tampered": whole.replace('"conventional"', '"balance"', 1),
            "empty": "",
            "nested": "[" * 100_000,
            "of another tool": remade(record, tool_id="another").to_json(),
            "expired": remade(record, expires_s=record.created_s + 1.0).to_json(),
        }
        for kind, content in damaged.items():
            file.write_text(content)
            health = reload()
            assert health["reload"] == {"count": health["reload"]["count"], "refused": None}
            assert health["calibration"]["cal_id"] == record.id, kind
            assert health["calibration"]["kept"] is True
            assert health["calibration"]["refused"], kind
            assert {"calibration_refused", "calibration_kept"} <= set(health["alarms"]), kind
        file.unlink()
        assert [reload()["calibration"]["cal_id"] for _ in range(4)] == [record.id] * 4
        kept = [said for said in reload.daemon.log.splitlines() if "is kept:" in said]
        assert len(kept) == len(damaged) + 1, "each reason is one line, however often it is asked for"
        line.write_all(b"".join(frame(i, 100.0) for i in range(100)))
        wait_for(lambda: reload.health()["pipeline"]["attitudes"] >= 9, 10, "attitudes", reload.daemon)
        attitude = wait_for(lambda: reload.subscriber.latest("attitude"), 10, "one of them", reload.daemon)
        assert attitude["cal_id"] == record.id
        assert {"calibration_refused", "calibration_kept"} <= set(attitude["flags"])
        assert "uncalibrated" not in attitude["flags"]
        # mended: nothing of it stays
        file.write_text(whole)
        health = reload()
        assert health["calibration"] == {"cal_id": record.id, "refused": None, "reason": None, "kept": False}
        assert not {"calibration_refused", "calibration_kept"} & set(health["alarms"])


def remade(
    record: CalibrationRecord,
    *,
    tool_id: str | None = None,
    serial: str | None = None,
    created_s: float | None = None,
    expires_s: float | None = None,
) -> CalibrationRecord:
    """The same poses in another record."""
    poses, request = record.content["pose_table"], SolveRequest("conventional")
    return build_record(
        tool_id=tool_id or record.tool_id,
        serial=serial,
        request=request,
        result=solve_poses(poses, request).result,
        pose_columns=poses,
        raw_sha256="0" * 64,
        raw_name="again",
        environment=Environment(bench="simulated", temp_c=25.0),
        now_s=record.created_s if created_s is None else created_s,
        expires_s=expires_s,
    )


def known() -> Present:
    return Present(time.time(), known=True, surely_s=time.time())


def settings(**calibration: object) -> Settings:
    tool = {"id": calibration.pop("tool", "demo"), "serial": calibration.pop("serial", None)}
    tables = {"tool": tool, "link": {"kind": "simulated"}, "codec": {"name": "tool"}, "calibration": calibration}
    return validate(tables, where="test", environment=False)


def test_what_a_store_took_back_or_is_not_this_tools_is_not_kept(tmp_path):
    first, second = factory_record(), remade(factory_record(), serial="17")
    store = CalibrationStore(tmp_path / "store")
    store.activate(first, now_s=time.time())
    store.activate(second, now_s=time.time())
    asked = settings(tool=first.tool_id, store=str(tmp_path / "store"))
    running = calibration_for(asked, known())
    assert (running.correction.cal_id, running.flags) == (second.id, ())
    # torn: kept
    path = tmp_path / "store" / "records" / f"{second.id}.json"
    whole = path.read_text()
    path.write_text(whole[:-400])
    kept = calibration_for(asked, known(), running)
    assert (kept.correction.cal_id, kept.flags) == (second.id, ("calibration_refused", "calibration_kept"))
    # and again, from what is kept
    assert calibration_for(asked, known(), kept).kept
    # at a start there is nothing to keep
    assert calibration_for(asked, known()).flags == ("calibration_refused",)
    # the tool of another serial number: not the one that was calibrated
    other = settings(tool=first.tool_id, serial="18", store=str(tmp_path / "store"))
    assert calibration_for(other, known(), running).flags == ("calibration_refused",)
    # taken back, and what is in force instead cannot be read
    path.write_text(whole)
    store.rollback(first.tool_id, now_s=time.time())
    (tmp_path / "store" / "records" / f"{first.id}.json").write_text("{")
    gone = calibration_for(asked, known(), running)
    assert (gone.correction.cal_id, gone.flags) == ("none", ("calibration_refused",))
    # the store is away: it has taken nothing back
    (tmp_path / "store").rename(tmp_path / "away")
    assert calibration_for(asked, known(), running).kept
    # asked for none: none, and nothing is refused
    plain = calibration_for(settings(tool=first.tool_id), known(), running)
    assert (plain.correction.cal_id, plain.flags) == ("none", ())


def test_a_store_in_which_nothing_was_ever_put_in_force_is_no_refusal(tmp_path, caplog):
    (tmp_path / "store").mkdir()
    found = calibration_for(settings(store=str(tmp_path / "store")), known())
    assert found.flags == ("no_calibration",)
    assert found.reason is RecordReason.NONE_ACTIVE
    assert found.as_dict()["reason"] == "none_active"
    (told,) = caplog.records
    assert told.levelname == "WARNING" and "has no calibration in force" in told.getMessage()
    assert not any("refused" in text for text in (told.getMessage(), found.refused))


@pytest.mark.timeout(120)
def test_reloads_that_go_alike_are_one_line_a_minute_and_each_change_is_told(tmp_path, broker):
    with at_work(tmp_path, broker, lambda port: text(tmp_path, port, broker.port)) as (reload, _line, _manager):
        good = (tmp_path / "highside.toml").read_text()
        bad = good.replace("output_rate_hz = 10", "output_rate_hz = -1")
        assert [reload()["reload"]["count"] for _ in range(5)] == [1, 2, 3, 4, 5]
        for _ in range(5):
            assert reload(bad)["reload"]["refused"]
        assert reload(good)["reload"] == {"count": 6, "refused": None}
        told = [answer.split("reload", 1)[1][:8] for answer in ANSWER.findall(reload.daemon.log)]
        assert told == ["ed", " refused", "ed"], reload.daemon.log
