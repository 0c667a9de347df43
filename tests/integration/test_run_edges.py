"""Service and commands at the edges: reloads in mid-stream, odd signals, odd input. Real processes, a real broker."""

from __future__ import annotations

import json
import os
import random
import signal
import stat
import subprocess
import time
from pathlib import Path

import pytest
from broker import Mosquitto
from daemon import HIGHSIDE, Daemon, Pty, Subscriber, is_held, running, wait_for

from highside.codec import vn100
from highside.codec.tool import encode
from highside.config.settings import validate
from highside.link.base import Chunk
from highside.recording.files import write_whole
from highside.service.app import Service
from highside.service.outputs import AttitudeOutput

pytestmark = pytest.mark.slow

SERIAL = '[link]\nkind = "serial"\nport = "/dev/x"\n'
TOOL = '[codec]\nname = "tool"\n'


@pytest.fixture
def broker(tmp_path):
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


@pytest.fixture
def subscriber(broker):
    found = Subscriber(broker.port, "#")
    yield found
    found.close()


@pytest.fixture
def line():
    found = Pty()
    yield found
    found.close()


def text(folder: Path, port: str, broker_port: int, *, codec: str = "tool", mqtt: str = "", extra: str = "") -> str:
    return (
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "{codec}"\n'
        f"[mqtt]\nport = {broker_port}\n{mqtt}\n"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.1\n{extra}'
    )


def stream(first: int, last: int) -> bytes:
    return b"".join(
        encode(i % 65536, i / 100.0, (0.1 + 1e-5 * (i % 7), 0.2, 0.97), temp_c=25.0) for i in range(first, last)
    )


def vn(i: int) -> bytes:
    return vn100.encode((0.0, 0.0, 0.0, 0.1 + 1e-3 * (i % 7), 0.2, -9.8, *[0.0] * 23))


def reload(daemon: Daemon, subscriber: Subscriber, path: Path, content: str) -> dict:
    """Write the file, say SIGHUP, wait until the reload was taken or refused; returns what `health` says of it."""
    before = (subscriber.latest("health") or {}).get("reload")
    path.write_text(content)
    daemon.process.send_signal(signal.SIGHUP)
    # not by the log: reloads that go alike are one line a minute there
    health = wait_for(
        lambda: (h := subscriber.latest("health")) and h["reload"] != before and h, 10, "the reload", daemon
    )
    return health["reload"]


def healthy(subscriber: Subscriber, condition, daemon: Daemon, what: str) -> dict:
    return wait_for(lambda: (h := subscriber.latest("health")) and condition(h) and h, 10, what, daemon)


def test_a_storm_of_reloads_between_two_links_ends_on_the_last_one_and_sigterm_in_the_midst_of_one_is_obeyed(
    tmp_path, broker, subscriber, line
):
    other = Pty()
    path = tmp_path / "highside.toml"
    texts = [text(tmp_path, port, broker.port) for port in (line.path, other.path)]
    path.write_text(texts[0])
    with running(path) as daemon:
        healthy(subscriber, lambda h: h["link"]["opens"] >= 1, daemon, "the link to open")
        for i in range(41):
            path.with_suffix(".new").write_text(texts[(i + 1) % 2])
            path.with_suffix(".new").replace(path)
            daemon.process.send_signal(signal.SIGHUP)
            time.sleep(0.003 * (i % 5))
        wait_for(lambda: is_held(other.path) and not is_held(line.path), 10, "the last link alone", daemon)
        healthy(subscriber, lambda h: h["link"]["opens"] == 1 and h["reload"]["count"] > 1, daemon, "one open link")
        other.write_all(stream(0, 100))
        health = healthy(subscriber, lambda h: h["monitor"]["good"] == 100, daemon, "all frames")
        assert all(health["balance"].values()), health["balance"]
        path.write_text(texts[0])
        daemon.process.send_signal(signal.SIGHUP)
        path.write_text(texts[1])
        daemon.process.send_signal(signal.SIGHUP)
        assert daemon.terminate(10) == 0, daemon.log
        assert "Traceback" not in daemon.log
    other.close()


def test_impatient_signals_do_not_cut_the_orderly_end_short(tmp_path, broker, subscriber, line):
    path = tmp_path / "highside.toml"
    path.write_text(text(tmp_path, line.path, broker.port))
    with running(path) as daemon:
        healthy(subscriber, lambda h: h["link"]["opens"] >= 1, daemon, "the link to open")
        line.write_all(stream(0, 200))
        healthy(subscriber, lambda h: h["pipeline"]["attitudes"] >= 19, daemon, "attitudes")
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            daemon.process.send_signal(number)
            time.sleep(0.002)
        assert daemon.process.wait(10) == 0, daemon.log
        assert "Traceback" not in daemon.log
        wait_for(lambda: [m for m in subscriber.drain() if m[1].startswith(b"offline ")], 3, "offline")


