"""What a link is: batches of wire data in, states with reasons out, and one owner of re-connection.

A `Transport` is one attempt: it opens, delivers what arrives, says why it ended, closes. It never tries again.
The `LinkSupervisor` is the only place that does: it opens a fresh transport, watches for silence, waits with back-off
and jitter, and tells the `Sink` (the service) what the state is. Two owners that race are how such daemons die.

States: CONNECTING (not open yet, or open and no data so far), UP (data arrives), STALE (open, but silent), DOWN (failed
or given up for silence; a re-open is due), ENDED (a replay is over). The watchdog knows only data: a link that is open
and says nothing is re-opened as if it had failed.

Times: `t_mono` is the monotonic clock at which the bytes were read, `t_wall` the epoch time of the same moment.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol, Self

from pydantic import Field, model_validator

from highside.codec.frame import CanFrame
from highside.errors import HighsideError
from highside.reading.config_table import ConfigTable

LOOK_LEAST_S = 0.01
"""Seconds between two looks at a silent link, or two attempts to open one, whatever was configured: less would be the
processor's whole time."""


class LinkState(Enum):
    """How a link is."""

    CONNECTING = "connecting"
    """Being opened, or open and nothing has arrived yet."""
    UP = "up"
    """Data arrives."""
    STALE = "stale"
    """Open, but nothing has arrived for a while."""
    DOWN = "down"
    """Not open; it is tried again by itself."""
    ENDED = "ended"
    """A replay has come to its end; nothing more will arrive."""


class LinkReason(Enum):
    """Why a link is not up; each member's text is for the person at the bench."""

    NOT_FOUND = "not_found"
    """No such device: is it plugged in and powered, and is the name right?"""
    NO_PERMISSION = "no_permission"
    """This user may not open the device: add the user to its group (dialout), or give the service access to it."""
    BUSY = "busy"
    """Another program has the device open: close it first."""
    END_OF_FILE = "end_of_file"
    """The device went away while open: unplugged, powered off, or its USB hub was reset."""
    SILENT = "silent"
    """The device is open but sends nothing: is the tool powered, and are baud rate and wiring right?"""
    IO_ERROR = "io_error"
    """The operating system reported an error while reading: look at the cable and the adapter."""
    INTERFACE_DOWN = "interface_down"
    """The CAN interface exists but is down: bring it up (ip link set can0 up type can bitrate ...)."""
    INTERFACE_GONE = "interface_gone"
    """The CAN interface was removed: is the adapter plugged in?"""
    BUS_OFF = "bus_off"
    """The CAN controller left the bus after too many errors: check bit rate, wiring and termination."""
    REMOTE_CLOSED = "remote_closed"
    """The other end of the network connection closed it: is the terminal server in use by somebody else?"""
    CONFIG = "config"
    """The link cannot be opened as it is configured: correct the [link] table."""
    FINISHED = "finished"
    """The recording has been played to its end."""


class LinkError(HighsideError):
    """A link could not be opened, or has ended: `reason` for programs, `message` for people."""

    exit_status = 2

    def __init__(self, reason: LinkReason, message: str) -> None:
        self.reason = reason
        self.message = " ".join(message.split())
        super().__init__(self.message)
        self.code = f"link.{reason.value}"


class Chunk(NamedTuple):
    """Bytes as they were read."""

    t_mono: float
    t_wall: float
    data: bytes


Batch = Chunk | list[CanFrame]
Deliver = Callable[[Batch], None]


class Sink(Protocol):
    """Who takes what a link brings. Both calls are made in the event loop and must be quick."""

    def on_batch(self, batch: Batch) -> None: ...

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None: ...


class Transport(Protocol):
    """One attempt at a link; used once."""

    @property
    def kernel_drops(self) -> int:
        """Frames that the kernel threw away since `open` because nobody read them in time (0 where it cannot tell)."""

    async def open(self, deliver: Deliver) -> None:
        """Open; from now on call `deliver` in the loop with whatever arrives. Raises LinkError."""

    async def wait_closed(self) -> LinkError:
        """Wait until the transport has failed or ended, and say why."""

    async def wait_ready(self) -> None:
        """After a failure: return as soon as another attempt is promising (the device is back). May wait for ever."""

    async def close(self) -> None:
        """Give everything back; may be called in any state, more than once. Nothing is delivered afterwards."""


class Clock(Protocol):
    """The time, so that tests need not wait for it."""

    def monotonic(self) -> float: ...

    def wall(self) -> float: ...

    async def sleep(self, seconds: float) -> None: ...


