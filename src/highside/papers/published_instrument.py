"""The instrument behind the balance paper's tables, found from its table 1 alone, and what that predicts of the rest.

Table 1 (after the three-pose correction) is diagnosed as `highside diagnose --summary` does it, without a model: one
instrument is found. What table 1 leaves open of it stays open (`highside.diagnosis.table.posterior`), and tables 2 to
6 and all figures are predicted with intervals (`highside.papers.balance_prediction`). They take no part in the fit.

The published numbers are facts of that paper, kept in `published_balance.json`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from highside.config.model import Model
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.table.chain import CELLS, Procedure
from highside.diagnosis.table.engine import Summarised, diagnose_summary
from highside.diagnosis.table.posterior import Posterior, instruments
from highside.papers.balance_prediction import (
    DRAWS,
    LEVEL,
    Ensemble,
    Predictions,
    Rows,
    interval,
    predict,
    run_ensemble,
)
from highside.papers.balance_triples import TripleEvidence, evidence
from highside.reading import parse_json
from highside.report.diagnosis_figures import table_misfit
from highside.report.diagnosis_words import proof, sizes, sureness
from highside.report.document import Page
from highside.version import __version__

SIMULATED = {
    "instruments": 58,
    "cells": 5336,
    "covered_percent": 95.1,
    "std_error_percent": 1.5,
    "covered_percent_by_column": {
        "d_inc_mean_deg": 94.5,
        "d_inc_pp_deg": 94.8,
        "d_tf_mean_deg": 96.3,
        "d_tf_pp_deg": 94.7,
    },
    "covered_percent_as_drawn": 85.2,
}
"""The same computed for simulated instruments that are known: share of their cells within the intervals (those of
peak-to-peaks as widened by the other instruments, each in turn omitted), and within those of the draws before they are
widened. Of `studies/balance_coverage.py`."""


@dataclass(frozen=True)
class PublishedInstrument:
    """What table 1 says of the instrument, draws of what it leaves open, and the other tables predicted."""

    found: Summarised
    posterior: Posterior
    ensemble: Ensemble
    predictions: Predictions
    triples: TripleEvidence


@cache
def published() -> dict[str, list[dict[str, Any]]]:
    """The published tables 1 to 6: rows as {column: value}, None where the source has lost a cell."""
    data = parse_json(resources.files("highside.papers").joinpath("published_balance.json").read_bytes())
    return {name: [dict(zip(t["columns"], row, strict=True)) for row in t["rows"]] for name, t in data.items()}


def find(
    tables: Rows, *, seed: int = 1, draws: int = DRAWS, progress: Callable[[float, str], None] | None = None
) -> PublishedInstrument:
    """Diagnose table 1 and predict the others. The same seed gives the same answer."""
    found, posterior, ensemble = from_table_1(tables["table1"], seed=seed, draws=draws, progress=progress)
    return PublishedInstrument(found, posterior, ensemble, predict(ensemble, tables), evidence(tables, ensemble))


def from_table_1(
    rows: Sequence[Mapping[str, Any]],
    *,
    seed: int = 1,
    draws: int = DRAWS,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Summarised, Posterior, Ensemble]:
    """The instrument, what table 1 leaves open of it, and the experiment on that: from the rows of table 1 alone."""
    report = progress or (lambda share, words: None)
    knows = Model()
    inc = np.array([row["inc_ref_deg"] for row in rows], dtype=float)
    printed = np.array([[np.nan if row[c] is None else float(row[c]) for c in CELLS] for row in rows])
    found = diagnose_summary(
        inc,
        printed,
        Procedure("conventional3"),
        knows.forward(),
        knows.sensor.free,
        seed=seed,
        version=__version__,
        progress=lambda share, words: report(0.6 * share, words),
    )
    posterior = instruments(
        found.explained, draws, seed, progress=lambda share, words: report(0.6 + 0.3 * share, words)
    )
    report(0.9, "tables 2 to 6 of what table 1 allows")
    return found, posterior, run_ensemble(posterior.draws, seed + 100)


def allowed(instrument: PublishedInstrument) -> list[dict[str, Any]]:
    """Each parameter of an effect that some draw has: share of the draws with it, and its interval among those."""
    effects = dict.fromkeys(name for e in instrument.posterior.explanations for name in e.effects)
    rows: list[dict[str, Any]] = []
    for effect in ("bias", *effects):
        own = [d.model.parameters()[effect] for d in instrument.posterior.draws if effect in d.model.ids]
        for name in own[0] if own else ():
            low, middle, high = interval(np.array([p[name] for p in own]), widened=1.0)
            if low == high == 0.0:
                continue
            share = len(own) / len(instrument.posterior.draws)
            ends = {"low": float(low), "middle": float(middle), "high": float(high)}
            rows.append({"effect": effect, "parameter": name, "share": share, **ends})
    return rows


def as_dict(instrument: PublishedInstrument) -> dict[str, Any]:
    """Plain values for JSON."""
    found, posterior, predictions = instrument.found, instrument.posterior, instrument.predictions
    noise = interval(np.array([d.noise_g for d in posterior.draws]), widened=1.0)
    counted = predictions.overall
    return {
        "instrument": {
            "found_from": "table 1",
            "diagnosis": found.diagnosis.to_dict(),
            "named": found.named.parameters(),
            "with_all_that_helps": found.whole.parameters(),
            "noise_g": found.noise_g,
            "explanations": [
                {"effects": list(e.effects), "probability": e.probability} for e in posterior.explanations
            ],
            "allowed": allowed(instrument),
            "allowed_noise_g": dict(zip(("low", "middle", "high"), map(float, noise), strict=True)),
            "draws": len(posterior.draws),
            "effective_draws": posterior.effective,
        },
        "coverage": {
            "level": LEVEL,
            "covered": counted.covered,
            "of": counted.of,
            "expected": LEVEL * counted.of,
            "by_column": {c: {"covered": n.covered, "of": n.of} for c, n in predictions.by_column().items()},
            "by_table": [
                {"table": n.table, "column": n.column, "covered": n.covered, "of": n.of, "verdict": n.verdict}
                for n in predictions.counts
            ],
            "simulated": SIMULATED,
        },
        "triples": instrument.triples.as_dict(),
    }


def in_words(instrument: PublishedInstrument) -> list[str]:
    """What table 1 says of the instrument, every figure from the numbers."""
    diagnosis = instrument.found.diagnosis
    lines = [f"Table 1: {diagnosis.verdict}."]
    lines += [f"{c.effect}: {sizes(c)}. {sureness(c)} Next: {c.next_manoeuvre}." for c in diagnosis.claims]
    if diagnosis.fit is not None:
        lines.append(proof(diagnosis.fit))
    lines += [hint[0].upper() + hint[1:] + "." for hint in diagnosis.remainder.hints]
    shares = [f"{', '.join(e.effects)} {e.probability:.0%}" for e in instrument.posterior.explanations[:5]]
    lines.append("Sets of effects that explain table 1, by probability: " + "; ".join(shares) + ".")
    return lines


def coverage_in_words(instrument: PublishedInstrument) -> str:
    """How much of tables 2 to 6 is predicted, beside what is expected and what simulated instruments gave."""
    count = instrument.predictions.overall
    by = ", ".join(
        f"{TITLES[column]} {n.covered} of {n.of}" for column, n in instrument.predictions.by_column().items()
    )
    share = f"{SIMULATED['covered_percent']:.1f} +- {SIMULATED['std_error_percent']:.1f} %"
    return (
        f"{count.covered} of {count.of} cells of tables 2 to 6 ({count.covered / count.of:.0%}) are within the "
        f"interval that table 1 gives them; {LEVEL:.0%} are expected. {by[0].upper()}{by[1:]}. "
        f"Of {SIMULATED['instruments']} simulated instruments treated the same way {share} of the cells were."
    )


def outside_in_words(instrument: PublishedInstrument) -> list[str]:
    """Which cells are not predicted, and what follows; and what no interval says."""
    counted = [c for c in instrument.predictions.cells if c.counts]
    out = [c for c in counted if not c.covered]
    triples = [c for c in out if c.correction != "average"]
    lines = []
    if triples:
        names = ", ".join(f"{TITLES[c.column]} of {c.correction} at {c.inc_ref_deg:g} deg" for c in triples)
        lines.append(f"Not predicted of single triples: {names}. All of these are closures; see below.")
    lines += [
        f"Not predicted of the average: {TITLES[c.column]} at {c.inc_ref_deg:g} deg, {c.published:+.4f} deg "
        f"({c.low:+.4f} to {c.high:+.4f}). A balance matrix absorbs whatever its four poses have in common, so its "
        "means are noise unless something moved between those poses and the turn."
        for c in out
        if c.correction == "average"
    ]
    means = [c for c in counted if "mean" in c.column]
    settled = [c for c in means if c.sign is not None]
    lines.append(
        f"Signs: the interval of {len(settled)} of {len(means)} means leaves one sign only"
        + (
            f", {sum(bool(c.sign) for c in settled)} of them the right one."
            if settled
            else "; table 1 says how large the means after balance are, not which way they go."
        )
    )
    return lines


TITLES = {
    "d_inc_mean_deg": "mean I",
    "d_inc_pp_deg": "p-p I",
    "d_tf_mean_deg": "mean T",
    "d_tf_pp_deg": "p-p T",
}


def verdicts(instrument: PublishedInstrument) -> list[list[str]]:
    """Rows (table, and each column in words)."""
    rows: dict[str, list[str]] = {}
    for n in instrument.predictions.counts:
        words = n.verdict if not n.of else f"{n.verdict}: {n.covered} of {n.of}"
        rows.setdefault(n.table, []).append(words)
    return [[f"Table {table[-1]}", *words] for table, words in rows.items()]


def add_to(page: Page, instrument: PublishedInstrument) -> None:
    """The section of a page on table 1; drawn within `plotting`."""
    diagnosis: DiagnosisResult = instrument.found.diagnosis
    page.heading("The published instrument, from table 1 alone")
    page.paragraph(
        "Table 1 diagnosed as if it were a recording (highside diagnose --summary, --corrected-by conventional3): the "
        "whole chain is simulated, the correction's own three poses on the same bench, and effects of the library are "
        "fitted to its 44 cells."
    )
    page.bullets(in_words(instrument))
    page.figure(
        table_misfit(instrument.found.report_data, diagnosis.location),
        "Table 1: misfit of each cell in sigma before (orange) and after (blue) what was found is simulated; rows "
        "shaded where a named effect acts.",
    )
    body = [
        [r["effect"], r["parameter"], f"{r['share']:.0%}", *(f"{r[k]:.3g}" for k in ("low", "middle", "high"))]
        for r in allowed(instrument)
    ]
    low, middle, high = interval(np.array([d.noise_g for d in instrument.posterior.draws]), widened=1.0)
    page.table(
        ["effect", "parameter", "there in", "from", "middle", "to"],
        body,
        "What table 1 allows: in how many of the draws an effect is there, and where 95 % of its values lie in those. "
        f"Angles in rad, sensor terms in g; the noise of a reading is {low * 1e6:.0f} to {high * 1e6:.0f} ug, middle "
        f"{middle * 1e6:.0f}.",
        words=(1,),
    )
