"""Readings of a hand session that do not belong to the others, left out before it is diagnosed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.floor import NoiseFloor
from highside.diagnosis.core.outlying import outlying_findings
from highside.diagnosis.core.regression import span
from highside.diagnosis.core.result import Finding
from highside.diagnosis.magnitude.observed import Magnitudes
from highside.diagnosis.magnitude.policy import MAGNITUDE_SESSIONS
from highside.diagnosis.magnitude.session import Ints, MagnitudeSession
from highside.physics.forward import ForwardModel


def without_outlying_readings(
    session: MagnitudeSession, model: ForwardModel, free: Sequence[str]
) -> tuple[MagnitudeSession, tuple[Finding, ...]]:
    """The session without the readings whose magnitude does not belong to the others, and a finding for each.

    A rest is left as it is: its blocks follow time, and a short disturbance is judged there.
    """
    if session.rest or not free:
        return session, ()
    observed = Magnitudes(session)
    fitted, residual = base_fit(model, observed, free)
    names = fitted.free_names(list(free))
    columns = observed.shown(observed.jacobian(fitted, names), names)

    def place(reading: int) -> str:
        return f"reading {reading + 1} of {session.n}, at {session.t_s[reading] - session.began_s:.6g} s"

    covariates = (session.temp_c, session.vibration_rms_g)
    out, findings = outlying_findings(residual, columns, ("g_total",), place, covariates)
    return (_select(session, np.setdiff1d(np.arange(session.n), out)), findings) if out else (session, ())


def too_few(session: MagnitudeSession, model: ForwardModel, free: Sequence[str]) -> tuple[str, str] | None:
    """Of a few averages beside what may be refitted: in words why nothing can be tested, and what would help; None
    where they are enough."""
    if not session.few:
        return None
    observed = Magnitudes(session)
    rank = len(span(observed.jacobian(base_fit(model, observed, free)[0], free)[:, 0])) if free else 0
    least = rank + MAGNITUDE_SESSIONS.least_room
    if session.n >= least:
        return None
    why = f"{session.found}, of which {', '.join(free)}, which may be refitted, take up {rank}"
    return why, f"measure at least {least} attitudes all over the sphere; or let less be refitted ([sensor] free)"


def _select(session: MagnitudeSession, readings: Ints) -> MagnitudeSession:
    group = np.unique(session.group[readings], return_inverse=True)[1].reshape(-1)
    floor = session.floor
    return replace(
        session,
        mean=session.mean[:, readings],
        count=session.count[readings],
        group=group,
        t_s=session.t_s[readings],
        temp_c=session.temp_c[readings],
        vibration_rms_g=session.vibration_rms_g[readings],
        attitudes=min(session.attitudes, int(group.max()) + 1),
        floor=None if floor is None else NoiseFloor(floor.sigma[:, readings], floor.freedom),
    )
