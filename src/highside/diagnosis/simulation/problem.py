"""A recording beside another program's prediction, prepared for the diagnosis: linear effects in coloured noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.held_out import gain_interval
from highside.diagnosis.core.memory import SlowEffect, beats_random_walk
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.probability import student_quantile
from highside.diagnosis.core.problem import ReportData, SelectionState
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.regression import solved
from highside.diagnosis.core.result import DiagnosisResult, Fit, FittedParameter, Location
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.stability import Stability
from highside.diagnosis.rows.gram import HeldOutRows
from highside.diagnosis.rows.inner_products import InnerProducts
from highside.diagnosis.rows.jitter import with_jitter
from highside.diagnosis.rows.noise import RotationNoise, estimate
from highside.diagnosis.rows.problem import RowsProblem, RowsSelectionState
from highside.diagnosis.rows.segments import Key
from highside.diagnosis.simulation.activity import by_activity
from highside.diagnosis.simulation.believed import more_than_remainders, without_doubtful
from highside.diagnosis.simulation.clock_or_filter import better_than, without_filter
from highside.diagnosis.simulation.constancy import stability_beside, steady_terms
from highside.diagnosis.simulation.constants import with_constants
from highside.diagnosis.simulation.design import (
    NONE,
    TONE_SHAPE,
    About,
    SimulationDesign,
    Without,
    covariates_of,
    parts_of_amounts,
)
from highside.diagnosis.simulation.policy import SIMULATION, SIMULATION_CHOICE
from highside.diagnosis.simulation.same_delay import taken_alike, with_the_other
from highside.diagnosis.simulation.session import OFFSET, SKEW, SimulationSession
from highside.diagnosis.simulation.starts import measured_start
from highside.physics.channel_effect import OnChannels


@dataclass(frozen=True)
class SimulationProblem(RowsProblem):
    """n rows of some channels beside their prediction."""

    session: SimulationSession
    design: SimulationDesign

    @classmethod
    def beside(cls, session: SimulationSession, free: tuple[str, ...], seed: int) -> SimulationProblem:
        """Make the columns, take the base off, learn the noise; again about the delays that are found.

        To first order a lag is found from none, and a filter's delay looks like one. A lag beyond that is started from
        as it was measured; what the recording is better explained from is kept.
        """
        found = cls._settled(session, free, seed, {})
        start = measured_start(session)
        if start:
            moved = cls._settled(session, free, seed, start)
            found = moved if better_than(moved, found) else found
        return without_filter(found, partial(cls._settled, session, free, seed))

    @classmethod
    def _settled(
        cls, session: SimulationSession, free: tuple[str, ...], seed: int, about: About, without: Without = NONE
    ) -> SimulationProblem:
        problem = cls._about(session, free, seed, about, without)
        before, about = about, problem._nonlinear()
        for _ in range(SIMULATION_CHOICE.turns):
            if _near(before, about):
                break
            problem = cls._about(session, free, seed, about, without)
            before, about = about, problem._nonlinear()
        return problem

    def about_clock(self, shift_s: float) -> SimulationProblem:
        """The same with its columns made about a shift of the clock."""
        return self._about(self.session, self.free, self.seed, {OFFSET: (shift_s,)}, self.design.without)

    def whole_term(self, effect: str) -> Term | None:
        """All amplitudes of an effect, at the first of its shapes; None where it is no candidate."""
        for i, candidate in enumerate(self.candidates):
            if candidate.id == effect:
                return next((Term(i, j) for j, variant in enumerate(candidate.variants) if variant.whole), None)
        return None

    def _nonlinear(self) -> About:
        """What a first choice says of effects that are not linear."""
        found = self.fit(self.chosen.terms, self.noise).parameters
        about: dict[str, tuple[float, ...]] = {}
        for candidate in self.candidates:
            effect = candidate.effect
            if isinstance(effect, OnChannels) and effect.relinearised:
                fitted = found.get(candidate.id, {})
                values = [(fitted[p.name].value if p.name in fitted else 0.0, p.gate[0]) for p in effect.parameters]
                # what cannot be negative is nothing where it was fitted so
                sizes = tuple(max(value, 0.0) if least == 0.0 else value for value, least in values)
                if any(sizes):
                    about[candidate.id] = sizes
        channels = self.session.as_channels({})
        return taken_alike(about, channels.kinds(), channels.in_time, len(channels.names))

    @classmethod
    def _about(
        cls, session: SimulationSession, free: tuple[str, ...], seed: int, about: About, without: Without = NONE
    ) -> SimulationProblem:
        design = SimulationDesign(session, free, about, without)
        session = session.about(about)
        residual = session.readings - session.original
        if design.base.size:
            columns = np.stack([design.column(int(k)) for k in design.base])
            kept = np.ones(session.n) if session.omitted is None else 1.0 - session.omitted
            sizes = np.maximum(residual.std(axis=1, keepdims=True), 1e-12)
            rows = (columns / sizes * kept).reshape(len(columns), -1)
            weights = np.linalg.lstsq(rows.T, (residual / sizes * kept).reshape(-1), rcond=1e-9)[0]
            residual = residual - np.tensordot(weights, columns, 1)
        noise = by_activity(design, estimate(design, residual, seed, only=design.before_noise), residual)
        return cls(
            design.candidates,
            design.unobservable,
            free,
            seed,
            session,
            design,
            residual,
            noise,
            InnerProducts.of(design, noise, residual),
        )

    @cached_property
    def _plain(self) -> RowsSelectionState:
        """As judged without any memory."""
        return super().prepare(self.coloured_noise)

    @cached_property
    def chosen(self) -> RowsSelectionState:
        """The effects with names that are chosen first, without any memory."""
        terms = [m for m in self._plain.selector.select() if self.candidates[m.candidate].named]
        return replace(self._plain, terms=terms)

    def prepare(self, noise: RotationNoise) -> RowsSelectionState:
        limits = self._plain
        found = super().prepare(noise) if noise.memories else limits
        # what is drawn to find the thresholds has no random walk in it: they are those of the noise without
        selector = replace(found.selector, threshold=limits.selector.threshold, most=SIMULATION_CHOICE.most_named)
        return replace(found, selector=selector, scan_threshold=limits.scan_threshold)

    def locate_whole(
        self, selection: SelectionState[RotationNoise], signal: Array, terms: Sequence[Term], p: float, share: float
    ) -> tuple[Location, ...]:
        # the covariates are what was recorded, and have no cells
        return self.locate(selection, signal, selection.selector.space_with(terms), p, share)

    def completed(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        # causes and manoeuvres are given for the library's own effects
        kinds = [[self.channels[c] for c in own] for own in self.session.as_channels({}).kinds().values()]
        told = with_the_other(diagnosis, kinds, self._plain.selector.size)
        return with_constants(with_jitter(told, self.noise, self.channels))

    @property
    def policy(self) -> ProblemPolicy:
        return SIMULATION

    def stability(self, selection: SelectionState[RotationNoise], term: Term) -> Stability | None:
        return stability_beside(self, selection, term)

    def steady(
        self, selection: SelectionState[RotationNoise], terms: list[Term]
    ) -> tuple[list[Term], dict[str, Stability]]:
        return steady_terms(self, selection, terms)

    def beyond_memory(
        self, selection: SelectionState[RotationNoise], terms: Sequence[Term], cell: int, dof: int
    ) -> bool:
        # the memory that was found is the best beside the claims, not the best that could stand in the cell's place
        own = self.design.where[self.design.cells[cell]]
        return beats_random_walk(self.likelihoods([]), self.block(terms), own, dof, certain=selection.scan_threshold)

    def believed(self, selection: SelectionState[RotationNoise], terms: list[Term]) -> list[Term]:
        terms = [m for m in terms if not self._within_memory(selection.noise, m, terms)]
        return without_doubtful(self, selection, more_than_remainders(self, selection, terms))

    def _within_memory(self, noise: RotationNoise, term: Term, terms: Sequence[Term]) -> bool:
        """Whether an offset is no larger than the mean of a level, walking or forgetful, as large as the noise may
        hold."""
        effect = self.candidates[term.candidate].effect
        if effect is None or not effect.constant or not noise.memories:
            return False
        numbers = [
            int(k) for m in terms if self.candidates[m.candidate].named for k in self.variant(m).columns if k >= 0
        ]
        every = np.concatenate([self.design.base, np.array(numbers, dtype=np.intp)])
        gram, moment = self.inner_products(every)
        sizes = np.linalg.lstsq(gram, moment, rcond=1e-12)[0]
        for number in self.variant(term).columns:
            c = int(np.flatnonzero(self.design.where[number] >= 0)[0])
            white = np.mean(noise.weight[c]) * np.sum(noise.filters[c])
            mean = sizes[int(np.flatnonzero(every == number)[0])] * white
            if abs(mean) > SIMULATION_CHOICE.far * np.sqrt(self.random_walks[c].mean_variance(noise.memories[c])):
                return False
        return True

    def slow(self) -> list[SlowEffect]:
        found = []
        for i, candidate in enumerate(self.candidates):
            if candidate.slow:
                for j, variant in enumerate(candidate.variants):
                    number = int(variant.columns[0])
                    if variant.columns.size == 1 and number >= 0:
                        tries = max(candidate.searched / len(candidate.variants), 1.0)
                        found.append(SlowEffect(i, j, self.design.where[number], tries=tries))
        return found

    def fit(self, terms: Sequence[Term], noise: RotationNoise, *, with_second_order: bool = True) -> JointFit:
        """Least squares of base and terms in the space of the judged noise."""
        if not terms:
            return JointFit({}, self.residual, ())
        numbers = [np.asarray(self._whole(m), dtype=np.intp) for m in terms]
        moved = self._clock_moved(terms, numbers)
        claimed = np.concatenate(numbers)
        every = np.concatenate([self.design.base, claimed[claimed >= 0]])
        gram, moment = self.inner_products(every)
        if moved:
            whole = np.array(list(moved), dtype=np.intp)
            both = self.inner_products(np.concatenate([every, whole]))[0]
            moment = moment - both[: every.size, every.size :] @ np.array(list(moved.values()))
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram / np.outer(size, size))
        good = values > 1e-9 * values[-1]
        inverse = (vectors[:, good] / values[good]) @ vectors[:, good].T / np.outer(size, size)
        solution = inverse @ moment
        # blocks of rows that depart together count as one: the sandwich of their scores, never less than the plain one
        scores = np.zeros((self.products.chance[0].shape[0], every.size))
        for c, products in enumerate(self.products.chance):
            functions = self.design.where[every, c]
            scores[:, functions >= 0] += products[:, functions[functions >= 0]]
        robust = inverse @ (scores.T @ scores) @ inverse
        std = np.sqrt(np.maximum(np.maximum(np.diag(inverse), np.diag(robust)), 0.0))
        half = student_quantile(INTERVALS.upper, self.noise.freedom)
        tables: dict[str, dict[str, FittedParameter]] = {}
        outside: list[str] = []
        amounts: dict[str, tuple[tuple[int, float], ...]] = {}
        left = self.residual.copy()
        for number, amount in moved.items():
            left -= amount * self.design.column(number)
        at = self.design.base.size
        fitted = dict(zip(every.tolist(), solution.tolist(), strict=True))
        for k in range(every.size):
            left -= solution[k] * self.design.column(int(every[k]))
        for term, own in zip(terms, numbers, strict=True):
            effect = self.design.effect_of(term.candidate)
            starts = self.design.about.get(effect.id, ()) if effect.id in self.design.tangents else ()
            table: dict[str, FittedParameter] = {}
            for i, (parameter, number) in enumerate(zip(effect.parameters, own, strict=True)):
                if number < 0:
                    continue
                value, error = float(solution[at]) + (starts[i] if starts else 0.0), float(std[at])
                at += 1
                table[parameter.name] = FittedParameter(
                    value, error, value - half * error, value + half * error, parameter.unit
                )
                if value + 2 * error < parameter.gate[0] or value - 2 * error > parameter.gate[1]:
                    outside.append(f"{effect.id}.{parameter.name}")
            for name, value in self.variant(term).shape.items():
                table[name] = self._of_shape(name, value, term)
            tables[effect.id] = table
            exact = [(n, a) for n, a in moved.items() if starts and n in self.numbers_of(term)]
            amounts[effect.id] = (*exact, *((n, fitted[n]) for n in own.tolist() if n in fitted))
        return JointFit(tables, left, tuple(outside), amounts=amounts)

    def _of_shape(self, name: str, value: float, term: Term) -> FittedParameter:
        """The frequency of a line, or the instant of a step: what their strength leaves of it."""
        gram, moment = self.inner_products(np.concatenate([self.design.base, self.numbers_of(term)]).astype(np.intp))
        strength = max(float(moment @ solved(gram, moment)), 1.0)
        if name == TONE_SHAPE:
            # the bound of Cramer and Rao of a wave in white noise: sqrt(3 / strength) / (pi T)
            error = float(np.sqrt(3.0 / strength) / (np.pi * self.session.n * self.session.step_s))
        else:
            # Yao, Ann. Statist. 15, 1987: rows by which a change of level is missed, times the square of its size
            after = float(np.mean(self.session.elapsed_s >= value))
            rows = SIMULATION_CHOICE.missed * self.session.n * after * (1.0 - after) / strength
            error = self.session.step_s * max(rows, SIMULATION_CHOICE.within_a_row)
        half = INTERVALS.normal * error
        return FittedParameter(value, error, value - half, value + half, "Hz" if name == TONE_SHAPE else "s")

    def _clock_moved(self, terms: Sequence[Term], numbers: list[NDArray[np.intp]]) -> dict[int, float]:
        """What moves the clock is taken out as it is, and fitted by what a little more of it would do: the columns that
        are taken out, with their amounts; in `numbers` those by which they are fitted take their place."""
        moved: dict[int, float] = {}
        for i, term in enumerate(terms):
            values = self.design.about.get(self.candidates[term.candidate].id, ())
            tangents = self.design.tangents.get(self.candidates[term.candidate].id)
            if any(values) and tangents is not None:
                moved |= {int(k): value for k, value in zip(numbers[i], values, strict=True) if k >= 0}
                numbers[i] = np.where(numbers[i] >= 0, tangents, -1)
        return moved

    def _whole(self, term: Term) -> NDArray[np.intp]:
        """All amplitudes of the effect at the term's shape; of one that acts on single channels, those alone."""
        candidate, variant = self.candidates[term.candidate], self.variant(term)
        if variant.whole:
            return variant.columns
        # of a lag several time constants are tried, each with columns of its own
        whole = next(v for v in candidate.variants if v.whole and np.isin(variant.columns, v.columns).all())
        kept = np.isin(whole.columns, variant.columns)
        return np.where(kept, whole.columns, -1)

    def inner_products(self, numbers: NDArray[np.intp]) -> tuple[Array, Array]:
        """(K, K) and (K,) whitened inner products of columns with one another and with the residual."""
        gram, moment = np.zeros((numbers.size, numbers.size)), np.zeros(numbers.size)
        for c, own in enumerate(self.grams):
            functions = self.design.where[numbers, c]
            shows = np.flatnonzero(functions >= 0)
            total = own.total
            gram[np.ix_(shows, shows)] += total[np.ix_(functions[shows], functions[shows])]
            moment[shows] += total[functions[shows], -1]
        return gram, moment

    def advice(self, term: Term, r: Rivalry, fit: JointFit) -> str:
        return self.design.effect_of(term.candidate).splitter

    def proof(self, terms: Sequence[Term], fit: JointFit) -> Fit:
        held = HeldOutRows(self.design, self.grams)
        parts = [np.asarray(self.variant(m).columns, dtype=np.intp) for m in terms]
        numbers = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        before, after = held.energies(numbers[:0], held.folds), held.energies(numbers, held.folds)
        rows = np.array([held.scored(fold) for fold in held.folds])
        low, high = gain_interval(before, after)
        shown = self.shown(terms)
        unit = self.session.units[shown[0]]
        kept = slice(None) if self.session.omitted is None else ~self.session.omitted
        plain = self._plain_held_out(numbers, shown)
        names = ", ".join(self.session.names[c] for c in shown)
        words = (
            f"{len(held.folds)} contiguous stretches; figures are of {names}; gain = share of the whitened mean square "
            f"of all channels removed ({1 - after.sum() / before.sum():.1%} of {int(rows.sum())} readings)"
        )
        return Fit(
            unit=unit,
            rmse_before=float(np.sqrt(np.mean(self.residual[shown][:, kept] ** 2))),
            rmse_after=float(np.sqrt(np.mean(fit.residual[shown][:, kept] ** 2))),
            heldout_rmse_before=plain[0],
            heldout_rmse_after=plain[1],
            heldout_gain_low=low,
            heldout_gain_high=high,
            noise_floor=float(np.sqrt(np.mean(self.noise.sigma[shown] ** 2))),
            how_held_out=words,
        )

    def shown(self, terms: Sequence[Term]) -> list[int]:
        """The channels that the figures are of: the one that the first claim changes most, in units of its noise, and
        all others of its unit."""
        first = 0
        if terms:
            numbers = np.asarray(self.variant(terms[0]).columns, dtype=np.intp)
            columns = [self.design.column(int(k)) / self.noise.sigma[:, None] for k in numbers[numbers >= 0]]
            first = int(np.argmax(np.sum(np.square(columns), axis=(0, 2))))
        return [c for c, unit in enumerate(self.session.units) if unit == self.session.units[first]]

    def _plain_held_out(self, numbers: NDArray[np.intp], shown: Sequence[int]) -> tuple[float, float]:
        """Rms, in the channels' unit, of stretches that the weights were not fitted to: without and with columns."""
        fold = self.products.segments.fold
        kept = np.ones(self.session.n, dtype=bool) if self.session.omitted is None else ~self.session.omitted
        parts = sorted({key for gram in self.grams for key in gram.parts})
        found = []
        for chosen in (numbers[:0], numbers):
            every = np.concatenate([self.design.base, chosen[chosen >= 0]])
            columns = np.array([self.design.column(int(k))[shown] for k in every])
            total, count = 0.0, 0
            for number in np.unique(fold):
                rows = (fold == number) & kept
                left = self.residual[shown][:, rows]
                if every.size:
                    solution = self._solution(every, [key for key in parts if key[0] != number])
                    left = left - np.tensordot(solution, columns[:, :, rows], 1)
                total, count = total + float(np.sum(left**2)), count + left.size
            found.append(float(np.sqrt(total / max(count, 1))))
        return found[0], found[1]

    def _solution(self, every: NDArray[np.intp], keys: Sequence[Key]) -> Array:
        if not every.size:
            return np.empty(0)
        kept = [replace(g, parts={k: g.parts[k] for k in keys if k in g.parts}) for g in self.grams]
        part = replace(self, products=replace(self.products, grams=kept))
        gram, moment = part.inner_products(every)
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        return np.asarray(np.linalg.lstsq(gram / np.outer(size, size), moment / size, rcond=1e-9)[0] / size)

    def report_data(self, fit: JointFit | None) -> ReportData:
        after = self.residual if fit is None else fit.residual
        return ReportData(
            self.session,
            self.residual,
            after,
            self.channels,
            self.session.units,
            covariates_of(self.session),
            recorded=self.session.readings,
            parts=parts_of_amounts(self.design, {} if fit is None else fit.amounts),
            sigma=tuple(float(s) for s in self.noise.sigma),
        )

    def noise_summary(self) -> dict[str, Any]:
        a = self.session.alignment
        return {
            **super().noise_summary(),
            "sigma": dict(zip(self.channels, (float(s) for s in self.noise.sigma), strict=True)),
            "alignment": {
                "lag_s": a.lag_s,
                "shift_s": a.shift_s,
                "correlation": a.correlation,
                "same_clock": a.same_clock,
                "rate": a.rate,
                "lags_s": dict(a.lags_s),
                "overlap_s": float(np.ptp(self.session.state.t_s)),
                "omitted": 0.0 if self.session.omitted is None else float(np.mean(self.session.omitted)),
                "rows_hz": 1.0 / self.session.step_s,
                "band_hz": self.session.band_hz,
            },
        }


def _near(one: About, other: About) -> bool:
    """Whether another turn would change nothing that shows."""
    if one.keys() != other.keys():
        return False
    settled = {name: SIMULATION_CHOICE.exact if name in (OFFSET, SKEW) else SIMULATION_CHOICE.settled for name in one}
    return all(
        abs(a - b) <= settled[name] * max(abs(a), abs(b))
        for name, values in one.items()
        for a, b in zip(values, other[name], strict=True)
    )
