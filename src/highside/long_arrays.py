"""Arrays whose last axis is too long for the memory: made or read run by run, never whole.

A `LongArray` is used as a numpy array is: slices and picked rows of it are arrays; arithmetic and functions of single
elements (`np.degrees`, `np.abs`) give another one, which is evaluated when rows of it are read; sums, means, extremes
go through all rows once and are remembered. What would need all rows at once is a TypeError that says so: a calculation
either keeps to its memory or does not run.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, cast

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from highside.arrays import AnyArray, Array

__all__ = [
    "LongArray",
    "by_runs",
    "counted",
    "is_long",
    "mean_and_std",
    "mean_square",
    "numbered_rows",
    "runs_of",
]

RUN = 1 << 16
"""Rows that are read at a time where nothing but a sum is wanted of them. Source: 0.5 MB, in a processor's cache."""
_NEAR = 64
"""rows between two picked ones up to which they are read in one piece"""

_CLASSES = 4096
"""into which numbers are sorted to find the one of a rank"""
_FEW = 1 << 20
"""numbers of one class that are sorted in the memory"""

Read = Callable[[slice], AnyArray]
"""rows from start to stop: (..., stop - start)"""


def runs_of(n: int, rows: int = RUN) -> Iterator[slice]:
    """Runs of rows that together are all n."""
    for start in range(0, n, rows):
        yield slice(start, min(start + rows, n))


def is_long(values: object) -> bool:
    """Whether these are not in the memory."""
    return isinstance(values, LongArray)


