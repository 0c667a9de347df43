"""Files of others as they are: read right after one answer, or refused in a line that says why and what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import highside
from highside.errors import InputError
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign, refuse_open

# file: (answer, unit of the accelerations, of the rates, rows/s)
READ = {
    "accel_multipose/rfayat_tumble.csv.gz": ({"accept": True}, "g", "deg/s", 300.0),
    "broad/02_undisturbed_slow_rotation_B.npz": ({"accept": True}, "m/s2", "rad/s", 285.714),
    "broad/07_undisturbed_fast_rotation_B.npz": ({"accept": True}, "m/s2", "rad/s", 285.714),
    "broad/10_undisturbed_slow_translation_A.npz": ({"accept": True}, "m/s2", "rad/s", 285.714),
    "broad/27_disturbed_phone_vibration_B.npz": ({"accept": True}, "m/s2", "rad/s", 285.714),
    "can_comma2k19/phone_imu_first30s.npz": ({"accept": True}, "m/s2", "rad/s", 104.4),
    "static_mpu6050/sunsided_rotate-ccw-around-x-pointing-forward.npz": ({"accept": True}, "g", "deg/s", 476.3),
    "static_mpu6050/sunsided_static_10min.npz": ({"accept": True}, "g", "deg/s", 491.3),
    "accel_multipose/mpu9150_imu0.log.gz": ({"accept": True, "rate_hz": 100.0}, "m/s2", "rad/s", 100.0),
    "accel_multipose/mpu9150_imu1.log.gz": ({"accept": True, "rate_hz": 100.0}, "m/s2", "rad/s", 100.0),
    "accel_multipose/imu_tk_xsens_mti.npz": (
        {"accept": True, "mapping": dict.fromkeys(("gx_dps", "gy_dps", "gz_dps"), "none")},
        "lsb/4056.96@32768", None, 100.0,
    ),
    "accel_multipose/imucal_annotated_session.csv.gz": (
        {"accept": True, "rate_hz": 204.8, "units": ["gyro=lsb/16.4"]}, "lsb/2048", "lsb/16.4", 204.8
    ),
    "static_mpu6050/mpu6050_tomisuarez_static.csv.gz": (
        {"accept": True, "units": ["accel=lsb/16384", "gyro=lsb/131"]}, "lsb/16384", "lsb/131", 100.0
    ),
    "serial_vn100/F00379_first60pct_decoded.csv.gz": (
        {"accept": True, "units": ["rad/s"]}, "m/s2", "rad/s", 10.0
    ),
}  # fmt: skip
REFUSED = {
    "accel_multipose/mpu9150_imu0.log.gz": r"no column is a time; --rate HZ",
    "accel_multipose/imucal_annotated_session.csv.gz": r"in one line: --rate HZ --units gyro=lsb/131 --yes",
    "accel_multipose/imu_tk_xsens_mti.npz": r"gx_dps from gyr\[0\]: its unit is not named.*gyro=lsb/131",
    "can_comma2k19/candump_first30s.log.gz": r"frames of a CAN bus, which need a DBC file.*highside decode",
    "serial_vn100/F00294.bin": r"bytes that are no text.*highside decode",
    "serial_multi_imu/2023-08-15_Multi-IMU_static60s.txt": r"no three columns are accelerations",
}


@pytest.mark.parametrize("name", READ)
def test_a_real_file_is_read_after_one_answer(shared_data: Path, name: str) -> None:
    answer, accel, rates, rate_hz = READ[name]
    path = shared_data / name
    found = highside.import_recording(path, **answer)  # type: ignore[arg-type]
    assert abs(float(np.median(np.linalg.norm(found.accel(), axis=0))) - 1.0) < 0.1
    assert 1.0 / float(np.median(np.diff(found.t_s))) == pytest.approx(rate_hz, rel=1e-3)
    said = {key: value for key, value in answer.items() if key != "accept"}
    wishes = Wishes(**said)  # type: ignore[arg-type]
    proposal = open_foreign(path, wishes)
    for target, unit in (("ax_g", accel), ("gx_dps", rates)):
        guess = proposal.guess(target)
        assert (guess and guess.unit and guess.unit.name) == unit


@pytest.mark.parametrize("name", REFUSED)
def test_a_real_file_that_leaves_something_open_is_refused_with_the_option(shared_data: Path, name: str) -> None:
    with pytest.raises(InputError, match=REFUSED[name]):
        refuse_open(open_foreign(shared_data / name, Wishes()), accepted=True)
