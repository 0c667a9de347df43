"""Serial lines: opened by pyserial, read by the event loop.

pyserial knows how to set up a port (baud rate, lock, low latency) and brings `socket://` and `rfc2217://` along; the
loop reads the descriptor itself. Facts that shape this module: a port is not exclusive unless one requests it; after an
unplug the descriptor is readable for ever and gives b"" - that is the end of file, not "no data"; pyserial sets
VMIN = 0, with which an empty line gives b"" too, so VMIN is set to 1; a device may return under another node, so a
by-id link is resolved anew at each open and looked at while open. URLs without a descriptor get a thread and a bounded
hand-over.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import threading
import time
from contextvars import copy_context
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from highside.link.base import Chunk, Deliver, LinkError, LinkReason
from highside.link.handover import Handover
from highside.reading.config_table import ConfigTable

try:
    import fcntl
    import termios
except ImportError:
    TERMINALS = False
else:
    TERMINALS = True
"""Whether ports are terminals with descriptors, which an event loop can wait for. Those of Windows are not: a thread
reads them, as it does URLs without a descriptor."""

SerialPort = Any
"""one of pyserial's classes; what they have in common (`in_waiting`, `fileno`) is not in their common base"""
READ_SIZE = 16_384
"""Bytes that are read before others have their turn: 680 frames of 24 bytes, 10 ms of work. After a stall more may
wait; the loop comes back for it."""
SHORT_READ = 2048
"""A read that gives less has emptied the line (the kernel's line discipline hands out up to 4 KiB): no second one is
made only to find that out."""
LOOK_S = 0.05
"""how often an absent device is looked for; one stat() costs some microseconds"""
WATCH_S = 0.5
"""how often the node of an open device is compared with the one that was opened"""
THREAD_POLL_S = 0.2
LETTING_GO_S = 0.5
"""Seconds for which a port that is busy is tried again before that is reported. A lock lives as long as its last
descriptor: a process that has just been asked to end, or one that was forked and has not become another program yet,
holds it for some milliseconds more; and the kernel itself says EAGAIN of a terminal that is being closed."""
_BUSY = (errno.EAGAIN, errno.EBUSY)


class SerialSettings(ConfigTable):
    """A serial port or URL and its line settings."""

    port: str = Field(
        min_length=1,
        description="Device (best /dev/serial/by-id/...), socket://host:port or rfc2217://host:port.",
    )
    baud: int = Field(default=115200, gt=0, le=12_000_000)
    bytesize: Literal[5, 6, 7, 8] = 8
    parity: Literal["N", "E", "O", "M", "S"] = "N"
    stopbits: float = Field(default=1.0, description="1, 1.5 or 2.")
    xonxoff: bool = False
    rtscts: bool = False

    @field_validator("port")
    @classmethod
    def _url_has_no_space(cls, value: str) -> str:
        if "://" in value and any(character.isspace() for character in value):
            raise ValueError("a URL has no spaces")
        return value

    @field_validator("stopbits")
    @classmethod
    def _stopbits_exist(cls, value: float) -> float:
        if value not in (1.0, 1.5, 2.0):
            raise ValueError("must be 1, 1.5 or 2")
        return value


