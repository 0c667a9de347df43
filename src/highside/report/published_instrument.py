"""The published instrument, diagnosed from its own conventional table, and what that predicts of its balance table.

Table 1 (after the three-pose correction) is diagnosed by `highside.diagnosis.summary`: which physics a linear sensor on
a perfect bench leaves out. Table 6 (after the balance average) is then predicted by the simulated instrument, three
times: refitted without any new physics, with what was given a name, and with everything that helped in table 1. The
fit has not seen table 6.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.result import Diagnosis
from highside.diagnosis.summary import Summarised, diagnose_summary
from highside.diagnosis.summary_chain import CELLS, Procedure
from highside.diagnosis.summary_instrument import Predicted, predict_table
from highside.physics.forward import ForwardModel
from highside.report.diagnosis_figures import AFTER, BEFORE, SHADE, TOLD, table_misfit
from highside.report.diagnosis_words import proof, sizes, sureness
from highside.report.page import Page, new_figure

Array = NDArray[np.float64]

FREE = ("bias", "scale", "misalignment")
CLOSE = 0.25
"""A cell counts as predicted within this share of the published figure, or two sigma (chance and open noise)."""
VERSIONS = {
    "before": "bias alone",
    "named": "with what was named",
    "whole": "with all that helped in table 1",
}
MOST, SOME = 0.8, 0.4


@dataclass(frozen=True)
class Comparison:
    """The diagnosis of table 1, and table 6 (R, 4) beside its predictions by version."""

    found: Summarised
    inc_deg: Array
    published: Array
    predicted: Mapping[str, Predicted]

    def hit(self, version: str) -> NDArray[np.bool_]:
        """(R, 4) cells that a version predicts; where the correction has no meaning none does."""
        said = self.predicted[version]
        error = np.abs(self.published - said.cells)
        return np.asarray(error <= np.maximum(CLOSE * np.abs(self.published), 2 * said.std)) & np.isfinite(said.cells)

    def counts(self, version: str) -> dict[str, tuple[int, int]]:
        """{column: (cells predicted, cells there are)}."""
        usable = np.isfinite(self.predicted[version].cells)
        hit = self.hit(version)
        return {name: (int(hit[:, c].sum()), int(usable[:, c].sum())) for c, name in enumerate(CELLS)}

    def words(self, version: str) -> dict[str, str]:
        """{column: "predicted", "partly" or "not predicted"}."""
        result = {}
        for name, (good, of) in self.counts(version).items():
            share = good / of
            result[name] = "predicted" if share >= MOST else "partly" if share >= SOME else "not predicted"
        return result


def compare(
    table1: list[dict[str, Any]],
    table6: list[dict[str, Any]],
    *,
    seed: int = 1,
    progress: Callable[[float, str], None] | None = None,
) -> Comparison:
    """Diagnose table 1 and predict table 6; rows {column: value} as published. The same seed gives the same answer."""
    inc, told = _columns(table1)
    found = diagnose_summary(
        inc, told, Procedure("conventional3"), ForwardModel.of({}), FREE, seed=seed, progress=progress
    )
    inc6, told6 = _columns(table6)
    models = {"before": found.before, "named": found.named, "whole": found.whole}
    predicted = {
        name: predict_table(
            inc6, Procedure("balance-average"), model, found.noise_g, noise_log_std=found.noise_log_std, seed=seed + 100
        )
        for name, model in models.items()
    }
    return Comparison(found, inc6, told6, predicted)


def _columns(rows: list[dict[str, Any]]) -> tuple[Array, Array]:
    inc = np.array([row["inc_ref_deg"] for row in rows], dtype=float)
    cells = [[np.nan if row[name] is None else float(row[name]) for name in CELLS] for row in rows]
    return inc, np.array(cells)


def as_dict(comparison: Comparison) -> dict[str, Any]:
    """Plain values for JSON."""

    def rows(values: Array) -> list[list[float | None]]:
        return [[None if np.isnan(v) else float(v) for v in row] for row in values]

    return {
        "table1_diagnosis": comparison.found.diagnosis.to_dict(),
        "noise_g": comparison.found.noise_g,
        "table6": {
            "inc_ref_deg": comparison.inc_deg.tolist(),
            "columns": list(CELLS),
            "published": rows(comparison.published),
            "predicted": {
                name: {
                    "cells": rows(said.cells),
                    "std": rows(said.std),
                    "counts": {column: list(pair) for column, pair in comparison.counts(name).items()},
                    "verdict": comparison.words(name),
                }
                for name, said in comparison.predicted.items()
            },
            "counts_as_predicted": f"within {CLOSE:.0%} of the published figure or two sigma"
            " (chance and what is open of the noise)",
        },
    }


def in_words(comparison: Comparison) -> list[str]:
    """The comparison in a few sentences, every figure from the numbers."""
    diagnosis = comparison.found.diagnosis
    lines = [f"Table 1: {diagnosis.verdict}."]
    lines += [f"{c.effect}: {sizes(c)}. {sureness(c)} Next: {c.next_manoeuvre}." for c in diagnosis.claims]
    if diagnosis.fit is not None:
        lines.append(proof(diagnosis.fit))
    lines += [hint[0].upper() + hint[1:] + "." for hint in diagnosis.remainder.hints]
    for name, label in VERSIONS.items():
        counts, verdict = comparison.counts(name), comparison.words(name)
        cells = ", ".join(f"{column} {verdict[column]} ({good} of {of})" for column, (good, of) in counts.items())
        lines.append(f"Table 6, not seen, {label}: {cells}.")
    return lines


def add_to(page: Page, comparison: Comparison) -> None:
    """The section of a page; drawn within `plotting`."""
    diagnosis: Diagnosis = comparison.found.diagnosis
    page.heading("What the published instrument leaves out")
    page.paragraph(
        "The published table 1 diagnosed as if it were a recording: the whole chain is simulated, the correction's own "
        "three poses on the same bench, and effects of the library are fitted to its 44 cells. Table 6 was not used; "
        "the instrument found is put through the balance average and its table is predicted."
    )
    page.bullets(in_words(comparison))
    page.figure(
        table_misfit(comparison.found.picture, diagnosis.location),
        "Table 1: misfit of each cell in sigma before (orange) and after (blue) what was found is simulated; rows "
        "shaded where a named effect acts.",
    )
    _figure(page, comparison)
    headers = ["I"] + [f"{column}, {who}" for column in TOLD.values() for who in ("published", *VERSIONS)]
    body = []
    for r, inc in enumerate(comparison.inc_deg):
        row = [f"{inc:g}"]
        for c in range(4):
            row.append(f"{comparison.published[r, c]:.4f}")
            for name in VERSIONS:
                value = comparison.predicted[name].cells[r, c]
                row.append("refused" if np.isnan(value) else f"{value:.4f}")
        body.append(row)
    page.table(
        headers, body, "Table 6 (deg) beside its predictions: before = " + VERSIONS["before"] + "; named = "
        + VERSIONS["named"] + "; whole = " + VERSIONS["whole"] + ".",
    )  # fmt: skip


def _figure(page: Page, comparison: Comparison) -> None:
    figure, axes = new_figure(2, 2, height=2.6)
    rows = np.argsort(comparison.inc_deg)
    at = np.arange(rows.size)
    colours = {"before": BEFORE, "named": AFTER, "whole": "#3d9a62"}
    for column, axis in enumerate(np.ravel(np.array(axes, dtype=object))):
        axis.plot(at, comparison.published[rows, column], "o", color=SHADE, markersize=4, label="published")
        for name, label in VERSIONS.items():
            axis.plot(at, comparison.predicted[name].cells[rows, column], "-", color=colours[name], label=label)
        axis.set_xticks(at, [f"{value:g}" for value in comparison.inc_deg[rows]], rotation=60)
        axis.set(ylabel="deg", title=TOLD[CELLS[column]])
        if column == 0:
            axis.legend()
    verdict = comparison.words("named")
    words = ", ".join(f"{TOLD[column]}: {verdict[column]}" for column in CELLS)
    page.figure(figure, f"Table 6, which the fit has not seen, beside its predictions. With what was named: {words}.")
