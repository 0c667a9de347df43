"""A rotating recording prepared for the diagnosis: columns in chunks, coloured noise, choices by inner products."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.fit import JointFit, Observed, base_fit, joint_fit
from highside.diagnosis.core.held_out import gain_interval
from highside.diagnosis.core.location import followed
from highside.diagnosis.core.memory import SlowEffect
from highside.diagnosis.core.method import WHOLE, Method
from highside.diagnosis.core.policy import FITS, RIVALS
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.result import Diagnosis, Fit, Location
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.scene import Judged, Picture, parts_of
from highside.diagnosis.core.scene_policy import ScenePolicy
from highside.diagnosis.core.support import Window
from highside.diagnosis.core.untestable import what_splits, with_manoeuvres
from highside.diagnosis.rotation.advice import next_rates
from highside.diagnosis.rotation.bursts import found_burst, with_burst
from highside.diagnosis.rotation.lines import found_lines
from highside.diagnosis.rotation.means import Sectors, mean_errors
from highside.diagnosis.rotation.policy import MEANS, ROTATION, SKETCH
from highside.diagnosis.rotation.sketch import Sketch, Some, sketched_bend
from highside.diagnosis.rotation.support import rotation_cells, windows
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.gram import HeldOutRows, accumulate
from highside.diagnosis.rows.jitter import with_jitter
from highside.diagnosis.rows.noise import RotationNoise, estimate, plain, rounding
from highside.diagnosis.rows.scene import RowsScene, chance_of, coordinates_of
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class RotationScene(RowsScene):
    """n rows of a rotation with known reference."""

    model: ForwardModel = field(kw_only=True)
    some: Some | None = None
    """of a long recording"""
    taken_out: frozenset[str] = frozenset()
    """ids of the effects whose bend a sketch told"""

    @classmethod
    def of(
        cls,
        session: RotationSession,
        model: ForwardModel,
        free: tuple[str, ...],
        seed: int,
        method: Method = WHOLE,
        sketch: Sketch | None = None,
    ) -> RotationScene:
        """Fit the base, learn the noise, pass over the rows. What a sketch's members do beyond first order is taken out
        from the beginning."""
        seen = Observed(session.state, session.readings, session.n > SKETCH.many_rows)
        some = None
        if session.n > SKETCH.many_rows:
            rows = session.thinned(SKETCH.some_rows, seed) if sketch is None else sketch.session
            model, left = base_fit(model, Observed(rows.state, rows.readings), free)
            some = Some(rows, plain(left.std(axis=1), rows.n) if sketch is None else sketch.noise)
        model, residual = base_fit(model, seen, free)
        bend: Array | float = 0.0
        if some is not None and sketch is not None and sketch.bent:
            bend = sketched_bend(model, seen, free if method.refit else (), some, sketch)
            residual = residual - bend
        residual = residual + rounding(session.readings, residual, seed)
        design = Design(session, model, free, found_lines(session, residual))
        noise = estimate(design, residual, seed, coloured=method.colour)
        grams, segments = accumulate(design, noise, residual)
        chance, rest = chance_of(design, noise, residual, grams, segments)
        return cls(
            design.candidates,
            design.blind,
            free,
            seed,
            session,
            design,
            residual,
            noise,
            grams,
            segments,
            chance,
            rest,
            some,
            frozenset(sketch.names) if sketch is not None and np.any(bend) else frozenset(),
            model=model,
            method=method,
            bend=bend,
        )

    @property
    def policy(self) -> ScenePolicy:
        return ROTATION

    @property
    def straightens(self) -> bool:
        return True

    def slow(self) -> list[SlowEffect]:
        found = []
        for i, candidate in enumerate(self.candidates):
            if candidate.slow:
                for j, variant in enumerate(candidate.variants):
                    if variant.whole:
                        # the first three are the three axes of the first order
                        own = [self.design.where[variant.columns[c], c] for c in range(3)]
                        found.append(SlowEffect(i, j, np.array(own)))
        return found

    def straightened(self, bend: Array | float, *, learn: bool = True) -> RotationScene:
        left = self.residual + self.bend - bend
        noise = estimate(self.design, left, self.seed, coloured=self.method.colour) if learn else self.noise
        grams, segments = accumulate(self.design, noise, left)
        chance, rest = chance_of(self.design, noise, left, grams, segments)
        return replace(
            self,
            residual=left,
            coloured_noise=noise,
            grams=grams,
            segments=segments,
            chance=chance,
            rest=rest,
            bend=bend,
            taken_out=frozenset(),
        )

    def fit(self, members: Sequence[Member], noise: RotationNoise, *, bends: bool = True) -> JointFit:
        seen = Observed(self.session.state, self.session.readings, self.session.n > SKETCH.many_rows)
        free = self.free if self.method.refit else ()
        given = (self.model, seen, free, self.candidates, members, self.noise, self.noise.freedom)
        if self.some is None:
            return joint_fit(*given, bends=bends)
        near = self._fitted_to_some(members)
        beyond = near.beyond * self.session.n / self.some.session.n
        known = bends and {self.candidates[m.candidate].id for m in members} == self.taken_out
        fit = joint_fit(*given, steps=1, near=near.model, bends=bends and not known and beyond > FITS.bends)
        return replace(fit, bend=np.asarray(self.bend), beyond=beyond) if known else fit

    def glance(self, members: Sequence[Member]) -> float | None:
        return None if self.some is None else self._fitted_to_some(members).chi_square

    def _fitted_to_some(self, members: Sequence[Member]) -> JointFit:
        assert self.some is not None
        which, some = frozenset(members), self.some
        if which not in some.fits:
            free = self.free if self.method.refit else ()
            some.fits[which] = joint_fit(
                self.model, some.seen, free, self.candidates, members, some.noise, some.noise.freedom
            )
        return some.fits[which]

    def locate_whole(
        self, judged: Judged[RotationNoise], signal: Array, members: Sequence[Member], p: float, share: float
    ) -> tuple[Location, ...]:
        coordinates = coordinates_of(judged)
        fitted = np.concatenate([self.design.base, *(self.variant(m).columns for m in members)]).astype(np.intp)
        cells = rotation_cells(self.session.state, slow=not any(m.upper for m in judged.noise.memories))

        def ranges(channels: list[int]) -> list[Window]:
            return windows(self.design, self.noise, self.residual, fitted[fitted >= 0], cells, channels, self.parts)

        space = judged.selector.space_with(members)
        sought = followed(judged.scan, signal, coordinates.channels, space, ranges)
        return () if sought is None else self.placed(sought, coordinates.weights(signal), p, share)

    def advice(self, member: Member, r: Rivalry, fit: JointFit) -> str:
        candidate = self.candidates[member.candidate]
        assert candidate.effect is not None
        rivals = [(self.candidates[k], self.variant(r.best[k]).shape) for k in r.same if k != member.candidate]
        amplitude = np.array([fit.parameters[candidate.id][name].value for name in candidate.amplitudes])
        advice = next_rates(
            self.model,
            self.session,
            self.free,
            (candidate, self.variant(member).shape, amplitude),
            rivals,
            1.0 / self.noise.sigma,
        )
        otherwise = what_splits(candidate.effect, [c.effect for c, _ in rivals if c.effect is not None])
        if advice.after < max(2 * advice.before, RIVALS.same_class_evidence):
            return otherwise
        words = "; ".join(stretch.words for stretch in advice.stretches)
        return f"turn for 20 s each: {words}; otherwise: {otherwise}"

    def proof(self, members: Sequence[Member], fit: JointFit) -> Fit:
        held = HeldOutRows(self.design, self.grams)
        parts = [np.asarray(self.variant(m).columns, dtype=np.intp) for m in members]
        numbers = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        none = numbers[:0]
        told = [(self.candidates[m.candidate].id, v) for m in members for v in self.variant(m).shape.values()]
        ways = [k for k, line in enumerate(self.design.lines, 1) if (line.effect, line.value) in told]
        effects = [self.candidates[m.candidate].effect for m in members]
        if not members or not all(effect is not None and effect.line for effect in effects):
            ways.insert(0, 0)
        every = np.concatenate([held.base, numbers])
        sectors = Sectors.of(self.design, self.noise, self.residual, self.segments, every, ways)
        means = [mean_errors(held, sectors, n) for n in (none, numbers)]
        by_rate = [held.energies(n, held.by_rate).sum() for n in (none, numbers)] if len(held.by_rate) > 1 else [0, 0]
        low, high = gain_interval(means[0].energy, means[1].energy)
        # whitened errors, told in g: the innovations' size, and what the filter takes of slow signals
        unit = float(np.sqrt(np.mean(self.noise.sigma[:3] ** 2) / max(means[0].rows, 1.0)))
        size = float(max(means[0].count.sum(), 1.0))
        words = (
            f"{len(held.folds)} contiguous stretches with gaps, each predicted from the others; means over sectors of "
            f"{360 // MEANS.sectors} deg of the turn, of {means[0].rows:.0f} rows each; whitened; gain = share of the "
            "mean square removed; the noise floor is what a complete simulation would leave there"
        )
        if by_rate[0] > 0:
            words += f"; leaving out one steady rate at a time: {1 - by_rate[1] / by_rate[0]:.2%}"
        return Fit(
            unit="g",
            rmse_before=float(np.sqrt(np.mean((self.residual + self.bend)[:3] ** 2))),
            rmse_after=float(np.sqrt(np.mean(fit.residual[:3] ** 2))),
            heldout_rmse_before=unit * float(np.sqrt(means[0].energy.sum() / size)),
            heldout_rmse_after=unit * float(np.sqrt(means[1].energy.sum() / size)),
            heldout_gain_low=low,
            heldout_gain_high=high,
            noise_floor=unit * float(np.sqrt(means[0].expected.sum() / size)),
            how_held_out=words,
            row_noise=float(np.sqrt(np.mean(self.noise.sigma[:3] ** 2))),
        )

    def completed(self, diagnosis: Diagnosis) -> Diagnosis:
        told = with_manoeuvres(located_by_cause(diagnosis, self.model, self.session.state), self.session.state)
        told = with_burst(told, found_burst(self.rest), self.session.state.t_s, self.channels)
        return with_jitter(told, self.noise, self.channels)

    def picture(self, fit: JointFit | None) -> Picture:
        seen = Observed(self.session.state, self.session.readings)
        return Picture(
            self.session,
            self.residual + self.bend,
            self.residual if fit is None else fit.residual,
            self.channels,
            recorded=self.session.readings,
            parts=parts_of(self.model, fit, seen),
            sigma=tuple(float(s) for s in self.noise.sigma),
        )

    def told_of_noise(self) -> dict[str, Any]:
        told = super().told_of_noise()
        sigma = [float(s) for s in self.noise.sigma]
        return {"model": told["model"], "sigma_g": sigma[:3], "sigma_radps": sigma[3:], **told}
