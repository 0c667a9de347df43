"""How large a departure chance makes, estimated without swallowing the effect that is looked for.

The scatter is taken from a *rich* residual: everything that any candidate or any smooth function of the covariates
could explain is projected off first, and the lost degrees of freedom are counted. Components, pose by pose:

    cov(pose) = diag(s_x^2, s_y^2, s_z^2) + s_I^2 t_I t_I' + s_T^2 t_T t_T' + s_A^2 t_A t_A'

the three sensors' own scatter, and that of the set angles (inclination, toolface, and across the plane of the tilt:
`core.set_angle_errors`), which is common to the channels. The second part is kept only where the likelihood asks.

A bench may be quiet by night and shaken by day: the whole is scaled by a size that changes slowly with time, where it
follows the scatter of the rows within the poses, or else where the mean squares of stretches of the session differ by
more than chance lets them.

Scatter that is correlated from pose to pose is the matter of `memory`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.markov import VectorNoise
from highside.diagnosis.core.memory import Memory, intervals
from highside.diagnosis.core.policy import FITS
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.poses.policy import POSE_NOISE
from highside.special import chdtrc, chdtri


@dataclass(frozen=True)
class PoseNoise:
    """`sigma` (3,) in g, `bench` (3,) in rad, and `whitening` (3, 3, n): W_i with W_i cov_i W_i' = 1.

    The components are means over the session; `size` (n,) is what they are multiplied by at each pose.
    """

    sigma: Array
    bench: Array
    """scatter of the set angles: inclination, toolface, and across the plane of the tilt"""
    whitening: Array
    freedom: float
    """residual degrees of freedom that one component was estimated with"""
    size: Array
    full: VectorNoise | None = None
    """whitening in time order, where the scatter has a memory"""

    def white(self, columns: Array) -> Array:
        """(..., 3, n) in g -> (..., 3 n) in units of the noise."""
        if self.full is not None:
            return self.full.white(columns)
        turned = np.zeros(np.broadcast_shapes(columns.shape, self.whitening.shape[1:]))
        for i, j in np.argwhere(self.whitening.any(axis=2)):
            turned[..., i, :] += self.whitening[i, j] * columns[..., j, :]
        return np.asarray(turned.reshape(*columns.shape[:-2], columns.shape[-2] * columns.shape[-1]))


def estimate(
    residual: Array,
    rich: Array,
    tangents: Array,
    *,
    scatter: Array | None = None,
    floor: Array | None = None,
    uneven: bool = True,
) -> PoseNoise:
    """Noise of a residual (3, n) after the rich columns (P, 3, n); `tangents` (3, 3, n), `turned_by_set_angles`, g/rad.

    With `uneven` its size may change with time; `scatter` (3, n) is that of the rows within each pose, and `floor`
    (3, n) that by which these let a pose's mean repeat, if known.
    """
    n = residual.shape[1]
    sigma, bench = np.full(3, max(float(residual.std()), 1e-12)), np.zeros(len(tangents))
    size = np.ones(n)
    repeats = np.zeros(3) if floor is None else np.sqrt(np.mean(floor**2, axis=1))
    for _ in range(2):
        draft = _draft(sigma, bench, tangents, size)
        left, share = _left(draft, residual, rich)
        # back to g, scaled up for what the projection took
        swollen = (left / np.sqrt(np.maximum(share, FITS.rich_left))).reshape(3, n)
        back = np.einsum("ijn,jn->in", np.linalg.inv(draft.whitening.transpose(2, 0, 1)).transpose(1, 2, 0), swollen)
        sigma, bench = _components(back / size, tangents, repeats)
        if uneven:
            even = _draft(sigma, bench, tangents, np.ones(n)).whitening
            size = _size(np.einsum("ijn,jn->in", even, back), share.reshape(3, n), scatter)
    draft = _draft(sigma, bench, tangents, size)
    left, share = _left(draft, residual, rich)
    freedom = float(share.sum())
    # the level to which F tests refer: mean square of the rich residual with its own degrees of freedom
    level = max(float(np.sqrt(np.sum(left**2) / freedom)), 1e-9)
    # a test leans on the one component that its effect runs along, which is known to a share of this only
    components = 3 + np.count_nonzero(bench)
    return PoseNoise(sigma * level, bench * level, draft.whitening / level, freedom / components, size)


def _draft(sigma: Array, bench: Array, tangents: Array, size: Array) -> PoseNoise:
    return PoseNoise(sigma, bench, _whitening(sigma, bench, tangents) / size, 1.0, size)


def _left(noise: PoseNoise, residual: Array, rich: Array) -> tuple[Array, Array]:
    """Whitened residual (3 n,) outside of the rich columns, and the share of each reading that these leave."""
    space = span(noise.white(rich))
    return outside(space, noise.white(residual)), np.asarray(1.0 - np.sum(space**2, axis=0))


def _size(unit: Array, share: Array, scatter: Array | None) -> Array:
    """(n,) size of the noise at each pose, mean square 1, from readings (3, n) that have variance 1 if it is even.

    `share` (3, n) of each was left by the rich columns.
    """
    n = unit.shape[1]
    if n < POSE_NOISE.stretches * POSE_NOISE.stretch:
        return np.ones(n)
    energy, known = np.sum(share * unit**2, axis=0), share.sum(axis=0)
    at = np.arange(n)
    near = np.exp(-0.5 * ((at[:, None] - at) / (POSE_NOISE.stretch / 2)) ** 2)
    logs = _by_scatter(energy, known, near, scatter)
    if logs is None:
        logs = _by_stretches(energy, known, near)
    size = np.exp(0.5 * logs)
    return np.asarray(size / np.sqrt(np.mean(size**2)))


def _by_scatter(energy: Array, known: Array, near: Array, scatter: Array | None) -> Array | None:
    """Logarithms (n,) of the variance as a power of the mean square within poses; None if it does not follow that."""
    if scatter is None or not np.all(np.mean(scatter**2, axis=1) > 0):
        return None
    squares = np.mean(scatter**2 / np.mean(scatter**2, axis=1, keepdims=True), axis=0)
    within = np.log(np.maximum(near @ squares / near.sum(axis=1), POSE_NOISE.least_square))
    tried = POSE_NOISE.powers[:, None] * within
    # -2 log likelihood of sums of squares with so many degrees of freedom, their level fitted
    level = np.sum(energy * np.exp(-tried), axis=1) / known.sum()
    minus2l = known.sum() * np.log(level) + tried @ known
    best = int(np.argmin(minus2l))
    return tried[best] if minus2l[0] - minus2l[best] > chdtri(1, POSE_NOISE.uneven) else None


def _by_stretches(energy: Array, known: Array, near: Array) -> Array:
    """Logarithms (n,) of the variance, smoothed; 0 where Bartlett's test finds stretches alike.

    What scatter of the averages chance explains is taken off their differences.
    """
    n = energy.size
    stretches = np.array_split(np.arange(n), n // POSE_NOISE.stretch)
    squares = np.array([energy[part].sum() for part in stretches])
    dof = np.array([known[part].sum() for part in stretches])
    differ = dof.sum() * np.log(squares.sum() / dof.sum()) - np.sum(dof * np.log(squares / dof))
    differ /= 1 + (np.sum(1 / dof) - 1 / dof.sum()) / (3 * (len(dof) - 1))
    if chdtrc(len(dof) - 1, differ) > POSE_NOISE.uneven:
        return np.zeros(n)
    logs = np.log((near @ energy) / (near @ known))
    chance = float(np.mean(2 * (near**2 @ known) / (near @ known) ** 2))
    return np.asarray(max(0.0, 1.0 - chance / float(np.var(logs))) * (logs - logs.mean()))


def _whitening(sigma: Array, bench: Array, tangents: Array) -> Array:
    cov = _covariance(sigma, bench, tangents)
    lower = np.linalg.cholesky(cov)
    return np.asarray(np.linalg.inv(lower).transpose(1, 2, 0))


def _covariance(sigma: Array, bench: Array, tangents: Array) -> Array:
    """(n, 3, 3)."""
    cov = np.zeros((tangents.shape[2], 3, 3)) + np.diag(sigma**2)
    for size, way in zip(bench, tangents.transpose(0, 2, 1), strict=True):
        cov += size**2 * way[:, :, None] * way[:, None, :]
    return cov


def _components(residual: Array, tangents: Array, repeats: Array) -> tuple[Array, Array]:
    """Scatter of the sensors (3,) and of the set angles (3,) by maximum likelihood, from (3, n).

    What is all of the bench leaves a sensor no less than its means repeat by, (3,): in few poses the likelihood would
    give a channel next to none, and what chance makes of that channel would be beyond chance.
    """
    plain = residual.std(axis=1)
    # a channel of which the rich model has left nothing is not without noise
    plain = np.maximum(plain, max(POSE_NOISE.quietest * float(plain.max()), 1e-12))
    rows = residual.T
    angle = float(plain.mean())

    def deviance(logs: Array) -> tuple[float, Array, Array]:
        """-2 log likelihood, its gradient by the logarithms of the sizes, and its expected second derivatives."""
        scale = np.exp(logs)
        sigma, bench = plain * scale[:3], angle * scale[3:]
        cov = _covariance(sigma, bench, tangents)
        inverse = np.linalg.inv(cov)
        left = np.einsum("nij,nj->ni", inverse, rows)
        by_cov = inverse - left[:, :, None] * left[:, None, :]
        # the covariance moves with each logarithm by 2 v v': of a channel its own axis, of an angle its tangent
        axes = np.broadcast_to(np.diag(sigma)[:, None], (3, *rows.shape))
        along = np.concatenate([axes, bench[:, None, None] * tangents.transpose(0, 2, 1)])
        gradient = 2 * np.einsum("ani,nij,anj->a", along, by_cov, along)
        expected = 4 * np.einsum("ani,nij,bnj->abn", along, inverse, along) ** 2
        value = float(np.sum(np.linalg.slogdet(cov)[1]) + np.sum(left * rows))
        return value, gradient, np.asarray(expected.sum(axis=2))

    without = float(2 * residual.shape[1] * np.log(plain).sum() + residual.size)
    bounds = np.array([POSE_NOISE.sensor_bounds] * 3 + [POSE_NOISE.angle_bounds] * len(tangents))
    bounds[:3, 0] = np.clip(np.log(np.maximum(repeats, 1e-300) / plain), bounds[:3, 0], 0.0)
    start = np.array([POSE_NOISE.sensor_start] * 3 + [POSE_NOISE.angle_start] * len(tangents))
    logs, least = _scored(deviance, start, bounds)
    if without - least < POSE_NOISE.table_gain:
        return plain, np.zeros(len(tangents))
    scale = np.exp(logs)
    return plain * scale[:3], np.where(logs[3:] > bounds[3:, 0], angle * scale[3:], 0.0)


def _scored(
    deviance: Callable[[Array], tuple[float, Array, Array]], start: Array, bounds: Array
) -> tuple[Array, float]:
    """Where a -2 log likelihood of (p,) is least within `bounds` (p, 2), and what it is there: Fisher scoring.

    Harville, J. Amer. Statist. Assoc. 72, 1977: the expected second derivatives in the place of the observed ones make
    each step one uphill in likelihood. What would leave its bounds stays there. A step that gains nothing is halved.
    """
    logs = np.clip(start, *bounds.T)
    value, gradient, expected = deviance(logs)
    for _ in range(POSE_NOISE.turns):
        free = ~((logs <= bounds[:, 0]) & (gradient > 0) | (logs >= bounds[:, 1]) & (gradient < 0))
        if not free.any():
            break
        inner = expected[np.ix_(free, free)]
        step = np.zeros_like(logs)
        step[free] = -np.linalg.solve(inner + POSE_NOISE.ridge * np.trace(inner) * np.eye(len(inner)), gradient[free])
        length = min(1.0, POSE_NOISE.stride / max(float(np.abs(step).max()), 1e-300))
        for _ in range(POSE_NOISE.halvings):
            tried = np.clip(logs + length * step, *bounds.T)
            found = deviance(tried)
            if found[0] < value:
                break
            length /= 2
        else:
            break
        gain, logs = value - found[0], tried
        value, gradient, expected = found
        if gain < POSE_NOISE.settled * max(abs(value), 1.0):
            break
    return logs, value


def with_memory(noise: PoseNoise, memories: Sequence[Memory], tangents: Array, t_s: Array) -> PoseNoise:
    """The same noise with the memory of each channel added, as large as the data allow."""
    cov = _covariance(noise.sigma, noise.bench, tangents) * noise.size[:, None, None] ** 2
    level = np.diagonal(cov, axis1=1, axis2=2).mean(axis=0)
    shares = level * [m.variance_share for m in memories]
    lengths = np.array([m.length for m in memories])
    return replace(noise, full=VectorNoise.of(cov, intervals(t_s), shares, lengths))


def white_variance(noise: PoseNoise, tangents: Array) -> Array:
    """(3, n) variance of each reading, memory left aside."""
    cov = _covariance(noise.sigma, noise.bench, tangents) * noise.size[:, None, None] ** 2
    return np.asarray(np.diagonal(cov, axis1=1, axis2=2).T)
