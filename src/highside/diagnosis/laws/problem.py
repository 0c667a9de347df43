"""What the search for laws sees of a session, whatever kind it is.

A session gives C channels of n values after its base fit, what is free anyway, how a number at each row would enter in
each place, the covariates, and a noise floor that does not come from the misfit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.physics.covariates import lag_of
from highside.physics.memory import low_pass


@dataclass(frozen=True)
class PlaceField:
    """A place and channel of a law, and what one unit of its value does: `field` (C, n)."""

    place: str
    channel: str
    field: Array
    own: int = -1
    """axis of the triad whose load is its own; -1: none"""

    @cached_property
    def acts(self) -> NDArray[np.bool_]:
        """(C,) on which channels."""
        return np.asarray(np.any(self.field != 0, axis=1))

    @cached_property
    def channels(self) -> tuple[int, ...]:
        """Numbers of these."""
        return tuple(int(c) for c in np.flatnonzero(self.acts))


def fields_that_act(fields: Iterable[PlaceField]) -> tuple[PlaceField, ...]:
    """Those that do more than rounding does, beside the largest of them."""
    fields = tuple(fields)
    sizes = [float(np.abs(one.field).max(initial=0.0)) for one in fields]
    least = LAW_GROUPS.absent * max(sizes, default=0.0)
    return tuple(one for one, size in zip(fields, sizes, strict=True) if size > least)


class CovariateValues(dict[str, Array]):
    """Covariates by name: (n,), or (3, n) where one differs from axis to axis; of values that follow one another in
    time the temperature of any lag too, which is not listed. Raises KeyError for what is not known."""

    def __init__(
        self, listed: Mapping[str, Array], t_s: Array, among: tuple[Array, Callable[[Array], Array]] | None = None
    ) -> None:
        """`among`: the temperature (N,) at all times `t_s` (N,), and what makes of (N,) the values (n,)."""
        super().__init__(listed)
        self._t_s, self._among = t_s, among
        self._lagging: dict[str, Array] = {}

    def __missing__(self, name: str) -> Array:
        if not (lag := lag_of(name)) or "temp" not in self:
            raise KeyError(name)
        if name not in self._lagging:
            temp, mean = self._among or (self["temp"], np.asarray)
            self._lagging[name] = np.asarray(mean(np.asarray(low_pass(self._t_s, temp, float(lag)))))
        return self._lagging[name]


@dataclass(frozen=True)
class LawProblem:
    """n values of C channels in time order."""

    residual: Array
    """(C, n) what the base fit leaves"""
    free: Array
    """(P, C, n) columns of all that is free"""
    places: tuple[PlaceField, ...]
    covariates: Mapping[str, Array]
    """(n,), or (3, n) where a covariate differs from axis to axis"""
    floor: Array
    """(C, n) standard deviation of each value that the misfit has no part in"""
    t_s: Array
    jitter: Array | None = None
    """(J, C, n) what errors of the set angles do, each value's own; None: there are none"""
    channels: tuple[str, ...] = ()
    """names of the channels, as they are reported"""
    orders: tuple[float, ...] = ()
    """orders of the turn at which the readings have a line"""
    memory: bool = True
    """noise may have a memory from value to value"""
    every_pair: bool = False
    """products of any two covariates are tried, not of the usual ones alone: of few values they cost little"""

    @property
    def n(self) -> int:
        """Number of values of a channel."""
        return int(self.residual.shape[1])

    @property
    def count(self) -> int:
        """Number of channels."""
        return int(self.residual.shape[0])


def independent(free: Array, floor: Array) -> Array:
    """(Q, C, n) columns that span what is free, each of the size of the floor and none twice."""
    if not len(free):
        return free
    white = flattened(free / floor)
    size = np.linalg.norm(white, axis=1, keepdims=True)
    white = white[size[:, 0] > 0] / size[size[:, 0] > 0]
    _, values, rows = np.linalg.svd(white, full_matrices=False)
    kept = rows[values > 1e-9 * values[0]]
    return np.asarray(kept.reshape(-1, *free.shape[1:]) * floor)
