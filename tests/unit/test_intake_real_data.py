"""Intake checks on recordings of real sensors: healthy data give no alarm, whatever noise and converter."""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.intake.checks import check

Array = NDArray[np.float64]
STRAIGHT = ((0, 1.0), (1, 1.0), (2, 1.0))
G = 9.80665


def columns(t_s: Array, accel_g: Array) -> dict[str, Array]:
    return {"t_s": t_s} | dict(zip(("ax_g", "ay_g", "az_g"), accel_g, strict=True))


def xsens(folder: Path) -> dict[str, Array]:
    with np.load(folder / "accel_multipose" / "imu_tk_xsens_mti.npz") as data:
        return columns(data["t"], (data["acc"].T.astype(float) - 2**15) / 4067.0)


def mpu9150(name: str) -> Callable[[Path], dict[str, Array]]:
    def read(folder: Path) -> dict[str, Array]:
        with gzip.open(folder / "accel_multipose" / f"{name}.log.gz", "rt") as lines:
            a = np.loadtxt(lines)[:, :3].T / G
        return columns(np.arange(a.shape[1]) / 100.0, a)

    return read


def tumble(folder: Path) -> dict[str, Array]:
    with gzip.open(folder / "accel_multipose" / "rfayat_tumble.csv.gz", "rt") as lines:
        rows = list(csv.DictReader(lines))
    a = np.array([[float(r[k]) for r in rows] for k in ("ax", "ay", "az")])
    return columns(np.array([float(r["time"]) for r in rows]), a)


def hand_turns(folder: Path) -> dict[str, Array]:
    with gzip.open(folder / "accel_multipose" / "imucal_annotated_session.csv.gz", "rt") as lines:
        rows = list(csv.DictReader(lines))
    a = np.array([[float(r[f"acc_{k}"]) for r in rows] for k in "xyz"]) / 2048.0
    return columns(np.arange(a.shape[1]) / 102.4, a)


def vn100(folder: Path) -> dict[str, Array]:
    with gzip.open(folder / "serial_vn100" / "F00379_first60pct_decoded.csv.gz", "rt") as lines:
        table = np.genfromtxt(lines, delimiter=",", names=True)
    a = np.stack([table[f"Acc{k}"] for k in "XYZ"]) / G
    return columns(table["t_s"], a)


def mpu6050(folder: Path) -> dict[str, Array]:
    with gzip.open(folder / "static_mpu6050" / "mpu6050_tomisuarez_static.csv.gz", "rt") as lines:
        text = lines.read()
    body = [line for line in text.splitlines() if line and line.split(",")[0].lstrip("-").replace(".", "").isdigit()]
    values = np.genfromtxt(io.StringIO("\n".join(body)), delimiter=",")
    a = values[:, -6:-3].T if values.shape[1] >= 7 else values[:, :3].T
    a = a / np.median(np.linalg.norm(a, axis=0))
    return columns(np.arange(a.shape[1]) / 100.0, a)


def broad(name: str) -> Callable[[Path], dict[str, Array]]:
    def read(folder: Path) -> dict[str, Array]:
        with np.load(folder / "broad" / f"{name}.npz") as data:
            a = data["imu_acc"].T.astype(float) / G
            return columns(np.arange(a.shape[1]) / float(data["fs"]), a)

    return read


def phone(folder: Path) -> dict[str, Array]:
    with np.load(folder / "can_comma2k19" / "phone_imu_first30s.npz") as data:
        return columns(data["t"], data["acc"].T / G)


RECORDINGS = {
    "xsens": xsens,
    "mpu9150_imu0": mpu9150("mpu9150_imu0"),
    "mpu9150_imu1": mpu9150("mpu9150_imu1"),
    "tumble": tumble,
    "hand_turns": hand_turns,
    "vn100": vn100,
    "mpu6050": mpu6050,
    "broad_02": broad("02_undisturbed_slow_rotation_B"),
    "broad_07": broad("07_undisturbed_fast_rotation_B"),
    "broad_10": broad("10_undisturbed_slow_translation_A"),
    "phone": phone,
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_real_recording_is_not_refused(shared_data: Path, name: str) -> None:
    found = check(RECORDINGS[name](shared_data), (), STRAIGHT, attitude=False)
    assert not found.spoiled, [(f.check, f.remedy) for f in found.findings]
    # what is told of them is true: real links lose frames, real converters are coarse
    assert {f.check for f in found.findings} <= {"dropped_frames", "quantisation"}, found.findings
