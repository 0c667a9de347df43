"""Long recordings, run of rows by run of rows: what is worked on at a time stays near the processor."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import islice
from typing import TypeVar

from highside.diagnosis.core.policy import CHUNKS

S = TypeVar("S")
T = TypeVar("T")

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
