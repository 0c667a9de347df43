"""What the watch has seen over the last day, for a picture: parameters with their standard deviations over time.

It is read from the watch's own trace, which is part of the state that is kept, and outlasts a restart. Deviations are
from the record in force at the time: where another one came into force, the history goes on and says when.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from highside.arrays import Array
from highside.service.saved_watch import POINTS, SPAN_S, last_of_each
from highside.service.watch_messages import WatchChange, WatchHistory, WatchTrace
from highside.service.watch_stage import WatchStage
from highside.watch.parameters import CALIBRATION, NAMES, UNITS

__all__ = ["POINTS", "SPAN_S", "history"]

DIGITS = 4
"""of a number: a tenth of a pixel of a picture"""


def history(stage: WatchStage, now_s: float, now_mono: float | None = None) -> WatchHistory:
    """The last day by the tool's own time, back from `now_s` (UTC); the last measurement of each interval. `now_mono`:
    the same by the host's clock; None: that of the last reading."""
    watch_s = stage.t_s if now_mono is None else stage.now_s(now_mono)
    rows = np.vstack([*(one.rows() for one in stage.earlier), _rows(stage)])
    rows = rows[last_of_each(rows[:, 0], stage.t_s)]
    since_s = stage.t_s - SPAN_S
    value, std = rows[:, 1 : 1 + CALIBRATION], rows[:, 1 + CALIBRATION : 1 + 2 * CALIBRATION]

    def utc(t_s: float) -> float:
        return round(now_s - (watch_s - t_s), 1)

    ids = [*(one.cal_id for one in stage.earlier), stage.cal_id]
    return WatchHistory(
        t=round(now_s, 3),
        cal_id=stage.cal_id,
        began=stage.began,
        threshold=stage.said.threshold,
        times=[utc(float(t)) for t in rows[:, 0]],
        inclination_deg=[round(float(one), 2) for one in rows[:, -2]],
        evidence=[_short(one) for one in rows[:, -1]],
        parameters={
            name: WatchTrace(
                unit=UNITS[name],
                value=[_short(one) for one in value[:, k]],
                std=[_short(one) for one in std[:, k]],
            )
            for k, name in enumerate(NAMES[:CALIBRATION])
        },
        changes=[
            WatchChange(t=utc(one.until_s), before=before, cal_id=then, why=one.why)
            for one, (before, then) in zip(stage.earlier, pairwise(ids), strict=True)
            if one.until_s >= since_s
        ],
    )


def _rows(stage: WatchStage) -> Array:
    """(K, `TRACE_WIDTH`) of the watch in force, as `WatchMemory` has them."""
    trace = stage.said.trace
    return np.column_stack([trace.t_s, trace.value, trace.std, trace.inclination_deg, trace.evidence])


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