class SerialTransport:
    """One attempt at a serial port or a pyserial URL."""

    kernel_drops = 0

    def __init__(self, settings: SerialSettings) -> None:
        self._settings = settings
        self._is_url = "://" in settings.port
        self._port: SerialPort = None
        self._fd = -1
        self._identity: tuple[int, int] | None = None
        self._deliver: Deliver | None = None
        self._ended: asyncio.Future[LinkError] | None = None
        self._closing = threading.Event()
        self._handover: Handover[Chunk | LinkError] | None = None
        self._thread: threading.Thread | None = None
        self._watcher: asyncio.Task[None] | None = None

    async def open(self, deliver: Deliver) -> None:
        loop = asyncio.get_running_loop()
        self._ended = loop.create_future()
        self._deliver = deliver
        if not self._is_url:
            self._identity = _identity(self._settings.port)
        # opening may talk over USB or the network: not in the loop
        self._port = await asyncio.to_thread(self._open_port)
        if self._closing.is_set():
            raise LinkError(LinkReason.IO_ERROR, "closed while being opened")
        try:
            self._fd = self._port.fileno() if TERMINALS else -1
        except (OSError, AttributeError):  # io.UnsupportedOperation is an OSError
            self._fd = -1
        if self._fd >= 0:
            if not self._is_url:
                # of what was opened: a link that appeared between the look at it and the opening is no other device
                self._identity = _identity(self._fd)
            os.set_blocking(self._fd, False)
            loop.add_reader(self._fd, self._readable)
        else:
            self._handover = Handover(loop, self._taken, capacity=64)
            self._thread = threading.Thread(
                target=copy_context().run,
                args=(self._read_in_thread, self._port, self._handover),
                name=f"read {self._settings.port}",
                daemon=True,
            )
            self._thread.start()
        if not self._is_url:
            self._watcher = asyncio.create_task(self._watch_node())

    async def wait_closed(self) -> LinkError:
        assert self._ended is not None, "open first"
        return await asyncio.shield(self._ended)

    async def wait_ready(self) -> None:
        if self._is_url:
            await asyncio.get_running_loop().create_future()  # nothing to look at: the back-off decides
        # compared with what was there when this attempt began: it may have come back before anybody waited for it
        before = self._identity
        while True:
            await asyncio.sleep(LOOK_S)
            now = _identity(self._settings.port)
            if now is None:
                before = None  # it is gone: whatever appears next is new
            elif now != before:
                return

    async def close(self) -> None:
        self._closing.set()
        if self._watcher is not None:
            self._watcher.cancel()
            await asyncio.wait({self._watcher})
            self._watcher = None
        if self._fd >= 0:
            asyncio.get_running_loop().remove_reader(self._fd)
            self._fd = -1
        if self._handover is not None:
            self._handover.close()
        port, self._port = self._port, None
        if port is not None:
            # pyserial's network ports sleep while closing, and a driver may wait for its device
            await asyncio.to_thread(_close_port, port)
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 2.0)
            self._thread = None

    # opening (in a thread)

    def _open_port(self) -> SerialPort:
        port = open_port(self._settings)
        if self._closing.is_set():
            _close_port(port)
        return port

    # reading

    def _readable(self) -> None:
        assert self._deliver is not None
        parts: list[bytes] = []
        error: LinkError | None = None
        room = READ_SIZE
        while room > 0:
            try:
                data = os.read(self._fd, room)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as fault:
                error = self._read_error(fault)
                break
            if not data:
                error = self._end_of_file()
                break
            parts.append(data)
            room -= len(data)
            if len(data) < SHORT_READ:
                break  # that was all; if more comes meanwhile, the loop calls again
        if parts:
            self._deliver(Chunk(time.monotonic(), time.time(), b"".join(parts)))
        if error is not None:
            self._end(error)

    def _read_in_thread(self, port: SerialPort, handover: Handover[Chunk | LinkError]) -> None:
        while not handover.closed:
            try:
                # what is there, at least one byte, at most THREAD_POLL_S
                data = port.read(max(1, min(port.in_waiting, READ_SIZE)))
            except (OSError, TypeError, AttributeError) as fault:
                # pyserial's classes raise the latter two when closed under a read
                handover.put(LinkError(LinkReason.REMOTE_CLOSED, f"{self._settings.port}: {fault}"))
                return
            if data and not handover.put(Chunk(time.monotonic(), time.time(), data)):
                return

    def _taken(self, items: list[Chunk | LinkError]) -> None:
        assert self._deliver is not None
        chunks = [item for item in items if isinstance(item, Chunk)]
        if chunks:
            self._deliver(Chunk(chunks[-1].t_mono, chunks[-1].t_wall, b"".join(chunk.data for chunk in chunks)))
        for item in items:
            if isinstance(item, LinkError):
                self._end(item)

    # ends

    async def _watch_node(self) -> None:
        """A by-id link that now leads to another node: the old descriptor may never say so."""
        while True:
            await asyncio.sleep(WATCH_S)
            now = _identity(self._settings.port)
            if now is not None and now != self._identity:
                self._end(
                    LinkError(LinkReason.END_OF_FILE, f"{self._settings.port} leads to another device now: re-opening")
                )
                return

    def _end_of_file(self) -> LinkError:
        if self._is_url:
            return LinkError(LinkReason.REMOTE_CLOSED, f"{self._settings.port}: the other end closed the connection")
        return LinkError(LinkReason.END_OF_FILE, f"{self._settings.port}: the device has gone (unplugged?)")

    def _read_error(self, fault: OSError) -> LinkError:
        if fault.errno in (errno.EIO, errno.ENODEV, errno.ENXIO) and not self._is_url:
            return self._end_of_file()
        if fault.errno in (errno.ECONNRESET, errno.EPIPE):
            return self._end_of_file()
        return LinkError(LinkReason.IO_ERROR, f"{self._settings.port}: {fault.strerror or fault}")

    def _end(self, error: LinkError) -> None:
        if self._fd >= 0:
            # at once: a descriptor at its end is readable for ever and would eat a whole core
            asyncio.get_running_loop().remove_reader(self._fd)
            self._fd = -1
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(error)


