"""Errors against the rotor angle without an outside reference: the recording's own gyros and accelerometers predict.

A case that stands, or moves slowly, holds a rotor that turns a package of accelerometers and gyros. Three attitudes of
the package can be separated, each as inclination I and toolface T:

    felt        what the accelerometers say
    predicted   the slow attitude of the case carried through the rotation by the gyros (a filter with no memory of the
                angle: whatever repeats with it is no part of the case)
    decoded     what the encoder says: T = T of the case + rotor angle t, I = I of the case

and with them three errors, each a curve over t:

    sensor   felt - predicted       errors of the accelerometers; the case may move
    rotor    predicted - decoded    encoder and axis (wobble); the case must not move with the rotor
    decoded  felt - decoded         both: the error of the attitude decoded with this encoder; needs no gyros

The recording is taken in pieces of a few turns. In each, gravity is carried into the frame of the piece's start by the
gyros; there it is slow (a cubic in time: drift of the gyros, the Earth's turn, the case) but for what repeats with the
angle, and both are fitted together.

What no such recording can show, and what is said in the remarks:

- constants of I and T: they look like another attitude of the case, and are set to zero;
- for `sensor` and `rotor` the first harmonic, as far as gyros err across the axis: a bias b there moves the predicted
  vertical on a circle of b / rate, a misalignment e of the gyros against the accelerometers on one of e. Their standard
  deviations are added to that of the first harmonic. In `decoded` the two cancel;
- a motion of the case at the rotor's own rate: it is taken for an error.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import TURN, wrap_signed
from highside.attitude.block import attitude_block
from highside.attitude.quaternion import direction_cosines, from_rotation_vector, multiply, normalised
from highside.errors import Refused
from highside.rotation.bases import fourier_rows
from highside.rotation.curve import CurveMethod, ErrorCurve
from highside.rotation.fit import FitOptions, fit
from highside.rotation.samples import Samples

PIECE_TURNS = 8.0
LEAST_TURNS = 3.0
ORDER = 13
"""harmonics fitted beside the slow motion: one more than the largest order of a curve, because gravity turns too"""
LEAST_SIN_INCLINATION = 0.05
LEAST_ROWS_A_TURN = 40
LARGEST_STEP = 5.0
"""times between rows, in units of the usual one, beyond which a piece ends"""


class ErrorPart(StrEnum):
    """Which error; see the module."""

    SENSOR = "sensor"
    ROTOR = "rotor"
    DECODED = "decoded"


@dataclass(frozen=True, slots=True)
class GyroDoubt:
    """What is not known of the gyros across the axis, one standard deviation each."""

    bias_radps: float = math.radians(10.0 / 3600.0)
    misalignment_rad: float = math.radians(1.0 / 60.0)


@dataclass(frozen=True, slots=True)
class SelfErrors:
    """Rows (N,) in which both are known: rotor angle, errors of inclination and toolface, all rad; means over rows."""

    part: ErrorPart
    theta_rad: Array
    inclination_rad: Array
    toolface_rad: Array
    mean_inclination_rad: float
    rate_radps: float
    """typical size of the rotor's rate"""
    turns: float

    def circle_rad(self, doubt: GyroDoubt) -> float:
        """Radius of the circle on which the gyros' errors may move the predicted vertical, one standard deviation."""
        if self.part is ErrorPart.DECODED:
            return 0.0
        return math.hypot(doubt.bias_radps / self.rate_radps, doubt.misalignment_rad)

    def curves(self, doubt: GyroDoubt | None = None) -> dict[str, ErrorCurve]:
        """`inclination` and `toolface` by `auto`, in arcminutes, with their held-out errors and limits."""
        circle = self.circle_rad(doubt or GyroDoubt())
        # a vertical that is off by a circle of radius c moves I by c and T by c / sin I
        arcmin = 10800.0 / math.pi
        levers = {"inclination": arcmin, "toolface": arcmin / math.sin(self.mean_inclination_rad)}
        errors = {"inclination": self.inclination_rad, "toolface": self.toolface_rad}
        return {name: self._curve(arcmin * error, circle * levers[name]) for name, error in errors.items()}

    def _curve(self, error: Array, circle: float) -> ErrorCurve:
        samples = Samples.build(self.theta_rad, error)
        curve = fit(samples, CurveMethod.AUTO, FitOptions())
        return _stated(curve, turn_to_turn(samples, curve), circle)


