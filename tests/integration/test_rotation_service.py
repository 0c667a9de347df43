"""A tool on a rotor with faults, live: a compensation applied by a real daemon, swapped, refused."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from broker import Mosquitto
from daemon import Subscriber, running, wait_for

from highside.link.device import DeviceSettings, SimulatedDevice
from highside.link.wire import PtyWire
from highside.physics.motion import Leg, Motion, still
from highside.physics.rotation_chain import Faults, azimuth_errors, inclination_toolface_errors
from highside.recording.table import read_recording
from highside.rotation import Compensation, CurveMethod, Samples, Validity, fit
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
                channels = ["encoder", "across", "along"]
                assert health["rotation"] == {
                    "comp_id": good,
                    "channels": channels,
                    "unused": [],
                    "refused": None,
                    "kept": False,
                }

                # another file by SIGHUP: no output is lost
                none = compensation(file, 0.0)
                daemon.process.send_signal(signal.SIGHUP)
                rows = wait_for(attitudes(none, 60), 40, "the other compensation", daemon)
                inc, tf = worst(rows[3:])
                assert inc > 0.1
                assert tf > 0.3
                everything = subscriber.payloads("attitude")
                assert [p["seq"] for p in everything] == list(range(len(everything)))

                # a changed file is refused, said, and the one in force goes on
                file.write_text(file.read_text().replace('"order": 0', '"order": 1', 1))
                daemon.process.send_signal(signal.SIGHUP)
                health = wait_for(
                    lambda: (h := subscriber.latest("health")) and "rotation_refused" in h["alarms"] and h,
                    10,
                    "alarm",
                    daemon,
                )
                assert "rotation_kept" in health["alarms"]
                assert "was changed" in health["rotation"]["refused"]
                before = len(attitudes(none, 0)())
                rows = wait_for(attitudes(none, before + 5), 20, "compensated attitudes", daemon)[before + 1 :]
                assert all({"rotation_refused", "rotation_kept"} <= set(p["flags"]) for p in rows)
                assert daemon.terminate() == 0, daemon.log

            # at the start there is none to keep: nothing is taken off
            with running(config) as daemon:
                rows = wait_for(attitudes(None, 5), 20, "attitudes without compensation", daemon)
                assert all("rotation_refused" in p["flags"] for p in rows[1:])
                assert daemon.terminate() == 0, daemon.log
        finally:
            device.stop()
            subscriber.close()
    assert math.isfinite(tf)


TILTED: Faults = [*FAULTS, ("mounting", {"tilt_x": 6e-3, "tilt_y": -4e-3})]
"""the package is held askew by 0.4 deg: its axis, and with it the azimuth of the gyros, goes round with the rotor"""
LATITUDE, AZIMUTH, INC = 35.2, 200.0, 30.0


def heading_compensation(path: Path) -> Compensation:
    """Of I, T and azimuth, fitted at the inclination of the run; what a reference with noise shows of two turns."""
    theta = np.arange(720) * (4 * np.pi / 720)
    inc, tf = inclination_toolface_errors(theta, np.radians(INC), TILTED)
    errors = {"inclination": inc, "toolface": tf, "heading": azimuth_errors(theta, np.radians(INC), TILTED)}
    noise = 0.05 * np.random.default_rng(2).standard_normal((3, 720))
    curves = {
        name: fit(Samples.build(theta, np.degrees(error) * 60.0 + n), CurveMethod.AUTO)
        for (name, error), n in zip(errors.items(), noise, strict=True)
    }
    made = Compensation(curves, Validity(inclination_deg=INC), "turns.csv", "0" * 64)
    path.write_text(made.to_json())
    return made


def command(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", "from highside.cli.main import main; main()", *arguments],
        capture_output=True, text=True, cwd=folder, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def off_deg(azimuths: object) -> np.ndarray:
    return np.mod(np.asarray(azimuths, dtype=float) - AZIMUTH + 180.0, 360.0) - 180.0


@pytest.mark.parametrize("method", ["kinematic", "recursive"])
def test_the_azimuth_is_compensated_live_and_its_recording_the_same(tmp_path: Path, method: str) -> None:
    made = heading_compensation(tmp_path / "rotor.json")
    settings = DeviceSettings(
        motion=still(INC, 20.0), noise_density_g=1e-6, gyro_noise_density_dps=1e-4,
        latitude_deg=LATITUDE, azimuth_deg=AZIMUTH, rotor_faults=TILTED,
    )  # fmt: skip
    device = SimulatedDevice(settings, PtyWire())
    state = tmp_path / "state"
    config = tmp_path / "highside.toml"
    with Mosquitto(tmp_path / "broker") as broker:
        subscriber = Subscriber(broker.port)
        device.start()
        config.write_text(
            f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{device.address}"\n[codec]\nname = "tool"\n'
            f'[rotation]\ncompensation = "rotor.json"\n[mqtt]\nport = {broker.port}\n'
            f"[site]\nlatitude_deg = {LATITUDE}\n"
            f'[drift]\nazimuth_deg = {AZIMUTH}\nazimuth_std_deg = 0.1\nmethod = "{method}"\n'
            f'[service]\nstate_dir = "{state}"\nhealth_interval_s = 0.2\n'
        )
        try:
            with running(config) as daemon:
                wait_for(lambda: (p := subscriber.latest("attitude")) and p.get("azi_deg"), 30, "an azimuth", daemon)
                began = device.time_s
                device.set_motion(Motion((Leg(12.0, turn_deg=400.0), Leg(600.0)), INC, 20.0, repeat=False))
                wait_for(lambda: device.time_s > began + 13.0, 60, "the turns", daemon)
                health = subscriber.latest("health")
                assert health is not None
                assert health["rotation"]["channels"] == ["inclination", "toolface", "heading"]
                assert daemon.terminate() == 0, daemon.log
                rows = [p for p in subscriber.payloads("attitude") if p.get("azi_deg") is not None]
        finally:
            device.stop()
            subscriber.close()
    assert len(rows) > 100
    assert not any({"rotor_unknown", "rotation_outside", "rotation_gap"} & set(p["flags"]) for p in rows)
    assert all(p["comp_id"] == made.id for p in rows)
    # what the filters are off by themselves on a perfect rotor that starts so briskly: 0.11 and 0.19 deg
    assert np.abs(off_deg([p["azi_deg"] for p in rows])).max() < (0.2 if method == "kinematic" else 0.3)
    assert all(p["azi_std_deg"] > 0.0 for p in rows)
    # the same bytes, in bulk: the azimuth that was told is that of the hole, `drift` follows the package
    (recorded,) = sorted(state.rglob("*.hsw*"))[:1]
    command(tmp_path, "decode", str(recorded), "--codec", "tool", "-o", "rec.csv")
    at_first = made.curves["heading"](np.radians([20.0]))[0] / 60.0
    arguments = ["--method", method, "--latitude-deg", str(LATITUDE), "--azimuth-deg", f"{AZIMUTH + at_first:.9f}"]
    command(tmp_path, "drift", "rec.csv", *arguments, "--azimuth-std-deg", "0.1", "-o", "drift.csv")
    said = json.loads(command(tmp_path, "rotation", "apply", "rotor.json", "drift.csv", "-o", "out.csv", "--json"))
    out = read_recording(tmp_path / "out.csv")
    assert said["attitude"]["azi"]["compensated"] == out.n
    assert np.ptp(out.columns["azi_deg"]) > 1.5  # the package's
    bulk = dict(zip(np.round(out.t_s, 6).tolist(), out.columns["azi_comp_deg"].tolist(), strict=True))
    pairs = [(p["azi_deg"], bulk[round(p["t_device_s"], 6)]) for p in rows]
    apart = np.mod(np.diff(np.array(pairs), axis=1) + 180.0, 360.0) - 180.0
    # the last row of a block knows that block in bulk, and a sample later live
    assert np.quantile(np.abs(apart), 0.85) < 0.005
    assert np.abs(apart).max() < 0.1
