"""The magnitude of gravity as an observable: what is left of a triad's reading where the attitude is not known.

A reading m of a sensor S at rest fulfils m = S(u), |u| = 1, u unknown. With J = dS/du and n = J^-T u, an error of the
reading along J t, t across u, is one of attitude; what remains of it is its projection on n. So the residual is
n . (m - S(u)), which is |S^-1(m)| - 1 to first order, and a term that adds d to the reading adds n . d. What only
turns the reading (the bench's angles, the mounting, the antisymmetric part of the matrix) adds nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import columns_of
from highside.diagnosis.magnitude.policy import OBSERVATION
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.physics.effect import Effect
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from highside.physics.gravity import unit
from highside.physics.state import ChainState


@dataclass(frozen=True)
class Aligned:
    """A model with the attitude of each reading fitted: state, projection `normal` (3, n), residual (n,) in g."""

    state: ChainState
    normal: Array
    residual: Array


@dataclass
class Magnitudes:
    """The readings of a session for the fits of `fit`: one channel, the magnitude in g."""

    session: MagnitudeSession
    gyros: bool = False
    _last: tuple[ForwardModel, Aligned] | None = field(default=None, repr=False)
    _shown: dict[tuple[str, ...], Array] = field(default_factory=dict, repr=False)

    @property
    def channels(self) -> int:
        return 1

    def aligned(self, model: ForwardModel) -> Aligned:
        """The attitudes under which a model comes nearest to the readings."""
        if self._last is not None and self._last[0] is model:
            return self._last[1]
        session, direction = self.session, self.session.direction
        for _ in range(OBSERVATION.turns):
            state = session.state_at(direction)
            chain = model.chain(state)
            inverse = np.linalg.inv(model.sensitivity(state, chain).transpose(2, 0, 1))
            force = chain.force
            missing = np.einsum("nij,jn->in", inverse, session.mean - chain.reported)
            across = missing - unit(force) * np.sum(unit(force) * missing, axis=0)
            # an effect of the pose or mounting turns what the triad feels against the direction set: the same turn
            turned = unit(direction + session.by_group(across))
            moved = float(np.max(np.abs(turned - direction)))
            direction = turned
            if moved < OBSERVATION.still:
                break
        normal = np.einsum("nij,in->jn", inverse, unit(force))
        found = Aligned(state, normal, np.sum(normal * (session.mean - chain.reported), axis=0))
        self._last = (model, found)
        return found

    def project(self, aligned: Aligned, columns: Array) -> Array:
        """(k, 3, n) changes of the reading -> (k, 1, n) changes of its magnitude; what only turns it becomes zero."""
        observed = np.einsum("in,kin->kn", aligned.normal, columns)
        size = np.linalg.norm(columns, axis=(1, 2))
        observed[np.linalg.norm(observed, axis=1) < OBSERVATION.rounding * size] = 0.0
        return np.asarray(observed[:, None, :])

    def residual(self, model: ForwardModel) -> Array:
        """(1, n) |g| - 1."""
        return self.aligned(model).residual[None]

    def jacobian(self, model: ForwardModel, names: Sequence[str]) -> Array:
        """(P, 1, n) derivatives by the free parameters."""
        if not names:
            return np.empty((0, 1, self.session.n))
        aligned = self.aligned(model)
        return self.project(aligned, np.asarray(model.jacobian(aligned.state, names), dtype=float))

    def columns(self, model: ForwardModel, effect: Effect, shape: dict[str, float]) -> Array:
        """(k, 1, n) by the amplitudes of an effect."""
        aligned = self.aligned(model)
        return self.project(aligned, columns_of(model, aligned.state, effect, shape))

    def step(self, columns: Array, residual: Array, names: Sequence[str]) -> Array:
        """(P,) least-squares step, the smallest one in units of the parameters' typical sizes.

        Much is not determined by a magnitude (in one attitude nearly everything): it stays where it is. So does what
        only turns the reading of an ideal triad: through other errors it shows a little, and would be moved far, till
        its square (a turn of 0.1 rad lengthens by 0.5 %) explains what it has nothing to do with.
        """
        sizes = _sizes(names, columns)
        shown = self.directions(names, sizes)
        solution = np.linalg.lstsq((columns * sizes[:, None]).T @ shown, residual, rcond=OBSERVATION.invisible)[0]
        return np.asarray(sizes * (shown @ solution))

    def shown(self, columns: Array, names: Sequence[str]) -> Array:
        """(r, 1, n) of the columns (P, 1, n) of parameters what a `step` moves."""
        sizes = _sizes(names, columns[:, 0])
        return np.asarray(np.tensordot((sizes[:, None] * self.directions(names, sizes)).T, columns, 1))

    def directions(self, names: Sequence[str], sizes: Array) -> Array:
        """(P, r) orthonormal: in units of `sizes`, the parameters without what an ideal triad's magnitudes ignore."""
        plain = [k for k, name in enumerate(names) if not any(p.shape for p in get(name.partition(".")[0]).parameters)]
        within = tuple(names[k] for k in plain)
        if not plain:
            return np.eye(len(names))
        if within not in self._shown:
            ideal = ForwardModel.of({})
            state = self.session.state
            normal = self.session.direction
            found = np.asarray(ideal.jacobian(state, list(within)), dtype=float)
            self._shown[within] = np.einsum("in,kin->kn", normal, found)
        rows = self._shown[within] * sizes[plain][:, None]
        values, vectors = np.linalg.eigh(rows @ rows.T)
        good = vectors[:, values > OBSERVATION.ideal**2 * values[-1]]
        others = [k for k in range(len(names)) if k not in plain]
        directions = np.zeros((len(names), good.shape[1] + len(others)))
        directions[plain, : good.shape[1]] = good
        directions[others, good.shape[1] :] = np.eye(len(others))
        return directions


def _sizes(names: Sequence[str], columns: Array) -> Array:
    """(P,) sizes of parameters: within an effect as they typically are, so that it is observed as well as any other."""
    owners = np.empty(len(names), dtype=object)
    sizes = np.empty(len(names))
    for k, name in enumerate(names):
        effect_id, _, parameter = name.partition(".")
        own = next(p for p in get(effect_id).parameters if p.name == parameter)
        owners[k] = name if own.shape else effect_id
        sizes[k] = own.typical
    shown = sizes * np.linalg.norm(columns, axis=1)
    for owner in set(owners):
        largest = float(shown[owners == owner].max())
        sizes[owners == owner] /= largest if largest > 0 else 1.0
    return sizes
