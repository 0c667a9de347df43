"""A subsample of a long recording's rows, fitted before all: what is strong shows there, and what is far off is ruled
out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.fit import JointFit, base_fit, joint_fit, second_order_of
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.policy import FITS
from highside.diagnosis.core.problem import Problem
from highside.diagnosis.rotation.policy import PILOT
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.policy import ROW_NOISE
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel


@dataclass(frozen=True)
class PilotFit:
    """What a subsample of a long recording says: their noise, and the terms that they name."""

    session: RotationSession
    noise: RotationNoise
    candidates: Sequence[Candidate]
    terms: Sequence[Term]
    has_second_order: bool
    """whether anything beyond first order was taken out"""

    @classmethod
    def of(cls, session: RotationSession, problem: Problem[RotationNoise], terms: Sequence[Term]) -> PilotFit:
        """What was chosen in the problem of these rows."""
        named = [m for m in terms if problem.candidates[m.candidate].named]
        return cls(session, problem.noise, problem.candidates, named, problem.has_second_order)

    @property
    def names(self) -> list[str]:
        """Ids of the effects."""
        return [self.candidates[m.candidate].id for m in self.terms]


@dataclass(frozen=True)
class Subsample:
    """A subsample of a long recording's rows: fits begin there, and rivals far behind are ruled out by them."""

    session: RotationSession
    noise: RotationNoise
    fits: dict[frozenset[Term], JointFit] = field(default_factory=dict)
    """terms fitted to these rows"""

    @property
    def observed(self) -> Observed:
        """The rows, as a fit sees them."""
        return Observed(self.session.state, self.session.readings)


def may_be_nonlinear(session: RotationSession, model: ForwardModel, free: Sequence[str], seed: int) -> bool:
    """Whether what the base leaves of a subsample is so large that its square, in g, may show in all of them.

    What is done beyond first order is of that size. The noise is distinguished from it by second differences.
    """
    subsample = session.thinned(PILOT.pilot_rows, seed)
    model, left = base_fit(model, Observed(subsample.state, subsample.readings), free)
    noise = np.zeros(3)
    starts = np.linspace(0, session.n - PILOT.neighbours, ROW_NOISE.windows).astype(int)
    for start in starts:
        rows = slice(int(start), int(start) + PILOT.neighbours)
        near = Observed(session.state.rows(rows), session.readings[:, rows]).residual(model)[:3]
        noise += np.mean(np.diff(near, 2, axis=1) ** 2, axis=1) / 6 / starts.size
    size = np.maximum(np.mean(left[:3] ** 2, axis=1) - noise, 0.0)
    return bool(np.any(size > np.sqrt(noise * FITS.second_order / session.n)))


def pilot_second_order(
    model: ForwardModel, observed: Observed, free: Sequence[str], subsample: Subsample, pilot: PilotFit
) -> Array | float:
    """(C, n) what the terms of a pilot fit do beyond first order in all rows, at the sizes that fit the subsample.

    The second-order part is small beside its effect, so sizes need be known no better than that.
    """
    near = joint_fit(
        model, subsample.observed, free, pilot.candidates, pilot.terms, subsample.noise, subsample.noise.freedom
    )
    return (
        0.0
        if near.second_order is None
        else second_order_of(model, near, observed, free, pilot.candidates, pilot.terms)
    )
