"""A stepped session prepared for the diagnosis: columns and noise pose by pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import CHANNELS, pose_candidates, unnamed_interactions
from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.effect_scores import WhiteLaw
from highside.diagnosis.core.fit import JointFit, base_fit
from highside.diagnosis.core.floor import Excess, excess
from highside.diagnosis.core.location import locate_whole, pose_bases, pose_cells
from highside.diagnosis.core.memory import Memory
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.policy import RIVALS, SELECTION
from highside.diagnosis.core.pooled_laws import pooled_laws
from highside.diagnosis.core.problem import ReportData, SelectionState, parts_of
from highside.diagnosis.core.problem_policy import OWN_NOISE, ProblemPolicy
from highside.diagnosis.core.regression import outside
from highside.diagnosis.core.result import DiagnosisResult, Finding, Location
from highside.diagnosis.core.rivals import Rivalry, next_poses
from highside.diagnosis.core.set_angle_errors import taken_for_set_angles, turned_by_set_angles
from highside.diagnosis.core.still_problem import StillProblem, rich_columns
from highside.diagnosis.core.untestable import one_sided, with_manoeuvres
from highside.diagnosis.poses import noise as noise_model
from highside.diagnosis.poses.noise import PoseNoise
from highside.diagnosis.poses.one_side import OneSide
from highside.diagnosis.poses.policy import POSES
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.poses.within import unsteady_poses, with_courses
from highside.physics.effects import registry
from highside.physics.forward import ForwardModel
from highside.physics.gravity import unit

BENCH = ("bench_inclination_rad", "bench_toolface_rad", "bench_across_rad")
"""names of the scatter of the set angles, in the order of `turned_by_set_angles`"""


@dataclass(frozen=True)
class PoseProblem(StillProblem[PoseNoise]):
    """n poses with known attitudes."""

    session: PoseSession
    observed: Observed
    tangents: Array
    """(2, 3, n) g/rad: change of the reading with the two set angles"""
    force: Array
    """(3, n) g"""

    readings = "pose means"
    starts = SELECTION.starts

    @classmethod
    def of(
        cls, session: PoseSession, model: ForwardModel, free: tuple[str, ...], seed: int, method: ProcedureParts = WHOLE
    ) -> PoseProblem:
        """Fit the base, make the columns, learn the noise."""
        state = session.state
        observed = Observed(state, session.mean)
        model, residual = base_fit(model, observed, free)
        base = observed.jacobian(model, free)
        tangents = turned_by_set_angles(model, state)
        candidates, unobservable = pose_candidates(model, state, free)
        force = np.asarray(model.chain(state).force, dtype=float)
        candidates += unnamed_interactions(state, force)
        bases = pose_bases(state, force)
        rich = rich_columns(base, candidates, bases)
        noise = _learned(session, residual, rich, tangents, method)
        return cls(
            candidates,
            unobservable,
            free,
            seed,
            session,
            model,
            observed,
            bases,
            base,
            residual,
            rich,
            noise,
            tangents,
            force,
            method=method,
        )

    @property
    def policy(self) -> ProblemPolicy:
        return POSES

    @property
    def relinearises(self) -> bool:
        return True

    @property
    def noise_size(self) -> float:
        return float(np.sqrt(np.mean(self.noise.sigma**2)))

    def variance(self) -> Array:
        return noise_model.white_variance(self.noise, self.tangents)

    def with_memory(self, memories: Sequence[Memory]) -> PoseNoise:
        return noise_model.with_memory(self.noise, memories, self.tangents, self.session.state.t_s)

    def relinearised(self, second_order: Array | float, *, learn: bool = True) -> PoseProblem:
        left = self.residual + self.second_order - second_order
        noise = _learned(self.session, left, self.rich, self.tangents, self.method) if learn else self.white_noise
        return replace(self, residual=left, white_noise=noise, second_order=second_order)

    def learned_beside(self, selection: SelectionState[PoseNoise]) -> PoseProblem | None:
        left = self.mean_square_left(selection)
        if not selection.terms or left is None or left >= OWN_NOISE.below:
            return None
        # what the terms explain was no noise: they are the first of what could be systematic
        rich = rich_columns(np.concatenate([self.base, self.block(selection.terms)]), self.candidates, self.bases)
        noise = _learned(self.session, self.residual, rich, self.tangents, self.method)
        return replace(self, rich=rich, white_noise=noise)

    def locate_whole(
        self, selection: SelectionState[PoseNoise], signal: Array, terms: Sequence[Term], p: float, share: float
    ) -> tuple[Location, ...]:
        space = selection.selector.space_with(terms)
        residual = outside(space, selection.selector.residual)
        cells = pose_cells(self.session.state)
        found = locate_whole(selection.scan, cells, selection.noise.white, residual, space, signal)
        if found is None:
            return ()
        channels, covariate, where, harmonic = found
        return (Location(tuple(CHANNELS[c] for c in channels), covariate, where, harmonic, share, p),)

    def pooled_laws(self, noise: PoseNoise) -> list[WhiteLaw]:
        laws = pooled_laws(self.session.state, self.force)
        return [WhiteLaw(one.name, one.parameters, one.units, noise.white(one.columns)) for one in laws]

    def floor_excess(self, terms: Sequence[Term], *, pose_errors: bool = True) -> Excess | None:
        floor = self.session.floor
        if floor is None:
            return None
        columns = np.concatenate([self.base, self.block(terms)])
        if not (pose_errors and self.noise.bench.any()):
            return excess(self.residual, columns, floor)
        # an error of a set angle moves the reading across gravity and leaves its magnitude
        normal = unit(self.force)
        along = np.sum(normal * self.residual, axis=0)[None]
        return excess(along, np.sum(normal * columns, axis=1)[:, None], floor.projected(normal))

    def completed(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        if diagnosis.verdict == "nothing_left_out" and self.noise.bench.max() > self.noise.sigma.max():
            # in g per radian: what is left across gravity is larger than the sensor's own noise, and is taken for noise
            diagnosis = taken_for_set_angles(diagnosis, self.noise.bench)
        placed = with_manoeuvres(located_by_cause(diagnosis, self.model, self.session.state), self.session.state)
        return self._one_side.told(with_courses(placed, self.session.within or self._unsteady()))

    def _unsteady(self) -> tuple[Finding, ...]:
        """What the rows do while a pose is held, where they scatter by far more than their means do."""
        session = self.session
        if session.scatter is None:
            return ()
        return unsteady_poses(session.scatter, session.count, np.array(_of_one_pose(self.noise)), self.noise.freedom)

    @property
    def _one_side(self) -> OneSide:
        state = self.session.state
        constants = tuple(one.effect for one in self.unobservable if one_sided(one.effect, state))
        if not self.session.sides_told:
            # they may all have been approached from one side, whatever the order of the toolfaces
            state = replace(state, direction=np.ones(state.n))
            constants = tuple(one for one in registry().values() if one_sided(one, state))
        return OneSide(state, self.model, self.force, self.base, self.noise, constants)

    def advice(self, term: Term, r: Rivalry, fit: JointFit) -> str:
        candidate = self.candidates[term.candidate]
        assert candidate.effect is not None
        rivals = [(self.candidates[k], self.variant(r.best[k]).shape) for k in r.same if k != term.candidate]
        amplitude = np.array([fit.parameters[candidate.id][name].value for name in candidate.amplitudes])
        advice = next_poses(
            self.model,
            self.session.state,
            self.free,
            (candidate, self.variant(term).shape, amplitude),
            rivals,
            self.base,
            1.0 / self.noise.sigma,
        )
        if advice.after < max(2 * advice.before, RIVALS.same_class_evidence):
            return candidate.effect.splitter
        words = ", ".join(f"({inc:g}, {tf:g}{', from the other side' if d < 0 else ''})" for inc, tf, d in advice.poses)
        return f"measure these poses (inclination, toolface in deg): {words}; otherwise: {candidate.effect.splitter}"

    def report_data(self, fit: JointFit | None) -> ReportData:
        return ReportData(
            self.session,
            self.residual + self.second_order,
            self.residual if fit is None else fit.residual,
            recorded=self.session.mean,
            parts=parts_of(self.model, fit, self.observed),
            sigma=_of_one_pose(self.noise),
        )

    def noise_summary(self) -> dict[str, Any]:
        noise = self.noise
        return {
            "model": "per channel and pose" if noise.bench.any() else "per channel",
            "sigma_g": [float(s) for s in noise.sigma],
            **{name: float(size) for name, size in zip(BENCH, noise.bench, strict=True)},
            "size_over_time": [float(noise.size.min()), float(noise.size.max())],
            "degrees_of_freedom": noise.freedom,
        }


def _learned(session: PoseSession, residual: Array, rich: Array, tangents: Array, method: ProcedureParts) -> PoseNoise:
    """The noise of what the rich model does not explain."""
    return noise_model.estimate(
        residual,
        rich,
        tangents if method.colour else np.zeros_like(tangents),
        scatter=session.scatter,
        floor=None if session.floor is None else session.floor.sigma,
        uneven=method.colour,
    )


def _of_one_pose(noise: PoseNoise) -> tuple[float, ...]:
    """Standard deviation of each channel at a pose, errors of the setting included: the mean over the poses."""
    mixing = np.linalg.inv(np.moveaxis(noise.whitening, 2, 0))
    return tuple(float(s) for s in np.sqrt(np.mean(np.sum(mixing**2, axis=2), axis=0)))
