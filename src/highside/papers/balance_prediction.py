"""What table 1 of the balance paper predicts of its other tables and figures, cell by cell with intervals.

One instrument is found, from table 1 alone (`highside.diagnosis.table.engine`). What table 1 leaves open of it is kept
as draws: other sets of effects that explain the table as well, their sizes and signs, effects too small to show in it,
the noise of a reading (`highside.diagnosis.table.posterior`). The whole experiment is run once on each draw, with
chance of its own, so that a predicted cell is a distribution: its middle, and the interval that holds 95 % of it,
widened by half of the last published digit and by what simulated instruments show to be missing (`WIDENED`). Tables 2
to 6 take no part in any of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.balance import TRIPLES
from highside.diagnosis.table.posterior import Drawn
from highside.papers.balance_session import COLUMNS, INCLINATIONS_DEG, METHODS, PaperPlan, cells_of, run_session

LEVEL = 0.95
DRAWS = 300
WIDENED_MEANS = 1.4
WIDENED = {
    "d_inc_mean_deg": WIDENED_MEANS,
    "d_inc_pp_deg": 1.6,
    "d_tf_mean_deg": WIDENED_MEANS,
    "d_tf_pp_deg": 2.3,
}
"""By how much the ends of an interval are moved away from its middle: what the search overlooks is not in the draws. A
peak-to-peak is noise and pattern in one, so all those of an instrument go wrong together where an effect that is not
named is made up by noise; a mean is spared that. Of the means set on 14 simulated instruments of
`studies/balance_coverage.py`, of the peak-to-peaks the 95 % quantile over 58 of them; what is stated of these is of
instruments that their width was not set on (each in turn omitted)."""
ROUNDING_DEG = 0.5e-7
"""half of the last digit of the published tables"""
AGREES_P = 0.05
"""A column is called predicted unless as few covered cells, or fewer, have less than this probability at `LEVEL`."""
TRIPLE_AT = {"table4": 1.206, "table5": 0.612}
HORIZONTAL_DEG = 90.0
"""Balance has no meaning there: its inclination is zero by construction, and nothing is predicted of it."""

Rows = Mapping[str, Sequence[Mapping[str, Any]]]


@dataclass(frozen=True)
class Ensemble:
    """The experiment on each of K instruments: `cells` (K, 6, 11, 4) in deg by method, inclination and column, and the
    mean of each station's readings over the turns, `inc` and `tf` (K, 6, 11, 73) in deg."""

    cells: Array
    inc: NDArray[np.float32]
    tf: NDArray[np.float32]

    def of(self, methods: Sequence[str], inc_deg: float) -> Array:
        """(K', 4) cells of a method at an inclination; of several, any of them with equal chance."""
        row = INCLINATIONS_DEG.index(inc_deg)
        return np.concatenate([self.cells[:, METHODS.index(m), row] for m in methods])

    def turn(self, method: str, inc_deg: float) -> tuple[Array, Array]:
        """Errors (K, 73) of I and T over a turn."""
        at = METHODS.index(method), INCLINATIONS_DEG.index(inc_deg)
        return np.asarray(self.inc[:, at[0], at[1]]), np.asarray(self.tf[:, at[0], at[1]])


def run_ensemble(draws: Sequence[Drawn], seed: int) -> Ensemble:
    """Run the experiment on each draw. The same seed gives the same numbers."""
    plan = PaperPlan.of_the_paper()
    cells, inc, tf = [], [], []
    for k, drawn in enumerate(draws):
        session = run_session(plan, drawn.model, drawn.noise_g, np.random.default_rng([seed, k]), drawn.own_g)
        errors = session.errors_deg()
        cells.append(cells_of(errors))
        inc.append(errors[0].mean(axis=-1).astype(np.float32))
        tf.append(errors[1].mean(axis=-1).astype(np.float32))
    return Ensemble(np.stack(cells), np.stack(inc), np.stack(tf))


def interval(values: Array, level: float = LEVEL, widened: float | Array = WIDENED_MEANS) -> tuple[Array, Array, Array]:
    """Low end, middle and high end over the first axis; `widened` one number, or one of each column of the values."""
    low, middle, high = (
        np.asarray(ends) for ends in np.quantile(values, [(1 - level) / 2, 0.5, (1 + level) / 2], axis=0)
    )
    return middle - widened * (middle - low), middle, middle + widened * (high - middle)


