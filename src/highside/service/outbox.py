"""The outbox: messages are stored here before they are sent, and stay until the broker has acknowledged them.

MQTT is not a store: a client library keeps unsent messages in memory at best, and a broker that went silent swallows
what was written to its socket. So every message is first committed to SQLite (write-ahead log, `synchronous=FULL`)
and deleted after its PUBACK. `put` only appends to a bounded hand-over in memory; a thread of its own commits it in
groups, at once when the last commit was `commit_interval_s` ago, else when that time is over. A process that is
killed loses what it had not committed: at most one commit interval and the commit in progress.

**Sequence numbers.** `next_seq` counts per topic and goes on after a restart from the last number committed. A
message is handed to the sender only after its commit, so that a number is never seen twice with two contents. The one
exception: while the disk refuses to write, messages are sent from memory, because late is better than never; what a
kill then loses may leave its numbers to be used again.

**Two streams.** After an outage there are old messages and new ones. Those younger than `historical_after_s` are
*live* and are handed out in order, first of all; the older ones are *historical*, handed out in order where the live
stream leaves room. So a backlog of a million rows does not delay what is measured now, each stream keeps its order,
and the sequence number lets a consumer merge them.

**Accounts.** `produced == acknowledged + queued + dropped` at any time; `queued` is counted on its own (hand-over and
database), not inferred. Caps on rows, bytes and age drop the oldest first, counted by reason. A file that is corrupt
is set aside under another name and a new one begun.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from highside.errors import InputError

log = logging.getLogger(__name__)

SCHEMA_VERSION = 1
LIVE_IN_MEMORY = 5_000
"""Committed live rows kept in memory for the sender; the oldest beyond that become historical."""
BACKLOG_CHUNK = 2_000
BATCH_ROWS = 2_000
"""Rows in one transaction."""
RETRY_S = 0.5
"""Pause after the disk refused a commit."""
CLOCK_IS_SET_S = 1_577_836_800.0
"""2020-01-01: a message stamped earlier was made before the clock was set, and its age is not known."""

NO_ROOM_IN_MEMORY = "memory"
TOO_MANY_ROWS = "max_rows"
TOO_MANY_BYTES = "max_bytes"
TOO_OLD = "max_age"
LOST_FILE = "corrupt"


class Row(NamedTuple):
    """One message; `id` grows in the order of `put`."""

    id: int
    topic: str
    seq: int
    created_s: float
    qos: int
    payload: bytes

    @property
    def size(self) -> int:
        return len(self.payload) + len(self.topic)


@dataclass(frozen=True, slots=True)
class OutboxStats:
    """A consistent picture: `produced == acknowledged + queued + sum(dropped.values())`."""

    produced: int
    """taken over from earlier runs (`carried`) and put in this one"""
    carried: int
    committed: int
    acknowledged: int
    queued: int
    queued_bytes: int
    dropped: dict[str, int] = field(default_factory=dict)
    storage_ok: bool = True
    storage_errors: int = 0
    storage_error: str = ""
    corrupt_files: int = 0

    def balanced(self) -> bool:
        return self.produced == self.acknowledged + self.queued + sum(self.dropped.values())


class Outbox:
    """See the module. `put`, `next_seq`, `take` and `ack` never block and belong to one thread (the event loop's)."""

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
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._path = path
        self._max_rows, self._max_age_s, self._max_bytes = max_rows, max_age_s, max_bytes
        self._commit_interval_s = commit_interval_s
        self._historical_after_s = historical_after_s
        self._max_memory_rows = max_memory_rows
        self._clock = clock

        # the lock guards what follows; it is never held during SQL, so nobody waits for the disk
        self._lock = threading.Lock()
        self._seq: dict[str, int] = {}
        self._next_id = 1
        self._handover: OrderedDict[int, Row] = OrderedDict()
        """put and not yet committed"""
        self._rows_in_file = 0
        self._bytes_in_file = 0
        self._bytes_in_memory = 0
        self._gone: dict[int, None] = {}
        """acknowledged or dropped, still to be deleted from the file"""
        self._delivering = False
        self._rewind = False
        self._live: deque[Row] = deque()
        self._backlog: deque[Row] = deque()
        self._backlog_cursor = 0
        self._live_from = 0
        """rows with an id from here on belong to the live stream"""
        self._in_flight: dict[int, Row] = {}
        self._produced = self._carried = self._committed = self._acknowledged = 0
        self._dropped: Counter[str] = Counter()
        self._storage_ok = True
        self._storage_errors = 0
        self._storage_error = ""
        self._corrupt_files = 0

        # only the thread touches these
        self._db: sqlite3.Connection | None = None
        self._last_committed_id = 0
        self._caps_checked = 0.0
        self._check_file = True
        self._opened_before = False

        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._ready = threading.Event()
        self._fatal: InputError | None = None
        self._thread: threading.Thread | None = None
        self._on_ready: Callable[[], None] | None = None

    # -- the producer's side ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the file and start the thread. Raises `InputError` if another process has the file open."""
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)
        self._thread.start()
        self._ready.wait()
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

    def next_seq(self, topic: str) -> int:
        """The sequence number of the next message on `topic`; begins at 0, goes on after a restart."""
        seq = self._seq.get(topic, -1) + 1
        self._seq[topic] = seq
        return seq

    def put(self, topic: str, payload: bytes, *, created_s: float, qos: int = 1) -> None:
        """Hand over a message that carries the last `next_seq(topic)`. Never blocks, never raises for want of room."""
        with self._lock:
            row = Row(self._next_id, topic, self._seq.get(topic, -1), created_s, qos, payload)
            self._next_id += 1
            self._produced += 1
            self._handover[row.id] = row
            self._bytes_in_memory += row.size
            if len(self._handover) > self._max_memory_rows:
                self._drop_from_memory()
        if not self._wake.is_set():
            self._wake.set()

    def _drop_from_memory(self) -> None:
        for row in self._handover.values():
            if row.id not in self._in_flight:
                self._forget(row)
                self._dropped[NO_ROOM_IN_MEMORY] += 1
                return

    @property
    def uncommitted(self) -> int:
        """Messages that wait in memory for their commit."""
        with self._lock:
            return len(self._handover)

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
            )

    # -- the sender's side -----------------------------------------------------------------------------------------

    def begin_delivery(self, on_ready: Callable[[], None]) -> None:
        """Hand out everything that is not acknowledged, anew. `on_ready` is called in the outbox's thread whenever
        there may be something to `take`."""
        with self._lock:
            self._on_ready = on_ready
            self._delivering = True
            self._forget_delivery()
            self._rewind = True
        self._wake.set()

    def end_delivery(self) -> None:
        """The connection is gone: what was taken and not acknowledged will be handed out again."""
        with self._lock:
            self._on_ready = None
            self._delivering = False
            self._forget_delivery()

    def _forget_delivery(self) -> None:
        self._in_flight.clear()
        self._live.clear()
        self._backlog.clear()
        self._rewind = False

    def take(self, *, backlog: bool = True) -> tuple[Row, bool] | None:
        """The next message to send and whether it is historical; None if there is none now.

        `backlog=False` asks for the live stream alone. Each message is handed out once until `begin_delivery`.
        """
        with self._lock:
            if not self._delivering or (self._rewind and self._storage_ok):
                return None
            row = self._take_live()
            if row is not None:
                self._in_flight[row.id] = row
                return row, False
            if backlog and self._backlog:
                row = self._backlog.popleft()
                if len(self._backlog) < BACKLOG_CHUNK // 2 and not self._wake.is_set():
                    self._wake.set()
                self._in_flight[row.id] = row
                return row, True
            return None

    def _take_live(self) -> Row | None:
        oldest = self._clock() - self._historical_after_s
        while self._live:
            row = self._live.popleft()
            if row.created_s >= oldest:
                return row
            # it waited too long: the backlog, which reads up to `_live_from`, will find it in the file
            self._live_from = row.id + 1
            self._wake.set()
        if not self._storage_ok:
            for row in self._handover.values():
                if row.id not in self._in_flight:
                    return row
        return None

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

    def _forget(self, row: Row) -> None:
        if self._handover.pop(row.id, None) is not None:
            self._bytes_in_memory -= row.size
        else:
            self._rows_in_file -= 1
            self._bytes_in_file -= row.size
        # also for a row from memory: a commit of it may be under way
        self._gone[row.id] = None

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._open()
        except InputError as error:
            self._fatal = error
            self._ready.set()
            return
        except (sqlite3.Error, OSError) as error:
            self._failed(error)
        self._ready.set()
        while True:
            self._wake.wait(1.0)
            self._wake.clear()
            began = time.monotonic()
            stopping = self._stopping.is_set()
            try:
                done = self._cycle()
                pause = self._commit_interval_s - (time.monotonic() - began)
            except (sqlite3.Error, OSError, InputError) as error:
                self._failed(error)
                done, pause = True, RETRY_S
            if not done:
                self._wake.set()
                continue
            if stopping:
                break
            self._notify()
            if pause > 0.0 and self._stopping.wait(pause):
                self._wake.set()
        self._close()

    def _notify(self) -> None:
        with self._lock:
            on_ready = self._on_ready
            something = bool(self._live or self._backlog or (self._handover and not self._storage_ok))
        if on_ready is not None and something:
            # the loop of the receiver may have ended in between
            with contextlib.suppress(RuntimeError):
                on_ready()

    def _cycle(self) -> bool:
        """Store, delete, fill the sender's queues. False if there is more to do at once."""
        if self._db is None:
            self._open()
        self._commit()
        now = time.monotonic()
        if now - self._caps_checked > 1.0 or self._over_caps():
            self._caps_checked = now
            self._enforce_caps()
        self._fill()
        if not self._storage_ok:
            with self._lock:
                self._storage_ok = True
                self._storage_error = ""
            log.warning("outbox: storing again")
        with self._lock:
            if self._stopping.is_set():
                return not self._handover and not self._gone
            return len(self._handover) < BATCH_ROWS

    def _commit(self) -> None:
        db = self._database()
        with self._lock:
            batch = []
            for row in self._handover.values():
                batch.append(row)
                if len(batch) == BATCH_ROWS:
                    break
            gone = list(self._gone)[: 2 * BATCH_ROWS]
        if not batch and not gone:
            return
        db.execute("BEGIN IMMEDIATE")
        # an earlier commit of the same rows may have failed after it reached the disk: hence OR IGNORE
        db.executemany("INSERT OR IGNORE INTO outbox VALUES (?, ?, ?, ?, ?, ?)", batch)
        last: dict[str, int] = {row.topic: row.seq for row in batch}
        db.executemany("INSERT OR REPLACE INTO sequence VALUES (?, ?)", last.items())
        db.executemany("DELETE FROM outbox WHERE id = ?", [(row_id,) for row_id in gone])
        db.execute("COMMIT")
        with self._lock:
            for row_id in gone:
                del self._gone[row_id]
            for row in batch:
                if self._handover.pop(row.id, None) is None:
                    continue  # acknowledged or dropped during the commit; `_gone` has it
                self._bytes_in_memory -= row.size
                self._rows_in_file += 1
                self._bytes_in_file += row.size
                if self._delivering and not self._rewind and row.id not in self._in_flight:
                    self._live.append(row)
            self._committed += len(batch)
            if batch:
                self._last_committed_id = batch[-1].id
            while len(self._live) > LIVE_IN_MEMORY:
                self._live_from = self._live.popleft().id + 1

    def _over_caps(self) -> bool:
        with self._lock:
            return self._rows_in_file > self._max_rows or self._bytes_in_file > self._max_bytes

    def _enforce_caps(self) -> None:
        """Drop the oldest rows beyond a cap. Rows in flight are left alone: their fate is being decided."""
        expired = self._clock() - self._max_age_s
        with self._lock:
            rows_over = self._rows_in_file - self._max_rows
            bytes_over = self._bytes_in_file - self._max_bytes
            spare = self._in_flight.keys() | self._gone.keys()
        cursor = self._database().execute(
            "SELECT id, topic, seq, created_s, qos, payload FROM outbox ORDER BY id LIMIT ?",
            (max(rows_over, 0) + len(spare) + BATCH_ROWS,),
        )
        victims: list[tuple[Row, str]] = []
        for values in cursor:
            row = Row(*values)
            if row.id in spare:
                continue
            if CLOCK_IS_SET_S < row.created_s < expired:
                reason = TOO_OLD
            elif rows_over > 0:
                reason = TOO_MANY_ROWS
            elif bytes_over > 0:
                reason = TOO_MANY_BYTES
            elif row.created_s <= CLOCK_IS_SET_S:
                continue
            else:
                break
            victims.append((row, reason))
            rows_over -= 1
            bytes_over -= row.size
        cursor.close()
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
        self._wake.set()

    def _fill(self) -> None:
        """Give the sender rows from the file: after a (re)connect the youngest as live, then the backlog."""
        with self._lock:
            if not self._delivering:
                return
            rewind = self._rewind
        if rewind:
            self._find_live()
        with self._lock:
            first, end, room = self._backlog_cursor, self._live_from, BACKLOG_CHUNK - len(self._backlog)
        if room < BACKLOG_CHUNK // 2 or first + 1 >= end:
            return
        rows = self._select("WHERE id > ? AND id < ? ORDER BY id LIMIT ?", (first, end, room))
        with self._lock:
            if self._rewind or not self._delivering:
                return
            self._backlog_cursor = rows[-1].id if len(rows) == room else end - 1
            self._backlog.extend(row for row in rows if row.id not in self._in_flight and row.id not in self._gone)

    def _find_live(self) -> None:
        oldest = self._clock() - self._historical_after_s
        rows: list[Row] = []
        for row in self._select("ORDER BY id DESC LIMIT ?", (LIVE_IN_MEMORY,)):
            if row.created_s < oldest:
                break
            rows.append(row)
        with self._lock:
            if not self._rewind:
                return
            spare = self._gone.keys() | self._in_flight.keys()
            self._live = deque(row for row in reversed(rows) if row.id not in spare)
            self._live_from = rows[-1].id if rows else self._last_committed_id + 1
            self._backlog_cursor = 0
            self._rewind = False

    def _select(self, clause: str, values: tuple[int, ...]) -> list[Row]:
        # `clause` is a constant of this module
        query = f"SELECT id, topic, seq, created_s, qos, payload FROM outbox {clause}"
        return [Row(*found) for found in self._database().execute(query, values)]

    # -- the file --------------------------------------------------------------------------------------------------

    def _database(self) -> sqlite3.Connection:
        assert self._db is not None
        return self._db

    def _open(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._db = self._connect()
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise InputError(
                    "is in use by another process", where=str(self._path), remedy="stop the other instance first"
                ) from error
            raise
        except sqlite3.DatabaseError as error:
            self._set_aside(error)
            self._db = self._connect()
        db = self._db
        sequence = dict(db.execute("SELECT topic, last FROM sequence").fetchall())
        with self._lock:
            for topic, seq in sequence.items():
                self._seq[topic] = max(self._seq.get(topic, -1), seq)
        if self._opened_before:
            self._count_again(db)
            return
        rows, size, last = db.execute(
            "SELECT count(*), total(length(payload) + length(topic)), max(id) FROM outbox"
        ).fetchone()
        highest = max(last or 0, self._highest_id(db))
        with self._lock:
            self._carried = rows
            self._produced += rows
            self._rows_in_file += rows
            self._bytes_in_file += int(size)
            self._renumber(highest)
        self._last_committed_id = highest
        self._opened_before = True

    def _count_again(self, db: sqlite3.Connection) -> None:
        """After a failure: what was committed should still be there; what is not is lost, and counted."""
        until = (self._last_committed_id,)
        found = {row_id for (row_id,) in db.execute("SELECT id FROM outbox WHERE id <= ?", until)}
        with self._lock:
            missing = self._rows_in_file - len(found - self._gone.keys())
            if missing <= 0:
                return
            self._dropped[LOST_FILE] += missing
            self._rows_in_file -= missing
            self._bytes_in_file = 0 if not self._rows_in_file else self._bytes_in_file
            self._forget_delivery()
            self._rewind = self._delivering
        log.error("outbox: %d messages were lost with the damaged file", missing)

    @staticmethod
    def _highest_id(db: sqlite3.Connection) -> int:
        """Ids are never used twice, also not after a restart that found the outbox empty."""
        found = db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'outbox'").fetchone()
        return int(found[0]) if found else 0

    def _renumber(self, highest: int) -> None:
        """Rows put before the file could be opened come after those in it; none of them was ever in the file."""
        self._gone.clear()
        waiting = [row._replace(id=highest + 1 + i) for i, row in enumerate(self._handover.values())]
        self._handover = OrderedDict((row.id, row) for row in waiting)
        self._next_id = highest + 1 + len(waiting)
        self._in_flight.clear()

    def _connect(self) -> sqlite3.Connection:
        db = sqlite3.connect(self._path, isolation_level=None, timeout=1.0)
        try:
            # nobody else has business in this file, and a second daemon is found out at once
            db.execute("PRAGMA locking_mode = EXCLUSIVE")
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA journal_size_limit = 4194304")
            if self._check_file:
                found = db.execute("PRAGMA quick_check(1)").fetchone()[0]
                if found != "ok":
                    raise sqlite3.DatabaseError(found)
            version = db.execute("PRAGMA user_version").fetchone()[0]
            if version not in (0, SCHEMA_VERSION):
                raise sqlite3.DatabaseError(f"schema version {version}, this program writes {SCHEMA_VERSION}")
            db.execute("BEGIN IMMEDIATE")
            db.execute(
                "CREATE TABLE IF NOT EXISTS outbox (id INTEGER PRIMARY KEY AUTOINCREMENT, topic TEXT NOT NULL,"
                " seq INTEGER NOT NULL, created_s REAL NOT NULL, qos INTEGER NOT NULL, payload BLOB NOT NULL)"
            )
            db.execute("CREATE TABLE IF NOT EXISTS sequence (topic TEXT PRIMARY KEY, last INTEGER NOT NULL)")
            db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            db.execute("COMMIT")
            # a file with another table layout fails here, not in the middle of a commit
            db.execute("SELECT id, topic, seq, created_s, qos, payload FROM outbox LIMIT 1").fetchone()
        except BaseException:
            db.close()
            raise
        self._check_file = False
        return db

    def _set_aside(self, error: Exception) -> None:
        # the numbering should go on, if that much can still be read
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(self._path, timeout=0.1)) as db:
            for topic, last in db.execute("SELECT topic, last FROM sequence").fetchall():
                self._seq[str(topic)] = max(self._seq.get(str(topic), -1), int(last))
        aside = self._path.with_name(f"{self._path.name}.corrupt-{time.time_ns()}")
        for suffix in ("", "-wal", "-shm"):
            with contextlib.suppress(FileNotFoundError):
                Path(f"{self._path}{suffix}").replace(f"{aside}{suffix}")
        with self._lock:
            self._corrupt_files += 1
        log.error("outbox: %s is damaged (%s); set aside as %s, a new one is begun", self._path, error, aside.name)

    def _failed(self, error: Exception) -> None:
        """The disk refuses. Rows wait in memory; the file is opened anew at the next try."""
        with self._lock:
            first = self._storage_ok
            self._storage_ok = False
            self._storage_errors += 1
            self._storage_error = f"{type(error).__name__}: {error}"
        if first:
            log.error("outbox: cannot store (%s); messages wait in memory", error)
        if isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.OperationalError):
            self._check_file = True
        self._close()
        self._wake.set()

    def _close(self) -> None:
        if self._db is not None:
            with contextlib.suppress(sqlite3.Error):
                self._db.close()
            self._db = None
