"""Is a prediction of the same things as the recording? Unit, sign and axes, before any effect is fitted.

Of each channel the slope of recording over prediction is looked at: a factor between units, a turned sign or a
neighbour that fits far better is a fault of the files, however well a fit could live with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import Finding
from highside.diagnosis.simulation.policy import SIMULATION_INTAKE, SIMULATION_SESSIONS
from highside.diagnosis.simulation.session import OFFSET, SKEW, SimulationSession
from highside.physics.channels import kind_of
from highside.units import STANDARD_GRAVITY_MPS2

FACTORS = {
    "m/s2 against g": STANDARD_GRAVITY_MPS2,
    "g against m/s2": 1 / STANDARD_GRAVITY_MPS2,
    "deg against rad": math.degrees(1),
    "rad against deg": math.radians(1),
    "thousandths against units": SIMULATION_INTAKE.prefix,
    "units against thousandths": 1 / SIMULATION_INTAKE.prefix,
}


def check_prediction(session: SimulationSession) -> tuple[Finding, ...]:
    """What spoils the comparison; empty if nothing does."""
    a = session.alignment
    if a.same_clock:
        session = session.about({OFFSET: (a.lag_s,), SKEW: (a.rate,)})
    kept = slice(None) if session.omitted is None else ~session.omitted
    measured, predicted = session.readings[:, kept], session.predicted[:, kept]
    dead = [n for n, m, p in zip(session.names, measured, predicted, strict=True) if _constant(m) and not _constant(p)]
    if dead:
        return (Finding("constant_channel", tuple(dead), 0.0, "check wire and codec"),)
    found = _axes(session, measured, predicted)
    if found:
        return found
    for name, m, p in zip(session.names, measured, predicted, strict=True):
        r = _correlation(m, p)
        if abs(r) < SIMULATION_INTAKE.follows:
            continue
        slope = r * float(m.std() / p.std())
        if slope < 0:
            words = f"the recording follows the prediction with the sign turned (slope {slope:.3g})"
            return (Finding("inverted_axis", (name,), _chance(r, session), f"{words}: check signs"),)
        unit = next((u for u, f in FACTORS.items() if abs(slope / f - 1) < SIMULATION_INTAKE.near), None)
        if unit:
            words = f"the recording is {slope:.4g} times the prediction: looks like {unit}"
            return (Finding("wrong_unit", (name,), _chance(r, session), words),)
    return ()


def _constant(values: Array) -> bool:
    """Whether a channel never changes but by the rounding of a filter."""
    return bool(np.ptp(values) <= SIMULATION_SESSIONS.copy * np.abs(values).max())


def _axes(session: SimulationSession, measured: Array, predicted: Array) -> tuple[Finding, ...]:
    """Channels that follow each other's prediction and not their own."""
    kinds = [kind_of(n, u) for n, u in zip(session.names, session.units, strict=True)]
    for c, d in _pairs(kinds):
        crossed = _correlation(measured[c], predicted[d]), _correlation(measured[d], predicted[c])
        own = _correlation(measured[c], predicted[c]), _correlation(measured[d], predicted[d])
        if min(np.abs(crossed)) > SIMULATION_INTAKE.follows and max(np.abs(own)) < SIMULATION_INTAKE.strange:
            words = "each follows the prediction of the other: check the order of the columns"
            p = _chance(float(min(np.abs(crossed))), session)
            return (Finding("swapped_axis", (session.names[c], session.names[d]), p, words),)
    return ()


def _pairs(kinds: Sequence[str]) -> list[tuple[int, int]]:
    return [(c, d) for c in range(len(kinds)) for d in range(c) if kinds[c] == kinds[d]]


def _correlation(one: Array, other: Array) -> float:
    size = float(one.std() * other.std())
    return float(np.mean((one - one.mean()) * (other - other.mean())) / size) if size > 0 else 0.0


def _chance(correlation: float, session: SimulationSession) -> float:
    """Probability of such a correlation by chance, one independent value a second."""
    n = max(session.n * session.step_s, SIMULATION_INTAKE.least_seconds)
    return float(math.erfc(math.atanh(min(abs(correlation), 1 - 1e-12)) * math.sqrt((n - 3) / 2)))
