"""A session of which only the magnitude of gravity is known, prepared for the diagnosis: one channel, `g_total`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term, ranked, ranking, span_with
from highside.diagnosis.core.candidates import pose_candidates, unnamed_interactions
from highside.diagnosis.core.causes import located_by_cause
from highside.diagnosis.core.fit import JointFit, base_fit, joint_fit
from highside.diagnosis.core.floor import Excess, excess
from highside.diagnosis.core.held_out import HeldOutBlocks, block_gain
from highside.diagnosis.core.independent_noise import IndependentNoise
from highside.diagnosis.core.memory import Channel, Likelihoods, Memory, SlowEffect
from highside.diagnosis.core.policy import CANDIDATE_SET, HELD_OUT, INTERVALS, REGRESSION, SELECTION
from highside.diagnosis.core.problem import ReportData, parts_of
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.repeatability import Remaining
from highside.diagnosis.core.result import DiagnosisResult, NotTestable
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.still_problem import Folds, IndependentProblem
from highside.diagnosis.magnitude.candidates import (
    bases_of,
    beyond_linear,
    finer_step,
    projected,
    short_enough,
    visible,
)
from highside.diagnosis.magnitude.fit import fitted_columns, from_the_start, least
from highside.diagnosis.magnitude.noise import plainly_required, rich_columns, scatter
from highside.diagnosis.magnitude.observed import Magnitudes
from highside.diagnosis.magnitude.policy import AT_REST, MAGNITUDE, MAGNITUDE_CHOICE
from highside.diagnosis.magnitude.projected_random_walk import ProjectedRandomWalkLikelihoods, ProjectedRandomWalkNoise
from highside.diagnosis.magnitude.remainder import READINGS, levels_differ, with_what_is_left
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.diagnosis.magnitude.shapes import sharpened
from highside.physics.effect import Stage
from highside.physics.effects import all_effects, get
from highside.physics.forward import ForwardModel

Shapes = dict[str, dict[str, float]]

CHANNEL = "g_total"


@dataclass(frozen=True)
class MagnitudeProblem(IndependentProblem):
    """n still readings of unknown attitude."""

    session: MagnitudeSession
    observed: Magnitudes

    about: Shapes = field(default_factory=dict)
    """effects beside the free ones, with their shapes, at whose fitted sizes everything is taken to first order"""

    readings = READINGS
    own_draws = False

    @classmethod
    def of(cls, session: MagnitudeSession, model: ForwardModel, free: tuple[str, ...], seed: int) -> MagnitudeProblem:
        """Fit the base, make the columns, learn the noise.

        The length of a vector is not linear in an offset of a tenth of it: the square of what was left out would pass
        for products of loads. So columns and residual are taken where what is plainly required has its fitted size.
        """
        observed = Magnitudes(session)
        problem = cls._about(observed, model, free, seed, {})
        while not session.rest and len(problem.about) < SELECTION.most:
            about = problem._nearest(model)
            if about is None:
                break
            problem = cls._about(observed, model, free, seed, about)
        return problem

    @classmethod
    def _about(
        cls, observed: Magnitudes, model: ForwardModel, free: tuple[str, ...], seed: int, about: Shapes
    ) -> MagnitudeProblem:
        session = observed.session
        offsets = tuple(e.id for e in all_effects().values() if e.constant and e.stage is Stage.SENSOR and e.id in free)
        if session.rest and offsets:
            # offset, scale and matrix show alike; an offset leaves the directions as they are
            model = base_fit(model, observed, offsets, steps=MAGNITUDE_CHOICE.steps)[0]
        model, columns, residual = _fitted(observed, model, free, about)
        names = model.free_names(free) if free else []
        values = model.get_free(list(about)) if about else np.empty(0)
        # as if the others had been left out, but to first order about what they are
        base, others = observed.shown(columns[: len(names)], names), columns[len(names) :]
        residual = outside(span(base[:, 0]), residual + np.tensordot(values, others, 1))
        aligned = observed.aligned(model)
        candidates, unobservable = visible(observed, model, *pose_candidates(model, aligned.state, free))
        if not session.rest:
            force = np.asarray(model.chain(aligned.state).force, dtype=float)
            candidates += projected(observed, model, unnamed_interactions(aligned.state, force))
        if session.rest:
            candidates = sharpened(observed, model, candidates, base, residual)
            candidates = short_enough(candidates, float(np.ptp(session.t_s)))
        candidates = beyond_linear(candidates, base)
        bases = bases_of(session, aligned.state.reading.shape[1])
        rich = plainly_required(rich_columns(base, candidates, bases), base, residual, candidates)
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
            scatter(session, residual, rich),
            about,
        )

    def _nearest(self, start: ForwardModel) -> Shapes | None:
        """One effect more to take everything about: of those that are plainly required, the one that comes nearest as
        it is, not to first order; none where nothing is required."""
        noise, ids = self.noise, [c.id for c in self.candidates]
        candidate_set = CandidateSet(
            self.candidates, [noise.white(v.columns) for c in self.candidates for v in c.variants]
        )
        known = [m for m in candidate_set.terms if ids[m.candidate] in self.about and self.variant(m).whole]
        known = [m for m in known if self.variant(m).shape == self.about[ids[m.candidate]]]
        space = span_with(span(noise.white(self.base)), candidate_set.stack(known))
        after = ranking(candidate_set, space, noise.white(self.residual), noise.freedom, self.session.n)
        limit = -np.log10(CANDIDATE_SET.alarm_rate / len(ids))
        required = [k for k in ranked(after.bic) if after.log_p[k] > limit]
        required = [k for k in required if self.candidates[k].named and ids[k] not in self.about]
        # every sensor has these: what few have may resemble one of them, and hide that another is required beside it
        calibrated = [k for k in required if (e := self.candidates[k].effect) is not None and e.calibrated]
        required = calibrated or required
        tried = []
        for k in required[: SELECTION.shortlist]:
            about = {**self.about, ids[k]: self.variant(after.best[k]).shape}
            left = _fitted(self.observed, start, self.free, about)[2]
            tried.append((float(np.sum(left**2)), k, about))
        if not tried:
            return None
        _, nearest, about = min(tried)
        # what comes and goes with time is small
        return about if not self.candidates[nearest].slow else None

    @cached_property
    def policy(self) -> ProblemPolicy:
        # a few readings are soon explained by anything
        room = self.session.n - int(span(self.base[:, 0]).shape[0])
        most = max(1, min(SELECTION.most, room // MAGNITUDE_CHOICE.per_name))
        return replace(AT_REST if self.session.rest else MAGNITUDE, most_named=most)

    @property
    def channels(self) -> tuple[str, ...]:
        return (CHANNEL,)

    @property
    def slow_ids(self) -> frozenset[str]:
        if not self.session.rest:
            return super().slow_ids
        # at rest the load is constant: whatever shows at all follows time or temperature
        return frozenset(c.id for c in self.candidates)

    def folds(self, *, apart: bool = False) -> tuple[Folds, str] | None:
        if apart:
            return None
        n = self.session.n
        single = not self.session.rest and n <= MAGNITUDE_CHOICE.one_by_one
        count = n if single else min(MAGNITUDE_CHOICE.blocks, n // HELD_OUT.poses_a_fold)
        words = "each pose left out in turn" if count == n else f"{count} contiguous stretches"
        return list(np.array_split(np.arange(n), count)), words

    def likelihoods(self, terms: Sequence[Term]) -> list[Channel]:
        if self.session.rest:
            return super().likelihoods(terms)
        explained = np.concatenate([self.base, self.block(terms)])[:, 0]
        residual, variance, t_s = self.residual[0], self.noise.std[0] ** 2, self.session.t_s
        return [ProjectedRandomWalkLikelihoods(residual, variance, explained, t_s, self.session.direction)]

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

    def remaining(self, terms: Sequence[Term]) -> Remaining | None:
        if self.session.floor is None:
            return None
        floor = self.session.floor.sigma[0]
        base = outside(span(self.base[:, 0] / floor), self.residual[0] / floor)
        block = (self._finer(terms) if self.session.rest else self).block(terms)
        space = span(np.concatenate([self.base, block])[:, 0] / floor)
        left = outside(space, base)
        onsets = sum(any(p.epoch for p in e.shapes) for m in terms if (e := self.candidates[m.candidate].effect))
        return Remaining(float(base @ base), float(left @ left), float(self.session.n - space.shape[0] - onsets))

    def holds_up(self, term: Term) -> bool:
        unit, folds = self.noise.std[0], self.folds()
        assert folds is not None
        held_out = HeldOutBlocks(self.base[:, 0] / unit, self.residual[0] / unit, folds[0])
        energies = [
            np.array([float(e @ e) for e in held_out.errors(self.block(terms)[:, 0] / unit)]) for terms in ([], [term])
        ]
        gain, error = block_gain(*energies)
        return gain > error

    def with_memory(self, memories: Sequence[Memory]) -> IndependentNoise:
        return self._remembering(memories[0].length, memories[0].variance_share)

    def _remembering(self, length: float, share: float) -> IndependentNoise:
        """The noise with a memory of `length` readings and a variance of `share` of the white part's."""
        if self.session.rest:
            return self.noise.remembering([length], [share], self.session.t_s)
        level = ProjectedRandomWalkNoise.of(
            self.noise.std[0] ** 2, self.session.direction, self.session.t_s, np.array([share])
        )
        return replace(self.noise, levels=(level,))

    def _widest(self, terms: Sequence[Term], noise: IndependentNoise) -> IndependentNoise:
        """The noise with the largest random walk that the readings allow at 95 % beside the terms.

        At rest all that shows is slow. That a random walk is not needed beside an effect does not say that there is
        none: with it, an amplitude is known less well by far.
        """
        channel = self.likelihoods(terms)[0]
        assert isinstance(channel, Likelihoods)
        fits = channel.without(self.base[:0, 0])
        random_walks = [
            share
            for (length, share), fit in zip(channel.settings, fits, strict=True)
            if np.isinf(length) and fit <= fits.min() + INTERVALS.chi2_95
        ]
        return self._remembering(np.inf, max(random_walks)) if random_walks else noise

    def _finer(self, terms: Sequence[Term]) -> MagnitudeProblem:
        """With steps of a rest at the instants at which they fit best, also between those that were searched."""
        candidates = list(self.candidates)
        elapsed = self.session.t_s - self.session.t_s[0]
        for m in terms:
            candidate = candidates[m.candidate]
            onset = [p.name for p in candidate.effect.shapes if p.epoch] if candidate.effect is not None else []
            if onset and len(self.variant(m).shape) == 1:
                others = self.block([o for o in terms if o != m])[:, 0]
                space = span(np.concatenate([self.base[:, 0], others]))
                variants = list(candidate.variants)
                variants[m.variant] = finer_step(
                    variants[m.variant], variants, onset[0], elapsed, space, self.residual[0]
                )
                candidates[m.candidate] = replace(candidate, variants=tuple(variants))
        return replace(self, candidates=candidates)

    def fit(self, terms: Sequence[Term], noise: IndependentNoise, *, with_second_order: bool = True) -> JointFit:
        if not self.session.rest or not terms:
            return self._fit(terms, noise)
        finer = self._finer(terms)
        return finer._fit(terms, finer._widest(terms, noise))

    def _fit(self, terms: Sequence[Term], noise: IndependentNoise) -> JointFit:
        ids = [self.candidates[m.candidate].id for m in terms]
        model = self.model.without(*(name for name in self.about if name not in ids))
        found = joint_fit(model, self.observed, self.free, self.candidates, terms, noise, noise.freedom)
        if not terms:
            return replace(found, residual=self.residual)
        tables = dict(found.parameters)
        parts = {}
        for term in terms:
            candidate = self.candidates[term.candidate]
            parts[candidate.id] = fitted_columns(self.observed, model, candidate, tables[candidate.id])
        for term in terms:
            candidate = self.candidates[term.candidate]
            own, slopes = parts[candidate.id]
            others = [c for name, both in parts.items() if name != candidate.id for c in both]
            space = span(noise.white(np.concatenate([self.base, slopes, *others])))
            names = [f"{candidate.id}.{name}" for name in candidate.amplitudes]
            shown = self.observed.directions(names, candidate.unit())
            tables[candidate.id] = least(
                tables[candidate.id], candidate, outside(space, noise.white(own)), shown, noise.freedom
            )
        delay_s = float(self.session.t_s[0]) - self.session.began_s
        tables_from_start = {name: from_the_start(table, get(name), delay_s) for name, table in tables.items()}
        return replace(found, parameters=tables_from_start)

    def advice(self, term: Term, r: Rivalry, fit: JointFit) -> str:
        effect = self.candidates[term.candidate].effect
        assert effect is not None
        return f"{effect.splitter}; more attitudes of the tool, spread over the whole sphere, held still"

    def floor_excess(self, terms: Sequence[Term], *, pose_errors: bool = True) -> Excess | None:
        floor = self.session.floor
        return None if floor is None else excess(self.residual, np.concatenate([self.base, self.block(terms)]), floor)

    def completed(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        lacking = (*diagnosis.not_testable, *self._not_parted())
        diagnosis = replace(diagnosis, not_testable=lacking)
        undetermined = [entry.effect for entry in self._not_parted()]
        if undetermined and not self.session.rest and diagnosis.verdict == "nothing_left_out":
            # what is free and not determined may have taken up anything
            words = f"{', '.join(undetermined)} may be refitted and cannot be determined by this recording"
            remainder = replace(diagnosis.remainder, hints=(words, *diagnosis.remainder.hints))
            diagnosis = replace(diagnosis, verdict="not_testable", remainder=remainder)
        if (
            self.session.rest
            and diagnosis.verdict == "nothing_left_out"
            and (words := levels_differ(self.session, self.free, self.policy.floor_ratio))
        ):
            remainder = replace(diagnosis.remainder, hints=(words, *diagnosis.remainder.hints))
            diagnosis = replace(diagnosis, verdict="not_testable", remainder=remainder)
        left = self.floor_excess([])
        if left is not None:
            slow = [c for c in self.candidates if c.slow and c.named]
            diagnosis = with_what_is_left(diagnosis, left, self.session, slow, self.base[:, 0], self.residual[0])
        diagnosis = located_by_cause(diagnosis, self.model.without(*self.about), self.session.state)
        if not self.session.rest or not diagnosis.claims:
            return diagnosis
        words = (
            "in one attitude only what acts along gravity shows: the parameters are its smallest explanation, and what "
            "acts across gravity, or whether an offset or a scale factor changes, is not determined"
        )
        remainder = replace(diagnosis.remainder, hints=(words, *diagnosis.remainder.hints))
        return replace(diagnosis, remainder=remainder)

    def _not_parted(self) -> list[NotTestable]:
        """Free effects of which the magnitudes show nothing that the other free ones do not show as well."""
        found = []
        columns = self.observed.jacobian(self.model, self.free)
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

    def report_data(self, fit: JointFit | None) -> ReportData:
        base = self.model.without(*self.about)
        return replace(
            super().report_data(fit),
            parts=parts_of(base, fit, self.observed),
            sigma=(float(np.sqrt(np.mean(self.noise.std**2))),),
        )

    def noise_summary(self) -> dict[str, Any]:
        return {
            "model": "of the magnitude, per reading",
            "reference": self.session.found,
            "sigma_g": [float(np.sqrt(np.mean(self.noise.std**2)))],
            "repeats_g": None if self.session.floor is None else float(np.sqrt(np.mean(self.session.floor.sigma**2))),
            "degrees_of_freedom": self.noise.freedom,
        }


def _fitted(
    observed: Magnitudes, model: ForwardModel, free: Sequence[str], about: Shapes
) -> tuple[ForwardModel, Array, Array]:
    """The model with the amplitudes of the free effects and of those of `about`, columns (P, 1, n), residual (1, n)."""
    model = model.with_effects({name: shape for name, shape in about.items() if name not in model.ids})
    model, residual = base_fit(model, observed, (*free, *about), steps=MAGNITUDE_CHOICE.steps)
    return model, observed.jacobian(model, (*free, *about)), residual


def _alike(one: Array, other: Array) -> bool:
    return bool(abs(one @ other) > MAGNITUDE_CHOICE.alike * np.linalg.norm(one) * np.linalg.norm(other))
