"""SocketCAN: an own reader on a raw socket, because an always-on link must know what it loses.

The kernel keeps about 300 classic frames for a socket by default (35 ms of a full bus) and throws away the rest in
silence: only the counter of SO_RXQ_OVFL tells, so it is switched on, and the buffer is enlarged. Frames carry the
kernel's own time of reception (SO_TIMESTAMPNS), error frames are requested, and each wake-up reads a bounded number.

An interface that goes down raises one error and is silent afterwards; one that is deleted raises one error and the
socket stays deaf for ever, even if the interface comes back. Therefore every error closes the link, and twice a second
the interface's index and its UP flag are looked at, which needs no traffic.

Frames made on this host are frames like any other: they are never filtered out.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import struct
import sys
import time
from typing import Annotated

from pydantic import Field

from highside.codec.frame import CanFrame
from highside.link.base import Deliver, LinkError, LinkReason
from highside.reading.config_table import ConfigTable

# linux/can.h, linux/can/raw.h, asm-generic/socket.h
CAN_EFF_FLAG = 0x80000000
CAN_RTR_FLAG = 0x40000000
CAN_ERR_FLAG = 0x20000000
CAN_SFF_MASK = 0x000007FF
CAN_EFF_MASK = 0x1FFFFFFF
CAN_ERR_BUSOFF = 0x00000040
CAN_RAW_ERR_FILTER = 2
CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IB3x64s")
FILTER = struct.Struct("=II")
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
SIOCGIFFLAGS = 0x8913
IFF_UP = 0x1
TIMESPEC = struct.Struct("@ll")
ANCILLARY_SIZE = 256

FRAMES_PER_WAKE = 256
HEALTH_S = 0.5
LOOK_S = 0.05


CanId = Annotated[int, Field(ge=0, le=0x1FFFFFFF)]


class SocketCanSettings(ConfigTable):
    """A CAN interface of the kernel."""

    interface: str = Field(description="Its name, as `ip link` shows it.")
    fd: bool = Field(default=False, description="Receive CAN FD frames too.")
    can_ids: tuple[CanId, ...] = Field(default=(), description="Only these identifiers; above 0x7ff: extended ones.")
    receive_buffer_bytes: int = Field(default=8 * 1024 * 1024, ge=4096, le=1 << 30)


class SocketCanTransport:
    """One attempt at a SocketCAN interface; can send as well."""

    def __init__(self, settings: SocketCanSettings, *, health_s: float = HEALTH_S) -> None:
        self._settings = settings
        self._health_s = health_s
        self._socket: socket.socket | None = None
        self._index = 0
        self._deliver: Deliver | None = None
        self._ended: asyncio.Future[LinkError] | None = None
        self._health: asyncio.Task[None] | None = None
        self._drops = 0

    @property
    def kernel_drops(self) -> int:
        return self._drops

    async def open(self, deliver: Deliver) -> None:
        loop = asyncio.get_running_loop()
        self._ended = loop.create_future()
        self._deliver = deliver
        self._socket = open_socket(self._settings)
        self._index = interface_index(self._settings.interface)
        loop.add_reader(self._socket.fileno(), self._readable)
        self._health = asyncio.create_task(self._watch_interface())

    async def wait_closed(self) -> LinkError:
        assert self._ended is not None, "open first"
        return await asyncio.shield(self._ended)

    async def wait_ready(self) -> None:
        """Return when an interface that was absent or down is there and up, or is another one than before."""
        ended = self._ended.result().reason if self._ended is not None and self._ended.done() else None
        before = 0 if ended in (LinkReason.INTERFACE_DOWN, LinkReason.INTERFACE_GONE) else self._index
        while True:
            await asyncio.sleep(LOOK_S)
            if interface_problem(self._settings.interface) is not None:
                before = 0
            elif interface_index(self._settings.interface) != before:
                return

    async def close(self) -> None:
        if self._health is not None:
            self._health.cancel()
            await asyncio.wait({self._health})
            self._health = None
        self._stop_reading()
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, frame: CanFrame) -> bool:
        """Send at once. False when the transmit queue is full (ENOBUFS): try again a little later. Raises LinkError."""
        if self._socket is None:
            raise LinkError(LinkReason.INTERFACE_GONE, f"{self._settings.interface}: not open")
        return send_frame(self._socket, frame, self._settings.interface)

    # reading

    def _readable(self) -> None:
        assert self._socket is not None
        assert self._deliver is not None
        # one pair of clocks a wake-up: the monotonic time of a frame is now, less its age by the wall clock
        mono, wall = time.monotonic(), time.time()
        frames: list[CanFrame] = []
        error: LinkError | None = None
        for _ in range(FRAMES_PER_WAKE):
            try:
                data, ancillary, _flags, _address = self._socket.recvmsg(FD.size, ANCILLARY_SIZE)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as fault:
                error = os_error(self._settings.interface, fault)
                break
            stamp = wall
            for level, kind, content in ancillary:
                if level != socket.SOL_SOCKET:
                    continue
                if kind == SO_TIMESTAMPNS:
                    seconds, nanoseconds = TIMESPEC.unpack(content)
                    stamp = seconds + nanoseconds * 1e-9
                elif kind == SO_RXQ_OVFL:
                    self._drops = int.from_bytes(content, sys.byteorder)
            frame = parse(data, mono - min(max(wall - stamp, 0.0), 60.0), stamp)
            if frame is None:
                continue
            frames.append(frame)
            if frame.error and frame.can_id & CAN_ERR_BUSOFF:
                error = LinkError(
                    LinkReason.BUS_OFF, f"{self._settings.interface}: the controller went bus-off (wiring, bit rate?)"
                )
                break
        if frames:
            self._deliver(frames)
        if error is not None:
            self._end(error)

    def _stop_reading(self) -> None:
        if self._socket is not None and self._socket.fileno() >= 0:
            asyncio.get_running_loop().remove_reader(self._socket.fileno())

    def _end(self, error: LinkError) -> None:
        self._stop_reading()
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(error)

    async def _watch_interface(self) -> None:
        while True:
            await asyncio.sleep(self._health_s)
            problem = interface_problem(self._settings.interface, self._index)
            if problem is not None:
                self._end(problem)
                return


def open_socket(settings: SocketCanSettings) -> socket.socket:
    """A raw, non-blocking CAN socket with everything switched on. Raises LinkError, also when the interface is down."""
    name = settings.interface
    if not hasattr(socket, "AF_CAN"):
        raise LinkError(LinkReason.CONFIG, f"{name}: this Python has no SocketCAN")
    problem = interface_problem(name)
    if problem is not None:
        raise problem
    try:
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as fault:
        if fault.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            raise LinkError(LinkReason.CONFIG, f"{name}: the kernel has no SocketCAN (modprobe can-raw)") from fault
        raise os_error(name, fault) from fault
    try:
        raw.setblocking(False)
        raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        raw.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        enlarge_receive_buffer(raw, settings.receive_buffer_bytes)
        raw.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_EFF_MASK)
        if settings.fd:
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        if settings.can_ids:
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, _filters(settings.can_ids))
        raw.bind((name,))
    except OSError as fault:
        raw.close()
        raise os_error(name, fault) from fault
    return raw


def enlarge_receive_buffer(raw: socket.socket, size: int) -> int:
    """Ask for `size` bytes (SO_RCVBUFFORCE needs a privilege, SO_RCVBUF is capped); return what was granted."""
    force = getattr(socket, "SO_RCVBUFFORCE", 33)
    try:
        raw.setsockopt(socket.SOL_SOCKET, force, size)
    except OSError:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    return raw.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def _filters(can_ids: tuple[int, ...]) -> bytes:
    packed = b""
    for can_id in can_ids:
        flag, mask = (CAN_EFF_FLAG, CAN_EFF_MASK) if can_id > CAN_SFF_MASK else (0, CAN_SFF_MASK)
        packed += FILTER.pack(can_id | flag, mask | CAN_EFF_FLAG)
    return packed


def parse(data: bytes, t_mono: float, t_wall: float) -> CanFrame | None:
    """A `struct can_frame` (16 bytes) or `canfd_frame` (72 bytes); None for anything else."""
    if len(data) == CLASSIC.size:
        can_id, length, payload = CLASSIC.unpack(data)
        fd = False
    elif len(data) == FD.size:
        can_id, length, payload = FD.unpack(data)
        fd = True
    else:
        return None
    extended = bool(can_id & CAN_EFF_FLAG)
    error = bool(can_id & CAN_ERR_FLAG)
    number = can_id & (CAN_EFF_MASK if extended or error else CAN_SFF_MASK)
    return CanFrame(t_mono, t_wall, number, payload[:length], extended, error, bool(can_id & CAN_RTR_FLAG), fd)


def pack(frame: CanFrame) -> bytes:
    """The `struct can_frame` or `canfd_frame` of a frame to be sent."""
    can_id = frame.can_id
    if frame.extended:
        can_id |= CAN_EFF_FLAG
    if frame.remote:
        can_id |= CAN_RTR_FLAG
    layout = FD if frame.fd else CLASSIC
    return layout.pack(can_id, len(frame.data), frame.data)


def send_frame(raw: socket.socket, frame: CanFrame, interface: str) -> bool:
    """Send; False when the transmit queue or the socket's buffer is full at the moment. Raises LinkError otherwise."""
    try:
        raw.send(pack(frame))
    except OSError as fault:
        if fault.errno in (errno.ENOBUFS, errno.EAGAIN, errno.EINTR):
            return False
        raise os_error(interface, fault) from fault
    return True


