"""The daemon under a wall clock that is wrong and is set while it runs: nothing is lost, old is old by the boot clock.

libfaketime gives the daemon its own wall clock, which a file sets; the monotonic and the boot clock stay the machine's.
"""

from __future__ import annotations

import ctypes.util
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from broker import Mosquitto, free_port
from daemon import Pty, Subscriber, running, wait_for

from highside.codec.tool import encode

FURTHER = pytest.mark.further

pytestmark = pytest.mark.slow

HOUR, DAY = 3600, 86_400
RATE_HZ = 20
HISTORICAL_AFTER_S = 5.0
"""Default of `mqtt.historical_after_s`."""


def library() -> str:
    """libfaketime. Absent: skipped, but a failure under CI."""
    found = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
    named = ctypes.util.find_library("faketimeMT")
    if not found and named is None:
        if os.environ.get("CI") == "true":
            pytest.fail("libfaketime is not installed, and CI must not skip these tests")
        pytest.skip("needs libfaketime (apt-get install faketime)")
    return str(found[0]) if found else str(named)


class Wall:
    """The daemon's wall clock: the machine's and an offset that can be changed while it runs."""

    def __init__(self, folder: Path, offset_s: float) -> None:
        self._file = folder / "faketime"
        self.set(offset_s)
        self.env = {
            "LD_PRELOAD": library(),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "FAKETIME_DONT_RESET": "1",
        }

    def set(self, offset_s: float) -> None:
        beside = self._file.with_suffix(".new")
        beside.write_text(f"{offset_s:+.0f}")
        beside.replace(self._file)


def config(folder: Path, line: Pty, broker_port: int) -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{line.path}"\n[codec]\nname = "tool"\n'
        f"[mqtt]\nport = {broker_port}\n[pipeline]\noutput_rate_hz = {RATE_HZ}\n"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
    )
    return path


class Tool:
    """Writes frames, and remembers how many."""

    def __init__(self, line: Pty) -> None:
        self._line, self._k = line, 0

    def speak(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for _ in range(2):
                noise = 1e-4 * (self._k * 7919 % 13 - 6)
                self._line.write_all(encode(self._k % 65536, self._k / 100.0, (noise, 0.5, 0.866), temp_c=25.0))
                self._k += 1
            time.sleep(0.02)


def health(subscriber: Subscriber) -> dict[str, Any]:
    return subscriber.latest("health") or {}


def test_the_boot_clock_is_not_the_faked_one(tmp_path: Path) -> None:
    """What the other tests rest on."""
    program = "from highside.service import clock; n = clock.now(); print(n.wall_s, n.boot_s)"
    env = {**os.environ, **Wall(tmp_path, -900 * DAY).env}
    said = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=True)
    wall_s, boot_s = map(float, said.stdout.split())
    assert abs(wall_s - (time.time() - 900 * DAY)) < 30.0
    assert abs(boot_s - time.clock_gettime(time.CLOCK_BOOTTIME)) < 30.0


@pytest.mark.parametrize(
    ("first_s", "then_s"),
    [
        pytest.param(-900 * DAY, 0, id="900 days behind, then right"),
        pytest.param("1970", 0, id="a boot in 1970, then right"),
        pytest.param(0, HOUR, id="an hour forward"),
        pytest.param(0, -HOUR, id="an hour back", marks=FURTHER),
        pytest.param(0, DAY, id="a day forward", marks=FURTHER),
        pytest.param(0, -DAY, id="a day back", marks=FURTHER),
        pytest.param(0, 31 * DAY, id="a month forward", marks=FURTHER),
        pytest.param(0, -31 * DAY, id="a month back", marks=FURTHER),
    ],
)
def test_a_clock_that_is_set_while_the_broker_is_away_loses_nothing(
    tmp_path: Path, first_s: float | str, then_s: float
) -> None:
    before_s = 120.0 - time.time() if isinstance(first_s, str) else first_s
    wall, line, port = Wall(tmp_path, before_s), Pty(), free_port()
    tool = Tool(line)
    with running(config(tmp_path, line, port), env=wall.env) as daemon:
        wait_for(lambda: "running, state in" in daemon.log, 60, "the start", daemon)
        while "data arrives" not in daemon.log:
            tool.speak(0.1)
        tool.speak(6.5)  # the first are older than `historical_after_s` when the broker comes
        wall.set(then_s)
        wait_for(lambda: "the wall clock was set" in daemon.log, 10, "the step noticed", daemon)
        tool.speak(0.5)
        with Mosquitto(tmp_path / "broker", port=port):
            subscriber = Subscriber(port)
            try:
                wait_for(lambda: health(subscriber).get("outbox", {}).get("acknowledged"), 30, "delivery", daemon)
                tool.speak(1.0)
                last_health = wait_for(
                    lambda: (h := health(subscriber)) and h["outbox"]["queued"] == 0 and h["broker"]["connected"] and h,
                    30,
                    "the rest",
                    daemon,
                )
                wait_for(
                    lambda: (
                        len({p["seq"] for p in subscriber.payloads("attitude")}) >= last_health["pipeline"]["attitudes"]
                    ),
                    10,
                    "all messages at the subscriber",
                    daemon,
                )
                attitudes = [
                    (arrived_s, json.loads(payload))
                    for topic, payload, _, arrived_s in subscriber.drain()
                    if topic.endswith("/attitude")
                ]
                found = {message["seq"]: message for _, message in attitudes}
            finally:
                subscriber.close()
            assert daemon.terminate(15) == 0, daemon.log
    line.close()
    assert sorted(found) == list(range(len(found)))
    assert len(found) > 40  # 160 on a quiet machine; the tool speaks by the clock and is slower on a busy one
    assert last_health["outbox"]["dropped"] == {}
    assert "clock_stepped" in last_health["alarms"]
    assert last_health["clock"]["steps"] == 1
    assert abs(last_health["clock"]["last_step_s"] - (then_s - before_s)) < 2.0
    assert daemon.log.count("the wall clock was set") == 1
    # old is what was measured more than 5 s before it was sent, whatever its wall time says
    assert found[0]["historical"]
    assert not found[max(found)]["historical"]
    for arrived_s, message in attitudes:
        # sent before it arrived: a machine that stands still makes more of them old, none of them young
        assert not message["historical"] or arrived_s - message["t_mono"] > HISTORICAL_AFTER_S - 0.1, (
            arrived_s,
            message,
        )
    assert abs(found[0]["t"] - (time.time() + before_s)) < 120.0
    assert abs(found[max(found)]["t"] - (time.time() + then_s)) < 120.0
