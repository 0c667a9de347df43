"""What `rotation fit --method auto` tells of rotations that hold noise alone: orders that are none.

    python -m studies.rotation_noise [--seeds 100] [--first-seed 7000] [--noise ar ...] [--fewest-turns 1]

Prints a line a cell: kind of noise, motion, turns and rows a turn; of how many recordings an order was told or taken
beyond the usual range, how many were given any order at all, and in how many the error was found to differ by the
direction of rotation (where direction and time do not run together). White noise is what the stated chance is of
(`rotation.unfitted_orders`); the other kinds are what the rows of a rotation may have instead.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from highside.rotation.curve import CurveMethod
from highside.rotation.direction import direction_difference
from highside.rotation.fit import fit
from highside.rotation.samples import Samples

Array = NDArray[np.float64]
SIZE = 0.002
"""of a row, arcmin: that of a good encoder"""
TURNS, ROWS = (1, 4, 12), (120, 360)
TOLD = ("an error of order", "was taken, beyond")
"""in a remark that says that there is an order"""


def _steady(turns: int, rows: int, rng: np.random.Generator) -> Array:
    return np.asarray(np.arange(turns * rows) * (2 * np.pi / rows))


def _there_and_back(turns: int, rows: int, rng: np.random.Generator) -> Array:
    steps = np.where(np.arange(turns * rows) < turns // 2 * rows, 1.0, -1.0)
    return np.asarray(np.cumsum(steps) * (2 * np.pi / rows))


def _alternating(turns: int, rows: int, rng: np.random.Generator) -> Array:
    steps = np.where(np.arange(turns * rows) // (2 * rows) % 2 == 0, 1.0, -1.0)
    return np.asarray(np.cumsum(steps) * (2 * np.pi / rows))


def _uneven(turns: int, rows: int, rng: np.random.Generator) -> Array:
    rate = 1 + 0.3 * np.sin(np.arange(turns * rows) * 2 * np.pi / (1.7 * rows))
    return np.asarray(np.cumsum(rate) * (2 * np.pi / rows))


def _several_rates(turns: int, rows: int, rng: np.random.Generator) -> Array:
    counts = (rows / rng.uniform(0.5, 2.0, turns)).astype(int)
    return np.concatenate([2 * np.pi * (k + np.arange(n) / n) for k, n in enumerate(counts)])


def _jittered(turns: int, rows: int, rng: np.random.Generator) -> Array:
    return _steady(turns, rows, rng) + rng.normal(0.0, 0.3 * 2 * np.pi / rows, turns * rows)


MOTIONS: dict[str, Callable[[int, int, np.random.Generator], Array]] = {
    "steady": _steady,
    "there and back": _there_and_back,
    "alternating": _alternating,
    "uneven": _uneven,
    "several rates": _several_rates,
    "jittered": _jittered,
}
NOISES: dict[str, Callable[[Array, np.random.Generator], Array]] = {
    "white": lambda white, rng: white,
    "ar": lambda white, rng: np.asarray(lfilter([0.4], [1.0, -0.9], white)),
    "walk": lambda white, rng: 0.03 * np.cumsum(white) + white,
    "heavy tails": lambda white, rng: SIZE * rng.standard_t(3, white.size),
    "quantised": lambda white, rng: 1.5 * SIZE * np.round(white / (1.5 * SIZE)),
}


def cell(noise: str, motion: str, turns: int, rows: int, seeds: range) -> tuple[int, int, int]:
    """Recordings in which an order was told or taken beyond the usual range, those that were given any order, and those
    in which the direction was found to matter."""
    told = given = differ = 0
    for seed in seeds:
        rng = np.random.default_rng([seed, turns, rows])
        theta = MOTIONS[motion](turns, rows, rng)
        error = NOISES[noise](rng.normal(0.0, SIZE, theta.size), rng)
        samples = Samples.build(theta, error)
        curve = fit(samples, CurveMethod.AUTO, held_out=False)
        told += any(words in remark for remark in curve.remarks for words in TOLD)
        given += curve.order > 0
        difference = direction_difference(samples, curve)
        differ += difference is not None and difference.found and not difference.with_time
    return told, given, differ


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=7000)
    parser.add_argument("--noise", nargs="*", choices=list(NOISES), default=list(NOISES))
    parser.add_argument("--fewest-turns", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for noise in arguments.noise:
        of = all_told = 0
        for motion, turns, rows in itertools.product(MOTIONS, TURNS, ROWS):
            if turns < max(arguments.fewest_turns, 4 if motion in ("there and back", "alternating") else 1):
                continue
            told, given, differ = cell(noise, motion, turns, rows, seeds)
            of, all_told = of + len(seeds), all_told + told
            kind = f"{noise}, {motion}, {turns} turns of {rows}"
            print(f"{kind}: told {told}, any order {given}, direction {differ} of {len(seeds)}", flush=True)
        print(f"{noise}: {all_told} of {of} told", flush=True)


if __name__ == "__main__":
    main()