def self_errors(
    t_s: Array, accel_g: Array, gyro_radps: Array | None, theta_rad: Array, part: ErrorPart = ErrorPart.DECODED
) -> SelfErrors:
    """The errors of `part` from rows in time order: `accel_g`, `gyro_radps` (3, N), the others (N,), all finite.

    Raises Refused without gyros where they are needed, with fewer than three turns, with fewer than forty rows a turn,
    or near vertical, where there is no toolface.
    """
    if gyro_radps is None and part is not ErrorPart.DECODED:
        raise Refused(
            f"the part '{part.value}' needs gyros; without them only '{ErrorPart.DECODED.value}' can be separated"
        )
    theta = np.unwrap(theta_rad)
    done = [
        _piece(t_s[p], accel_g[:, p], None if gyro_radps is None else gyro_radps[:, p], theta[p], part)
        for p in _pieces(t_s, theta)
    ]
    rows = np.concatenate([angle for angle, *_ in done])
    d_inc, d_tf, inc = (np.concatenate([piece[k] for piece in done]) for k in (1, 2, 3))
    moved = np.abs(np.diff(theta))
    # the last digits of the constants, which nobody can know
    return SelfErrors(
        part,
        rows,
        d_inc - d_inc.mean(),
        d_tf - d_tf.mean(),
        float(inc.mean()),
        float(moved.sum() / (t_s[-1] - t_s[0])),
        float(moved.sum() / TURN),
    )


