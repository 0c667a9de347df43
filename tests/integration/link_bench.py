"""What the tests of links share: a sink that remembers, and a pty that is unplugged and plugged in again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from highside.codec.frame import CanFrame
from highside.link.base import Batch, Chunk, LinkReason, LinkState, LinkSupervisor, SupervisorSettings, Transport

QUICK = SupervisorSettings(backoff_initial_s=0.05, backoff_max_s=0.5, stale_after_s=1.8, reopen_after_s=9.5)


class Memory:
    """A sink that keeps everything with its time."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.frames: list[CanFrame] = []
        self.batches = 0
        self.last_data = 0.0
        self.states: list[tuple[float, LinkState, LinkReason | None, str]] = []

    def on_batch(self, batch: Batch) -> None:
        self.batches += 1
        self.last_data = time.monotonic()
        if isinstance(batch, Chunk):
            self.data += batch.data
        else:
            self.frames += batch

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        self.states.append((time.monotonic(), state, reason, message))

    @property
    def state(self) -> LinkState:
        return self.states[-1][1] if self.states else LinkState.CONNECTING

    @property
    def reason(self) -> LinkReason | None:
        return self.states[-1][2] if self.states else None


async def until(condition: Callable[[], bool], timeout_s: float = 10.0, what: str = "", poll_s: float = 0.002) -> float:
    """Wait for something and say how long it took."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > timeout_s:
            raise AssertionError(f"did not happen within {timeout_s} s: {what}")
        await asyncio.sleep(poll_s)
    return time.monotonic() - start


@asynccontextmanager
async def supervised(
    factory: Callable[[], Transport], memory: Memory, settings: SupervisorSettings = QUICK
) -> AsyncIterator[LinkSupervisor]:
    """A running supervisor; its end is waited for and what it raised is raised."""
    supervisor = LinkSupervisor(factory, memory, settings)
    task = asyncio.create_task(supervisor.run())
    try:
        yield supervisor
    finally:
        task.cancel()
        await asyncio.wait({task})
        if not task.cancelled():
            task.result()
