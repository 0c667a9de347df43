"""Sensors with 1 mg of structure that no term describes: joint with refinement, joint alone, plain least squares.

    python tests/bench/structure_montecarlo.py [--sensors N]

Two structures (three sines of each sensor's own load; three waves over direction) on two plans (four and twelve
toolfaces at the eleven published inclinations). Judged at the truth: at the inclinations of the poses, and between and
beyond them, at toolfaces of no pose. Coverage is that of the stated 95 % intervals, reading noise included.
"""

from __future__ import annotations

import argparse

import numpy as np

from highside.calibration.conventional import least_squares
from highside.calibration.joint import joint
from highside.calibration.poses import Array, PoseSet
from highside.calibration.refinement import refine
from highside.physics.scenario import (
    BALANCE_TOOLFACES_DEG,
    PUBLISHED_INCLINATIONS_DEG,
    DirectionSine,
    MultiSine,
    reference_scenario,
)

OTHER_DEG = (20.0, 52.0, 68.0, 82.0, 100.0)
PLACES_DEG = (*sorted(PUBLISHED_INCLINATIONS_DEG), *OTHER_DEG)
POSED = len(PUBLISHED_INCLINATIONS_DEG)
TOOLFACES_DEG = np.arange(2.5, 360.0, 5.0)
PLANS = {"44 poses": BALANCE_TOOLFACES_DEG, "132 poses": tuple(15.0 + 30.0 * k for k in range(12))}
STRUCTURES = {"own load": MultiSine, "direction": DirectionSine}


def study(structure: type[MultiSine] | type[DirectionSine], plan: tuple[float, ...], sensors: int) -> None:
    """Prints the rows of one structure on one plan."""
    inc, tf = (x.ravel() for x in np.meshgrid(np.deg2rad(PLACES_DEG), np.deg2rad(TOOLFACES_DEG), indexing="ij"))
    cells = (len(PLACES_DEG), TOOLFACES_DEG.size)
    errors: dict[str, list[Array]] = {"plain least squares": [], "joint": [], "joint, refined": []}
    inside = []
    for seed in range(sensors):
        scenario = reference_scenario(seed, toolfaces_deg=plan, structure_g=1e-3, structure=structure)
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
    for label, row in zip("IT", 100 * np.mean(inside, axis=(0, 3)), strict=True):
        print(f"\nCoverage of {label}: " + ", ".join(f"{x:.1f}" for x in row[:POSED]), end="; between and at 100 deg: ")
        print(", ".join(f"{x:.1f}" for x in row[POSED:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensors", type=int, default=40)
    chosen = parser.parse_args()
    for name, structure in STRUCTURES.items():
        for plan, toolfaces in PLANS.items():
            print(f"\n## {name}, {plan}, {chosen.sensors} sensors\n")
            print("| rms in deg | I at the poses' rings | I at 20 to 82 | I at 100 | T at 0.612 | T at 45 |")
            print("|---|---|---|---|---|---|")
            study(structure, toolfaces, chosen.sensors)


if __name__ == "__main__":
    main()
