"""How little the azimuth can drift: the least that the readings allow, found twice, and our filter beside it.

    python -m studies.drift_limit [--seeds 60] [--only NAME ...]

Three figures in deg/h for each case (error at the end by the hours passed):

    recursion   `papers.drift_bound`: the covariance carried along the true motion, from formulas
    batch       the information of the whole recording at once: attitude and gyro bias at the end of every second,
                axial scale error and accelerometer biases, their priors and all readings in one sparse least-squares
                problem whose Jacobians are differences of the nonlinear motion, sample by sample; no recursion, none
                of the formulas of `drift_bound`
    optimum     that problem solved for simulated readings, linearised at the *truth*: an estimator with foreknowledge
                that nobody can have, and on normal noise none is better. rms over seeds

All of them, as the filter, use the direction of a reading. "Length" is the batch bound if its length counted as well,
which is exactly 1 g here and nowhere else.

and `error_state_filter` on the same readings. What the optimum leaves no filter can correct. "walk" is what the angle
random walk alone turns the azimuth by if all biases were known: no reading of gravity takes it back. Where a straight
hole is asserted the readings do not bound anything: the assertion gives the azimuth.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.stats import chi2

from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import (
    conjugate,
    direction_cosines,
    from_angles,
    from_rotation_vector,
    multiply,
    to_angles,
    to_rotation_vector,
)
from highside.gyro.frames import to_body
from highside.gyro.recording_filter import error_state_filter
from highside.papers.drift_bound import azimuth_bound
from highside.papers.drift_scenarios import (
    DEG_PER_HOUR,
    DriftExperiment,
    Triad,
    record,
    rotating_rod,
    rotating_table,
    true_rates,
)
from highside.physics.gravity import EARTH_RATE_RADPS

from .drift_scenarios import SETTINGS

Array = NDArray[np.float64]

AZIMUTH_STD_RAD = 1e-6
BIAS_STD = 20.0 * DEG_PER_HOUR
SCALE_STD = 1e-3
TILT_STD_RAD = 0.05
STANDING_RAD = 1e-7
"""by which a standing tool may turn in a second: none"""
STEP = 1e-6
"""of the differences, rad"""
UNITS = np.array([1e-5] * 3 + [DEG_PER_HOUR] * 3)
"""of attitude error and bias in the least-squares problem, so that its matrix is well scaled"""


@dataclass(frozen=True, slots=True)
class Blocks:
    """The samples of an experiment in blocks of a second, body frame; the first row stands alone at time zero."""

    q: Array
    """(4, M + 1) true attitude at the edges"""
    dt: float
    n: int
    still: NDArray[np.bool_]
    walk: Array
    """(M,) rad/sqrt(s)"""
    reading: Array
    """(M,) scatter of a block's mean reading, g"""
    earth: Array


