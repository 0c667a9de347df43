"""One simulated session: a plan, a forward model and a seed become rows of readings, with the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.physics.gravity import attitude_of
from highside.physics.plan import Session
from highside.physics.state import ChainState


@dataclass(frozen=True)
class Simulated:
    """M rows as they reach the recording (some may be lost or repeated by the link)."""

    state: ChainState
    """what the bench reads, at these rows"""
    held: AnyArray
    """(M,) whether the tool stood at a pose"""
    seq: AnyArray
    """(M,) number of the row as the device counted it"""
    accel: AnyArray
    """(3, M) reported gravity direction, g"""
    gyro: AnyArray | None
    """(3, M) reported rates, rad/s"""
    inc_true: AnyArray
    """(M,) true inclination in [0, pi], rad"""
    tf_true: AnyArray
    """(M,) true toolface in [0, 2 pi), rad"""
    power_up_bias_g: AnyArray
    """(3,) what the random effects added to the zero offsets at the start (turn-on bias)"""


def simulate(model: ForwardModel, session: Session, seed: int, *, gyros: bool = False) -> Simulated:
    """Run a session. The same arguments give the same numbers, bit for bit.

    Gyros are simulated if requested or if the model holds an effect that acts on them.
    """
    rng = np.random.default_rng(seed)
    state, held = session.rows()
    draws = model.draw(state, rng)
    chain = model.chain(state, draws)
    accel = model.recorded(state, chain.reported, rng)
    on_gyros = any(Stage.GYRO in (effect.stage, getattr(effect, "draws_at", None)) for effect, _ in model.effects)
    gyro = model.gyro(state, draws) if gyros or on_gyros else None
    inc_true, tf_true = attitude_of(chain.gravity)
    rows = model.recorded_rows(state, rng)
    offset = draws.get(Stage.SENSOR)
    return Simulated(
        state=state.rows(rows),
        held=held[rows],
        seq=rows,
        accel=accel[:, rows],
        gyro=None if gyro is None else gyro[:, rows],
        inc_true=inc_true[rows],
        tf_true=tf_true[rows],
        power_up_bias_g=np.zeros(3) if offset is None else offset[:, 0],
    )
