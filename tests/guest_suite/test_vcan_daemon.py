"""Half a minute of a real car's bus, played into a real CAN interface at its own rate, with the daemon behind it.

Everything is checked against an independent path: `canplayer` sends, the sent file itself is what must be recorded
(every frame, in order), and id 0x024 is decoded here with two shifts.
"""

from __future__ import annotations

import csv
import gzip
import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HIGHSIDE = Path(sys.executable).with_name("highside")
STANDARD_GRAVITY = 9.80665
YAW_SCALE = 1e-3

CONFIGURATION = f"""\
[tool]
id = "car"

[link]
kind = "socketcan"
interface = "vcan0"

[codec]
name = "dbc"
dbc = "{ROOT / "config" / "comma2k19.dbc"}"

# the car has no full triad on this id: the second axis is its yaw rate, the third is set to 1 g
[codec.fields]
ax_g = {{ signal = "KINEMATICS.ACCEL_Y", scale = {1 / STANDARD_GRAVITY!r} }}
ay_g = {{ signal = "KINEMATICS.YAW_RATE", scale = {YAW_SCALE} }}
az_g = {{ signal = "KINEMATICS.YAW_RATE", scale = 0.0, offset = 1.0 }}
gz_dps = {{ signal = "KINEMATICS.YAW_RATE" }}

# an attitude for every frame that has a hundredth of a second of its own
[pipeline]
output_rate_hz = 100
averaging_s = 1e-4

[mqtt]
port = 18830

[service]
health_interval_s = 0.5
"""


def independent(data: bytes) -> tuple[float, float]:
    """(yaw rate in deg/s, lateral acceleration in m/s2) of id 0x024: two big-endian fields of ten bits."""
    yaw = ((data[0] & 0x03) << 8 | data[1]) * 0.244 - 125.0
    lateral = ((data[4] & 0x03) << 8 | data[5]) * 0.03589 - 18.375
    return yaw, lateral


class Broker:
    """A real mosquitto and a subscriber that keeps all it gets."""

    def __init__(self, directory: Path) -> None:
        config = directory / "mosquitto.conf"
        config.write_text("listener 18830 127.0.0.1\nallow_anonymous true\npersistence false\nmax_queued_messages 0\n")
        self._received = directory / "received"
        self._broker = subprocess.Popen(["mosquitto", "-c", str(config)], stderr=subprocess.DEVNULL)
        time.sleep(0.5)
        with self._received.open("wb") as out:
            self._subscriber = subprocess.Popen(
                ["mosquitto_sub", "-p", "18830", "-q", "1", "-t", "highside/car/#", "-F", "%t %p"], stdout=out
            )

    def messages(self, topic: str) -> list[dict[str, object]]:
        """Payloads received so far."""
        lines = self._received.read_text().splitlines(keepends=True)
        found = [line.partition(" ") for line in lines if line.endswith("\n")]
        return [json.loads(payload) for name, _, payload in found if name == f"highside/car/{topic}"]

    def health(self) -> dict[str, dict[str, object]]:
        """The last health message, empty before the first."""
        found = self.messages("health")
        return found[-1] if found else {}  # type: ignore[return-value]

    def close(self) -> None:
        for process in (self._subscriber, self._broker):
            process.terminate()
            process.wait(10)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    one = Broker(tmp_path)
    yield one
    one.close()


def until(what: Callable[[], bool], timeout_s: float, say: str) -> None:
    """Wait for something."""
    end = time.monotonic() + timeout_s
    while not what():
        assert time.monotonic() < end, f"{say}: not within {timeout_s} s"
        time.sleep(0.2)