def test_the_retained_health_of_a_daemon_that_left_has_the_final_counts(tmp_path, broker, subscriber, line):
    path = tmp_path / "highside.toml"
    path.write_text(text(tmp_path, line.path, broker.port).replace("health_interval_s = 0.1", "health_interval_s = 60"))
    with running(path) as daemon:
        wait_for(lambda: is_held(line.path), 10, "the link to open", daemon)
        line.write_all(stream(0, 200))
        wait_for(lambda: len(subscriber.payloads("attitude")) >= 19, 10, "attitudes", daemon)
        assert daemon.terminate(10) == 0
    late = Subscriber(broker.port, "highside/t1/health")
    kept = wait_for(lambda: late.drain(), 5, "the retained health")
    late.close()
    health = json.loads(kept[-1][1])
    assert health["monitor"]["good"] == 200
    assert all(health["balance"].values()), health["balance"]


def test_new_limits_in_the_middle_of_a_frame_lose_nothing(tmp_path, broker, subscriber, line):
    path = tmp_path / "highside.toml"
    content = text(tmp_path, line.path, broker.port)
    path.write_text(content)
    with running(path) as daemon:
        healthy(subscriber, lambda h: h["link"]["opens"] >= 1, daemon, "the link to open")
        data = stream(0, 200)
        cut = len(data) // 2 + 11
        line.write_all(data[:cut])
        healthy(subscriber, lambda h: h["codec"]["bytes_pending"] > 0, daemon, "half a frame")
        last_health = reload(
            daemon,
            subscriber,
            path,
            content + "[monitor]\nrange_g = 5\n[rolling_bias]\napply = true\n[survey]\nstill_s = 2\n",
        )
        assert last_health == {"count": 1, "refused": None}
        line.write_all(data[cut:])
        health = healthy(subscriber, lambda h: h["monitor"]["received"] == 200, daemon, "all frames")
        assert (health["monitor"]["gap"], health["codec"]["bytes_junk"]) == (0, 0)
        assert all(health["balance"].values()), health["balance"]
        line.write_all(encode(200, 2.0, (6.0, 0.0, 0.0)))
        healthy(subscriber, lambda h: h["monitor"]["out_of_range"] == 1, daemon, "the new limit")


def test_codec_broker_and_recorder_change_in_mid_stream_and_the_counters_balance(tmp_path, broker, subscriber, line):
    path = tmp_path / "highside.toml"
    path.write_text(text(tmp_path, line.path, broker.port))
    with running(path) as daemon:
        healthy(subscriber, lambda h: h["link"]["opens"] >= 1, daemon, "the link to open")
        line.write_all(stream(0, 100) + b"junk" * 9)
        healthy(subscriber, lambda h: h["monitor"]["good"] == 100, daemon, "tool frames")
        assert reload(daemon, subscriber, path, text(tmp_path, line.path, broker.port, codec="vn100"))["count"] == 1
        line.write_all(b"noise" + b"".join(vn(i) + b"\nM,%d\n\r\n" % (10 * i) for i in range(50)) + vn(50))
        health = healthy(subscriber, lambda h: h["monitor"]["good"] == 50, daemon, "vn100 frames")
        # the last frame waits for its time: it is held, not lost, and nobody is alarmed
        assert health["codec"]["frames_held"] == 1
        assert all(health["balance"].values()), health["balance"]
        renamed = text(tmp_path, line.path, broker.port, mqtt='prefix = "drill"', extra="[recorder]\nenabled = false\n")
        assert reload(daemon, subscriber, path, renamed) == {"count": 2, "refused": None}
        line.write_all(stream(0, 100))
        health = healthy(subscriber, lambda h: h["monitor"]["good"] == 100, daemon, "tool frames again")
        assert health["recorder"] is None
        assert all(health["balance"].values()), health["balance"]
        wait_for(
            lambda: {m[0] for m in subscriber.drain()} >= {f"drill/t1/{n}" for n in ("attitude", "health", "status")},
            10,
            "the new topics",
            daemon,
        )
        # what only a restart can change, or cannot be used, is refused by name and changes nothing
        for wrong, named in (
            ("[mqtt.outbox]\nmax_rows = 500", "mqtt.outbox"),
            ("[mqtt.tls]\nca = 'no.pem'", "mqtt.tls.ca"),
        ):
            last_health = reload(daemon, subscriber, path, renamed.replace("[service]", f"{wrong}\n[service]"))
            assert named in last_health["refused"]
            assert last_health["count"] == 2
        assert daemon.terminate(10) == 0
    seqs = sorted(json.loads(p)["seq"] for t, p, _, _ in subscriber.drain() if t == "highside/t1/attitude")
    assert seqs == list(range(len(seqs)))


def test_a_device_that_sends_no_time_is_paced_by_the_clock_of_arrival(tmp_path):
    found: list[AttitudeOutput] = []
    tables = {
        "link": {"kind": "serial", "port": "/dev/x"},
        "codec": {"name": "vn100", "time_line": False},
        "service": {"state_dir": str(tmp_path)},
    }
    service = Service(validate(tables, where="test"))
    service.pipeline._emit = found.append
    rng = random.Random(3)
    for i in range(1000):
        # pairs arrive every 20 ms, with jitter: the step between two frames says nothing about the pace
        service.on_batch(Chunk(100.0 + i / 50.0 + rng.uniform(0.0, 0.004), 0.0, vn(2 * i) + vn(2 * i + 1)))
    attitudes = [one for one in found if isinstance(one, AttitudeOutput)]
    assert 198 <= len(attitudes) <= 201
    assert 119.8 <= attitudes[-1].t_device_s <= 120.0


