"""The daemon's calibration expires by the time that is known, not by a wall clock that somebody has set."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import pytest
from broker import Mosquitto
from daemon import Pty, Subscriber, running, wait_for
from test_clock_steps import DAY, Tool, Wall, config, health
from test_reload import known, remade, settings

from highside.calibration.record import CalibrationRecord
from highside.service import clock
from highside.service.demo import factory_record
from highside.service.in_force import calibration_for
from highside.service.known_time import FILE, Present

FURTHER = pytest.mark.further

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]


def made(tmp_path: Path, *, made_days_ago: float, expires_in_s: float) -> CalibrationRecord:
    """A record of tool t1."""
    now = time.time()
    record = remade(factory_record(), tool_id="t1", created_s=now - made_days_ago * DAY, expires_s=now + expires_in_s)
    (tmp_path / "cal.json").write_text(record.to_json())
    return record


def was_synchronised(tmp_path: Path, *, days_ago: float = 0.0, this_boot: bool = True) -> None:
    """What a daemon leaves behind that saw a synchronised clock: a moment of true time."""
    state = tmp_path / "state"
    state.mkdir(exist_ok=True)
    now = clock.now()
    (state / FILE).write_text(
        json.dumps(
            {
                "format": "highside.clock/1",
                "wall_s": time.time() - days_ago * DAY,
                "boot_id": now.boot_id if this_boot else "another",
                "boot_s": now.boot_s - days_ago * DAY,
            }
        )
    )


@pytest.fixture
def parts(tmp_path):
    """A broker, a line, the path of a configuration with a calibration, a subscriber."""
    with Mosquitto(tmp_path / "broker") as broker:
        line, subscriber = Pty(), Subscriber(broker.port)
        path = config(tmp_path, line, broker.port)
        path.write_text(path.read_text() + f'[calibration]\nrecord = "{tmp_path / "cal.json"}"\n')
        yield path, Tool(line), subscriber
        subscriber.close()
        line.close()


def reported(subscriber: Subscriber, daemon, condition):
    return wait_for(lambda: (h := health(subscriber)) and condition(h) and h, 40, "the health", daemon)


@pytest.mark.parametrize("off_s", [0, -900 * DAY], ids=["a right clock", "a clock 900 days behind"])
def test_what_has_expired_is_refused_by_a_clock_set_back_too(tmp_path, parts, off_s):
    path, _, subscriber = parts
    made(tmp_path, made_days_ago=100, expires_in_s=-DAY)
    was_synchronised(tmp_path)
    with running(path, env=Wall(tmp_path, off_s).env) as daemon:
        found = reported(subscriber, daemon, lambda h: h["link"]["opens"])
        assert found["calibration"]["cal_id"] == "none"
        assert found["calibration"]["reason"] == "expired"
        assert "calibration_refused" in found["alarms"]
        assert daemon.terminate(15) == 0


@pytest.mark.parametrize("by_s", [400 * DAY, -400 * DAY], ids=["forward", "back"])
def test_a_good_one_stays_good_when_the_clock_is_set_while_it_runs(tmp_path, parts, by_s):
    path, tool, subscriber = parts
    record = made(tmp_path, made_days_ago=1, expires_in_s=30 * DAY)
    was_synchronised(tmp_path)
    wall = Wall(tmp_path, 0)
    with running(path, env=wall.env) as daemon:
        reported(subscriber, daemon, lambda h: h["link"]["opens"])
        wall.set(by_s)
        reported(subscriber, daemon, lambda h: "clock_stepped" in h["alarms"])
        daemon.process.send_signal(signal.SIGHUP)
        found = reported(subscriber, daemon, lambda h: h["reload"]["count"] == 1)
        assert found["calibration"] == {"cal_id": record.id, "refused": None, "reason": None, "kept": False}
        # nor after a restart under the wrong clock
        assert daemon.terminate(15) == 0
    with running(path, env=wall.env) as daemon:
        while not subscriber.payloads("attitude"):
            tool.speak(0.2)
        assert subscriber.latest("attitude")["cal_id"] == record.id
        assert not [flag for flag in subscriber.latest("attitude")["flags"] if flag.startswith("calibration")]
        assert daemon.terminate(15) == 0


@FURTHER
def test_one_that_expires_while_it_runs_is_kept_and_flagged(tmp_path, parts):
    path, tool, subscriber = parts
    record = made(tmp_path, made_days_ago=1, expires_in_s=25.0)
    was_synchronised(tmp_path)
    wall = Wall(tmp_path, 0)
    with running(path, env=wall.env) as daemon:
        first = reported(subscriber, daemon, lambda h: h["link"]["opens"])
        assert first["calibration"] == {"cal_id": record.id, "refused": None, "reason": None, "kept": False}
        wall.set(-400 * DAY)  # it does not live longer for that
        found = reported(subscriber, daemon, lambda h: h["calibration"]["kept"])
        assert time.time() >= record.expires_s
        assert found["calibration"]["reason"] == "expired"
        assert found["calibration"]["cal_id"] == record.id
        count = len(subscriber.payloads("attitude"))
        while len(subscriber.payloads("attitude")) < count + 3:
            tool.speak(0.2)
        attitude = subscriber.latest("attitude")
        assert {"calibration_refused", "calibration_kept"} <= set(attitude["flags"])
        assert attitude["cal_id"] == record.id
        assert daemon.log.count("expired on") == 1
        assert daemon.terminate(15) == 0


@pytest.mark.parametrize("off_s", ["1970", -900 * DAY], ids=["a boot in 1970", "a boot years behind"])
def test_where_no_clock_can_tell_it_is_used_and_flagged_and_what_surely_expired_is_refused(tmp_path, parts, off_s):
    path, tool, subscriber = parts
    record = made(tmp_path, made_days_ago=100, expires_in_s=30 * DAY)
    # of a boot before this one; that it lies ahead of what the clock says now is what makes a reference doubtful
    was_synchronised(tmp_path, days_ago=2, this_boot=False)
    wall = Wall(tmp_path, 120.0 - time.time() if isinstance(off_s, str) else off_s)
    with running(path, env=wall.env) as daemon:
        found = reported(subscriber, daemon, lambda h: h["link"]["opens"])
        assert found["calibration"] == {"cal_id": record.id, "refused": None, "reason": None, "kept": False}
        assert "calibration_age_unknown" in found["alarms"]
        while not subscriber.payloads("attitude"):
            tool.speak(0.2)
        assert "calibration_age_unknown" in subscriber.latest("attitude")["flags"]
        # another record, that expired before the last moment known: not put in force; the running one is kept
        made(tmp_path, made_days_ago=90, expires_in_s=-5 * DAY)
        daemon.process.send_signal(signal.SIGHUP)
        found = reported(subscriber, daemon, lambda h: h["reload"]["count"] == 1)
        assert (found["calibration"]["cal_id"], found["calibration"]["reason"]) == (record.id, "expired")
        assert found["calibration"]["kept"]
        assert daemon.terminate(15) == 0
    with running(path, env=wall.env) as daemon:
        wait_for(lambda: daemon.log.count("running, state in") == 2, 40, "the second start", daemon)
        assert "readings pass uncorrected" in daemon.log
        assert daemon.terminate(15) == 0


def test_what_may_have_expired_is_used_where_there_is_nothing_else_and_replaces_no_other(tmp_path):
    """A clock that is ahead, and that nobody vouches for."""
    first = made(tmp_path, made_days_ago=100, expires_in_s=30 * DAY)
    asked = settings(tool="t1", record=str(tmp_path / "cal.json"))
    ahead = Present(time.time() + 900 * DAY, known=False, surely_s=time.time() - DAY)
    alone = calibration_for(asked, ahead)
    assert (alone.correction.cal_id, alone.flags) == (first.id, ("calibration_age_unknown",))
    assert calibration_for(asked, ahead, alone).flags == ("calibration_age_unknown",)
    # known later on, whether good or not
    assert alone.aged(known()).flags == ()
    late = Present(first.expires_s or 0.0, known=True, surely_s=first.expires_s or 0.0)
    gone = alone.aged(late)
    assert (gone.correction.cal_id, gone.flags) == (first.id, ("calibration_refused", "calibration_kept"))
    assert gone.aged(late) is gone
    # another one
    made(tmp_path, made_days_ago=90, expires_in_s=40 * DAY)
    kept = calibration_for(asked, ahead, alone)
    assert (kept.correction.cal_id, kept.kept) == (first.id, True)
    # one that does not expire needs no clock
    (tmp_path / "cal.json").write_text(remade(factory_record(), tool_id="t1").to_json())
    assert calibration_for(asked, ahead, alone).flags == ()
