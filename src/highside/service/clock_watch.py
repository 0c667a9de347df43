"""The clocks while the service runs: followed a reference, was set, and what day it surely is."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from pathlib import Path

from highside.service import clock
from highside.service.clock import StepWatch, clock_synced
from highside.service.known_time import KnownTime, Present

log = logging.getLogger("highside")

CHECK_S = 10.0
"""Between two questions to the kernel whether the wall clock follows a reference."""
STEP_CHECK_S = 1.0
"""Between two looks whether the wall clock was set."""


class ClockWatch:
    """Of one state directory."""

    def __init__(self, directory: Path) -> None:
        self.synced = clock_synced()
        """whether the wall clock followed a reference when last checked"""
        self.steps = StepWatch()
        # a start may wait for its link: a clock that is set meanwhile was set, too
        self.steps.look()
        self._known = KnownTime(directory)

    def present(self) -> Present:
        """The time that is known, by which a calibration is judged."""
        now = clock.now(synced=self.synced)
        self._known.look(now)
        return self._known.present(now)

    def keep(self) -> None:
        """Write down the last moment that was known; from a thread."""
        self._known.keep()

    async def run(self, checked: Callable[[], None], stepped: Callable[[], None]) -> None:
        """Look for ever: `checked` is called after each check, `stepped` when the wall clock was set."""
        last_check = 0.0
        while True:
            step_s, now = self.steps.look(), time.monotonic()
            if step_s is not None or now - last_check >= CHECK_S:
                self.synced, last_check = clock_synced(), now
                checked()
                if self._known.to_be_kept:
                    await asyncio.to_thread(self._known.keep)
            if step_s is not None:
                log.warning("the wall clock was set %s by %.1f s", "forward" if step_s > 0.0 else "back", abs(step_s))
                stepped()
            await asyncio.sleep(STEP_CHECK_S)
