"""Some rows of a long recording, asked before all: what is strong shows there, and what is far off is ruled out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.fit import JointFit, Observed, base_fit, bend_of, joint_fit
from highside.diagnosis.core.policy import FITS
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.scene import Scene
from highside.diagnosis.rotation.policy import SKETCH
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.policy import ROW_NOISE
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel


@dataclass(frozen=True)
class Sketch:
    """What some rows of a long recording say: their noise, and the members that they name."""

    session: RotationSession
    noise: RotationNoise
    candidates: Sequence[Candidate]
    members: Sequence[Member]
    bent: bool
    """whether anything beyond first order was taken out"""

    @classmethod
    def of(cls, session: RotationSession, scene: Scene[RotationNoise], members: Sequence[Member]) -> Sketch:
        """What was chosen in the scene of these rows."""
        named = [m for m in members if scene.candidates[m.candidate].named]
        return cls(session, scene.noise, scene.candidates, named, scene.bent)

    @property
    def names(self) -> list[str]:
        """Ids of the effects."""
        return [self.candidates[m.candidate].id for m in self.members]


@dataclass(frozen=True)
class Some:
    """Some rows of a long recording: fits begin there, and rivals far behind are ruled out by them."""

    session: RotationSession
    noise: RotationNoise
    fits: dict[frozenset[Member], JointFit] = field(default_factory=dict)
    """members fitted to these rows"""

    @property
    def seen(self) -> Observed:
        """The rows, as a fit sees them."""
        return Observed(self.session.state, self.session.readings)


def may_bend(session: RotationSession, model: ForwardModel, free: Sequence[str], seed: int) -> bool:
    """Whether what the base leaves of some rows is so large that its square, in g, may show in all of them.

    What is done beyond first order is of that size. The noise is told from it by second differences.
    """
    some = session.thinned(SKETCH.some_rows, seed)
    model, left = base_fit(model, Observed(some.state, some.readings), free)
    noise = np.zeros(3)
    starts = np.linspace(0, session.n - SKETCH.neighbours, ROW_NOISE.windows).astype(int)
    for start in starts:
        rows = slice(int(start), int(start) + SKETCH.neighbours)
        near = Observed(session.state.rows(rows), session.readings[:, rows]).residual(model)[:3]
        noise += np.mean(np.diff(near, 2, axis=1) ** 2, axis=1) / 6 / starts.size
    size = np.maximum(np.mean(left[:3] ** 2, axis=1) - noise, 0.0)
    return bool(np.any(size > np.sqrt(noise * FITS.bends / session.n)))


def sketched_bend(
    model: ForwardModel, seen: Observed, free: Sequence[str], some: Some, sketch: Sketch
) -> Array | float:
    """(C, n) what the members of a sketch do beyond first order in all rows, at the sizes that fit some of them.

    A bend is small beside its effect, so sizes need be known no better than that.
    """
    near = joint_fit(model, some.seen, free, sketch.candidates, sketch.members, some.noise, some.noise.freedom)
    return 0.0 if near.bend is None else bend_of(model, near, seen, free, sketch.candidates, sketch.members)
