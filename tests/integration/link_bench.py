"""What the tests of links share: a sink that remembers, and a pty that is unplugged and plugged in again."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

import can

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.link.base import Batch, Chunk, LinkReason, LinkState, LinkSupervisor, SupervisorSettings, Transport
from highside.link.pythoncan import PythonCanSettings, open_bus

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


class PythonCanWire:
    """The device's side of a bus of python-can, for instance of its `virtual` one."""

    def __init__(self, settings: PythonCanSettings) -> None:
        self._settings = settings
        self._bus: can.BusABC | None = None
        self.unheard = 0

    pending = 0
    unread = False

    def flush(self) -> None:
        """Nothing is ever pending."""

    @property
    def address(self) -> str:
        return f"{self._settings.interface}:{self._settings.channel}"

    def plug(self) -> None:
        if self._bus is None:
            self._bus = open_bus(self._settings)

    def unplug(self) -> None:
        if self._bus is not None:
            with contextlib.suppress(can.CanError, OSError):
                self._bus.shutdown()
        self._bus = None

    def remove(self) -> None:
        self.unplug()

    @property
    def listened_to(self) -> bool:
        return self._bus is not None

    def write(self, data: bytes) -> None:
        raise InputError("bytes cannot be written to a CAN bus", remedy="use --to pty")

    def write_frames(self, frames: Sequence[CanFrame]) -> None:
        if self._bus is None:
            self.unheard += len(frames)
            return
        for frame in frames:
            message = can.Message(
                arbitration_id=frame.can_id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                is_fd=frame.fd,
            )
            try:
                self._bus.send(message)
            except (can.CanError, OSError):
                self.unheard += 1