def os_error(interface: str, fault: OSError) -> LinkError:
    """What an errno of a CAN socket means."""
    if fault.errno == errno.ENETDOWN:
        return LinkError(LinkReason.INTERFACE_DOWN, f"{interface}: the interface is down (ip link set {interface} up)")
    if fault.errno in (errno.ENODEV, errno.ENXIO):
        return LinkError(LinkReason.INTERFACE_GONE, f"{interface}: no such CAN interface")
    if fault.errno in (errno.EACCES, errno.EPERM):
        return LinkError(LinkReason.NO_PERMISSION, f"{interface}: no permission for raw CAN sockets")
    return LinkError(LinkReason.IO_ERROR, f"{interface}: {fault.strerror or fault}")


def interface_index(interface: str) -> int:
    """The kernel's number of an interface, 0 when there is none. A re-created interface has a new one."""
    try:
        return socket.if_nametoindex(interface)
    except OSError:
        return 0


def interface_problem(interface: str, index: int | None = None) -> LinkError | None:
    """Why an interface cannot be used now, or None; with `index` also whether it is still the same one."""
    now = interface_index(interface)
    if now == 0:
        return LinkError(LinkReason.INTERFACE_GONE, f"{interface}: no such CAN interface")
    if index is not None and now != index:
        return LinkError(LinkReason.INTERFACE_GONE, f"{interface}: was removed and created anew: re-opening")
    import fcntl  # here: where there is no CAN interface there may be no such module either

    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        request = struct.pack("16sH14x", interface.encode()[:15], 0)
        _name, flags = struct.unpack("16sH14x", fcntl.ioctl(probe, SIOCGIFFLAGS, request))
        if not flags & IFF_UP:
            return LinkError(
                LinkReason.INTERFACE_DOWN, f"{interface}: the interface is down (ip link set {interface} up)"
            )
    return None
