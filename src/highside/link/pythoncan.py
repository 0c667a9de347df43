"""Every other CAN adapter that python-can knows (PCAN, Kvaser, slcan, gs_usb, `virtual`, ...), by configuration.

python-can's own asyncio Notifier is not used: its reader's errors reach nobody and its buffer is unbounded, so a lost
adapter would look like a quiet bus for ever. Here a thread reads the bus with a short time-out, hands batches over to
the loop through a bounded queue, and an error ends the transport, which the supervisor sees.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from contextvars import copy_context
from typing import TYPE_CHECKING

from pydantic import Field

from highside.codec.frame import CanFrame
from highside.link.base import Deliver, LinkError, LinkReason
from highside.link.handover import Handover
from highside.link.socketcan import CanId
from highside.reading.config_table import ConfigTable

if TYPE_CHECKING:
    import can

POLL_S = 0.1
FRAMES_PER_BATCH = 256


class PythonCanSettings(ConfigTable):
    """What `can.Bus` is given: `interface` and `channel` as python-can names them, further `options` as they are."""

    interface: str = Field(
        min_length=1, description="python-can's name of the interface: pcan, kvaser, slcan, virtual, ..."
    )
    channel: str | int | None = None
    bitrate: int | None = Field(default=None, gt=0)
    fd: bool = False
    can_ids: tuple[CanId, ...] = ()
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="Further arguments of can.Bus."
    )


class PythonCanTransport:
    """One attempt at a python-can bus."""

    kernel_drops = 0

    def __init__(self, settings: PythonCanSettings) -> None:
        self._settings = settings
        self._bus: can.BusABC | None = None
        self._deliver: Deliver | None = None
        self._ended: asyncio.Future[LinkError] | None = None
        self._handover: Handover[list[CanFrame] | LinkError] | None = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    async def open(self, deliver: Deliver) -> None:
        loop = asyncio.get_running_loop()
        self._ended = loop.create_future()
        self._deliver = deliver
        self._bus = await asyncio.to_thread(self._open_bus)
        if self._closing.is_set():
            raise LinkError(LinkReason.IO_ERROR, "closed while being opened")
        self._handover = Handover(loop, self._taken, capacity=64)
        self._thread = threading.Thread(
            target=copy_context().run,
            args=(self._read_in_thread, self._bus, self._handover),
            name=f"read {self._name}",
            daemon=True,
        )
        self._thread.start()

    async def wait_closed(self) -> LinkError:
        assert self._ended is not None, "open first"
        return await asyncio.shield(self._ended)

    async def wait_ready(self) -> None:
        await asyncio.get_running_loop().create_future()  # nothing to look at: the back-off decides

    async def close(self) -> None:
        self._closing.set()
        if self._handover is not None:
            self._handover.close()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 2.0)
            self._thread = None
        bus, self._bus = self._bus, None
        if bus is not None:
            await asyncio.to_thread(_shut_down, bus)

    @property
    def _name(self) -> str:
        return f"{self._settings.interface}:{self._settings.channel}"

    def _open_bus(self) -> can.BusABC:
        bus = open_bus(self._settings)
        if self._closing.is_set():
            _shut_down(bus)
        return bus

    def _read_in_thread(self, bus: can.BusABC, handover: Handover[list[CanFrame] | LinkError]) -> None:
        import can

        while not handover.closed:
            frames: list[CanFrame] = []
            error: LinkError | None = None
            try:
                # one blocking read, then what else is there
                message = bus.recv(POLL_S)
                while message is not None:
                    frames.append(_frame(message))
                    message = bus.recv(0) if len(frames) < FRAMES_PER_BATCH else None
            except (can.CanError, OSError, ValueError) as fault:
                error = LinkError(LinkReason.IO_ERROR, f"{self._name}: {fault}")
            if frames and not handover.put(frames):
                return
            if error is not None:
                handover.put(error)
                return

    def _taken(self, items: list[list[CanFrame] | LinkError]) -> None:
        assert self._deliver is not None
        frames = [frame for item in items if not isinstance(item, LinkError) for frame in item]
        if frames:
            self._deliver(frames)
        for item in items:
            if isinstance(item, LinkError) and self._ended is not None and not self._ended.done():
                self._ended.set_result(item)


def open_bus(settings: PythonCanSettings) -> can.BusABC:
    """`can.Bus` by configuration; blocking. Raises LinkError."""
    import can

    options: dict[str, object] = dict(settings.options)
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    if settings.fd:
        options["fd"] = True
    if settings.can_ids:
        options["can_filters"] = [
            {"can_id": can_id, "can_mask": 0x1FFFFFFF if can_id > 0x7FF else 0x7FF, "extended": can_id > 0x7FF}
            for can_id in settings.can_ids
        ]
    name = f"{settings.interface}:{settings.channel}"
    try:
        return can.Bus(channel=settings.channel, interface=settings.interface, **options)  # type: ignore[arg-type]
    except (can.CanInterfaceNotImplementedError, ValueError, TypeError) as fault:
        # an interface that is not known or whose driver is not installed, options that it does not take
        raise LinkError(LinkReason.CONFIG, f"{name}: {fault}") from fault
    except (can.CanError, OSError) as fault:
        # every driver has texts of its own; the reason is what all have in common
        raise LinkError(LinkReason.NOT_FOUND, f"{name}: cannot be opened: {fault}") from fault


def _frame(message: can.Message) -> CanFrame:
    wall, mono = time.time(), time.monotonic()
    # some drivers stamp with epoch time, some with their own; a stamp that is not of the last minute is not a date
    age = wall - message.timestamp
    if not 0.0 <= age <= 60.0:
        age = 0.0
    return CanFrame(
        mono - age,
        wall - age,
        message.arbitration_id,
        bytes(message.data),
        message.is_extended_id,
        message.is_error_frame,
        message.is_remote_frame,
        message.is_fd,
    )


def _shut_down(bus: can.BusABC) -> None:
    import can

    with contextlib.suppress(can.CanError, OSError, ValueError):
        bus.shutdown()
