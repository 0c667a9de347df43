"""A rotating recording prepared for the diagnosis: columns in chunks, coloured noise, choices by inner products."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.chunks import CHUNK, in_order
from highside.diagnosis.core.fit import BENDS, JointFit, Observed, base_fit, joint_fit
from highside.diagnosis.core.held_out import block_gain, gain_interval
from highside.diagnosis.core.location import Located, Scan, followed, intervals, scan_of
from highside.diagnosis.core.memory import Channel, Memory, SlowEffect, SlowLimits
from highside.diagnosis.core.method import WHOLE, Method
from highside.diagnosis.core.pool import FLIPS, Member, Pool, threshold
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Diagnosis, Fit, Location
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.scene import SLOW, Judged, Picture, Scene, parts_of
from highside.diagnosis.core.selection import STARTS, Selector
from highside.diagnosis.core.support import Window
from highside.diagnosis.core.untestable import what_splits, with_manoeuvres
from highside.diagnosis.rotation.advice import next_rates
from highside.diagnosis.rotation.bursts import found_burst, with_burst
from highside.diagnosis.rotation.lines import found_lines
from highside.diagnosis.rotation.means import SECTORS, Sectors, mean_errors
from highside.diagnosis.rotation.sketch import MANY_ROWS, SOME_ROWS, Sketch, Some, sketched_bend
from highside.diagnosis.rotation.support import rotation_cells, windows
from highside.diagnosis.rows.bases import Group
from highside.diagnosis.rows.design import LINES, Design
from highside.diagnosis.rows.gram import Gram, HeldOutRows, Segments, Space, WalkingChannel, Walks, accumulate
from highside.diagnosis.rows.jitter import with_jitter
from highside.diagnosis.rows.noise import RotationNoise, estimate, plain, rounding, with_walk
from highside.diagnosis.rows.noise import windows as learned_from
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

SLOW_BAND_HZ = 0.23
"""Below this, a group of slow functions is judged by as many degrees of freedom as the band has."""
PLACES = 20_000
"""Rows by which intervals of a covariate are found."""


@dataclass(frozen=True)
class RotationGains:
    """Held-out likelihood of members of a pool, from inner products."""

    pool: Pool
    held_out: HeldOutRows
    known: dict[frozenset[Member], Array] = field(default_factory=dict)

    def gain(self, before: Sequence[Member], after: Sequence[Member]) -> tuple[float, float]:
        return block_gain(self._energies(before), self._energies(after))

    def _energies(self, members: Sequence[Member]) -> Array:
        which = frozenset(members)
        if which not in self.known:
            self.known[which] = self.held_out.energies(numbers_of(self.pool, members), self.held_out.folds)
        return self.known[which]


def numbers_of(pool: Pool, members: Sequence[Member]) -> Ints:
    """Numbers of the members' columns in the design."""
    parts = [np.asarray(pool.candidates[m.candidate].variants[m.variant].columns, dtype=np.intp) for m in members]
    return np.concatenate([np.empty(0, dtype=np.intp), *parts])


