"""Long recordings, run of rows by run of rows: what is worked on at a time stays near the processor."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import islice
from typing import Protocol, TypeVar

from highside.diagnosis.core.policy import CHUNKS

S = TypeVar("S")
T = TypeVar("T")


class Elsewhere(Protocol):
    """Other processes that see the files in which long arrays lie."""

    def takes(self, count: int) -> bool:
        """Whether so many runs are worth sending."""

    def results(
        self, work: Callable[[S], T], items: Sequence[S], both: Callable[[T, T], T] | None = None
    ) -> Iterator[T]:
        """As `of_runs`."""


_elsewhere: ContextVar[Elsewhere | None] = ContextVar("elsewhere", default=None)
_threads: ContextVar[int] = ContextVar("threads", default=CHUNKS.threads)


def chunks_of(n: int) -> list[slice]:
    """Runs of rows that together are all n."""
    return [slice(start, min(start + CHUNKS.rows, n)) for start in range(0, n, CHUNKS.rows)]


@contextmanager
def on_threads(count: int | None) -> Iterator[None]:
    """Work on so many runs at a time; None: on as many as before."""
    before = _threads.set(_threads.get() if count is None else count)
    try:
        yield
    finally:
        _threads.reset(before)


@contextmanager
def spread_over(elsewhere: Elsewhere) -> Iterator[None]:
    """Give runs of rows of long recordings out to other processes."""
    before = _elsewhere.set(elsewhere)
    try:
        yield
    finally:
        _elsewhere.reset(before)


def of_runs(work: Callable[[slice], T], runs: Sequence[slice], both: Callable[[T, T], T] | None = None) -> Iterator[T]:
    """The results of runs of rows in their order, from threads or from the processes of `spread_over`.

    `both` makes one result of those of two neighbours: these processes then answer for many runs at once.
    """
    elsewhere = _elsewhere.get()
    if elsewhere is None or not elsewhere.takes(len(runs)):
        yield from in_order(work, runs)
    else:
        yield from elsewhere.results(work, runs, both)


def in_order(work: Callable[[S], T], items: Sequence[S]) -> Iterator[T]:
    """The results of items in their order (sums stay the same to the bit), some at a time: the work is numpy's, which
    lets other threads run. No more are begun than are soon wanted, so that results do not pile up."""
    count = min(_threads.get(), len(items))
    if count <= 1:
        yield from map(work, items)
        return
    left = iter(items)
    with ThreadPoolExecutor(count) as pool:
        ahead: deque[Future[T]] = deque(pool.submit(work, item) for item in islice(left, 2 * count))
        while ahead:
            done = ahead.popleft().result()
            ahead.extend(pool.submit(work, item) for item in islice(left, 1))
            yield done
