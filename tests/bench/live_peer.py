"""What a maker would write in an afternoon: the script that the service's cost is measured against.

    python -m tests.bench.live_peer PTY BROKER_PORT MESSAGES_PER_S

Reads the tool's frames (24 bytes and a temperature) from a serial port, checks the CRC, averages, publishes inclination
and toolface as JSON at QoS 1. It imports nothing of this project; it keeps nothing on disk and knows no calibration,
no noise, no health, no reconnection.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import struct
import sys
import time
from binascii import crc_hqx

import aiomqtt
import serial

FRAME = struct.Struct(">2sBBHIiiihH")
TOPIC = "peer/t1/attitude"


class Reader:
    """Cuts the stream into frames; a message after every `per_message` of them."""

    def __init__(self, fd: int, per_message: int, queue: asyncio.Queue[bytes]) -> None:
        self.fd, self.per_message, self.queue = fd, per_message, queue
        self.buffer = bytearray()
        self.rows: list[tuple[float, float, float]] = []
        self.seq = 0

    def readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self.buffer += os.read(self.fd, 4096)
        while (at := self.buffer.find(b"\xc8\xf3")) >= 0 and len(self.buffer) - at >= FRAME.size:
            _, _, _, _, t_us, x, y, z, temp, crc = FRAME.unpack_from(self.buffer, at)
            if crc_hqx(self.buffer[at + 2 : at + FRAME.size - 2], 0xFFFF) != crc:
                del self.buffer[: at + 2]
                continue
            del self.buffer[: at + FRAME.size]
            self.rows.append((x * 1e-8, y * 1e-8, z * 1e-8))
            if len(self.rows) == self.per_message:
                self.output(t_us * 1e-6, temp * 0.01)
                self.rows.clear()

    def output(self, t_s: float, temp_c: float) -> None:
        n = len(self.rows)
        x, y, z = (sum(row[axis] for row in self.rows) / n for axis in range(3))
        inc = math.degrees(math.atan2(math.hypot(x, y), z))
        tf = math.degrees(math.atan2(y, x)) % 360.0
        message = {"seq": self.seq, "t": time.time(), "t_mono": time.monotonic(), "t_device_s": t_s, "inc_deg": inc}
        message |= {"tf_deg": tf, "g_total": math.sqrt(x * x + y * y + z * z), "temp_c": temp_c, "n": n}
        self.seq += 1
        self.queue.put_nowait(json.dumps(message).encode())


async def main() -> None:
    port = serial.Serial(sys.argv[1], 115200, timeout=0)
    queue: asyncio.Queue[bytes] = asyncio.Queue()
    reader = Reader(port.fileno(), max(round(100 / float(sys.argv[3])), 1), queue)
    async with aiomqtt.Client("127.0.0.1", int(sys.argv[2])) as client:
        asyncio.get_running_loop().add_reader(port.fileno(), reader.readable)
        while True:
            await client.publish(TOPIC, await queue.get(), qos=1)


if __name__ == "__main__":
    asyncio.run(main())
