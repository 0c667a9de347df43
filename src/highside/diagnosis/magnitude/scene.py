"""A session of which only the magnitude of gravity is known, prepared for the diagnosis: one channel, `g_total`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import pose_candidates, shadows
from highside.diagnosis.core.fit import JointFit, base_fit, joint_fit
from highside.diagnosis.core.held_out import HeldOut, PoseGains, block_gain, block_proof
from highside.diagnosis.core.location import Basis, followed, intervals, scan_of
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.core.memory import Channel, Innovating, Likelihoods, Memory, SlowEffect
from highside.diagnosis.core.memory import intervals as in_intervals
from highside.diagnosis.core.policy import HELD_OUT, INTERVALS, POOL, REGRESSION, SELECTION
from highside.diagnosis.core.pool import Member, Pool, pose_flips, ranked, span_with, standing, threshold
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Diagnosis, Fit, Location, NotTestable
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.scene import Judged, Picture, Scene
from highside.diagnosis.core.scene_policy import ScenePolicy
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.magnitude.candidates import (
    bases_of,
    beyond_linear,
    finer_step,
    projected,
    short_enough,
    visible,
)
from highside.diagnosis.magnitude.directed_walk import DirectedLikelihoods, DirectedNoise
from highside.diagnosis.magnitude.fit import fitted_columns, from_the_start, least
from highside.diagnosis.magnitude.noise import MagnitudeNoise, plainly_asked, rich_columns, scatter
from highside.diagnosis.magnitude.observed import Magnitudes
from highside.diagnosis.magnitude.policy import AT_REST, MAGNITUDE, MAGNITUDE_CHOICE
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.physics.effect import Stage
from highside.physics.effects import all_effects, get
from highside.physics.forward import ForwardModel

Shapes = dict[str, dict[str, float]]

CHANNEL = "g_total"


@dataclass(frozen=True)
class MagnitudeScene(Scene[MagnitudeNoise]):
    """n still readings of unknown attitude."""

    session: MagnitudeSession
    model: ForwardModel
    seen: Magnitudes
    base: Array
    """(P, 1, n)"""
    residual: Array
    """(1, n) g after the base fit"""
    rich: Array
    white_noise: MagnitudeNoise
    bases: list[Basis]

    about: Shapes = field(default_factory=dict)
    """effects beside the free ones, with their shapes, at whose fitted sizes everything is taken to first order"""

    @classmethod
    def of(cls, session: MagnitudeSession, model: ForwardModel, free: tuple[str, ...], seed: int) -> MagnitudeScene:
        """Fit the base, make the columns, learn the noise.

        The length of a vector is not linear in an offset of a tenth of it: the square of what was left out would pass
        for products of loads. So columns and residual are taken where what is plainly asked for has its fitted size.
        """
        seen = Magnitudes(session)
        scene = cls._about(seen, model, free, seed, {})
        while not session.rest and len(scene.about) < SELECTION.most:
            about = scene._nearest(model)
            if about is None:
                break
            scene = cls._about(seen, model, free, seed, about)
        return scene

    @classmethod
    def _about(
        cls, seen: Magnitudes, model: ForwardModel, free: tuple[str, ...], seed: int, about: Shapes
    ) -> MagnitudeScene:
        session = seen.session
        offsets = tuple(e.id for e in all_effects().values() if e.constant and e.stage is Stage.SENSOR and e.id in free)
        if session.rest and offsets:
            # offset, scale and matrix show alike; an offset leaves the directions as they are
            model = base_fit(model, seen, offsets, steps=MAGNITUDE_CHOICE.steps)[0]
        model, columns, residual = _fitted(seen, model, free, about)
        names = model.free_names(free) if free else []
        values = model.get_free(list(about)) if about else np.empty(0)
        # as if the others had been left out, but to first order about what they are
        base, others = seen.shown(columns[: len(names)], names), columns[len(names) :]
        residual = outside(span(base[:, 0]), residual + np.tensordot(values, others, 1))
        aligned = seen.aligned(model)
        candidates, blind = visible(seen, model, *pose_candidates(model, aligned.state, free))
        if not session.rest:
            force = np.asarray(model.chain(aligned.state).force, dtype=float)
            candidates += projected(seen, model, shadows(aligned.state, force))
        if session.rest:
            candidates = short_enough(candidates, float(np.ptp(session.t_s)))
        candidates = beyond_linear(candidates, base)
        bases = bases_of(session, aligned.state.reading.shape[1])
        rich = plainly_asked(rich_columns(base, candidates, bases), base, residual, candidates)
        return cls(
            candidates,
            blind,
            free,
            seed,
            session,
            model,
            seen,
            base,
            residual,
            rich,
            scatter(session, residual, rich),
            bases,
            about,
        )

    def _nearest(self, start: ForwardModel) -> Shapes | None:
        """One effect more to take everything about: of those that are plainly asked for, the one that comes nearest as
        it is, not to first order; none where nothing is asked for."""
        noise, ids = self.noise, [c.id for c in self.candidates]
        pool = Pool(self.candidates, [noise.white(v.columns) for c in self.candidates for v in c.variants])
        known = [m for m in pool.members if ids[m.candidate] in self.about and self.variant(m).whole]
        known = [m for m in known if self.variant(m).shape == self.about[ids[m.candidate]]]
        space = span_with(span(noise.white(self.base)), pool.stack(known))
        after = standing(pool, space, noise.white(self.residual), noise.freedom, self.session.n)
        limit = -np.log10(POOL.alarm_rate / len(ids))
        asked = [k for k in ranked(after.bic) if after.log_p[k] > limit]
        asked = [k for k in asked if self.candidates[k].named and ids[k] not in self.about]
        tried = []
        for k in asked[: SELECTION.shortlist]:
            about = {**self.about, ids[k]: self.variant(after.best[k]).shape}
            left = _fitted(self.seen, start, self.free, about)[2]
            tried.append((float(np.sum(left**2)), k, about))
        if not tried:
            return None
        _, nearest, about = min(tried)
        # what comes and goes with time is small
        return about if not self.candidates[nearest].slow else None

    @cached_property
    def policy(self) -> ScenePolicy:
        # a few readings are soon explained by anything
        room = self.session.n - int(span(self.base[:, 0]).shape[0])
        most = max(1, min(SELECTION.most, room // MAGNITUDE_CHOICE.per_name))
        return replace(AT_REST if self.session.rest else MAGNITUDE, most_named=most)

    @property
    def channels(self) -> tuple[str, ...]:
        return (CHANNEL,)

    @property
    def noise(self) -> MagnitudeNoise:
        return self.white_noise

    @property
    def slow_ids(self) -> frozenset[str]:
        if not self.session.rest:
            return super().slow_ids
        # at rest the load is constant: whatever shows at all follows time or temperature
        return frozenset(c.id for c in self.candidates)

    def judge(self, noise: MagnitudeNoise) -> Judged[MagnitudeNoise]:
        rng = np.random.default_rng(self.seed)
        base = span(noise.white(self.base))
        residual = outside(base, noise.white(self.residual))
        pool = Pool(self.candidates, [noise.white(v.columns) for c in self.candidates for v in c.variants])
        space = span(noise.white(self.rich))
        left = outside(space, noise.white(self.residual))
        rich = np.asarray(left / np.sqrt(np.maximum(1.0 - np.sum(space**2, axis=0), MAGNITUDE_CHOICE.least_left)))
        chance = pose_flips(rich, rng, 1)
        limit = threshold(pool.race, pool.owner, chance, base, noise.freedom)
        held_out = HeldOut(noise.white(self.base), noise.white(self.residual), self._folds())
        selector = Selector(pool, base, residual, noise.freedom, limit, PoseGains(pool, held_out), residual.size)
        cells = [(0, b) for b in range(len(self.bases))]
        white = [noise.white(basis.functions[:, None]) for basis in self.bases]
        scan = scan_of(self.bases, white, cells, noise.freedom)
        scan_limit = threshold(scan.race, np.arange(len(cells)), chance, base, noise.freedom)
        return Judged(selector, scan, scan_limit, [], noise)

    def _folds(self) -> list[NDArray[np.intp]]:
        n = self.session.n
        single = not self.session.rest and n <= MAGNITUDE_CHOICE.one_by_one
        return list(
            np.array_split(np.arange(n), n if single else min(MAGNITUDE_CHOICE.blocks, n // HELD_OUT.poses_a_fold))
        )

    def likelihoods(self, members: Sequence[Member]) -> list[Channel]:
        explained = np.concatenate([self.base, self.block(members)])[:, 0]
        residual, variance, t_s = self.residual[0], self.noise.std**2, self.session.t_s
        if self.session.rest:
            return [Likelihoods(residual, variance, explained, t_s)]
        return [DirectedLikelihoods(residual, variance, explained, t_s, self.session.direction)]

    def block(self, members: Sequence[Member]) -> NDArray[Any]:
        return np.concatenate([np.empty((0, 1, self.session.n)), *(self.variant(m).columns for m in members)])

    def slow(self) -> list[SlowEffect]:
        found = []
        base = span(self.base[:, 0])
        for i, candidate in enumerate(self.candidates):
            if candidate.id not in self.slow_ids or not candidate.named:
                continue
            kept: list[Array] = []
            for j, variant in enumerate(candidate.variants):
                rows = variant.columns[:, 0]
                row = rows[int(np.argmax(np.linalg.norm(rows, axis=1)))]
                if all(_alike(row, other) or not np.any(other) for other in rows) and not any(
                    _alike(row, other) for other in kept
                ):
                    kept.append(row)
                    if np.linalg.norm(outside(base, row)) > REGRESSION.visible * np.linalg.norm(row):
                        found.append(SlowEffect(i, j, row[None]))
        return found

    def holds_up(self, member: Member) -> bool:
        unit = self.noise.std
        held_out = HeldOut(self.base[:, 0] / unit, self.residual[0] / unit, self._folds())
        energies = [
            np.array([float(e @ e) for e in held_out.errors(self.block(members)[:, 0] / unit)])
            for members in ([], [member])
        ]
        gain, error = block_gain(*energies)
        return gain > error

    def with_memory(self, memories: Sequence[Memory]) -> MagnitudeNoise:
        memory = memories[0]
        return self._remembering(memory.length, memory.upper if memory.share > 0 else 0.0)

    def _remembering(self, length: float, share: float) -> MagnitudeNoise:
        """The noise with a memory of `length` readings and a variance of `share` of the white part's."""
        variance = self.noise.std**2
        level: Innovating
        if self.session.rest:
            size = np.array([share * float(variance.mean())])
            level = LevelNoise.of(variance, in_intervals(self.session.t_s), size, np.array([length]))
        else:
            level = DirectedNoise.of(variance, self.session.direction, self.session.t_s, np.array([share]))
        return replace(self.noise, level=level)

    def _widest(self, members: Sequence[Member], noise: MagnitudeNoise) -> MagnitudeNoise:
        """The noise with the largest walk that the readings allow at 95 % beside the members.

        At rest all that shows is slow. That a walk is not needed beside an effect does not say that there is none: with
        it, an amplitude is known less well by far.
        """
        channel = self.likelihoods(members)[0]
        assert isinstance(channel, Likelihoods)
        fits = channel.without(self.base[:0, 0])
        walks = [
            share
            for (length, share), fit in zip(channel.settings, fits, strict=True)
            if np.isinf(length) and fit <= fits.min() + INTERVALS.chi2_95
        ]
        return self._remembering(np.inf, max(walks)) if walks else noise

    def _finer(self, members: Sequence[Member]) -> MagnitudeScene:
        """With steps of a rest at the instants at which they fit best, also between those that were searched."""
        candidates = list(self.candidates)
        elapsed = self.session.t_s - self.session.t_s[0]
        for m in members:
            candidate = candidates[m.candidate]
            onset = [p.name for p in candidate.effect.shapes if p.epoch] if candidate.effect is not None else []
            if onset and len(self.variant(m).shape) == 1:
                others = self.block([o for o in members if o != m])[:, 0]
                space = span(np.concatenate([self.base[:, 0], others]))
                variants = list(candidate.variants)
                variants[m.variant] = finer_step(
                    variants[m.variant], variants, onset[0], elapsed, space, self.residual[0]
                )
                candidates[m.candidate] = replace(candidate, variants=tuple(variants))
        return replace(self, candidates=candidates)

    def fit(self, members: Sequence[Member], noise: MagnitudeNoise, *, bends: bool = True) -> JointFit:
        if not self.session.rest or not members:
            return self._fit(members, noise)
        finer = self._finer(members)
        return finer._fit(members, finer._widest(members, noise))

    def _fit(self, members: Sequence[Member], noise: MagnitudeNoise) -> JointFit:
        ids = [self.candidates[m.candidate].id for m in members]
        model = self.model.without(*(name for name in self.about if name not in ids))
        found = joint_fit(model, self.seen, self.free, self.candidates, members, noise, noise.freedom)
        if not members:
            return replace(found, residual=self.residual)
        tables = dict(found.parameters)
        parts = {}
        for member in members:
            candidate = self.candidates[member.candidate]
            parts[candidate.id] = fitted_columns(self.seen, model, candidate, tables[candidate.id])
        for member in members:
            candidate = self.candidates[member.candidate]
            own, slopes = parts[candidate.id]
            others = [c for name, both in parts.items() if name != candidate.id for c in both]
            space = span(noise.white(np.concatenate([self.base, slopes, *others])))
            names = [f"{candidate.id}.{name}" for name in candidate.amplitudes]
            shown = self.seen.directions(names, candidate.unit())
            tables[candidate.id] = least(
                tables[candidate.id], candidate, outside(space, noise.white(own)), shown, noise.freedom
            )
        delay_s = float(self.session.t_s[0]) - self.session.began_s
        told = {name: from_the_start(table, get(name), delay_s) for name, table in tables.items()}
        return replace(found, parameters=told)

    def locate(
        self, judged: Judged[MagnitudeNoise], signal: Array, space: Array, p: float, share: float
    ) -> tuple[Location, ...]:
        sought = followed(judged.scan, signal, [slice(0, signal.size)], space)
        if sought is None:
            return ()
        chosen = sought[1]
        assert isinstance(chosen, Basis)
        where = intervals(chosen.covariate, chosen.along, signal**2)
        return (Location((CHANNEL,), chosen.covariate, where, None, share, p),)

    def advice(self, member: Member, r: Rivalry, fit: JointFit) -> str:
        effect = self.candidates[member.candidate].effect
        assert effect is not None
        return f"{effect.splitter}; more attitudes of the tool, spread over the whole sphere, held still"

    def proof(self, members: Sequence[Member], fit: JointFit) -> Fit:
        folds = self._folds()
        each = len(folds) == self.session.n
        words = "each pose left out in turn" if each else f"{len(folds)} contiguous stretches"
        floor = float(np.sqrt(np.mean(self.noise.std**2)))
        return block_proof(
            self.base[:, 0], self.residual[0], self.block(members)[:, 0], folds, fit.residual, floor, words
        )

    def picture(self, fit: JointFit | None) -> Picture:
        after = self.residual if fit is None else fit.residual
        return Picture(self.session, self.residual, after, self.channels)

    def completed(self, diagnosis: Diagnosis) -> Diagnosis:
        lacking = (*diagnosis.not_testable, *self._not_parted())
        diagnosis = replace(diagnosis, not_testable=lacking)
        if not self.session.rest or not diagnosis.claims:
            return diagnosis
        words = (
            "in one attitude only what acts along gravity shows: the parameters are its smallest explanation, and what "
            "acts across gravity, or whether an offset or a scale factor changes, is not told"
        )
        remainder = replace(diagnosis.remainder, hints=(words, *diagnosis.remainder.hints))
        return replace(diagnosis, remainder=remainder)

    def _not_parted(self) -> list[NotTestable]:
        """Free effects of which the magnitudes show nothing that the other free ones do not show as well."""
        found = []
        columns = self.seen.jacobian(self.model, self.free)
        owners = [name.partition(".")[0] for name in self.model.free_names(self.free)] if self.free else []
        for name in self.free:
            mine = np.array([owner == name for owner in owners])
            own, others = columns[mine][:, 0], columns[~mine][:, 0]
            if mine.all() or np.linalg.norm(outside(span(others), own)) > REGRESSION.visible * np.linalg.norm(own):
                continue
            rivals = [other for other in self.free if other != name]
            why = f"it is adjusted, but in the attitudes of this recording {', '.join(rivals)} would do the same"
            found.append(NotTestable(name, why, get(name).splitter))
        return found

    def told_of_noise(self) -> dict[str, Any]:
        return {
            "model": "of the magnitude, per reading",
            "reference": self.session.found,
            "sigma_g": [float(np.sqrt(np.mean(self.noise.std**2)))],
            "degrees_of_freedom": self.noise.freedom,
        }


def _fitted(
    seen: Magnitudes, model: ForwardModel, free: Sequence[str], about: Shapes
) -> tuple[ForwardModel, Array, Array]:
    """The model with the amplitudes of the free effects and of those of `about`, columns (P, 1, n), residual (1, n)."""
    model = model.with_effects({name: shape for name, shape in about.items() if name not in model.ids})
    model, residual = base_fit(model, seen, (*free, *about), steps=MAGNITUDE_CHOICE.steps)
    return model, seen.jacobian(model, (*free, *about)), residual


def _alike(one: Array, other: Array) -> bool:
    return bool(abs(one @ other) > MAGNITUDE_CHOICE.alike * np.linalg.norm(one) * np.linalg.norm(other))
