"""What the search for laws sees of a session, whatever kind it is.

A session gives C channels of n values after its base fit, what is free anyway, how a number at each row would enter in
each place, the covariates, and a noise floor that does not come from the misfit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.physics.covariates import lag_of
from highside.physics.law import Axis
from highside.physics.memory import low_pass

if TYPE_CHECKING:
    from highside.diagnosis.laws.cell_noise import CellNoise


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


POLYNOMIALS = frozenset({"one", "straight", "square", "linear"})
CORNERS = frozenset({"step", "ramp", "decay", "modulus", "sign"})
"""functions with a corner or a step at their first number (of `sign` at zero), and smooth on either side of it"""


def fastest_phase(axis: Axis) -> float:
    """By how many rad the fastest function of an axis turns in a unit of its covariate, beside its corners; 0 where all
    are polynomials, infinite where that is not known. A bell of width w turns by less than 4 / w: beyond that it has
    exp(-8) of its largest wave."""
    width = (axis.high - axis.low) or 1.0
    each = {"cosine": np.pi / width, "wide_cosine": np.pi / width, "cos": np.pi / 180.0, "sin": np.pi / 180.0}
    turns = [0.0]
    for function in axis.functions:
        kind, numbers = function.kind, function.numbers
        if kind in ("dent", "bump"):
            turns.append(4.0 / numbers[1])
        elif kind == "decay":
            turns.append(1.0 / numbers[1])
        elif kind not in POLYNOMIALS | CORNERS:
            turns.append(abs(numbers[0]) * each.get(kind, np.inf) if numbers and numbers[0] else np.inf)
    return float(max(turns))


def corners_of(axis: Axis) -> list[float]:
    """The values of the covariate of an axis at which a function has a corner or a step."""
    return [f.numbers[0] if f.numbers else 0.0 for f in axis.functions if f.kind in CORNERS]


class CovariateValues(dict[str, Array]):
    """Covariates by name: (n,), or (3, n) where one differs from axis to axis; of values that follow one another in
    time the temperature of any lag too, which is not listed. Raises KeyError for what is not known.

    Where each value stands for many rows, a function of a covariate is the mean of what it is at these: its reading is
    a mean too.
    """

    def __init__(self, listed: Mapping[str, Array], t_s: Array, among: RowValues | None = None) -> None:
        super().__init__(listed)
        self._t_s, self._among = t_s, among
        self._lagging: dict[str, Array] = {}
        self._functions: dict[Axis, Array] = {}
        self._nodes: dict[str, tuple[Array, Array, Array] | None] = {}
        self._extents: dict[str, tuple[Array, Array]] = {}
        self._last: tuple[str, Array | None] = "", None

    def functions(self, axis: Axis) -> Array | None:
        """(m, n) the functions of an axis, means over rows; None where that is not known."""
        if self._among is None or self._among.n > LAW_GROUPS.averaged_rows:
            return None
        if axis not in self._functions:
            made = self._mean_of(axis)
            if made is None:
                return None
            # the last stay: products share them
            self._functions[axis] = made
            _limited(self._functions, LAW_GROUPS.averaged_kept)
        return self._functions[axis]

    def _mean_of(self, axis: Axis) -> Array | None:
        """(m, n) means over rows of an axis' functions; of smooth ones from a few nodes of each value's rows."""
        assert self._among is not None
        name = axis.covariate
        fastest = fastest_phase(axis)
        if fastest < np.inf and name not in self._nodes:
            values = self._of_rows(name)
            if values is None:
                return None
            self._nodes[name] = self._among.nodes(values) if np.isfinite(values).all() else None
            _limited(self._nodes, LAW_GROUPS.nodes_kept)
        nodes = self._nodes[name] if fastest < np.inf else None
        if nodes is None:
            values = self._of_rows(name)
            return None if values is None else np.asarray(self._among.mean(axis.basis(values)))
        at, weights, spread = nodes
        found = np.sum(axis.basis(at.reshape(-1)).reshape(-1, *at.shape) * weights, axis=1)
        wide = fastest * spread > LAW_GROUPS.by_nodes
        if corners := corners_of(axis):
            wide |= self._around(name, corners)
        if wide.any() and (values := self._of_rows(name)) is not None:
            rows, mean = self._among.within(wide)
            found[:, wide] = mean(axis.basis(values[rows]))[:, wide]
        return np.asarray(found)

    def _around(self, name: str, corners: Sequence[float]) -> NDArray[np.bool_]:
        """(n,) whose rows lie on both sides of one of these values of a covariate."""
        assert self._among is not None
        if name not in self._extents:
            values = self._of_rows(name)
            assert values is not None
            self._extents[name] = self._among.extent(values)
            _limited(self._extents, LAW_GROUPS.nodes_kept)
        low, high = self._extents[name]
        return np.asarray(np.any([(low <= at) & (at <= high) for at in corners], axis=0))

    def _of_rows(self, name: str) -> Array | None:
        """(N,) a covariate at all rows; that of the last is known."""
        assert self._among is not None
        if self._last[0] != name:
            self._last = name, self._lagged(name) if lag_of(name) else self._among.of(name)
        return self._last[1]

    def spread_of_times(self) -> Array | None:
        """(n,) standard deviation in s of the times of the rows of each value; None where a value is a row."""
        if self._among is None:
            return None
        time = self._t_s - self._t_s[0]
        return np.asarray(np.sqrt(np.maximum(self._among.mean(time**2) - self._among.mean(time) ** 2, 0.0)))

    def _lagged(self, name: str) -> Array:
        """(N,) a temperature that lags, at all times."""
        temp = self["temp"] if self._among is None else self._among.of("temp")
        assert temp is not None
        return np.asarray(low_pass(self._t_s, temp, float(lag_of(name))))

    def __missing__(self, name: str) -> Array:
        if not lag_of(name) or "temp" not in self:
            raise KeyError(name)
        if name not in self._lagging:
            made = self._lagged(name)
            self._lagging[name] = made if self._among is None else np.asarray(self._among.mean(made))
        return self._lagging[name]


def _limited(kept: dict[Any, Any], most: int) -> None:
    """Without the oldest beyond so many."""
    for oldest in list(kept)[: max(0, len(kept) - most)]:
        del kept[oldest]


class RowValues(Protocol):
    """All rows (N,) that fewer values stand for."""

    @property
    def n(self) -> int: ...
    def of(self, name: str) -> Array | None:
        """(N,) a covariate; None where it differs from axis to axis, or is not known of all rows."""

    def mean(self, values: Array) -> Array:
        """(..., N) to (..., n)."""

    def nodes(self, values: Array) -> tuple[Array, Array, Array]:
        """Of values (N,) nodes and weights (k, n) of the means of smooth functions, and their scatter (n,)."""

    def extent(self, values: Array) -> tuple[Array, Array]:
        """Of values (N,) the smallest and the largest (n,)."""

    def within(self, wanted: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Callable[[Array], Array]]:
        """The rows (M,) for which the values `wanted` (n,) stand, and what takes (..., M) to (..., n)."""


def functions_of(covariates: Mapping[str, Array], axis: Axis, own: int = -1) -> Array:
    """(m, n) the functions of an axis, of a covariate that may differ from axis to axis as the axis `own` knows it."""
    if isinstance(covariates, CovariateValues) and (made := covariates.functions(axis)) is not None:
        return made
    values = covariates[axis.covariate]
    return axis.basis(values[own] if values.ndim == 2 else values)


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
    measured: bool = True
    """whether the floor was measured; else it is what rounding leaves"""
    cells: CellNoise | None = None
    """the noise of values that are means over cells of rows; None: values are rows, or poses"""

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
