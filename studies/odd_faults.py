"""Faults put in by hand, of forms that neither the library nor a deck has: what is said of them?

    python -m studies.odd_faults [--seed 4] [--design poses|rotation] [--only NAME ...]

Sessions of 112 random poses (four rows each, 0.1 mg a row), and rotations of 168 s at ten rates (40 Hz, 0.08 mg a row).
For each fault its form, then the first sentence of the diagnosis with the share of the misfit that is explained: the
reader judges, for a form has no id to compare with.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable

import numpy as np

from highside.api.diagnosis import Diagnosis, diagnose
from highside.api.simulation import simulate
from highside.arrays import Array
from highside.config.model import Model
from highside.report.diagnosis_claims import first_sentence, shares_of_fit
from highside.report.diagnosis_words import verdict_words

Fault = Callable[[dict[str, Array], np.random.Generator], dict[str, Array]]
"""What is added to readings: {channel: (n,) g} of columns"""

ROTATION = {
    "sensor": {"noise_g": 80e-6, "bias_g": [1e-3, -2e-3, 0.5e-3], "scale": [0.002, -0.001, 0.003]},
    "effects": {
        "included": ["earth_rotation", "gyro_noise"],
        "earth_rotation": {"share": 1},
        "gyro_noise": {"density_dps": 0.005},
    },
    "motion": {
        "kind": "rotation",
        "inclination_deg": 62,
        "rates_hz": [-2, -1.5, -1, -0.5, -0.2, 0.2, 0.5, 1, 1.5, 2],
        "hold_s": 15,
        "ramp_s": 2,
        "sample_hz": 40,
        "temperatures_c": [25, 40, 30],
    },
    "site": {"gravity_mps2": 9.81, "latitude_deg": 52.0, "azimuth_deg": 30.0},
}


def steps(*steps: tuple[float, float]) -> Fault:
    """An offset of z that steps by g at s."""
    return lambda columns, rng: {"az_g": np.sum([size * (columns["t_s"] >= at) for at, size in steps], axis=0)}


def turns_hz(columns: dict[str, Array]) -> Array:
    """(n,) rate of the toolface."""
    turned = np.unwrap(np.radians(columns["tf_ref_deg"]))
    return np.asarray(np.gradient(turned, columns["t_s"]) / (2 * np.pi))


POSES: dict[str, tuple[str, Fault]] = {
    "nothing": ("nothing", lambda c, rng: {}),
    "step": ("an offset of z that steps by 0.6 mg", steps((1000.0, 6e-4))),
    "two steps": ("an offset of z: up by 0.6 mg, later down by 0.5 mg", steps((1000.0, 6e-4), (2400.0, -5e-4))),
    "three steps": (
        "an offset of z: up by 0.6, down by 0.5, up by 0.8 mg",
        steps((900.0, 6e-4), (2000.0, -5e-4), (3100.0, 8e-4)),
    ),
    "soft stop": (
        "z reads 3 % less beyond 0.8 g",
        lambda c, rng: {"az_g": -0.03 * np.maximum(np.abs(c["az_g"]) - 0.8, 0)},
    ),
    "fifth order": (
        "an offset of x of order 5 of the toolface, times the cosine of the inclination",
        lambda c, rng: {"ax_g": 3e-4 * np.sin(np.radians(5 * c["tf_ref_deg"])) * np.cos(np.radians(c["inc_ref_deg"]))},
    ),
    "root of a load": (
        "an offset of y: 0.5 mg times the root of the load on z, with the sign of that on x",
        lambda c, rng: {"ay_g": 5e-4 * np.sqrt(np.abs(c["az_g"])) * np.sign(c["ax_g"])},
    ),
    "decay": (
        "an offset of x of 1 mg that decays with 670 s",
        lambda c, rng: {"ax_g": 1e-3 * np.exp(-c["t_s"] / 670.0)},
    ),
    "wander": (
        "an offset of x in a random walk, 0.03 mg from pose to pose",
        lambda c, rng: {"ax_g": np.cumsum(rng.normal(0, 3e-5, c["t_s"].size // 4)).repeat(4)},
    ),
    "common scale": (
        "the scale factor of all axes follows a slow sine of time, 0.04 %",
        lambda c, rng: {k: c[k] * 4e-4 * np.sin(9 * c["t_s"] / c["t_s"][-1]) for k in ("ax_g", "ay_g", "az_g")},
    ),
}
ROTATIONS: dict[str, tuple[str, Fault]] = {
    "nothing": ("nothing", lambda c, rng: {}),
    "cube": ("an offset of z by the cube of the temperature", lambda c, rng: {"az_g": 3e-7 * (c["temp_c"] - 32) ** 3}),
    "resonance": (
        "an offset of y of 1.2 mg near 1.2 turns a second",
        lambda c, rng: {"ay_g": 1.2e-3 / (1 + ((np.abs(turns_hz(c)) - 1.2) / 0.15) ** 2)},
    ),
    "dent": (
        "an offset of x of 0.8 mg near toolface 63 deg",
        lambda c, rng: {"ax_g": 8e-4 * np.exp(4 * (np.cos(np.radians(c["tf_ref_deg"] - 63)) - 1))},
    ),
    "scale by rate": (
        "the scale factor of x follows the rate, 0.06 %",
        lambda c, rng: {"ax_g": c["ax_g"] * 6e-4 * np.tanh(3 * turns_hz(c))},
    ),
    "chirp": (
        "an offset of z that swings ever faster, 0.5 mg at 0.02 to 0.12 Hz",
        lambda c, rng: {"az_g": 5e-4 * np.sin(2 * np.pi * (0.02 * c["t_s"] + 3e-4 * c["t_s"] ** 2))},
    ),
    "fading scale": (
        "the scale factor of x is off by 0.1 % at first and recovers with 30 s",
        lambda c, rng: {"ax_g": c["ax_g"] * 1e-3 * np.exp(-c["t_s"] / 30)},
    ),
    "walk": (
        "an offset of z in a random walk, 0.01 mg a row",
        lambda c, rng: {"az_g": np.cumsum(rng.normal(0, 1e-5, c["t_s"].size))},
    ),
    "late axis": (
        "x is read 4 ms late",
        lambda c, rng: {"ax_g": np.interp(c["t_s"] - 0.004, c["t_s"], c["ax_g"]) - c["ax_g"]},
    ),
    "bent load": (
        "y: 0.4 mg by the cube of its load, less 0.2 mg by its load beyond 0.2 g",
        lambda c, rng: {"ay_g": 4e-4 * c["ay_g"] ** 3 - 2e-4 * c["ay_g"] * (c["ay_g"] > 0.2)},
    ),
}


def poses(seed: int) -> dict[str, Array]:
    """112 random poses of a perfect sensor."""
    rng, n = np.random.default_rng(seed), 112
    inc, tf = rng.uniform(10, 120, n).repeat(4), rng.uniform(0, 360, n).repeat(4)
    i, t = np.radians(inc), np.radians(tf)
    readings = np.stack([np.sin(i) * np.cos(t), np.sin(i) * np.sin(t), np.cos(i)])
    readings = readings + 1e-4 * rng.standard_normal(readings.shape)
    t_s = np.asarray(40.0 * np.arange(n).repeat(4) + np.tile(np.arange(4.0), n), dtype=float)
    columns: dict[str, Array] = {
        "t_s": t_s,
        "inc_ref_deg": inc,
        "tf_ref_deg": tf,
        "pose": np.arange(float(n)).repeat(4),
    }
    return columns | dict(zip(("ax_g", "ay_g", "az_g"), readings, strict=True))


def rotation(seed: int) -> dict[str, Array]:
    """The rotation of `ROTATION`."""
    made = simulate(Model.model_validate(ROTATION), seed=seed).recording
    return {name: np.array(column, dtype=float) for name, column in made.columns.items()}


def sentence(found: Diagnosis) -> str:
    """The first sentence, as the command prints it."""
    return first_sentence(found.found, shares_of_fit(found.found), verdict_words(found.found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--design", choices=("poses", "rotation"), nargs="+", default=["poses", "rotation"])
    parser.add_argument("--only", nargs="+", help="these faults alone")
    given = parser.parse_args()
    designs = {"poses": (poses, POSES, Model()), "rotation": (rotation, ROTATIONS, Model.model_validate(ROTATION))}
    for design in given.design:
        make, faults, model = designs[design]
        for name, (form, fault) in faults.items():
            if given.only and name not in given.only:
                continue
            columns = make(given.seed)
            for channel, added in fault(columns, np.random.default_rng(given.seed + 1)).items():
                columns[channel] = columns[channel] + added
            begun = time.process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = diagnose(columns, model)
            took = time.process_time() - begun
            print(f"{design:9s} {form}\n    {took:5.1f} s: {found.verdict}: {sentence(found)}", flush=True)


if __name__ == "__main__":
    main()