@dataclass(frozen=True)
class RotationScene(Scene):
    """n rows of a rotation with known reference."""

    session: RotationSession
    model: ForwardModel
    design: Design
    residual: Array
    """(C, n) after the base fit"""
    coloured_noise: RotationNoise
    grams: list[Gram]
    segments: Segments
    chance: list[Array]
    """(flip blocks, m) on each channel: inner products of the functions with what is left of everything, by blocks"""
    rest: list[tuple[slice, Array]]
    """what is left of everything, whitened, (C, n) of the rows that the noise was learned from"""
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
        seen = Observed(session.state, session.readings, session.n > MANY_ROWS)
        some = None
        if session.n > MANY_ROWS:
            rows = session.thinned(SOME_ROWS, seed) if sketch is None else sketch.scene.session
            model, left = base_fit(model, Observed(rows.state, rows.readings), free)
            some = Some(rows, plain(left.std(axis=1), rows.n) if sketch is None else sketch.scene.noise)
        model, residual = base_fit(model, seen, free)
        bend: Array | float = 0.0
        if some is not None and sketch is not None and sketch.scene.bent:
            bend = sketched_bend(model, seen, free if method.refit else (), some, sketch)
            residual = residual - bend
        residual = residual + rounding(session.readings, residual, seed)
        design = Design(session, model, free, found_lines(session, residual))
        noise = estimate(design, residual, seed, coloured=method.colour)
        grams, segments = accumulate(design, noise, residual)
        chance, rest = _chance(design, noise, residual, grams, segments)
        return cls(
            design.candidates,
            design.blind,
            free,
            seed,
            session,
            model,
            design,
            residual,
            noise,
            grams,
            segments,
            chance,
            rest,
            some,
            frozenset(sketch.names) if sketch is not None and np.any(bend) else frozenset(),
            method=method,
            bend=bend,
        )

    @property
    def straightens(self) -> bool:
        return True

    @property
    def channels(self) -> tuple[str, ...]:
        return self.session.channels

    @property
    def noise(self) -> RotationNoise:
        return self.coloured_noise

    @cached_property
    def _walks(self) -> list[Walks]:
        return list(in_order(Walks.of, self.grams))

    @property
    def slow_limits(self) -> SlowLimits:
        # a straight line is what a walk imitates most easily
        return SlowLimits(alike={"bias_drift": 3.0})

    @property
    def slow_beside_fast(self) -> bool:
        # the rates of a programme usually go one way
        return True

    @property
    def named_share(self) -> float:
        # rows are many: what is left beside the whole story is small
        return 0.93

    @property
    def faint(self) -> float:
        # one scan in a hundred is loud by chance
        return 1.0

    @property
    def shadow_margin(self) -> float:
        # their number counts against them already
        return 4.0

    @property
    def most_named(self) -> int:
        # harmonics of the toolface on one channel are matched by several effects of the bench together
        return 2

    def judge(self, noise: RotationNoise) -> Judged:
        totals = []
        for c, gram in enumerate(self.grams):
            memory = noise.memories[c] if c < len(noise.memories) else None
            if memory is None or memory.upper == 0.0:
                totals.append(gram.total)
            else:
                totals.append(self._walks[c].under(memory))
        space = Space(self.design, totals)
        base = span(space.columns(self.design.base if self.method.refit else self.design.base[:0]))
        residual = outside(base, space.residual)
        pool = Pool(self.candidates, [space.columns(v.columns) for c in self.candidates for v in c.variants])
        gains = RotationGains(pool, HeldOutRows(self.design, self.grams))
        size = sum(int(np.sum(w > 0)) for w in noise.weight)
        cells = self.design.cell_of
        slow_freedom = 2 * SLOW_BAND_HZ * self.session.n * self.session.step_s
        freedom = [slow_freedom if self.design.groups[b].slow else noise.freedom for _, b in cells]
        scan = scan_of(
            self.design.groups, [space.columns(numbers) for numbers in self.design.cells], cells, np.array(freedom)
        )
        # a walk is no matter of flipped signs: what the rows show by chance was found without it
        if not any(m.upper for m in noise.memories):
            limit, scan_limit = self._limits(space, base, pool, scan, noise.freedom)
        else:
            judged = self.judge(with_walk(noise, []))
            limit, scan_limit = judged.selector.threshold, judged.scan_threshold
        selector = Selector(
            pool, base, residual, noise.freedom, limit, gains, size, starts=STARTS, told=self.most_named
        )  # fmt: skip
        return Judged(selector, scan, scan_limit, [], _Judging(noise, space))

    def _limits(self, space: Space, base: Array, pool: Pool, scan: Scan, freedom: float) -> tuple[float, float]:
        """What race and scan exceed by chance, from flipped blocks."""
        rng = np.random.default_rng(self.seed)
        signs = rng.choice([-1.0, 1.0], size=(FLIPS, self.chance[0].shape[0]))
        chance = space.moments([signs @ blocks for blocks in self.chance])
        if not self.method.colour:
            # nothing is remembered: chance is what the F test says
            chance = np.zeros_like(chance)
        return (
            threshold(pool.race, pool.owner, chance, base, freedom),
            threshold(scan.race, np.arange(scan.freedom.size), chance, base, scan.freedom),
        )

    def likelihoods(self, members: Sequence[Member]) -> list[Channel]:
        block = self.block(members)
        found: list[Channel] = []
        for c in range(len(self.channels)):
            where = np.concatenate([self.design.where[self.design.base, c], block[:, c]])
            found.append(WalkingChannel(self._walks[c], np.unique(where[where >= 0])))
        return found

    def block(self, members: Sequence[Member]) -> NDArray[Any]:
        numbers = [np.asarray(self.variant(m).columns, dtype=np.intp) for m in members]
        every = np.concatenate([np.empty(0, dtype=np.intp), *numbers])
        return np.asarray(self.design.where[every[every >= 0]])

    def slow(self) -> list[SlowEffect]:
        found = []
        for i, candidate in enumerate(self.candidates):
            if candidate.id in SLOW:
                for j, variant in enumerate(candidate.variants):
                    if variant.whole:
                        # the first three are the three axes of the first order
                        own = [self.design.where[variant.columns[c], c] for c in range(3)]
                        found.append(SlowEffect(i, j, np.array(own)))
        return found

    def with_memory(self, memories: Sequence[Memory]) -> RotationNoise:
        return with_walk(self.noise, memories)

    def straightened(self, bend: Array | float, *, learn: bool = True) -> RotationScene:
        left = self.residual + self.bend - bend
        noise = estimate(self.design, left, self.seed, coloured=self.method.colour) if learn else self.noise
        grams, segments = accumulate(self.design, noise, left)
        chance, rest = _chance(self.design, noise, left, grams, segments)
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

    def fit(self, members: Sequence[Member], noise: Any, *, bends: bool = True) -> JointFit:
        seen = Observed(self.session.state, self.session.readings, self.session.n > MANY_ROWS)
        free = self.free if self.method.refit else ()
        given = (self.model, seen, free, self.candidates, members, self.noise, self.noise.freedom)
        if self.some is None:
            return joint_fit(*given, bends=bends)
        near = self._fitted_to_some(members)
        beyond = near.beyond * self.session.n / self.some.session.n
        known = bends and {self.candidates[m.candidate].id for m in members} == self.taken_out
        fit = joint_fit(*given, steps=1, near=near.model, bends=bends and not known and beyond > BENDS)
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

    def locate(self, judged: Judged, signal: Array, space: Array, p: float, share: float) -> tuple[Location, ...]:
        coordinates: Space = judged.noise.space
        sought = followed(judged.scan, signal, coordinates.channels, space)
        if sought is None:
            return ()
        return self._placed(sought, coordinates.weights(signal), p, share)

    def locate_whole(
        self, judged: Judged, signal: Array, members: Sequence[Member], p: float, share: float
    ) -> tuple[Location, ...]:
        coordinates: Space = judged.noise.space
        fitted = np.concatenate([self.design.base, *(self.variant(m).columns for m in members)]).astype(np.intp)
        cells = rotation_cells(self.session.state, slow=not any(m.upper for m in judged.noise.noise.memories))

        def ranges(channels: list[int]) -> list[Window]:
            return windows(self.design, self.noise, self.residual, fitted[fitted >= 0], cells, channels, self._parts)

        space = judged.selector.space_with(members)
        sought = followed(judged.scan, signal, coordinates.channels, space, ranges)
        return () if sought is None else self._placed(sought, coordinates.weights(signal), p, share)

    @property
    def _parts(self) -> list[slice]:
        """The rows that places are found by."""
        n, length = self.session.n, PLACES // 4
        if n <= PLACES:
            return [slice(0, n)]
        return [slice(int(s), int(s) + length) for s in np.linspace(0, n - length, 4).astype(int)]

    def _placed(
        self, sought: tuple[list[int], Located | Window], weights: Sequence[Array], p: float, share: float
    ) -> tuple[Location, ...]:
        """A location from what was found to be followed; a signal's weights (m,) on each channel say how much where."""
        channels, chosen = sought
        names = tuple(self.channels[c] for c in channels)
        if isinstance(chosen, Window):
            return (Location(names, chosen.covariate, chosen.intervals, None, share, p),)
        assert isinstance(chosen, Group)
        along, energy, power = [], [], np.zeros(len(chosen.harmonics))
        for part in self._parts:
            made = self.design.functions(part)
            rows = np.stack([weights[c] @ made[c] for c in channels])
            along.append(chosen.along[part])
            energy.append(np.sum(rows**2, axis=0))
            for i, k in enumerate(chosen.harmonics):
                phase = k * self.session.state.tf_rad[part]
                power[i] += float(np.sum((rows @ np.cos(phase)) ** 2 + (rows @ np.sin(phase)) ** 2))
        return (
            Location(
                channels=names,
                covariate=chosen.covariate,
                intervals=intervals(chosen.covariate, np.concatenate(along), np.concatenate(energy)),
                harmonic=chosen.harmonics[int(np.argmax(power))] if chosen.harmonics else None,
                share_of_misfit=share,
                p=p,
            ),
        )

    def advice(self, member: Member, r: Rivalry, fit: JointFit) -> str:
        candidate = self.candidates[member.candidate]
        assert candidate.effect is not None
        rivals = [(self.candidates[k], self.variant(r.best[k]).shape) for k in r.same if k != member.candidate]
        amplitude = np.array([fit.parameters[candidate.id][name].value for name in candidate.amplitudes])
        advice = next_rates(
            self.model, self.session, self.free, (candidate, self.variant(member).shape, amplitude), rivals,
            1.0 / self.noise.sigma,
        )  # fmt: skip
        otherwise = what_splits(candidate.effect, [c.effect for c, _ in rivals if c.effect is not None])
        if advice.after < max(2 * advice.before, 12.0):
            return otherwise
        words = "; ".join(stretch.words for stretch in advice.stretches)
        return f"turn for 20 s each: {words}; otherwise: {otherwise}"

    def proof(self, members: Sequence[Member], fit: JointFit) -> Fit:
        held = HeldOutRows(self.design, self.grams)
        parts = [np.asarray(self.variant(m).columns, dtype=np.intp) for m in members]
        numbers = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        none = numbers[:0]
        names = [self.candidates[m.candidate].id for m in members]
        told = [(self.candidates[m.candidate].id, v) for m in members for v in self.variant(m).shape.values()]
        ways = [k for k, line in enumerate(self.design.lines, 1) if (line.effect, line.value) in told]
        if not names or not set(names) <= set(LINES):
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
            f"{360 // SECTORS} deg of the turn, of {means[0].rows:.0f} rows each; whitened; gain = share of the mean "
            "square removed; the noise floor is what a complete simulation would leave there"
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
        noise = self.noise
        return {
            "model": "autoregressive per channel",
            "sigma_g": [float(s) for s in noise.sigma[:3]],
            "sigma_radps": [float(s) for s in noise.sigma[3:]],
            "filters": [[float(a) for a in f] for f in noise.filters],
            "follows_vibration_evidence": [float(v) for v in noise.by_vibration],
            "sampling_jitter_s": [float(v) for v in noise.jitter[:, 1]],
            "sampling_jitter_evidence": [float(v) for v in noise.jitter[:, 0]],
            "impulses": noise.impulses,
            "degrees_of_freedom": noise.freedom,
        }


