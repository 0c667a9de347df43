"""How often what one published table predicts of the others holds: simulated instruments, tables 1 to 6 of each.

    python -m studies.balance_coverage [INSTRUMENTS [FIRST_SEED [FILE]]] [--workers 0 --parts DIR]
                                                    (6 and 500000; half a minute each, `make evidence` takes 54)

Each instrument of the kind of the balance paper's is drawn at random and known (`drawn_instrument`); the paper's whole
experiment is simulated on it, and a table 1 is written down. What `highside diagnose --summary` finds in that table
predicts the synthetic tables 2 to 6, as `highside reproduce balance` does with the published ones, with 95 % intervals.
Printed: the share of cells within their intervals, by column and in all, and its standard error over instruments
(cells of one instrument are not independent). To FILE is added a line an instrument: by column, how far each cell is
from the middle of its interval, in halves of it on its side; `highside.papers.balance_prediction.WIDENED` comes from
there.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.table.chain import Procedure
from highside.diagnosis.table.explained import explain, prepare
from highside.diagnosis.table.policy import EXPLAINING
from highside.diagnosis.table.posterior import instruments
from highside.papers.balance_prediction import DRAWS, Predictions, predict, run_ensemble
from highside.papers.balance_session import COLUMNS, INCLINATIONS_DEG, METHODS, PaperPlan, cells_of, run_session
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from studies import over_seeds

FREE = ("bias", "scale", "misalignment")
EFFECTS = (
    "base_tilt", "axis_nonorthogonality", "encoder_first_harmonic", "encoder_second_harmonic", "cogging", "wobble",
    "sag", "reference_twist", "quadratic", "cubic", "asymmetry", "cross_product",
)  # fmt: skip
"""What a bench and a sensor may have, of what leaves a trace in such tables."""
SIZES = 1.5
"""Sizes are normal with this many of the library's typical ones as standard deviation."""


def drawn_instrument(seed: int) -> tuple[ForwardModel, float]:
    """An instrument on its bench, and the noise of one reading (g): two to five effects, usual sizes."""
    rng = np.random.default_rng([seed, 1])
    chosen = {"base_tilt", *rng.choice(EFFECTS[1:], int(rng.integers(1, 5)), replace=False).tolist()}
    effects: dict[str, dict[str, float]] = {
        "bias": dict(zip(("b_x", "b_y", "b_z"), rng.normal(0.0, 5e-4, 3).tolist(), strict=True)),
        "scale": dict(zip(("s_x", "s_y", "s_z"), rng.normal(0.0, 2e-3, 3).tolist(), strict=True)),
        "misalignment": {
            name: float(rng.normal(0.0, 2e-3)) for name in ("m_xy", "m_xz", "m_yx", "m_yz", "m_zx", "m_zy")
        },
        "pose_error": {
            "inc_station": EXPLAINING.step_rad,
            "tf_station": EXPLAINING.step_rad,
            "inc_pose": 0.0,
            "tf_pose": 0.0,
        },
    }
    for name in sorted(chosen):
        own = all_effects()[name].parameters
        effects[name] = {p.name: float(rng.normal(0.0, SIZES * p.typical)) for p in own if not p.shape}
        # of a cross product one axis, as a pendulous sensor has it
        if name == "cross_product":
            axis = rng.choice(["x", "y", "z"])
            effects[name] = {n: v for n, v in effects[name].items() if n.startswith(f"k_{axis}_")}
        if name == "wobble":
            effects[name]["k"] = float(rng.integers(1, 4))
        if name == "cogging":
            effects[name]["k"] = float(rng.integers(3, 8))
    return ForwardModel.of(effects), float(40e-6 * np.exp(0.4 * rng.standard_normal()))


def tables_of(cells: NDArray[np.float64]) -> dict[str, list[dict[str, Any]]]:
    """Tables 1 to 6 from the cells (6, 11, 4) of one run, written with the digits of the published ones."""

    def row(method: str, inc_deg: float, **what: Any) -> dict[str, Any]:
        own = cells[METHODS.index(method), INCLINATIONS_DEG.index(inc_deg)]
        return {**what, **{name: round(float(v), 7) for name, v in zip(COLUMNS, own, strict=True)}}

    return {
        "table1": [row("conventional", i, inc_ref_deg=i) for i in INCLINATIONS_DEG],
        "table2": [row("1-2-3", i, correction="balance 1-2-3", inc_ref_deg=i) for i in (3.006, 1.998, 1.206, 0.612)],
        "table3": [
            row("2-3-4", i, correction="balance 1st quadrant", inc_ref_deg=i) for i in (90.0, 75.006, 45.0, 14.994)
        ],
        "table4": [row(t, 1.206, triple=t) for t in METHODS[1:5]],
        "table5": [row(t, 0.612, triple=t) for t in METHODS[1:5]],
        "table6": [row("average", i, inc_ref_deg=i) for i in INCLINATIONS_DEG],
    }


