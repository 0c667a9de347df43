"""Where the clock and the channels are taken to be before anything is fitted: as the alignment measured them.

To first order a lag is found from none. One beyond that is started from as it was measured; one that first order finds
is not: what a measurement errs by would be taken up by other effects.
"""

from __future__ import annotations

import numpy as np

from highside.diagnosis.simulation.design import About
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE
from highside.diagnosis.simulation.session import OFFSET, SKEW, SimulationSession
from highside.physics.effects.late_channel import EFFECT as LATE_CHANNEL


def measured_start(session: SimulationSession) -> About:
    """Delays beyond first order that were measured, by effect; nothing where there are none, or each file has its own
    zero of time."""
    a = session.alignment
    if not a.same_clock:
        return {}

    def far(lag_s: float) -> bool:
        return bool(2 * np.pi * session.band_hz * abs(lag_s) > SIMULATION_CHOICE.phase)

    lags_s = dict(a.lags_s)
    apart = any(far(lag_s - a.lag_s) for lag_s in lags_s.values())
    lag_s = lags_s[session.names[a.in_time(session.names)]] if apart else a.lag_s
    start: dict[str, tuple[float, ...]] = {}
    if far(a.rate * float(session.elapsed_s[-1])):
        start[SKEW] = (a.rate,)
    if far(lag_s):
        start[OFFSET] = (lag_s,)
    others = [name for c, name in enumerate(session.names) if c != a.in_time(session.names)]
    own_s = tuple(lags_s[name] - lag_s if name in lags_s and far(lags_s[name] - lag_s) else 0.0 for name in others)
    if apart and any(own_s):
        start[LATE_CHANNEL.id] = own_s
    return start
