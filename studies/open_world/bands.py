"""How often the band of a law holds what is true of it, where its quantity was read and where nothing was.

    python -m studies.open_world.score --seed H --groups law --design poses --keep DIR --out OUT
    python -m studies.open_world.bands H=DIR [H=DIR ...]

Of the cases of seed H kept in DIR those of one law of one quantity that acts all the time, told in its place and of its
quantity. Law and truth are compared off what the base takes of either: a constant, and of a load what is straight in
it. A point of the curve is far from any reading where that is a twentieth of the range and more away.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import laws
from .answers import Case
from .score import every_case

FAR = 0.05
PLACES = ("offset", "scale", "matrix")
UNSUITABLE = ("tf", "time", "time_since_move")
"""an angle comes round, a time begins anew"""


@dataclass(frozen=True)
class Held:
    """One law: how far the truth is from it, in units of its standard deviation, at each point of its curve."""

    name: str
    formula: bool
    off: np.ndarray
    far: np.ndarray
    """whether nothing was read near the point"""


def held(name: str, case: Case, answer: dict[str, Any]) -> Held | None:
    """What the band of a right law holds; None of a case without one."""
    if len(case.laws) != 1 or case.first is None:
        return None
    (law,) = case.laws
    (quantity, *more) = law.covariates
    if more or law.onset_s is not None or law.place not in PLACES or quantity in UNSUITABLE:
        return None
    told = [c for c in answer["claims"] if (c.get("place"), c.get("depends_on")) == (law.place, [quantity])]
    if not told or told[0]["curve"] is None:
        return None
    curve, channel = told[0]["curve"], "xyz".index(told[0]["law"]["channels"][0][0])
    grid, value, std = (np.array(curve[key]) for key in ("grid", "value", "std"))
    # the product tells inclinations in degrees
    unit = np.pi / 180.0 if quantity == "inc" else 1.0
    low, high = law.ranges[0]
    weight = law.weights[channel] if law.place != "matrix" else 1.0
    truth = weight * law.size * law.shape((2.0 * (grid * unit - low) / (high - low) - 1.0)[None])
    rows = laws.covariate(case.first, quantity) / unit
    number = case.first.pose
    read = np.array([rows[number == one].mean() for one in np.unique(number)])
    base = [np.ones(grid.size), *([grid] if quantity.startswith("load") else [])]
    at_read = np.array([np.interp(read, grid, column) for column in (*base, value - truth)])
    taken = np.linalg.lstsq(at_read[:-1].T, at_read[-1], rcond=None)[0]
    far = np.abs(grid[:, None] - read).min(axis=1) > FAR * np.ptp(grid)
    off = (value - truth - taken @ np.array(base)) / np.maximum(std, 1e-300)
    return Held(name, bool(told[0]["law"]["formula"]), off, far)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kept", nargs="+", help="SEED=FOLDER: of the deck, and the folder that `score --keep` filled")
    given = parser.parse_args()
    found = []
    for seed, folder in (one.split("=", 1) for one in given.kept):
        for name, make in sorted(every_case(seed, ("law",)).items()):
            path = Path(folder) / name.replace("/", "_") / "diagnosis.json"
            if path.exists() and (one := held(name, make(), json.loads(path.read_text()))) is not None:
                found.append(one)
                print(
                    f"{name}: {'formula' if one.formula else 'curve'}, at most {np.abs(one.off).max():.2f} deviations"
                )
    for words, formula in (("curves", False), ("formulas", True)):
        for where, far in (("where something was read", False), ("where nothing was", True)):
            points = [one.off[one.far == far] for one in found if one.formula == formula]
            off = np.abs(np.concatenate([*points, np.empty(0)]))
            if off.size:
                rms = float(np.sqrt(np.mean(off**2)))
                print(
                    f"{words}, {where}: {len(points)} laws, {off.size} points, beyond 2 deviations"
                    f" {100 * np.mean(off > 2):.1f} %, beyond 3 {100 * np.mean(off > 3):.1f} %, rms {rms:.3g},"
                    f" at most {off.max():.3g}"
                )


if __name__ == "__main__":
    main()
