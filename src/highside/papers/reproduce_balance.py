"""The balance paper's tables and statements beside what the instrument found from its table 1 predicts.

Tables 2 to 6 and the figures are predicted with 95 % intervals (`highside.papers.published_instrument`); what is said
of them is computed from the published and the predicted numbers. Only a simulation knows the truth as well, gravity in
the tool frame: errors against it are those of instruments that table 1 allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.calibration.balance import TRIPLES, balance
from highside.calibration.joint import joint
from highside.calibration.remark import Reason
from highside.papers.balance_prediction import WIDENED, Ensemble, interval
from highside.papers.balance_session import (
    COLUMNS,
    INCLINATIONS_DEG,
    METHODS,
    STATIONS_DEG,
    BalanceRun,
    PaperPlan,
    run_session,
)
from highside.papers.published_instrument import PublishedInstrument, published

EXPECTED_RANGE_SIGMAS = 5.74
"""expected peak-to-peak of 292 normal numbers"""
SMALL_DEG = (3.006, 1.998, 1.206, 0.612)
LARGE_DEG = (90.0, 75.006, 45.0, 14.994)
OMITTED = {"1-2-3": 4, "2-3-4": 1, "3-4-1": 2, "4-1-2": 3}
"""the quadrant whose pose a triple does not use"""
TRUTH_DRAWS = 24
"""Draws that the joint estimator is run on: for a middle and a spread."""

Made = Mapping[str, list[dict[str, Any]]]


@dataclass(frozen=True)
class Reproduction:
    """All that the page and the JSON say."""

    instrument: PublishedInstrument
    tables: Made
    ratios: list[dict[str, Any]]
    shares: list[dict[str, Any]]
    omitted: dict[str, list[dict[str, Any]]]
    truth: list[dict[str, Any]]
    refused: list[str]


def reproduce(instrument: PublishedInstrument, seed: int = 7) -> Reproduction:
    """Everything from the one instrument. The same seed gives the same numbers."""
    ensemble = instrument.ensemble
    sessions = _sessions(instrument, seed)
    return Reproduction(
        instrument,
        tables(instrument),
        headline_ratios(ensemble),
        specification_shares(ensemble),
        {f"{i:g}": omitted_quadrants(ensemble, i) for i in (1.206, 0.612)},
        against_truth(sessions),
        refusals(sessions[0]),
    )


def _sessions(instrument: PublishedInstrument, seed: int) -> list[BalanceRun]:
    plan = PaperPlan.of_the_paper()
    return [
        run_session(plan, d.model, d.noise_g, np.random.default_rng([seed, k]), d.own_g)
        for k, d in enumerate(instrument.posterior.draws[:TRUTH_DRAWS])
    ]


# --- tables


def tables(instrument: PublishedInstrument) -> dict[str, list[dict[str, Any]]]:
    """Tables 1 to 6: each row says what it is of and whether it was held out, and gives by column what is published,
    predicted, the ends of its interval, and whether that holds it (None where one of them is missing)."""
    result: dict[str, list[dict[str, Any]]] = {}
    cells = instrument.predictions.cells
    for start in range(0, len(cells), len(COLUMNS)):
        own = cells[start : start + len(COLUMNS)]
        first = own[0]
        whole = first.predicted is not None
        result.setdefault(first.table, []).append(
            {
                "correction": first.correction,
                "inc_ref_deg": first.inc_ref_deg,
                "held_out": first.held_out,
                "published": {c.column: c.published for c in own},
                "predicted": {c.column: c.predicted for c in own} if whole else None,
                "low": {c.column: c.low for c in own} if whole else None,
                "high": {c.column: c.high for c in own} if whole else None,
                "covered": {c.column: c.covered for c in own},
                "repeated": {c.column: c.repeated for c in own},
            }
        )
    return result


def _interval(values: Array, printed: float | None, column: str) -> dict[str, Any]:
    low, middle, high = (float(v) for v in interval(values, widened=WIDENED[column]))
    covered = None if printed is None else low <= printed <= high
    return {"published": printed, "predicted": middle, "low": low, "high": high, "covered": covered}


def headline_ratios(ensemble: Ensemble) -> list[dict[str, Any]]:
    """Table 6 as a share of table 1 in percent, by column, at every inclination balance can be used at (figure 7)."""
    paper = published()
    out = []
    for before, after in zip(paper["table1"], paper["table6"], strict=True):
        inc_deg = before["inc_ref_deg"]
        if inc_deg == 90.0:
            continue
        percent = 100.0 * np.abs(ensemble.of(["average"], inc_deg)) / np.abs(ensemble.of(["conventional"], inc_deg))
        printed = {name: 100.0 * abs(after[name]) / abs(before[name]) for name in COLUMNS}
        row = {name: _interval(percent[:, c], printed[name], name) for c, name in enumerate(COLUMNS)}
        out.append({"inc_ref_deg": inc_deg, **row})
    return out


def specification_band_deg(inc_deg: float) -> float:
    """Full width of the instrument's toolface specification: +-2.5 deg below 3 deg of inclination, else +-1.5 deg.

    The specification begins at 1 deg; the paper holds 0.612 deg to the same band, and so does this.
    """
    return 5.0 if inc_deg < 3.0 else 3.0


def specification_shares(ensemble: Ensemble) -> list[dict[str, Any]]:
    """Toolface peak-to-peak before and after as percent of the specification's band (figure 7)."""
    paper = published()
    out = []
    for before, after in zip(paper["table1"], paper["table6"], strict=True):
        inc_deg = before["inc_ref_deg"]
        band = specification_band_deg(inc_deg)
        row: dict[str, Any] = {"inc_ref_deg": inc_deg, "band_deg": band}
        for when, method, printed in (("before", "conventional", before), ("after", "average", after)):
            if method == "average" and inc_deg == 90.0:
                continue
            percent = 100.0 * ensemble.of([method], inc_deg)[:, 3] / band
            row[when] = _interval(percent, 100.0 * printed["d_tf_pp_deg"] / band, "d_tf_pp_deg")
        out.append(row)
    return out


