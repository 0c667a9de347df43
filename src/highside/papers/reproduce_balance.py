"""The balance paper's tables and statements beside what the instrument found from its table 1 predicts.

Tables 2 to 6 and the figures are predicted with 95 % intervals (`highside.papers.published_instrument`); what is said
of them is computed from the published and the predicted numbers. Only a simulation knows the truth as well, gravity in
the tool frame: errors against it are those of instruments that table 1 allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.calibration.balance import TRIPLES, balance
from highside.calibration.joint import joint
from highside.calibration.result import Reason
from highside.papers import published_instrument
from highside.papers.balance_prediction import WIDENED, Ensemble, interval
from highside.papers.balance_session import (
    COLUMNS,
    INCLINATIONS_DEG,
    METHODS,
    STATIONS_DEG,
    Plan,
    Session,
    run_session,
)
from highside.papers.published_instrument import PublishedInstrument, published

EXPECTED_RANGE_SIGMAS = 5.74
"""expected peak-to-peak of 292 normal numbers"""
SMALL_DEG = (3.006, 1.998, 1.206, 0.612)
LARGE_DEG = (90.0, 75.006, 45.0, 14.994)
LEFT_OUT = {"1-2-3": 4, "2-3-4": 1, "3-4-1": 2, "4-1-2": 3}
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
    left_out: dict[str, list[dict[str, Any]]]
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
        {f"{i:g}": left_out_quadrants(ensemble, i) for i in (1.206, 0.612)},
        against_truth(sessions),
        refusals(sessions[0]),
    )


def _sessions(instrument: PublishedInstrument, seed: int) -> list[Session]:
    plan = Plan.of_the_paper()
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


def _interval(values: Array, told: float | None, column: str) -> dict[str, Any]:
    low, middle, high = (float(v) for v in interval(values, widened=WIDENED[column]))
    covered = None if told is None else low <= told <= high
    return {"published": told, "predicted": middle, "low": low, "high": high, "covered": covered}


def headline_ratios(ensemble: Ensemble) -> list[dict[str, Any]]:
    """Table 6 as a share of table 1 in percent, by column, at every inclination balance can be used at (figure 7)."""
    paper = published()
    out = []
    for before, after in zip(paper["table1"], paper["table6"], strict=True):
        inc_deg = before["inc_ref_deg"]
        if inc_deg == 90.0:
            continue
        said = 100.0 * np.abs(ensemble.of(["average"], inc_deg)) / np.abs(ensemble.of(["conventional"], inc_deg))
        told = {name: 100.0 * abs(after[name]) / abs(before[name]) for name in COLUMNS}
        row = {name: _interval(said[:, c], told[name], name) for c, name in enumerate(COLUMNS)}
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
        for when, method, told in (("before", "conventional", before), ("after", "average", after)):
            if method == "average" and inc_deg == 90.0:
                continue
            said = 100.0 * ensemble.of([method], inc_deg)[:, 3] / band
            row[when] = _interval(said, 100.0 * told["d_tf_pp_deg"] / band, "d_tf_pp_deg")
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


def left_out_quadrants(ensemble: Ensemble, inc_deg: float) -> list[dict[str, Any]]:
    """For each triple how likely its toolface error, noise taken out, is largest in the quadrant that it leaves out,
    and by how much it is larger there than elsewhere (figures 4 and 5)."""
    quadrant = np.minimum((np.array(STATIONS_DEG) % 360.0 // 90.0).astype(int), 3)
    out = []
    for name in TRIPLES:
        size = np.abs(smooth(ensemble.turn(name, inc_deg)[1]))
        mean = np.stack([size[:, quadrant == q].mean(axis=1) for q in range(4)], axis=1)
        there = LEFT_OUT[name] - 1
        others = np.delete(mean, there, axis=1).mean(axis=1)
        low, middle, high = (float(v) for v in interval(mean[:, there] / others))
        out.append(
            {
                "triple": name,
                "left_out": LEFT_OUT[name],
                "probability_largest_there": float(np.mean(np.argmax(mean, axis=1) == there)),
                "ratio_to_others": {"predicted": middle, "low": low, "high": high},
            }
        )
    return out


def against_truth(sessions: list[Session]) -> list[dict[str, Any]]:
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


def refusals(session: Session) -> list[str]:
    """What balance declines, in its own words."""
    solved = balance(session.poses().subset(np.arange(3, 3 + 4 * len(INCLINATIONS_DEG))), triples="average")
    return [r.text for r in solved.remarks if r.reason is Reason.NEAR_HORIZONTAL]


# --- words


@dataclass(frozen=True, slots=True)
class Statement:
    """Where the paper's model or text and the measurements part: what is said, what was measured, what table 1
    predicts.

    `holds` is whether what the paper says is true of the published tables, and of those predicted from table 1 (their
    middles).
    """

    topic: str
    paper_says: str
    published: str
    predicted: str
    reason: str
    holds_published: bool
    holds_predicted: bool


def statements(found: Reproduction) -> list[Statement]:
    """The comparison in words, every number computed from the tables."""
    made, noise_g = found.tables, found.instrument.found.noise_g
    return [
        _peak_to_peak_of_inclination(made),
        _mean_of_inclination(made),
        _mean_of_toolface(made),
        _no_inclination_error_after_balance(made, noise_g),
        _exact_at_90(made),
        _all_errors_fall(found),
        _small_as_good_as_large(made, noise_g),
        _printed_ratios(found),
        _accuracy(found),
    ]


def _column(made: Made, table: str, who: str, name: str) -> dict[float, float]:
    return {row["inc_ref_deg"]: row[who][name] for row in made[table] if row[who] is not None}


def _peak_to_peak_of_inclination(made: Made) -> Statement:
    told, holds = {}, {}
    for who in ("published", "predicted"):
        pp = _column(made, "table1", who, "d_inc_pp_deg")
        ratio = pp[90.0] / pp[0.612]
        told[who] = f"{pp[90.0]:.3f} deg at 90 deg, {pp[0.612]:.3f} deg at 0.612 deg: a ratio of {ratio:.1f}"
        holds[who] = abs(ratio - 1.0) < 0.2
    return Statement(
        "Conventional: peak-to-peak of inclination",
        "(13): 2 sqrt(2) dS0, the same at every inclination",
        told["published"],
        told["predicted"],
        "One dS0 common to all elements cannot change with inclination. An offset b that three poses leave in the "
        "matrix can: it comes back as b (1 - gx - gy - gz), nothing near vertical and most near horizontal.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _mean_of_inclination(made: Made) -> Statement:
    predicted = np.tan(np.radians(75.006)) / np.tan(np.radians(0.612))
    told, holds = {}, {}
    for who in ("published", "predicted"):
        mean = _column(made, "table1", who, "d_inc_mean_deg")
        ratio = mean[0.612] / mean[75.006]
        told[who] = (
            f"{mean[75.006]:+.4f} deg at 75.006 deg, {mean[0.612]:+.4f} deg at 0.612 deg: a ratio of {ratio:+.1f}"
        )
        holds[who] = 0.5 < ratio / predicted < 2.0
    return Statement(
        "Conventional: mean of inclination",
        f"(13): -2 cot I dSr, of one sign and {predicted:.0f} times larger at 0.612 than at 75 deg",
        told["published"],
        told["predicted"],
        "With the derivative of the determinant dSr drops out and the mean is zero. What is left comes from the offset "
        "that three poses cannot show, from the bench's tilt and steps, and from the quadratic terms of the sensor.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _mean_of_toolface(made: Made) -> Statement:
    told, holds = {}, {}
    for who in ("published", "predicted"):
        mean = _column(made, "table1", who, "d_tf_mean_deg")
        arc = [mean[i] * np.sin(np.radians(i)) for i in SMALL_DEG]
        told[who] = (
            f"{mean[45.0]:+.3f} deg at 45 deg, {mean[0.612]:+.3f} deg at 0.612 deg; times sin I, from 3 deg down, "
            f"{min(arc):.4f} to {max(arc):.4f} deg"
        )
        holds[who] = abs(mean[0.612] / mean[45.0] - 1.0) < 0.5
    return Statement(
        "Conventional: mean of toolface",
        "(13): dS0, the same at every inclination (corrected: zero)",
        told["published"],
        told["predicted"],
        "Growing as 1 / sin I with a nearly constant arc, it is the mark of a bench that leans across its plane of "
        "inclination, or whose spindle is not square to it: no error of a sensor's matrix or offset does that.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _no_inclination_error_after_balance(made: Made, noise_g: float) -> Statement:
    told, holds = {}, {}
    for who in ("published", "predicted"):
        pp = {i: v for i, v in _column(made, "table6", who, "d_inc_pp_deg").items() if i != 90.0}
        worst = max(pp, key=lambda i: pp[i])
        told[who] = f"{min(pp.values()):.3f} to {max(pp.values()):.3f} deg peak-to-peak are left, most at {worst:g} deg"
        holds[who] = max(pp.values()) < 1e-3
    noise = EXPECTED_RANGE_SIGMAS * np.degrees(noise_g)
    return Statement(
        "Average balance: inclination",
        "(19): dI = 0",
        told["published"],
        told["predicted"],
        f"It is zero for an error common to the four poses, at I = Ic only. Noise alone leaves {noise:.3f} deg; "
        "what goes beyond it between 15 and 75 deg is the shape of the sensor and the bench's encoder.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _exact_at_90(made: Made) -> Statement:
    row = next(r for r in made["table6"] if r["inc_ref_deg"] == 90.0)["published"]
    return Statement(
        "Balance at 90 deg",
        "tables 3 and 6: inclination without any error",
        f"mean {row['d_inc_mean_deg']:.6f}, peak-to-peak {row['d_inc_pp_deg']:.6f} deg",
        "refused, and nothing is predicted",
        "cos Ic = 0: the third row of W vanishes, so the corrected gz is zero whatever the tool does. The table shows "
        "this degeneracy, not accuracy.",
        row["d_inc_pp_deg"] == 0.0,
        False,
    )


def _all_errors_fall(found: Reproduction) -> Statement:
    names = published_instrument.TITLES
    told, holds = {}, {}
    for who in ("published", "predicted"):
        grown = [
            f"{names[name]} at {row['inc_ref_deg']:g} deg ({row[name][who] / 100.0:.1f} times)"
            for row in found.ratios
            for name in COLUMNS
            if row[name][who] > 100.0
        ]
        if who == "published":
            at_45 = {r["correction"]: r["published"] for r in found.tables["table3"] if r["inc_ref_deg"] == 45.0}
            before, after = (at_45[name]["d_inc_mean_deg"] for name in ("conventional", "1st quadrant"))
            if abs(after) > abs(before):
                grown.append(f"mean I at 45 deg in table 3 ({abs(after / before):.1f} times)")
        told[who] = "grown: " + (", ".join(grown) if grown else "none")
        holds[who] = not grown
    return Statement(
        "All errors fall",
        "after balance all errors are smaller, at most 30.8 % is left",
        told["published"],
        told["predicted"],
        "Small means are noise of the calibration poses. The 30.8 % are those of 1.206 and 0.612 deg only.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _small_as_good_as_large(made: Made, noise_g: float) -> Statement:
    told, holds = {}, {}
    for who in ("published", "predicted"):
        pp = _column(made, "table6", who, "d_tf_pp_deg")
        told[who] = f"{pp[0.612]:.2f} deg at 0.612 deg, {pp[45.0]:.2f} deg at 45 deg peak-to-peak"
        holds[who] = pp[0.612] < 2.0 * pp[45.0]
    floor = EXPECTED_RANGE_SIGMAS * np.degrees(noise_g) / np.sin(np.radians(0.612))
    return Statement(
        "Small inclinations are as good as large ones",
        "toolface after balance is as accurate near vertical as elsewhere",
        told["published"],
        told["predicted"],
        f"The noise of a reading turns toolface by sigma / sin I: {floor:.2f} deg peak-to-peak at 0.612 deg for "
        f"{noise_g * 1e6:.0f} ug. No correction can do better with single readings; averaging does.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _printed_ratios(found: Reproduction) -> Statement:
    table = {row["inc_ref_deg"]: row for row in found.ratios}
    mean, spread = COLUMNS[2:]
    told = {
        who: "; ".join(
            f"at {inc:g} deg {table[inc][mean][who]:.1f} % and {table[inc][spread][who]:.1f} %"
            for inc in (1.206, 0.612)
        )
        for who in ("published", "predicted")
    }
    printed = (0.2, 29.3, 1.1, 28.1)
    computed = [round(table[i][c]["published"], 1) for i in (1.206, 0.612) for c in (mean, spread)]
    return Statement(
        "What is left of toolface errors (mean, peak-to-peak)",
        "the text prints 0.2 %, 29.3 %, 1.1 % and 28.1 %",
        told["published"] + " by its own tables 1 and 6",
        told["predicted"],
        "The four figures of the text do not follow from the tables.",
        sorted(printed) == sorted(computed),
        False,
    )


def _accuracy(found: Reproduction) -> Statement:
    row = next(r for r in found.truth if r["inc_ref_deg"] == 0.612)
    bench, truth, joint_truth = (
        row["average_tf_rms_bench_deg"],
        row["average_tf_rms_truth_deg"],
        row["joint_tf_rms_truth_deg"],
    )
    return Statement(
        "Agreement with the bench is accuracy",
        "errors are judged against the bench that calibrated",
        "no other reference was available",
        f"toolface at 0.612 deg: average balance {bench:.3f} deg rms against the bench, {truth:.3f} against the truth; "
        f"joint estimator {joint_truth:.3f} against the truth",
        "The balance matrix takes up the bench's tilt with the sensor's errors. In the hole there is no bench.",
        True,
        bool(truth < 1.2 * bench),
    )


def figures(found: Reproduction) -> dict[str, dict[str, Any]]:
    """What each of the paper's figures shows beside what is predicted of it: from which tables, and the verdicts."""
    predictions = found.instrument.predictions

    def counted(table: str, methods: tuple[str, ...] = ()) -> dict[str, Any]:
        own = [c for c in predictions.cells if c.table == table and c.held_out and c.covered is not None]
        own = [c for c in own if not methods or c.correction in methods]
        return {"table": table, "covered": sum(bool(c.covered) for c in own), "of": len(own)}

    result: dict[str, dict[str, Any]] = {
        "figure1": {"shows": "conventional errors over a turn", "table": "table1", "held_out": False},
        "figure2": {
            "shows": "small inclinations, conventional and balance 1-2-3",
            "held_out": True,
            **counted("table2"),
        },
        "figure3": {
            "shows": "large inclinations, conventional and balance of three quadrants",
            "held_out": True,
            **counted("table3"),
        },
    }
    for name, table, inc in (("figure4", "table4", "1.206"), ("figure5", "table5", "0.612")):
        likely = [row["probability_largest_there"] for row in found.left_out[inc]]
        result[name] = {
            "shows": f"the four triples at {inc} deg",
            "held_out": True,
            **counted(table),
            "error_largest_in_quadrant_left_out": {"published": True, "probability": likely},
        }
    result["figure6"] = {"shows": "average of the four triples", "held_out": True, **counted("table6")}
    parts = [row[name] for row in found.ratios for name in ("d_inc_pp_deg", "d_tf_pp_deg")]
    parts += [row["after"] for row in found.shares if "after" in row]
    result["figure7"] = {
        "shows": "peak-to-peak after as a share of before, and of the specification",
        "held_out": True,
        "covered": sum(bool(p["covered"]) for p in parts),
        "of": len(parts),
    }
    return result


def as_dict(found: Reproduction) -> dict[str, Any]:
    """Everything as plain values for JSON."""
    return {
        **published_instrument.as_dict(found.instrument),
        "tables": found.tables,
        "figures": figures(found),
        "ratios_percent": found.ratios,
        "specification_share_percent": found.shares,
        "left_out_quadrants": found.left_out,
        "against_truth_deg": found.truth,
        "refused": found.refused,
        "statements": [asdict(s) for s in statements(found)],
    }
