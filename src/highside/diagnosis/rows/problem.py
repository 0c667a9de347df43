"""Any recording that is looked at row by row: columns in chunks, coloured noise, choices by inner products.

What a kind of rows adds (how columns are made, what is fitted, what is shown) its own problem says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term, threshold
from highside.diagnosis.core.chunks import in_order
from highside.diagnosis.core.finding_policy import FLOOR, STABILITY
from highside.diagnosis.core.floor import lattice_step, rounding_error
from highside.diagnosis.core.held_out import block_gain
from highside.diagnosis.core.location import Located, Scan, followed, intervals, scan_of
from highside.diagnosis.core.memory import Channel, Memory
from highside.diagnosis.core.policy import CANDIDATE_SET, SELECTION
from highside.diagnosis.core.problem import Problem, SelectionState
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Location
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.stability import Stability, stability_of_inner
from highside.diagnosis.core.support import Window
from highside.diagnosis.rows.bases import BasisGroup
from highside.diagnosis.rows.changing import changing_instead
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.gram import Gram, HeldOutRows, RandomWalkChannel, RandomWalkGrams, Space, inner_by_parts
from highside.diagnosis.rows.inner_products import InnerProducts
from highside.diagnosis.rows.noise import RotationNoise, windows, with_random_walk
from highside.diagnosis.rows.policy import GRAMS, ROW_PLACES
from highside.diagnosis.rows.segments import Key
from highside.diagnosis.rows.session import RotationSession
from highside.long_arrays import runs_of

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class RowGains:
    """Held-out likelihood of terms of a candidate set, from inner products."""

    candidate_set: CandidateSet
    held_out: HeldOutRows
    known: dict[frozenset[Term], Array] = field(default_factory=dict)

    def gain(self, before: Sequence[Term], after: Sequence[Term]) -> tuple[float, float]:
        return block_gain(self._energies(before), self._energies(after))

    def _energies(self, terms: Sequence[Term]) -> Array:
        which = frozenset(terms)
        if which not in self.known:
            self.known[which] = self.held_out.energies(numbers_of(self.candidate_set, terms), self.held_out.folds)
        return self.known[which]


def numbers_of(candidate_set: CandidateSet, terms: Sequence[Term]) -> Ints:
    """Numbers of the terms' columns in the design."""
    parts = [
        np.asarray(candidate_set.candidates[m.candidate].variants[m.variant].columns, dtype=np.intp) for m in terms
    ]
    return np.concatenate([np.empty(0, dtype=np.intp), *parts])


@dataclass(frozen=True, kw_only=True)
class RowsSelectionState(SelectionState[RotationNoise]):
    """What one noise of rows leads to, and the coordinates that it gives."""

    space: Space


def coordinates_of(selection: SelectionState[RotationNoise]) -> Space:
    """The coordinates that rows were judged in."""
    assert isinstance(selection, RowsSelectionState)
    return selection.space


