"""The rig pack live: a simulated tool on a pty, real mosquitto, WITS over a pty and TCP, a Prometheus scrape, doctor.

The WITS parser here is the test's own and knows nothing of the product's.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest
from broker import Mosquitto, free_port
from daemon import HIGHSIDE, Pty, Subscriber, running, still_tool, wait_for
from prometheus_client.parser import text_string_to_metric_families

pytestmark = pytest.mark.slow

RECORD = re.compile(rb"&&\r\n((?:[0-9]{4}[ -~]*\r\n)+)!!\r\n")


def independent_records(data: bytes) -> tuple[list[dict[str, str]], bytes]:
    """Records by a regular expression, and the bytes that belong to none."""
    found = []
    for match in RECORD.finditer(data):
        lines = match[1].decode("ascii").split("\r\n")[:-1]
        found.append({line[:4]: line[4:] for line in lines})
    return found, RECORD.sub(b"", data)


@pytest.fixture
def broker(tmp_path):
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


def receive(sock: socket.socket, enough: int, timeout_s: float = 20.0) -> bytes:
    sock.settimeout(timeout_s)
    data = b""
    while len(RECORD.findall(data)) < enough:
        piece = sock.recv(4096)
        assert piece, "the peer closed"
        data += piece
    return data


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(HIGHSIDE), *arguments], capture_output=True, text=True, timeout=120, check=False)


def test_the_whole_pack_live(tmp_path: Path, broker: Mosquitto) -> None:
    line, server_port, client_listener = Pty(), free_port(), socket.create_server(("127.0.0.1", 0))
    metrics_port = free_port()
    wits = "".join(
        f"[[wits]]\n{table}\ninterval_s = 0.2\n"
        for table in (
            f'kind = "serial"\nport = "{line.path}"\nbaud = 9600\ngreeting = [["1984", "RIG 12"]]',
            f'kind = "tcp_server"\nport = {server_port}',
            f'kind = "tcp_client"\nhost = "127.0.0.1"\nport = {client_listener.getsockname()[1]}',
        )
    )
    extra = f"{wits}[metrics]\nport = {metrics_port}\n[home_assistant]\n[site]\ngravity_mps2 = 9.81\n"
    path = still_tool(tmp_path / "live", broker.port, extra)
    subscriber = Subscriber(broker.port, "#")
    assert command("toolface", "set", "100", "--config", str(path), "--author", "day shift").returncode == 0
    try:
        with running(path) as daemon:
            first = wait_for(lambda: subscriber.latest("attitude"), 30, "an attitude", daemon)
            assert first["motor_toolface_deg"] == pytest.approx((first["tf_deg"] + 100.0) % 360.0, abs=1e-5)
            assert first["toolface_offset_deg"] == 100.0
            assert first["tf_deg"] == pytest.approx(45.0, abs=1.0)

            survey = wait_for(lambda: subscriber.latest("survey"), 30, "a survey", daemon)
            assert (survey["accepted"], survey["reasons"]) == (True, [])
            assert survey["g_error_std_mg"] > 0.0
            kept = tmp_path / "live" / "state" / "surveys.jsonl"
            wait_for(lambda: kept.exists() and kept.read_text().count("\n"), 5, "the kept survey", daemon)
            line_kept = json.loads(kept.read_text().splitlines()[0])
            assert {k: line_kept[k] for k in ("seq", "inc_deg", "accepted")} == {
                k: survey[k] for k in ("seq", "inc_deg", "accepted")
            }

            # one that asks, one that is called, and the line: each gets whole records with the same values
            peer = socket.create_connection(("127.0.0.1", server_port))
            called, _ = client_listener.accept()
            called.sendall(b"&&\r\n01082750.1\r\n01102811.25\r\n!!\r\n")
            streams = {"server": receive(peer, 3), "client": receive(called, 8), "serial": b""}
            while len(RECORD.findall(streams["serial"])) < 3:
                streams["serial"] += os.read(line.master, 4096)
            for name, data in streams.items():
                records, rest = independent_records(data)
                assert RECORD.match(data), f"{name}: it begins with a whole record"
                # but for a record that is still on its way, not one byte is foreign
                assert rest == b"" or rest.startswith(b"&&"), name
                if name == "serial":
                    assert records.pop(0) == {"1984": "RIG 12"}
                for record in records:
                    assert set(record) <= {"0705", "0706", "0708", "0713", "0717"}
                    assert float(record["0713"]) == pytest.approx(30.0, abs=0.3)
                    assert float(record["0717"]) == pytest.approx(145.0, abs=1.0)
                    assert re.fullmatch(r"\d{6}", record["0705"])
                    assert re.fullmatch(r"\d{6}", record["0706"])
            # the depth that the rig told one output is known to all
            assert independent_records(streams["client"])[0][-1]["0708"] == "2811.25"

            # a peer that reads nothing holds nobody up
            for _ in range(3):
                before = len(subscriber.payloads("attitude"))
                time.sleep(0.5)
                assert len(subscriber.payloads("attitude")) >= before + 3
            peer.close()
            called.close()

            scrape = urllib.request.urlopen(f"http://127.0.0.1:{metrics_port}/metrics", timeout=10).read().decode()
            families = {family.name: family for family in text_string_to_metric_families(scrape)}
            assert families["highside_up"].samples[0].value == 1.0
            value = families["highside_inc_deg"].samples[0]
            assert value.labels == {"tool": "t1"}
            assert value.value == pytest.approx(30.0, abs=0.3)
            produced = families["highside_outbox_produced"].samples[0].value
            assert produced >= first["seq"]
            assert {s.labels["verdict"] for s in families["highside_surveys"].samples} == {"accepted", "refused"}
            assert len(families["highside_shocks"].samples) == 15

            dashboard = json.loads((Path(__file__).parents[2] / "config" / "grafana-dashboard.json").read_text())
            used = set(re.findall(r"highside_[a-z0-9_]+", json.dumps(dashboard["panels"])))
            served = {sample.name for family in families.values() for sample in family.samples}
            assert used, "the dashboard shows something"
            # those of the watch need a calibration record: test_watch_live
            used = {name for name in used if not name.startswith("highside_watch")}
            assert used <= served, f"the dashboard asks for what nobody serves: {used - served}"

            topic, payload, *_ = next(m for m in subscriber.drain() if m[0].startswith("homeassistant/"))
            message = json.loads(payload)
            assert topic == "homeassistant/device/highside_t1/config"
            assert message["availability_topic"] == "highside/t1/status"
            assert message["components"]["inc"]["state_topic"] == "highside/t1/latest"
            seconds = wait_for(lambda: len(m := subscriber.payloads("latest")) > 3 and m, 10, "latest", daemon)
            assert seconds[-1]["t"] - seconds[-4]["t"] > 2.5
            assert seconds[-1]["inc_deg"] == pytest.approx(first["inc_deg"], abs=0.5)
            assert message["device"]["serial_number"] == "SN 7"

            # a new offset is in force within seconds, and health says who set it
            assert (
                command("toolface", "set", "--config", str(path), "--author", "night shift", "--", "-45").returncode
                == 0
            )
            latest = lambda: subscriber.latest("attitude") or {}  # noqa: E731
            wait_for(lambda: latest().get("toolface_offset_deg") == 315.0, 10, "the offset", daemon)
            health = wait_for(
                lambda: h if (h := subscriber.latest("health")) and h["toolface"]["author"] == "night shift" else None,
                5, "the author in health", daemon,
            )  # fmt: skip
            assert health["toolface"]["previous_deg"] == 100.0
            assert health["surveys"]["accepted"] >= 1
            assert [w["made"] > 0 for w in health["wits"]] == [True] * 3
            assert health["vibration"]["max_rms_g"] == pytest.approx([0.0] * 3, abs=0.01)
            assert "set by night shift" in daemon.log
            assert daemon.terminate() == 0
    finally:
        subscriber.close()
        line.close()
        client_listener.close()
    shown = command("toolface", "show", "--config", str(path))
    assert [text in shown.stdout for text in ("100.000 deg  by day shift", "315.000 deg  by night shift")] == [True] * 2


def test_a_rig_that_is_away_dead_or_comes_back(tmp_path: Path, broker: Mosquitto) -> None:
    """No port, no listener at first: acquisition goes on, the outputs come when the rig does."""
    absent, port = tmp_path / "ttyRIG", free_port()
    extra = (
        f'[[wits]]\nkind = "serial"\nport = "{absent}"\ninterval_s = 0.2\n'
        f'[[wits]]\nkind = "tcp_client"\nhost = "127.0.0.1"\nport = {port}\ninterval_s = 0.2\n'
    )
    path = still_tool(tmp_path / "away", broker.port, extra)
    subscriber = Subscriber(broker.port)
    try:
        with running(path) as daemon:
            wait_for(lambda: len(subscriber.payloads("attitude")) > 10, 30, "attitudes", daemon)
            health = wait_for(lambda: h if (h := subscriber.latest("health")) and "wits_away" in h["alarms"] else None,
                              10, "the alarm", daemon)  # fmt: skip
            assert [w["peers"] for w in health["wits"]] == [0, 0]
            for _ in range(2):
                with socket.create_server(("127.0.0.1", port)) as listener:
                    listener.settimeout(20)
                    peer, _ = listener.accept()
                    assert receive(peer, 2)
                    # it dies without a word
                    peer.close()
            line = Pty()
            absent.symlink_to(line.path)
            data, deadline = b"", time.monotonic() + 20.0
            while len(RECORD.findall(data)) < 2:
                assert time.monotonic() < deadline
                # nobody holds the other end yet: an error, not an end
                with contextlib.suppress(OSError):
                    data += os.read(line.master, 4096)
            line.close()
            attitudes = subscriber.payloads("attitude")
            assert [a["seq"] for a in attitudes] == list(range(attitudes[0]["seq"], attitudes[-1]["seq"] + 1))
            assert daemon.terminate() == 0
    finally:
        subscriber.close()


def test_reload_takes_new_outputs_and_refuses_what_cannot_be(tmp_path: Path, broker: Mosquitto) -> None:
    path = still_tool(tmp_path / "reload", broker.port, "")
    good = path.read_text()
    subscriber = Subscriber(broker.port)
    try:
        with running(path) as daemon, socket.create_server(("127.0.0.1", 0)) as taken:
            wait_for(lambda: subscriber.latest("attitude"), 30, "an attitude", daemon)
            path.write_text(f"{good}[metrics]\nport = {taken.getsockname()[1]}\n")
            daemon.process.send_signal(signal.SIGHUP)
            health = wait_for(
                lambda: h if (h := subscriber.latest("health")) and h["reload"]["refused"] else None,
                10, "a refusal", daemon,
            )  # fmt: skip
            assert "cannot listen on 127.0.0.1" in health["reload"]["refused"]
            port = free_port()
            path.write_text(f'{good}[[wits]]\nkind = "tcp_server"\nport = {port}\ninterval_s = 0.2\n')
            daemon.process.send_signal(signal.SIGHUP)
            wait_for(lambda: (subscriber.latest("health") or {}).get("wits"), 10, "the output", daemon)
            peer = wait_for(lambda: _connected(port), 10, "the server", daemon)
            assert receive(peer, 2)
            peer.close()
            for _ in range(10):  # who comes and goes all day does not fill the log
                peer = wait_for(lambda: _connected(port), 10, "the server", daemon)
                assert receive(peer, 1)
                peer.close()
            assert daemon.terminate() == 0
            assert len([said for said in daemon.log.splitlines() if "wits" in said]) <= 4, daemon.log
    finally:
        subscriber.close()


def _connected(port: int) -> socket.socket | None:
    try:
        return socket.create_connection(("127.0.0.1", port), 1.0)
    except OSError:
        return None


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ('[[wits]]\nkind = "serial"\n', "wits.0.port: is missing"),
        ('[[wits]]\nkind = "pigeon"\n', "wits.0.kind: 'pigeon' is unknown"),
        ('[[wits]]\nkind = "tcp_server"\nport = 1\nitems = [{code = "7", value = "inc_deg"}]\n', "wits.0.items.0.code"),
        ('[site]\ngravity_mps2 = 1.0\n', "site.gravity_mps2"),
        ('[survey.accept]\nmin_temp_c = 10.0\nmax_temp_c = 5.0\n', "`max_temp_c` must be above `min_temp_c`"),
        ('[vibration]\nrms_levels_g = [2.0, 1.0]\n', "`rms_levels_g` must rise"),
    ],
)  # fmt: skip
def test_a_wrong_table_is_named(tmp_path: Path, extra: str, message: str) -> None:
    path = tmp_path / "c.toml"
    path.write_text(f'[link]\nkind = "simulated"\n[codec]\nname = "tool"\n{extra}')
    answer = command("check", str(path))
    assert answer.returncode == 2, answer.stderr
    assert message in answer.stderr
    assert answer.stderr.count("\n") == 1
