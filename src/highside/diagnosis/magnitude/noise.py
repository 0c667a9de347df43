"""How large a departure of the magnitude of gravity chance makes, learned without swallowing what is looked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.independent_noise import IndependentNoise
from highside.diagnosis.core.location import Basis
from highside.diagnosis.core.policy import CANDIDATE_SET, FITS, REGRESSION
from highside.diagnosis.core.regression import log10_p, outside, span
from highside.diagnosis.magnitude.policy import MAGNITUDE_NOISE
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.physics.effect import Stage
from highside.special import fdtrc


def rich_columns(base: Array, candidates: Sequence[Candidate], bases: Sequence[Basis]) -> Array:
    """Columns (P, 1, n) of what could be systematic, the likeliest first, as many directions as the session affords."""
    room = int(FITS.rich_share * base.shape[2])
    stages = [Stage.SENSOR, Stage.THERMAL]
    named = sorted(
        (c for c in candidates if c.effect is not None and len([v for v in c.variants if v.whole]) == 1),
        key=lambda c: (stages.index(c.effect.stage) if c.effect and c.effect.stage in stages else 9, len(c.amplitudes)),
    )
    first = [c for c in named if c.effect is not None and c.effect.calibrated]
    parts = [v.columns for c in [*first, *(c for c in named if c not in first)] for v in c.variants if v.whole]
    parts += [basis.functions[:, None] for basis in bases]
    kept = base
    absorbed = span(base[:, 0]).shape[0]
    for part in parts:
        wider = np.concatenate([kept, part])
        rank = span(wider[:, 0], tolerance=MAGNITUDE_NOISE.independent).shape[0]
        if rank <= room:
            kept, absorbed = wider, rank
        if absorbed == room:
            break
    return kept


def plainly_required(rich: Array, base: Array, residual: Array, candidates: Sequence[Candidate]) -> Array:
    """The rich columns and what the readings plainly require beyond them.

    Few readings do not afford a rich model of everything, and what it lacks would pass as scatter and hide itself. An F
    test with the residual of its own fit does not have that flaw.
    """
    space = span(base[:, 0])
    n = residual.size
    required = base
    for _ in range(MAGNITUDE_NOISE.most_required):
        left = outside(space, residual[0])
        total, freedom = float(left @ left), n - space.shape[0]
        best: tuple[float, Array] | None = None
        for candidate in candidates:
            for variant in candidate.variants:
                own = span(
                    outside(space, variant.columns[:, 0] / _size(variant.columns[:, 0])), tolerance=REGRESSION.visible
                )
                k = own.shape[0]
                if not 0 < k <= freedom - MAGNITUDE_NOISE.least_freedom:
                    continue
                gain = float(np.sum((own @ left) ** 2))
                per_noise = gain * (freedom - k) / max(total - gain, 1e-12 * total)
                p = float(log10_p(np.array(per_noise), np.array(k), freedom - k, len(candidate.variants)))
                if best is None or p > best[0]:
                    best = (p, own)
        if best is None or best[0] < -np.log10(CANDIDATE_SET.alarm_rate / len(candidates)):
            break
        required = np.concatenate([required, best[1][:, None]])
        space = span(np.concatenate([space, best[1]]))
    whole = np.concatenate([rich, required])
    # what is required goes before what merely could be there
    return (
        whole
        if n - span(whole[:, 0], tolerance=MAGNITUDE_NOISE.independent).shape[0] >= MAGNITUDE_NOISE.least_freedom
        else required
    )


def _size(columns: Array) -> Array:
    norm = np.linalg.norm(columns, axis=1, keepdims=True)
    return np.where(norm > 0, norm, 1.0)


def scatter(session: MagnitudeSession, residual: Array, rich: Array) -> IndependentNoise:
    """Scatter of the readings beyond the rich columns. Poses of a hand scatter alike whatever their length; blocks of a
    rest by the number of rows they hold.

    Where few readings are left to show it, most of what is sought may hide in it. So where the readings of a hand
    scatter no more than they repeat, by their rows, what both say is taken together.
    """
    relative = np.sqrt(np.median(session.count) / session.count) if session.rest else np.ones(session.n)
    space = span(rich[:, 0] / relative, tolerance=MAGNITUDE_NOISE.independent)
    left = outside(space, residual[0] / relative)
    freedom = session.n - space.shape[0]
    square = float(left @ left) / freedom
    floor = session.floor
    if floor is not None and not session.rest:
        known = float(np.mean(floor.sigma**2))
        if fdtrc(freedom, floor.freedom, square / known) > FLOOR.chance:
            square = (freedom * square + floor.freedom * known) / (freedom + floor.freedom)
            freedom += floor.freedom
    return IndependentNoise(max(float(np.sqrt(square)), 1e-9) * relative[None], float(freedom))
