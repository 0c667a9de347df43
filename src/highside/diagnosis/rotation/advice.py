"""What to turn next: stretches of rotation that raise most the smallest evidence of a claim against any rival.

Tried are steady rates in both senses at several inclinations, and quick ramps to a rate and back. What was measured
counts by a sample of its rows; how much evidence a stretch adds follows from the columns alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.rivals import beyond
from highside.diagnosis.rotation.policy import ROTATION_ADVICE
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.plan import RotationPlan, Session, Site
from highside.physics.state import ChainState


@dataclass(frozen=True)
class Stretch:
    """A manoeuvre of `ROTATION_ADVICE.seconds`: a steady rate, or ramps between standstill and the rate."""

    inclination_deg: float
    rate_hz: float
    ramps: bool

    @property
    def words(self) -> str:
        """In words for the person at the bench."""
        how = "ramps of 1 s between standstill and" if self.ramps else "steady"
        return f"{how} {360 * self.rate_hz:g} deg/s at inclination {self.inclination_deg:g} deg"


@dataclass(frozen=True)
class RateAdvice:
    """Stretches, and by how much they raise the evidence between the rivals."""

    stretches: tuple[Stretch, ...]
    before: float
    after: float


def next_rates(
    model: ForwardModel,
    session: RotationSession,
    free: Sequence[str],
    claim: tuple[Candidate, dict[str, float], Array],
    rivals: Sequence[tuple[Candidate, dict[str, float]]],
    white_per_unit: Array,
) -> RateAdvice:
    """`claim`: the candidate, its shape and fitted amplitudes; `white_per_unit` (C,): 1 / noise of a row."""
    rows = np.unique(np.linspace(0, session.n - 1, min(ROTATION_ADVICE.rows, session.n)).astype(int))
    tried = [
        Stretch(i, s * r, False)
        for i in ROTATION_ADVICE.inclinations_deg
        for r in ROTATION_ADVICE.rates_hz
        for s in (1, -1)
    ]
    tried += [Stretch(i, r, True) for i in ROTATION_ADVICE.inclinations_deg for r in ROTATION_ADVICE.ramps_hz]
    candidate, shape, amplitude = claim
    weight = white_per_unit[:, None]

    def gram(state: ChainState, rival: tuple[Candidate, dict[str, float]], times: float) -> Array:
        observed = Observed(state, np.zeros((white_per_unit.size, state.n)))
        assert candidate.effect is not None and rival[0].effect is not None
        signal = np.tensordot(amplitude, observed.columns(model, candidate.effect, shape), 1)[None]
        every = [signal, observed.jacobian(model, free), observed.columns(model, rival[0].effect, rival[1])]
        flat = (np.concatenate(every) * weight).reshape(sum(map(len, every)), -1)
        return np.asarray(times * flat @ flat.T)

    measured = [gram(session.state.rows(rows), rival, session.n / rows.size) for rival in rivals]
    per_row = 1 / (session.step_s * ROTATION_ADVICE.sample_hz)
    added = [[gram(_turned(stretch, session.state), rival, per_row) for stretch in tried] for rival in rivals]
    before = min(float(beyond(g[None])[0]) for g in measured)
    chosen: list[int] = []
    for _ in range(ROTATION_ADVICE.stretches):
        worst = np.min([beyond(g[None] + np.stack(new)) for g, new in zip(measured, added, strict=True)], axis=0)
        chosen.append(int(np.argmax(worst)))
        measured = [g + new[chosen[-1]] for g, new in zip(measured, added, strict=True)]
    after = min(float(beyond(g[None])[0]) for g in measured)
    return RateAdvice(tuple(dict.fromkeys(tried[k] for k in chosen)), before, after)


def _turned(stretch: Stretch, last: ChainState) -> ChainState:
    """The rows of a stretch; temperature and vibration as they were at the end."""
    rate = 2 * np.pi * stretch.rate_hz
    site = Site(last.gravity_mps2, last.latitude_rad, last.azimuth_rad)
    if stretch.ramps:
        turns = int(ROTATION_ADVICE.seconds / ROTATION_ADVICE.ramp_s)
        plan = RotationPlan(stretch.inclination_deg, (0.0, rate) * turns, 1.0, 1.0, ROTATION_ADVICE.sample_hz)
    else:
        plan = RotationPlan(stretch.inclination_deg, (rate,), ROTATION_ADVICE.seconds, 0.0, ROTATION_ADVICE.sample_hz)
    state = Session(plan, site).rows().state
    n = state.n
    return replace(
        state,
        t_s=state.t_s + last.t_s[-1],
        temp_c=np.full(n, float(last.temp_c[-1])),
        vibration_rms_g=np.full(n, float(last.vibration_rms_g[-1])),
    )
