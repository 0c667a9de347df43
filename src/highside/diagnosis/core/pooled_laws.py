"""Laws of which many recordings can be pooled: the same functions of the same quantities in every recording.

The search for laws takes its functions from the range that a recording visited, so that coefficients of two recordings
are of different things. Here the functions are fixed: harmonics of toolface and inclination from the second on (what
the first do is bias, scale and misalignment), powers of the temperature's departure from 25 C from the second on (the
first are effects of the library). They stand beside the effects in the scores of a recording, as `law:offset_x_tf`, so
that what has no name and is too small for one recording shows in a lot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.physics.covariates import covariate
from highside.physics.effect import REFERENCE_TEMP_C
from highside.physics.law import PREFIX, Function
from highside.physics.places import PLACES
from highside.physics.state import ChainState

__all__ = ["FAMILIES", "PooledLaw", "pooled_laws"]


@dataclass(frozen=True)
class LawFamily:
    """Functions of one covariate at one place: a law on each of its channels."""

    place: str
    covariate: str
    functions: tuple[Function, ...]
    names: tuple[str, ...]
    per: tuple[str, ...]
    """what the place's unit is divided by"""


def _harmonics(last: int) -> tuple[tuple[Function, ...], tuple[str, ...], tuple[str, ...]]:
    made = [(Function(kind, (float(k),)), f"{kind}{k}", "") for k in range(2, last + 1) for kind in ("cos", "sin")]
    return tuple(f for f, _, _ in made), tuple(n for _, n, _ in made), tuple(u for _, _, u in made)


_SQUARE, _CUBE = Function("power", (REFERENCE_TEMP_C, 2.0)), Function("odd_power", (REFERENCE_TEMP_C, 3.0))

FAMILIES = (
    LawFamily("offset", "tf", *_harmonics(4)),
    LawFamily("offset", "inc", *_harmonics(3)),
    LawFamily("offset", "temp", (_SQUARE, _CUBE), ("square", "cube"), ("C^2", "C^3")),
    LawFamily("scale", "temp", (_SQUARE,), ("square",), ("C^2",)),
)
"""Few functions each: every amplitude is one more that a lot is searched for, and the limit of all rises with it."""


@dataclass(frozen=True)
class PooledLaw:
    """A law with its columns: of each of k functions what one unit does to n readings."""

    name: str
    """`law:offset_x_tf`: place, channel, covariate"""
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    columns: Array
    """(k, 3, n) g"""


def pooled_laws(state: ChainState, force: Array) -> list[PooledLaw]:
    """The laws of `FAMILIES` for n rows of accelerometers under a specific force (3, n) in g."""
    found = []
    for family in FAMILIES:
        place = PLACES[family.place]
        for axis, channel in enumerate(place.channels):
            along = np.asarray(np.real(covariate(family.covariate).of(state, force, axis)), dtype=float)
            span = (float(along.min(initial=0.0)), float(along.max(initial=0.0)))
            columns = [place.act(channel, function(along, span), force) for function in family.functions]
            units = tuple(f"{'' if place.unit == '1' else place.unit}{'/' + per if per else ''}" for per in family.per)
            units = tuple(f"1{unit}" if unit.startswith("/") else unit for unit in units)
            name = f"{PREFIX}{family.place}_{channel}_{family.covariate}"
            found.append(PooledLaw(name, family.names, units, np.asarray(columns, dtype=float)))
    return found
