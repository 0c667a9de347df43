"""A session of which only the magnitude of gravity is known, prepared for the diagnosis: one channel, `g_total`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.candidates import Blind, Candidate, Variant, pose_candidates, shadows
from highside.diagnosis.directed_walk import DirectedLikelihoods, DirectedNoise
from highside.diagnosis.fit import JointFit, base_fit, joint_fit
from highside.diagnosis.location import Basis, followed, intervals, scan_of
from highside.diagnosis.magnitude_noise import MagnitudeNoise, plainly_asked, rich_columns, scatter
from highside.diagnosis.magnitude_observed import Magnitudes
from highside.diagnosis.magnitude_session import MagnitudeSession
from highside.diagnosis.markov import LevelNoise
from highside.diagnosis.memory import Channel, Innovating, Likelihoods, Memory, SlowEffect, SlowLimits
from highside.diagnosis.memory import intervals as in_intervals
from highside.diagnosis.pose_scene import block_proof
from highside.diagnosis.regression import VISIBLE, outside, span
from highside.diagnosis.result import Diagnosis, Fit, FittedParameter, Location
from highside.diagnosis.rivals import Rivalry
from highside.diagnosis.scene import SLOW, Judged, Picture, Scene
from highside.diagnosis.selection import (
    MAX_CLAIMS,
    HeldOut,
    Member,
    Pool,
    PoseGains,
    Selector,
    block_gain,
    pose_flips,
    threshold,
)
from highside.physics.forward import ForwardModel

Array = NDArray[np.float64]

CHANNEL = "g_total"
ONE_BY_ONE = 60
"""Up to so many poses each is left out by itself."""
BLOCKS = 10
ALIKE = 0.999
PER_NAME = 6
"""Readings beyond the base for each effect that is given a name."""


@dataclass(frozen=True)
class MagnitudeScene(Scene):
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

    @classmethod
    def of(cls, session: MagnitudeSession, model: ForwardModel, free: tuple[str, ...], seed: int) -> MagnitudeScene:
        """Fit the base, make the columns, learn the noise."""
        seen = Magnitudes(session)
        model, base, residual = base_fit(model, seen, free, steps=12)
        aligned = seen.aligned(model)
        candidates, blind = _visible(seen, model, *pose_candidates(model, aligned.state, free))
        if not session.rest:
            force = np.asarray(model.chain(aligned.state).force, dtype=float)
            candidates += _projected(seen, model, shadows(aligned.state, force))
        if session.rest:
            candidates = _short_enough(candidates, float(np.ptp(session.t_s)))
        candidates = _beyond_linear(candidates, base)
        bases = _bases(session, aligned.state.reading.shape[1])
        rich = plainly_asked(rich_columns(base, candidates, bases), base, residual, candidates)
        return cls(
            candidates, blind, free, seed, session, model, seen, base, residual, rich,
            scatter(session, residual, rich), bases,
        )  # fmt: skip

    @property
    def channels(self) -> tuple[str, ...]:
        return (CHANNEL,)

    @property
    def noise(self) -> MagnitudeNoise:
        return self.white_noise

    @property
    def slow_ids(self) -> frozenset[str]:
        if not self.session.rest:
            return frozenset(SLOW)
        # at rest the load is constant: whatever shows at all follows time or temperature
        return frozenset(c.id for c in self.candidates)

    @property
    def most_named(self) -> int:
        # a few readings are soon explained by anything
        room = self.session.n - int(span(self.base[:, 0]).shape[0])
        return max(1, min(MAX_CLAIMS, room // PER_NAME))

    def judge(self, noise: MagnitudeNoise) -> Judged:
        rng = np.random.default_rng(self.seed)
        base = span(noise.white(self.base))
        residual = outside(base, noise.white(self.residual))
        pool = Pool(self.candidates, [noise.white(v.columns) for c in self.candidates for v in c.variants])
        space = span(noise.white(self.rich))
        left = outside(space, noise.white(self.residual))
        rich = np.asarray(left / np.sqrt(np.maximum(1.0 - np.sum(space**2, axis=0), 0.05)))
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
        single = not self.session.rest and n <= ONE_BY_ONE
        return list(np.array_split(np.arange(n), n if single else min(BLOCKS, n // 3)))

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
                    if np.linalg.norm(outside(base, row)) > VISIBLE * np.linalg.norm(row):
                        found.append(SlowEffect(i, j, row[None]))
        return found

    @property
    def slow_limits(self) -> SlowLimits:
        # a temperature coefficient that is not quite constant leaves a little that looks like a walk
        return SlowLimits(forgiven=0.05 if self.session.rest else 0.0)

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
        memory, variance = memories[0], self.noise.std**2
        share = memory.upper if memory.share > 0 else 0.0
        level: Innovating
        if self.session.rest:
            size, length = np.array([share * float(variance.mean())]), np.array([memory.length])
            level = LevelNoise.of(variance, in_intervals(self.session.t_s), size, length)
        else:
            level = DirectedNoise.of(variance, self.session.direction, self.session.t_s, np.array([share]))
        return replace(self.noise, level=level)

    def fit(self, members: Sequence[Member], noise: MagnitudeNoise) -> JointFit:
        found = joint_fit(self.model, self.seen, self.free, self.candidates, members, noise, noise.freedom)
        if not members:
            return replace(found, residual=self.residual)
        base = noise.white(self.base)
        tables = dict(found.parameters)
        for member in members:
            candidate = self.candidates[member.candidate]
            whole = next(v for v in candidate.variants if v.whole and v.shape == self.variant(member).shape)
            others = [noise.white(self.variant(m).columns) for m in members if m != member]
            columns = outside(span(np.concatenate([base, *others])), noise.white(whole.columns))
            tables[candidate.id] = _least(tables[candidate.id], candidate, columns, noise.freedom)
        return replace(found, parameters=tables)

    def locate(self, judged: Judged, signal: Array, space: Array, p: float, share: float) -> tuple[Location, ...]:
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
        if not self.session.rest or not diagnosis.claims:
            return diagnosis
        words = (
            "in one attitude only what acts along gravity shows: the parameters are its smallest explanation, and what "
            "acts across gravity, or whether an offset or a scale factor changes, is not told"
        )
        remainder = replace(diagnosis.remainder, hints=(words, *diagnosis.remainder.hints))
        return replace(diagnosis, remainder=remainder)

    def told_of_noise(self) -> dict[str, Any]:
        return {
            "model": "of the magnitude, per reading",
            "reference": self.session.found,
            "sigma_g": [float(np.sqrt(np.mean(self.noise.std**2)))],
            "degrees_of_freedom": self.noise.freedom,
        }


def _visible(
    seen: Magnitudes, model: ForwardModel, candidates: list[Candidate], blind: list[Blind]
) -> tuple[list[Candidate], list[Blind]]:
    """Candidates by what they do to the magnitude; those that only turn the reading become blind."""
    projected = _projected(seen, model, candidates)
    kept = {c.id for c in projected}
    turns = "it only turns the reading, and a magnitude does not show that"
    return projected, [*blind, *(Blind(c.effect, turns) for c in candidates if c.effect and c.id not in kept)]


def _projected(seen: Magnitudes, model: ForwardModel, candidates: Sequence[Candidate]) -> list[Candidate]:
    aligned = seen.aligned(model)
    found = []
    for candidate in candidates:
        variants: list[Variant] = []
        for variant in candidate.variants:
            columns = seen.project(aligned, variant.columns)
            if np.any(columns != 0):
                variants.append(replace(variant, columns=columns))
        if variants:
            found.append(replace(candidate, variants=tuple(variants)))
    return found


def _least(
    table: dict[str, FittedParameter], candidate: Candidate, columns: Array, freedom: float
) -> dict[str, FittedParameter]:
    """The fitted parameters with what the magnitude does not show left at zero, columns (k, N) whitened.

    The part that is not seen (all across gravity in one attitude, the antisymmetric part of a matrix) is arbitrary; a
    parameter that is seen is known whatever else is not.
    """
    from scipy.stats import t as student

    amplitudes = candidate.amplitudes
    assert candidate.effect is not None
    gates = {p.name: p.gate for p in candidate.effect.parameters}
    values, vectors = np.linalg.eigh(columns @ columns.T)
    good = values > VISIBLE**2 * values[-1]
    if good.all() and all((table[name].low, table[name].high) != gates[name] for name in amplitudes):
        return table
    seen = vectors[:, good]
    size = seen @ (seen.T @ np.array([table[name].value for name in amplitudes]))
    std = np.sqrt(np.sum(seen**2 / values[good], axis=1))
    half = float(student.ppf(0.975, freedom)) * std
    return {
        **table,
        **{
            name: FittedParameter(
                float(size[k]), float(std[k]), float(size[k] - half[k]), float(size[k] + half[k]), table[name].unit
            )
            for k, name in enumerate(amplitudes)
        },
    }


def _short_enough(candidates: Sequence[Candidate], length_s: float) -> list[Candidate]:
    """Without warm-ups that take longer than half of a rest: such a one is a drift with a slight bend, and bends like
    whatever else went up meanwhile."""
    found = []
    for candidate in candidates:
        variants = tuple(v for v in candidate.variants if candidate.id != "warmup" or v.shape["tau"] < length_s / 2)
        if variants:
            found.append(replace(candidate, variants=variants))
    return found


def _beyond_linear(candidates: list[Candidate], base: Array) -> list[Candidate]:
    """The curvature with temperature by what it adds to the coefficient alone.

    Counted from a temperature far away, a square is almost a straight line, and would be named in its place.
    """
    linear = [v.columns[:, 0] for c in candidates if c.id == "temperature_bias" for v in c.variants if v.whole]
    if not linear:
        return candidates
    space = span(np.concatenate([base[:, 0], *linear]))
    return [
        replace(c, variants=tuple(replace(v, columns=outside(space, v.columns)) for v in c.variants))
        if c.id == "temperature_bias_curvature"
        else c
        for c in candidates
    ]


def _alike(one: Array, other: Array) -> bool:
    return bool(abs(one @ other) > ALIKE * np.linalg.norm(one) * np.linalg.norm(other))


def _bases(session: MagnitudeSession, n: int) -> list[Basis]:
    """Covariates of still readings: the direction of the load, temperature, time."""
    x, y, z = session.direction
    inc_deg = np.degrees(np.arccos(np.clip(z, -1, 1)))
    found: list[Basis] = []

    def add(covariate: str, along: Array, functions: Sequence[Array]) -> None:
        found.append(Basis(covariate, np.asarray(along), np.stack(functions)))

    if not session.rest:
        square = [x * x - y * y, 2 * z * z - x * x - y * y, x * y, x * z, y * z]
        add("gravity_direction", inc_deg, square)
        add("gravity_direction (third order)", inc_deg, [x**3, y**3, z**3, x * y * z])
        if n >= 40:
            add("gravity_direction (fourth order)", inc_deg, [x**4, y**4, z**4, x * x * y * y, x * x * z * z])
    if np.ptp(session.temp_c) > 0.5:
        q = (session.temp_c - session.temp_c.mean()) / session.temp_c.std()
        add("temp_c", session.temp_c, [q, q**2, q**3])
        if not session.rest:
            add("temp_c x gravity_direction", session.temp_c, [q * x, q * y, q * z])
    if np.ptp(session.vibration_rms_g) > 0:
        add("vibration_rms_g", session.vibration_rms_g, [session.vibration_rms_g, session.vibration_rms_g**2])
    u = (session.t_s - session.t_s[0]) / max(float(np.ptp(session.t_s)), 1e-9)
    add("t_s", session.t_s, [np.cos(np.pi * k * u) for k in range(1, 4 if n < 40 else 7)])
    return found
