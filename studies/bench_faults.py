"""What goes wrong at a bench rather than in the sensor, in stepped sessions: is it said, whatever its size?

    python -m studies.bench_faults [--first-seed 1000] [--seeds 4] [--kinds exchanged,tone,...]

Sessions of 24 to 60 poses, in order or at random, of 15 to 40 rows each, white noise of 50 ug a row, a room that warms.

exchanged: the angles of two poses were exchanged, 0.03 to 60 deg apart; right is that these two are said and nothing is
claimed. tone: all channels oscillate with a period of 60 to 400 s, 50 ug to 20 mg; right is one law of an offset that
oscillates with that period. jump: in one pose one row is off by 2 to 200 mg, and one axis' scale factor follows the
temperature by 0.5 mg; right is that law. zero: the zero of the toolface changed after half of the session by 0.01 to 3
deg; right is an error of the toolface that follows time, told or in a class, or nothing told and not "nothing". spans:
four neighbouring poses are in m/s2; right is that these four are said. lash: the toolface stops 0.003 to 0.08 deg short
of where it was to go, from either side, and no column says from which; right is a play of the toolface, `stiction` or
`backlash`, or no name and not "nothing". Physics and noise are made here; of the product
nothing but `diagnose` is used.
"""

from __future__ import annotations

import argparse
import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from highside.api.diagnosis import Diagnosis, diagnose
from highside.arrays import Array
from highside.config.model import Model
from highside.physics.law import Law

ROW_G = 5e-5
MODEL = Model.model_validate({"sensor": {"free": ["bias", "scale", "misalignment"]}})


