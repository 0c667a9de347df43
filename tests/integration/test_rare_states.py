"""What seldom happens to a daemon: keys that are no longer trusted, a clock of before 1970; and what it never tells."""

from __future__ import annotations

import signal
import subprocess
import time
from pathlib import Path

import pytest
from broker import Mosquitto, require_mosquitto
from daemon import HIGHSIDE, Pty, Subscriber, running, wait_for
from test_clock_steps import Tool, Wall, config, health
from test_reload import remade

from highside.calibration.signature import new_key
from highside.service.demo import factory_record

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]


def reported(subscriber: Subscriber, daemon, condition):
    return wait_for(lambda: (h := health(subscriber)) and condition(h) and h, 60, "the health", daemon)


def test_a_key_that_is_no_longer_trusted_takes_its_calibration_away_at_a_reload(tmp_path: Path) -> None:
    lab, other = new_key("lab"), new_key("other")
    record = remade(factory_record(), tool_id="t1").signed(lab, now_s=time.time())
    (tmp_path / "cal.json").write_text(record.to_json())
    trusted = tmp_path / "trusted"
    trusted.write_text(lab.public_line + "\n")
    line = Pty()
    with Mosquitto(tmp_path / "broker") as broker:
        subscriber = Subscriber(broker.port)
        path = config(tmp_path, line, broker.port)
        path.write_text(path.read_text() + '[calibration]\nrecord = "cal.json"\ntrusted_keys = "trusted"\n')
        with running(path) as daemon:
            first = reported(subscriber, daemon, lambda h: h["link"]["opens"])
            assert first["calibration"]["cal_id"] == record.id
            steps = (
                # a file that cannot be read has taken nothing back
                ("no key\n", record.id, True),
                (lab.public_line + "\n", record.id, False),
                # the laboratory's key is taken off the list: what it signed is not used any more
                (other.public_line + "\n", "none", False),
                (f"{other.public_line}\n{lab.public_line}\n", record.id, False),
            )
            for count, (content, cal_id, kept) in enumerate(steps, start=1):
                trusted.write_text(content)
                daemon.process.send_signal(signal.SIGHUP)
                found = reported(subscriber, daemon, lambda h, count=count: h["reload"]["count"] == count)
                assert (found["calibration"]["cal_id"], found["calibration"]["kept"]) == (cal_id, kept), content
                refused = kept or cal_id == "none"
                assert (found["calibration"]["refused"] is not None) == refused
                assert ("calibration_refused" in found["alarms"]) == refused
            assert daemon.terminate(15) == 0
        subscriber.close()
    line.close()


def test_under_a_clock_of_before_1970_it_works_and_is_set_right(tmp_path: Path) -> None:
    wall, line = Wall(tmp_path, -time.time() - 5 * 365 * 86_400), Pty()
    tool = Tool(line)
    with Mosquitto(tmp_path / "broker") as broker:
        subscriber = Subscriber(broker.port)
        with running(config(tmp_path, line, broker.port), env=wall.env) as daemon:
            reported(subscriber, daemon, lambda h: h["link"]["opens"])
            while len(subscriber.payloads("attitude")) < 5:
                tool.speak(0.2)
            assert subscriber.latest("attitude")["t"] < 0.0
            wall.set(0)
            reported(subscriber, daemon, lambda h: "clock_stepped" in h["alarms"])
            count = len(subscriber.payloads("attitude"))
            while len(subscriber.payloads("attitude")) < count + 5:
                tool.speak(0.2)
            last = reported(subscriber, daemon, lambda h: h["outbox"]["queued"] == 0)
            assert all(last["balance"].values())
            assert last["outbox"]["dropped"] == {}
            assert abs(subscriber.latest("attitude")["t"] - time.time()) < 60.0
            assert daemon.terminate(15) == 0, daemon.log
        assert "Traceback" not in daemon.log
        subscriber.close()
    line.close()


def test_the_password_is_reported_to_nobody_but_the_broker(tmp_path: Path) -> None:
    """Not in the log, at its most talkative, nor in health, `check`, a refusal or what lies in the state directory."""
    require_mosquitto()
    secret = "Zq8-never-to-be-seen"
    (tmp_path / "password").write_text(secret + "\n")
    conf, users = tmp_path / "mosquitto.conf", tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", users, "tool", secret], check=True, capture_output=True)
    users.chmod(0o600)
    broker = Mosquitto(tmp_path / "broker", config=conf)
    conf.write_text(
        f"user root\nper_listener_settings true\nlistener {broker.port} 127.0.0.1\npassword_file {users}\n"
        f"allow_anonymous true\n"
    )
    line = Pty()
    path = config(tmp_path, line, broker.port)
    with_password = path.read_text().replace(
        "[mqtt]\n", '[mqtt]\nusername = "tool"\npassword_file = "password"\n'
    ).replace("[service]\n", '[service]\nlog_level = "debug"\n')  # fmt: skip
    path.write_text(with_password)
    with broker:
        subscriber = Subscriber(broker.port)
        with running(path, env={"HIGHSIDE_DEBUG": "1"}) as daemon:
            reported(subscriber, daemon, lambda h: h["link"]["opens"])
            # a wrong one is refused by the broker, which the log tells
            (tmp_path / "password").write_text(secret + "wrong\n")
            broker.kill()
            broker.start()
            wait_for(lambda: "not authori" in daemon.log.lower(), 60, "the broker's refusal", daemon)
            (tmp_path / "password").write_text(secret + "\n")
            path.write_text(with_password.replace("= 20\n", "= -1\n"))
            daemon.process.send_signal(signal.SIGHUP)
            wait_for(lambda: "reload refused" in daemon.log, 30, "the refusal", daemon)
            assert daemon.terminate(15) == 0
        said = [payload for _, payload, _, _ in subscriber.drain()]
        subscriber.close()
    path.write_text(with_password)
    for arguments in (("check", path), ("check", path, "--json"), ("doctor", "--config", path)):
        done = subprocess.run([HIGHSIDE, *arguments], capture_output=True, timeout=90, check=False)
        said.extend((done.stdout, done.stderr))
    said.append(daemon.log.encode())
    said.extend(file.read_bytes() for file in (tmp_path / "state").rglob("*") if file.is_file())
    assert len(said) > 8
    assert not [text for text in said if secret.encode() in text]
    line.close()
