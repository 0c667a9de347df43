"""Answers to commands, on their way to the broker: few, in memory, and behind everything that was measured.

An answer is worth something to who asked, for seconds. So it does not go through the outbox: it takes no disk, no place
in the order of the readings, and is lost with the process. Two allowances, one for what was done and one for what was
refused, so that a flood of wrong commands does not silence the answers to the right ones; what is beyond is counted.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

RATE_PER_S = 5.0
"""Answers a second of each kind in the long run: more than an operator or a rig's control system requests, and a
twentieth of what a tool at 100 messages/s sends of its own."""
BURST = 20
"""Answers of each kind at once after a pause: a page that requests everything at its start."""
WAITING = 2 * BURST
"""Answers that wait for the network; beyond, the newest is dropped."""


class TokenBucket:
    """Grows by `rate_per_s` up to `burst`; each `take` costs one."""

    def __init__(self, rate_per_s: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._clock = rate_per_s, burst, clock
        self._level, self._at = burst, clock()

    def take(self) -> bool:
        """Whether there was one left."""
        now = self._clock()
        self._level = min(self._level + (now - self._at) * self._rate, self._burst)
        self._at = now
        if self._level < 1.0:
            return False
        self._level -= 1.0
        return True


class QueuedReply(NamedTuple):
    """One answer."""

    topic: str
    payload: bytes


class ReplyQueue:
    """A bounded queue. `put` by who answers; `first`, then `sent`, by who sends."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._allowed = {done: TokenBucket(RATE_PER_S, BURST, clock) for done in (True, False)}
        self._waiting: deque[QueuedReply] = deque()
        self.made = 0
        self.dropped = 0

    def put(self, reply: QueuedReply, *, done: bool) -> bool:
        """Queue an answer to a command that was done, or refused; False: there was no room, it is dropped."""
        if len(self._waiting) >= WAITING or not self._allowed[done].take():
            self.dropped += 1
            return False
        self._waiting.append(reply)
        return True

    @property
    def first(self) -> QueuedReply | None:
        """The one to send next."""
        return self._waiting[0] if self._waiting else None

    def sent(self, reply: QueuedReply) -> None:
        """The broker has it."""
        if self._waiting and self._waiting[0] is reply:
            self._waiting.popleft()
            self.made += 1