def test_a_rare_output_keeps_no_more_than_the_window(tmp_path):
    tables = {
        "link": {"kind": "serial", "port": "/dev/x"},
        "codec": {"name": "tool"},
        "pipeline": {"output_rate_hz": 1e-6, "averaging_s": 1.0},
        "service": {"state_dir": str(tmp_path)},
    }
    service = Service(validate(tables, where="test"))
    service.on_batch(Chunk(1.0, 0.0, stream(0, 3000)))
    assert service.pipeline.monitor.counts.good == 3000
    assert len(service.pipeline._window) <= 102


def test_what_is_no_regular_file_is_written_to_and_never_replaced(tmp_path):
    pipe, link, target = tmp_path / "pipe", tmp_path / "link.csv", tmp_path / "target.csv"
    os.mkfifo(pipe)
    # open before anything is written: a pipe that nobody reads is refused
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_whole(pipe, b"rows")
        assert os.read(reader, 100) == b"rows"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.csv", "pipe", "target.csv"]


def command(*arguments: object, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(HIGHSIDE), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=30,
        env={**os.environ, **(env or {})},
        stdin=subprocess.DEVNULL,
    )


CHECKS = [
    (SERIAL + TOOL + "[mqtt.tls]\ncaa = 1\n", (), {}, ("mqtt.tls.caa", "'ca'")),
    (SERIAL + TOOL + "[mqtt.tls]\nca = 'no.pem'\n", (), {}, ("mqtt.tls.ca", "no.pem")),
    (SERIAL + TOOL + "[mqtt]\nusername = 'a'\npassword_file = 'no.pw'\n", (), {}, ("mqtt.password_file", "no.pw")),
    (SERIAL.replace("port", "prot") + TOOL, (), {}, ("link.p",)),
    (SERIAL + TOOL + "[survey]\nstill_s = inf\n", (), {}, ("survey.still_s", "finite")),
    ("tool = 5\n" + SERIAL + TOOL, (), {}, ("tool", "table")),
    ("a = " + "[" * 5000, (), {}, ("TOML",)),
    ('[link]\nkind = "simulated"\n[codec]\nname = "vn100"\n', (), {}, ("simulated", "'tool'")),
    ('[link]\nkind = "replay"\npath = "bus.log"\n' + TOOL, (), {}, ("carries can", "bytes")),
    ('[link]\nkind = "socketcan"\ninterface = "can0"\n[codec]\nname = "dbc"\nemit_on = "X"\n', (), {}, ("emit_on",)),
    (SERIAL + TOOL, ("--set", "mqtt.port=zz"), {}, ("--set", "mqtt.port")),
    (SERIAL + TOOL, (), {"HIGHSIDE__MQTT__PORT": "zz"}, ("HIGHSIDE__MQTT__PORT",)),
    (SERIAL + TOOL, (), {"HIGHSIDE__MQQT__PORT": "1"}, ("HIGHSIDE__MQQT__PORT", "'mqtt'")),
]


@pytest.mark.parametrize(("content", "arguments", "env", "named"), CHECKS)
def test_what_cannot_work_is_one_line_that_names_it(tmp_path, content, arguments, env, named):
    path = tmp_path / "edge.toml"
    path.write_text(content)
    (tmp_path / "bus.log").write_text("(1.000000) can0 024#0011223344556677\n" * 9)
    run = command("check", path, *arguments, env=env)
    assert run.returncode == 2, run.stderr
    assert len(run.stderr.strip().splitlines()) == 1, run.stderr
    for name in named:
        assert name in run.stderr


@pytest.mark.parametrize(
    "arguments", [("nope",), ("run",), ("demo", "--seconds", "nan"), ("demo", "--bad"), ("check", "x" * 300)]
)
def test_wrong_usage_is_one_line_and_exit_status_2(arguments):
    run = command(*arguments)
    assert run.returncode == 2
    assert len(run.stderr.strip().splitlines()) == 1, run.stderr
    assert run.stderr.startswith("highside: ")


def test_the_environment_of_a_service_does_not_reach_the_demonstration():
    run = command("demo", "--seconds", "1", "--json", env={"HIGHSIDE__MQTT__PORT": "9", "HIGHSIDE__TOOL__ID": "other"})
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    assert (summary["published"] > 0, summary["lost"]) == (True, 0)


def test_a_decoded_file_that_cannot_be_written_is_one_line_and_leaves_nothing(tmp_path):
    raw = tmp_path / "raw.bin"
    raw.write_bytes(stream(0, 20))
    run = command("decode", raw, "--codec", "tool", "-o", tmp_path / "no" / "out.csv", "--json")
    assert run.returncode == 2
    assert run.stdout == ""
    assert len(run.stderr.strip().splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["raw.bin"]
