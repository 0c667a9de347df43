"""A rotation that the recording has and the prediction has not: gyros and accelerometers must tell the same one.

Let the tool stand turned by theta from where it is predicted. Gyros show its rate, accelerometers its angle:

    dw = theta' - theta x w,    df = -theta x f

to first order, with w, f the rates and the specific force that are predicted. So the gyros alone say what the
accelerometers must show; here without approximation, from the attitudes that both rates integrate to. Errors of the
gyros and of the accelerometers, whatever their colour, follow one another by chance only: in an octave the correlation
of what the accelerometers depart by and what the gyros say they must is that of values with phases at random (Student's
t; as many as hold the power, by as many fewer as a taper makes neighbours alike). Of a rotation that is there each of
the two is the other and noise, so both slopes of the regression, one on the other, are one at most (Frisch's bounds of
errors in variables).

What an attitude that was another from the beginning and a constant offset of a gyro would do is taken off both. A delay
that follows time turns the tool as well, along its own motion, and shows on the accelerometers more than that: where
it does better the rotation is no finding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.regression import span
from highside.diagnosis.simulation.independence import octaves
from highside.diagnosis.simulation.motion import MissingMotion, sized
from highside.diagnosis.simulation.policy import BAND, MOTION, SIMULATION_COLUMNS
from highside.diagnosis.simulation.session import RATES, SimulationSession
from highside.physics.effect import AXES
from highside.special import stdtr


@dataclass(frozen=True)
class Agreement:
    """In which octave, Hz, two sets of rows follow one another most surely, by which correlation and slope, and the
    chance of it among all octaves."""

    band_hz: tuple[float, float]
    correlation: float
    slope: float
    error: float
    p: float

    @property
    def of_one_thing(self) -> bool:
        """Whether each may be the other and noise."""
        wide = INTERVALS.normal * self.error
        back = self.correlation**2 / self.slope if self.slope > 0.0 else np.inf
        return bool(self.slope <= 1.0 + wide and back <= 1.0 + wide * back / max(self.slope, 1e-300))


def missing_turn(session: SimulationSession, left: Array) -> MissingMotion | None:
    """The rotation that gyros and accelerometers tell alike in what base and claims leave (C, n), if there is one."""
    accelerations = {axis: c for c, (axis, _) in session.as_channels({}).accel_axes().items()}
    if set(accelerations) != set(AXES) or not set(RATES) <= set(session.names):
        return None
    felt, turned = [accelerations[a] for a in AXES], [session.names.index(name) for name in RATES]
    kept = np.ones(session.n, dtype=bool) if session.omitted is None else ~session.omitted
    rate, force = np.radians(session.predicted[turned]), session.predicted[felt]
    more, departs = np.radians(np.where(kept, left[turned], 0.0)), np.where(kept, left[felt], 0.0)
    predicted = attitudes(rate, session.step_s)
    apart = _product(_conjugate(predicted), attitudes(rate + more, session.step_s))
    shown = (_turned(apart, force) - force) * kept
    base = span(np.stack([(row * kept).ravel() for row in _free(predicted, force)]))
    x, y = (_without(base, rows) for rows in (shown, departs))
    found = agreement(x, y, session.step_s)
    if found is None or found.p > BAND.chance or not found.of_one_thing:
        return None
    late = _without(base, _delayed(more, np.radians(session.slope[turned]), session.slope[felt]) * kept)
    if _correlation(late, y) > _correlation(x, y):
        return None
    return _told(session, [*felt, *turned], left, angles(predicted, apart, kept), found)


def agreement(x: Array, y: Array, step_s: float) -> Agreement | None:
    """How rows y (C, n) follow rows x (C, n) in the octave in which they do most surely; None where there are too few
    rows."""
    # rows that end elsewhere than they begin have tails in all octaves, which follow one another
    taper = np.hanning(x.shape[1])
    known = octaves(x * taper)
    if known is None:
        return None
    waves, parts = known
    others = np.fft.rfft(y * taper, axis=1)
    independent = np.mean(taper**2) ** 2 / np.mean(taper**4)
    best: Agreement | None = None
    for part in parts:
        size = np.sqrt(np.mean(np.abs(others[:, part]) ** 2, axis=1, keepdims=True))
        if not np.all(size > 0.0):
            continue
        one, other = waves[:, part] / size, others[:, part] / size
        both, own, of_other = (float(np.vdot(a, b).real) for a, b in ((one, other), (one, one), (other, other)))
        if own <= 0.0:
            continue
        # of phases at random, whatever the sizes are: where few ordinates hold all there is, these few are counted
        alike = float(np.sum(np.abs(one) ** 2 * np.abs(other) ** 2))
        freedom = 2 * own * of_other / alike * independent - 2
        if freedom < 1.0:
            continue
        r = min(both / np.sqrt(own * of_other), 1.0 - BAND.rounding)
        t = r * np.sqrt(freedom / (1.0 - r * r))
        ends = (float(k / (x.shape[1] * step_s)) for k in (part[0], part[-1]))
        p = min(1.0, len(parts) * float(stdtr(freedom, -t)))
        slope = both / own
        now = Agreement((next(ends), next(ends)), float(r), slope, abs(slope / t) if t else np.inf, p)
        best = (
            now if best is None or now.p < best.p or (now.p == best.p and now.correlation > best.correlation) else best
        )
    return best


def attitudes(rate: Array, step_s: float) -> Array:
    """(n, 4) attitudes at each row, quaternions with the scalar last, of rates (3, n) rad/s from no rotation on."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation

    n, finer = rate.shape[1], MOTION.finer
    between = (np.arange((n - 1) * finer) + 0.5) / finer
    rows = np.asarray(CubicSpline(np.arange(n), rate, axis=1)(between))
    found = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], Rotation.from_rotvec(rows.T * step_s / finer).as_quat()])
    reach = 1
    while reach < len(found):
        # each holds the product of the steps of `reach` rows before it
        found[reach:] = _product(found[:-reach], found[reach:])
        reach *= 2
    return np.asarray(found[::finer])


