"""The outbox: a message is kept until the broker has acknowledged it, on disk if that takes longer than a moment.

MQTT is not a store: a client library keeps unsent messages in memory at best, and a broker that went silent swallows
what was written to its socket. So `put` keeps the message in a bounded hand-over in memory and gives it to the sender
at once. What has no PUBACK within `commit_interval_s` is committed to a file by a thread of its own, in groups, and
deleted after its PUBACK. With a broker that answers nothing is written but the reservation of numbers; without one
every message reaches the disk within the interval.

**What a crash or a loss of power costs.** A message is lost if it was neither acknowledged nor committed: it was put
less than one commit interval, and the commit in progress, before the end. That is the same bound as with a commit
before sending; what was acknowledged is safe with the broker, what was older is in the file. A message that the broker
had, and whose deletion was not committed, is sent again: with the same number and content.

**Sequence numbers.** `next_seq` counts per topic and goes on after a restart. No number is ever used with two contents:
numbers are reserved on disk in blocks (`sequence`), the sender is given only messages whose number is reserved, and
after a crash the numbering goes on behind the reservation. So a crash leaves a hole of up to 200 numbers; an orderly
end leaves none. The one exception is a disk that refuses even to overwrite the reservation (read-only, I/O error; not a
full one): then messages are sent all the same, because late is better than never, and a kill before it takes writes
again may let numbers be used again.

**Two streams.** After an outage there are old messages and new ones. Those younger than `historical_after_s` are
*live* and are handed out in order, first of all; the older ones are *historical*, handed out in order where the live
stream leaves room. So a backlog of a million rows does not delay what is measured now, each stream keeps its order,
and the sequence number lets a consumer merge them. Age is measured by the boot clock (see `clock`), so that a wall
clock that is set neither ages nor renews anything; a message of an earlier boot is historical, and too old only if the
wall clock was synchronised both times.

**Accounts.** `produced == acknowledged + queued + dropped` at any time; `queued` is counted on its own (hand-over and
file), not inferred. Caps on rows, bytes and age drop the oldest first, counted by reason. A file that is corrupt is set
aside under another name, a new one is begun, and what can be read is taken over.
"""

from __future__ import annotations

import logging
import sqlite3
import threading
import time
from collections import deque
from contextvars import copy_context
from pathlib import Path

from highside.errors import InputError
from highside.service import clock
from highside.service.outbox_caps import LOST_FILE, beyond_caps
from highside.service.outbox_file import MessageFile
from highside.service.outbox_inspect import OutboxState, inspect
from highside.service.outbox_log import StoredMessage
from highside.service.outbox_memory import BACKLOG_CHUNK, LIVE_IN_MEMORY, Clocks, OutboxStats
from highside.service.outbox_numbers import NumberedOutbox
from highside.service.outbox_rows import BATCH_ROWS
from highside.service.sequence import SequenceFile

__all__ = ["Outbox", "OutboxState", "OutboxStats", "StoredMessage", "inspect"]

log = logging.getLogger(__name__)
RETRY_S = 0.5
"""Pause after the disk refused a commit."""
TIDY_S = 1.0
"""How often caps are looked at, and how long an acknowledged row may wait to be deleted from the file."""
LOOK_S = 2.0
"""How often it is looked whether the files are still where they were opened; an alarm has to come within 5 s."""