def laid(e: DriftExperiment, rest: Array | None) -> Blocks:
    """The blocks of an experiment; `rest` (K, 2) s."""
    interval = float(np.median(np.diff(e.t_s)))
    n = round(1.0 / interval)
    edges = np.arange(0, e.t_s.size, n)
    begin, end = e.t_s[edges[:-1]], e.t_s[edges[1:]]
    still = np.zeros(begin.size, dtype=bool)
    for first, last in np.zeros((0, 2)) if rest is None else rest:
        still |= (begin >= first - 1e-6) & (end <= last + 1e-6)
    shaken = e.vibrating[edges[:-1] + n // 2]
    t = e.triad
    walk = np.hypot(np.radians(t.arw_deg_sqrt_h) / 60.0, np.radians(t.gyro_vibration_dps) * shaken * interval**0.5)
    reading = np.hypot(t.accel_noise_g, t.vibration_rms_g * shaken) / n**0.5
    earth = EARTH_RATE_RADPS * np.array([0.0, np.cos(e.latitude_rad), np.sin(e.latitude_rad)])
    q = from_angles(e.theta[edges], e.phi[edges], e.psi[edges])
    return Blocks(q, n * interval, n, still, walk, reading, earth)


def _by_block(rows: Array, b: Blocks) -> Array:
    """(3, n, M) samples 1 .. of (3, N)."""
    return rows[:, 1 : 1 + b.n * b.still.size].reshape(3, b.still.size, b.n).transpose(0, 2, 1)


def turned(rates: Array, b: Blocks, bias: Array, scale: float) -> tuple[Array, Array]:
    """Relative rotation (4, M) over blocks of rates (3, n, M), and after each sample of them (4, n, M)."""
    w = rates - bias[:, None, None]
    w[1] -= scale * rates[1]
    q = np.zeros((4, rates.shape[2]))
    q[0] = 1.0
    each = np.empty((4, *rates.shape[1:]))
    for i in range(rates.shape[1]):
        q = multiply(q, from_rotation_vector(w[:, i] * (b.dt / b.n)))
        each[:, i] = q
    return q, each


def ends(b: Blocks, rates: Array, bias: Array, scale: float, start: Array | None = None) -> Array:
    """Where blocks that begin at the truth (turned by `start` (3,)) end, as a rotation vector from the truth (3, M)."""
    begin = b.q[:, :-1]
    if start is not None:
        begin = multiply(begin, from_rotation_vector(start)[:, None])
    earth = from_rotation_vector(-b.earth * b.dt)[:, None]
    reached = multiply(multiply(earth, begin), turned(rates, b, bias, scale)[0])
    return np.asarray(to_rotation_vector(multiply(conjugate(b.q[:, 1:]), reached)))


def differences(function: Callable[[Array], Array], steps: Array) -> Array:
    """Jacobian (3, K, M) of a function of (K,) with values (3, M), central."""
    columns = []
    for k, step in enumerate(steps):
        at = np.zeros(steps.size)
        at[k] = step
        columns.append((function(at) - function(-at)) / (2.0 * step))
    return np.stack(columns, axis=1)


class Problem:
    """All that an experiment's readings say about attitude and biases at every second: whitened rows A x = z.

    `length`: that readings at rest are 1 g long is known, too.
    """

    def __init__(self, e: DriftExperiment, rest: Array | None, *, length: bool = False) -> None:
        self.experiment, self.blocks = e, laid(e, rest)
        b, t = self.blocks, e.triad
        rates = _by_block(true_rates(e)[0], b)
        nothing = np.zeros(3)
        by_start = differences(lambda x: ends(b, rates, nothing, 0.0, x), np.full(3, STEP))
        by_bias = differences(lambda x: ends(b, rates, x, 0.0), np.full(3, STEP / b.dt))
        by_scale = differences(lambda x: ends(b, rates, nothing, float(x[0])), np.array([STEP]))
        # the mean of readings turned into the newest frame
        whole, each = turned(rates, b, nothing, 0.0)
        self.into_end = direction_cosines(multiply(conjugate(whole)[:, None], each)).transpose(1, 0, 2, 3)
        by_tilt = differences(
            lambda x: direction_cosines(multiply(b.q[:, 1:], from_rotation_vector(x)[:, None]))[:, 2], np.full(3, STEP)
        )
        by_offset = self.into_end.mean(axis=2)
        if not length:
            up = direction_cosines(b.q[:, 1:])[:, 2]
            by_offset = by_offset - up[:, None] * np.einsum("im,ijm->jm", up, by_offset)[None]
        by_turn = differences(
            lambda x: np.einsum(
                "ijm,j->im", direction_cosines(multiply(b.q[:, 1:], from_rotation_vector(x)[:, None])), b.earth
            ),
            np.full(3, 1e-3),
        )
        m = b.still.size
        shape = (3, 3, m)
        unit = np.broadcast_to(np.eye(3)[:, :, None], shape)
        keeps = np.where(b.still, unit, by_start)
        motion = np.where(b.still, STANDING_RAD, b.walk * b.dt**0.5)
        bias_walk = np.full(m, t.rrw_dph_sqrt_h * DEG_PER_HOUR / 60.0 * b.dt**0.5)
        self.scales = motion, bias_walk, b.reading, b.walk / b.dt**0.5
        moving = ~b.still
        now, then, last = 6 * np.arange(m), 6 * np.arange(1, m + 1), 6 * (m + 1)
        scale_at, offset_at = np.full(m, last), np.full(m, last + 1)
        angle, dph = UNITS[0], UNITS[3]
        parts = [
            # the end less where the start leads to
            _rows(
                [
                    (then, unit * angle),
                    (now, -keeps * angle),
                    (now + 3, -by_bias * moving * dph),
                    (scale_at, -by_scale * moving * 1e-3),
                ],
                motion,
                last + 4,
            ),
            _rows([(then + 3, unit * dph), (now + 3, -unit * dph)], bias_walk, last + 4),
            _rows([(then, by_tilt * angle), (offset_at, by_offset * 1e-3)], b.reading, last + 4),
            _rows([(then, by_turn * angle), (then + 3, unit * dph)], self.scales[3], last + 4, only=b.still),
            self._priors(last),
        ]
        self.A = sparse.vstack(parts).tocsc()
        at = to_angles(b.q[:, -1:])[2]
        row = differences(
            lambda x: np.asarray(
                wrap_signed(to_angles(multiply(b.q[:, -1:], from_rotation_vector(x)[:, None]))[2] - at)
            )[None],
            np.full(3, STEP),
        )[0, :, 0]
        g = np.zeros(self.A.shape[1])
        g[last - 6 : last - 3] = row * angle
        information = splu((self.A.T @ self.A).tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0)
        answer = information.solve(g)
        self.bound_rad = float(np.sqrt(g @ answer))
        self.weights = np.asarray(self.A @ answer)
        """what each whitened residual adds to the azimuth"""

    def _priors(self, last: int) -> sparse.csr_matrix:
        q = self.blocks.q[:, :1]
        at = to_angles(q)

        def angles(x: Array) -> Array:
            found = to_angles(multiply(q, from_rotation_vector(x)[:, None]))
            return np.stack([np.asarray(wrap_signed(a - b)) for a, b in zip(found, at, strict=True)])

        stds = np.array([TILT_STD_RAD, TILT_STD_RAD / np.cos(at[0][0]), AZIMUTH_STD_RAD])
        prior = np.zeros((10, last + 4))
        prior[:3, :3] = differences(angles, np.full(3, STEP))[:, :, 0] * UNITS[0] / stds[:, None]
        prior[3:6, 3:6] = np.eye(3) * UNITS[3] / BIAS_STD
        prior[6, last] = 1e-3 / SCALE_STD
        prior[7:, last + 1 :] = np.eye(3) * 1e-3 / max(self.experiment.triad.accel_bias_g, 1e-9)
        return sparse.csr_matrix(prior)

    def optimum_error_rad(self, rate: Array, accel: Array) -> float:
        """Error of the azimuth at the end, of readings (3, N) in the body frame."""
        b = self.blocks
        rates, readings = _by_block(rate, b), _by_block(accel, b)
        leads = np.where(b.still, 0.0, ends(b, rates, np.zeros(3), 0.0))
        mean = np.einsum("ijnm,jnm->im", self.into_end, readings) / b.n
        C = direction_cosines(b.q[:, 1:])
        shown = rates.mean(axis=1) - np.einsum("ijm,j->im", C, b.earth)
        motion, _, reading, rested = self.scales
        z = np.concatenate(
            [
                (leads / motion).T.ravel(),
                np.zeros(3 * b.still.size),
                ((mean - C[:, 2]) / reading).T.ravel(),
                (shown / rested)[:, b.still].T.ravel(),
                np.zeros(10),
            ]
        )
        return float(self.weights @ z)


def _rows(
    parts: list[tuple[Array, Array]], std: Array, width: int, only: NDArray[np.bool_] | None = None
) -> sparse.csr_matrix:
    """Three rows a block: Jacobians (3, K, M) at columns (M,), by a standard deviation (M,); of some blocks only."""
    m = std.size
    r, c, v = [], [], []
    for column, jacobian in parts:
        k = jacobian.shape[1]
        rows = 3 * np.arange(m)[:, None, None] + np.arange(3)[None, :, None] + np.zeros((1, 1, k), dtype=int)
        columns = column[:, None, None] + np.zeros((1, 3, 1), dtype=int) + np.arange(k)[None, None, :]
        r.append(rows.ravel())
        c.append(columns.ravel())
        v.append((jacobian.transpose(2, 0, 1) / std[:, None, None]).ravel())
    found = sparse.csr_matrix((np.concatenate(v), (np.concatenate(r), np.concatenate(c))), shape=(3 * m, width))
    return found if only is None else found[np.repeat(only, 3)]


@dataclass(frozen=True, slots=True)
class Case:
    experiment: Callable[[], DriftExperiment]
    aim: float
    """deg/h"""
    declared: bool = False
    straight: bool = False


CASES = {
    **{f"table, {theta} deg, 1 h": Case(lambda theta=theta: rotating_table(theta), 0.10) for theta in (0, 15, 30)},
    **{
        f"table, {theta} deg, {hours} h": Case(
            lambda theta=theta, hours=hours: rotating_table(theta, 3600.0 * hours, 20.0), 0.10
        )
        for hours in (2, 3)
        for theta in (0, 15, 30)
    },
    "table, 30 deg, 1 h, 0.07 deg/sqrt(h)": Case(lambda: rotating_table(30.0, triad=Triad(arw_deg_sqrt_h=0.07)), 0.10),
    "rod, 3 h": Case(rotating_rod, 0.20, declared=True),
    "rod, 3 h, straight hole asserted": Case(rotating_rod, 0.20, declared=True, straight=True),
}


def walk_alone(e: DriftExperiment, rest: Array | None) -> float:
    """The recursion with every bias, scale and accelerometer known: only the angle random walk is left, deg/h."""
    known = replace(e, triad=replace(e.triad, rrw_dph_sqrt_h=0.0, accel_bias_g=1e-9, axial_scale_ppm=0.0))
    bound = azimuth_bound(known, azimuth_std_rad=AZIMUTH_STD_RAD, bias_std_dph=1e-6, scale_std=1e-12, rest=rest)
    return float(np.degrees(bound[-1])) / e.hours


def measure(name: str, seeds: int) -> str:
    """One Markdown row."""
    case = CASES[name]
    e = case.experiment()
    rest = e.rest if case.declared else None
    settings = replace(
        SETTINGS,
        detect_stops=False,
        azimuth_std_rad=1e-5,
        straight_hole_std_rad=float(np.radians(0.1)) if case.straight else None,
    )
    recursion = float(np.degrees(azimuth_bound(e, azimuth_std_rad=AZIMUTH_STD_RAD, rest=rest)[-1])) / e.hours
    problem = None if case.straight else Problem(e, rest)
    best, own = [], []
    for seed in range(seeds):
        data = record(e, 2000 + seed)
        if problem is not None:
            best.append(np.degrees(problem.optimum_error_rad(to_body(data.rate), to_body(data.accel))) / e.hours)
        result = error_state_filter(e.t_s, data.rate, data.accel, settings, rest=rest)
        error = np.degrees(wrap_signed(np.asarray(result.azi_rad - e.psi)))
        own.append(error[e.t_s >= e.t_s[-1] - 10.0].mean() / e.hours)
    ours = float(np.sqrt(np.mean(np.square(own))))
    if problem is None:
        return f"| {name} | {case.aim:.2f} | - | - | - | - | - | {ours:.3f} | - | - | - |"
    batch, length = (float(np.degrees(each.bound_rad)) / e.hours for each in (problem, Problem(e, rest, length=True)))
    optimum = float(np.sqrt(np.mean(np.square(best))))
    few = float(chi2.cdf(4 * (case.aim / batch) ** 2, 4))
    return (
        f"| {name} | {case.aim:.2f} | {walk_alone(e, rest):.3f} | {recursion:.3f} | {batch:.3f} | {length:.3f} |"
        f" {optimum:.3f} | {ours:.3f} | {ours / optimum:.2f} | {ours / batch:.2f} | {few:.2f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--only", nargs="*", choices=list(CASES), default=list(CASES))
    arguments = parser.parse_args()
    print(f"Azimuth drift, deg/h, rms of {arguments.seeds} seeds from 2000 on; ratios to the optimum on the same seeds")
    print("and to the batch bound; last: how often the rms of four runs of the optimum reaches the aim.\n")
    print("| case | aim | walk | recursion | batch | length | optimum | kinematic | by optimum | by bound | of four |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name in arguments.only:
        print(measure(name, arguments.seeds), flush=True)


if __name__ == "__main__":
    main()
