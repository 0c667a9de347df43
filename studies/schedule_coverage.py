"""Coverage of the stated 95 % intervals of I and T through schedules: at, between and beyond their zones.

    python -m studies.schedule_coverage [--sensors N] [--only KIND] [--workers 0 --parts DIR]

Every sensor is calibrated on a bench of its own and read at known attitudes, one reading a row of the table. What a
method takes for zero and knows the size of, the bench's tilt and the sensor's offset, is normal with just that standard
deviation: a uniform one has no tails, and where it dominates every interval of 1.96 standard deviations holds the
truth; one drawn smaller than stated makes intervals that are wide by right. Tilts are stratified (each two-hundredth,
say, of the normal distribution has one of two hundred sensors), because one draw of tilt decides over all readings of
its sensor.

The last line of a kind gives two standard deviations of a share, from the scatter over sensors: six readings of one
sensor share its calibration, so that they are fewer than six independent trials.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from highside.arrays import Array
from highside.attitude.block import attitude_std_block
from highside.calibration.balance import balance
from highside.calibration.conventional import DEFAULT_OFFSET_STD_G, conventional
from highside.calibration.joint import joint
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.schedule import ScheduledCorrection
from highside.physics.forward import ForwardModel
from studies import over_seeds
from studies.scenario import reference_scenario

PLACES_DEG = (0.2, 0.4, 0.612, 0.9, 1.0, 1.6, 2.0, 2.5, 4.0, 7.0, 10.0, 20.0, 25.0, 37.0, 50.0, 68.0, 82.0, 90.0, 100.0)
"""0.612 is the centre of a zone; 0.9, 1.6, 2.5, 4.0, 10, 25 and 37 lie in blends; 90 and 100 beyond balance zones."""
READINGS = 6
"""Readings of each sensor at each place, at toolfaces of their own; they share one calibration."""

Solver = Callable[[PoseSet, BenchAccuracy], ScheduledCorrection]


def balance_and_conventional(poses: PoseSet, bench: BenchAccuracy) -> ScheduledCorrection:
    zones = tuple(LinearCorrection(zone, guarded=False) for zone in balance(poses, bench=bench).zones)
    return ScheduledCorrection(zones, fallback=LinearCorrection(conventional(poses, bench=bench).main))


def balance_and_joint(poses: PoseSet, bench: BenchAccuracy) -> ScheduledCorrection:
    zones = tuple(LinearCorrection(zone, guarded=False) for zone in balance(poses, bench=bench).zones)
    return ScheduledCorrection(zones, fallback=LinearCorrection(joint(poses, bench=bench).main))


def joint_alone(poses: PoseSet, bench: BenchAccuracy) -> ScheduledCorrection:
    return ScheduledCorrection((), fallback=LinearCorrection(joint(poses, bench=bench).main))


@dataclass(frozen=True)
class Kind:
    """A bench, an instrument and a way to solve. Sizes of errors in deg: of the tilt one standard deviation, of the
    others half-widths of uniform distributions."""

    solve: Solver
    tilt_deg: float = 0.03 / math.sqrt(3.0)
    pose_deg: float = 0.009
    inc_station_deg: float = 0.0
    tf_station_deg: float = 0.0


KINDS = {
    "balance+conventional": Kind(balance_and_conventional),
    "balance+conventional, nominal tilt": Kind(balance_and_conventional, tilt_deg=0.05),
    "balance+conventional, level bench": Kind(balance_and_conventional, tilt_deg=0.002),
    "balance+conventional, inclination, station": Kind(
        balance_and_conventional, pose_deg=0.0, inc_station_deg=0.009, tf_station_deg=0.009
    ),
    "balance+joint": Kind(balance_and_joint),
    "balance+joint, inclination, station": Kind(
        balance_and_joint, pose_deg=0.0, inc_station_deg=0.009, tf_station_deg=0.009
    ),
    "joint": Kind(joint_alone),
    "joint, inclination, station": Kind(joint_alone, pose_deg=0.0, inc_station_deg=0.009, tf_station_deg=0.009),
}


def held(kind: Kind, seed: int, tilt: Array) -> tuple[Array, int]:
    """Whether I and T lie in their stated intervals (2, places, READINGS) for one sensor on a bench out of level by
    `tilt` (2,) rad, and its number of zones."""
    rng = np.random.default_rng([seed, 77])
    scenario = reference_scenario(seed)
    offset = DEFAULT_OFFSET_STD_G * rng.standard_normal(3)
    known = tuple((effect, offset if effect.id == "bias" else p) for effect, p in scenario.sensor.effects)
    scenario = replace(scenario, sensor=ForwardModel(known))
    bench = ForwardModel.of(
        {
            "base_tilt": {"tilt_x": float(tilt[0]), "tilt_y": float(tilt[1])},
            "pose_error": {
                "inc_pose": math.radians(kind.pose_deg),
                "tf_pose": math.radians(kind.pose_deg),
                "inc_station": math.radians(kind.inc_station_deg),
                "tf_station": math.radians(kind.tf_station_deg),
            },
        }
    )
    data = replace(scenario, bench=bench).measure(scenario.poses.inc_ref, scenario.poses.tf_ref, rng)
    poses = PoseSet.build(
        data.mean, inc_ref_rad=data.inc_ref, tf_ref_rad=data.tf_ref, n=data.n.astype(float), std=data.std
    )
    correction = kind.solve(poses, BenchAccuracy(tilt_rad=math.radians(kind.tilt_deg)))
    inc = np.deg2rad(np.repeat(PLACES_DEG, READINGS))
    tf = rng.uniform(0.0, 2.0 * np.pi, inc.size)
    out = correction.corrected_block(scenario.read(inc, tf, rng), scenario.reading_sigma_g)
    inc_std, tf_std, _ = attitude_std_block(out.g, out.cov)
    error_inc = np.arctan2(np.hypot(out.g[0], out.g[1]), out.g[2]) - inc
    error_tf = np.angle(np.exp(1j * (np.arctan2(out.g[1], out.g[0]) - tf)))
    inside = np.stack([np.abs(error_inc) < 1.96 * inc_std, np.abs(error_tf) < 1.96 * tf_std])
    return inside.reshape(2, len(PLACES_DEG), READINGS), len(correction.zones)


def one_sensor(name: str, seed: int, tilt: Sequence[float]) -> tuple[Array, int]:
    """As `held`, of a kind by its name."""
    return held(KINDS[name], seed, np.array(tilt))


@dataclass(frozen=True)
class Coverage:
    """Shares (2, places) of intervals of I and T that hold the truth, their standard deviations over draws of sensors,
    and the mean number of zones."""

    share: Array
    std: Array
    zones: float


def coverage(name: str, sensors: int, first_seed: int = 0, over: over_seeds.Over = over_seeds.in_a_loop) -> Coverage:
    """Of `sensors` sensors of a kind, from `first_seed` on."""
    middles = [NormalDist().inv_cdf((k + 0.5) / sensors) for k in range(sensors)]
    rng = np.random.default_rng(first_seed)
    tilts = np.deg2rad(KINDS[name].tilt_deg) * np.stack([rng.permutation(middles) for _ in range(2)], axis=1)
    found = over(one_sensor, [(name, first_seed + k, tilt) for k, tilt in enumerate(tilts.tolist())])
    by_sensor = np.mean([inside for inside, _ in found], axis=3)
    std = by_sensor.std(axis=0, ddof=1) / math.sqrt(sensors)
    return Coverage(by_sensor.mean(axis=0), std, float(np.mean([zones for _, zones in found])))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensors", type=int, default=300)
    parser.add_argument("--first-seed", type=int, default=0, help="sensors of another number are other sensors")
    parser.add_argument("--only", choices=sorted(KINDS))
    over_seeds.add_options(parser)
    options = parser.parse_args()
    over = over_seeds.chosen(options, seconds=0.02)
    print("| " + " | ".join(["kind", "", *(f"{place:g}" for place in PLACES_DEG), "mean", "zones"]) + " |")
    print("|" + "---|" * (len(PLACES_DEG) + 4))
    for name in KINDS:
        if options.only in (None, name):
            found = coverage(name, options.sensors, options.first_seed, over)
            for label, row in zip("IT", found.share, strict=True):
                cells = [f"{100 * value:.1f}" for value in (*row, row.mean())]
                print("| " + " | ".join([name, label, *cells, f"{found.zones:.1f}"]) + " |")
            limits = [f"{200 * value:.1f}" for value in found.std.max(axis=0)]
            print("| " + " | ".join(["", "±", *limits, "", ""]) + " |", flush=True)


if __name__ == "__main__":
    main()