class SystemClock:
    """The machine's own clocks and the event loop's sleep."""

    def monotonic(self) -> float:
        return time.monotonic()

    def wall(self) -> float:
        return time.time()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(max(0.0, seconds))


class SupervisorSettings(ConfigTable):
    """When to try again and when to call a silent link stale.

    The pause before an attempt is `backoff_initial_s`, doubled for each earlier attempt that brought no data, at most
    `backoff_max_s`, spread by +-`jitter` (a fraction) so that many tools do not connect to one server together. A
    device that comes back is opened at once, whatever the pause. Silence is watched unless `stale_after_s` is 0.
    """

    backoff_initial_s: float = Field(default=0.1, gt=0, le=60, description="Pause before the first new attempt.")
    backoff_max_s: float = Field(default=5.0, gt=0, le=3600, description="Longest pause between two attempts.")
    jitter: float = Field(
        default=0.2, ge=0, le=1, description="Random share of each pause, so that tools do not all connect at once."
    )
    stale_after_s: float = Field(
        default=1.8, ge=0, description="Silence after which the link is called stale; 0: never."
    )
    reopen_after_s: float = Field(
        default=9.5, gt=0, description="Silence after which the link is closed and opened anew."
    )

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.backoff_max_s < self.backoff_initial_s:
            raise ValueError("backoff_max_s must not be less than backoff_initial_s")
        if self.reopen_after_s < self.stale_after_s:
            raise ValueError("reopen_after_s must not be less than stale_after_s")
        return self


@dataclass(slots=True)
class LinkStats:
    """What has happened on a link since its supervisor started."""

    state: LinkState = LinkState.CONNECTING
    reason: LinkReason | None = None
    message: str = ""
    opens: int = 0
    failures: dict[LinkReason, int] = field(default_factory=dict)
    bytes: int = 0
    """bytes of a stream, or payload bytes of CAN frames"""
    batches: int = 0
    can_frames: int = 0
    error_frames: int = 0
    """CAN error frames (reported by the controller, not sent by a node); not in `can_frames`"""
    kernel_drops: int = 0
    last_data_mono: float | None = None

    def as_dict(self) -> dict[str, object]:
        """For the health message."""
        return {
            "state": self.state.value,
            "reason": self.reason.value if self.reason else None,
            "message": self.message,
            "opens": self.opens,
            "failures": {reason.value: count for reason, count in self.failures.items()},
            "bytes": self.bytes,
            "batches": self.batches,
            "can_frames": self.can_frames,
            "error_frames": self.error_frames,
            "kernel_drops": self.kernel_drops,
        }