@dataclass(frozen=True)
class _Judging:
    """A noise and the coordinates that it gives."""

    noise: RotationNoise
    space: Space


def _chance(
    design: Design, noise: RotationNoise, residual: Array, grams: Sequence[Gram], segments: Segments
) -> tuple[list[Array], list[tuple[slice, Array]]]:
    """(flip blocks, m) on each channel: inner products of functions with the residual of everything, block by block;
    and that residual itself.

    Of long recordings the windows that the noise was learned from stand for the rest.
    """
    session = design.session
    explained = [Space.of_channel(gram.total) for gram in grams]
    rest = [(window, np.zeros((len(grams), window.stop - window.start))) for window in learned_from(session.n)]
    parts = [
        (slice(start, min(start + CHUNK, window.stop)), left[:, start - window.start :])
        for window, left in rest
        for start in range(window.start, window.stop, CHUNK)
    ]
    used = np.unique(np.concatenate([segments.flip[part] for part, _ in parts]))
    result = [np.zeros((used.size, m)) for m in design.sizes]
    for part, kept in parts:
        led = slice(max(0, part.start - noise.lead), part.stop)
        starts = np.concatenate([[0], np.flatnonzero(np.diff(segments.flip[part])) + 1])
        blocks = np.searchsorted(used, segments.flip[part][starts])
        for c, functions in enumerate(design.functions(led, residual)):
            white = noise.whiten(c, functions, part)
            left = white[-1] - explained[c] @ white[:-1]
            kept[c, : left.size] = left
            result[c][blocks] += np.add.reduceat(white[:-1] * left, starts, axis=1).T
    rows = sum(part.stop - part.start for part, _ in parts)
    # to the size it has in all rows, and with what the projection took given back
    swell = [session.n / rows / max(1 - m / session.n, 0.1) for m in design.sizes]
    return [r * np.sqrt(s) for r, s in zip(result, swell, strict=True)], rest
