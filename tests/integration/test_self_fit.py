"""`highside rotation fit-self`: from a recording to a compensation that the live service takes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_rotation_commands import highside

from highside.attitude import attitude_block
from highside.physics.gravity import gravity_direction
from highside.physics.rotation_chain import Faults, inclination_toolface_errors
from highside.recording.table import Recording, read_recording
from highside.rotation import Compensation
from highside.rotation.live import LiveCompensation
from highside.rotation.turntable import reference_errors

FAULTS: Faults = [
    ("encoder_first_harmonic", {"c1": 9e-4, "s1": -6e-4}),
    ("wobble", {"ck": 3e-4, "sk": 2e-4, "dk": -2e-4, "tk": 3e-4, "k": 2.0}),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six turns of a faulty rotor in a case that stands at 40 deg, without gyros."""
    place = tmp_path_factory.mktemp("self")
    t = np.arange(3600) * 0.01
    theta = 2.0 * np.pi * t / 6.0
    d_inc, d_tf = inclination_toolface_errors(theta, np.radians(40.0), FAULTS)
    noise = 5e-5 * np.random.default_rng(3).standard_normal((3, t.size))
    a = gravity_direction(np.radians(40.0) + d_inc, theta + d_tf + 1.0) + noise
    rotor = np.degrees(theta) % 360.0
    Recording({"t_s": t, "rotor_deg": rotor, "ax_g": a[0], "ay_g": a[1], "az_g": a[2]}).write(place / "rec.csv")
    return place


def test_a_fit_without_an_outside_reference_straightens_the_decoded_attitude(folder: Path) -> None:
    done = highside("rotation", "fit-self", "rec.csv", "-o", "comp.json", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["inclination_deg"] == pytest.approx(40.0, abs=0.05)
    live = LiveCompensation(Compensation.from_json((folder / "comp.json").read_text()))
    rec = read_recording(folder / "rec.csv")
    inc, tf = attitude_block(rec.accel())
    before, after = [], []
    for row in range(0, rec.n, 3):
        angle = float(rec.columns["rotor_deg"][row])
        one = live.apply(float(inc[row]), float(tf[row]), live.at(angle))
        assert one.flags == ()
        decoded = (one.tf_rad - np.radians(angle), tf[row] - np.radians(angle))
        after.append(np.exp(1j * decoded[0]))
        before.append(np.exp(1j * decoded[1]))
    spread = [float(np.std(np.angle(np.array(z) / np.mean(z)))) for z in (before, after)]
    noise = 5e-5 / np.sin(np.radians(40.0))
    assert spread[0] > 5.0 * noise
    assert spread[1] < 1.1 * noise


def test_what_cannot_be_fitted_is_one_line(folder: Path) -> None:
    done = highside("rotation", "fit-self", "rec.csv", "-o", "x.json", "--of", "rotor", cwd=folder)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "needs gyros" in done.stderr
    whole = read_recording(folder / "rec.csv")
    Recording({name: column[:500] for name, column in whole.columns.items()}).write(folder / "short.csv")
    done = highside("rotation", "fit-self", "short.csv", "-o", "x.json", cwd=folder)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "short.csv" in done.stderr
    assert "no 3 turns" in done.stderr
    Recording({name: column for name, column in whole.columns.items() if name != "rotor_deg"}).write(folder / "no.csv")
    done = highside("rotation", "fit-self", "no.csv", "-o", "x.json", cwd=folder)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "rotor_deg" in done.stderr
    assert not (folder / "x.json").exists()


def test_recordings_at_two_inclinations_make_a_turntable_that_a_calibration_takes(tmp_path: Path) -> None:
    for inc_deg in (25, 70):
        t = np.arange(3600) * 0.01
        theta = 2.0 * np.pi * t / 6.0
        d_inc, d_tf = inclination_toolface_errors(theta, np.radians(inc_deg), FAULTS)
        noise = 5e-5 * np.random.default_rng(inc_deg).standard_normal((3, t.size))
        a = gravity_direction(np.radians(inc_deg) + d_inc, theta + d_tf + 1.0) + noise
        rotor = np.degrees(theta) % 360.0
        columns = {"t_s": t, "rotor_deg": rotor, "ax_g": a[0], "ay_g": a[1], "az_g": a[2]}
        Recording(columns).write(tmp_path / f"at{inc_deg}.csv")
    done = highside("rotation", "fit-self", "at25.csv", "at70.csv", "-o", "table.json", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["inclination_deg"] == [pytest.approx(25.0, abs=0.05), pytest.approx(70.0, abs=0.05)]
    assert "give --calibration or --of rotor" in said["remarks"][0]
    made = Compensation.from_json((tmp_path / "table.json").read_text())
    assert made.validity.inclination_deg is None
    theta, inc = np.radians(np.arange(0.0, 360.0, 5.0)), np.full(72, np.radians(48.0))
    true = inclination_toolface_errors(theta, inc, FAULTS)
    for error, exact in zip(reference_errors(made, theta, inc), true, strict=True):
        left = error - exact
        assert np.std(left) < 0.05 * np.std(exact) + 1e-6
    one = highside("rotation", "fit-self", "at25.csv", "at25.csv", "-o", "no.json", cwd=tmp_path)
    assert (one.returncode, "one inclination cannot separate" in one.stderr) == (1, True)
    assert not (tmp_path / "no.json").exists()