class LinkSupervisor:
    """Keeps one link open: the only owner of re-connection.

    `transport_factory` makes a fresh transport for every attempt. `run` returns when the transport says FINISHED (a
    replay), raises what the sink raises, and ends on cancellation; in every case the transport is closed.
    """

    def __init__(
        self,
        transport_factory: Callable[[], Transport],
        sink: Sink,
        settings: SupervisorSettings | None = None,
        clock: Clock | None = None,
        rng: random.Random | None = None,
    ) -> None:
        self._factory = transport_factory
        self._sink = sink
        self._settings = settings or SupervisorSettings()
        self._clock = clock or SystemClock()
        self._rng = rng or random.Random()
        self._transport: Transport | None = None
        self._drops_before = 0
        self._last_data = 0.0
        self._had_data = False
        self._sink_fault: asyncio.Future[None] | None = None
        self._look = asyncio.Event()
        self.stats = LinkStats()

    def apply(self, settings: SupervisorSettings) -> None:
        """Other limits from now on; an open link stays open."""
        self._settings = settings
        self._look.set()

    async def run(self) -> None:
        self._sink_fault = asyncio.get_running_loop().create_future()
        self._set(LinkState.CONNECTING, None, "opening")
        attempts_without_data = 0
        while True:
            transport = self._factory()
            self._had_data = False
            error = await self._attempt(transport)
            if error.reason is LinkReason.FINISHED:
                self._set(LinkState.ENDED, error.reason, error.message)
                return
            self.stats.failures[error.reason] = self.stats.failures.get(error.reason, 0) + 1
            self._set(LinkState.DOWN, error.reason, error.message)
            attempts_without_data = 0 if self._had_data else attempts_without_data + 1
            await self._pause(transport, attempts_without_data)

    async def _attempt(self, transport: Transport) -> LinkError:
        """Open, watch to the end, close; return why it ended."""
        self._transport = transport
        try:
            await transport.open(self._deliver)
            self.stats.opens += 1
            return await self._watch(transport)
        except LinkError as error:
            return error
        except OSError as error:
            return LinkError(LinkReason.IO_ERROR, f"{error.strerror or error}")
        finally:
            # close before anything else is opened: a device may return under the old name only when we let go
            await transport.close()
            self._drops_before += transport.kernel_drops
            self._transport = None

    async def _watch(self, transport: Transport) -> LinkError:
        """Wait for the transport's end, or give up on its silence."""
        assert self._sink_fault is not None
        clock = self._clock
        self._last_data = clock.monotonic()
        stale = False
        closed = asyncio.ensure_future(transport.wait_closed())
        try:
            while True:
                settings = self._settings
                self._look.clear()
                look = asyncio.ensure_future(self._look.wait())
                waiting: set[asyncio.Future[object]] = {closed, self._sink_fault, look}  # type: ignore[arg-type]
                sleeper: asyncio.Future[None] | None = None
                if settings.stale_after_s > 0:
                    wait_s = self._last_data + settings.stale_after_s - clock.monotonic()
                    if stale:
                        # until the re-open is due, but look in between: a sign of life brings the first limit back
                        wait_s = self._last_data + settings.reopen_after_s - clock.monotonic()
                        wait_s = min(wait_s, settings.stale_after_s / 4.0)
                    # whatever was configured: the time between two looks is not the processor's whole time
                    sleeper = asyncio.ensure_future(clock.sleep(max(wait_s, LOOK_LEAST_S)))
                    waiting.add(sleeper)  # type: ignore[arg-type]
                try:
                    await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    look.cancel()
                    if sleeper is not None:
                        sleeper.cancel()
                if self._sink_fault.done():
                    self._sink_fault.result()
                if closed.done():
                    return closed.result()
                if self._look.is_set():
                    continue
                quiet_s = clock.monotonic() - self._last_data
                stale = quiet_s >= settings.stale_after_s
                if quiet_s >= max(settings.reopen_after_s, settings.stale_after_s):
                    return LinkError(
                        LinkReason.SILENT, f"open, but nothing has arrived for {quiet_s:.1f} s: re-opening"
                    )
                if stale:
                    self._set(LinkState.STALE, LinkReason.SILENT, f"open, but nothing has arrived for {quiet_s:.1f} s")
        finally:
            await _cancelled(closed)

    async def _pause(self, transport: Transport, attempts_without_data: int) -> None:
        """Wait for the back-off to pass or for the device to come back."""
        settings = self._settings
        initial_s = max(settings.backoff_initial_s, LOOK_LEAST_S)
        base_s = min(settings.backoff_max_s, initial_s * 2.0 ** min(max(attempts_without_data - 1, 0), 30))
        pause_s = base_s * (1.0 + settings.jitter * self._rng.uniform(-1.0, 1.0))
        tasks = [
            asyncio.ensure_future(self._clock.sleep(max(pause_s, LOOK_LEAST_S))),
            asyncio.ensure_future(transport.wait_ready()),
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await _cancelled(*tasks)

    def _deliver(self, batch: Batch) -> None:
        stats = self.stats
        stats.batches += 1
        if isinstance(batch, Chunk):
            stats.bytes += len(batch.data)
            data = bool(batch.data)
        else:
            errors = 0
            for frame in batch:
                if frame.error:
                    errors += 1
                else:
                    stats.bytes += len(frame.data)
            stats.error_frames += errors
            stats.can_frames += len(batch) - errors
            # a controller that complains is not a tool that speaks
            data = len(batch) > errors
        if self._transport is not None:
            stats.kernel_drops = self._drops_before + self._transport.kernel_drops
        if data:
            self._last_data = stats.last_data_mono = self._clock.monotonic()
            self._had_data = True
            if stats.state is not LinkState.UP:
                self._set(LinkState.UP, None, "data arrives")
        try:
            self._sink.on_batch(batch)
        except Exception as fault:
            # called from a reader callback, where nobody would see it: hand it to `run`
            if self._sink_fault is None or self._sink_fault.done():
                raise
            self._sink_fault.set_exception(fault)

    def _set(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        """Report a change of state or reason; the same news is not reported twice."""
        stats = self.stats
        changed = state is not stats.state or reason is not stats.reason or not stats.message
        stats.state, stats.reason, stats.message = state, reason, message
        if changed:
            self._sink.on_state(state, reason, message)


async def _cancelled(*tasks: asyncio.Future[object] | asyncio.Future[None] | asyncio.Future[LinkError]) -> None:
    """Cancel and wait until they are over, so that no task outlives its owner.

    A cancellation of the owner that arrives meanwhile passes: were it swallowed, the link would run for ever.
    """
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
