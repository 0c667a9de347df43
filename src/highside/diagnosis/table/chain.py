"""How a published error table comes about, simulated whole: the bench, the sensor, the correction's own poses on the
same bench, a revolution of readings at each inclination, and the four figures that are reported of it.

A table of means and peak-to-peaks is data *after* a correction. Effects that the correction takes up leave no trace in
it, others come back changed, and chance enters three times: in the readings of the revolution, in those of the
correction's poses, and in where the bench stopped. Mean and peak-to-peak of an angle are no linear functions of an
effect, so they are simulated with the same random draws for every set of parameters: smooth in the parameters, with
exact derivatives, and with the covariance that the draws show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.balance import balance_matrix
from highside.calibration.conventional import position_plan
from highside.diagnosis.table.policy import CHAIN
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.plan import BALANCE_TOOLFACES_DEG
from highside.physics.state import ChainState

Correction = Literal["conventional3", "balance-average", "none"]
CORRECTIONS: tuple[Correction, ...] = get_args(Correction)
CELLS = ("d_inc_mean_deg", "d_inc_pp_deg", "d_tf_mean_deg", "d_tf_pp_deg")


@dataclass(frozen=True, slots=True)
class Procedure:
    """What was done for each row: the correction, stations a revolution (0 and 360 deg both counted), readings each."""

    corrected_by: Correction
    stations: int = CHAIN.stations
    readings: int = CHAIN.readings


@dataclass(frozen=True)
class Sessions:
    """All poses of a table's measurement: R revolutions of S stations, then the poses of the correction."""

    procedure: Procedure
    inc_rad: Array
    """(R,)"""
    state: ChainState
    """R S poses of the revolutions, then the correction's"""

    @classmethod
    def of(cls, inc_rad: Array, procedure: Procedure) -> Sessions:
        """The sessions behind rows at these inclinations (R,)."""
        stations = np.radians(np.linspace(0.0, 360.0, procedure.stations))
        inc, tf = [np.repeat(inc_rad, stations.size)], [np.tile(stations, inc_rad.size)]
        if procedure.corrected_by == "conventional3":
            own_inc, own_tf = position_plan(3)
            inc, tf = [*inc, own_inc], [*tf, own_tf]
        elif procedure.corrected_by == "balance-average":
            four = np.radians(np.array(BALANCE_TOOLFACES_DEG))
            inc, tf = [*inc, np.repeat(inc_rad, 4)], [*tf, np.tile(four, inc_rad.size)]
        state = ChainState.build(np.concatenate(inc), np.concatenate(tf))
        return cls(procedure, inc_rad, state)

    @property
    def turns(self) -> int:
        """Number of poses that belong to revolutions."""
        return self.inc_rad.size * self.procedure.stations

    def corrected(self, readings: Array) -> Array:
        """Means (..., 3, N) of all poses -> corrected gravity (..., 3, R, S) at the stations, from the high side.

        The three components are radial (towards the toolface of the bench), tangential and axial: on a perfect
        instrument sin I, 0 and cos I.
        """
        turns = readings[..., : self.turns].reshape(*readings.shape[:-1], self.inc_rad.size, -1)
        return self.apply(self.matrices(readings), turns)

    def matrices(self, readings: Array) -> Array:
        """The correction (..., R or 1, 3, 3) that the correction's own poses give."""
        own = readings[..., self.turns :]
        if self.procedure.corrected_by == "none":
            return np.broadcast_to(np.eye(3), (*readings.shape[:-2], 1, 3, 3))
        state = self.state
        W = np.asarray(gravity_direction(state.inc_rad[self.turns :], state.tf_rad[self.turns :]), dtype=float)
        if self.procedure.corrected_by == "conventional3":
            return np.asarray(W @ np.linalg.inv(own))[..., None, :, :]
        inclination_stations = [slice(4 * r, 4 * r + 4) for r in range(self.inc_rad.size)]
        return np.stack([balance_matrix(own[..., r], W[:, r]) for r in inclination_stations], axis=-3)

    def apply(self, matrices: Array, turns: Array) -> Array:
        """(..., R or 1, 3, 3) to (..., 3, R, S), and from the tool's axes to those of the bench's toolface."""
        x, y, z = np.moveaxis(matrices @ np.moveaxis(turns, -3, -2), -2, 0)
        tf = self.state.tf_rad[: self.turns].reshape(x.shape[-2:])
        cos, sin = np.cos(tf), np.sin(tf)
        return np.stack([x * cos + y * sin, y * cos - x * sin, z], axis=-3)

    def degenerate(self) -> NDArray[np.bool_]:
        """(R,) rows where the correction has no meaning."""
        if self.procedure.corrected_by != "balance-average":
            return np.zeros(self.inc_rad.size, dtype=bool)
        return np.asarray(np.abs(self.inc_rad - np.pi / 2) < CHAIN.horizontal_rad)