def _pieces(t_s: Array, theta: Array) -> list[slice]:
    """Pieces of about `PIECE_TURNS` turns; they end where rows are missing."""
    steps = np.diff(t_s)
    usual = float(np.median(steps)) if steps.size else 0.0
    ends = [0, *(np.flatnonzero(steps > LARGEST_STEP * usual) + 1).tolist(), t_s.size]
    out: list[slice] = []
    turns = rows = 0.0
    for low, high in itertools.pairwise(ends):
        travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(theta[low:high])))]) / TURN
        if travel[-1] < LEAST_TURNS:
            continue
        count = max(1, int(travel[-1] // PIECE_TURNS))
        cuts = np.searchsorted(travel, np.linspace(0.0, travel[-1], count + 1))
        cuts[-1] = high - low
        out += [slice(low + int(a), low + int(b)) for a, b in itertools.pairwise(cuts)]
        turns, rows = turns + float(travel[-1]), rows + (high - low)
    if not out:
        raise Refused(
            f"no {LEAST_TURNS:g} turns in one go: nothing repeats by which an error could be distinguished from motion"
        )
    if rows / turns < LEAST_ROWS_A_TURN:
        raise Refused(f"{rows / turns:.0f} rows a turn; {LEAST_ROWS_A_TURN} are needed: record faster or turn slower")
    return out


def _piece(
    t_s: Array, accel: Array, gyro: Array | None, theta: Array, part: ErrorPart
) -> tuple[Array, Array, Array, Array]:
    """(theta, error of I, error of T, I of the case) of one piece."""
    felt_inc, felt_tf = attitude_block(np.ascontiguousarray(accel))
    felt_tf = np.unwrap(felt_tf)
    if np.median(np.sin(felt_inc)) < LEAST_SIN_INCLINATION:
        raise Refused("within three degrees of vertical there is no toolface to tell errors of")
    slow, repeating = _slow_columns(t_s, theta), fourier_rows(theta, ORDER)[1:]
    case_inc = _slow_part(felt_inc, slow, repeating)
    case_tf = _slow_part(felt_tf - theta, slow, repeating)
    if part is ErrorPart.DECODED:
        return theta, felt_inc - case_inc, felt_tf - theta - case_tf, case_inc
    assert gyro is not None
    to_start = direction_cosines(_turned(t_s, gyro))
    carried = np.einsum("ijn,in->jn", to_start, accel)
    vertical = np.stack([_slow_part(one, slow, repeating) for one in carried])
    inc, tf = attitude_block(np.ascontiguousarray(np.einsum("ijn,jn->in", to_start, vertical)))
    if part is ErrorPart.SENSOR:
        return theta, felt_inc - inc, np.asarray(wrap_signed(felt_tf - tf)), inc
    tf = np.unwrap(tf) - theta
    return theta, inc - _slow_part(inc, slow, repeating), tf - _slow_part(tf, slow, repeating), inc


def _slow_columns(t_s: Array, theta: Array) -> Array:
    """(5, N): a cubic in time, and the angle itself (the scale error of a gyro along the axis)."""
    x = 2.0 * (t_s - t_s[0]) / (t_s[-1] - t_s[0]) - 1.0
    y = theta - theta.mean()
    return np.stack([np.ones_like(x), x, x * x, x**3, y / np.abs(y).max()])


def _slow_part(values: Array, slow: Array, repeating: Array) -> Array:
    """What of `values` (N,) is slow, when what repeats with the angle is fitted beside it."""
    # at a constant rate the angle is the time once more: the smallest solution
    solution = np.linalg.lstsq(np.vstack([slow, repeating]).T, values, rcond=1e-10)[0]
    return np.asarray(solution[: len(slow)] @ slow)


def _turned(t_s: Array, gyro: Array) -> Array:
    """Attitudes (4, N) against that of the first row, by the mean rate between rows."""
    q = np.empty((4, t_s.size))
    q[:, 0] = 1.0, 0.0, 0.0, 0.0
    q[:, 1:] = from_rotation_vector(0.5 * (gyro[:, 1:] + gyro[:, :-1]) * np.diff(t_s))
    # all products from the first on, in log2 N rounds
    step = 1
    while step < t_s.size:
        q[:, step:] = multiply(q[:, :-step], q[:, step:])
        step *= 2
    return normalised(q)


def turn_to_turn(samples: Samples, curve: ErrorCurve) -> Array:
    """Standard deviation of each parameter by its scatter over the turns, (P,): noise of gyros is no noise of rows."""
    count = curve.parameters.size
    each = []
    for turn in samples.whole_revolutions:
        rows = samples.revolution == turn
        if np.count_nonzero(rows) > 2 * count:
            columns = fourier_rows(samples.theta_rad[rows], curve.order).T
            each.append(np.linalg.lstsq(columns, samples.error[rows], rcond=None)[0])
    return np.std(each, axis=0, ddof=1) / math.sqrt(len(each)) if len(each) > 2 else np.zeros(count)


def _stated(curve: ErrorCurve, scatter: Array, circle: float) -> ErrorCurve:
    """The curve with its constant set to zero, and the doubt of its harmonics."""
    parameters = curve.parameters.copy()
    parameters[0] = 0.0
    grown = np.maximum(scatter / np.sqrt(np.maximum(np.diag(curve.covariance), 1e-300)), 1.0)
    covariance = curve.covariance * np.outer(grown, grown)
    remarks = [*curve.remarks, "the constant is unobservable without an outside reference: it is zero here"]
    if circle > 0.0:
        if curve.order >= 1:
            covariance[1, 1] += circle**2
            covariance[2, 2] += circle**2
        remarks.append(f"the first harmonic is uncertain by {circle:.2g}': bias and misalignment of the gyros")
    return replace(curve, parameters=parameters, covariance=covariance, remarks=tuple(remarks))
