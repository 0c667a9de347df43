"""Long recordings, run of rows by run of rows: what is worked on at a time stays near the processor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

CHUNK = 4096
FEW_CHUNKS = 8


def chunks_of(n: int) -> list[slice]:
    """Runs of rows that together are all n."""
    return [slice(start, min(start + CHUNK, n)) for start in range(0, n, CHUNK)]


def in_order(work: Callable[[slice], T], chunks: Sequence[slice]) -> Iterator[T]:
    """The results of chunks in their order (sums stay the same to the bit), two at a time where there are many."""
    if len(chunks) <= FEW_CHUNKS:
        yield from map(work, chunks)
        return
    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(work, chunks)
