"""A simulated serial line where the system has no pseudo-terminals (Windows): a TCP connection on the loopback.

`TcpWire` is the tool's end, a server of one reader; `TcpTransport` the reader's, with the event loop's own streams,
which every system has. Unplugging closes both the connection and the door.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import threading
import time
from collections.abc import Sequence

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.link.base import Chunk, Deliver, LinkError, LinkReason, Transport
from highside.link.serial import SerialSettings, SerialTransport
from highside.link.wire import PENDING_BYTES, PtyWire, Wire

SCHEME = "socket://"
READ_SIZE = 16_384
"""Bytes that are read before others have their turn, as of a serial line."""


class TcpWire:
    """The tool's end: what nobody reads is lost, and counted."""

    unread = False

    def __init__(self) -> None:
        self._door: socket.socket | None = None
        self._port = 0
        self._reader: socket.socket | None = None
        self._pending = bytearray()
        self._lock = threading.RLock()
        self.unheard = 0

    @property
    def address(self) -> str:
        return f"{SCHEME}127.0.0.1:{self._port}" if self._port else ""

    def plug(self) -> None:
        """Open the door, at the first time on a port that is free."""
        with self._lock:
            if self._door is None:
                self._door = socket.create_server(("127.0.0.1", 0), backlog=1)
                self._door.setblocking(False)
                self._port = self._door.getsockname()[1]

    def unplug(self) -> None:
        with self._lock:
            self._lose_reader()
            if self._door is not None:
                self._door.close()
                self._door = None

    def remove(self) -> None:
        self.unplug()

    @property
    def listened_to(self) -> bool:
        with self._lock:
            if self._door is None:
                return False
            with contextlib.suppress(BlockingIOError):
                reader, _ = self._door.accept()
                reader.setblocking(False)
                reader.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._lose_reader()
                self._reader = reader
            return self._reader is not None

    @property
    def pending(self) -> int:
        return len(self._pending)

    def write(self, data: bytes) -> None:
        with self._lock:
            if not self.listened_to:
                self.unheard += len(data)
                return
            assert self._reader is not None
            self._pending += data
            try:
                while self._pending:
                    del self._pending[: self._reader.send(self._pending)]
            except (BlockingIOError, InterruptedError):
                pass
            except OSError:
                self._lose_reader()
            excess = len(self._pending) - PENDING_BYTES
            if excess > 0:
                self.unheard += excess
                del self._pending[:excess]

    def flush(self) -> None:
        self.write(b"")

    def write_frames(self, frames: Sequence[CanFrame]) -> None:
        raise InputError("CAN frames cannot be written to a serial line")

    def _lose_reader(self) -> None:
        self.unheard += len(self._pending)
        self._pending.clear()
        if self._reader is not None:
            self._reader.close()
            self._reader = None


class TcpTransport:
    """One attempt at reading the other end of a `TcpWire`."""

    kernel_drops = 0

    def __init__(self, address: str) -> None:
        self._host, _, port = address.removeprefix(SCHEME).rpartition(":")
        self._port = int(port) if port.isdigit() else 0
        self._ended: asyncio.Future[LinkError] | None = None
        self._reading: asyncio.Task[None] | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def open(self, deliver: Deliver) -> None:
        self._ended = asyncio.get_running_loop().create_future()
        try:
            reader, self._writer = await asyncio.open_connection(self._host, self._port)
        except OSError as fault:
            raise LinkError(LinkReason.NOT_FOUND, f"{self._host}:{self._port}: nobody listens there") from fault
        self._reading = asyncio.create_task(self._read(reader, deliver))

    async def _read(self, reader: asyncio.StreamReader, deliver: Deliver) -> None:
        assert self._ended is not None
        try:
            while data := await reader.read(READ_SIZE):
                deliver(Chunk(time.monotonic(), time.time(), data))
            error = LinkError(LinkReason.END_OF_FILE, "the simulated tool has gone (unplugged?)")
        except OSError as fault:
            error = LinkError(LinkReason.END_OF_FILE, f"the simulated tool has gone: {fault.strerror or fault}")
        self._ended.set_result(error)

    async def wait_closed(self) -> LinkError:
        assert self._ended is not None, "open first"
        return await asyncio.shield(self._ended)

    async def wait_ready(self) -> None:
        await asyncio.get_running_loop().create_future()  # nothing to look at: the back-off decides

    async def close(self) -> None:
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.wait({self._reading})
            self._reading = None
        if self._writer is not None:
            self._writer.close()
            with contextlib.suppress(OSError):
                await self._writer.wait_closed()
            self._writer = None


def local_wire() -> Wire:
    """What a simulated tool of this machine writes to: a pseudo-terminal where there are such."""
    return PtyWire() if hasattr(os, "openpty") else TcpWire()


def local_reader(address: str) -> Transport:
    """What reads the other end of a `local_wire`, by its address."""
    if address.startswith(SCHEME):
        return TcpTransport(address)
    return SerialTransport(SerialSettings(port=address or "unplugged"))
