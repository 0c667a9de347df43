"""Long recordings, run of rows by run of rows: what is worked on at a time stays near the processor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from highside.diagnosis.core.policy import CHUNKS

S = TypeVar("S")
T = TypeVar("T")


def chunks_of(n: int) -> list[slice]:
    """Runs of rows that together are all n."""
    return [slice(start, min(start + CHUNKS.rows, n)) for start in range(0, n, CHUNKS.rows)]


def in_order(work: Callable[[S], T], items: Sequence[S]) -> Iterator[T]:
    """The results of items in their order (sums stay the same to the bit), two at a time: the work is numpy's, which
    lets another thread run."""
    if len(items) == 1:
        yield work(items[0])
        return
    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(work, items)