@dataclass(frozen=True)
class RowsProblem(Problem[RotationNoise]):
    """n rows of some channels, and their inner products under a coloured noise."""

    session: RotationSession
    design: Design
    residual: Array
    """(C, n) after the base fit"""
    coloured_noise: RotationNoise
    products: InnerProducts

    @property
    def grams(self) -> list[Gram]:
        """Inner products on each channel."""
        return self.products.grams

    @property
    def channels(self) -> tuple[str, ...]:
        return self.session.channels

    @property
    def noise(self) -> RotationNoise:
        return self.coloured_noise

    @cached_property
    def random_walks(self) -> list[RandomWalkGrams]:
        return list(in_order(RandomWalkGrams.of, self.grams))

    def prepare(self, noise: RotationNoise) -> RowsSelectionState:
        totals = []
        for c, gram in enumerate(self.grams):
            memory = noise.memories[c] if c < len(noise.memories) else None
            if memory is None or memory.upper == 0.0:
                totals.append(gram.total)
            else:
                totals.append(self.random_walks[c].under(memory))
        space = Space(self.design, totals)
        base = span(space.columns(self.design.base if self.method.refit else self.design.base[:0]))
        residual = outside(base, space.residual)
        candidate_set = CandidateSet(
            self.candidates, [space.columns(v.columns) for c in self.candidates for v in c.variants]
        )
        gains = RowGains(candidate_set, HeldOutRows(self.design, self.grams))
        size = sum(int(np.sum(w > 0)) for w in noise.weight)
        cells = self.design.cell_of
        slow_freedom = 2 * ROW_PLACES.slow_band_hz * self.session.n * self.session.step_s
        freedom = [slow_freedom if self.design.groups[b].slow else noise.freedom for _, b in cells]
        scan = scan_of(
            self.design.groups, [space.columns(numbers) for numbers in self.design.cells], cells, np.array(freedom)
        )
        # a random walk is no matter of flipped signs: what the rows show by chance was found without it
        if not any(m.upper for m in noise.memories):
            limit, scan_limit = self._limits(space, base, candidate_set, scan, noise.freedom)
        else:
            selection = self.prepare(with_random_walk(noise, []))
            limit, scan_limit = selection.selector.threshold, selection.scan_threshold
        starts, most_named = SELECTION.starts, self.policy.most_named
        selector = Selector(
            candidate_set, base, residual, noise.freedom, limit, gains, size, starts=starts, most_named=most_named
        )
        return RowsSelectionState(selector, scan, scan_limit, [], noise, space=space)

    def _limits(
        self, space: Space, base: Array, candidate_set: CandidateSet, scan: Scan, freedom: float
    ) -> tuple[float, float]:
        """What race and scan exceed by chance, from flipped blocks."""
        rng = np.random.default_rng(self.seed)
        signs = rng.choice([-1.0, 1.0], size=(CANDIDATE_SET.flips, self.products.chance[0].shape[0]))
        chance = space.moments([signs @ blocks for blocks in self.products.chance])
        if not self.method.colour:
            # nothing is remembered: chance is what the F test says
            chance = np.zeros_like(chance)
        rate = self.policy.alarm_rate
        return (
            threshold(candidate_set.score_test, candidate_set.owner, chance, base, freedom, rate),
            threshold(scan.score_test, np.arange(scan.freedom.size), chance, base, scan.freedom, rate),
        )

    def likelihoods(self, terms: Sequence[Term]) -> list[Channel]:
        block = self.block(terms)
        found: list[Channel] = []
        for c in range(len(self.channels)):
            where = np.concatenate([self.design.where[self.design.base, c], block[:, c]])
            found.append(RandomWalkChannel(self.random_walks[c], np.unique(where[where >= 0])))
        return found

    def block(self, terms: Sequence[Term]) -> AnyArray:
        numbers = [np.asarray(self.variant(m).columns, dtype=np.intp) for m in terms]
        every = np.concatenate([np.empty(0, dtype=np.intp), *numbers])
        return np.asarray(self.design.where[every[every >= 0]])

    def with_memory(self, memories: Sequence[Memory]) -> RotationNoise:
        return with_random_walk(self.noise, memories)

    def locate(
        self, selection: SelectionState[RotationNoise], signal: Array, space: Array, p: float, share: float
    ) -> tuple[Location, ...]:
        coordinates = coordinates_of(selection)
        sought = followed(selection.scan, signal, coordinates.channels, space)
        if sought is None:
            return ()
        return self.placed(sought, coordinates.weights(signal), p, share)

    def stability(self, selection: SelectionState[RotationNoise], term: Term) -> Stability | None:
        found = self.over_parts(selection, term)
        if found is None or not found.stable:
            return found
        changed = changing_instead(self, selection, term)
        return found if changed is None else changed

    def mean_square_left(self, selection: SelectionState[RotationNoise]) -> float | None:
        space = selection.selector.space_with(selection.terms)
        left = outside(space, selection.selector.residual)
        return float(left @ left) / max(left.size - len(space), 1)

    def over_parts(self, selection: SelectionState[RotationNoise], term: Term, excess: float = 1.0) -> Stability | None:
        """Whether a size agrees over parts of the rows; between blocks it varies by `excess` times white noise."""
        others = [o for o in selection.terms if o != term]
        parts = [self.design.base, *(self.numbers_of(o) for o in [*others, term])]
        numbers = np.concatenate(parts).astype(np.intp)
        inner = {
            name: inner_by_parts(self.design, self.grams, self.products.segments, numbers, part_of, selection.noise)
            for name, part_of in self._splits().items()
        }
        return stability_of_inner(inner, parts[-1].size, selection.noise.freedom, excess)

    def numbers_of(self, term: Term) -> Ints:
        """Numbers of a term's columns that show."""
        numbers = np.asarray(self.variant(term).columns, dtype=np.intp)
        return numbers[numbers >= 0]

    def _splits(self) -> dict[str, Callable[[Key], int]]:
        """By which parts of the rows sizes are compared."""
        splits: dict[str, Callable[[Key], int]] = {
            "the beginning, middle and end of the session": lambda key: key[0] * 3 // GRAMS.folds
        }
        known = sorted({key[1] for gram in self.grams for key in gram.parts} - {-1})
        if len(known) >= STABILITY.levels:
            rate = np.abs(self.session.state.rotor_rate_radps)
            mean = self._mean_over_rates(rate, known)
            middle = float(np.median(list(mean.values())))
            # what is on no steady rate stands by itself
            splits["lower rates, higher rates and ramps"] = lambda key: 2 if key[1] < 0 else int(mean[key[1]] > middle)
        return splits

    def _mean_over_rates(self, values: Array, rates: Sequence[int]) -> dict[int, float]:
        """Mean of values (N,) over the rows of each steady rate."""
        total, count = dict.fromkeys(rates, 0.0), dict.fromkeys(rates, 0)
        for part in runs_of(self.session.n):
            own, of_rate = values[part], self.products.segments.rate[part]
            for k in rates:
                total[k] += float(own[of_rate == k].sum())
                count[k] += int(np.sum(of_rate == k))
        return {k: total[k] / count[k] for k in rates}

    @property
    def in_steps(self) -> tuple[Array, Array]:
        parts = windows(self.session.n) if self.session.long else [slice(0, self.session.n)]
        rows = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        tf_rad, pairs = self.session.state.tf_rad[rows], zip(self.session.readings, self.residual, strict=True)
        steps = np.array([_coarse_step(reading[rows], left[rows], tf_rad) for reading, left in pairs])
        return steps, np.std(self.residual, axis=1)

    @property
    def parts(self) -> list[slice]:
        """The rows that places are found by."""
        n, length = self.session.n, ROW_PLACES.rows // ROW_PLACES.stretches
        if n <= ROW_PLACES.rows:
            return [slice(0, n)]
        return [slice(int(s), int(s) + length) for s in np.linspace(0, n - length, ROW_PLACES.stretches).astype(int)]

    def placed(
        self, sought: tuple[list[int], Located | Window], weights: Sequence[Array], p: float, share: float
    ) -> tuple[Location, ...]:
        """A location from what was found to be followed; a signal's weights (m,) on each channel say how much where."""
        channels, chosen = sought
        names = tuple(self.channels[c] for c in channels)
        if isinstance(chosen, Window):
            return (Location(names, chosen.covariate, chosen.intervals, None, share, p),)
        assert isinstance(chosen, BasisGroup)
        along, energy, power = [], [], np.zeros(len(chosen.harmonics))
        for part in self.parts:
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

    def noise_summary(self) -> dict[str, Any]:
        noise = self.noise
        return {
            "model": "autoregressive per channel",
            "filters": [[float(a) for a in f] for f in noise.filters],
            "follows_vibration_evidence": [float(v) for v in noise.by_vibration],
            "sampling_jitter_s": [float(v) for v in noise.jitter[:, 1]],
            "sampling_jitter_evidence": [float(v) for v in noise.jitter[:, 0]],
            "impulses": noise.impulses,
            "degrees_of_freedom": noise.freedom,
        }


def _coarse_step(reading: Array, left: Array, tf_rad: Array) -> float:
    """The step of the lattice of readings (N,); 0.0 where the turn or noise removes its error from means."""
    step = lattice_step(reading)
    return step if rounding_error(reading, left, tf_rad) > FLOOR.rounded * step else 0.0
