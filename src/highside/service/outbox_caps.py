"""Why a message is dropped instead of sent, and which ones go when the file is beyond a cap: the oldest first."""

from __future__ import annotations

from collections.abc import Iterable

from highside.service import clock
from highside.service.outbox_log import StoredMessage
from highside.service.outbox_rows import age

NO_ROOM_IN_MEMORY = "memory"
TOO_MANY_ROWS = "max_rows"
TOO_MANY_BYTES = "max_bytes"
TOO_OLD = "max_age"
TOO_LARGE = "too_large"
"""The message alone is larger than `max_bytes`: were it kept, all older ones would go for it."""
LOST_FILE = "corrupt"


def beyond_caps(
    rows: Iterable[StoredMessage], now: clock.Moment, *, max_age_s: float, rows_over: int, bytes_over: int
) -> list[tuple[StoredMessage, str]]:
    """The messages to drop, each with its reason. `rows` are the oldest, in order; `*_over` what is stored beyond the
    caps (negative: what there is room for)."""
    dropped: list[tuple[StoredMessage, str]] = []
    for row in rows:
        age_s = age(row, now)
        if age_s is not None and age_s > max_age_s:
            reason = TOO_OLD
        elif rows_over > 0:
            reason = TOO_MANY_ROWS
        elif bytes_over > 0:
            reason = TOO_MANY_BYTES
        elif age_s is None:
            continue  # no clock can tell its age; those behind it may be too old
        else:
            break
        dropped.append((row, reason))
        rows_over -= 1
        bytes_over -= row.size
    return dropped