@dataclass
class Bench:
    """A session before the fault: angles (n,) of poses in deg, and rows (N,)."""

    rng: np.random.Generator
    inc: Array
    tf: Array
    pose: Array
    t_s: Array
    temp: Array

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Bench:
        """A grid of stations in order, or angles at random."""
        count = int(rng.choice([24, 36, 48, 60]))
        if rng.random() < 0.5:
            inc = np.repeat(np.sort(rng.uniform(8, 165, count // 12)), 12)
            tf = np.tile(np.arange(12) * 30.0, count // 12)
        else:
            inc, tf = rng.uniform(8, 165, count), rng.uniform(0, 360, count)
        rows, step = int(rng.integers(15, 41)), float(rng.choice([0.5, 1.0]))
        began = np.cumsum(rng.uniform(1.2, 2.0, count) * rows * step)
        t_s = (began[:, None] + step * np.arange(rows)).reshape(-1)
        temp = 24.0 + rng.uniform(4, 15) * (1 - np.exp(-t_s / rng.uniform(400, 2000))) + 0.3 * np.sin(t_s / 500)
        return cls(rng, inc, tf, np.repeat(np.arange(count), rows), t_s, temp)

    def load(self, tf_deg: Array | None = None) -> Array:
        """(3, N) gravity at the rows; at other toolfaces (n,) of the poses if they are given."""
        inc, tf = np.radians(self.inc[self.pose]), np.radians((self.tf if tf_deg is None else tf_deg)[self.pose])
        return np.stack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])

    def diagnosed(self, load: Array, added: Array | float = 0.0, order: Array | None = None) -> Diagnosis:
        """Of readings of these loads; `order` (n,): whose angles were written down at each pose."""
        matrix = np.eye(3) + self.rng.normal(0, 2e-3, (3, 3))
        read = matrix @ load + self.rng.normal(0, 5e-3, (3, 1)) + added
        return self.of(read + self.rng.normal(0, ROW_G, load.shape), order)

    def of(self, read: Array, order: Array | None = None) -> Diagnosis:
        """Of readings (3, N)."""
        at = self.pose if order is None else order[self.pose]
        columns = {f"a{axis}_g": read[k] for k, axis in enumerate("xyz")}
        columns |= {"t_s": self.t_s, "temp_c": self.temp, "pose": self.pose * 1.0}
        return diagnose({**columns, "inc_ref_deg": self.inc[at], "tf_ref_deg": self.tf[at]}, MODEL)


def exchanged(bench: Bench, size: float) -> bool:
    """Two poses, `size` deg apart, of which each was written down as the other."""
    one, other = bench.rng.choice(bench.inc.size, 2, replace=False)
    way = bench.rng.uniform(0, np.pi)
    bench.inc[other] = np.clip(bench.inc[one] + size * np.cos(way), 3, 175)
    bench.tf[other] = bench.tf[one] + size * np.sin(way) / max(np.sin(np.radians(bench.inc[one])), 0.2)
    order = np.arange(bench.inc.size)
    order[[one, other]] = other, one
    made = bench.diagnosed(bench.load(), order=order)
    said = [f.remedy for f in made.intake if f.check == "exchanged_poses"]
    low, high = sorted((int(one), int(other)))
    right = len(said) == 1 and said[0].startswith(f"poses {low} and {high} ")
    return right and made.verdict == "nothing_left_out"


def tone(bench: Bench, size: float) -> bool:
    """An oscillation on all channels of `size` g."""
    period = float(np.exp(bench.rng.uniform(np.log(60), np.log(400))))
    phase = bench.rng.uniform(0, 2 * np.pi, (3, 1))
    made = bench.diagnosed(bench.load(), size * np.sin(2 * np.pi * bench.t_s / period + phase))
    if [(claim.place, claim.depends_on) for claim in made.claims] != [("offset", ("time",))]:
        return False
    (axis,) = Law.from_dict(made.claims[0].law or {}).axes
    return axis.functions[0].kind == "sine" and abs(axis.functions[0].numbers[0] / period - 1) < 0.01


def jump(bench: Bench, size: float) -> bool:
    """One row off by `size` g, and a scale factor that follows the temperature."""
    load, axis = bench.load(), int(bench.rng.integers(3))
    added = np.zeros_like(load)
    warm = (bench.temp - bench.temp.min()) / np.ptp(bench.temp)
    added[axis] = 5e-4 * load[axis] * np.tanh(4 * (warm - 0.5))
    added[axis, bench.rng.integers(load.shape[1])] += size
    made = bench.diagnosed(load, added)
    return any(_holds(claim.equivalence_class, claim.effect, "scale", "temp") for claim in made.claims)


def zero(bench: Bench, size: float) -> bool:
    """The toolface that is written down is `size` deg off from some pose on."""
    begun = np.arange(bench.tf.size) >= bench.rng.integers(bench.tf.size // 3, 2 * bench.tf.size // 3)
    made = bench.diagnosed(bench.load(bench.tf + size * begun))
    if not made.claims:
        return made.verdict != "nothing_left_out"
    return any(_holds(claim.equivalence_class, claim.effect, "toolface", "time") for claim in made.claims)


def lash(bench: Bench, size: float) -> bool:
    """A play of the toolface of `size` deg, the side not written down."""
    side = np.sign(np.diff(bench.tf, prepend=bench.tf[:1] - 1.0))
    made = bench.diagnosed(bench.load(bench.tf - size * side))
    names = {claim.effect for claim in made.claims if claim.law is None}
    return names <= {"backlash", "stiction"} and made.verdict != "nothing_left_out"


def spans(bench: Bench, size: float) -> bool:
    """Four neighbouring poses in m/s2."""
    first = int(bench.rng.integers(bench.inc.size - 4))
    load = bench.load()
    read = load + bench.rng.normal(0, 5e-3, (3, 1)) + bench.rng.normal(0, ROW_G, load.shape)
    made = bench.of(np.where((bench.pose >= first) & (bench.pose < first + 4), 9.80665 * read, read))
    named = f"poses {first}, {first + 1}, {first + 2}, {first + 3} "
    return made.verdict == "bad_data" and any(finding.remedy.startswith(named) for finding in made.intake)


def _holds(members: tuple[str, ...], own: str, place: str, follows: str) -> bool:
    """Whether a law of a place that follows something is told or in the class."""
    laws = [name for name in (own, *members) if name.startswith(f"law:{place}")]
    return any(follows in name for name in laws) or (follows == "temp" and "temperature_scale" in (own, *members))


KINDS: dict[str, tuple[Callable[[Bench, float], bool], tuple[float, ...]]] = {
    "exchanged": (exchanged, (0.03, 0.3, 3.0, 30.0, 60.0)),
    "tone": (tone, (5e-5, 1e-3, 2e-2)),
    "jump": (jump, (2e-3, 2e-2, 0.2)),
    "zero": (zero, (0.01, 0.1, 1.0, 3.0)),
    "spans": (spans, (0.0,)),
    "lash": (lash, (0.003, 0.08)),
}
"""each with the sizes that are tried"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--kinds", default=",".join(KINDS))
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    wrong: dict[str, list[str]] = defaultdict(list)
    for kind in given.kinds.split(","):
        told, sizes = KINDS[kind]
        for size in sizes:
            seeds = range(given.first_seed, given.first_seed + given.seeds)
            right = [told(Bench.drawn(np.random.default_rng([seed, len(kind)])), size) for seed in seeds]
            wrong[kind] += [f"seed {seed} at {size:g}" for seed, one in zip(seeds, right, strict=True) if not one]
            print(f"{kind:10s} {size:8g}: {sum(right)} of {len(right)} right", flush=True)
    for kind, which in wrong.items():
        if which:
            print(f"{kind}: not right: {'; '.join(which)}")


if __name__ == "__main__":
    main()
