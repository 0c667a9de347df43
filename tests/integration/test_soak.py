"""A minute at the ceilings: 3,840 frames/s over a pty, 9,000 CAN frames/s over python-can's virtual bus.

The sender is a process of its own for the pty (as a tool is), a thread for the virtual bus, which lives in the process.
Frames are counted, the memory is watched after a warm-up, the stall of the event loop is reported. `HIGHSIDE_SOAK_S`
sets the length.
"""

from __future__ import annotations

import asyncio
import gc
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from broker import Mosquitto
from daemon import Subscriber, running, wait_for

pytestmark = pytest.mark.slow

SECONDS = float(os.environ.get("HIGHSIDE_SOAK_S", "60"))
LAG_MS = 20.0 if SECONDS > 60 else 500.0
"""99.9 % of the stalls of the event loop are shorter: 20 ms is what the CAN socket's buffer bridges at 9,000
frames/s; ten times that in the short form, whose machine may be busy"""
SERIAL_RATE = 3840
CAN_RATE = 9000

SENDER = """
import sys, time
from highside.link.device import DeviceSettings, SimulatedDevice
from highside.link.wire import PtyWire
from pathlib import Path
link, rate, seconds = Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
device = SimulatedDevice(DeviceSettings(rate_hz=rate, gyros=False, temp_c=None), PtyWire(link))
device.wire.plug()
print("plugged", flush=True)
sys.stdin.readline()
device.start()
time.sleep(seconds)
while device.produced < rate * seconds:
    time.sleep(0.01)
device._stop.set(); device._thread.join()
end = time.monotonic() + 20
while device.wire.pending and time.monotonic() < end:
    device.step(0); time.sleep(0.01)
print(device.sent, flush=True)
sys.stdin.readline()
"""


