"""A departure in the form of the answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.watch.bank import HYPOTHESES, Scored
from highside.watch.broken import broken_axis
from highside.watch.mixture import Mixture
from highside.watch.policy import WatchPolicy
from highside.watch.result import Size, WatchClaim

__all__ = ["SECOND", "broken", "sizes_of", "unexplained"]

SECOND = "a second departure"
"""in a class: the likeliest departure is not all that happened"""
INTERVAL = 1.96
"""standard deviations of a 95 % interval"""


def sizes_of(alike: Sequence[Scored], mixture: Mixture, grown: float) -> dict[str, Size]:
    """Of each of a class, if it is what happened, over all its onsets; `grown`: how much wider standard deviations stand
    than the bank has them."""
    out = {}
    for one in alike:
        size, std = mixture.size_of(HYPOTHESES.index(one.hypothesis)) or (one.size, one.std)
        half = INTERVAL * grown * std
        out[one.hypothesis.name] = Size(size, grown * std, size - half, size + half, one.hypothesis.unit)
    return out


def unexplained(
    parameter: str, size: Size, equivalence_class: tuple[str, ...], since_s: float, alarm_s: float
) -> WatchClaim:
    """No small error of the calibration: no reading is to be used."""
    return WatchClaim(
        effect="unexplained",
        parameter=parameter,
        parameters={parameter: size},
        equivalence_class=equivalence_class,
        since_s=since_s,
        since_low_s=since_s,
        since_high_s=since_s,
        alarm_s=alarm_s,
        evidence=None,
        error=None,
    )


def broken(beyond: Sequence[tuple[float, float]], axes: Sequence[Array], policy: WatchPolicy) -> WatchClaim:
    """The length of the readings is far from gravity's: no small error of the calibration. `beyond`: time, s, and
    excess, g, of each such reading; `axes`: (6,) as `broken_axis` takes them."""
    times, excess = zip(*beyond, strict=True)
    size = float(np.median(excess))
    std = float(np.std(excess)) / np.sqrt(len(excess))
    half = INTERVAL * std
    return unexplained(
        "length",
        Size(size, std, size - half, size + half, "g"),
        broken_axis(np.array(axes).reshape(-1, 6), policy.largest),
        times[0],
        times[policy.fewest_beyond - 1],
    )