class Outbox(NumberedOutbox):
    """See the module. `put`, `next_seq`, `take` and `ack` never block and belong to one thread (the event loop's).

    `path` is the file of messages; the numbers are kept beside it. `clocks` is for tests.
    """

    def __init__(
        self,
        path: Path,
        *,
        max_rows: int,
        max_age_s: float,
        max_bytes: int,
        commit_interval_s: float = 0.05,
        historical_after_s: float = 5.0,
        max_memory_rows: int = 20_000,
        clocks: Clocks = clock.now,
    ) -> None:
        super().__init__(
            max_rows=max_rows,
            max_age_s=max_age_s,
            max_bytes=max_bytes,
            commit_interval_s=commit_interval_s,
            historical_after_s=historical_after_s,
            max_memory_rows=max_memory_rows,
            clocks=clocks,
        )
        # only the thread touches these
        self._path = path
        self._file = MessageFile(path)
        self._numbers = SequenceFile(path.with_name(path.name + ".numbers"))
        self._last_committed_id = 0
        self._tidied_mono = 0.0
        self._looked_mono = 0.0

        self._stopping = threading.Event()
        self._numbered = threading.Event()
        self._ready = threading.Event()
        self._fatal: InputError | None = None
        self._thread: threading.Thread | None = None

    def start(self, *, wait: bool = True) -> None:
        """Open the file and start the thread. Raises `InputError` if another process has the file open.

        `wait=False` returns when the sequence numbers are known: a file with a million messages takes seconds to be
        counted, and what is measured meanwhile waits in memory.
        """
        self._thread = threading.Thread(target=copy_context().run, args=(self._run,), name="outbox", daemon=True)
        self._thread.start()
        (self._ready if wait else self._numbered).wait()
        if self._fatal is not None:
            self._thread.join()
            raise self._fatal

    def stop(self, timeout_s: float) -> None:
        """Commit what is in memory and close the file."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                log.error("outbox: the last commit did not end within %.1f s", timeout_s)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._file.lock()
            self._begin_numbers()
            self._numbered.set()
            self._open()
        except InputError as error:
            self._fatal = error
        except (sqlite3.Error, OSError) as error:
            self._failed(error)
        self._numbered.set()
        self._ready.set()
        while self._fatal is None and not self._turn():
            pass
        self._numbers.close()
        self._file.release()

    def _turn(self) -> bool:
        """Sleep until something is due, and do it. True at the end."""
        self._wake.wait(self._sleep_s())
        stopping = self._stopping.is_set()
        if not stopping and not self._is_due():
            return False
        try:
            done = self._cycle(stopping)
        except Exception as error:
            # whatever it is: were this thread to end, nothing would be stored any more and nobody would notice
            self._failed(error)
            self._notify()
            if stopping:
                return True
            self._stopping.wait(RETRY_S)
            return False
        self._notify()
        return done and stopping

    def _sleep_s(self) -> float:
        """How long nothing needs to be done unless the thread is woken."""
        with self._lock:
            now, due = time.monotonic(), None
            if self._urgent or self._stopping.is_set():
                due = now
            elif self._handover:
                due = next(iter(self._handover.values())).put_mono + self._commit_interval_s
            elif now - self._put_mono < TIDY_S:
                # more will come: looking in time for the next one is cheaper than being woken by each
                due = now + self._commit_interval_s
            elif self._gone or self._rows_in_file or not self._storage_ok:
                due = now + TIDY_S
            self._due_mono = due
            return LOOK_S if due is None else max(due - now, 0.0)

    def _is_due(self) -> bool:
        """Whether there is anything to do: what was put is mostly acknowledged before its commit is due."""
        with self._lock:
            now = time.monotonic()
            if self._urgent or not self._storage_ok or not self._file.is_open:
                return True
            if self._handover and next(iter(self._handover.values())).put_mono + self._commit_interval_s <= now:
                return True
            if now - self._looked_mono >= LOOK_S:
                return True
            return bool(self._gone or self._rows_in_file) and now - self._tidied_mono >= TIDY_S

    def _cycle(self, stopping: bool) -> bool:
        """Reserve, store, delete, fill the sender's queues. False if there is more to do at once."""
        with self._lock:
            self._urgent = False
        if stopping or not self._storage_ok or time.monotonic() - self._looked_mono >= LOOK_S:
            self._look()
        refused = self._reserve()
        if not self._file.is_open:
            self._open()
        now = time.monotonic()
        tidy = now - self._tidied_mono >= TIDY_S
        with self._lock:
            oldest = next(iter(self._handover.values())).put_mono if self._handover else now
            due = stopping or not self._storage_ok or now - oldest >= self._commit_interval_s
            over = self._rows_in_file > self._max_rows or self._bytes_in_file > self._max_bytes
            due = due or (bool(self._gone) and (tidy or len(self._gone) >= BATCH_ROWS))
        if due:
            self._commit()
        if (tidy or over) and self._rows_in_file:
            self._enforce_caps()
        if tidy:
            self._tidied_mono = now
        self._fill()
        self._delete_damaged()
        if refused is not None:
            raise refused
        if not self._storage_ok:
            with self._lock:
                self._storage_ok = True
                self._storage_error = ""
            self._quiet.say(logging.WARNING, "storing", "outbox: storing again")
        with self._lock:
            if stopping:
                if self._handover or self._gone:
                    return False
            else:
                return True
        self._numbers.write({topic: seq + 1 for topic, seq in self._seq.items()}, orderly=True)
        return True

    # -- storing ---------------------------------------------------------------------------------------------------

    def _commit(self) -> None:
        with self._lock:
            batch = []
            for row in self._handover.values():
                batch.append(row)
                if len(batch) == BATCH_ROWS:
                    break
            self._committing.update(row.id for row in batch)
            gone = list(self._gone)[: 2 * BATCH_ROWS]
        if not batch and not gone:
            return
        self._file.change(batch, gone)
        with self._lock:
            for row_id in gone:
                del self._gone[row_id]
            for row in batch:
                if self._handover.pop(row.id, None) is None:
                    continue  # acknowledged or dropped during the commit; `_gone` has it
                self._bytes_in_memory -= row.size
                self._rows_in_file += 1
                self._bytes_in_file += row.size
            self._committing.clear()
            self._committed += len(batch)
            if batch:
                self._last_committed_id = batch[-1].id
            if len(self._handover) >= BATCH_ROWS or len(self._gone) >= 2 * BATCH_ROWS:
                self._urgent = True

    def _enforce_caps(self) -> None:
        """Drop the oldest rows beyond a cap. Rows in flight are left alone: their fate is being decided."""
        now = self._clocks()
        with self._lock:
            rows_over = self._rows_in_file - self._max_rows
            bytes_over = self._bytes_in_file - self._max_bytes
            spare = self._in_flight.keys() | self._gone.keys()
        candidates = self._file.oldest(max(rows_over, 0) + len(spare) + BATCH_ROWS)
        victims = beyond_caps(
            (row for row in candidates if row.id not in spare),
            now,
            max_age_s=self._max_age_s,
            rows_over=rows_over,
            bytes_over=bytes_over,
        )
        if not victims:
            return
        with self._lock:
            dropped = set()
            for row, reason in victims:
                if row.id not in self._in_flight and row.id not in self._gone:
                    self._forget(row)
                    self._dropped[reason] += 1
                    dropped.add(row.id)
            self._live = deque(row for row in self._live if row.id not in dropped)
            self._backlog = deque(row for row in self._backlog if row.id not in dropped)
            self._urgent = True

    def _delete_damaged(self) -> None:
        """Rows whose checksum was wrong when they were read: they count as lost."""
        found, self._file.damaged_rows = set(self._file.damaged_rows), []
        if not found:
            return
        with self._lock:
            for row_id in found - self._gone.keys() - self._in_flight.keys():
                self._gone[row_id] = None
                self._rows_in_file -= 1
                self._dropped[LOST_FILE] += 1
            if not self._rows_in_file:
                self._bytes_in_file = 0
        log.error("outbox: %d stored messages were damaged and are omitted", len(found))

    # -- filling the sender's queues -------------------------------------------------------------------------------

    def _fill(self) -> None:
        """Give the sender rows from the file: after a (re)connect the youngest as live, then the backlog."""
        with self._lock:
            if not self._delivering:
                return
            rewind = self._rewind
        if rewind:
            self._find_live()
        with self._lock:
            end = self._live_from
            if self._handover:
                # a row that waited too long may not be in the file yet: the backlog must not pass it
                end = min(end, next(iter(self._handover)))
            first, room = self._backlog_cursor, BACKLOG_CHUNK - len(self._backlog)
        if room < BACKLOG_CHUNK // 2 or first + 1 >= end:
            return
        rows = self._file.between(first, end, room)
        with self._lock:
            if self._rewind or not self._delivering:
                return
            self._backlog_cursor = rows[-1].id if len(rows) == room else end - 1
            self._backlog.extend(row for row in rows if row.id not in self._in_flight and row.id not in self._gone)

    def _find_live(self) -> None:
        now = self._clocks()
        rows: list[StoredMessage] = []
        for row in self._file.youngest(LIVE_IN_MEMORY):
            if not self._is_live(row, now):
                break
            rows.append(row)
        with self._lock:
            if self._rewind:
                self._set_live(rows[::-1])
                self._backlog.clear()
                self._backlog_cursor = 0

    # -- opening and failing ---------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Whether the files in use are at their places; if not, begin anew there. Raises as opening does."""
        self._looked_mono = time.monotonic()
        self._leave_what_moved()
        self._file.lock()

    def _leave_what_moved(self) -> bool:
        numbers_moved = self._numbers.moved()
        if not numbers_moved and not self._file.moved():
            return False
        if numbers_moved:
            self._numbers.close()
            self._sequence_read = False
        self._file.leave()
        with self._lock:
            self._replaced += 1
        text = (
            "outbox: files in %s were deleted or replaced while in use; they are begun anew with all that can be read"
        )
        self._quiet.say(logging.ERROR, "moved", text, self._path.parent)
        return True

    def _open(self) -> None:
        before = self._file.set_aside, self._file.renewed
        if not self._file.is_open:
            self._file.open()
        elif self._opened_before:
            return
        self._corrupt_files = self._file.set_aside
        if self._opened_before:
            if (self._file.set_aside, self._file.renewed) != before:
                self._keep_what_is_in_memory()
                self._count_again()
            with self._lock:
                self._rewind = self._delivering
            return
        rows, size, highest = self._file.count()
        with self._lock:
            self._carried = rows
            self._produced += rows
            self._rows_in_file += rows
            self._bytes_in_file += size
            self._renumber(highest)
        self._last_committed_id = highest
        self._opened_before = True
        if size > self._max_bytes:
            self._drop_large()

    def _drop_large(self) -> None:
        """Stored under a larger cap: one message that is beyond it alone would cost all the others."""
        large = self._file.larger_than(self._max_bytes)
        with self._lock:
            for row in large:
                self._forget(row)
                self._refuse_large(row)

    def _keep_what_is_in_memory(self) -> None:
        """Of rows that were in a file which cannot be read any more, the sender may still have some."""
        with self._lock:
            rows = [*self._in_flight.values(), *self._live, *self._backlog]
            rows = [row for row in rows if row.id not in self._handover and row.id not in self._gone]
        self._file.keep(rows)

    def _count_again(self) -> None:
        """After damage: what was committed should still be there; what is not is lost, and counted."""
        with self._lock:
            gone = list(self._gone)
        rows, size, _ = self._file.count(until=self._last_committed_id)
        rows -= len([row_id for row_id in self._file.present(gone) if row_id <= self._last_committed_id])
        with self._lock:
            missing = self._rows_in_file - rows
            self._bytes_in_file = size
            if missing <= 0:
                return
            self._dropped[LOST_FILE] += missing
            self._rows_in_file = rows
            self._forget_delivery()
        log.error("outbox: %d messages were lost with the damaged file", missing)

    def _failed(self, error: Exception) -> None:
        """The disk refuses. Rows wait in memory; the file is opened anew at the next try."""
        with self._lock:
            first = self._storage_ok
            self._storage_ok = False
            self._storage_errors += 1
            self._storage_error = f"{type(error).__name__}: {error}"
            self._urgent = True
            if self._rewind:
                self._set_live([])
        if first:
            text = "outbox: cannot store (%s); messages wait in memory"
            self._quiet.say(logging.ERROR, "cannot store", text, error)
        if isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.OperationalError):
            self._file.distrust()
        if not self._leave_what_moved():
            self._file.close()
