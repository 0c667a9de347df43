"""What an effect is measured in: its parameters, and which of its amplitudes act together."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

Groups = tuple[tuple[int, ...], ...]
"""sets of amplitudes, by their numbers in the order of `Effect.amplitudes`"""

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    `gate` is the physically plausible range: a fit outside of it is not believed, a model outside of it is refused.
    `shape` marks numbers that form the effect without giving it size (a time constant, a harmonic order): with all
    others at zero the effect is nothing, whatever the shape; the others are its *amplitudes*. Of several shapes every
    combination is tried. What is tried of a shape, one of:

    `grid`           the values worth trying;
    `time_constant`  the same, halved and doubled on to all that the length of a recording tells apart;
    `epoch`          it is a time of onset, in s since the first row, and may be anywhere: nothing of the effect shows
                     before. It is searched, not fitted: no derivative says where a step is;
    `line_over`      it is a frequency, in cycles per second ("time") or per turn ("turns"), looked for in a spectrum;
                     the effect is a cosine and a sine on each axis it acts on.
    """

    name: str
    unit: str
    typical: float
    gate: tuple[float, float]
    default: float = 0.0
    shape: bool = False
    integer: bool = False
    grid: tuple[float, ...] = ()
    time_constant: bool = False
    epoch: bool = False
    line_over: Literal["", "time", "turns"] = ""
    formerly: str = ""
    """the name in older files, which is still read"""

    @property
    def fitted(self) -> bool:
        """Whether a fit may move it: not a number of things, not a time of onset."""
        return not self.integer and not self.epoch


def triad(prefix: str, unit: str, typical: float, limit: float) -> tuple[Parameter, ...]:
    """Three parameters `prefix_x, prefix_y, prefix_z` with the gate +-limit."""
    return tuple(Parameter(f"{prefix}_{axis}", unit, typical, (-limit, limit)) for axis in AXES)


def singles(count: int) -> Groups:
    """Each of so many amplitudes by itself."""
    return tuple((k,) for k in range(count))


def runs(count: int, length: int) -> Groups:
    """Neighbours together: of 6 by 2 (0, 1), (2, 3), (4, 5), as the rows of a matrix."""
    return tuple(tuple(range(k, k + length)) for k in range(0, count, length))


def across(count: int, step: int) -> Groups:
    """Those so many apart together: of 6 by 3 (0, 3), (1, 4), (2, 5), as the orders or the phases of each axis."""
    return tuple(tuple(range(k, count, step)) for k in range(step))


def pairs(groups: Groups) -> Groups:
    """Two groups at a time."""
    return tuple((*one, *other) for one, other in combinations(groups, 2))