@dataclass(frozen=True)
class Draws:
    """M realisations of chance, as what they add to the corrected gravity (g).

    `readings` (M, 3, R, S, K), single precision: of the K readings for a noise of 1 g, those of the correction's poses
    included; `bench` (M, 3, R, S): of where the bench stopped.
    """

    readings: Array
    bench: Array

    @cached_property
    def of_station(self) -> Array:
        """(M, 3, R, S) mean of a station's readings."""
        return np.asarray(self.readings.mean(axis=-1))


def draw(sessions: Sessions, model: ForwardModel, count: int, seed: int, noise_g: float, *, own: bool = True) -> Draws:
    """Realisations at a model whose random effects move the bench; `noise_g` is the size at which the noise of the
    correction's poses is linearised. Without `own` those poses are taken as they are (see `errors_in_common`)."""
    rng = np.random.default_rng(seed)
    state, procedure = sessions.state, sessions.procedure
    rows, stations = sessions.inc_rad.size, procedure.stations
    clean = np.asarray(model.predict(state), dtype=float)
    tangents = np.asarray(model.pose_sensitivity(state), dtype=float)
    matrices = sessions.matrices(clean)
    start = sessions.corrected(clean)
    moved = np.empty((count, 3, rows, stations))
    noise = np.empty((count, 3, rows, stations, procedure.readings))
    poses = state.n - sessions.turns if own else 0
    for k in range(count):
        stops = model.draw(state, rng).get(Stage.POSE, np.zeros((3, state.n)))
        if not own:
            stops[:, sessions.turns :] = 0.0
        moved[k] = sessions.corrected(clean + np.einsum("ijn,jn->in", tangents, stops)) - start
        by_matrix = np.zeros((3, rows, stations))
        if poses:
            trembling = np.zeros((3, state.n))
            trembling[:, sessions.turns :] = rng.standard_normal((3, poses)) / np.sqrt(procedure.readings)
            by_matrix = (sessions.corrected(clean + noise_g * trembling) - start) / noise_g
        trembling = rng.standard_normal((procedure.readings, 3, rows, stations))
        noise[k] = np.moveaxis(sessions.apply(matrices, trembling), 0, -1) + by_matrix[..., None]
    return Draws(noise.astype(np.float32), moved)


def errors_in_common(sessions: Sessions, model: ForwardModel, noise_g: float) -> Array:
    """What chance did to the few poses of one correction, as columns (9, 3, N) of unit normal amounts.

    All rows share these errors, and peak-to-peaks depend on them too strongly to be averaged over: they are fitted,
    each with its size known beforehand. Empty where each row has a correction of its own.
    """
    if sessions.procedure.corrected_by != "conventional3":
        return np.empty((0, 3, sessions.state.n))
    three = sessions.state.rows(np.arange(sessions.turns, sessions.state.n))
    rng = np.random.default_rng(0)
    nowhere = np.zeros((3, three.n))
    stops = np.stack([model.draw(three, rng).get(Stage.POSE, nowhere).reshape(-1) for _ in range(CHAIN.stops)])
    tangents = np.asarray(model.pose_sensitivity(three), dtype=float)
    turned = np.zeros((3 * three.n, 3 * three.n))
    for k in range(three.n):
        turned[k :: three.n, k :: three.n] = tangents[:, :, k]
    cov = turned @ (stops.T @ stops / len(stops)) @ turned.T
    cov += noise_g**2 / sessions.procedure.readings * np.eye(len(cov))
    columns = np.zeros((len(cov), 3, sessions.state.n))
    columns[:, :, sessions.turns :] = np.linalg.cholesky(cov).T.reshape(-1, 3, three.n)
    return columns


@dataclass(frozen=True)
class Linear:
    """Corrected gravity about one set of parameters: `start` (3, R, S) and `columns` (P, 3, R, S) per unit."""

    sessions: Sessions
    start: Array
    columns: Array

    @classmethod
    def about(cls, sessions: Sessions, model: ForwardModel, columns: Array) -> Linear:
        """`columns` (P, 3, N): what one unit of each parameter adds to the readings of all poses at the model."""
        clean = np.asarray(model.predict(sessions.state), dtype=float)
        return cls(sessions, sessions.corrected(clean), through(sessions, clean, columns))

    def field(self, values: Array) -> Array:
        """(3, R, S) corrected gravity for values (P,) of the parameters, counted from `start`."""
        return np.asarray(self.start + np.tensordot(values, self.columns, 1))


def through(sessions: Sessions, clean: Array, columns: Array) -> Array:
    """What columns (P, 3, N) of the readings become after the correction, (P, 3, R, S)."""
    if not len(columns):
        return np.empty((0, 3, sessions.inc_rad.size, sessions.procedure.stations))
    size = np.max(np.abs(columns), axis=(1, 2), keepdims=True)
    step = CHAIN.step / np.where(size > 0, size, 1.0)
    up, down = sessions.corrected(clean + step * columns), sessions.corrected(clean - step * columns)
    return np.asarray((up - down) / (2 * step[..., None]))


