"""Averages of attitudes by hand, of which only |g| is known: laws that the library lacks, effects of it, and nothing.

    python -m studies.hand_outsiders laws|effects|nulls [--first-seed 500] [--seeds 20] [--strength 400]

A table of 16 to 47 averages of attitudes all over the sphere, each of 100 readings; offset and the whole matrix are
refitted. What is hidden is one smooth function of one load or of the temperature on one axis (`laws`), or an effect of
the library (`effects`); its strength is its energy in units of what an average is uncertain by, off offset and matrix.
Noise is in turn white, a random walk of the zero, correlated, heavy-tailed, of two sizes, and rounded; of laws it is
white. Physics and noise are made here; of the product nothing but `diagnose` is used.

wrong: a name, of which 40 units of the law's strength or more lie outside, alone or beside other names; near: a name of
which less lies outside; or: a wrong name, but a law of the same quantity is told as a rival; law: laws alone, of that
quantity (`other law`: of others); refused: `unknown`, `wander`, `partial`, `not_testable`; nothing: `nothing_left_out`.
Of effects: named, alone or with names that do the same; tied: a law is told as a rival; law: a law in its place;
resembles: that law is said to resemble it; implausible: the name, of a size that no instrument has, alone (`other
implausible`: other names; of laws any).
"""

from __future__ import annotations

import argparse
import itertools
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

NOISE_G = 2e-4
"""g; of one reading"""
READINGS = 100
"""of an average"""
AXES = "xyz"
NOISES = ("white", "walk", "coloured", "heavy", "modulated", "rounded")
LAWS = ("kink of load", "kink of temp", "bump of load", "bump of temp", "tanh of load", "fourth power of load",
        "sine of load", "step of temp", "power 1.5 of temp", "exponential of load")  # fmt: skip
UNSEEN = 40.0
"""strength outside of a name below which the name is no fault: what no margin can tell (spec: shapes within x %)"""
EFFECTS = ("quadratic", "cubic", "asymmetry", "odd_quadratic", "temperature_bias", "temperature_scale", "bias_step",
           "bias_drift", "warmup")  # fmt: skip


def attitudes(rng: np.random.Generator, n: int) -> Array:
    """(3, n) unit vectors all over the sphere."""
    found = rng.normal(size=(3, n))
    return np.asarray(found / np.linalg.norm(found, axis=0))


def course(rng: np.random.Generator, law: str, load: Array, temp: Array) -> Array:
    """(n,) a smooth function; `temp` from 0 to 1."""
    shape, _, of = law.partition(" of ")
    u = load if of == "load" else 2 * temp - 1
    at, width = rng.uniform(-0.4, 0.4), rng.uniform(0.2, 0.4)
    made: dict[str, Callable[[], Array]] = {
        "kink": lambda: np.maximum(u - at, 0.0),
        "bump": lambda: np.exp(-(((u - at) / width) ** 2) / 2),
        "tanh": lambda: np.tanh((u - at) / width),
        "fourth power": lambda: u**4,
        "sine": lambda: np.sin(rng.uniform(3.0, 6.0) * u + at),
        "step": lambda: (u > at).astype(float),
        "power 1.5": lambda: ((u + 1) / 2) ** 1.5,
        "exponential": lambda: np.exp(rng.uniform(2.0, 4.0) * u),
    }
    return np.asarray(made[shape](), dtype=float)


def effect(rng: np.random.Generator, name: str, load: Array, temp: Array, time: Array) -> Array:
    """(n,) an effect of the library on the axis of a load; `temp` and `time` from 0 to 1."""
    made: dict[str, Callable[[], Array]] = {
        "quadratic": lambda: load**2,
        "cubic": lambda: load**3,
        "asymmetry": lambda: np.abs(load),
        "odd_quadratic": lambda: load * np.abs(load),
        "temperature_bias": lambda: temp,
        "temperature_scale": lambda: temp * load,
        "bias_step": lambda: (time > rng.uniform(0.3, 0.7)).astype(float),
        "bias_drift": lambda: time,
        "warmup": lambda: np.exp(-time / rng.uniform(0.1, 0.25)),
    }
    return np.asarray(made[name](), dtype=float)


