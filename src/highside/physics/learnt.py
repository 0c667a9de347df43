"""Effects that were learnt as laws: what their files need beside the curve or the formula itself.

A file that `highside effects new` writes holds one subclass of `LearntEffect`: where it acts (`place`, a name of
`places.PLACES`), on which channels, of which covariates, and `value`, what one unit of a channel's amplitude does. The
rest follows from these. Beyond the range that was visited the value falls to nothing, as that of a law does.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.covariates import COVARIATES, covariate
from highside.physics.effect import AXES, LinearEffect
from highside.physics.gravity import gravity_direction
from highside.physics.law import Axis
from highside.physics.places import PLACES
from highside.physics.state import ChainState

Span = tuple[float, float]


class LearntEffect(LinearEffect):
    """`value` of covariates, with one amplitude for each of `channels`."""

    place: str
    channels: tuple[str, ...]
    depends_on: tuple[str, ...]
    visited: tuple[Span, ...]
    """of each covariate the range in which it was learnt"""
    turns_the_tool = False
    """as the law it was: set it where an error of the angle is known to be one of the recorded rate, too"""

    @abstractmethod
    def value(self, channel: str, *covariates: AnyArray) -> AnyArray:
        """(n,) what one unit of the amplitude of a channel does, at values (n,) of each covariate."""

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        place = PLACES[self.place]
        known = all(name in COVARIATES or name in state.extra for name in self.depends_on)
        columns = []
        for channel in self.channels:
            if known:
                unit = self._tapered(channel, [self._along(name, channel, state, x) for name in self.depends_on])
            else:
                # the recording lacks the column: nothing is known, and nothing shows
                unit = np.zeros(state.n)
            columns.append(place.act(channel, unit, x))
        return np.stack(np.broadcast_arrays(*columns))

    def _along(self, name: str, channel: str, state: ChainState, x: AnyArray) -> AnyArray:
        place = PLACES[self.place]
        axis = -1
        if place.triad:
            axis = AXES.index(channel)
        elif self.place == "matrix":
            axis = AXES.index(channel[1])
        on_sensor = place.stage is not None and place.stage.value == "thermal"
        load = np.real(x) if on_sensor else gravity_direction(state.inc_rad, state.tf_rad)
        return np.asarray(np.real(covariate(name).of(state, load, axis)), dtype=float)

    def _tapered(self, channel: str, along: Sequence[AnyArray]) -> AnyArray:
        held, fall = [], np.ones(along[0].size)
        for name, span, u in zip(self.depends_on, self.visited, along, strict=True):
            inside, own = Axis(name, *span, ()).held(u)
            held.append(inside)
            fall = fall * own
        return np.asarray(self.value(channel, *held) * fall)