def smooth(turns: Array, harmonics: int = 2) -> Array:
    """Errors (..., 73) over a turn without the noise: the first harmonics."""
    angle = np.radians(np.array(STATIONS_DEG))
    basis = [np.ones_like(angle)]
    for k in range(1, harmonics + 1):
        basis += [np.cos(k * angle), np.sin(k * angle)]
    X = np.stack(basis, axis=1)
    return np.asarray(turns @ (X @ np.linalg.pinv(X)).T)


def omitted_quadrants(ensemble: Ensemble, inc_deg: float) -> list[dict[str, Any]]:
    """For each triple how likely its toolface error, noise taken out, is largest in the quadrant that it omits,
    and by how much it is larger there than elsewhere (figures 4 and 5)."""
    quadrant = np.minimum((np.array(STATIONS_DEG) % 360.0 // 90.0).astype(int), 3)
    out = []
    for name in TRIPLES:
        size = np.abs(smooth(ensemble.turn(name, inc_deg)[1]))
        mean = np.stack([size[:, quadrant == q].mean(axis=1) for q in range(4)], axis=1)
        there = OMITTED[name] - 1
        others = np.delete(mean, there, axis=1).mean(axis=1)
        low, middle, high = (float(v) for v in interval(mean[:, there] / others))
        out.append(
            {
                "triple": name,
                "omitted": OMITTED[name],
                "probability_largest_there": float(np.mean(np.argmax(mean, axis=1) == there)),
                "ratio_to_others": {"predicted": middle, "low": low, "high": high},
            }
        )
    return out


def against_truth(sessions: list[BalanceRun]) -> list[dict[str, Any]]:
    """Root mean square errors (deg) of I and T over each turn, against the bench and against the truth: middle of the
    draws."""
    names = ("conventional", "average", "joint")
    found: dict[str, list[Array]] = {}
    for session in sessions:
        C, picked = session.matrices(), [METHODS.index("conventional"), METHODS.index("average")]
        together = joint(session.poses()).main.model()
        every = np.broadcast_to(together.C, (1, len(INCLINATIONS_DEG), 3, 3))
        for against in ("bench", "truth"):
            parts = (
                session.errors_deg(C[picked], against=against),
                session.errors_deg(every, together.b, against=against),
            )
            for angle, first, second in zip(("inc", "tf"), parts[0], parts[1], strict=True):
                rms = np.sqrt(np.mean(np.concatenate([first, second]) ** 2, axis=(2, 3)))
                for name, values in zip(names, rms, strict=True):
                    found.setdefault(f"{name}_{angle}_rms_{against}_deg", []).append(values)
    out = []
    for r, inc_deg in enumerate(INCLINATIONS_DEG):
        row: dict[str, Any] = {"inc_ref_deg": inc_deg}
        for key, values in found.items():
            refused = key.startswith("average") and inc_deg == 90.0
            row[key] = None if refused else float(np.median([v[r] for v in values]))
        out.append(row)
    return out


def refusals(session: BalanceRun) -> list[str]:
    """What balance declines, in its own words."""
    solved = balance(session.poses().subset(np.arange(3, 3 + 4 * len(INCLINATIONS_DEG))), triples="average")
    return [r.text for r in solved.remarks if r.reason is Reason.NEAR_HORIZONTAL]
