"""`highside watch` over all open recordings that it can read: does it cry wolf over real noise?

    python -m studies.watch_real [DATA]

Each file is read by the product's own importer or decoder. Sensors held in many attitudes get a record by |g| from the
poses of the first half and are watched over the second; where the first half does not suffice, from all poses, and
watched over all. One attitude calibrates nothing: a sensor that only rests gets the record of a good tool, its readings
are divided by the length of their mean over the first minute of rest, and the mean rates of that rest are taken off
its gyros, so that at first the calibration holds by definition. Each is watched as the tool that the watch expects
(quartz), as what it is, a MEMS sensor, and as such with rests from 1.5 s on: hands hold a pose for seconds, and the
watch wants 20 s.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import highside
from highside.arrays import Array
from highside.calibration.still_intervals import find_still_intervals
from highside.errors import HighsideError, InputError
from highside.recording.table import read_recording
from highside.watch import rows as watch_rows
from studies.survey_analysis import calibration as good_tool

MEMS: dict[str, float] = {
    "repeat_g": 1e-3,
    "random_walk_g": 2e-3,
    "still_floor_g": 2e-4,
    "window_floor_g": 2e-3,
}
"""of a consumer sensor: an offset that walks by 2 mg in an hour, 0.2 mg of 1/f noise. Set before the first run"""
IMPORTED: dict[str, dict[str, Any]] = {
    "accel_multipose/imu_tk_xsens_mti.npz": {"mapping": dict.fromkeys(("gx_dps", "gy_dps", "gz_dps"), "none")},
    "accel_multipose/mpu9150_imu0.log.gz": {"rate_hz": 100.0},
    "accel_multipose/mpu9150_imu1.log.gz": {"rate_hz": 100.0},
    "accel_multipose/imucal_annotated_session.csv.gz": {"rate_hz": 204.8, "units": ["gyro=lsb/16.4"]},
    "accel_multipose/rfayat_tumble.csv.gz": {},
    "broad/02_undisturbed_slow_rotation_B.npz": {},
    "broad/07_undisturbed_fast_rotation_B.npz": {},
    "broad/10_undisturbed_slow_translation_A.npz": {},
    "broad/27_disturbed_phone_vibration_B.npz": {},
    "can_comma2k19/phone_imu_first30s.npz": {},
    "static_mpu6050/sunsided_rotate-ccw-around-x-pointing-forward.npz": {},
    "static_mpu6050/sunsided_static_10min.npz": {},
    "static_mpu6050/mpu6050_tomisuarez_static.csv.gz": {"units": ["accel=lsb/16384", "gyro=lsb/131"]},
    "serial_vn100/F00379_first60pct_decoded.csv.gz": {"units": ["rad/s"]},
}
DECODED = {
    "serial_vn100/F00294.bin": [("--codec", "vn100")],
    "serial_multi_imu/2023-08-09_Multi-IMU_commaDelim.txt": [
        ("--codec", "delimited", "--config", str(k)) for k in "12345"
    ],
    "serial_multi_imu/2023-08-15_Multi-IMU_static60s.txt": [
        ("--codec", "delimited", "--config", str(k)) for k in "12345"
    ],
}
"""`--config` by the number of the sensor on the line"""
NOT_READ = {
    "can_comma2k19/candump_first30s.log.gz": "yaw rate and one lateral acceleration: no three axes",
    "serial_vn100/F00379_first60pct.bin": "the same bytes as its decoded table",
}
MAPPING = Path(__file__).resolve().parents[1] / "config" / "multi_imu-mapping.toml"
POSES = 10
"""that a record by |g| needs at least: nine parameters and a remainder"""
SHORT_S = 1.5
"""of a rest, in the third way"""
WAYS = ("quartz", "MEMS", "MEMS, short rests")
COLUMNS = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps", "temp_c")


@dataclass(frozen=True)
class Open:
    """An open recording: its name, and its columns by name, (N,) each."""

    name: str
    columns: dict[str, Array]

    @property
    def t_s(self) -> Array:
        """Time, (N,) s."""
        return self.columns["t_s"]

    def part(self, low: float, high: float) -> dict[str, Array]:
        """Of its time, shares."""
        share = (self.t_s - self.t_s[0]) / (self.t_s[-1] - self.t_s[0])
        keep = (share >= low) & (share <= high)
        return {name: values[keep] for name, values in self.columns.items()}


def recordings(data: Path) -> Iterator[Open | tuple[str, str]]:
    """Each that the product reads, or its name and why it does not."""
    for name, answer in IMPORTED.items():
        yield _opened(
            name, lambda name=name, answer=answer: highside.import_recording(data / name, accept=True, **answer)
        )
    for name, ways in DECODED.items():
        for way in ways:
            whole = name if way[-2] != "--config" else f"{name}, sensor {way[-1]}"
            yield _opened(whole, lambda name=name, way=way: _decoded(data / name, way))
    yield from NOT_READ.items()


def _opened(name: str, read: Callable[[], Any]) -> Open | tuple[str, str]:
    try:
        table = read()
    except (HighsideError, OSError) as error:
        return name, str(error)
    return Open(name, {"t_s": table.t_s} | {column: table.columns[column] for column in COLUMNS if table.has(column)})


def _decoded(path: Path, way: tuple[str, ...]) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        options = list(way)
        if "--config" in way:
            config = Path(folder) / "mapping.toml"
            config.write_text(MAPPING.read_text().replace('equals = "3"', f'equals = "{way[-1]}"'))
            options[-1] = str(config)
        out = Path(folder) / "recording.csv"
        done = subprocess.run(
            [str(Path(sys.executable).with_name("highside")), "decode", str(path), *options, "-o", str(out)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise HighsideError(done.stderr.strip())
        return read_recording(out)


@dataclass(frozen=True)
class Watched:
    """What was watched, under which record, and what was said."""

    name: str
    record: str
    minutes: float
    said: dict[str, highside.WatchedRecording]


def watched(one: Open) -> Watched:
    """One recording as a quartz tool and as a MEMS sensor."""
    for share in (0.5, 1.0):
        record = _by_magnitude(one.part(0.0, share))
        if record is not None:
            rows = one.part(share % 1.0, 1.0)
            word = "|g|, first half" if share < 1.0 else "|g|, all poses"
            return Watched(one.name, word, _minutes(rows), _said(rows, record))
    rows = _at_first_right(one.part(0.0, 1.0))
    return Watched(one.name, "first rest's length", _minutes(rows), _said(rows, good_tool()))


def _at_first_right(rows: dict[str, Array]) -> dict[str, Array]:
    """With the length of gravity and without rates in the first minute of the first rest; of all where none is."""
    readings, step = np.stack([rows[name] for name in COLUMNS[:3]]), float(np.median(np.diff(rows["t_s"])))
    try:
        at = find_still_intervals(readings, 1.0 / step)[0].rows()
    except InputError:
        at = np.arange(rows["t_s"].size)
    at = at[rows["t_s"][at] - rows["t_s"][at[0]] <= 60.0]
    length = float(np.linalg.norm(readings[:, at].mean(axis=1)))
    right = {name: rows[name] / length for name in COLUMNS[:3]}
    return rows | right | {name: rows[name] - rows[name][at].mean() for name in COLUMNS[3:6] if name in rows}


def _minutes(rows: dict[str, Array]) -> float:
    return float(rows["t_s"][-1] - rows["t_s"][0]) / 60.0


def _by_magnitude(rows: dict[str, Array]) -> highside.Calibration | None:
    """The record of the poses, or None where they are too few or refused."""
    try:
        poses = highside.find_poses(rows)
        if len(poses["ax"]) < POSES:
            return None
        return highside.calibrate(poses, reference="magnitude", tool="open")
    except HighsideError:
        return None


def _said(rows: dict[str, Array], record: highside.Calibration) -> dict[str, highside.WatchedRecording]:
    with mock.patch.object(watch_rows, "REST", replace(watch_rows.REST, shortest_s=SHORT_S)):
        short = highside.watch_recording(rows, record, **MEMS)
    quartz, mems = highside.watch_recording(rows, record), highside.watch_recording(rows, record, **MEMS)
    return dict(zip(WAYS, (quartz, mems, short), strict=True))


def words(said: highside.WatchedRecording) -> str:
    """The verdict, and of a departure its class, size and where it was said."""
    found = said.found
    claims = [
        f"{', '.join(claim.equivalence_class)}: {claim.parameters[claim.parameter].value:+.2g}"
        f" {claim.parameters[claim.parameter].unit} after {claim.alarm_s / 60.0:.1f} min"
        for claim in found.claims
    ]
    return "; ".join([f"{found.counts.stills} rests, {found.counts.turns} turns: {found.verdict}", *claims])


def main() -> None:
    """Print one row a recording, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    beside = Path(os.environ.get("HIGHSIDE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=beside)
    data = parser.parse_args().data
    if not data.is_dir():
        raise SystemExit(f"no recordings in {data}: nothing measured; name their folder")
    print("| recording | record by | min | left out | " + " | ".join(f"as {way}" for way in WAYS) + " |")
    print("|---" * (4 + len(WAYS)) + "|")
    hours, used, alarms = (dict.fromkeys(WAYS, 0.0) for _ in range(3))
    for one in recordings(data):
        if not isinstance(one, Open):
            print(f"| {one[0]} | not read: {one[1]} |" + " |" * (2 + len(WAYS)))
            continue
        try:
            got = watched(one)
        except HighsideError as error:
            print(f"| {one.name} | refused: {error} |" + " |" * (2 + len(WAYS)), flush=True)
            continue
        left = ", ".join(f"{n} {why}" for why, n in got.said["MEMS"].found.counts.left_out.items())
        said = " | ".join(words(got.said[way]) for way in WAYS)
        print(f"| {one.name} | {got.record} | {got.minutes:.1f} | {left} | {said} |", flush=True)
        for way in WAYS:
            counts = got.said[way].found.counts
            hours[way] += got.minutes / 60.0
            used[way] += got.minutes / 60.0 if counts.stills + counts.turns else 0.0
            alarms[way] += got.said[way].verdict == "departs"
    for way in WAYS:
        print(
            f"\nas {way}: {alarms[way]:.0f} alarms in {hours[way]:.2f} h; recordings of {used[way]:.2f} h had a rest or"
            " rotation that is used"
        )


if __name__ == "__main__":
    main()
