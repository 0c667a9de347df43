"""A rotating recording prepared for the diagnosis: columns in chunks, coloured noise, choices by inner products."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.fit import JointFit, base_fit, joint_fit
from highside.diagnosis.core.held_out import gain_interval
from highside.diagnosis.core.location import followed
from highside.diagnosis.core.memory import SlowEffect
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.policy import FITS, RIVALS
from highside.diagnosis.core.problem import ReportData, SelectionState, parts_of
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.result import DiagnosisResult, Fit, Location
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.support import Window
from highside.diagnosis.core.untestable import what_splits, with_manoeuvres
from highside.diagnosis.rotation.advice import next_rates
from highside.diagnosis.rotation.bursts import found_burst, with_burst
from highside.diagnosis.rotation.lines import found_lines
from highside.diagnosis.rotation.means import Sectors, mean_errors
from highside.diagnosis.rotation.pilot import PilotFit, Subsample, pilot_second_order
from highside.diagnosis.rotation.policy import MEANS, PILOT, ROTATION
from highside.diagnosis.rotation.steps import found_step
from highside.diagnosis.rotation.support import rotation_cells, windows
from highside.diagnosis.rotation.ties import with_ties
from highside.diagnosis.rows.design import ChainDesign
from highside.diagnosis.rows.gram import HeldOutRows
from highside.diagnosis.rows.inner_products import InnerProducts
from highside.diagnosis.rows.jitter import with_jitter
from highside.diagnosis.rows.noise import RotationNoise, estimate, plain
from highside.diagnosis.rows.problem import RowsProblem, coordinates_of
from highside.diagnosis.rows.rounding import rounding
from highside.diagnosis.rows.session import FIRST_GYRO, RotationSession
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.scratch_arrays import evaluated

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class RotationProblem(RowsProblem):
    """n rows of a rotation with known reference."""

    model: ForwardModel = field(kw_only=True)
    subsample: Subsample | None = None
    """of a long recording"""
    taken_out: frozenset[str] = frozenset()
    """ids of the effects whose second-order part a pilot fit gave"""

    @classmethod
    def of(
        cls,
        session: RotationSession,
        model: ForwardModel,
        free: tuple[str, ...],
        seed: int,
        method: ProcedureParts = WHOLE,
        pilot: PilotFit | None = None,
    ) -> RotationProblem:
        """Fit the base, learn the noise, pass over the rows. What a pilot fit's terms do beyond first order is taken
        out from the beginning."""
        observed = Observed(session.state, session.readings, session.n > PILOT.many_rows)
        subsample = None
        if session.n > PILOT.many_rows:
            rows = session.thinned(PILOT.pilot_rows, seed) if pilot is None else pilot.session
            model, left = base_fit(model, Observed(rows.state, rows.readings), free)
            subsample = Subsample(rows, plain(left.std(axis=1), rows.n) if pilot is None else pilot.noise)
        model, residual = base_fit(model, observed, free)
        second_order: Array | float = 0.0
        if subsample is not None and pilot is not None and pilot.has_second_order:
            second_order = pilot_second_order(model, observed, free if method.refit else (), subsample, pilot)
            residual = residual - second_order
        residual = evaluated(residual + rounding(session.readings, residual, seed))
        design = ChainDesign(session, model, free, found_lines(session, residual), found_step(session, residual))
        noise = estimate(design, residual, seed, coloured=method.colour)
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
            subsample,
            frozenset(pilot.names) if pilot is not None and np.any(second_order) else frozenset(),
            model=model,
            method=method,
            second_order=second_order,
        )

    @property
    def policy(self) -> ProblemPolicy:
        return ROTATION

    @property
    def relinearises(self) -> bool:
        return True

    def slow(self) -> list[SlowEffect]:
        found = []
        for i, candidate in enumerate(self.candidates):
            if candidate.effect is not None and candidate.slow:
                first = FIRST_GYRO if candidate.effect.stage is Stage.GYRO else 0
                for j, variant in enumerate(candidate.variants):
                    if variant.whole:
                        # the first three are the three axes of the first order
                        own = [self.design.where[variant.columns[c], first + c] for c in range(3)]
                        found.append(SlowEffect(i, j, np.array(own), first))
        return found

    def relinearised(self, second_order: Array | float, *, learn: bool = True) -> RotationProblem:
        left = evaluated(self.residual + self.second_order - second_order)
        noise = estimate(self.design, left, self.seed, coloured=self.method.colour) if learn else self.noise
        return replace(
            self,
            residual=left,
            coloured_noise=noise,
            products=InnerProducts.of(self.design, noise, left),
            second_order=second_order,
            taken_out=frozenset(),
        )

    def fit(self, terms: Sequence[Term], noise: RotationNoise, *, with_second_order: bool = True) -> JointFit:
        observed = Observed(self.session.state, self.session.readings, self.session.n > PILOT.many_rows)
        free = self.free if self.method.refit else ()
        given = (self.model, observed, free, self.candidates, terms, self.noise, self.noise.freedom)
        if self.subsample is None:
            return joint_fit(*given, with_second_order=with_second_order)
        near = self._fitted_to_subsample(terms)
        beyond = near.beyond * self.session.n / self.subsample.session.n
        known = with_second_order and {self.candidates[m.candidate].id for m in terms} == self.taken_out
        fit = joint_fit(
            *given,
            steps=1,
            near=near.model,
            with_second_order=with_second_order and not known and beyond > FITS.second_order,
        )
        if not known:
            return fit
        return replace(fit, second_order=self.residual * 0.0 + self.second_order, beyond=beyond)

    def subsample_chi_square(self, terms: Sequence[Term]) -> float | None:
        return None if self.subsample is None else self._fitted_to_subsample(terms).chi_square

    def _fitted_to_subsample(self, terms: Sequence[Term]) -> JointFit:
        assert self.subsample is not None
        which, subsample = frozenset(terms), self.subsample
        if which not in subsample.fits:
            free = self.free if self.method.refit else ()
            subsample.fits[which] = joint_fit(
                self.model, subsample.observed, free, self.candidates, terms, subsample.noise, subsample.noise.freedom
            )
        return subsample.fits[which]

    def locate_whole(
        self, selection: SelectionState[RotationNoise], signal: Array, terms: Sequence[Term], p: float, share: float
    ) -> tuple[Location, ...]:
        coordinates = coordinates_of(selection)
        fitted = np.concatenate([self.design.base, *(self.variant(m).columns for m in terms)]).astype(np.intp)
        cells = rotation_cells(self.session.state, slow=not any(m.upper for m in selection.noise.memories))

        def ranges(channels: list[int]) -> list[Window]:
            return windows(self.design, self.noise, self.residual, fitted[fitted >= 0], cells, channels, self.parts)

        space = selection.selector.space_with(terms)
        sought = followed(selection.scan, signal, coordinates.channels, space, ranges)
        return () if sought is None else self.placed(sought, coordinates.weights(signal), p, share)

    def advice(self, term: Term, r: Rivalry, fit: JointFit) -> str:
        candidate = self.candidates[term.candidate]
        assert candidate.effect is not None
        rivals = [(self.candidates[k], self.variant(r.best[k]).shape) for k in r.same if k != term.candidate]
        amplitude = np.array([fit.parameters[candidate.id][name].value for name in candidate.amplitudes])
        advice = next_rates(
            self.model,
            self.session,
            self.free,
            (candidate, self.variant(term).shape, amplitude),
            rivals,
            1.0 / self.noise.sigma,
        )
        otherwise = what_splits(candidate.effect, [c.effect for c, _ in rivals if c.effect is not None])
        if advice.after < max(2 * advice.before, RIVALS.same_class_evidence):
            return otherwise
        words = "; ".join(stretch.words for stretch in advice.stretches)
        return f"turn for 20 s each: {words}; otherwise: {otherwise}"

    def proof(self, terms: Sequence[Term], fit: JointFit) -> Fit:
        held = HeldOutRows(self.design, self.grams)
        parts = [np.asarray(self.variant(m).columns, dtype=np.intp) for m in terms]
        numbers = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        none = numbers[:0]
        summary = [(self.candidates[m.candidate].id, v) for m in terms for v in self.variant(m).shape.values()]
        ways = [k for k, line in enumerate(self.design.lines, 1) if (line.effect, line.value) in summary]
        effects = [self.candidates[m.candidate].effect for m in terms]
        if not terms or not all(effect is not None and effect.line for effect in effects):
            ways.insert(0, 0)
        every = np.concatenate([held.base, numbers])
        sectors = Sectors.of(self.design, self.noise, self.residual, self.products.segments, every, ways)
        means = [mean_errors(held, sectors, n) for n in (none, numbers)]
        by_rate = [held.energies(n, held.by_rate).sum() for n in (none, numbers)] if len(held.by_rate) > 1 else [0, 0]
        low, high = gain_interval(means[0].energy, means[1].energy)
        # whitened errors, in g: the innovations' size, and what the filter takes of slow signals
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
            rmse_before=float(np.sqrt(np.mean((self.residual + self.second_order)[:3] ** 2))),
            rmse_after=float(np.sqrt(np.mean(fit.residual[:3] ** 2))),
            heldout_rmse_before=unit * float(np.sqrt(means[0].energy.sum() / size)),
            heldout_rmse_after=unit * float(np.sqrt(means[1].energy.sum() / size)),
            heldout_gain_low=low,
            heldout_gain_high=high,
            noise_floor=unit * float(np.sqrt(means[0].expected.sum() / size)),
            how_held_out=words,
            row_noise=float(np.sqrt(np.mean(self.noise.row_sigma[:3] ** 2))),
        )

    def completed(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        summary = with_manoeuvres(located_by_cause(diagnosis, self.model, self.session.state), self.session.state)
        summary = with_ties(summary, self.session.state)
        summary = with_burst(summary, found_burst(self.products.rest, self.session.places), self.session, self.channels)
        return with_jitter(summary, self.noise, self.channels)

    def report_data(self, fit: JointFit | None) -> ReportData:
        observed = Observed(self.session.state, self.session.readings, self.session.n > PILOT.many_rows)
        before, after = self.residual + self.second_order, self.residual if fit is None else fit.residual
        session, parts = self.session, parts_of(self.model, fit, observed)
        if session.long:
            # some rows stand for all
            rows = session.sample_rows
            session, before, after = session.sample, before[:, rows], after[:, rows]
            parts = {name: one[:, rows] for name, one in parts.items()}
        return ReportData(
            session,
            before,
            after,
            self.channels,
            recorded=session.readings,
            parts=parts,
            sigma=tuple(float(s) for s in self.noise.row_sigma),
            rows_per_independent=self.noise.rows_per_independent,
        )

    def noise_summary(self) -> dict[str, Any]:
        summary = super().noise_summary()
        sigma = [float(s) for s in self.noise.sigma]
        return {"model": summary["model"], "sigma_g": sigma[:3], "sigma_radps": sigma[3:], **summary}
