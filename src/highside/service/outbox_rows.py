"""Rows of the outbox's SQLite file: their columns, their checksums, and what can still be read of a damaged file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator

from highside.service import clock
from highside.service.outbox_log import BOOT_ID_LETTERS, StoredMessage

BATCH_ROWS = 2_000
"""Rows in one transaction."""
COLUMNS = "id, topic, seq, created_s, qos, payload, boot, boot_s, synced, checksum"
INSERT = f"INSERT OR IGNORE INTO outbox ({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


def values(row: StoredMessage) -> tuple[object, ...]:
    return (*row[:8], int(row.synced), row.checksum)


def stored_row(found: tuple[object, ...]) -> StoredMessage | None:
    """A row as it was stored; None if it was damaged. Rows of an older version carry no checksum."""
    row_id, topic, seq, created_s, qos, payload, boot, boot_s, synced, checksum = found
    if not (
        isinstance(row_id, int)
        and isinstance(topic, str)
        and isinstance(seq, int)
        and isinstance(payload, bytes)
        and isinstance(created_s, float)
        and isinstance(qos, int)
    ):
        return None
    if checksum is None:
        return StoredMessage(row_id, topic, seq, created_s, qos, payload, "", 0.0, False)
    row = StoredMessage(row_id, topic, seq, created_s, qos, payload, str(boot), _real(boot_s), bool(synced))
    return row if row.checksum == checksum else None


def _real(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def salvage(db: sqlite3.Connection, *, unchecked: bool = False) -> Iterator[list[StoredMessage]]:
    """Whole rows of a damaged file, in batches: from its beginning up to the damage, then from its end down to it.

    `unchecked`: also those of an older version, whose damage nothing would show.
    """
    last = 0
    for order in ("ASC", "DESC"):
        batch: list[StoredMessage] = []
        try:
            query = f"SELECT {COLUMNS} FROM outbox WHERE id > {last:d} ORDER BY id {order}"
            for found in db.execute(query):
                row = stored_row(found)
                if row is None or (found[-1] is None and not unchecked):
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


def age(row: StoredMessage, now: clock.Moment) -> float | None:
    """Seconds since a message was made; None where no clock can tell."""
    return clock.age_s(row, now._replace(boot_id=now.boot_id[:BOOT_ID_LETTERS]))


def old_numbers(db: sqlite3.Connection) -> dict[str, int]:
    """The last sequence number by topic, which an older version kept in this file."""
    if not db.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'sequence'").fetchone():
        return {}
    return {str(topic): int(last) for topic, last in db.execute("SELECT topic, last FROM sequence")}
