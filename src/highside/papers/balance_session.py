"""The balance paper's experiment on an instrument: readings of all poses, the corrections, errors over each revolution.

The published experiment: a triaxial accelerometer on a turntable of 0.018 deg resolution, at eleven inclinations one
revolution each, 73 stations 5 deg apart with four unfiltered readings each (292 a revolution); the readings are
corrected by the three-pose conventional matrix or by a balance matrix of that inclination (three of its four poses, or
the average of the four triples), and the errors of I and T against the bench are given as mean and peak-to-peak over
the revolution. Each pose of a correction is read four times, on the same imperfect bench.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.attitude import attitude_block, wrap_signed
from highside.calibration.balance import TRIPLES, balance_matrix
from highside.calibration.conventional import position_plan
from highside.calibration.poses import PoseSet
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.plan import BALANCE_TOOLFACES_DEG, PUBLISHED_INCLINATIONS_DEG, pose_grid
from highside.physics.state import ChainState

INCLINATIONS_DEG = tuple(sorted(PUBLISHED_INCLINATIONS_DEG, reverse=True))
STATIONS_DEG = tuple(5.0 * k for k in range(73))
READINGS = 4
"""readings at each station of a turn, and averaged for each calibration pose"""
METHODS = ("conventional", *TRIPLES, "average")
COLUMNS = ("d_inc_mean_deg", "d_inc_pp_deg", "d_tf_mean_deg", "d_tf_pp_deg")
_THREE, _BALANCE = 3, 4 * len(INCLINATIONS_DEG)


@dataclass(frozen=True)
class PaperPlan:
    """All poses of the experiment: the three conventional ones, four on each inclination, and the turns."""

    inc_rad: Array
    tf_rad: Array
    state: ChainState

    @classmethod
    def of_the_paper(cls) -> PaperPlan:
        """The poses in the order conventional, inclinations, turns."""
        three_inc, three_tf = position_plan(3)
        station_inc, balance_tf = pose_grid(INCLINATIONS_DEG, BALANCE_TOOLFACES_DEG)
        turn_inc, turn_tf = pose_grid(INCLINATIONS_DEG, STATIONS_DEG)
        inc, tf = np.concatenate([three_inc, station_inc, turn_inc]), np.concatenate([three_tf, balance_tf, turn_tf])
        return cls(inc, tf, ChainState.build(inc, tf))


@dataclass(frozen=True)
class BalanceRun:
    """One run of the experiment: `readings` (3, N, 4) in g of the plan's poses, and where the tool was, (N,) rad."""

    plan: PaperPlan
    readings: Array
    inc_true_rad: Array
    tf_true_rad: Array

    def matrices(self) -> Array:
        """(6, 11, 3, 3): the correction of each method at each inclination; at 90 deg as it comes out."""
        means = self.readings.mean(axis=2)
        W = np.asarray(gravity_direction(self.plan.inc_rad, self.plan.tf_rad), dtype=float)
        conventional = W[:, :_THREE] @ np.linalg.inv(means[:, :_THREE])
        inclinations = len(INCLINATIONS_DEG)
        four = [slice(_THREE + 4 * r, _THREE + 4 * r + 4) for r in range(inclinations)]
        found = [np.broadcast_to(conventional, (inclinations, 3, 3))]
        found += [np.stack([balance_matrix(means[:, f], W[:, f], name) for f in four]) for name in METHODS[1:]]
        return np.stack(found)

    def errors_deg(
        self, matrices: Array | None = None, offset_g: Array | None = None, *, against: str = "bench"
    ) -> tuple[Array, Array]:
        """Errors (M, 11, 73, 4) of I and T in deg, against the "bench" or the "truth", after all corrections or after
        other `matrices` (M, 11, 3, 3) behind an `offset_g` (3,)."""
        C = self.matrices() if matrices is None else matrices
        inclinations, stations = len(INCLINATIONS_DEG), len(STATIONS_DEG)
        turns = self.readings[:, _THREE + _BALANCE :].reshape(3, inclinations, stations * READINGS)
        if offset_g is not None:
            turns = turns - offset_g[:, None, None]
        g = np.einsum("mrij,jrs->imrs", C, turns)
        inc, tf = attitude_block(g.reshape(3, -1))
        shape = (len(C), inclinations, stations, READINGS)
        where = slice(_THREE + _BALANCE, None)
        inc_ref, tf_ref = (
            (self.plan.inc_rad, self.plan.tf_rad) if against == "bench" else (self.inc_true_rad, self.tf_true_rad)
        )
        d_inc = inc.reshape(shape) - inc_ref[where].reshape(1, inclinations, stations, 1)
        d_tf = wrap_signed(tf.reshape(shape) - tf_ref[where].reshape(1, inclinations, stations, 1))
        return np.degrees(d_inc), np.degrees(d_tf)

    def poses(self) -> PoseSet:
        """The conventional and the balance poses, for an estimator over all of them."""
        part = self.readings[:, : _THREE + _BALANCE]
        return PoseSet.build(
            part.mean(axis=2),
            inc_ref_rad=self.plan.inc_rad[: _THREE + _BALANCE],
            tf_ref_rad=self.plan.tf_rad[: _THREE + _BALANCE],
            n=READINGS,
            std=part.std(axis=2, ddof=1),
        )


def run_session(
    plan: PaperPlan, instrument: ForwardModel, noise_g: float, rng: np.random.Generator, own_g: Array | None = None
) -> BalanceRun:
    """Run the experiment on an instrument (its random effects say how the bench stops).

    `own_g` (3, 3): what chance did to the three conventional poses, where that is known; drawn otherwise.
    """
    draws = dict(instrument.draw(plan.state, rng))
    if own_g is not None and Stage.POSE in draws:
        draws[Stage.POSE] = draws[Stage.POSE].copy()
        draws[Stage.POSE][:, :_THREE] = 0.0
    chain = instrument.chain(plan.state, draws)
    noise = noise_g * rng.standard_normal((*chain.reported.shape, READINGS))
    if own_g is not None:
        noise[:, :_THREE] = own_g[:, :, None]
    inc, tf = attitude_block(np.asarray(chain.gravity))
    return BalanceRun(plan, chain.reported[:, :, None] + noise, inc, tf)


def cells_of(errors: tuple[Array, Array]) -> Array:
    """(..., 4) mean and peak-to-peak of I and T over each turn, from errors (..., 73, 4) in deg: see `COLUMNS`."""
    inc, tf = errors
    both = (-2, -1)
    return np.stack([inc.mean(axis=both), np.ptp(inc, axis=both), tf.mean(axis=both), np.ptp(tf, axis=both)], axis=-1)
