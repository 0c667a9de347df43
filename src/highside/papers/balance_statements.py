"""Where the balance paper's model or text and the measurements part, each number computed from the tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.papers import published_instrument
from highside.papers.balance_session import (
    COLUMNS,
)
from highside.papers.reproduce_balance import EXPECTED_RANGE_SIGMAS, SMALL_DEG, Made, Reproduction


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
    text, holds = {}, {}
    for who in ("published", "predicted"):
        pp = _column(made, "table1", who, "d_inc_pp_deg")
        ratio = pp[90.0] / pp[0.612]
        text[who] = f"{pp[90.0]:.3f} deg at 90 deg, {pp[0.612]:.3f} deg at 0.612 deg: a ratio of {ratio:.1f}"
        holds[who] = abs(ratio - 1.0) < 0.2
    return Statement(
        "Conventional: peak-to-peak of inclination",
        "(13): 2 sqrt(2) dS0, the same at every inclination",
        text["published"],
        text["predicted"],
        "One dS0 common to all elements cannot change with inclination. An offset b that three poses leave in the "
        "matrix can: it comes back as b (1 - gx - gy - gz), nothing near vertical and most near horizontal.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _mean_of_inclination(made: Made) -> Statement:
    predicted = np.tan(np.radians(75.006)) / np.tan(np.radians(0.612))
    text, holds = {}, {}
    for who in ("published", "predicted"):
        mean = _column(made, "table1", who, "d_inc_mean_deg")
        ratio = mean[0.612] / mean[75.006]
        text[who] = (
            f"{mean[75.006]:+.4f} deg at 75.006 deg, {mean[0.612]:+.4f} deg at 0.612 deg: a ratio of {ratio:+.1f}"
        )
        holds[who] = 0.5 < ratio / predicted < 2.0
    return Statement(
        "Conventional: mean of inclination",
        f"(13): -2 cot I dSr, of one sign and {predicted:.0f} times larger at 0.612 than at 75 deg",
        text["published"],
        text["predicted"],
        "With the derivative of the determinant dSr drops out and the mean is zero. What is left comes from the offset "
        "that three poses cannot show, from the bench's tilt and steps, and from the quadratic terms of the sensor.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _mean_of_toolface(made: Made) -> Statement:
    text, holds = {}, {}
    for who in ("published", "predicted"):
        mean = _column(made, "table1", who, "d_tf_mean_deg")
        arc = [mean[i] * np.sin(np.radians(i)) for i in SMALL_DEG]
        text[who] = (
            f"{mean[45.0]:+.3f} deg at 45 deg, {mean[0.612]:+.3f} deg at 0.612 deg; times sin I, from 3 deg down, "
            f"{min(arc):.4f} to {max(arc):.4f} deg"
        )
        holds[who] = abs(mean[0.612] / mean[45.0] - 1.0) < 0.5
    return Statement(
        "Conventional: mean of toolface",
        "(13): dS0, the same at every inclination (corrected: zero)",
        text["published"],
        text["predicted"],
        "Growing as 1 / sin I with a nearly constant arc, it is the mark of a bench that leans across its plane of "
        "inclination, or whose spindle is not square to it: no error of a sensor's matrix or offset does that.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _no_inclination_error_after_balance(made: Made, noise_g: float) -> Statement:
    text, holds = {}, {}
    for who in ("published", "predicted"):
        pp = {i: v for i, v in _column(made, "table6", who, "d_inc_pp_deg").items() if i != 90.0}
        worst = max(pp, key=lambda i: pp[i])
        text[who] = f"{min(pp.values()):.3f} to {max(pp.values()):.3f} deg peak-to-peak are left, most at {worst:g} deg"
        holds[who] = max(pp.values()) < 1e-3
    noise = EXPECTED_RANGE_SIGMAS * np.degrees(noise_g)
    return Statement(
        "Average balance: inclination",
        "(19): dI = 0",
        text["published"],
        text["predicted"],
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
    text, holds = {}, {}
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
        text[who] = "grown: " + (", ".join(grown) if grown else "none")
        holds[who] = not grown
    return Statement(
        "All errors fall",
        "after balance all errors are smaller, at most 30.8 % is left",
        text["published"],
        text["predicted"],
        "Small means are noise of the calibration poses. The 30.8 % are those of 1.206 and 0.612 deg only.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _small_as_good_as_large(made: Made, noise_g: float) -> Statement:
    text, holds = {}, {}
    for who in ("published", "predicted"):
        pp = _column(made, "table6", who, "d_tf_pp_deg")
        text[who] = f"{pp[0.612]:.2f} deg at 0.612 deg, {pp[45.0]:.2f} deg at 45 deg peak-to-peak"
        holds[who] = pp[0.612] < 2.0 * pp[45.0]
    floor = EXPECTED_RANGE_SIGMAS * np.degrees(noise_g) / np.sin(np.radians(0.612))
    return Statement(
        "Small inclinations are as good as large ones",
        "toolface after balance is as accurate near vertical as elsewhere",
        text["published"],
        text["predicted"],
        f"The noise of a reading turns toolface by sigma / sin I: {floor:.2f} deg peak-to-peak at 0.612 deg for "
        f"{noise_g * 1e6:.0f} ug. No correction can do better with single readings; averaging does.",
        bool(holds["published"]),
        bool(holds["predicted"]),
    )


def _printed_ratios(found: Reproduction) -> Statement:
    table = {row["inc_ref_deg"]: row for row in found.ratios}
    mean, spread = COLUMNS[2:]
    text = {
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
        text["published"] + " by its own tables 1 and 6",
        text["predicted"],
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
        "The balance matrix absorbs the bench's tilt with the sensor's errors. In the hole there is no bench.",
        True,
        bool(truth < 1.2 * bench),
    )
