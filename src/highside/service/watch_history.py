"""What the watch has seen over the last day, for a picture: parameters with their standard deviations over time.

It is read from the watch's own trace, which is part of the state that is kept: it outlasts a restart, and begins anew
with another calibration record, since deviations are from the record in force.
"""

from __future__ import annotations

import numpy as np

from highside.service.watch_messages import WatchHistory, WatchTrace
from highside.service.watch_stage import WatchStage
from highside.watch.parameters import CALIBRATION, NAMES, UNITS

__all__ = ["POINTS", "SPAN_S", "history"]

SPAN_S = 86_400.0
"""how far back it goes, s"""
POINTS = 144
"""at most, evenly in time: one each ten minutes of a day, the shortest distance of two onsets. 40 KB as JSON"""
DIGITS = 4
"""of a number: a tenth of a pixel of a picture"""


def history(stage: WatchStage, now_s: float) -> WatchHistory:
    """The last day by the tool's own time, back from `now_s` (UTC); the last measurement of each interval."""
    said, trace = stage.said, stage.said.trace
    since = stage.t_s - SPAN_S
    # of the watch's own time, so that what was said once does not move
    bins = np.floor(trace.t_s / (SPAN_S / POINTS))
    last_of_bin = np.append(np.diff(bins) > 0.0, True)[: bins.size]
    chosen = np.flatnonzero(last_of_bin & (trace.t_s >= since))[-POINTS:]
    return WatchHistory(
        t=round(now_s, 3),
        cal_id=stage.cal_id,
        began=stage.began,
        threshold=said.threshold,
        times=[round(now_s - (stage.t_s - float(t)), 1) for t in trace.t_s[chosen]],
        inclination_deg=[round(float(one), 2) for one in trace.inclination_deg[chosen]],
        evidence=[_short(one) for one in trace.evidence[chosen]],
        parameters={
            name: WatchTrace(
                unit=UNITS[name],
                value=[_short(one) for one in trace.value[chosen, k]],
                std=[_short(one) for one in trace.std[chosen, k]],
            )
            for k, name in enumerate(NAMES[:CALIBRATION])
        },
    )


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
