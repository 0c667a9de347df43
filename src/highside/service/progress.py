"""Whether the pipeline moves: what the watchdog is fed by."""

from __future__ import annotations

from highside.service.outbox import Outbox


class Progress:
    """Whether the outbox takes what the pipeline makes. A disk that refuses is reported, it is not a wedged thread."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox

    def wedged_s(self) -> float:
        """Seconds for which messages have waited for a commit that did not come."""
        return self._outbox.overdue_s if self._outbox.stats.storage_ok else 0.0
