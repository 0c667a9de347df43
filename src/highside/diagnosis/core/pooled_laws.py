"""Laws of which many recordings can be pooled: the same functions of the same quantities in every recording.

The search for laws takes its functions from the range that a recording visited, so that coefficients of two recordings
are of different things. Here the functions are fixed: harmonics of toolface and inclination from the second on (what
the first do is bias, scale and misalignment), powers of the temperature's departure from 25 C from the second on (the
first are effects of the library). They stand beside the effects in the scores of a recording, as
`law:offset_x_tf[harmonic=3]`, so that what has no name and is too small for one recording shows in a lot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.physics.covariates import covariate
from highside.physics.effect import REFERENCE_TEMP_C
from highside.physics.law import PREFIX
from highside.physics.law_functions import Function
from highside.physics.places import PLACES
from highside.physics.state import ChainState

__all__ = ["FAMILIES", "PooledLaw", "pooled_laws"]


@dataclass(frozen=True)
class LawFamily:
    """Functions of one covariate at one place, all of one order: a law on each of the place's channels."""

    place: str
    covariate: str
    shape: str
    """which of several: `harmonic=3`"""
    functions: tuple[Function, ...]
    names: tuple[str, ...]
    per: str = ""
    """what the place's unit is divided by"""


def _harmonic(covariate: str, order: int) -> LawFamily:
    functions = (Function("cos", (float(order),)), Function("sin", (float(order),)))
    return LawFamily("offset", covariate, f"harmonic={order}", functions, ("cos", "sin"))


def _power(place: str, kind: str, power: int) -> LawFamily:
    function = Function(kind, (REFERENCE_TEMP_C, float(power)))
    return LawFamily(place, "temp", f"power={power}", (function,), ("size",), f"C^{power}")


FAMILIES = (
    *(_harmonic("tf", order) for order in (2, 3, 4)),
    *(_harmonic("inc", order) for order in (2, 3)),
    _power("offset", "power", 2),
    _power("offset", "odd_power", 3),
    _power("scale", "power", 2),
)
"""Each order by itself: of a law of six amplitudes an effect of one that is like it would be preferred (11 of 125 lots
with such a law, `studies.fleet_lots --hidden laws --first-seed 96000`)."""


@dataclass(frozen=True)
class PooledLaw:
    """A law with its columns: of each of k functions what one unit does to n readings."""

    name: str
    """`law:offset_x_tf[harmonic=3]`: place, channel, covariate, order"""
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
            unit = f"{place.unit}/{family.per}" if family.per else place.unit
            name = f"{PREFIX}{family.place}_{channel}_{family.covariate}[{family.shape}]"
            found.append(PooledLaw(name, family.names, (unit,) * len(columns), np.asarray(columns, dtype=float)))
    return found
