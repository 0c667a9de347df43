"""A stepped session prepared for the diagnosis: columns and noise pose by pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import CHANNELS, Candidate, pose_candidates, shadows
from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.fit import JointFit, Observed, base_fit, joint_fit
from highside.diagnosis.core.held_out import HeldOut, PoseGains, block_proof, pose_folds
from highside.diagnosis.core.location import locate, locate_whole, on_channel, pose_bases, pose_cells, scan_of
from highside.diagnosis.core.memory import Channel, Likelihoods, Memory, SlowEffect
from highside.diagnosis.core.method import WHOLE, Method
from highside.diagnosis.core.policy import FITS, RIVALS, SELECTION
from highside.diagnosis.core.pool import Member, Pool, pose_flips, threshold
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Diagnosis, Fit, Location
from highside.diagnosis.core.rivals import Rivalry, next_poses
from highside.diagnosis.core.scene import Judged, Picture, Scene, parts_of
from highside.diagnosis.core.scene_policy import ScenePolicy
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.untestable import with_manoeuvres
from highside.diagnosis.poses import noise as noise_model
from highside.diagnosis.poses.noise import PoseNoise
from highside.diagnosis.poses.policy import POSE_ADVICE, POSES
from highside.diagnosis.poses.session import PoseSession
from highside.physics.forward import ForwardModel


@dataclass(frozen=True)
class PoseScene(Scene[PoseNoise]):
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

    @classmethod
    def of(
        cls, session: PoseSession, model: ForwardModel, free: tuple[str, ...], seed: int, method: Method = WHOLE
    ) -> PoseScene:
        """Fit the base, make the columns, learn the noise."""
        state = session.state
        seen = Observed(state, session.mean)
        model, residual = base_fit(model, seen, free)
        base = seen.jacobian(model, free)
        tangents = np.asarray(model.pose_sensitivity(state), dtype=float)[:, [0, 2]].transpose(1, 0, 2)
        candidates, blind = pose_candidates(model, state, free)
        force = np.asarray(model.chain(state).force, dtype=float)
        candidates += shadows(state, force)
        rich = _rich(base, candidates, session, force)
        noise = _learned(session, residual, rich, tangents, method)
        return cls(
            candidates, blind, free, seed, session, model, base, residual, tangents, rich, noise, force, method=method
        )

    @property
    def policy(self) -> ScenePolicy:
        return POSES

    @property
    def straightens(self) -> bool:
        return True

    @property
    def channels(self) -> tuple[str, ...]:
        return CHANNELS

    @property
    def noise(self) -> PoseNoise:
        return self.white_noise

    def judge(self, noise: PoseNoise) -> Judged[PoseNoise]:
        rng = np.random.default_rng(self.seed)
        fitted = self.base if self.method.refit else self.base[:0]
        base = span(noise.white(fitted))
        residual = outside(base, noise.white(self.residual))
        pool = Pool(self.candidates, all_white(noise, [v.columns for c in self.candidates for v in c.variants]))
        rich = noise_model.rich_residual(noise, self.residual, self.rich)
        if not self.method.colour:
            # nothing is remembered: chance is what the F test says
            rich = np.zeros_like(rich)
        limit = threshold(pool.race, pool.owner, pose_flips(rich, rng), base, noise.freedom)
        rows = noise.white(fitted), noise.white(self.residual)
        folds, apart = (pose_folds(self.session.n, interleaved=i) for i in (False, True))
        gains = PoseGains(pool, HeldOut(*rows, folds), HeldOut(*rows, apart))
        selector = Selector(pool, base, residual, noise.freedom, limit, gains, residual.size, starts=SELECTION.starts)
        bases = pose_bases(self.session.state, self.force)
        cells = [(channel, b) for b in range(len(bases)) for channel in range(3)]
        groups = all_white(noise, [on_channel(bases[b].functions, c) for c, b in cells])
        scan = scan_of(bases, groups, cells, noise.freedom)
        scan_limit = threshold(scan.race, np.arange(len(cells)), pose_flips(rich, rng), base, noise.freedom)
        return Judged(selector, scan, scan_limit, [], noise)

    def likelihoods(self, members: Sequence[Member]) -> list[Channel]:
        variance = noise_model.white_variance(self.noise, self.tangents)
        explained = np.concatenate([self.base, self.block(members)])
        t_s = self.session.state.t_s
        return [Likelihoods(self.residual[c], variance[c], explained[:, c], t_s) for c in range(3)]

    def block(self, members: Sequence[Member]) -> NDArray[Any]:
        return np.concatenate([np.empty((0, 3, self.session.n)), *(self.variant(m).columns for m in members)])

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

    def straightened(self, bend: Array | float, *, learn: bool = True) -> PoseScene:
        left = self.residual + self.bend - bend
        noise = _learned(self.session, left, self.rich, self.tangents, self.method) if learn else self.white_noise
        return replace(self, residual=left, white_noise=noise, bend=bend)

    def fit(self, members: Sequence[Member], noise: PoseNoise, *, bends: bool = True) -> JointFit:
        seen = Observed(self.session.state, self.session.mean)
        free = self.free if self.method.refit else ()
        return joint_fit(self.model, seen, free, self.candidates, members, noise, self.noise.freedom, bends=bends)

    def locate(
        self, judged: Judged[PoseNoise], signal: Array, space: Array, p: float, share: float
    ) -> tuple[Location, ...]:
        return locate(judged.scan, signal, space, p, share)

    def locate_whole(
        self, judged: Judged[PoseNoise], signal: Array, members: Sequence[Member], p: float, share: float
    ) -> tuple[Location, ...]:
        space = judged.selector.space_with(members)
        residual = outside(space, judged.selector.residual)
        cells = pose_cells(self.session.state)
        found = locate_whole(judged.scan, cells, judged.noise.white, residual, space, signal)
        if found is None:
            return ()
        channels, covariate, where, harmonic = found
        return (Location(tuple(CHANNELS[c] for c in channels), covariate, where, harmonic, share, p),)

    def completed(self, diagnosis: Diagnosis) -> Diagnosis:
        told = located_by_cause(diagnosis, self.model, self.session.state)
        return with_manoeuvres(told, self.session.state)

    def advice(self, member: Member, r: Rivalry, fit: JointFit) -> str:
        candidate = self.candidates[member.candidate]
        assert candidate.effect is not None
        rivals = [(self.candidates[k], self.variant(r.best[k]).shape) for k in r.same if k != member.candidate]
        amplitude = np.array([fit.parameters[candidate.id][name].value for name in candidate.amplitudes])
        advice = next_poses(
            self.model,
            self.session.state,
            self.free,
            (candidate, self.variant(member).shape, amplitude),
            rivals,
            self.base,
            1.0 / self.noise.sigma,
        )
        if advice.after < max(2 * advice.before, RIVALS.same_class_evidence):
            return candidate.effect.splitter
        words = ", ".join(f"({inc:g}, {tf:g}{', from the other side' if d < 0 else ''})" for inc, tf, d in advice.poses)
        return f"measure these poses (inclination, toolface in deg): {words}; otherwise: {candidate.effect.splitter}"

    def proof(self, members: Sequence[Member], fit: JointFit) -> Fit:
        folds = pose_folds(self.session.n)
        words = f"{len(folds)} contiguous blocks of poses"
        flat = self.residual.reshape(-1)
        base, claimed = (c.reshape(-1, flat.size) for c in (self.base, self.block(members)))
        plain = HeldOut(base, flat, folds)
        if any(plain.hides(self.block([m]).reshape(-1, flat.size)) for m in members):
            folds = pose_folds(self.session.n, interleaved=True)
            words = f"{len(folds)} sets of every {len(folds)}th pose, since what was found lives within few poses"
        floor = float(np.sqrt(np.mean(self.noise.sigma**2)))
        after = fit.residual if fit.parameters else self.residual
        found = block_proof(base, flat, claimed, folds, after, floor, words)
        return replace(found, rmse_before=float(np.sqrt(np.mean((self.residual + self.bend) ** 2))))

    def picture(self, fit: JointFit | None) -> Picture:
        return Picture(
            self.session,
            self.residual + self.bend,
            self.residual if fit is None else fit.residual,
            recorded=self.session.mean,
            parts=parts_of(self.model, fit, Observed(self.session.state, self.session.mean)),
            sigma=_of_one_pose(self.noise),
        )

    def told_of_noise(self) -> dict[str, Any]:
        noise = self.noise
        return {
            "model": "per channel and pose" if noise.inc or noise.tf else "per channel",
            "sigma_g": [float(s) for s in noise.sigma],
            "bench_inclination_rad": noise.inc,
            "bench_toolface_rad": noise.tf,
            "size_over_time": [float(noise.size.min()), float(noise.size.max())],
            "degrees_of_freedom": noise.freedom,
        }


def _learned(session: PoseSession, residual: Array, rich: Array, tangents: Array, method: Method) -> PoseNoise:
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
    taken = 0
    for part in [*parts, *shaped, *groups]:
        if taken + len(part) <= room or not kept:
            kept.append(part)
            taken += len(part)
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