def open_port(settings: SerialSettings) -> SerialPort:
    """Open with pyserial, exclusively and with low latency; blocking. Raises LinkError with the reason.

    The lock is `flock`, which other instances of this and every pyserial program that requests exclusivity respect (it
    works on a pty as well); on real devices TIOCEXCL is added, which keeps out programs that do not look at locks. Not
    on a pty: there the flag would outlive us. A busy port is tried again for `LETTING_GO_S`.
    """
    import serial  # here: links of other kinds do not need it

    options: dict[str, Any] = {
        "baudrate": settings.baud,
        "bytesize": settings.bytesize,
        "parity": settings.parity,
        "stopbits": settings.stopbits,
        "xonxoff": settings.xonxoff,
        "rtscts": settings.rtscts,
        "timeout": THREAD_POLL_S,
    }
    is_url = "://" in settings.port
    if not is_url:
        options["exclusive"] = True
    give_up_s = time.monotonic() + LETTING_GO_S
    while True:
        try:
            port: SerialPort = serial.serial_for_url(settings.port, **options)
            break
        except ValueError as fault:
            raise LinkError(LinkReason.CONFIG, f"{settings.port}: {fault}") from fault
        except OSError as fault:  # SerialException is one
            if fault.errno not in _BUSY or time.monotonic() > give_up_s:
                raise _open_error(settings.port, fault) from fault
            # not time.sleep: that waits for a point of the absolute clock, which a clock that is being faked breaks
            threading.Event().wait(LOOK_S)
    if not is_url and TERMINALS:
        try:
            fd = port.fileno()
            attributes = termios.tcgetattr(fd)
            attributes[6][termios.VMIN] = 1
            attributes[6][termios.VTIME] = 0
            termios.tcsetattr(fd, termios.TCSANOW, attributes)
            if not os.path.realpath(settings.port).startswith("/dev/pts/"):
                fcntl.ioctl(fd, termios.TIOCEXCL)
        except (OSError, termios.error) as fault:
            _close_port(port)
            raise LinkError(LinkReason.IO_ERROR, f"{settings.port}: {fault}") from fault
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            # FTDI adapters hold data back for 16 ms otherwise; a pty or an embedded UART has no such switch (OSError,
            # ValueError), nor has pyserial on other systems than Linux (NotImplementedError): the port serves as it is
            port.set_low_latency_mode(True)
    return port


def _open_error(name: str, fault: OSError) -> LinkError:
    text = " ".join(str(fault).split())
    code = fault.errno
    if code in _BUSY:
        return LinkError(LinkReason.BUSY, f"{name}: in use by another program{_holder(name)}")
    if code in (errno.EACCES, errno.EPERM):
        return LinkError(LinkReason.NO_PERMISSION, f"{name}: no permission (is the user in the group dialout?)")
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.ENOTDIR):
        return LinkError(LinkReason.NOT_FOUND, f"{name}: no such device")
    if "Connection refused" in text:
        return LinkError(LinkReason.NOT_FOUND, f"{name}: nobody listens there")
    if "RFC2217" in text or "Inappropriate ioctl" in text:
        return LinkError(LinkReason.CONFIG, f"{name}: {text}")
    return LinkError(LinkReason.IO_ERROR, f"{name}: {text}")


def _holder(path: str) -> str:
    """Who holds the lock on a port, as far as the kernel tells: " (highside, process 123)", or nothing."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        status = Path(path).stat()
        place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            # 12: FLOCK  ADVISORY  WRITE 4711 00:19:7 0 EOF
            words = line.split()
            if words[1] == "FLOCK" and words[5] == place:
                pid = int(words[4])
                return f" ({Path(f'/proc/{pid}/comm').read_text(errors='replace').strip()}, process {pid})"
    return ""


def _close_port(port: SerialPort) -> None:
    with contextlib.suppress(OSError, TypeError, AttributeError):
        port.close()


def _identity(place: str | int) -> tuple[int, int] | None:
    """Which device node a path (through links) or an open descriptor leads to; None when it leads nowhere."""
    try:
        status = os.stat(place)  # noqa: PTH116 - a descriptor, too
    except OSError:
        return None
    return status.st_ino, status.st_rdev
