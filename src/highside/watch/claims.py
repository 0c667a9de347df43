"""A departure in the form of the answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.watch.bank import HYPOTHESES, Scored
from highside.watch.broken import Beyond, broken_axis
from highside.watch.mixture import Mixture
from highside.watch.policy import WatchPolicy
from highside.watch.result import AttitudeError, Size, WatchClaim

__all__ = ["SECOND", "broken", "departed", "sizes_of", "unexplained"]

SECOND = "a second departure"
"""in a class: the likeliest departure is not all that happened"""
INTERVAL = 1.96
"""standard deviations of a 95 % interval"""


def sizes_of(alike: Sequence[Scored], mixture: Mixture, grown: float) -> dict[str, Size]:
    """Of each of a class, if it is what happened, over all its onsets; `grown`: how much wider standard deviations
    stand than the bank has them."""
    out = {}
    for one in alike:
        size, std = mixture.size_of(HYPOTHESES.index(one.hypothesis)) or (one.size, one.std)
        half = INTERVAL * grown * std
        out[one.hypothesis.name] = Size(size, grown * std, size - half, size + half, one.hypothesis.unit)
    return out


def departed(
    alike: Sequence[Scored],
    sizes: dict[str, Size],
    onsets: tuple[float, float],
    alarm_s: float,
    error: AttitudeError,
    *,
    second: bool,
) -> WatchClaim:
    """One class, the likeliest first. `onsets`: first and last that explain it about as well; `error`: of the
    likeliest; `second`: it is not all that happened."""
    best = alike[0]
    return WatchClaim(
        effect=best.hypothesis.effect,
        parameter=best.hypothesis.name,
        parameters=sizes,
        equivalence_class=(*(one.hypothesis.name for one in alike), *((SECOND,) if second else ())),
        since_s=best.since_s,
        since_low_s=onsets[0],
        since_high_s=onsets[1],
        alarm_s=alarm_s,
        evidence=best.ratio,
        error=error,
    )


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


def broken(beyond: Beyond, policy: WatchPolicy) -> WatchClaim:
    """The length of the readings is far from gravity's: no small error of the calibration."""
    times, excess = zip(*beyond.lengths, strict=True)
    size = float(np.median(excess))
    std = float(np.std(excess)) / np.sqrt(len(excess))
    half = INTERVAL * std
    return unexplained(
        "length",
        Size(size, std, size - half, size + half, "g"),
        broken_axis(np.array(beyond.axes).reshape(-1, 6), policy.largest),
        times[0],
        times[policy.fewest_beyond - 1],
    )
