"""The azimuth live: a simulated tool with gyros on a pty, `highside run`, a real mosquitto, commands and restarts."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from broker import Mosquitto
from daemon import Operator, Subscriber, running, wait_for

from highside.link.device import DeviceSettings, SimulatedDevice
from highside.link.wire import PtyWire
from highside.physics.motion import Leg, Motion, still
from highside.service.messages import AttitudeMessage, DriftMessage, DriftReply

pytestmark = pytest.mark.slow

LATITUDE, AZIMUTH = 35.2, 200.0
BIAS_DPS = (0.02, -0.015, 0.01)
"""54 deg/h along the tool: untouched it would show within the test"""


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


@pytest.fixture
def tool() -> Iterator[SimulatedDevice]:
    """At rest until it is told to move."""
    motion = still(30.0, 45.0)
    settings = DeviceSettings(
        rate_hz=100.0, motion=motion, gyro_bias_dps=BIAS_DPS, gyro_noise_density_dps=0.002, noise_density_g=1e-4,
        latitude_deg=LATITUDE, azimuth_deg=AZIMUTH,
    )  # fmt: skip
    device = SimulatedDevice(settings, PtyWire())
    device.start()
    yield device
    device.stop()


def config(folder: Path, tool: SimulatedDevice, broker: Mosquitto, extra: str = "") -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{tool.address}"\n[codec]\nname = "tool"\n'
        f"[site]\nlatitude_deg = {LATITUDE}\n[mqtt]\nport = {broker.port}\n"
        f"[drift]\ngyro_arw = 0.15\ngyro_bias_std = 100.0\nsave_interval_s = 0.5\ncompare_literal = true\n{extra}"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.3\n'
    )
    return path


def latest(ear: Subscriber) -> AttitudeMessage:
    message = ear.latest("attitude")
    assert message is not None
    return AttitudeMessage.model_validate(message)


def away_deg(message: AttitudeMessage) -> float:
    assert message.azi_deg is not None
    return abs(math.remainder(message.azi_deg - AZIMUTH, 360.0))


def test_the_azimuth_is_reported_followed_and_outlives_the_daemon(
    tmp_path: Path, broker: Mosquitto, tool: SimulatedDevice
) -> None:
    path = config(tmp_path, tool, broker)
    ear = Subscriber(broker.port)
    operator = Operator(broker.port, "highside/t1/drift", ear, DriftReply)
    try:
        with running(path) as daemon:
            wait_for(lambda: ear.latest("attitude") and latest(ear).azi_basis == ["unaligned"], 20.0, "gyros", daemon)
            assert latest(ear).azi_deg is None
            assert operator.say(daemon, command="align").error is not None
            assert operator.say(daemon, command="reset_heading").ok is False
            wait_for(
                lambda: operator.say(daemon, command="align", azimuth_deg=AZIMUTH, std_deg=0.2).ok,
                10.0, "a second of gyros and an alignment", daemon,
            )  # fmt: skip
            assert operator.say(daemon, command="connection", seconds=20).ok is True
            wait_for(lambda: latest(ear).azi_basis == ["zero_rate"], 10.0, "a zero-rate update", daemon)
            assert operator.say(daemon, command="connection", seconds=0).ok is True
            first = latest(ear)
            assert first.azi_std_deg is not None
            assert away_deg(first) < 0.3

            def found_a_stop() -> bool:
                latest = ear.latest("drift")
                return latest is not None and not latest["connection"] and latest["motion"] == "still"

            wait_for(lambda: tool.time_s > 23.0 and found_a_stop(), 40.0, "a stop found in the data", daemon)
            # killed, not stopped: what was kept half a second ago is taken up
            time.sleep(1.0)
            daemon.kill()
        with running(path) as daemon:
            mark = len(ear.payloads("attitude"))
            wait_for(lambda: len(ear.payloads("attitude")) > mark + 30, 20.0, "attitudes again", daemon)
            wait_for(lambda: latest(ear).azi_deg is not None, 10.0, "the azimuth again", daemon)
            drift_message = DriftMessage.model_validate(wait_for(lambda: ear.latest("drift"), 5.0, "drift", daemon))
            assert drift_message.restored is not None
            assert "the tool stood all the time, gyro biases kept" in drift_message.restored
            assert drift_message.alignment is not None
            assert drift_message.alignment.by == "command"
            # it turns and inclines, and the azimuth stays
            legs = (Leg(6.0, inclination_to_deg=40.0, turn_deg=720.0), Leg(600.0))
            began = tool.time_s
            tool.set_motion(Motion(legs, 30.0, 45.0, repeat=False))
            wait_for(lambda: tool.time_s > began + 9.0, 60.0, "the motion", daemon)
            message = latest(ear)
            assert message.azi_std_deg is not None
            assert away_deg(message) < 3.0 * message.azi_std_deg
            assert message.azi_std_deg < 2.0
            assert message.inc_deg == pytest.approx(40.0, abs=0.2)
            drift_message = DriftMessage.model_validate(ear.latest("drift"))
            assert drift_message.bias_dph is not None
            assert drift_message.bias_std_dph is not None
            for found, std, true in zip(drift_message.bias_dph, drift_message.bias_std_dph, BIAS_DPS, strict=True):
                assert abs(found - true * 3600.0) < 4.0 * std
            assert drift_message.literal is not None
            health = ear.latest("health")
            assert health is not None
            assert health["drift"]["aligned"] is True
            assert health["drift"]["error"] is None
            assert all(health["balance"].values())
            assert operator.say(daemon, command="reset_heading").ok is True
            wait_for(lambda: latest(ear).azi_basis[0] == "constraint", 5.0, "the reset", daemon)
            assert operator.say(daemon, command="restart").ok is True
            wait_for(lambda: latest(ear).azi_basis == ["unaligned"], 5.0, "the restart", daemon)
            assert daemon.terminate() == 0
    finally:
        operator.close()
        ear.close()


@pytest.mark.parametrize("method", ["literal", "recursive"])
def test_a_configured_azimuth_and_a_method_for_comparison(
    tmp_path: Path, broker: Mosquitto, tool: SimulatedDevice, method: str
) -> None:
    extra = f'azimuth_deg = {AZIMUTH}\nmethod = "{method}"\nazimuth_policy = "gyro"\n'
    path = config(tmp_path, tool, broker, extra)
    ear = Subscriber(broker.port)
    try:
        with running(path) as daemon:
            wait_for(lambda: ear.latest("attitude") and latest(ear).azi_deg is not None, 20.0, "an azimuth", daemon)
            message = latest(ear)
            assert message.azi_basis == ["nothing"]
            assert away_deg(message) < 2.0
            drift_message = wait_for(lambda: (d := ear.latest("drift")) and d["literal"] and d, 10.0, "drift", daemon)
            drift = DriftMessage.model_validate(drift_message)
            assert drift.method == method
            if method == "literal":
                assert message.azi_std_deg is None
                assert drift.recursive is None
            else:
                assert message.azi_std_deg is not None
                assert drift.recursive is not None
                assert drift.recursive.azi_deg == pytest.approx(drift.azi_deg)
            assert daemon.terminate() == 0
    finally:
        ear.close()
