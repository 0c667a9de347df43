"""Laws drawn at random in stepped sessions, by a generator that uses nothing of the product but `diagnose`.

    python -m studies.random_laws [--seed 31] [--cases 45] [--null]

Each session has 24 to 130 poses (at random, or rings in either order), 40 to 90 rows of white noise each, settings that
are off by some 80 microradian, temperatures in waves, and a column `supply_v` that wanders. What is left out is one
smooth function (tanh, kink, bump, sine, power, exponential, a sum of waves; of the toolface a bump or a wave that is
modulated) of a load, an angle, the temperature, the time or that column, as an offset or a scale factor of one axis or
an error of an angle. `strength` is its energy in units of what a pose mean is uncertain by, before anything is fitted:
the fit of offset, scale and misalignment takes part of it away, of some laws most.

right: the law is claimed, or in the class that is told; alone: nothing else is claimed; other: only something else is
claimed; refused: `unknown`, `wander`, `partial` or `not_testable`; nothing: `nothing_left_out`.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import highside
from highside.arrays import Array
from highside.errors import HighsideError

AXES = "xyz"
SETTING_RAD = 8e-5
"""rad; error of a set angle"""
BENCH_G = 6e-5
"""g; what that makes of a pose, about"""
FOLLOWS = {
    "offset": ("load", "load_other", "tf", "inc", "temp", "time", "supply_v"),
    "scale": ("temp", "time", "supply_v", "load_other"),
    "inclination": ("temp", "tf", "inc"),
    "toolface": ("inc", "temp", "tf"),
}
CLASSES = (0.0, 100.0, 400.0, np.inf)
"""Strengths between which results are counted."""


@dataclass(frozen=True)
class Case:
    """One session, and what was left out of it."""

    columns: dict[str, Array]
    noise_g: float
    truth: frozenset[str]
    strength: float
    poses: int


def curve(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A smooth function of -1 to 1."""
    middle, width = rng.uniform(-0.6, 0.6), rng.uniform(0.2, 0.6)
    sizes, begins, waves = rng.normal(0, 1, 6), rng.uniform(0, 6, 6), rng.uniform(0.5, 3.5, 6)
    made: list[Callable[[Array], Array]] = [
        lambda u: np.tanh((u - middle) / width),
        lambda u: np.maximum(u - middle, 0.0),
        lambda u: np.exp(-(((u - middle) / width) ** 2) / 2),
        lambda u: np.sin(2.7 * u + 5 * middle),
        lambda u: (np.maximum(u + 1, 0.0) / 2) ** 2.6,
        lambda u: np.exp(2 * u),
        lambda u: np.sum(sizes[:, None] * np.sin(waves[:, None] * u + begins[:, None]), axis=0),
    ]
    return made[int(rng.integers(len(made)))]