def angles(predicted: Array, apart: Array, kept: NDArray[np.bool_]) -> Array:
    """(3, n) rad about the tool's axes by how much it stands turned (quaternions (n, 4)) beside an attitude that was
    another from the beginning, and beside gyros that drift."""
    from scipy.spatial.transform import Rotation

    resting = Rotation.from_quat(predicted)
    vector = resting.apply(Rotation.from_quat(apart).as_rotvec())
    u = np.linspace(-1.0, 1.0, len(vector))
    drift = np.stack([np.ones_like(u), u], axis=1)
    vector = vector - drift @ np.linalg.lstsq(drift[kept], vector[kept], rcond=None)[0]
    return np.asarray(resting.inv().apply(vector).T * kept)


def _product(a: Array, b: Array) -> Array:
    """(n, 4) of quaternions with the scalar last: first b, then a."""
    x, y, z, w = a.T
    p, q, r, s = b.T
    rows = (
        w * p + x * s + y * r - z * q,
        w * q - x * r + y * s + z * p,
        w * r + x * q - y * p + z * s,
        w * s - x * p - y * q - z * r,
    )
    return np.stack(rows, axis=1)


def _conjugate(a: Array) -> Array:
    return np.asarray(a * np.array([-1.0, -1.0, -1.0, 1.0]))


def _turned(apart: Array, force: Array) -> Array:
    """(3, n) a force (3, n) in the axes of a tool that stands turned."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(apart).inv().apply(force.T).T)


def _free(predicted: Array, force: Array) -> list[Array]:
    """(3, n) each: what an attitude that was another from the beginning, or that drifts, and an offset of a gyro show
    on accelerometers."""
    from scipy.spatial.transform import Rotation

    resting, n = Rotation.from_quat(predicted), len(predicted)
    u = np.linspace(-1.0, 1.0, n)
    rows = []
    for axis in np.eye(3):
        still = resting.inv().apply(axis)
        drifting = resting.inv().apply(np.cumsum(resting.apply(axis), axis=0) / n)
        rows += [np.cross(force.T, turned).T for turned in (still, u[:, None] * still, drifting)]
    return rows


def _without(base: Array, rows: Array) -> Array:
    flat = rows.ravel()
    return np.asarray((flat - (flat @ base.T) @ base).reshape(rows.shape))


def _delayed(more: Array, turning: Array, changing: Array) -> Array:
    """(3, n) what accelerometers that change by so much a second show of the delay, a curve of time, by which gyros
    that change by `turning` explain most of what they show more."""
    u = np.linspace(0.0, 1.0, more.shape[1])
    waves = np.stack([np.cos(np.pi * k * u) for k in range(SIMULATION_COLUMNS.time_waves + 1)])
    columns = np.stack([(turning * wave).ravel() for wave in waves], axis=1)
    return np.asarray(changing * (np.linalg.lstsq(columns, more.ravel(), rcond=None)[0] @ waves))


def _correlation(x: Array, y: Array) -> float:
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    return float(np.sum(x * y)) / size if size > 0.0 else 0.0


def _told(session: SimulationSession, own: Sequence[int], left: Array, angle: Array, found: Agreement) -> MissingMotion:
    """When, by how much and about which axis; it shows on the channels `own`."""
    low, high = found.band_hz
    motion = sized(session, left, own, found.p, ())
    start, stop = motion.stretch_s or motion.session_s
    within = (session.state.t_s >= start) & (session.state.t_s <= stop)
    most = angle[:, within][:, int(np.argmax(np.linalg.norm(angle[:, within], axis=0)))]
    axis = AXES[int(np.argmax(np.abs(most)))]
    words = (
        f"the tool turns by up to {np.degrees(np.linalg.norm(most)):.2g} deg, most of it about {axis}, and the "
        f"prediction does not: the accelerometers show {found.slope:.2f} +- {found.error:.2f} of what the gyros say of "
        f"it, from {low:.2g} to {high:.2g} Hz"
    )
    return MissingMotion(motion.session_s, motion.stretch_s, motion.rms, found.p, (words,))