def outside(load: Array, does: Array) -> Array:
    """What of (n,) on the magnitude offset and the matrix do not take."""
    x, y, z = load
    base = np.array([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z]).T
    q, _ = np.linalg.qr(base)
    return np.asarray(does - q @ (q.T @ does))


def noise(rng: np.random.Generator, kind: str, n: int, sigma: float) -> Array:
    """(3, n) errors of averages."""
    white = rng.normal(0, sigma, (3, n))
    if kind == "walk":
        return np.asarray(white + np.cumsum(rng.normal(0, 0.5 * sigma, (3, n)), axis=1))
    if kind == "coloured":
        level = np.zeros((3, n))
        level[:, 0] = rng.normal(0, sigma, 3)
        for k in range(1, n):
            level[:, k] = 0.8 * level[:, k - 1] + rng.normal(0, 0.6 * sigma, 3)
        return np.asarray(white + level)
    if kind == "heavy":
        return np.asarray(sigma * rng.standard_t(3, (3, n)) / np.sqrt(3))
    if kind == "modulated":
        return np.asarray(white * np.where(np.arange(n) < n // 2, 0.6, 1.6))
    return white


@dataclass(frozen=True)
class Case:
    """Columns of a table, what was hidden, and the kind of noise."""

    columns: dict[str, Array]
    kind: str
    name: str
    noise: str
    outside: Callable[[list[str]], float]
    """strength outside of names"""


def case(kind: str, seed: int, strength: float) -> Case:
    """A table of a seed."""
    rng = np.random.default_rng([seed, ("laws", "effects", "nulls").index(kind)])
    n, sigma = int(rng.integers(16, 48)), NOISE_G / np.sqrt(READINGS)
    load, axis = attitudes(rng, n), int(rng.integers(3))
    time = (np.arange(n) + rng.uniform(0, 0.5, n)) / n
    turns = rng.uniform(0.5, 2.0)
    temp = 0.5 - 0.5 * np.cos(2 * np.pi * turns * time + rng.uniform(0, 6))
    temp = (temp - temp.min()) / np.ptp(temp)
    sort = NOISES[seed % len(NOISES)] if kind != "laws" else "white"
    names = {"laws": LAWS, "effects": EFFECTS, "nulls": ("nothing",)}[kind]
    name = names[seed % len(names)]
    does = np.zeros(n)
    if kind == "laws":
        does = course(rng, name, load[axis], temp)
    elif kind == "effects":
        does = effect(rng, name, load[axis], temp, time)
    size = np.sqrt(np.sum(outside(load, does * load[axis]) ** 2))
    if kind != "nulls":
        does = does * np.sqrt(strength) * sigma / size
    read = (np.eye(3) + rng.normal(0, 3e-3, (3, 3))) @ load + rng.normal(0, 3e-3, (3, 1))
    read[axis] += does
    read = read + noise(rng, sort, n, sigma)
    if sort == "rounded":
        read = np.round(read / (2 * sigma)) * 2 * sigma
    columns = {f"a{one}": row for one, row in zip(AXES, read, strict=True)}
    columns |= {f"std_a{one}": np.full(n, NOISE_G) for one in AXES}
    columns |= {"n": np.full(n, float(READINGS)), "t_s": 20.0 * n * time, "temp_c": 20.0 + 15.0 * temp}
    return Case(columns, kind, name, sort, lambda names: beyond(names, load, temp, time, does, axis, sigma))


def beyond(names: list[str], load: Array, temp: Array, time: Array, does: Array, axis: int, sigma: float) -> float:
    """Strength of a law outside of what names can do on all axes, their shapes at their best."""
    tries = [np.linspace(0.02, 0.98, 49) if name in ("bias_step", "warmup") else np.zeros(1) for name in names]
    least = np.inf
    along = load[axis] * does
    for shapes in itertools.product(*tries):
        columns = [row for name, at in zip(names, shapes, strict=True) for row in _columns(name, at, load, temp, time)]
        base = [*load, *(load[i] * load[j] for i in range(3) for j in range(i, 3))]
        q, _ = np.linalg.qr(np.array([*base, *columns]).T)
        least = min(least, float(np.sum((along - q @ (q.T @ along)) ** 2)) / sigma**2)
    return least


def _columns(name: str, at: float, load: Array, temp: Array, time: Array) -> list[Array]:
    """What an effect can do to the magnitude, axis by axis; nothing of an effect that is not made here."""
    if name == "cross_product":
        return [load[k] * load[i] * load[j] for k in range(3) for i, j in ((0, 1), (0, 2), (1, 2))]
    made = {
        "quadratic": load**2, "cubic": load**3, "asymmetry": np.abs(load), "odd_quadratic": load * np.abs(load),
        "temperature_bias": temp + 0 * load, "temperature_scale": temp * load, "bias_drift": time + 0 * load,
        "bias_step": (time > at) + 0 * load, "warmup": np.exp(-time / max(at, 1e-3)) + 0 * load,
    }.get(name)  # fmt: skip
    return [] if made is None else [one * own for one, own in zip(made, load, strict=True)]


def judged(found: dict[str, Any], one: Case) -> str:
    """What became of what was hidden."""
    claims, kind = found["claims"], one.kind
    if not claims and found["verdict"] == "implausible_fit":
        return "implausible" if one.name in found["remainder"]["resembles"] else "other implausible"
    if not claims:
        return "nothing" if found["verdict"] == "nothing_left_out" else "refused"
    if kind == "nulls":
        return "alarm"
    names = [c for c in claims if not c["effect"].startswith("law:")]
    ties = [any(other.startswith("law:") for other in c["equivalence_class"]) for c in names]
    if kind == "effects":
        if any(one.name in {c["effect"], *c["equivalence_class"]} for c in claims):
            return "tied" if any(ties) or len(names) < len(claims) else "named"
        resembles = any(one.name in c["resembles"] for c in claims)
        return "wrong" if names else "resembles" if resembles else "law"
    of = "load" if one.name.endswith("load") else "temp"
    if not names:
        each = [{*c["depends_on"], *(o.partition("_")[2] for o in c["equivalence_class"])} for c in claims]
        return "law" if any(of in own or any(o.endswith(f"_{of}") for o in own) for own in each) else "other law"
    if one.outside([c["effect"] for c in names]) < UNSEEN:
        return "near"
    told = any(other.startswith("law:") and of in other for c in names for other in c["equivalence_class"])
    return "or" if told else "wrong"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("laws", "effects", "nulls"))
    parser.add_argument("--first-seed", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--strength", type=float, default=400.0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    counted: Counter[str] = Counter()
    by_noise: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model.toml"
        model.write_text(
            f'[sensor]\nnoise_g = {NOISE_G}\nfree = ["bias", "scale", "misalignment"]\n'
            '[reference]\nkind = "magnitude"\n'
        )
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            one = case(given.kind, seed, given.strength)
            found = highside.diagnose(one.columns, str(model)).to_dict()
            word = judged(found, one)
            counted[word] += 1
            by_noise.setdefault(one.noise, Counter())[word] += 1
            claims = "; ".join(
                c["effect"] + (f" (or {', '.join(c['equivalence_class'][1:])})" if c["equivalence_class"][1:] else "")
                for c in found["claims"]
            )
            print(
                f"{seed} {one.noise:9s} {one.columns['ax'].size:2d} {one.name:20s} {word:10s} "
                f"{found['verdict']:16s} {claims}",
                flush=True,
            )
    print(f"{given.kind}, strength {given.strength:g}: {dict(counted.most_common())}")
    if len(by_noise) > 1:
        for sort, words in by_noise.items():
            print(f"  {sort}: {dict(words.most_common())}")


if __name__ == "__main__":
    main()
