"""What makes the mean toolface of a triple: the closure of its four poses, and a check of the paper's signs by itself.

A matrix from three of an inclination's four poses meets them exactly, so the closure `e = S1 - S2 + S3 - S4` of the
four falls on the pose omitted. Beside the average of the triples each has an affine field, of `r = e / 4` at the three
poses and -3 r at the fourth. Near vertical, where gx and gy alone count, its means over the turn are (times sin I for
T, and 1/sqrt 2 for all):

    triple   mean T sin I     mean I
    1-2-3    -(rx + ry)       -(rx - ry)
    2-3-4    -(rx - ry)       +(rx + ry)
    3-4-1    +(rx + ry)       +(rx - ry)
    4-1-2    +(rx - ry)       -(rx + ry)

So the mean of T of one triple is, over sin I, the mean of I of the triple before it, with a sign that depends on which
way T turns and on how its error is counted. Nothing of the instrument enters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from highside.calibration.balance import TRIPLES
from highside.papers.balance_prediction import Ensemble, Rows, interval

BEFORE = {"1-2-3": "4-1-2", "2-3-4": "1-2-3", "3-4-1": "2-3-4", "4-1-2": "3-4-1"}
"""The triple whose mean of I tells the mean of T."""
MICRO_G_PER_DEG = float(np.radians(1.0) * 1e6)


@dataclass(frozen=True)
class MeanToolface:
    """Mean T of a triple less that of the average, deg: as published, and as its table's own means of I say it is."""

    inc_ref_deg: float
    triple: str
    published: float
    from_inclination: float


@dataclass(frozen=True)
class TripleClosure:
    """One component of the closure of a session (ug, of r = e / 4 along a diagonal of x and y): as the published means
    of the triples say, and as table 1 predicts it."""

    inc_ref_deg: float
    which: str
    published_ug: float
    predicted_ug: float
    low_ug: float
    high_ug: float

    @property
    def covered(self) -> bool:
        """Whether the published one is in the interval."""
        return self.low_ug <= self.published_ug <= self.high_ug


@dataclass(frozen=True)
class TripleEvidence:
    """What tables 2, 4, 5 and 6 say of the signs of T, and of the closures that set the means of the triples."""

    means: tuple[MeanToolface, ...]
    closures: tuple[TripleClosure, ...]
    arcs_deg: Mapping[float, float]
    """Mean T of 1-2-3 less that of the average, times sin I, by inclination"""

    @property
    def rms_deg(self) -> float:
        """By how much the means of I miss those of T, root mean square in arc."""
        return self._rms(1.0)

    @property
    def rms_of_other_sign_deg(self) -> float:
        """The same if T were counted the other way."""
        return self._rms(-1.0)

    def _rms(self, sign: float) -> float:
        arcs = [(m.published - sign * m.from_inclination) * np.sin(np.radians(m.inc_ref_deg)) for m in self.means]
        return float(np.sqrt(np.mean(np.square(arcs))))

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "mean_toolface_deg": [vars(m) for m in self.means],
            "rms_arc_deg": {"signs_as_here": self.rms_deg, "toolface_the_other_way": self.rms_of_other_sign_deg},
            "closures": [{**vars(c), "covered": c.covered} for c in self.closures],
            "arc_of_1-2-3_deg": {f"{inc:g}": arc for inc, arc in self.arcs_deg.items()},
        }


def evidence(published: Rows, ensemble: Ensemble) -> TripleEvidence:
    """From the published tables, and from what table 1 predicts of the same means."""
    average = {row["inc_ref_deg"]: row for row in published["table6"]}
    means: list[MeanToolface] = []
    closures: list[TripleClosure] = []
    for table, inc_deg in (("table4", 1.206), ("table5", 0.612)):
        sin = float(np.sin(np.radians(inc_deg)))
        rows = {row["triple"]: row for row in published[table]}
        less = {
            name: {t: rows[t][name] - average[inc_deg][name] for t in TRIPLES}
            for name in ("d_inc_mean_deg", "d_tf_mean_deg")
        }
        means += [
            MeanToolface(inc_deg, t, less["d_tf_mean_deg"][t], less["d_inc_mean_deg"][BEFORE[t]] / sin) for t in TRIPLES
        ]
        predicted = {t: ensemble.of([t], inc_deg)[:, 2] for t in TRIPLES}
        for which, plus, minus in (("x + ry", "3-4-1", "1-2-3"), ("x - ry", "4-1-2", "2-3-4")):
            scale = sin / np.sqrt(2.0) * MICRO_G_PER_DEG
            low, middle, high = interval((predicted[plus] - predicted[minus]) * scale)
            printed = (rows[plus]["d_tf_mean_deg"] - rows[minus]["d_tf_mean_deg"]) * scale
            closures.append(TripleClosure(inc_deg, which, float(printed), float(middle), float(low), float(high)))
    arcs = {
        row["inc_ref_deg"]: float(
            (row["d_tf_mean_deg"] - average[row["inc_ref_deg"]]["d_tf_mean_deg"])
            * np.sin(np.radians(row["inc_ref_deg"]))
        )
        for row in published["table2"]
        if row["correction"] == "balance 1-2-3"
    }
    return TripleEvidence(tuple(means), tuple(closures), arcs)


def in_words(found: TripleEvidence, noise_g: float) -> list[str]:
    """Why the means of T of single triples come out as they do; every figure from the tables."""
    arcs = np.abs(list(found.arcs_deg.values()))
    outside = [c for c in found.closures if not c.covered]
    printed = "; ".join(
        f"r{c.which} at {c.inc_ref_deg:g} deg {c.published_ug:+.0f} ug, predicted {c.low_ug:+.0f} to {c.high_ug:+.0f}"
        for c in found.closures
    )
    lines = [
        "Signs: a triple meets its three poses exactly, so its mean T, less that of the average, is over sin I the "
        "mean I of the triple before it, whatever the instrument. The published means of tables 4 and 5 agree to "
        f"{found.rms_deg:.5f} deg of arc (rms) with the signs used here, and would miss by "
        f"{found.rms_of_other_sign_deg:.5f} deg if T were counted the other way: it is no matter of convention, of a "
        "wrap or of a misprint.",
        f"What sets these means is the closure of the four poses at that inclination: {printed} (two sigma of a "
        f"reading's noise of {noise_g * 1e6:.0f} ug are {noise_g * 1e6 / np.sqrt(2.0):.0f}). Table 1 holds the size of "
        "such a term in its peak-to-peaks, its sign nowhere: the intervals hold both signs.",
    ]
    if outside:
        lines.append(
            f"{len(outside)} of {len(found.closures)} closures are larger than table 1 allows. The arc of 1-2-3 is "
            f"{arcs.min():.4f} to {arcs.max():.4f} deg from {min(found.arcs_deg):g} to {max(found.arcs_deg):g} deg of "
            "inclination, much the same at each. No error of the sensor's shape does that (near vertical its load "
            "does not change over the turn), none of the toolface encoder (it would fall with sin I): the poses of "
            f"those sessions were off in direction by some {np.sqrt(2) * arcs.mean():.4f} deg (the table's step is "
            "0.018), or the zero moved between them. These means of T are not predicted."
        )
    return lines