class LongArray(NDArrayOperatorsMixin):
    """(..., n) numbers; `read` makes those of a run of rows."""

    __array_priority__ = 100.0

    def __init__(self, shape: tuple[int, ...], read: Read, one: Callable[[int], LongArray] | None = None) -> None:
        """`one` gives a channel by its number, where its rows can be read alone."""
        self.shape, self._read, self._one = shape, read, one
        self._known: dict[tuple[Any, ...], Any] = {}

    @property
    def n(self) -> int:
        """Rows."""
        return self.shape[-1]

    @property
    def size(self) -> int:
        """Numbers."""
        return int(np.prod(self.shape))

    @property
    def ndim(self) -> int:
        """Axes."""
        return len(self.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the numbers."""
        return self.rows(slice(0, min(1, self.n))).dtype

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Any]:
        if self.ndim == 1:
            raise _whole("iterating")
        return (self[k] for k in range(self.shape[0]))

    def rows(self, part: slice) -> AnyArray:
        """(..., stop - start) of a run."""
        return self._read(part)

    # --- picking

    def __getitem__(self, key: Any) -> Any:
        first, along = self._split(key)
        if along is None and self._one is not None and isinstance(first, int | np.integer):
            return self._one(int(first) % self.shape[0])
        if along is None:
            return LongArray((*_picked_shape(self.shape, first), self.n), lambda part: self.rows(part)[first])
        found = self._along(along)
        return found if first is None else found[first]

    def _split(self, key: Any) -> tuple[Any, Any]:
        """What a key says of the channels, and what of the rows; None where it says nothing."""
        if not isinstance(key, tuple):
            return (None, key) if self.ndim == 1 else (key, None)
        if self.ndim == 1 and len(key) == 2 and key[0] is Ellipsis:
            return None, key[1]
        if len(key) > self.ndim:
            raise IndexError(f"{len(key)} indices for {self.ndim} axes")
        if key[0] is Ellipsis:
            return None, key[-1]
        along = key[-1] if len(key) == self.ndim else None
        first = key[0] if self.ndim > 1 else None
        if isinstance(along, slice) and along == slice(None):
            along = None
        if isinstance(first, slice) and first == slice(None) and along is not None:
            first = None
        return first, along

    def _along(self, key: Any) -> Any:
        if isinstance(key, slice):
            start, stop, step = key.indices(self.n)
            if step == 1:
                return self.rows(slice(start, max(start, stop)))
            key = np.arange(start, stop, step)
        if isinstance(key, int | np.integer):
            at = int(key) + (self.n if key < 0 else 0)
            return self.rows(slice(at, at + 1))[..., 0]
        index = np.asarray(key)
        if index.dtype == bool:
            index = np.flatnonzero(index)
        index = np.where(index < 0, index + self.n, index)
        pieces = [self.rows(_span(one))[..., one - one.min()] for one in _near(index)]
        return np.concatenate(pieces, axis=-1) if pieces else self.rows(slice(0, 0))

    # --- arithmetic

    def __array__(self, dtype: Any = None, copy: Any = None) -> AnyArray:
        raise _whole("making one array")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **more: Any) -> Any:
        if method != "__call__" or more.get("out") is not None or ufunc.nout != 1:
            raise _whole(f"{ufunc.__name__}.{method}")
        return _each(ufunc, inputs, more)

    def __array_function__(self, function: Any, types: Any, arguments: Any, more: Any) -> Any:
        if function in _ELEMENTWISE:
            return _each(function, arguments, more)
        known = _REDUCTIONS.get(function)
        if known is None or any(is_long(one) for one in arguments[1:]):
            raise _whole(getattr(function, "__name__", str(function)))
        return getattr(self, known)(*arguments[1:], **more)

    def astype(self, dtype: Any) -> LongArray:
        """The same numbers of another type."""
        return LongArray(self.shape, lambda part: self.rows(part).astype(dtype))

    # --- what goes through all rows

    def _reduced(self, name: str, axis: Any, keepdims: bool, over: Callable[[], AnyArray]) -> Any:
        """Of `over`, which gives (...,) by channels: of all numbers where there is no axis."""
        if axis not in (None, -1, self.ndim - 1):
            raise _whole(f"{name} over axis {axis}")
        key = (name, axis is None)
        if key not in self._known:
            self._known[key] = over()
        found = self._known[key]
        if axis is None:
            return found[()]
        return found[..., None] if keepdims else found

    def _folded(self, each: Callable[[AnyArray], AnyArray], both: Callable[[Any, Any], Any]) -> AnyArray:
        total: Any = None
        for part in runs_of(self.n):
            one = each(self.rows(part))
            total = one if total is None else both(total, one)
        return np.asarray(total)

    def sum(self, axis: Any = None, keepdims: bool = False) -> Any:
        """Of all numbers, or along the rows."""
        return self._reduced("sum", axis, keepdims, lambda: self._summed(axis))

    def _summed(self, axis: Any) -> AnyArray:
        return self._folded(lambda rows: rows.sum(axis=None if axis is None else -1), operator.add)

    def mean(self, axis: Any = None, keepdims: bool = False) -> Any:
        """Of all numbers, or along the rows."""
        count = self.size if axis is None else self.n
        return self._reduced("mean", axis, keepdims, lambda: self._summed(axis) / count)

    def std(self, axis: Any = None, keepdims: bool = False) -> Any:
        """Of all numbers, or along the rows."""
        return self._reduced("std", axis, keepdims, lambda: np.sqrt(self._variance(axis)))

    def _variance(self, axis: Any) -> AnyArray:
        middle = self.mean(axis=axis, keepdims=axis is not None)
        where, count = (None, self.size) if axis is None else (-1, self.n)
        return self._folded(lambda rows: np.sum((rows - middle) ** 2, axis=where), operator.add) / count

    def min(self, axis: Any = None, keepdims: bool = False) -> Any:
        """Of all numbers, or along the rows."""
        where = None if axis is None else -1
        return self._reduced("min", axis, keepdims, lambda: self._folded(lambda r: r.min(axis=where), np.minimum))

    def max(self, axis: Any = None, keepdims: bool = False) -> Any:
        """Of all numbers, or along the rows."""
        where = None if axis is None else -1
        return self._reduced("max", axis, keepdims, lambda: self._folded(lambda r: r.max(axis=where), np.maximum))

    def ptp(self, axis: Any = None, keepdims: bool = False) -> Any:
        """The largest less the smallest."""
        return self.max(axis, keepdims) - self.min(axis, keepdims)

    def median(self) -> float:
        """The middle one of all numbers, as `np.median`."""
        key = ("median", True)
        if key not in self._known:
            ranks = {(self.size - 1) // 2, self.size // 2}
            self._known[key] = float(np.mean([self._ranked(rank) for rank in sorted(ranks)]))
        return cast(float, self._known[key])

    def _ranked(self, rank: int) -> float:
        """The number of that rank from below: between limits that are drawn closer until few numbers are left."""
        low, high = float(self.min()), float(self.max())
        while low < high:
            edges = np.linspace(low, high, _CLASSES + 1)
            count = np.zeros(_CLASSES + 2, dtype=np.int64)
            for part in runs_of(self.n):
                at = np.searchsorted(edges, self.rows(part).reshape(-1), side="right")
                count += np.bincount(at, minlength=_CLASSES + 2)
            # class k holds what is from edge k - 1 to below edge k; the last number is alone at the last edge
            k = int(np.searchsorted(np.cumsum(count), rank, side="right"))
            before = int(count[:k].sum())
            if k > _CLASSES:
                return float(edges[-1])
            if count[k] <= _FEW or not edges[k - 1] < edges[k] or (edges[k - 1], edges[k]) == (low, high):
                inside = [self._between(part, edges[k - 1], edges[k]) for part in runs_of(self.n)]
                return float(np.partition(np.concatenate(inside), rank - before)[rank - before])
            low, high = float(edges[k - 1]), float(edges[k])
        return low

    def _between(self, part: slice, low: float, high: float) -> AnyArray:
        rows = self.rows(part).reshape(-1)
        return rows[(rows >= low) & (rows < high)]

    def any(self, axis: Any = None, keepdims: bool = False) -> Any:
        """Whether any number is not zero."""
        where = None if axis is None else -1
        return self._reduced(
            "any", axis, keepdims, lambda: self._folded(lambda r: np.asarray(r.any(axis=where)), np.logical_or)
        )


def _each(function: Callable[..., Any], inputs: Sequence[Any], more: dict[str, Any]) -> LongArray:
    """What a function makes of single elements."""
    shape = np.broadcast_shapes(*(one.shape if isinstance(one, LongArray) else np.shape(one) for one in inputs))

    def read(part: slice) -> AnyArray:
        return cast(AnyArray, function(*(_rows_of(one, part, shape[-1]) for one in inputs), **more))

    return LongArray(shape, read)


_ELEMENTWISE = frozenset({np.round, np.around, np.where})
_REDUCTIONS = {
    np.ptp: "ptp",
    np.min: "min",
    np.amin: "min",
    np.max: "max",
    np.amax: "max",
    np.mean: "mean",
    np.std: "std",
    np.sum: "sum",
    np.any: "any",
    np.median: "median",
}


def _whole(what: str) -> TypeError:
    return TypeError(f"{what} needs all rows of an array that is too long for the memory")


def _picked_shape(shape: tuple[int, ...], key: Any) -> tuple[int, ...]:
    return cast(tuple[int, ...], np.empty(shape[:-1])[key].shape)


def _rows_of(one: Any, part: slice, n: int) -> Any:
    """A run of an operand; one without rows of its own as it is."""
    if isinstance(one, LongArray):
        return one.rows(part) if one.n == n else one
    shape = np.shape(one)
    return one[..., part] if shape and shape[-1] == n and n > 1 else one


def _near(index: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Picked rows in pieces that lie close together."""
    if not index.size:
        return []
    return np.split(index, np.flatnonzero(np.abs(np.diff(index)) > _NEAR) + 1)


def _span(index: NDArray[np.intp]) -> slice:
    return slice(int(index.min()), int(index.max()) + 1)


# --- making them ---------------------------------------------------------------------------------------------


def by_runs(like: object, shape: tuple[int, ...], of: Read) -> AnyArray:
    """(..., n) what `of` makes of a run of rows: at once, or as a `LongArray` where `like` is one."""
    if is_long(like):
        return cast(AnyArray, LongArray(shape, of))
    return of(slice(0, shape[-1]))


def mean_square(values: AnyArray) -> Array:
    """(C, 1) mean of the squares of (C, n) along the rows: of as many rows the same number to the last bit, whether or
    not they are in the memory."""
    total = sum(np.sum(values[:, part] ** 2, axis=1, keepdims=True) for part in runs_of(values.shape[-1]))
    return np.asarray(total / values.shape[-1])


def mean_and_std(values: AnyArray) -> tuple[float, float]:
    """Of (n,) numbers, summed by the same runs whether or not they are in the memory."""
    n = values.shape[-1]
    mean = float(sum(np.sum(values[part]) for part in runs_of(n)) / n)
    return mean, float(np.sqrt(sum(np.sum((values[part] - mean) ** 2) for part in runs_of(n)) / n))


def numbered_rows(like: AnyArray) -> Array:
    """(n,) 0, 1, ... of as many rows."""
    n = like.shape[-1]
    return by_runs(like, (n,), lambda part: np.arange(part.start, part.stop, dtype=float))


def counted(runs: Iterable[AnyArray]) -> tuple[AnyArray, NDArray[np.intp]]:
    """The different values of runs of rows in rising order, and how many there are of each."""
    found, count = np.empty(0), np.empty(0, dtype=np.intp)
    for rows in runs:
        values, own = np.unique(rows, return_counts=True)
        every = np.union1d(found, values)
        total = np.zeros(every.size, dtype=np.intp)
        total[np.searchsorted(every, found)] += count
        total[np.searchsorted(every, values)] += own
        found, count = every, total
    return found, count


def concatenated(parts: Sequence[AnyArray]) -> AnyArray:
    """Arrays (C, n) one below the other."""
    if not any(is_long(one) for one in parts):
        return np.concatenate(parts)
    n = parts[0].shape[-1]
    count = sum(one.shape[0] for one in parts)
    return cast(AnyArray, LongArray((count, n), lambda part: np.concatenate([one[:, part] for one in parts])))
