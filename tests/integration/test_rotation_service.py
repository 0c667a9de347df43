"""A tool on a rotor with faults, live: a compensation applied by a real daemon, swapped, refused."""

from __future__ import annotations

import math
import signal
from pathlib import Path

import numpy as np
import pytest
from broker import Mosquitto
from daemon import Subscriber, running, wait_for

from highside.link.device import DeviceSettings, SimulatedDevice
from highside.link.wire import PtyWire
from highside.physics.motion import Leg, Motion
from highside.physics.rotation_chain import Faults, inclination_toolface_errors
from highside.rotation.turntable import fit_turntable

pytestmark = pytest.mark.slow

FAULTS: Faults = [
    ("encoder_first_harmonic", {"c1": 6e-3, "s1": -4e-3}),
    ("encoder_second_harmonic", {"c2": 2e-3, "s2": 1e-3}),
    ("wobble", {"ck": 3e-3, "sk": 1e-3, "dk": -2e-3, "tk": 2e-3, "k": 2.0}),
]


def compensation(path: Path, scale: float = 1.0) -> str:
    """The turntable's file, from turns at 25 and 70 deg; gives its id."""
    theta = np.arange(360) * (2 * np.pi / 360)
    found = [inclination_toolface_errors(theta, np.radians(inc), FAULTS) for inc in (25.0, 70.0)]
    noise = 1e-5 * np.random.default_rng(1).standard_normal((2, 720))
    curve = fit_turntable(
        np.tile(theta, 2),
        np.radians(np.repeat([25.0, 70.0], 360)),
        scale * np.concatenate([tf for _, tf in found]) + noise[0],
        scale * np.concatenate([inc for inc, _ in found]) + noise[1],
    )
    made = curve.compensation("turns.csv", "0" * 64)
    path.write_text(made.to_json())
    return made.id


def test_a_rotor_is_compensated_live_and_the_file_is_swapped_like_a_calibration(tmp_path: Path) -> None:
    file = tmp_path / "rotor.json"
    good = compensation(file)
    turning = Motion((Leg(10.0, turn_deg=360.0),), inclination_deg=45.0, toolface_deg=0.0)
    device = SimulatedDevice(
        DeviceSettings(motion=turning, gyros=False, noise_density_g=1e-6, rotor_faults=FAULTS), PtyWire()
    )
    with Mosquitto(tmp_path / "broker") as broker:
        subscriber = Subscriber(broker.port)
        device.start()
        config = tmp_path / "highside.toml"
        config.write_text(
            f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{device.address}"\n[codec]\nname = "tool"\n'
            f'[rotation]\ncompensation = "rotor.json"\n[mqtt]\nport = {broker.port}\n'
            f'[service]\nstate_dir = "{tmp_path / "state"}"\nhealth_interval_s = 0.2\n'
        )
        try:
            with running(config) as daemon:

                def attitudes(comp_id: str | None, count: int):
                    def check():
                        found = [p for p in subscriber.payloads("attitude") if p.get("comp_id") == comp_id]
                        return found if len(found) >= count else None

                    return check

                def worst(rows: list[dict]) -> tuple[float, float]:
                    """Largest errors of I and T against the truth in the middle of each window, deg."""
                    true = device.truth_block([p["t_device_s"] - p["window_s"] / 2 for p in rows])
                    off_tf = np.degrees(
                        np.angle(np.exp(1j * (np.radians([p["tf_deg"] for p in rows]) - true.toolface_rad)))
                    )
                    off_inc = np.array([p["inc_deg"] for p in rows]) - np.degrees(true.inclination_rad)
                    return float(np.abs(off_inc).max()), float(np.abs(off_tf).max())

                rows = wait_for(attitudes(good, 60), 40, "compensated attitudes", daemon)
                inc, tf = worst(rows[3:])
                assert inc < 0.02  # the curvature of the circle within a window: up to 7 deg of turn
                assert tf < 0.02
                assert not any("rotor_unknown" in p["flags"] for p in rows)
                health = subscriber.latest("health")
                assert health is not None
                assert health["rotation"] == {"comp_id": good, "refused": None}

                # another file by SIGHUP: no output is lost
                none = compensation(file, 0.0)
                daemon.process.send_signal(signal.SIGHUP)
                rows = wait_for(attitudes(none, 60), 40, "the other compensation", daemon)
                inc, tf = worst(rows[3:])
                assert inc > 0.1
                assert tf > 0.3
                everything = subscriber.payloads("attitude")
                assert [p["seq"] for p in everything] == list(range(len(everything)))

                # a changed file is refused, said, and nothing is taken off
                file.write_text(file.read_text().replace('"order": 0', '"order": 1', 1))
                daemon.process.send_signal(signal.SIGHUP)
                rows = wait_for(attitudes(None, 5), 20, "attitudes without compensation", daemon)
                assert all("rotation_refused" in p["flags"] for p in rows[1:])
                health = wait_for(
                    lambda: (h := subscriber.latest("health")) and "rotation_refused" in h["alarms"] and h,
                    10,
                    "alarm",
                    daemon,
                )
                assert "was changed" in health["rotation"]["refused"]
                assert daemon.terminate() == 0, daemon.log
        finally:
            device.stop()
            subscriber.close()
    assert math.isfinite(tf)
