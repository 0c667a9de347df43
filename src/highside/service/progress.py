"""Whether the pipeline moves: what the watchdog is fed by."""

from __future__ import annotations

import asyncio
import logging

from highside.service.notify import Notifier
from highside.service.outbox import Outbox

log = logging.getLogger("highside")

WEDGED_AFTER_S = 15.0
"""The outbox has not committed what it was given for so long: the pipeline counts as wedged."""


class Progress:
    """Whether the outbox takes what the pipeline makes. A disk that refuses is reported, it is not a wedged thread."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox

    def wedged_s(self) -> float:
        """Seconds for which messages have waited for a commit that did not come."""
        return self._outbox.overdue_s if self._outbox.stats.storage_ok else 0.0


async def feed_watchdog(notifier: Notifier, outbox: Outbox) -> None:
    """Tell systemd that the pipeline moves, as long as it does; never ends."""
    interval = notifier.watchdog_interval_s
    if interval is None:
        await asyncio.Event().wait()
        return
    progress = Progress(outbox)
    while True:
        if progress.wedged_s() < max(WEDGED_AFTER_S, interval / 2.0):
            notifier.watchdog()
        else:
            log.error("the outbox has committed nothing of what it was given for %.0f s", progress.wedged_s())
        await asyncio.sleep(interval / 4.0)
