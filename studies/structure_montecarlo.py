"""Sensors with 1 mg of structure that no term describes: joint with refinement, joint alone, plain least squares.

    python -m studies.structure_montecarlo [--sensors N] [--first-seed N] [--only STRUCTURE]

Two structures (three sines of each sensor's own load; three waves over direction) on two plans (four and twelve
toolfaces at the eleven published inclinations). Judged at the truth: at the inclinations of the poses, and between and
beyond them, at toolfaces of no pose. Coverage is that of the stated 95 % intervals, reading noise included.

The estimator takes a structure for a Gaussian process whose size and length it finds. Three sines are none: bounded, of
three lengths at once and none between. As a control there are structures drawn as the estimator assumes them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from highside.arrays import Array
from highside.calibration.conventional import least_squares
from highside.calibration.joint import joint
from highside.calibration.poses import PoseSet
from highside.calibration.refinement import refine
from highside.physics.effect import Effect, LinearEffect, Parameter, Stage
from highside.physics.plan import BALANCE_TOOLFACES_DEG, PUBLISHED_INCLINATIONS_DEG
from highside.physics.state import ChainState
from highside.physics.structure import DIRECTION, OWN_LOAD
from studies.scenario import DirectionSine, MultiSine, reference_scenario

OTHER_DEG = (20.0, 52.0, 68.0, 82.0, 100.0)
PLACES_DEG = (*sorted(PUBLISHED_INCLINATIONS_DEG), *OTHER_DEG)
POSED = len(PUBLISHED_INCLINATIONS_DEG)
TOOLFACES_DEG = np.arange(2.5, 360.0, 5.0)
PLANS = {"44 poses": BALANCE_TOOLFACES_DEG, "132 poses": tuple(15.0 + 30.0 * k for k in range(12))}
ASSUMED_LENGTHS = (0.3, 0.6)
"""Of a function of the own load in g, of a field over direction in rad."""


class Assumed(Effect):
    """A structure of the estimator's own kind, drawn with the prior variances of one length."""

    id = "assumed_structure"
    stage = Stage.SENSOR
    parameters = (Parameter("size", "g", 1e-3, (0.0, 0.02)),)

    def __init__(self, kind: LinearEffect, variances: Array, rng: np.random.Generator) -> None:
        self._kind = kind
        self._coefficients = np.sqrt(np.tile(variances, 3)) * rng.standard_normal(3 * variances.size)

    def delta(self, state: ChainState, p: Array, x: Array) -> Array:
        return self._kind.delta(state, p[0] * self._coefficients, x)


def assumed_own_load(rng: np.random.Generator) -> Effect:
    return Assumed(OWN_LOAD, OWN_LOAD.prior_variances(1.0, ASSUMED_LENGTHS[0]), rng)


def assumed_direction(rng: np.random.Generator) -> Effect:
    return Assumed(DIRECTION, DIRECTION.prior_variances(1.0, ASSUMED_LENGTHS[1]), rng)


STRUCTURES: dict[str, tuple[Callable[[np.random.Generator], Effect], float]] = {
    "own load": (MultiSine, 1e-3),
    "direction": (DirectionSine, 1e-3),
    "own load as assumed": (assumed_own_load, 5e-4),
    "direction as assumed": (assumed_direction, 5e-4),
}
"""How each is drawn, and its size in g."""


def study(
    structure: Callable[[np.random.Generator], Effect],
    size_g: float,
    plan: tuple[float, ...],
    sensors: int,
    first_seed: int,
) -> None:
    """Prints the rows of one structure on one plan."""
    inc, tf = (x.ravel() for x in np.meshgrid(np.deg2rad(PLACES_DEG), np.deg2rad(TOOLFACES_DEG), indexing="ij"))
    cells = (len(PLACES_DEG), TOOLFACES_DEG.size)
    errors: dict[str, list[Array]] = {"plain least squares": [], "joint": [], "joint, refined": []}
    inside = []
    for seed in range(first_seed, first_seed + sensors):
        scenario = reference_scenario(seed, toolfaces_deg=plan, structure_g=size_g, structure=structure)  # type: ignore[arg-type]
        p = scenario.poses
        poses = PoseSet.build(p.mean, inc_ref_rad=p.inc_ref, tf_ref_rad=p.tf_ref, n=p.n.astype(float), std=p.std)
        reading = scenario.read(inc, tf, np.random.default_rng([seed, 99]))
        plain = joint(poses)
        refined = refine(plain, poses)
        for name, result in zip(errors, (least_squares(poses), plain, refined), strict=True):
            g = result.correct(reading)
            d_tf = np.angle(np.exp(1j * (np.arctan2(g[1], g[0]) - tf)))
            errors[name].append(np.stack([np.arctan2(np.hypot(g[0], g[1]), g[2]) - inc, d_tf]).reshape(2, *cells))
        std = np.stack(refined.predict_std(inc, tf, scenario.reading_sigma_g)).reshape(2, *cells)
        inside.append(np.abs(errors["joint, refined"][-1]) <= 1.96 * std)
    for name, values in errors.items():
        rms = np.rad2deg(np.sqrt(np.mean(np.square(values), axis=(0, 3))))
        at, between = (float(np.sqrt(np.mean(rms[0, part] ** 2))) for part in (slice(POSED), slice(POSED, -1)))
        print(f"| {name} | {at:.4f} | {between:.4f} | {rms[0, -1]:.4f} | {rms[1, 0]:.3f} | {rms[1, 7]:.4f} |")
    by_sensor = np.mean(inside, axis=3)
    scatter = 200.0 * by_sensor.std(axis=0, ddof=1) / np.sqrt(sensors)
    for label, row, wide in zip("IT", 100.0 * by_sensor.mean(axis=0), scatter, strict=True):
        print(f"\nCoverage of {label}: " + ", ".join(f"{x:.1f}" for x in row[:POSED]), end="; between and at 100 deg: ")
        print(", ".join(f"{x:.1f}" for x in row[POSED:]), end="; ")
        print(f"mean {row.mean():.1f}; two standard deviations of a cell: {wide.max():.1f} at most", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensors", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0, help="sensors of another number are other sensors")
    parser.add_argument("--only", choices=sorted(STRUCTURES))
    chosen = parser.parse_args()
    for name, (structure, size_g) in STRUCTURES.items():
        if chosen.only not in (None, name):
            continue
        for plan, toolfaces in PLANS.items():
            print(f"\n## {name}, {plan}, {chosen.sensors} sensors\n")
            print("| rms in deg | I at the poses' inclinations | I at 20 to 82 | I at 100 | T at 0.612 | T at 45 |")
            print("|---|---|---|---|---|---|")
            study(structure, size_g, toolfaces, chosen.sensors, chosen.first_seed)


if __name__ == "__main__":
    main()
