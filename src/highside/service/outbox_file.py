"""The file of the outbox: messages that wait for the broker, in SQLite (write-ahead log, `synchronous=FULL`).

A transaction is on the disk when it returns. Pages are of 1 KiB, because a message is a third of that: a commit of one
message then writes 6.6 KB to the disk and not 22 (measured with 353 bytes of payload, ext4, /proc/PID/io). Each row has
a checksum, since a page that was damaged is not always found out by its structure.

A second process is refused by a lock on a file beside it; readers (`inspect`) are never in the way of the service.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

from highside.errors import InputError
from highside.service import clock
from highside.service.sequence import sync_directory

log = logging.getLogger(__name__)

SCHEMA_VERSION = 2
PAGE_BYTES = 1024
CHECKED_BYTES = 64 << 20
"""A file up to this size is checked as a whole when it is opened; what is damaged in a larger one is found when it is
read."""
BATCH_ROWS = 2_000
"""Rows in one transaction."""
BOOT_ID_LETTERS = 8
"""Of the boot id, kept with each row: two boots of one machine share them once in 4e9."""

_COLUMNS = "id, topic, seq, created_s, qos, payload, boot, boot_s, synced, checksum"


class Row(NamedTuple):
    """One message; `id` grows in the order of `put`."""

    id: int
    topic: str
    seq: int
    created_s: float
    qos: int
    payload: bytes
    boot_id: str
    """of the boot in which it was made, first letters; empty if not known"""
    boot_s: float
    """when it was made by the boot clock, which tells its age within that boot"""
    synced: bool
    """whether `created_s` can be believed"""
    put_mono: float = 0.0
    """when it was put, monotonic; not in the file"""

    @property
    def wall_s(self) -> float:
        return self.created_s

    @property
    def size(self) -> int:
        return len(self.payload) + len(self.topic)

    @property
    def checksum(self) -> int:
        return crc32(self.payload, crc32(b"%d" % self.seq, crc32(self.topic.encode("utf-8", errors="replace"))))


class Damaged(sqlite3.DatabaseError):
    """The file has to be set aside."""


class MessageFile:
    """Belongs to one thread; every method may raise sqlite3.Error or OSError when the disk refuses."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._db: sqlite3.Connection | None = None
        self._lock = -1
        self._check = True
        self.set_aside = 0
        """damaged files so far"""
        self.damaged_rows: list[int] = []
        """ids of rows whose checksum was wrong, to be deleted by the owner"""

    @property
    def is_open(self) -> bool:
        return self._db is not None

    def lock(self) -> None:
        """Keep others out. Raises InputError if another process has the file."""
        if self._lock >= 0:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(f"{self._path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            raise InputError(
                "is in use by another process", where=str(self._path), remedy="stop the other instance first"
            ) from None
        self._lock = descriptor

    def open(self) -> None:
        """Open, and bring a file of an older version up to date. A damaged one is set aside and what is readable in it
        taken over. Raises InputError if another process uses it."""
        self.lock()
        try:
            self._db = self._connect()
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                # an older version of this program, which locked the file itself
                raise InputError(
                    "is in use by another process", where=str(self._path), remedy="stop the other instance first"
                ) from error
            raise
        except sqlite3.DatabaseError as error:
            self._begin_anew(error)

    def distrust(self) -> None:
        """An operation found damage: the next `open` checks the whole file."""
        self._check = True

    def close(self) -> None:
        """Close the file; the lock is kept until `release`."""
        if self._db is not None:
            with contextlib.suppress(sqlite3.Error):
                self._db.close()
            self._db = None

    def release(self) -> None:
        self.close()
        if self._lock >= 0:
            with contextlib.suppress(OSError):
                os.close(self._lock)
            self._lock = -1

    # -- rows ------------------------------------------------------------------------------------------------------

    def change(self, batch: Sequence[Row], gone: Sequence[int]) -> None:
        """Store rows and delete others, in one transaction."""
        db = self._database()
        db.execute("BEGIN IMMEDIATE")
        try:
            # an earlier commit of the same rows may have failed after it reached the disk: hence OR IGNORE
            db.executemany(_INSERT, map(_values, batch))
            db.executemany("DELETE FROM outbox WHERE id = ?", [(row_id,) for row_id in gone])
            db.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                db.execute("ROLLBACK")
            raise

    def oldest(self, limit: int) -> Iterator[Row]:
        return self._select("ORDER BY id LIMIT ?", (limit,))

    def youngest(self, limit: int) -> Iterator[Row]:
        return self._select("ORDER BY id DESC LIMIT ?", (limit,))

    def between(self, after: int, before: int, limit: int) -> list[Row]:
        """Rows with `after < id < before`, in order."""
        return list(self._select("WHERE id > ? AND id < ? ORDER BY id LIMIT ?", (after, before, limit)))

    def count(self, until: int | None = None) -> tuple[int, int, int]:
        """Rows, bytes and the highest id, of all or of those up to an id."""
        where, values = ("", ()) if until is None else (" WHERE id <= ?", (until,))
        rows, size, last = self._database().execute(
            f"SELECT count(*), total(length(payload) + length(topic)), max(id) FROM outbox{where}", values
        ).fetchone()  # fmt: skip
        return int(rows), int(size), int(last or 0)

    def present(self, ids: Iterable[int]) -> list[int]:
        """Those of the ids that are in the file."""
        db = self._database()
        return [row_id for row_id in ids if db.execute("SELECT 1 FROM outbox WHERE id = ?", (row_id,)).fetchone()]

    def last_numbers(self) -> dict[str, int]:
        """The highest sequence number by topic of what is in the file, and of what an older version wrote down."""
        db = self._database()
        found = dict(db.execute("SELECT topic, max(seq) FROM outbox GROUP BY topic").fetchall())
        for topic, last in _old_numbers(db):
            found[topic] = max(found.get(topic, -1), last)
        return found

    def old_numbers(self) -> dict[str, int]:
        """What an older version of this program, which had no file of numbers, wrote down."""
        return _old_numbers_dict(self._database())

    def _select(self, clause: str, values: tuple[int, ...]) -> Iterator[Row]:
        # `clause` is a constant of this module
        for found in self._database().execute(f"SELECT {_COLUMNS} FROM outbox {clause}", values):
            row = _row(found)
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
            db.execute(f"PRAGMA page_size = {PAGE_BYTES}")
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA journal_size_limit = 4194304")
            if self._check and self._path.stat().st_size <= CHECKED_BYTES:
                found = db.execute("PRAGMA quick_check(1)").fetchone()[0]
                if found != "ok":
                    raise Damaged(found)
            self._bring_up_to_date(db)
            try:
                db.execute(f"SELECT {_COLUMNS} FROM outbox LIMIT 1").fetchone()
            except sqlite3.OperationalError as error:
                # a table of another layout fails here, not in the middle of a commit
                raise (Damaged(str(error)) if "column" in str(error) else error) from error
            if new:
                sync_directory(self._path.parent)
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
            raise Damaged(f"schema version {version}, this program writes {SCHEMA_VERSION}")
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
        for batch in _salvage(aside):
            self.change(batch, ())
            saved += len(batch)
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(aside, timeout=0.1)) as db:
            self._keep_old_numbers(_old_numbers_dict(db))
        log.error(
            "outbox: %s is damaged (%s); set aside as %s, a new one is begun with %d messages that could be read",
            self._path, " ".join(str(error).split()), aside.name, saved,
        )  # fmt: skip

    def _keep_old_numbers(self, numbers: dict[str, int]) -> None:
        if numbers:
            db = self._database()
            db.execute("CREATE TABLE IF NOT EXISTS sequence (topic TEXT PRIMARY KEY, last INTEGER NOT NULL)")
            db.executemany("INSERT OR REPLACE INTO sequence VALUES (?, ?)", numbers.items())


