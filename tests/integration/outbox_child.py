"""Helper of test_mqtt_sigkill: forks daemons in miniature (producer, outbox, publisher) that are there to be killed.

`outbox_child.py PATH RATE_HZ COMMIT_INTERVAL_S`, then a line `RUN PORT` on stdin for each child. A child writes
`ready PID`, and `SEQ T_MONO` after each `put`, straight to the descriptor. With a RUN of -1 it produces nothing and
leaves when everything is acknowledged.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path

from highside.config.mqtt import MqttSettings
from highside.service.outbox import Outbox
from highside.service.publisher import Publisher

TOPIC = "highside/victim/attitude"


async def produce(path: Path, port: int, rate_hz: float, commit_interval_s: float, run: int) -> None:
    outbox = Outbox(path, max_rows=1_000_000, max_age_s=1e6, max_bytes=1 << 30, commit_interval_s=commit_interval_s)
    outbox.start()
    publisher = Publisher(MqttSettings(port=port), outbox, tool_id="victim")
    sending = asyncio.create_task(publisher.run())
    os.write(1, b"ready %d\n" % os.getpid())
    due = time.monotonic()
    while run >= 0:
        seq = outbox.next_seq(TOPIC)
        outbox.put(TOPIC, b'{"seq":%d,"run":%d,"historical":false}' % (seq, run), created_s=time.time())
        os.write(1, b"%d %.6f\n" % (seq, time.monotonic()))
        due += 1.0 / rate_hz
        await asyncio.sleep(max(due - time.monotonic(), 0.0))
    for _ in range(3_000):
        if not outbox.stats.queued:
            break
        await asyncio.sleep(0.01)
    await publisher.stop(5.0)
    await sending
    outbox.stop(10.0)
    os.write(1, b"drained %d\n" % outbox.stats.queued)


def main() -> None:
    path, rate_hz, commit_interval_s = Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
    # this process has no threads and no event loop: forking it is safe, and spares each child a second of imports
    for line in sys.stdin:
        run, port = map(int, line.split())
        child = os.fork()
        if child == 0:
            try:
                asyncio.run(produce(path, port, rate_hz, commit_interval_s, run))
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        os.write(1, b"gone\n")


if __name__ == "__main__":
    main()
