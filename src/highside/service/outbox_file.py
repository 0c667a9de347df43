"""The file of the outbox: messages that wait for the broker, in a log of commits and in SQLite behind it.

A commit of a few messages is appended to the log (`outbox_log`); when that is full, at an orderly end and with a large
commit the messages move to SQLite (`synchronous=FULL`) in one transaction, which also says up to which generation of
the log it has taken. A move appends to the database under a rollback journal, so that its pages are written once; where
a reader is in the way, and for deletions, it is the write-ahead log. What is in the log has the younger ids, and is
kept in memory too. Either way `change` returns when it is on the disk.

Measured with 353 bytes of payload and a commit for each message (ext4, /proc/PID/io): SQLite alone wrote 22 KB a
message with pages of 4 KiB, 6.6 KB with pages of 1 KiB. Each row has a checksum, since a page that was damaged is not
always found out by its structure.

A second process is refused by a lock on a file beside it; readers (`inspect`) are never in the way of the service.

Files that are deleted or replaced while in use are noticed (`moved`). What they hold can still be read, being open, and
is taken over into new ones (`leave`, then `open`); what was put in their place is set aside.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

from highside.errors import InputError
from highside.recording.files import make_directory
from highside.recording.locks import lock
from highside.service.outbox_log import CommitLog, LogFull, StoredMessage, read_log
from highside.service.outbox_places import Places
from highside.service.outbox_rows import COLUMNS, INSERT, old_numbers, salvage, stored_row, values
from highside.service.sequence import sync_directory

log = logging.getLogger(__name__)

SCHEMA_VERSION = 2
LARGE_COMMIT = 64 * 1024
"""Bytes from which a commit goes to SQLite at once: the log would write it once more than needed."""
CHECKED_BYTES = 64 << 20
"""A file up to this size is checked as a whole when it is opened; damage in a larger one is found when it is read."""


class DamagedDatabase(sqlite3.DatabaseError):
    """The file has to be set aside."""


class MessageFile:
    """Belongs to one thread; every method may raise sqlite3.Error or OSError when the disk refuses."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._db: sqlite3.Connection | None = None
        self._left: sqlite3.Connection | None = None
        """a file that was open when it was deleted or replaced, until what it holds is in a new one"""
        self._places = Places()
        self._wal, self._log_path = path.with_name(path.name + "-wal"), log_path(path)
        self._lock_path = path.with_name(path.name + ".lock")
        self._has_room = True
        """False: something else may stand where our file was"""
        self._lock = -1
        self._check = True
        self._log = CommitLog(self._log_path)
        self._tail: dict[int, StoredMessage] | None = None
        """what is in the log; None before it was read"""
        self._log_ready = False
        """whether the log may be appended to: not before what an earlier process left in it, or what a refused write
        may have left, is in SQLite"""
        self.set_aside = 0
        """damaged files so far"""
        self.renewed = 0
        """times that a file was begun in the place of one that had been in use"""
        self.damaged_rows: list[int] = []
        """ids of rows whose checksum was wrong, to be deleted by the owner"""

    @property
    def is_open(self) -> bool:
        return self._db is not None

    def lock(self) -> None:
        """Keep others out. Raises InputError if another process has the file."""
        if self._lock >= 0:
            return
        make_directory(self._path.parent)
        descriptor = os.open(self._lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        try:
            lock(descriptor)
        except OSError:
            os.close(descriptor)
            raise _in_use(self._path) from None
        self._lock = descriptor
        self._places.note(self._lock_path, descriptor)

    # -- files that are deleted or replaced ------------------------------------------------------------------------

    def moved(self) -> bool:
        """Whether a file in use is not at its place any more."""
        return any(self._places.moved(path) for path in (self._lock_path, self._path, self._wal, self._log_path))

    def leave(self) -> None:
        """Let go of what was moved; `lock` and `open` begin anew, with all that can be read in what was left."""
        if self._places.moved(self._lock_path):
            os.close(self._lock)
            self._lock = -1
            self._places.forget(self._lock_path)
        if self._places.moved(self._log_path):
            self._close_log()  # what it holds is in memory
        if not (self._places.moved(self._path) or self._places.moved(self._wal)):
            return
        if self._db is not None and self._left is not None:
            self._db.close()  # not finished yet: the one before still has everything
        elif self._db is not None:
            self._left = self._db
        self._db, self._has_room = None, False
        self._close_log()
        self._places.forget(self._path, self._wal)

    def _make_room(self) -> None:
        """What stands in the place of a file that was in use is another's: set aside, never mixed with ours."""
        if self._has_room:
            return
        aside = f"{self._path}.other-{time.time_ns()}"
        found = [suffix for suffix in ("", "-wal", "-shm", ".log") if Path(f"{self._path}{suffix}").exists()]
        for suffix in found:
            Path(f"{self._path}{suffix}").replace(f"{aside}{suffix}")
        if found:
            log.error("outbox: what was found at %s is set aside as %s", self._path, aside)
        self._has_room = True
        self.renewed += 1

    def _take_over(self) -> None:
        """What the file that was left holds, and what is only in memory, into this one."""
        if self._left is not None:
            for batch in salvage(self._left, unchecked=True):
                self._in_one_transaction(batch, ())
            with contextlib.suppress(sqlite3.Error):
                self._left.close()
            self._left = None
        if self._tail:
            self._move((), ())

    def keep(self, rows: Iterable[StoredMessage]) -> None:
        """Store rows that were in a file before, where they are not."""
        self._in_one_transaction([row for row in rows if row.id not in self._rows_in_log], ())

    def open(self) -> None:
        """Open, and bring a file of an older version up to date. A damaged one is set aside and what is readable in it
        taken over. Raises InputError if another process uses it."""
        self.lock()
        if self._places.moved(self._path):
            self.leave()  # it was closed when that happened
        renewed = not self._has_room or self._left is not None
        self._make_room()
        try:
            self._db = self._connect()
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                # an older version of this program, which locked the file itself
                raise _in_use(self._path) from error
            raise
        except sqlite3.DatabaseError as error:
            self._begin_anew(error)
        try:
            self._open_log()
            if renewed:
                self._take_over()
        except BaseException:
            self.close()
            raise

    def _open_log(self) -> None:
        db = self._database()
        db.execute(_LOG_TABLE)
        moved = moved_generation(db)
        if self._tail is None:
            generation, rows = read_log(self._log_path)
            # a damaged file may have lost the word of what it had taken: what has moved has no younger id than SQLite
            last = int(db.execute("SELECT max(id) FROM outbox").fetchone()[0] or 0)
            self._tail = {row_id: row for row_id, row in rows.items() if row_id > last} if generation > moved else {}
            self._log.generation = max(generation, moved)
        if not self._tail:
            self._begin_log()

    def _begin_log(self) -> None:
        self._places.note(self._log_path, self._log.begin(self._log.generation + 1))
        self._log_ready = True

    def distrust(self) -> None:
        """An operation found damage: the next `open` checks the whole file."""
        self._check = True

    def close(self) -> None:
        """Close the files; the lock is kept until `release`."""
        self._close_log()
        if self._db is not None:
            with contextlib.suppress(sqlite3.Error):
                self._db.close()
            self._db = None
        self._places.forget(self._wal)  # SQLite deletes it itself

    def _close_log(self) -> None:
        self._log.close()
        self._log_ready = False
        self._places.forget(self._log_path)

    def release(self) -> None:
        """The orderly end: all messages are in SQLite, if it takes them."""
        if self._db is not None and self._tail:
            with contextlib.suppress(sqlite3.Error, OSError):
                self._move((), ())
        self.close()
        if self._lock >= 0:
            with contextlib.suppress(OSError):
                os.close(self._lock)
            self._lock = -1

    # -- rows ------------------------------------------------------------------------------------------------------

    def change(self, batch: Sequence[StoredMessage], gone: Sequence[int]) -> None:
        """Store rows and delete others. After a fault some of it may be done; it can be requested again."""
        tail = self._rows_in_log
        left = [row_id for row_id in gone if row_id not in tail]
        large = sum(row.size for row in batch) > LARGE_COMMIT
        if not self._log_ready or large:
            self._move(batch, gone)
            return
        if left:
            # first, for it can be repeated: what is deleted there is not in the log
            self._in_one_transaction((), left)
        from_log = [row_id for row_id in gone if row_id in tail]
        if not batch and not from_log:
            return
        try:
            self._log.append(batch, from_log)
        except LogFull:
            self._move(batch, from_log)
            return
        except BaseException:
            self._log_ready = False  # who knows how much of it is there
            raise
        for row_id in from_log:
            del tail[row_id]
        tail.update((row.id, row) for row in batch)
        if not tail:
            self._begin_log()

    def _move(self, batch: Sequence[StoredMessage], gone: Sequence[int]) -> None:
        """Everything into SQLite; the log begins anew."""
        db, tail = self._database(), self._rows_in_log
        rows = [row for row in tail.values() if row.id not in set(gone)] if gone else list(tail.values())
        with contextlib.suppress(sqlite3.OperationalError):
            db.execute("PRAGMA journal_mode = TRUNCATE")  # refused while somebody reads
        try:
            self._in_one_transaction([*rows, *batch], gone, moved=self._log.generation)
        finally:
            with contextlib.suppress(sqlite3.OperationalError):
                db.execute("PRAGMA journal_mode = WAL")
                db.execute("SELECT moved FROM log").fetchone()  # begins the file of that journal
            self._places.note_if_there(self._wal)
        tail.clear()
        self._begin_log()

    def _in_one_transaction(
        self, batch: Sequence[StoredMessage], gone: Sequence[int], moved: int | None = None
    ) -> None:
        db = self._database()
        db.execute("BEGIN IMMEDIATE")
        try:
            # an earlier commit of the same rows may have failed after it reached the disk: hence OR IGNORE
            db.executemany(INSERT, map(values, batch))
            db.executemany("DELETE FROM outbox WHERE id = ?", [(row_id,) for row_id in gone])
            if moved is not None:
                db.execute("INSERT OR REPLACE INTO log VALUES (0, ?)", (moved,))
            db.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                db.execute("ROLLBACK")
            raise

    @property
    def _rows_in_log(self) -> dict[int, StoredMessage]:
        assert self._tail is not None
        return self._tail

    def oldest(self, limit: int) -> Iterator[StoredMessage]:
        return islice(chain(self._select("ORDER BY id LIMIT ?", (limit,)), self._rows_in_log.values()), limit)

    def youngest(self, limit: int) -> Iterator[StoredMessage]:
        stored = self._select("ORDER BY id DESC LIMIT ?", (limit,))
        return islice(chain(reversed(self._rows_in_log.values()), stored), limit)

    def between(self, after: int, before: int, limit: int) -> list[StoredMessage]:
        """Rows with `after < id < before`, in order."""
        rows = list(self._select("WHERE id > ? AND id < ? ORDER BY id LIMIT ?", (after, before, limit)))
        if len(rows) < limit and self._rows_in_log:
            late = (row for row in self._rows_in_log.values() if after < row.id < before)
            rows.extend(islice(late, limit - len(rows)))
        return rows

    def larger_than(self, size: int) -> list[StoredMessage]:
        """Rows that alone have more bytes."""
        stored = self._select("WHERE length(payload) + length(topic) > ? ORDER BY id", (size,))
        return [*stored, *(row for row in self._rows_in_log.values() if row.size > size)]

    def count(self, until: int | None = None) -> tuple[int, int, int]:
        """Rows, bytes and the highest id, of all or of those up to an id."""
        where, values = ("", ()) if until is None else (" WHERE id <= ?", (until,))
        rows, size, last = (
            self._database()
            .execute(f"SELECT count(*), total(length(payload) + length(topic)), max(id) FROM outbox{where}", values)
            .fetchone()
        )
        late = [row for row in self._rows_in_log.values() if until is None or row.id <= until]
        highest = late[-1].id if late else int(last or 0)
        return int(rows) + len(late), int(size) + sum(row.size for row in late), highest

    def present(self, ids: Iterable[int]) -> list[int]:
        """Those of the ids that are in the file."""
        db, tail = self._database(), self._rows_in_log
        query = "SELECT 1 FROM outbox WHERE id = ?"
        return [row_id for row_id in ids if row_id in tail or db.execute(query, (row_id,)).fetchone()]

    def last_numbers(self) -> dict[str, int]:
        """The highest sequence number by topic of what is in the file, and of what an older version wrote down."""
        db = self._database()
        found = dict(db.execute("SELECT topic, max(seq) FROM outbox GROUP BY topic").fetchall())
        for topic, last in old_numbers(db).items():
            found[topic] = max(found.get(topic, -1), last)
        for row in self._rows_in_log.values():
            found[row.topic] = max(found.get(row.topic, -1), row.seq)
        return found

    def _select(self, clause: str, values: tuple[int, ...]) -> Iterator[StoredMessage]:
        # `clause` is a constant of this module
        for found in self._database().execute(f"SELECT {COLUMNS} FROM outbox {clause}", values):
            row = stored_row(found)
            if row is None:
                self.damaged_rows.append(found[0])
            else:
                yield row

    def _database(self) -> sqlite3.Connection:
        assert self._db is not None
        return self._db

    # -- opening ---------------------------------------------------------------------------------------------------

    def _connect(self) -> sqlite3.Connection:
        new = not self._path.exists()
        db = sqlite3.connect(self._path, isolation_level=None, timeout=1.0)
        try:
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA journal_size_limit = 4194304")
            if self._check and self._path.stat().st_size <= CHECKED_BYTES:
                found = db.execute("PRAGMA quick_check(1)").fetchone()[0]
                if found != "ok":
                    raise DamagedDatabase(found)
            self._bring_up_to_date(db)
            try:
                db.execute(f"SELECT {COLUMNS} FROM outbox LIMIT 1").fetchone()
            except sqlite3.OperationalError as error:
                # a table of another layout fails here, not in the middle of a commit
                raise (DamagedDatabase(str(error)) if "column" in str(error) else error) from error
            if new:
                sync_directory(self._path.parent)
            self._places.note(self._path)
            self._places.note_if_there(self._wal)
        except BaseException:
            db.close()
            raise
        self._check = False
        return db

    @staticmethod
    def _bring_up_to_date(db: sqlite3.Connection) -> None:
        version = db.execute("PRAGMA user_version").fetchone()[0]
        if version == SCHEMA_VERSION:
            return
        if version not in (0, 1):
            raise DamagedDatabase(f"schema version {version}, this program writes {SCHEMA_VERSION}")
        db.execute("BEGIN IMMEDIATE")
        if version == 1:
            # the rows stay where they are; of their clock nothing is known
            for column in ("boot TEXT", "boot_s REAL", "synced INTEGER", "checksum INTEGER"):
                db.execute(f"ALTER TABLE outbox ADD COLUMN {column}")
        else:
            db.execute(
                "CREATE TABLE IF NOT EXISTS outbox (id INTEGER PRIMARY KEY, topic TEXT NOT NULL, seq INTEGER NOT NULL,"
                " created_s REAL NOT NULL, qos INTEGER NOT NULL, payload BLOB NOT NULL, boot TEXT, boot_s REAL,"
                " synced INTEGER, checksum INTEGER)"
            )
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        db.execute("COMMIT")

    def _begin_anew(self, error: Exception) -> None:
        """Set the damaged file aside, begin a new one, and take over the rows that can be read and are whole."""
        aside = self._path.with_name(f"{self._path.name}.corrupt-{time.time_ns()}")
        for suffix in ("", "-wal", "-shm"):
            with contextlib.suppress(FileNotFoundError):
                Path(f"{self._path}{suffix}").replace(f"{aside}{suffix}")
        self.set_aside += 1
        self._db = self._connect()
        saved = 0
        with contextlib.closing(sqlite3.connect(aside, timeout=0.1)) as db:
            for batch in salvage(db):
                self._in_one_transaction(batch, ())
                saved += len(batch)
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(aside, timeout=0.1)) as db:
            self._keep_old_numbers(old_numbers(db))
            moved = moved_generation(db)
            self._database().execute(_LOG_TABLE)
            self._database().execute("INSERT OR REPLACE INTO log VALUES (0, ?)", (moved,))
        log.error(
            "outbox: %s is damaged (%s); set aside as %s, a new one is begun with %d messages that could be read",
            self._path,
            " ".join(str(error).split()),
            aside.name,
            saved,
        )

    def _keep_old_numbers(self, numbers: dict[str, int]) -> None:
        if numbers:
            db = self._database()
            db.execute("CREATE TABLE IF NOT EXISTS sequence (topic TEXT PRIMARY KEY, last INTEGER NOT NULL)")
            db.executemany("INSERT OR REPLACE INTO sequence VALUES (?, ?)", numbers.items())


def _in_use(path: Path) -> InputError:
    return InputError("is in use by another process", where=str(path), remedy="stop the other instance first")


_LOG_TABLE = "CREATE TABLE IF NOT EXISTS log (only INTEGER PRIMARY KEY CHECK (only = 0), moved INTEGER NOT NULL)"
"""Its one row: the newest generation of the log that is in SQLite."""


def log_path(path: Path) -> Path:
    """Where the log of commits of the outbox at `path` is."""
    return path.with_name(path.name + ".log")


def moved_generation(db: sqlite3.Connection) -> int:
    """The newest generation of the log that is in SQLite."""
    if not db.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'log'").fetchone():
        return 0
    found = db.execute("SELECT moved FROM log").fetchone()
    return int(found[0]) if found else 0