_INSERT = f"INSERT OR IGNORE INTO outbox ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


def _values(row: Row) -> tuple[object, ...]:
    return (*row[:8], int(row.synced), row.checksum)


def _row(found: tuple[object, ...]) -> Row | None:
    """A row as it was stored; None if it was damaged. Rows of an older version carry no checksum."""
    row_id, topic, seq, created_s, qos, payload, boot, boot_s, synced, checksum = found
    if not (
        isinstance(row_id, int) and isinstance(topic, str) and isinstance(seq, int) and isinstance(payload, bytes)
        and isinstance(created_s, float) and isinstance(qos, int)
    ):  # fmt: skip
        return None
    if checksum is None:
        return Row(row_id, topic, seq, created_s, qos, payload, "", 0.0, False)
    row = Row(row_id, topic, seq, created_s, qos, payload, str(boot), _real(boot_s), bool(synced))
    return row if row.checksum == checksum else None


def _real(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _old_numbers(db: sqlite3.Connection) -> list[tuple[str, int]]:
    if not db.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'sequence'").fetchone():
        return []
    return [(str(topic), int(last)) for topic, last in db.execute("SELECT topic, last FROM sequence")]


def _old_numbers_dict(db: sqlite3.Connection) -> dict[str, int]:
    return dict(_old_numbers(db))


def _salvage(path: Path) -> Iterator[list[Row]]:
    """Whole rows of a damaged file, in batches: from its beginning up to the damage, then from its end down to it."""
    with contextlib.closing(sqlite3.connect(path, timeout=0.1)) as db:
        last = 0
        for order in ("ASC", "DESC"):
            batch: list[Row] = []
            try:
                # a row without a checksum cannot be told from a damaged one
                query = f"SELECT {_COLUMNS} FROM outbox WHERE id > {last:d} ORDER BY id {order}"
                for found in db.execute(query):
                    row = _row(found)
                    if row is None or found[-1] is None:
                        continue
                    batch.append(row)
                    if order == "ASC":
                        last = row.id
                    if len(batch) == BATCH_ROWS:
                        yield batch
                        batch = []
            except sqlite3.Error:
                pass  # here it is damaged
            else:
                yield batch
                return
            yield batch


class OutboxState(NamedTuple):
    """What waits in an outbox."""

    queued: int
    oldest_s: float | None
    """wall time of the oldest, as its clock said"""
    oldest_age_s: float | None
    """None where no clock can tell"""
    in_use: bool
    """whether a service has it open"""


def inspect(path: Path) -> OutboxState:
    """Look into the outbox of a service, running or not, without being in its way: nothing is written or locked.

    Messages that the broker acknowledges within the commit interval are never in the file and not counted. Raises
    InputError where there is no outbox or it cannot be read.
    """
    if not path.is_file():
        raise InputError("no outbox: no service has run here yet", where=str(path))
    try:
        with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=2.0)) as db:
            queued = int(db.execute("SELECT count(*) FROM outbox").fetchone()[0])
            columns = _COLUMNS if db.execute("PRAGMA user_version").fetchone()[0] == SCHEMA_VERSION else "*"
            found = db.execute(f"SELECT {columns} FROM outbox ORDER BY id LIMIT 1").fetchone()
    except sqlite3.Error as error:
        raise InputError(
            f"cannot be read: {error}", where=str(path), remedy="the service sets a damaged file aside at its start"
        ) from None
    if found is None:
        return OutboxState(queued, None, None, _in_use(path))
    row = _row((*found, None, None, None, None)[:10])
    if row is None:
        raise InputError(
            "holds a damaged message", where=str(path), remedy="the service leaves it out when it comes to it"
        )
    return OutboxState(queued, row.created_s, age(row, clock.now()), _in_use(path))


def age(row: Row, now: clock.Moment) -> float | None:
    """Seconds since a message was made; None where no clock can tell."""
    return clock.age_s(row, now._replace(boot_id=now.boot_id[:BOOT_ID_LETTERS]))


def _in_use(path: Path) -> bool:
    """Whether the lock is held; told by the kernel's list, for to try it could keep a service out that is starting."""
    try:
        status = Path(f"{path}.lock").stat()
        held = Path("/proc/locks").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    device = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    return any(device in line.split() for line in held.splitlines())
