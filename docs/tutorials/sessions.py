"""Sessions for the tutorials: numpy alone, with physics that highside's library of effects does not have.

    python sessions.py NAME

writes `one.csv`, `two.csv` and `three.csv`, three sessions of one sensor on one bench with the flaw NAME, each with
other poses (or rates), other temperatures and other noise; and `known.toml`, what is known of the sensor: nothing
beside offset, scale and misalignment, which are fitted. Angles in degrees, accelerations in g, times in s.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SENSOR = np.random.default_rng(2026)
MATRIX = np.eye(3) + 1e-3 * SENSOR.standard_normal((3, 3))
OFFSET_G = 2e-3 * SENSOR.standard_normal((3, 1))
NOISE_G = 1.2e-4
ROWS = 4
KNOWN = '[sensor]\nfree = ["bias", "scale", "misalignment"]\n'


def gravity(inc_deg: Array, tf_deg: Array) -> Array:
    """Up, in the axes of the tool: (3, n)."""
    inc, tf = np.radians(inc_deg), np.radians(tf_deg)
    return np.stack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])


def poses(rng: np.random.Generator, toolfaces: int = 16) -> dict[str, Array]:
    """Stops in an order drawn at random, four rows each, while the oven goes up and down."""
    inclinations = np.sort(rng.uniform(5.0, 120.0, 7))
    inc, tf = np.meshgrid(inclinations, np.arange(toolfaces) * 360.0 / toolfaces + rng.uniform(0, 22), indexing="ij")
    order = rng.permutation(inc.size)
    inc, tf = np.repeat(inc.ravel()[order], ROWS), np.repeat(np.mod(tf.ravel()[order], 360.0), ROWS)
    number = np.repeat(np.arange(order.size, dtype=float), ROWS)
    t_s = 40.0 * number + np.tile(np.arange(ROWS, dtype=float), order.size)
    high, peak = rng.uniform(55.0, 62.0), rng.uniform(0.4, 0.6)
    temp = np.interp(t_s / t_s[-1], [0.0, peak, 1.0], [22.0, high, 27.0])
    return {"t_s": t_s, "inc_ref_deg": inc, "tf_ref_deg": tf, "temp_c": temp, "pose": number}


def rotation(rng: np.random.Generator) -> dict[str, Array]:
    """One inclination, eight steady rates of both signs with ramps between them, 12.5 rows a second."""
    rates = rng.permutation(np.concatenate([rng.uniform(20, 240, 4), -rng.uniform(20, 240, 4)]))
    hold, ramp, step = 9.0, 1.0, 0.08
    t_s = np.arange(0.0, rates.size * (hold + ramp), step)
    corners = np.concatenate([[k * (hold + ramp), k * (hold + ramp) + hold] for k in range(rates.size)])
    rate = np.interp(t_s, corners, np.repeat(rates, 2))
    turned = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * step)])
    inc = np.full(t_s.size, rng.uniform(50.0, 75.0))
    return {"t_s": t_s, "inc_ref_deg": inc, "tf_ref_deg": turned, "rotor_rate_dps": rate}


def dent(rows: dict[str, Array], rng: np.random.Generator) -> None:
    """A wire touches the housing near one toolface, and presses on the y axis."""
    apart = np.mod(rows["tf_ref_deg"] - 130.0 + 180.0, 360.0) - 180.0
    rows["ay_g"] = rows["ay_g"] + 4e-4 * np.exp(-0.5 * (apart / 24.0) ** 2)


def glue(rows: dict[str, Array], rng: np.random.Generator) -> None:
    """The glue of the z sensor gives way about 42 degrees, and is firm again above: a peak of the scale factor."""
    rows["az_g"] = rows["az_g"] * (1.0 + 6e-4 * np.exp(-0.5 * ((rows["temp_c"] - 42.0) / 5.0) ** 2))


def supply(rows: dict[str, Array], rng: np.random.Generator) -> None:
    """The offset of x follows the supply, which somebody recorded beside the sensor: a column of its own."""
    volts = 24.0 + 1.5 * np.sin(2 * np.pi * rows["t_s"] / rng.uniform(900, 1300))
    rows["supply_v"] = volts
    rows["ax_g"] = rows["ax_g"] + 2e-4 * np.maximum(volts - 24.2, 0.0)


def arm(rows: dict[str, Array], rng: np.random.Generator) -> None:
    """The arm of the bench bends with the square of the warmth of the room: the inclination is off by it."""
    bent = 4e-7 * (rows["temp_c"] - 22.0) ** 2
    inc, tf = rows["inc_ref_deg"], rows["tf_ref_deg"]
    moved = gravity(inc + np.degrees(bent), tf) - gravity(inc, tf)
    for name, change in zip(("ax_g", "ay_g", "az_g"), moved, strict=True):
        rows[name] = rows[name] + change


def ring(rows: dict[str, Array], rng: np.random.Generator) -> None:
    """A brush of the slip ring bounces at one toolface of a turning tool, and the supply of y dips."""
    apart = np.mod(rows["tf_ref_deg"], 360.0) - 180.0  # y bears no load there
    rows["ay_g"] = rows["ay_g"] - 4e-4 * np.exp(-0.5 * (apart / 20.0) ** 2)


FLAWS = {"dent": dent, "glue": glue, "supply": supply, "arm": arm, "ring": ring}


def session(name: str, number: int) -> dict[str, Array]:
    """Session 1, 2 or 3 with a flaw."""
    rng = np.random.default_rng([number, *name.encode()])
    rows = rotation(rng) if name == "ring" else poses(rng)
    read = MATRIX @ gravity(rows["inc_ref_deg"], rows["tf_ref_deg"]) + OFFSET_G
    rows.update(zip(("ax_g", "ay_g", "az_g"), read, strict=True))
    FLAWS[name](rows, rng)
    for axis in ("ax_g", "ay_g", "az_g"):
        rows[axis] = rows[axis] + NOISE_G * rng.standard_normal(rows["t_s"].size)
    return rows


def main() -> None:
    """Write the files of one flaw into the folder at hand."""
    if len(sys.argv) != 2 or sys.argv[1] not in FLAWS:
        sys.exit(f"usage: python sessions.py {'|'.join(FLAWS)}")
    for number, name in enumerate(("one", "two", "three"), start=1):
        rows = session(sys.argv[1], number)
        lines = [",".join(rows), *(",".join(f"{v:.9g}" for v in row) for row in zip(*rows.values(), strict=True))]
        Path(f"{name}.csv").write_text("\n".join(lines) + "\n")
    Path("known.toml").write_text(KNOWN)


if __name__ == "__main__":
    main()
