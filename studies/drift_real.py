"""Real recordings: inclination and heading against an optical reference, and gyro bias against temperature at rest.

    python -m studies.drift_real [DATA]

DATA holds `broad/*.npz` (trials of the BROAD benchmark: Laidig, Caruso, Cereatti, Seel 2021) and `serial_vn100`.
Errors are those of the benchmark: e = q (x) conj(q_opt), inclination 2 acos sqrt(w^2 + z^2), heading 2 atan2(z, w),
root mean square over the movement; heading less that of its first second, since nothing here has a magnetometer.
"Tuned" is leave-one-out: each trial with the parameters that are best on the mean of the others.
"""

from __future__ import annotations

import argparse
import gzip
import importlib.util
import itertools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.attitude.quaternion import conjugate, from_angles, multiply, to_tool
from highside.gyro.filter import FilterSettings, carried
from highside.gyro.recording_filter import error_state_filter
from highside.papers import drift_rivals as rivals
from highside.units import STANDARD_GRAVITY_MPS2

Array = NDArray[np.float64]

MEMS = FilterSettings(
    bias_std_radps=float(np.radians(0.5)),
    arw=float(np.radians(0.02)),
    rrw=float(np.radians(0.001)),
    accel_noise_g=2e-3,
    accel_floor_g=0.03,
    azimuth_std_rad=0.01,
    scale_std=5e-3,
)
"""A MEMS sensor: 0.5 deg/s of turn-on bias, accelerations of 30 mg that do not average out in a second. Chosen with an
eye on these trials: the honest row is the one tuned on the others."""
HAND = carried(MEMS)
"""The same waved by hand (`--carried`): its velocity is bounded. Tuned on others it does as well."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial: rates rad/s and accelerations m/s2 of the sensor frame (3, N), reference (4, N), NaN where none."""

    name: str
    rate_hz: float
    rate: Array
    accel: Array
    reference: Array
    moving: NDArray[np.bool_]

    @property
    def t_s(self) -> Array:
        return np.arange(self.moving.size) / self.rate_hz

    @property
    def rest_rate(self) -> Array:
        """Mean rate before the movement, rad/s: what a rest shows of the bias."""
        return np.asarray(self.rate[:, : int(np.argmax(self.moving))].mean(axis=1))


def trials(folder: Path) -> list[Trial]:
    found = []
    for path in sorted(folder.glob("*.npz")):
        z = np.load(path)
        rate, accel, q = (np.ascontiguousarray(z[name].astype(float).T) for name in ("imu_gyr", "imu_acc", "opt_quat"))
        found.append(Trial(path.stem, float(z["fs"]), rate, accel, q, z["movement"].astype(bool)))
    return found


def errors_deg(q: Array, trial: Trial) -> tuple[float, float]:
    """Inclination and heading error (rms over the movement)."""
    known = np.flatnonzero(~np.isnan(trial.reference).any(axis=0) & trial.moving)
    e = multiply(q[:, known], conjugate(trial.reference[:, known]))
    inclination = 2.0 * np.arccos(np.clip(np.sqrt(e[0] ** 2 + e[3] ** 2), 0.0, 1.0))
    heading = np.unwrap(2.0 * np.arctan2(e[3], e[0]))
    heading = heading - heading[: int(trial.rate_hz)].mean()
    return tuple(float(np.degrees(np.sqrt(np.mean(x**2)))) for x in (inclination, heading))  # type: ignore[return-value]


def ours(trial: Trial, settings: FilterSettings, *, smooth: bool = False) -> Array:
    result = error_state_filter(
        trial.t_s, to_tool(trial.rate), to_tool(trial.accel / STANDARD_GRAVITY_MPS2), settings, smooth=smooth
    )
    return from_angles(result.inc_rad - 0.5 * np.pi, result.tf_rad, result.azi_rad)


def found_bias(trial: Trial) -> Array:
    """(3,) what the filter says before the movement, rad/s."""
    i = int(np.argmax(trial.moving)) - 1
    result = error_state_filter(
        trial.t_s[:i], to_tool(trial.rate[:, :i]), to_tool(trial.accel[:, :i] / STANDARD_GRAVITY_MPS2), MEMS
    )
    x, y, z = result.bias_radps[:, -1]
    return np.array([-y, -z, x])


def theirs(run: Callable[..., Array], trial: Trial, **parameters: Any) -> Array:
    return run(trial.rate_hz, trial.rate, trial.accel / STANDARD_GRAVITY_MPS2, **parameters)


Run = Callable[..., Array]
METHODS: dict[str, tuple[Run, list[dict[str, Any]]]] = {
    "kinematic, carried": (
        lambda trial, **changes: ours(trial, replace(HAND, **changes)),
        [
            {"velocity_std_mps": velocity, "gyro_scatter": scatter}
            for velocity, scatter in itertools.product((0.1, 0.2, 0.3, 0.5, 1.0), (1e-3, 3e-3, 1e-2))
        ],
    ),
    "kinematic, accelerations as noise": (
        lambda trial, **changes: ours(trial, replace(MEMS, **changes)),
        [
            {"accel_floor_g": floor, "arw": float(np.radians(walk)), "block_s": block}
            for floor, walk, block in itertools.product((0.01, 0.02, 0.035, 0.05), (0.01, 0.03, 0.1), (1.0, 2.0))
        ],
    ),
    "vqf": (partial(theirs, rivals.vqf), [{"tauAcc": tau} for tau in (1.0, 2.0, 3.0, 5.0, 8.0)]),
    "imufusion with Bias": (partial(theirs, rivals.imufusion), [{"gain": gain} for gain in (0.1, 0.25, 0.5, 1.0)]),
    "ahrs Mahony": (
        partial(theirs, partial(rivals.ahrs, "Mahony")),
        [{"k_P": k, "k_I": 0.01} for k in (0.2, 0.5, 1.0)],
    ),
    "ahrs Madgwick": (partial(theirs, partial(rivals.ahrs, "Madgwick")), [{"gain": g} for g in (0.01, 0.02, 0.04)]),
}
NEEDS = {"vqf": "vqf", "imufusion with Bias": "imufusion", "ahrs Mahony": "ahrs", "ahrs Madgwick": "ahrs"}