@dataclass(frozen=True, slots=True)
class PredictedCells:
    """What a table says of corrected readings: cells (M, R, 4) in deg of each draw, and the derivatives of their mean.

    `slope` (P + 1, R, 4): by the parameters and by the noise (deg a unit).
    """

    cells: Array
    slope: Array


def predict_cells(
    linear: Linear, values: Array, noise_g: float, draws: Draws, *, slopes: bool = True
) -> PredictedCells:
    """Mean and peak-to-peak of I and T over each revolution, in every draw."""
    sessions = linear.sessions
    field = linear.field(values)
    rows, stations, readings = sessions.inc_rad.size, sessions.procedure.stations, sessions.procedure.readings
    count, size = len(draws.bench), stations * readings
    columns = linear.columns
    cells = np.empty((count, rows, 4))
    slope = np.zeros((len(columns) + 1, rows, 4))
    if slopes:
        # a mean is hardly nonlinear: its slope is that of the curve without noise
        means = [np.asarray(_slopes(field[None], which)[0]) for which in (0, 2)]
        flat = np.moveaxis(columns, 2, 0).reshape(rows, len(columns), 3 * stations)
        for which, mean in zip((0, 2), means, strict=True):
            along = np.moveaxis(mean, 1, 0).reshape(rows, -1, 1)
            slope[:-1, :, which] = (flat @ along)[:, :, 0].T * count / stations
    row = np.arange(rows)
    for first in range(0, count, CHAIN.chunk):
        noise = draws.readings[first : first + CHAIN.chunk]
        still = (field + draws.bench[first : first + CHAIN.chunk]).astype(np.float32)
        g = np.asarray(np.float32(noise_g) * noise, dtype=np.float32)
        g += still[..., None]
        g = g.reshape(len(noise), 3, rows, size)
        inc, tf = _angles(g, sessions.inc_rad)
        drawn = np.arange(len(noise))[:, None]
        flat_noise = noise.reshape(len(noise), 3, rows, size)
        for k, (which, angle) in enumerate(((0, inc), (2, tf))):
            top, low = angle.argmax(axis=-1), angle.argmin(axis=-1)
            cells[first : first + CHAIN.chunk, :, which] = angle.mean(axis=-1, dtype=np.float64)
            cells[first : first + CHAIN.chunk, :, which + 1] = angle[drawn, row, top] - angle[drawn, row, low]
            if not slopes:
                continue
            by_station = draws.of_station[first : first + CHAIN.chunk]
            slope[-1, :, which] += np.einsum("irs,mirs->r", means[k].astype(np.float32), by_station) / stations
            for sign, at in ((1.0, top), (-1.0, low)):
                extreme = np.asarray(np.moveaxis(g[drawn, :, row, at], -1, 1), dtype=np.float64)
                weight = _slopes(extreme[..., None], which)[..., 0]  # (m, 3, R)
                shape = columns[:, :, row[None, :], at // readings]  # (P, 3, m, R)
                slope[:-1, :, which + 1] += sign * np.sum(shape * np.moveaxis(weight, 1, 0), axis=(1, 2))
                slope[-1, :, which + 1] += sign * np.sum(
                    np.moveaxis(weight, 1, 2) * flat_noise[drawn, :, row, at], axis=(0, 2)
                )
    return PredictedCells(np.degrees(cells), np.degrees(slope / count))


def _angles(g: NDArray[np.float32], inc_rad: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Errors (m, R, K) of I and T in rad of readings (m, 3, R, K): small, so single precision is enough."""
    cos, sin = (f(inc_rad).astype(np.float32)[:, None] for f in (np.cos, np.sin))
    radial, tangential, axial = g[:, 0], g[:, 1], g[:, 2]
    across = radial * radial
    across += tangential * tangential
    np.sqrt(across, out=across)
    up = across * cos
    up -= axial * sin
    across *= sin
    across += axial * cos
    return _small_angle(up, across), _small_angle(tangential, radial)


def _small_angle(y: NDArray[np.float32], x: NDArray[np.float32]) -> NDArray[np.float32]:
    """The angle of (x, y) in rad; by the series, several times faster, where all are small."""
    if not np.min(x) > 0:
        return np.asarray(np.arctan2(y, x))
    t = y / x
    square = t * t
    if not np.max(square) < CHAIN.series_to**2:
        return np.asarray(np.arctan2(y, x))
    terms = square * np.float32(CHAIN.series[0])
    for term in CHAIN.series[1:]:
        terms += np.float32(term)
        terms *= square
    terms *= t
    terms += t
    return np.asarray(terms)


def _slopes(g: Array, which: int) -> Array:
    """Derivatives (m, 3, R, S) of inclination (`which` 0) or toolface (2) by the components (m, 3, R, S), rad per g."""
    radial, tangential, axial = g[:, 0], g[:, 1], g[:, 2]
    across2 = radial**2 + tangential**2
    if which == 2:
        return np.stack([-tangential / across2, radial / across2, np.zeros_like(axial)], axis=1)
    across, norm2 = np.sqrt(across2), across2 + axial**2
    along = axial / (across * norm2)
    return np.stack([radial * along, tangential * along, -across / norm2], axis=1)