def one(seed: int) -> tuple[Predictions, tuple[str, ...], tuple[str, ...]]:
    """Predictions of the tables of one instrument, the effects it has and those found in its table 1."""
    model, noise_g = drawn_instrument(seed)
    session = run_session(PaperPlan.of_the_paper(), model, noise_g, np.random.default_rng([seed, 2]))
    tables = tables_of(cells_of(session.errors_deg()))
    inc = np.array([row["inc_ref_deg"] for row in tables["table1"]])
    reported = np.array([[row[name] for name in COLUMNS] for row in tables["table1"]])
    problem = prepare(inc, reported, Procedure("conventional3"), ForwardModel.of({}), FREE, None, 1)
    explained = explain(problem, lambda share, words: None)
    ensemble = run_ensemble(instruments(explained, DRAWS, 1).draws, 2)
    has = tuple(sorted(set(model.ids) - {"bias", "scale", "misalignment", "pose_error"}))
    return predict(ensemble, tables), has, tuple(sorted(explained.best.effects))


def departures(predictions: Predictions) -> dict[str, list[float]]:
    """How far each counted cell is from the middle, as a share of that side of its interval."""
    found: dict[str, list[float]] = {column: [] for column in COLUMNS}
    for cell in predictions.cells:
        if cell.counts:
            assert cell.published is not None and cell.predicted is not None
            assert cell.low is not None and cell.high is not None
            off = cell.published - cell.predicted
            side = cell.high - cell.predicted if off > 0 else cell.predicted - cell.low
            found[cell.column].append(abs(off) / side)
    return found


def one_instrument(seed: int) -> dict[str, Any]:
    """Of one instrument: by column and in all how many cells are within their intervals and of how many; signs right
    and known; departures; the effects it has and those found; how long it took."""
    start = time.perf_counter()
    predictions, has, found = one(seed)
    known = [c.sign for c in predictions.cells if c.counts and c.sign is not None]
    return {
        "columns": {column: [tally.covered, tally.of] for column, tally in predictions.by_column().items()},
        "overall": [predictions.overall.covered, predictions.overall.of],
        "signs": [sum(known), len(known)],
        "departures": departures(predictions),
        "has": has,
        "found": found,
        "seconds": time.perf_counter() - start,
    }


def main(count: int, first: int, file: Path | None, over: over_seeds.Over) -> None:
    """Print the coverage."""
    shares = {column: np.zeros((count, 2)) for column in COLUMNS}
    signs = np.zeros(2, dtype=int)
    for k, own in enumerate(over(one_instrument, [(first + k,) for k in range(count)])):
        for column, tally in own["columns"].items():
            shares[column][k] = tally
        signs += np.array(own["signs"])
        if file is not None:
            with file.open("a") as lines:
                lines.write(json.dumps({"seed": first + k, **own["departures"]}) + "\n")
        covered, of = own["overall"]
        print(
            f"{first + k}: {covered} of {of}; has {', '.join(own['has'])}; table 1 shows {', '.join(own['found'])}; "
            f"{own['seconds']:.0f} s",
            flush=True,
        )
    print(f"{count} instruments, 95 % intervals:")
    total = sum(shares.values(), np.zeros((count, 2)))
    for name, pairs in (*shares.items(), ("all", total)):
        ratio = pairs[:, 0] / pairs[:, 1]
        share = pairs[:, 0].sum() / pairs[:, 1].sum()
        error = ratio.std(ddof=1) / np.sqrt(count)
        print(f"  {name}: {100 * share:.1f} % +- {100 * error:.1f} of {pairs[:, 1].sum():.0f}")
    print(f"  signs that the interval settles: {signs[0]} of {signs[1]} right")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("instruments", type=int, nargs="?", default=6)
    parser.add_argument("first_seed", type=int, nargs="?", default=500_000)
    parser.add_argument("file", type=Path, nargs="?")
    over_seeds.add_options(parser)
    options = parser.parse_args()
    main(options.instruments, options.first_seed, options.file, over_seeds.chosen(options, seconds=30.0))
