"""Problems of readings at rest, a reading for each still interval, whose columns are all at hand.

All that the procedure asks is done here from a few arrays (columns of the base, residual, rich model, noise); a kind of
knowledge says how these are made (`StillProblem`'s fields), and what its noise is. With noise that is independent from
reading to reading (`independent_noise`) it says no more: `IndependentProblem`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term, pose_flips, threshold
from highside.diagnosis.core.candidates import CHANNELS, Candidate
from highside.diagnosis.core.fit import JointFit, joint_fit
from highside.diagnosis.core.held_out import HeldOutBlocks, PoseGains, block_proof, pose_folds
from highside.diagnosis.core.independent_noise import IndependentNoise
from highside.diagnosis.core.location import Basis, locate, on_channel, scan_of
from highside.diagnosis.core.memory import Channel, Likelihoods, Memory, SlowEffect
from highside.diagnosis.core.observed import ObservationModel
from highside.diagnosis.core.policy import FITS
from highside.diagnosis.core.problem import HasState, N, Noise, Problem, ReportData, SelectionState
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Fit, Location
from highside.diagnosis.core.rivals import Rivalry
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.stability import Stability, splits_of, stability
from highside.physics.forward import ForwardModel

Folds = list[NDArray[np.intp]]


class StillSession(HasState, Protocol):
    """Readings at rest, one of each still interval."""

    @property
    def n(self) -> int:
        """How many are used."""
        ...

    @property
    def expected(self) -> int:
        """About how many there are; 0 where that is not known."""
        ...


@dataclass(frozen=True)
class StillProblem(Problem[N]):
    """n readings at rest; terms have their columns (k, C, n) at hand."""

    session: StillSession
    model: ForwardModel
    """with the base fitted"""
    observed: ObservationModel
    """the readings, as a fit sees them"""
    bases: Sequence[Basis]
    """the covariates by which what is left is located"""
    base: Array
    """(P, C, n) derivatives of the readings by what may be refitted"""
    residual: Array
    """(C, n) after the base fit"""
    rich: Array
    """(P, C, n) everything that could be systematic (`rich_columns`)"""
    white_noise: N

    starts: ClassVar[int] = 1
    """candidates from each of which choosing begins"""
    own_draws: ClassVar[bool] = True
    """whether places are judged by other draws of chance than terms"""

    @property
    @abstractmethod
    def noise_size(self) -> float:
        """Standard deviation of a reading, rms over all."""

    @abstractmethod
    def variance(self) -> Array:
        """(C, n) of each reading, memory left aside."""

    @property
    def channels(self) -> tuple[str, ...]:
        return CHANNELS

    @property
    def noise(self) -> N:
        return self.white_noise

    @property
    def refitted(self) -> tuple[str, ...]:
        """Ids of the effects that fits adjust beside the terms."""
        return self.free if self.method.refit else ()

    def folds(self, *, apart: bool = False) -> tuple[Folds, str] | None:
        """What is held out at a time, as indices into (C n,), and in words; with `apart` for what lives within few
        readings, None where that is not done."""
        found = pose_folds(self.session.n, interleaved=apart, channels=len(self.channels))
        if apart:
            k = len(found)
            return found, f"{k} sets of every {k}th pose, since what was found lives within few poses"
        return found, f"{len(found)} contiguous blocks of poses"

    def prepare(self, noise: N) -> SelectionState[N]:
        rng = np.random.default_rng(self.seed)
        fitted = self.base if self.method.refit else self.base[:0]
        rows = noise.white(fitted), noise.white(self.residual)
        base = span(rows[0])
        residual = outside(base, rows[1])
        candidate_set = CandidateSet(
            self.candidates, all_white(noise, [v.columns for c in self.candidates for v in c.variants])
        )
        rich = rich_residual(noise, self.residual, self.rich)
        if not self.method.colour:
            # nothing is remembered: chance is what the F test says
            rich = np.zeros_like(rich)
        chance = pose_flips(rich, rng, len(self.channels))
        limit = threshold(candidate_set.score_test, candidate_set.owner, chance, base, noise.freedom)
        plain, apart = self.folds(), self.folds(apart=True)
        assert plain is not None
        gains = PoseGains(
            candidate_set, HeldOutBlocks(*rows, plain[0]), None if apart is None else HeldOutBlocks(*rows, apart[0])
        )
        selector = Selector(
            candidate_set, base, residual, noise.freedom, limit, gains, residual.size, starts=self.starts
        )
        cells = [(channel, b) for b in range(len(self.bases)) for channel in range(len(self.channels))]
        groups = all_white(noise, [on_channel(self.bases[b].functions, c, len(self.channels)) for c, b in cells])
        scan = scan_of(self.bases, groups, cells, noise.freedom)
        if self.own_draws:
            chance = pose_flips(rich, rng, len(self.channels))
        scan_limit = threshold(scan.score_test, np.arange(len(cells)), chance, base, noise.freedom)
        return SelectionState(selector, scan, scan_limit, [], noise)

    def block(self, terms: Sequence[Term]) -> AnyArray:
        none = np.empty((0, len(self.channels), self.session.n))
        return np.concatenate([none, *(self.variant(m).columns for m in terms)])

    def likelihoods(self, terms: Sequence[Term]) -> list[Channel]:
        variance, t_s = self.variance(), self.session.state.t_s
        explained = np.concatenate([self.base, self.block(terms)])
        return [Likelihoods(self.residual[c], variance[c], explained[:, c], t_s) for c in range(len(self.channels))]

    def slow(self) -> list[SlowEffect]:
        return [
            SlowEffect(i, j, np.broadcast_to(v.columns[0, 0], (len(self.channels), self.session.n)))
            for i, c in enumerate(self.candidates)
            if c.slow
            for j, v in enumerate(c.variants)
            if v.whole
        ]

    def fit(self, terms: Sequence[Term], noise: N, *, with_second_order: bool = True) -> JointFit:
        return joint_fit(
            self.model,
            self.observed,
            self.refitted,
            self.candidates,
            terms,
            noise,
            self.noise.freedom,
            with_second_order=with_second_order,
        )

    def locate(
        self, selection: SelectionState[N], signal: Array, space: Array, p: float, share: float
    ) -> tuple[Location, ...]:
        return locate(selection.scan, signal, space, p, share, self.channels)

    def advice(self, term: Term, r: Rivalry, fit: JointFit) -> str:
        effect = self.candidates[term.candidate].effect
        assert effect is not None
        return effect.splitter

    def proof(self, terms: Sequence[Term], fit: JointFit) -> Fit:
        flat = self.residual.reshape(-1)
        base, claimed = (c.reshape(-1, flat.size) for c in (self.base, self.block(terms)))
        chosen, apart = self.folds(), self.folds(apart=True)
        assert chosen is not None
        held_out = HeldOutBlocks(base, flat, chosen[0])
        if apart is not None and any(held_out.hides(self.block([m]).reshape(-1, flat.size)) for m in terms):
            chosen = apart
        after = fit.residual if fit.parameters else self.residual
        found = block_proof(base, flat, claimed, chosen[0], after, self.noise_size, chosen[1])
        return replace(found, rmse_before=float(np.sqrt(np.mean((self.residual + self.second_order) ** 2))))

    def report_data(self, fit: JointFit | None) -> ReportData:
        after = self.residual if fit is None else fit.residual
        return ReportData(self.session, self.residual + self.second_order, after, self.channels)

    def stability(self, selection: SelectionState[N], term: Term) -> Stability | None:
        selector = selection.selector
        others = selector.space_with([o for o in selection.terms if o != term])
        return stability(
            self.variant(term).columns,
            selection.noise.white,
            others,
            selector.residual,
            selector.freedom,
            splits_of(self.session.state),
        )

    def mean_square_left(self, selection: SelectionState[N]) -> float | None:
        space = selection.selector.space_with(selection.terms)
        left = outside(space, selection.selector.residual)
        return float(left @ left) / max(left.size - len(space), 1)

    @property
    def intervals(self) -> tuple[int, int] | None:
        return self.session.n, max(self.session.n, self.session.expected)


class IndependentProblem(StillProblem[IndependentNoise]):
    """Readings whose noise is independent from one to the next, but for what memory is found."""

    @property
    def noise_size(self) -> float:
        return float(np.sqrt(np.mean(self.noise.std**2)))

    def variance(self) -> Array:
        return np.asarray(self.noise.std**2)

    def with_memory(self, memories: Sequence[Memory]) -> IndependentNoise:
        return self.noise.with_memory(memories, self.session.state.t_s)

    def noise_summary(self) -> dict[str, Any]:
        return {
            "model": "per channel",
            "sigma": [float(s) for s in np.sqrt(np.mean(self.noise.std**2, axis=1))],
            "degrees_of_freedom": self.noise.freedom,
        }


def rich_columns(base: Array, candidates: Sequence[Candidate], bases: Sequence[Basis]) -> Array:
    """Columns (P, C, n) of everything that could be systematic, as many as the readings afford."""
    channels, n = base.shape[1:]
    whole = [[v.columns for v in c.variants if v.whole] for c in candidates if c.named]
    parts = [base, *(columns[0] for columns in whole if len(columns) == 1)]
    groups = [on_channel(b.functions, channel, channels) for b in bases for channel in range(channels)]
    shaped = [columns[i] for columns in whole if len(columns) > 1 for i in _spread(len(columns), FITS.rich_shapes)]
    room = int(FITS.rich_share * channels * n)
    kept: list[Array] = []
    used = 0
    for part in [*parts, *shaped, *groups]:
        if used + len(part) <= room or not kept:
            kept.append(part)
            used += len(part)
    return np.concatenate(kept)


def _spread(count: int, want: int) -> list[int]:
    return sorted({round(x) for x in np.linspace(0, count - 1, min(want, count))})


def rich_residual(noise: Noise, residual: Array, rich: Array) -> Array:
    """Whitened residual (C n,) outside of the rich columns, scaled to unit variance: what sign flips are made of."""
    space = span(noise.white(rich))
    left = outside(space, noise.white(residual))
    return np.asarray(left / np.sqrt(np.maximum(1.0 - np.sum(space**2, axis=0), FITS.rich_left)))


def all_white(noise: Noise, blocks: Sequence[Array]) -> list[Array]:
    """Each block (k, C, n) whitened, (k, C n): in one pass, since one pass in time order serves any number."""
    ends = np.cumsum([len(block) for block in blocks])[:-1]
    return np.split(noise.white(np.concatenate(blocks)), ends)
