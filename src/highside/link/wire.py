"""The far end of a link: where the simulated device and a replayed recording write to.

A pty stands for a serial line, a CAN interface for a bus. Like real hardware they do not wait for a listener: what
nobody reads is lost, and counted. What the kernel cannot take at the moment is kept for the next write, up to a bound.
Unplugging a pty closes its master, which is what the reader of a real line sees when a USB adapter is pulled; plugging
in again makes a new pty, under the same link if one was requested.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.link.socketcan import SocketCanSettings, open_socket, send_frame

# systems without pseudo-terminals have a `tcp_wire` instead
with contextlib.suppress(ImportError):
    import fcntl
    import pty
    import termios
    import tty

PENDING_BYTES = 1 << 20
PENDING_FRAMES = 20_000


class Wire(Protocol):
    """Something that bytes or CAN frames can be written to."""

    unheard: int
    """bytes or frames lost because nobody listened or took them in time"""

    @property
    def address(self) -> str:
        """What a reader has to open."""

    def plug(self) -> None: ...

    def unplug(self) -> None: ...

    def remove(self) -> None:
        """Unplug for good, and leave nothing behind."""

    @property
    def listened_to(self) -> bool:
        """Whether somebody reads; a bus always says yes."""

    def write(self, data: bytes) -> None:
        """Send bytes (a serial wire)."""

    def write_frames(self, frames: Sequence[CanFrame]) -> None:
        """Send frames (a bus)."""

    @property
    def pending(self) -> int:
        """Bytes or frames that are accepted, but not on their way yet."""

    def flush(self) -> None:
        """Send on what is pending, as far as possible now."""

    @property
    def unread(self) -> bool:
        """Whether a reader has not taken yet what is on its way (known of a pty only; elsewhere False)."""


class PtyWire:
    """A pseudo-terminal whose slave the reader opens as if it were a serial port."""

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self._master = -1
        self._slave_name = ""
        self._pending = bytearray()
        self._poll = select.poll()
        self.unheard = 0

    @property
    def address(self) -> str:
        return str(self._link) if self._link is not None else self._slave_name

    @property
    def plugged(self) -> bool:
        return self._master >= 0

    def plug(self) -> None:
        """Make a new pty, and let the link lead to it. Raises InputError when the link's name is taken."""
        if self.plugged:
            return
        if self._link is not None and self._link.exists() and not self._link.is_symlink():
            raise InputError("exists and is not a symbolic link", where=str(self._link), remedy="choose another name")
        master, slave = pty.openpty()
        tty.setraw(slave)
        self._slave_name = os.ttyname(slave)
        # from now on the master reports a hang-up until somebody opens the slave
        os.close(slave)
        os.set_blocking(master, False)
        self._master = master
        self._poll.register(master, select.POLLOUT)
        if self._link is not None:
            beside = self._link.with_name(f".{self._link.name}.{os.getpid()}")
            beside.unlink(missing_ok=True)
            try:
                beside.symlink_to(self._slave_name)
                beside.replace(self._link)
            except OSError as fault:
                self._close_master()
                raise InputError(f"cannot be made: {fault.strerror}", where=str(self._link)) from fault

    def unplug(self) -> None:
        """Close the master: the reader sees the end of file. The link stays and leads nowhere."""
        if self.plugged:
            self.unheard += len(self._pending)
            self._pending.clear()
            self._close_master()

    def remove(self) -> None:
        """Unplug and take the link away."""
        self.unplug()
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def _close_master(self) -> None:
        self._poll.unregister(self._master)
        os.close(self._master)
        self._master = -1

    @property
    def listened_to(self) -> bool:
        if not self.plugged:
            return False
        events = self._poll.poll(0)
        return not any(event & (select.POLLHUP | select.POLLERR) for _, event in events)

    @property
    def pending(self) -> int:
        return len(self._pending)

    def write(self, data: bytes) -> None:
        if not self.listened_to:
            self.unheard += len(data) + len(self._pending)
            self._pending.clear()
            return
        self._pending += data
        while self._pending:
            try:
                done = os.write(self._master, memoryview(self._pending)[:4096].tobytes())
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                self.unheard += len(self._pending)
                self._pending.clear()
                break
            del self._pending[:done]
        excess = len(self._pending) - PENDING_BYTES
        if excess > 0:
            self.unheard += excess
            del self._pending[:excess]

    def flush(self) -> None:
        self.write(b"")

    @property
    def unread(self) -> bool:
        """Asked of the slave side; closing the master would throw the rest away."""
        if not self.listened_to:
            return False
        slave = os.open(self._slave_name, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            (waiting,) = struct.unpack("i", fcntl.ioctl(slave, termios.FIONREAD, b"\0" * 4))
        finally:
            os.close(slave)
        return bool(waiting)

    def write_frames(self, frames: Sequence[CanFrame]) -> None:
        raise InputError("CAN frames cannot be written to a serial line", remedy="use --to can:IFACE")


class CanWire:
    """A SocketCAN interface."""

    def __init__(self, interface: str) -> None:
        self._interface = interface
        self._socket: socket.socket | None = None
        self._pending: deque[CanFrame] = deque()
        self.unheard = 0

    @property
    def address(self) -> str:
        return self._interface

    def plug(self) -> None:
        """Open the interface. Raises LinkError."""
        if self._socket is None:
            self._socket = open_socket(SocketCanSettings(interface=self._interface))
            # a writer reads nothing: an empty filter keeps its receive queue empty
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")

    def unplug(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self.unheard += len(self._pending)
        self._pending.clear()

    def remove(self) -> None:
        self.unplug()

    @property
    def listened_to(self) -> bool:
        return self._socket is not None

    @property
    def pending(self) -> int:
        return len(self._pending)

    def write(self, data: bytes) -> None:
        raise InputError("bytes cannot be written to a CAN bus", remedy="use --to pty")

    unread = False

    def flush(self) -> None:
        self.write_frames([])

    def write_frames(self, frames: Sequence[CanFrame]) -> None:
        """Send as many as the transmit queue takes; the rest waits for the next call. Raises LinkError."""
        if self._socket is None:
            self.unheard += len(frames)
            return
        self._pending.extend(frames)
        fd_enabled = False
        while self._pending:
            frame = self._pending[0]
            if frame.error:
                self._pending.popleft()  # a controller makes these; they cannot be sent
                self.unheard += 1
                continue
            if frame.fd and not fd_enabled:
                self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
                fd_enabled = True
            if not send_frame(self._socket, frame, self._interface):
                break
            self._pending.popleft()
        while len(self._pending) > PENDING_FRAMES:
            self._pending.popleft()
            self.unheard += 1
