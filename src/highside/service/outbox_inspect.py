"""A look into the outbox of a service, running or not, without being in its way."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from pathlib import Path
from typing import NamedTuple

from highside.errors import InputError
from highside.service import clock
from highside.service.outbox_file import SCHEMA_VERSION, log_path, moved_generation
from highside.service.outbox_log import read_log
from highside.service.outbox_rows import COLUMNS, age, stored_row


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
        # the log first: what moves meanwhile is in SQLite then, which says so
        generation, late = read_log(log_path(path))
        with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=2.0)) as db:
            if generation <= moved_generation(db):
                late = {}
            queued = int(db.execute("SELECT count(*) FROM outbox").fetchone()[0])
            columns = COLUMNS if db.execute("PRAGMA user_version").fetchone()[0] == SCHEMA_VERSION else "*"
            found = db.execute(f"SELECT {columns} FROM outbox ORDER BY id LIMIT 1").fetchone()
    except (sqlite3.Error, OSError) as error:
        raise InputError(
            f"cannot be read: {error}", where=str(path), remedy="the service sets a damaged file aside at its start"
        ) from None
    queued += len(late)
    if found is None:
        if not late:
            return OutboxState(queued, None, None, _in_use(path))
        oldest = next(iter(late.values()))
        return OutboxState(queued, oldest.created_s, age(oldest, clock.now()), _in_use(path))
    row = stored_row((*found, None, None, None, None)[:10])
    if row is None:
        raise InputError(
            "holds a damaged message", where=str(path), remedy="the service leaves it out when it comes to it"
        )
    return OutboxState(queued, row.created_s, age(row, clock.now()), _in_use(path))


def _in_use(path: Path) -> bool:
    """Whether the lock is held; told by the kernel's list, for to try it could keep a service out that is starting."""
    try:
        status = Path(f"{path}.lock").stat()
        held = Path("/proc/locks").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    device = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    return any(device in line.split() for line in held.splitlines())
