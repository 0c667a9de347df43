"""What a rotation leaves beside base, names and laws: is it noise of sensors?

The noise of rows is learned from what is left, so an error of the angles that no effect and no smooth law follows, a
motion or a vibration pass for its colour, however large they are. The floor that they cannot raise is that of
`simulation.band` and `simulation.independence`: noise of a sensor has no less power at lower frequencies than at higher
ones. Channels that a converter rounds coarsely are left aside, as the spectrum of rounding follows the reading. That
channels depart together is no finding here: errors of the set angles do that, and are noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.floor import lattice_step
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.rows.session import ACCEL, RotationSession
from highside.diagnosis.simulation.band import humps, with_humps
from highside.diagnosis.simulation.independence import no_noise, with_no_noise

UNTOUCHED = frozenset({"bad_data", "wander"})


def beside_noise(diagnosis: DiagnosisResult, report: ReportData, session: RotationSession) -> DiagnosisResult:
    """The diagnosis where what is left (C, n) departs from the noise of sensors: then something was left out."""
    own = [c for c in range(len(session.channels)) if not _rounded(session.readings[c], report.after[c])]
    if diagnosis.verdict in UNTOUCHED or not own:
        return diagnosis
    left, kept = _in_steps(report.after[own], session)
    names = [session.channels[c] for c in own]
    units = ["g" if name in ACCEL else "rad/s" for name in names]
    found = humps(left, session.step_s, ~kept, names, units)
    told = with_humps(diagnosis, found)
    if found and told.verdict == "not_testable":
        # no colour of a sensor's noise explains that
        told = replace(told, verdict="unknown")
    if told.verdict != "nothing_left_out":
        return told
    departs = no_noise(left, None, session.step_s, ~kept, names)
    return with_no_noise(told, departs, report.after[own], session.state.t_s, names)


def _rounded(reading: Array, left: Array) -> bool:
    """Whether what is left of a channel is as coarse as its converter's steps."""
    return bool(np.std(left) < FLOOR.dither * lattice_step(reading))


def _in_steps(rows: Array, session: RotationSession) -> tuple[Array, np.ndarray]:
    """Rows (C, n) at equal steps of time (C, m), 0 where one is missing, and which are there (m,)."""
    places = session.places.astype(np.intp)
    kept = np.ones(session.n, dtype=bool) if session.omitted is None else ~session.omitted
    even = np.zeros((len(rows), int(places[-1]) + 1))
    there = np.zeros(even.shape[1], dtype=bool)
    even[:, places[kept]], there[places[kept]] = rows[:, kept], True
    return even, there