def broad(folder: Path) -> Iterator[str]:
    """Markdown rows."""
    data = trials(folder)
    yield "\n### BROAD: inclination / heading drift, deg rms\n"
    yield f"| method | {' | '.join(trial.name[:2] for trial in data)} | mean inclination |"
    yield f"|---|{'---|' * len(data)}---|"

    def row(name: str, pairs: list[tuple[float, float]]) -> str:
        cells = " | ".join(f"{inc:.2f} / {azi:.2f}" for inc, azi in pairs)
        return f"| {name} | {cells} | {np.mean([inc for inc, _ in pairs]):.3f} |"

    for name, (run, grid) in METHODS.items():
        if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
            yield f"| {name} | not installed |"
            continue
        yield row(
            f"{name}, {'as set' if name.startswith('kinematic') else 'defaults'}",
            [errors_deg(run(trial), trial) for trial in data],
        )
        tried = [[errors_deg(run(trial, **parameters), trial) for trial in data] for parameters in grid]
        inclination = np.array([[inc for inc, _ in each] for each in tried])
        best = [int(np.argmin(np.delete(inclination, k, axis=1).mean(axis=1))) for k in range(len(data))]
        yield row(f"{name}, tuned on the others", [tried[best[k]][k] for k in range(len(data))])
    # what each part of the model of a hand is worth
    for name, settings in {
        "bounded velocity, perfect gyros": replace(HAND, gyro_scatter=0.0),
        "bounded velocity, blocks of 1 s": replace(HAND, block_s=1.0),
        "noise, but gyros true to 0.3 %": replace(MEMS, gyro_scatter=3e-3),
        "noise, blocks of 0.25 s": replace(MEMS, block_s=0.25),
    }.items():
        yield row(f"kinematic, {name}", [errors_deg(ours(trial, settings), trial) for trial in data])
    yield row("kinematic, carried, smoothed", [errors_deg(ours(trial, HAND, smooth=True), trial) for trial in data])
    if importlib.util.find_spec("vqf"):
        yield row("vqf, offline", [errors_deg(theirs(rivals.vqf_offline, trial), trial) for trial in data])
    yield "\nGyro bias found by the filter while the sensor still rests, less the mean rate of that rest, deg/s:\n"
    for trial in data:
        difference = np.degrees(found_bias(trial) - trial.rest_rate)
        yield f"- {trial.name}: {np.array2string(difference, precision=4)}, rest {np.degrees(trial.rest_rate).round(3)}"


def vn100(folder: Path) -> Iterator[str]:
    """Gyro bias against temperature while the unit warms up at rest."""
    with gzip.open(folder / "F00379_first60pct_decoded.csv.gz", "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    t = table["t_s"]
    keep = t > 70.0
    # x forward, y right, z down: half a turn about x to the tool frame
    rate = np.stack([table["GyroX"], -table["GyroY"], -table["GyroZ"]])[:, keep]
    accel = np.stack([table["AccX"], -table["AccY"], -table["AccZ"]])[:, keep] / STANDARD_GRAVITY_MPS2
    # warming up, the bias walks by some hundredths of a degree per second in minutes
    settings = replace(MEMS, rrw=float(np.radians(3e-4)), accel_noise_g=5e-4)
    t, temperature = t[keep], table["Temp"][keep]
    result = error_state_filter(t, rate, accel, settings, rest=np.array([[t[0], t[-1]]]), smooth=True)
    yield "\n### VN-100 warming up at rest, 10 to 14.4 degC: gyro bias against temperature\n"
    yield "| axis | bias at 12 degC, deg/s | slope, deg/s per degC | scatter about the line | slope, second half |"
    yield "|---|---|---|---|---|"
    settled = t > t[0] + 30.0
    later = t > t[0] + 0.5 * (t[-1] - t[0])
    for axis, bias in zip("xyz", np.degrees(result.bias_radps), strict=True):
        slope, offset = np.polyfit(temperature[settled] - 12.0, bias[settled], 1)
        half = np.polyfit(temperature[later] - 12.0, bias[later], 1)[0]
        rest = bias[settled] - (offset + slope * (temperature[settled] - 12.0))
        yield f"| {axis} | {offset:.4f} | {slope:+.5f} | {rest.std():.5f} | {half:+.5f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    beside = Path(os.environ.get("HIGHSIDE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=beside)
    arguments = parser.parse_args()
    if not (arguments.data / "broad").is_dir():
        raise SystemExit(f"no recordings in {arguments.data}: nothing measured; name their folder")
    for lines in (broad(arguments.data / "broad"), vn100(arguments.data / "serial_vn100")):
        for line in lines:
            print(line, flush=True)


if __name__ == "__main__":
    main()
