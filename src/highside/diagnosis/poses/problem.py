"""A stepped session prepared for the diagnosis: columns and noise pose by pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term, pose_flips, threshold
from highside.diagnosis.core.candidates import CHANNELS, Candidate, pose_candidates, unnamed_interactions
from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.fit import JointFit, Observed, base_fit, joint_fit
from highside.diagnosis.core.floor import Excess, excess
from highside.diagnosis.core.held_out import HeldOutBlocks, PoseGains, block_proof, pose_folds
from highside.diagnosis.core.location import locate, locate_whole, on_channel, pose_bases, pose_cells, scan_of
from highside.diagnosis.core.memory import Channel, Likelihoods, Memory, SlowEffect
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.policy import FITS, RIVALS, SELECTION
from highside.diagnosis.core.problem import ReportData, SelectionState, parts_of
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import DiagnosisResult, Fit, Location
from highside.diagnosis.core.rivals import Rivalry, next_poses
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.still_problem import StillProblem
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.core.untestable import with_manoeuvres
from highside.diagnosis.poses import noise as noise_model
from highside.diagnosis.poses.noise import PoseNoise
from highside.diagnosis.poses.policy import POSE_ADVICE, POSES
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.poses.within import with_courses
from highside.physics.forward import ForwardModel
from highside.physics.gravity import unit


@dataclass(frozen=True)
class PoseProblem(StillProblem[PoseNoise]):
    """n poses with known attitudes."""

    session: PoseSession
    model: ForwardModel
    base: Array
    """(P, 3, n)"""
    residual: Array
    """(3, n) g after the base fit"""
    tangents: Array
    rich: Array
    white_noise: PoseNoise
    force: Array

    readings = "pose means"

    @classmethod
    def of(
        cls, session: PoseSession, model: ForwardModel, free: tuple[str, ...], seed: int, method: ProcedureParts = WHOLE
    ) -> PoseProblem:
        """Fit the base, make the columns, learn the noise."""
        state = session.state
        observed = Observed(state, session.mean)
        model, residual = base_fit(model, observed, free)
        base = observed.jacobian(model, free)
        tangents = np.asarray(model.pose_sensitivity(state), dtype=float)[:, [0, 2]].transpose(1, 0, 2)
        candidates, unobservable = pose_candidates(model, state, free)
        force = np.asarray(model.chain(state).force, dtype=float)
        candidates += unnamed_interactions(state, force)
        rich = _rich(base, candidates, session, force)
        noise = _learned(session, residual, rich, tangents, method)
        return cls(
            candidates,
            unobservable,
            free,
            seed,
            session,
            model,
            base,
            residual,
            tangents,
            rich,
            noise,
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
    def channels(self) -> tuple[str, ...]:
        return CHANNELS

    @property
    def noise(self) -> PoseNoise:
        return self.white_noise

    def prepare(self, noise: PoseNoise) -> SelectionState[PoseNoise]:
        rng = np.random.default_rng(self.seed)
        fitted = self.base if self.method.refit else self.base[:0]
        base = span(noise.white(fitted))
        residual = outside(base, noise.white(self.residual))
        candidate_set = CandidateSet(
            self.candidates, all_white(noise, [v.columns for c in self.candidates for v in c.variants])
        )
        rich = noise_model.rich_residual(noise, self.residual, self.rich)
        if not self.method.colour:
            # nothing is remembered: chance is what the F test says
            rich = np.zeros_like(rich)
        limit = threshold(candidate_set.score_test, candidate_set.owner, pose_flips(rich, rng), base, noise.freedom)
        rows = noise.white(fitted), noise.white(self.residual)
        folds, apart = (pose_folds(self.session.n, interleaved=i) for i in (False, True))
        gains = PoseGains(candidate_set, HeldOutBlocks(*rows, folds), HeldOutBlocks(*rows, apart))
        selector = Selector(
            candidate_set, base, residual, noise.freedom, limit, gains, residual.size, starts=SELECTION.starts
        )
        bases = pose_bases(self.session.state, self.force)
        cells = [(channel, b) for b in range(len(bases)) for channel in range(3)]
        groups = all_white(noise, [on_channel(bases[b].functions, c) for c, b in cells])
        scan = scan_of(bases, groups, cells, noise.freedom)
        scan_limit = threshold(scan.score_test, np.arange(len(cells)), pose_flips(rich, rng), base, noise.freedom)
        return SelectionState(selector, scan, scan_limit, [], noise)

    def likelihoods(self, terms: Sequence[Term]) -> list[Channel]:
        variance = noise_model.white_variance(self.noise, self.tangents)
        explained = np.concatenate([self.base, self.block(terms)])
        t_s = self.session.state.t_s
        return [Likelihoods(self.residual[c], variance[c], explained[:, c], t_s) for c in range(3)]

    def block(self, terms: Sequence[Term]) -> AnyArray:
        return np.concatenate([np.empty((0, 3, self.session.n)), *(self.variant(m).columns for m in terms)])

    def slow(self) -> list[SlowEffect]:
        return [
            SlowEffect(i, j, np.broadcast_to(v.columns[0, 0], (3, self.session.n)))
            for i, c in enumerate(self.candidates)
            if c.slow
            for j, v in enumerate(c.variants)
            if v.whole
        ]

    def with_memory(self, memories: Sequence[Memory]) -> PoseNoise:
        return noise_model.with_memory(self.noise, memories, self.tangents, self.session.state.t_s)

    def relinearised(self, second_order: Array | float, *, learn: bool = True) -> PoseProblem:
        left = self.residual + self.second_order - second_order
        noise = _learned(self.session, left, self.rich, self.tangents, self.method) if learn else self.white_noise
        return replace(self, residual=left, white_noise=noise, second_order=second_order)

    def fit(self, terms: Sequence[Term], noise: PoseNoise, *, with_second_order: bool = True) -> JointFit:
        observed = Observed(self.session.state, self.session.mean)
        free = self.free if self.method.refit else ()
        return joint_fit(
            self.model,
            observed,
            free,
            self.candidates,
            terms,
            noise,
            self.noise.freedom,
            with_second_order=with_second_order,
        )

    def locate(
        self, selection: SelectionState[PoseNoise], signal: Array, space: Array, p: float, share: float
    ) -> tuple[Location, ...]:
        return locate(selection.scan, signal, space, p, share)

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

    def floor_excess(self, terms: Sequence[Term], *, pose_errors: bool = True) -> Excess | None:
        floor = self.session.floor
        if floor is None:
            return None
        columns = np.concatenate([self.base, self.block(terms)])
        if not (pose_errors and (self.noise.inc or self.noise.tf)):
            return excess(self.residual, columns, floor)
        # an error of a set angle moves the reading across gravity and leaves its magnitude
        normal = unit(self.force)
        along = np.sum(normal * self.residual, axis=0)[None]
        return excess(along, np.sum(normal * columns, axis=1)[:, None], floor.projected(normal))

    def completed(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        inc, tf = float(self.noise.inc), float(self.noise.tf)
        if diagnosis.verdict == "nothing_left_out" and max(inc, tf) > float(np.max(self.noise.sigma)):
            # in g per radian: what is left across gravity is larger than the sensor's own noise, and is taken for noise
            words = f"what is left is taken for errors of the set angles: {np.degrees(inc):.2g} deg of inclination, "
            diagnosis = hinted(diagnosis, f"{words}{np.degrees(tf):.2g} deg of toolface")
        placed = with_manoeuvres(located_by_cause(diagnosis, self.model, self.session.state), self.session.state)
        return with_courses(placed, self.session.within)

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

    def proof(self, terms: Sequence[Term], fit: JointFit) -> Fit:
        folds = pose_folds(self.session.n)
        words = f"{len(folds)} contiguous blocks of poses"
        flat = self.residual.reshape(-1)
        base, claimed = (c.reshape(-1, flat.size) for c in (self.base, self.block(terms)))
        plain = HeldOutBlocks(base, flat, folds)
        if any(plain.hides(self.block([m]).reshape(-1, flat.size)) for m in terms):
            folds = pose_folds(self.session.n, interleaved=True)
            words = f"{len(folds)} sets of every {len(folds)}th pose, since what was found lives within few poses"
        floor = float(np.sqrt(np.mean(self.noise.sigma**2)))
        after = fit.residual if fit.parameters else self.residual
        found = block_proof(base, flat, claimed, folds, after, floor, words)
        return replace(found, rmse_before=float(np.sqrt(np.mean((self.residual + self.second_order) ** 2))))

    def report_data(self, fit: JointFit | None) -> ReportData:
        return ReportData(
            self.session,
            self.residual + self.second_order,
            self.residual if fit is None else fit.residual,
            recorded=self.session.mean,
            parts=parts_of(self.model, fit, Observed(self.session.state, self.session.mean)),
            sigma=_of_one_pose(self.noise),
        )

    def noise_summary(self) -> dict[str, Any]:
        noise = self.noise
        return {
            "model": "per channel and pose" if noise.inc or noise.tf else "per channel",
            "sigma_g": [float(s) for s in noise.sigma],
            "bench_inclination_rad": noise.inc,
            "bench_toolface_rad": noise.tf,
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
        uneven=method.colour,
    )


def _rich(base: Array, candidates: Sequence[Candidate], session: PoseSession, force: Array) -> Array:
    """Columns (P, 3, n) of everything that could be systematic, as many as the session affords."""
    whole = [[v.columns for v in c.variants if v.whole] for c in candidates if c.named]
    parts = [base, *(columns[0] for columns in whole if len(columns) == 1)]
    groups = [on_channel(b.functions, channel) for b in pose_bases(session.state, force) for channel in range(3)]
    shaped = [columns[i] for columns in whole if len(columns) > 1 for i in _spread(len(columns), POSE_ADVICE.shapes)]
    room = int(FITS.rich_share * 3 * session.n)
    kept: list[Array] = []
    used = 0
    for part in [*parts, *shaped, *groups]:
        if used + len(part) <= room or not kept:
            kept.append(part)
            used += len(part)
    return np.concatenate(kept)


def all_white(noise: PoseNoise, blocks: Sequence[Array]) -> list[Array]:
    """Each block (k, 3, n) whitened, (k, 3 n): in one pass, since one pass in time order serves any number."""
    ends = np.cumsum([len(block) for block in blocks])[:-1]
    return np.split(noise.white(np.concatenate(blocks)), ends)


def _spread(count: int, want: int) -> list[int]:
    return sorted({round(x) for x in np.linspace(0, count - 1, min(want, count))})


def _of_one_pose(noise: PoseNoise) -> tuple[float, ...]:
    """Standard deviation of each channel at a pose, errors of the setting included: the mean over the poses."""
    mixing = np.linalg.inv(np.moveaxis(noise.whitening, 2, 0))
    return tuple(float(s) for s in np.sqrt(np.mean(np.sum(mixing**2, axis=2), axis=0)))