def test_thirty_seconds_of_a_real_bus_pass_the_daemon_without_loss(
    tmp_path: Path, shared_data: Path, broker: Broker
) -> None:
    log = gzip.decompress((shared_data / "can_comma2k19" / "candump_first30s.log.gz").read_bytes()).decode()
    sent_log = tmp_path / "sent.log"
    sent_log.write_text(log)
    # "(time) interface id#data"
    sent = [line.split()[2] for line in log.splitlines()]
    kinematics = [bytes.fromhex(item[4:]) for item in sent if item.startswith("024#")]
    assert (len(sent), len(kinematics)) == (49_404, 2_487)
    config, state = tmp_path / "car.toml", tmp_path / "state"
    config.write_text(CONFIGURATION + f'state_dir = "{state}"\n')

    errors = (tmp_path / "daemon.log").open("w")
    daemon = subprocess.Popen([HIGHSIDE, "run", "--config", config], stderr=errors)
    try:
        until(lambda: broker.health().get("link", {}).get("opens") == 1, 60, "the daemon listens")
        begin = time.monotonic()
        subprocess.run(["canplayer", "-I", sent_log, "vcan0=can0", "vcan0=can1"], check=True, timeout=90)
        took = time.monotonic() - begin
        until(lambda: int(str(broker.health()["link"]["can_frames"])) >= len(sent), 20, "all frames at the daemon")
        # 29.99 s of recording: the player kept the recording's own rate
        assert 29.0 < took < 40.0
        begin = time.monotonic()
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(15) == 0
        assert time.monotonic() - begin < 10.0
    finally:
        daemon.kill()
        daemon.wait()
        errors.close()
        print((tmp_path / "daemon.log").read_text())
    health = broker.health()
    print(f"played in {took:.2f} s; loop {health['loop']}; link {health['link']}; recorder {health['recorder']}")

    # none lost on the way in, every 0x024 decoded, the rest passed over
    assert health["link"]["can_frames"] == len(sent)
    assert health["link"]["kernel_drops"] == 0
    assert health["codec"]["frames_good"] == len(kinematics)
    assert health["codec"]["frames_bad"] == 0
    assert health["codec"]["frames_ignored"] == len(sent) - len(kinematics)
    assert all(health["balance"].values())

    # the recording holds each frame that was sent, in the order in which it was sent
    (recording,) = (state / "recordings").iterdir()
    assert [line.split()[2] for line in recording.read_text().splitlines()] == sent

    # values: the product's own decoding of its recording, frame by frame
    table = tmp_path / "car.csv"
    subprocess.run(
        [HIGHSIDE, "decode", recording, "--codec", "dbc", "--config", config, "-o", table], check=True, timeout=60
    )
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(kinematics)
    for row, data in zip(rows, kinematics, strict=True):
        yaw, lateral = independent(data)
        assert math.isclose(float(row["gz_dps"]), yaw, rel_tol=1e-12, abs_tol=1e-12)
        assert math.isclose(float(row["ax_g"]), lateral / STANDARD_GRAVITY, rel_tol=1e-12, abs_tol=1e-12)

    # values: what was published live, each attitude one of the sent frames, in their order
    expected = []
    for data in kinematics:
        yaw, lateral = independent(data)
        x, y = lateral / STANDARD_GRAVITY, yaw * YAW_SCALE
        inclination = math.degrees(math.atan2(math.hypot(x, y), 1.0))
        expected.append((inclination, math.degrees(math.atan2(y, x)) % 360.0, math.hypot(x, y, 1.0)))
    single = [one for one in broker.messages("attitude") if one["window_s"] == 0]
    place = 0
    for one in single:
        values = (float(str(one["inc_deg"])), float(str(one["tf_deg"])), float(str(one["g_total"])))
        while not agree(values, expected[place]):
            place += 1
            assert place < len(expected), f"no frame that was sent gives {values}, in this order"
        place += 1
    print(f"{len(single)} attitudes of single frames, {len(broker.messages('attitude'))} in all")
    assert len(single) > len(kinematics) // 2
    numbers = [int(str(one["seq"])) for one in broker.messages("attitude")]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def agree(published: tuple[float, float, float], frame: tuple[float, float, float]) -> bool:
    """Equal to the last printed digit (six for angles, eight for |g|), toolface on the circle."""
    turn = abs((published[1] - frame[1] + 180.0) % 360.0 - 180.0)
    return abs(published[0] - frame[0]) < 6e-7 and turn < 6e-7 and abs(published[2] - frame[2]) < 6e-9