def around(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A periodic function of an angle in rad."""
    order, begin = int(rng.integers(2, 6)), rng.uniform(0, 6)
    if rng.random() < 0.5:
        return lambda t: np.asarray(np.exp(3 * (np.cos(t - begin) - 1)))
    return lambda t: np.asarray(np.cos(order * t + begin) * np.exp(np.cos(t) - 1))


def poses(rng: np.random.Generator) -> tuple[Array, Array]:
    """Set inclination and toolface in degrees."""
    count, design = int(rng.integers(24, 131)), int(rng.integers(3))
    if design == 0:
        return rng.uniform(2, 170, count), rng.uniform(0, 360, count)
    around_, rings = (8, max(3, count // 8)) if design == 1 else (6, max(3, count // 6))
    if design == 1:
        return np.repeat(np.linspace(10, 150, rings), 8), np.tile(np.arange(8) * 45.0 + 3, rings)
    return np.tile(rng.uniform(5, 160, rings), around_), np.repeat(np.arange(6) * 60.0, rings)


def gravity(inc: Array, tf: Array) -> Array:
    """(3, n) load on each axis, g."""
    return np.array([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])


def names(place: str, channel: str, follows: str, axis: int) -> frozenset[str]:
    """The ids of a law: the load on z is a function of the inclination, and the reverse."""
    own = {"load": "load", "load_other": f"load_{AXES[(axis + 1) % 3]}"}.get(follows, follows)
    along_z = own in ("inc", "load_z") or (own == "load" and axis == 2)
    alike = {own, *(("inc", "load_z") if along_z else ()), *(("load",) if along_z and axis == 2 else ())}
    return frozenset(f"law:{place}_{channel}_{one}" for one in alike)


def case(seed: int, number: int, *, null: bool) -> Case:
    """One session of a seed."""
    rng = np.random.default_rng([seed, number])
    set_inc, set_tf = poses(rng)
    n, rows, noise = set_inc.size, int(rng.integers(40, 91)), float(10 ** rng.uniform(-4.3, -3.3))
    turns = np.arange(n) / n * rng.uniform(2, 9) + rng.uniform(0, 6)
    temp = 25 + rng.uniform(5, 30) * np.sin(turns) + rng.normal(0, 0.5, n)
    supply, t_s = 24 + np.cumsum(rng.normal(0, 0.1, n)), np.arange(n) * rng.uniform(20, 60)
    inc, tf = (np.radians(one) + rng.normal(0, SETTING_RAD, n) for one in (set_inc, set_tf))
    axis, place = int(rng.integers(3)), str(rng.choice(list(FOLLOWS), p=[0.5, 0.2, 0.15, 0.15]))
    follows = str(rng.choice(FOLLOWS[place]))
    load = gravity(inc, tf)

    def unit(values: Array) -> Array:
        return np.asarray(2 * (values - values.min()) / (np.ptp(values) + 1e-12) - 1)

    if follows == "tf":
        does = around(rng)(tf)
    else:
        other = load[(axis + 1) % 3]
        along = {"load": load[axis], "load_other": other, "inc": inc, "temp": temp, "time": t_s, "supply_v": supply}
        does = curve(rng)(along[follows] if follows.startswith("load") else unit(along[follows]))
    strength = 0.0 if null else float(10 ** rng.uniform(1, 5))
    does = does - does.mean()
    does = does / np.sqrt(np.mean(does**2)) * np.sqrt(strength / n) * np.hypot(noise / np.sqrt(rows), BENCH_G)
    if place in ("inclination", "toolface"):
        load = gravity(inc + does * (place == "inclination"), tf + does * (place == "toolface"))
    read = (np.eye(3) + rng.normal(0, 3e-3, (3, 3))) @ load + rng.normal(0, 2e-3, (3, 1))
    if place in ("offset", "scale"):
        read[axis] += does * (load[axis] if place == "scale" else 1.0)
    every = np.repeat(read, rows, axis=1)
    every = every + rng.normal(0, noise, every.shape)
    columns = {"t_s": np.repeat(t_s, rows) + np.tile(np.arange(rows) * 0.05, n)}
    columns |= {f"a{one}_g": channel for one, channel in zip(AXES, every, strict=True)}
    slow = {"temp_c": temp, "inc_ref_deg": set_inc, "tf_ref_deg": np.mod(set_tf, 360.0), "supply_v": supply}
    columns |= {name: np.repeat(values, rows) for name, values in slow.items()}
    channel = {"inclination": "inc", "toolface": "tf"}.get(place, AXES[axis])
    return Case(columns, noise, names(place, channel, follows, axis), strength, n)


def outcome(found: dict[str, Any], truth: frozenset[str]) -> str:
    """What became of a law."""
    claims = [{claim["effect"], *claim["equivalence_class"]} for claim in found["claims"]]
    right = [bool(truth & claim) for claim in claims]
    if any(right):
        return "right, alone" if all(right) else "right"
    if claims:
        return "other"
    return "nothing" if found["verdict"] == "nothing_left_out" else "refused"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--cases", type=int, default=45)
    parser.add_argument("--null", action="store_true", help="nothing is left out")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    counted: dict[int, Counter[str]] = {k: Counter() for k in range(len(CLASSES) - 1)}
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model.toml"
        for number in range(given.cases):
            one = case(given.seed, number, null=given.null)
            model.write_text(f"[sensor]\nnoise_g = {one.noise_g:.3g}\n")
            try:
                found = highside.diagnose(one.columns, str(model)).to_dict()
            except HighsideError as error:
                print(f"{number:3d} {one.poses} poses: {error}")
                continue
            word = outcome(found, frozenset() if given.null else one.truth)
            counted[int(np.searchsorted(CLASSES, one.strength, side="right")) - 1][word] += 1
            claims = ", ".join(claim["effect"] for claim in found["claims"]) or "-"
            truth = "nothing" if given.null else min(one.truth)
            print(f"{number:3d} {truth:28s} {one.strength:8.0f} {one.poses:3d} poses: {word:12s} {claims}", flush=True)
    for k, words in counted.items():
        if words:
            low, high = CLASSES[k], CLASSES[k + 1]
            print(f"strength {low:g} to {high:g}: {sum(words.values())} cases, {dict(sorted(words.items()))}")


if __name__ == "__main__":
    main()
