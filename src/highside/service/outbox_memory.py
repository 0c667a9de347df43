"""The outbox in memory: what was put and is not stored yet, what is handed out, and the accounts of both.

Everything here is guarded by one lock that is never held during a write, so that nobody waits for the disk. The other
half, which stores and reads, is `outbox`.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Protocol

from pydantic import ConfigDict, Field

from highside.service import clock
from highside.service.outbox_caps import NO_ROOM_IN_MEMORY, TOO_LARGE
from highside.service.outbox_log import BOOT_ID_LETTERS, StoredMessage
from highside.service.outbox_rows import age
from highside.service.quiet_log import QuietLog
from highside.service.sequence import BLOCK
from highside.service.wake import Wake

log = logging.getLogger("highside.service.outbox")

LIVE_IN_MEMORY = 5_000
"""Live rows kept in memory for the sender; the oldest beyond that become historical."""
BACKLOG_CHUNK = 2_000

Count = Annotated[int, Field(ge=0)]


class Clocks(Protocol):
    """What tells the time; `clock.now` but for tests."""

    def __call__(self, *, synced: bool | None = None) -> clock.Moment: ...


@dataclass(frozen=True, slots=True)
class OutboxStats:
    """`produced == acknowledged + queued + sum(dropped)`. Also the member `outbox` of the health message."""

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", allow_inf_nan=False)

    produced: Annotated[Count, Field(description="Taken over from earlier runs (`carried`) and put in this one.")]
    carried: Count
    committed: Annotated[Count, Field(description="Written to the file, because the broker did not have them in time.")]
    acknowledged: Count
    queued: Count
    queued_bytes: int
    dropped: dict[str, Count] = field(default_factory=dict)
    storage_ok: bool = True
    storage_errors: Count = 0
    storage_error: str = ""
    corrupt_files: Count = 0
    replaced: Annotated[Count, Field(description="Times that its files were deleted or replaced while in use.")] = 0
    resumed_at: Annotated[
        dict[str, Count],
        Field(
            description="By topic, where the last run was killed: the first `seq` of this one. Up to 200 numbers before"
            " it were reserved and belong to no message."
        ),
    ] = field(default_factory=dict)

    def balanced(self) -> bool:
        return self.produced == self.acknowledged + self.queued + sum(self.dropped.values())


class OutboxMemory:
    """`put`, `next_seq`, `take` and `ack` never block and belong to one thread (the event loop's).

    `__init__` is long because it declares every account with its meaning, and nothing else.
    """

    def __init__(
        self,
        *,
        max_rows: int,
        max_age_s: float,
        max_bytes: int,
        commit_interval_s: float,
        historical_after_s: float,
        max_memory_rows: int,
        clocks: Clocks,
    ) -> None:
        self._max_rows, self._max_age_s, self._max_bytes = max_rows, max_age_s, max_bytes
        self._commit_interval_s = commit_interval_s
        self._historical_after_s = historical_after_s
        self._max_memory_rows = max_memory_rows
        self._clocks = clocks
        self._quiet = QuietLog(log)
        self._wake = Wake()

        self._lock = threading.Lock()
        self._seq: dict[str, int] = {}
        """the last number given out, by topic"""
        self._topics: set[str] = set()
        """those with messages in this run"""
        self._reserved: dict[str, int] = {}
        """numbers below this are reserved on disk, or were used by an earlier run, by topic"""
        self._reserving = True
        """whether the disk takes reservations"""
        self._resumed_at: dict[str, int] = {}
        self._next_id = 1
        self._handover: OrderedDict[int, StoredMessage] = OrderedDict()
        """put, and neither committed nor acknowledged"""
        self._committing: set[int] = set()
        """rows of the hand-over that may be in the file already: a commit of them is under way, or failed"""
        self._rows_in_file = 0
        self._bytes_in_file = 0
        self._bytes_in_memory = 0
        self._gone: dict[int, None] = {}
        """acknowledged or dropped, still to be deleted from the file"""
        self._delivering = False
        self._rewind = False
        self._live: deque[StoredMessage] = deque()
        self._backlog: deque[StoredMessage] = deque()
        self._backlog_cursor = 0
        self._live_from = 0
        """rows with an id from here on belong to the live stream"""
        self._live_sent = -1
        """the youngest message that was handed out live since `begin_delivery`"""
        self._in_flight: dict[int, StoredMessage] = {}
        self._produced = self._carried = self._committed = self._acknowledged = 0
        self._dropped: Counter[str] = Counter()
        self._storage_ok = True
        self._storage_errors = 0
        self._storage_error = ""
        self._corrupt_files = self._replaced = 0
        self._due_mono: float | None = 0.0
        """when the thread wakes by itself; None: when it is woken"""
        self._put_mono = -math.inf
        """of the last message"""
        self._urgent = True
        """something is to be done at once"""
        self._on_ready: Callable[[], None] | None = None
        self._on_put: Callable[[], None] | None = None

    # -- the producer's side ---------------------------------------------------------------------------------------

    def next_seq(self, topic: str) -> int:
        """The sequence number of the next message on `topic`; begins at 0, goes on after a restart."""
        seq = self._seq.get(topic, -1) + 1
        self._seq[topic] = seq
        self._topics.add(topic)
        if self._reserved.get(topic, 0) - seq < BLOCK // 2:
            self._hurry()
        return seq

    def put(
        self, topic: str, payload: bytes, *, created_s: float | None = None, qos: int = 1, synced: bool = False
    ) -> None:
        """Hand over a message that carries the last `next_seq(topic)`. Never blocks, never raises for want of room.

        `created_s` is for one that was made earlier, by the wall clock as it is now; `synced`: that clock is right.
        """
        now, mono = self._clocks(synced=synced), time.monotonic()
        made_s, age_s = (now.wall_s, 0.0) if created_s is None else (created_s, max(now.wall_s - created_s, 0.0))
        boot_id = now.boot_id[:BOOT_ID_LETTERS]
        with self._lock:
            seq = self._seq.get(topic, -1)
            row = StoredMessage(
                self._next_id, topic, seq, made_s, qos, payload, boot_id, now.boot_s - age_s, synced, mono
            )
            self._produced += 1
            if row.size > self._max_bytes:
                self._refuse_large(row)
                return
            self._next_id += 1
            self._put_mono = mono
            self._handover[row.id] = row
            self._bytes_in_memory += row.size
            if len(self._handover) > self._max_memory_rows:
                self._drop_from_memory()
            if self._delivering and not self._rewind:
                self._live.append(row)
                self._trim_live()
            sleeping = self._due_mono is None or self._due_mono > mono + self._commit_interval_s
            on_put = self._on_put
        if sleeping:
            self._wake.set()
        if on_put is not None:
            on_put()

    def _refuse_large(self, row: StoredMessage) -> None:
        self._dropped[TOO_LARGE] += 1
        text = "outbox: a message of %d bytes on %s is dropped: it is larger than mqtt.outbox.max_bytes (%d)"
        self._quiet.say(logging.ERROR, TOO_LARGE, text, row.size, row.topic, self._max_bytes)

    def _drop_from_memory(self) -> None:
        for row in self._handover.values():
            if row.id not in self._in_flight:
                self._forget(row)
                self._dropped[NO_ROOM_IN_MEMORY] += 1
                with contextlib.suppress(ValueError):
                    self._live.remove(row)
                return

    def _trim_live(self) -> None:
        while len(self._live) > LIVE_IN_MEMORY:
            self._live_from = self._live.popleft().id + 1

    def _hurry(self) -> None:
        """Let the thread look at once."""
        if not self._urgent:
            self._urgent = True
            self._wake.set()

    @property
    def uncommitted(self) -> int:
        """Messages that the broker does not have and the file neither."""
        with self._lock:
            return len(self._handover)

    @property
    def overdue_s(self) -> float:
        """For how long the oldest message has waited for a commit that should have been; 0 if none has."""
        with self._lock:
            if not self._handover:
                return 0.0
            oldest = next(iter(self._handover.values())).put_mono
        return max(time.monotonic() - oldest - self._commit_interval_s, 0.0)

    @property
    def stats(self) -> OutboxStats:
        with self._lock:
            return OutboxStats(
                produced=self._produced,
                carried=self._carried,
                committed=self._committed,
                acknowledged=self._acknowledged,
                queued=len(self._handover) + self._rows_in_file,
                queued_bytes=self._bytes_in_memory + self._bytes_in_file,
                dropped=dict(self._dropped),
                storage_ok=self._storage_ok,
                storage_errors=self._storage_errors,
                storage_error=self._storage_error,
                corrupt_files=self._corrupt_files,
                replaced=self._replaced,
                resumed_at=dict(self._resumed_at),
            )

    # -- the sender's side -----------------------------------------------------------------------------------------

    def begin_delivery(self, on_ready: Callable[[], None], on_put: Callable[[], None] | None = None) -> None:
        """Hand out everything that is not acknowledged, anew.

        Whenever there may be something to `take`, `on_ready` is called in the outbox's thread, or `on_put` in that of
        the caller of `put`.
        """
        with self._lock:
            self._on_ready, self._on_put = on_ready, on_put
            self._delivering = True
            self._forget_delivery()
            self._rewind = True
        self._hurry()

    def end_delivery(self) -> None:
        """The connection is gone: what was taken and not acknowledged will be handed out again."""
        with self._lock:
            self._on_ready = self._on_put = None
            self._delivering = False
            self._forget_delivery()

    def _forget_delivery(self) -> None:
        self._in_flight.clear()
        self._live.clear()
        self._backlog.clear()
        self._rewind = False
        self._live_sent = -1

    def take(self, *, backlog: bool = True) -> tuple[StoredMessage, bool] | None:
        """The next message to send and whether it is historical; None if there is none now.

        `backlog=False` requests the live stream alone. Each message is handed out once until `begin_delivery`.
        """
        with self._lock:
            if not self._delivering or self._rewind:
                return None
            taken = self._take_live()
            if taken is None and backlog and self._backlog:
                taken = self._backlog.popleft(), True
                if len(self._backlog) < BACKLOG_CHUNK // 2:
                    self._hurry()
            if taken is not None:
                row, historical = taken
                self._in_flight[row.id] = row
                if not historical:
                    self._live_sent = max(self._live_sent, row.id)
            return taken

    def _take_live(self) -> tuple[StoredMessage, bool] | None:
        if not self._live and self._storage_ok:
            return None
        now = self._clocks(synced=False)
        while self._live:
            row = self._live[0]
            if self._reserving and row.seq >= self._reserved.get(row.topic, 0):
                self._hurry()
                return None
            self._live.popleft()
            if self._is_live(row, now):
                return row, False
            # it waited too long: the backlog, which reads up to `_live_from`, will find it in the file
            self._live_from = row.id + 1
            self._hurry()
        if not self._storage_ok:
            for row in self._handover.values():
                if row.id not in self._in_flight:
                    return row, row.id < self._live_sent or not self._is_live(row, now)
        return None

    def _is_live(self, row: StoredMessage, now: clock.Moment) -> bool:
        old = age(row, now)
        return old is not None and old <= self._historical_after_s

    def ack(self, row_id: int) -> None:
        """The broker has the message: it is deleted. An id that is not in flight is ignored."""
        with self._lock:
            row = self._in_flight.pop(row_id, None)
            if row is None:
                return
            self._acknowledged += 1
            # no wake-up: the deletion rides on the next commit, or is made within a second; were it lost, a
            # duplicate would be sent
            self._forget(row)

    def discard(self, row_id: int, reason: str) -> None:
        """A message in flight that can never be sent: dropped, counted under `reason`."""
        with self._lock:
            row = self._in_flight.pop(row_id, None)
            if row is None:
                return
            self._dropped[reason] += 1
            self._forget(row)

    def _forget(self, row: StoredMessage) -> None:
        if self._handover.pop(row.id, None) is not None:
            self._bytes_in_memory -= row.size
            if row.id in self._committing:
                self._gone[row.id] = None
        else:
            self._rows_in_file -= 1
            self._bytes_in_file -= row.size
            self._gone[row.id] = None

    # -- for the thread of `outbox` --------------------------------------------------------------------------------

    def _notify(self) -> None:
        with self._lock:
            on_ready = self._on_ready
            something = bool(self._live or self._backlog or (self._handover and not self._storage_ok))
        if on_ready is not None and something:
            # the loop of the receiver may have ended in between
            with contextlib.suppress(RuntimeError):
                on_ready()

    def _set_live(self, stored: list[StoredMessage]) -> None:
        """The live stream: what is young in the file, and what is not there yet."""
        spare = self._gone.keys() | self._in_flight.keys()
        # after a disk that refused the file is looked at again: what is older than what went out live is history
        rows = [row for row in (*stored, *self._handover.values()) if row.id > self._live_sent]
        self._live_from = rows[0].id if rows else self._next_id
        self._live = deque(row for row in rows if row.id not in spare)
        self._trim_live()
        self._rewind = False

    def _renumber(self, highest: int) -> None:
        """Rows put before the file could be opened come after those in it; none of them was ever in the file."""
        self._rewind = self._delivering
        if not self._handover and not self._in_flight:
            self._next_id = max(self._next_id, highest + 1)
            return
        first = max(self._next_id, highest + 1)  # an id that is in flight must not be that of another row
        self._gone.clear()
        waiting = [row._replace(id=first + i) for i, row in enumerate(self._handover.values())]
        self._handover = OrderedDict((row.id, row) for row in waiting)
        self._next_id = first + len(waiting)
        self._forget_delivery()
        self._rewind = self._delivering
