"""Where in the chain a law may act: one entry for each place, with the channels that it has there.

`PLACES` is the one place in which a name is added. A law gives a number at each row and channel; the place says what
that number does at its stage of the chain (see `effect`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Stage

Act = Callable[[str, AnyArray, AnyArray], AnyArray]
"""(channel, values (n,), stage input x (d, n)) -> what is added, of the shape of the stage"""


@dataclass(frozen=True, slots=True)
class Place:
    """`channels` are the names a law may act on here, `unit` is that of its values, `act` what they do.

    `constant`: a constant here is not absorbed by bias, scale and misalignment, and belongs into a law. `stage` is None
    for channels beside another program's prediction: no chain is known there.
    """

    title: str
    unit: str
    stage: Stage | None
    channels: tuple[str, ...]
    act: Act
    constant: bool = False
    triad: bool = False
    """its channels are the three axes: the load of the own axis is known"""


def _row(count: int, index: int, values: AnyArray) -> AnyArray:
    result = np.zeros((count, values.size), dtype=values.dtype)
    result[index] = values
    return result


def _offset(channel: str, values: AnyArray, x: AnyArray) -> AnyArray:
    return _row(3, AXES.index(channel), values)


def _scale(channel: str, values: AnyArray, x: AnyArray) -> AnyArray:
    axis = AXES.index(channel)
    return _row(3, axis, values * x[axis])


def _matrix(channel: str, values: AnyArray, x: AnyArray) -> AnyArray:
    return _row(3, AXES.index(channel[0]), values * x[AXES.index(channel[1])])


def _all(channel: str, values: AnyArray, x: AnyArray) -> AnyArray:
    return np.asarray(values * x)


def _component(index: int, count: int) -> Act:
    return lambda channel, values, x: _row(count, index, values)


def _level(channel: str, values: AnyArray, x: AnyArray) -> AnyArray:
    return _row(3, AXES.index(channel), values)


PAIRS = tuple(a + b for a in AXES for b in AXES if a != b)

PLACES: dict[str, Place] = {
    "offset": Place("added to a channel", "g", Stage.THERMAL, AXES, _offset, triad=True),
    "scale": Place("in proportion to the load of a channel", "1", Stage.THERMAL, AXES, _scale, triad=True),
    "scale_all": Place("one scale of all channels", "1", Stage.THERMAL, ("xyz",), _all),
    "matrix": Place("share of one axis' load in another", "1", Stage.THERMAL, PAIRS, _matrix),
    "inclination": Place("error of the reference inclination", "rad", Stage.POSE, ("inc",), _component(0, 3), True),
    "toolface": Place("error of the reference toolface", "rad", Stage.POSE, ("tf",), _component(2, 3), True),
    "timing": Place("how much later a row was sampled", "s", Stage.TIMING, ("t",), _component(0, 1), True),
    "level": Place("tilt of the bench", "rad", Stage.GRAVITY, ("x", "y"), _level, True),
    "gyro_offset": Place("added to a gyro", "rad/s", Stage.GYRO, AXES, _offset, triad=True),
    "gyro_scale": Place("in proportion to the rate of a gyro", "1", Stage.GYRO, AXES, _scale, triad=True),
    "channel_offset": Place("added to a channel", "", None, (), _all),
    "channel_factor": Place("a factor of a predicted channel", "1", None, (), _all),
    "channel_delay": Place("delay of a predicted channel", "s", None, (), _all, True),
}
