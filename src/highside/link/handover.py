"""Bounded hand-over from a reader thread to the event loop.

Some wires can only be read by a blocking call (RFC 2217, adapters of python-can without a descriptor). Their thread
puts batches here; the loop is woken once for many of them. When the loop is late the thread waits: memory stays
bounded and the loss, if any, happens in the driver where it is counted, not here.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")

A_TURN = 4
"""Items that the loop takes before others have their turn: of a CAN adapter 1,000 frames, 5 to 10 ms of work. After a
stall 64 of them may wait."""


class Handover(Generic[Item]):
    """`put` is called by one thread, `take` runs in the loop and gets what has gathered, some at a time."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, take: Callable[[list[Item]], None], capacity: int = 1024
    ) -> None:
        self._loop = loop
        self._take = take
        self._capacity = capacity
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._woken = False
        self._closed = False

    def put(self, item: Item) -> bool:
        """Hand over; waits while full. False when the receiver has closed."""
        with self._changed:
            while len(self._items) >= self._capacity and not self._closed:
                self._changed.wait()
            if self._closed:
                return False
            self._items.append(item)
            if self._woken:
                return True
            self._woken = True
        self._loop.call_soon_threadsafe(self._drain)
        return True

    @property
    def closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        """Nothing is taken any more; a waiting thread is let go."""
        with self._changed:
            self._closed = True
            self._items.clear()
            self._changed.notify_all()

    def _drain(self) -> None:
        with self._changed:
            items = [self._items.popleft() for _ in range(min(len(self._items), A_TURN))]
            closed = self._closed
            self._woken = bool(self._items)
            if self._woken:
                self._loop.call_soon(self._drain)
            self._changed.notify_all()
        if items and not closed:
            self._take(items)