@pytest.mark.timeout(180 + 2 * SECONDS)
def test_a_minute_at_3840_frames_a_second_over_a_pty_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "soak.toml"
    port = tmp_path / "tty"
    with Mosquitto(tmp_path / "broker") as broker:
        path.write_text(
            f'[tool]\nid = "soak"\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "tool"\n'
            f'[mqtt]\nport = {broker.port}\n[service]\nstate_dir = "{tmp_path / "state"}"\nhealth_interval_s = 0.5\n'
        )
        subscriber = Subscriber(broker.port)
        sender = subprocess.Popen(
            [sys.executable, "-c", SENDER, str(port), str(SERIAL_RATE), str(SECONDS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert sender.stdin is not None
        assert sender.stdout is not None
        try:
            assert sender.stdout.readline().strip() == "plugged"
            with running(path) as daemon:
                wait_for(
                    lambda: (h := subscriber.latest("health")) and h["link"]["opens"] >= 1,
                    20,
                    "the link to open",
                    daemon,
                )
                process = psutil.Process(daemon.process.pid)
                sender.stdin.write("go\n")
                sender.stdin.flush()
                time.sleep(min(SECONDS / 3, 15))
                rss_start, cpu_start, wall_start = process.memory_info().rss, process.cpu_times(), time.monotonic()
                sent = int(sender.stdout.readline())
                rss_end, cpu_end, wall_end = process.memory_info().rss, process.cpu_times(), time.monotonic()

                def counted():
                    health = subscriber.latest("health")
                    return health and health["monitor"]["received"] >= sent and health

                health = wait_for(counted, 20, f"{sent} frames", daemon)
                assert daemon.terminate() == 0, daemon.log
        finally:
            sender.kill()
            sender.wait()
            subscriber.close()
    cpu = (cpu_end.user + cpu_end.system - cpu_start.user - cpu_start.system) / (wall_end - wall_start)
    drift = (rss_end - rss_start) / 2**20
    print(
        f"serial: {sent} frames, rss {rss_start / 2**20:.1f} MiB {drift:+.2f} MiB, cpu {cpu:.2f} of one core,"
        f" {SERIAL_RATE / cpu:.0f} frames/s per core, loop lag p99.9 {health['loop']['lag_p999_ms']} ms"
        f" max {health['loop']['lag_max_ms']} ms"
    )
    assert health["loop"]["lag_p999_ms"] < LAG_MS
    assert health["monitor"]["good"] == sent
    assert health["monitor"]["gap"] == health["monitor"]["duplicate"] == 0
    assert health["codec"]["bytes_junk"] == health["codec"]["bytes_bad"] == 0
    assert all(health["balance"].values()), health["balance"]
    assert health["recorder"]["bytes_dropped"] == 0
    assert sent >= 0.9 * SERIAL_RATE * SECONDS
    assert drift < 5.0
    seqs = sorted(p["seq"] for p in subscriber.payloads("attitude"))
    assert seqs == list(range(len(seqs)))


@pytest.mark.timeout(180 + 2 * SECONDS)
async def test_a_minute_at_9000_can_frames_a_second_loses_nothing(tmp_path: Path) -> None:
    import can

    from highside.config.settings import validate
    from highside.link.device import DeviceSettings, encode_can
    from highside.link.device import SimulatedDevice as Device
    from highside.service.app import Service

    settings = validate(
        {
            "tool": {"id": "soak"},
            "link": {"kind": "python-can", "interface": "virtual", "channel": "soak", "wait_at_start": True},
            "codec": {"name": "dbc"},
            "mqtt": {"port": 1},
            "service": {"state_dir": str(tmp_path / "state")},
        },
        where="the test",
    )
    service = Service(settings)
    serving = asyncio.create_task(service.run())
    while not service.supervisor.stats.opens:
        await asyncio.sleep(0.01)

    # the frames of a real reading cycle, made beforehand: the sender must not compete for the interpreter
    class NoWire:
        address = ""
        pending = 0

    device = Device(DeviceSettings(rate_hz=1000.0), NoWire(), encode_can)  # type: ignore[arg-type]
    readings = [encode_can(frame) for frame in device.frames(4096)]
    per_reading = len(readings[0])
    cycle = [
        can.Message(arbitration_id=f.can_id, data=f.data, is_extended_id=f.extended) for cf in readings for f in cf
    ]
    counts = {"sent": 0}

    def send() -> None:
        with can.Bus(interface="virtual", channel="soak") as bus:
            start = time.monotonic()
            while (elapsed := time.monotonic() - start) < SECONDS:
                due = int(elapsed * CAN_RATE)
                while counts["sent"] < due:
                    bus.send(cycle[counts["sent"] % len(cycle)])
                    counts["sent"] += 1
                time.sleep(0.005)

    thread = threading.Thread(target=send)
    process = psutil.Process()
    cpu_start = process.cpu_times()
    thread.start()
    await asyncio.sleep(min(SECONDS / 3, 15))
    gc.collect()
    rss_start = process.memory_info().rss
    while thread.is_alive():
        await asyncio.sleep(0.1)
    gc.collect()
    rss_end, cpu_end = process.memory_info().rss, process.cpu_times()
    for _ in range(200):
        if service.supervisor.stats.can_frames == counts["sent"]:
            break
        await asyncio.sleep(0.05)
    health = service.health()
    service.stop()
    await serving
    cpu = (cpu_end.user + cpu_end.system - cpu_start.user - cpu_start.system) / SECONDS
    print(
        f"can: {counts['sent']} frames ({per_reading} a reading), rss {(rss_end - rss_start) / 2**20:+.2f} MiB,"
        f" cpu {cpu:.2f} of one core with the sender, loop lag p99.9 {health.loop['lag_p999_ms']} ms"
        f" max {health.loop['lag_max_ms']} ms"
    )
    assert health.loop["lag_p999_ms"] < LAG_MS
    assert counts["sent"] >= 0.9 * CAN_RATE * SECONDS
    assert service.supervisor.stats.can_frames == counts["sent"]
    assert abs(health.monitor["received"] - counts["sent"] // per_reading) <= 1
    assert health.codec["frames_bad"] == 0
    assert all(health.balance.values())
    assert health.recorder is not None
    assert health.recorder["bytes_dropped"] == 0
    assert (rss_end - rss_start) / 2**20 < 5.0