@dataclass(frozen=True)
class Cell:
    """One published figure beside what table 1 predicts of it, deg."""

    table: str
    correction: str
    inc_ref_deg: float
    column: str
    published: float | None
    """None where the source has lost it"""
    predicted: float | None
    low: float | None
    high: float | None
    held_out: bool
    """False for what the instrument was found from: table 1, and the conventional rows of tables 2 and 3"""
    repeated: bool
    """The same figure stands in an earlier table: it counts once"""

    @property
    def covered(self) -> bool | None:
        """Whether the published figure is in the interval; None where one of them is missing."""
        if self.published is None or self.low is None or self.high is None:
            return None
        return self.low <= self.published <= self.high

    @property
    def counts(self) -> bool:
        """Whether it is a test of the prediction."""
        return self.held_out and not self.repeated and self.covered is not None

    @property
    def sign(self) -> bool | None:
        """Whether the sign is predicted: True right, False wrong, None where the interval holds both."""
        if self.published is None or self.low is None or self.high is None or self.low < 0 < self.high:
            return None
        return bool(np.sign(self.published) == np.sign(self.low + self.high))

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "table": self.table,
            "correction": self.correction,
            "inc_ref_deg": self.inc_ref_deg,
            "column": self.column,
            "published": self.published,
            "predicted": self.predicted,
            "low": self.low,
            "high": self.high,
            "covered": self.covered,
            "held_out": self.held_out,
            "repeated": self.repeated,
        }


@dataclass(frozen=True)
class Count:
    """How many cells of a table and column are covered, of how many."""

    table: str
    column: str
    covered: int
    of: int

    @property
    def verdict(self) -> str:
        """In words: "predicted", "predicted in part", "not predicted", or that nothing was there to predict."""
        from scipy.stats import binom

        if not self.of:
            return "nothing to predict"
        if binom.cdf(self.covered, self.of, LEVEL) >= AGREES_P:
            return "predicted"
        return "predicted in part" if 2 * self.covered >= self.of else "not predicted"


@dataclass(frozen=True)
class Predictions:
    """All cells of tables 1 to 6."""

    cells: tuple[Cell, ...]

    @cached_property
    def counts(self) -> tuple[Count, ...]:
        """By table and column, of the tables that are predicted (2 to 6)."""
        found = []
        for table in dict.fromkeys(cell.table for cell in self.cells if cell.held_out):
            for column in COLUMNS:
                own = [c for c in self.cells if c.table == table and c.column == column and c.held_out]
                there = [c for c in own if c.covered is not None]
                found.append(Count(table, column, sum(bool(c.covered) for c in there), len(there)))
        return tuple(found)

    @property
    def overall(self) -> Count:
        """All held-out cells, each once."""
        counted = [c for c in self.cells if c.counts]
        return Count("2 to 6", "all", sum(bool(c.covered) for c in counted), len(counted))

    def by_column(self) -> dict[str, Count]:
        """All held-out cells of each column, each once."""
        found = {}
        for column in COLUMNS:
            counted = [c for c in self.cells if c.counts and c.column == column]
            found[column] = Count("2 to 6", column, sum(bool(c.covered) for c in counted), len(counted))
        return found


def predict(ensemble: Ensemble, published: Rows) -> Predictions:
    """Every published cell of tables 1 to 6 beside its prediction."""
    cells: list[Cell] = []
    earlier: set[tuple[str, float, str]] = set()
    for table in sorted(published):
        for row in published[table]:
            inc_deg = row.get("inc_ref_deg", TRIPLE_AT.get(table, 0.0))
            label, methods = methods_of(table, row)
            low, middle, high = interval(ensemble.of(methods, inc_deg), widened=np.array([WIDENED[c] for c in COLUMNS]))
            # no peak-to-peak is negative, however wide its interval
            low = np.where([column.endswith("_pp_deg") for column in COLUMNS], np.maximum(low, 0.0), low)
            refused = label != "conventional" and inc_deg == HORIZONTAL_DEG
            for c, column in enumerate(COLUMNS):
                key = (label, inc_deg, column)
                cells.append(
                    Cell(
                        table,
                        label,
                        inc_deg,
                        column,
                        row[column],
                        predicted=None if refused else float(middle[c]),
                        low=None if refused else float(low[c]) - ROUNDING_DEG,
                        high=None if refused else float(high[c]) + ROUNDING_DEG,
                        held_out=label != "conventional",
                        repeated=key in earlier,
                    )
                )
                if row[column] is not None:
                    earlier.add(key)
    return Predictions(tuple(cells))


def methods_of(table: str, row: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """What a published row was corrected by: its name, and the methods that it may stand for.

    The text does not say which poses the "first-quadrant balance" of table 3 takes: any of the four triples.
    """
    if "triple" in row:
        return str(row["triple"]), (str(row["triple"]),)
    if "correction" not in row:
        name = "conventional" if table == "table1" else "average"
        return name, (name,)
    name = str(row["correction"])
    if name == "conventional":
        return name, (name,)
    name = name.removeprefix("balance ")
    return (name, (name,)) if name in TRIPLES else (name, tuple(TRIPLES))
