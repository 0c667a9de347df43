"""At the ceilings: 3,840 frames/s over a pty, 9,000 CAN frames/s over python-can's virtual bus.

The sender is a process of its own for the pty (as a tool is), a thread for the virtual bus, which lives in the process.
Frames are counted, the memory is watched after a warm-up, the stall of the event loop is reported. `HIGHSIDE_SOAK_S`
sets the length: half a minute here, one in `make evidence`, two in `make faults`.

Where it may, the long form gives the service real-time priority, as the unit may be told to: it is to measure what the
service does, and not who else was given the processor.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from broker import Mosquitto
from daemon import Subscriber, running, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timing]

SECONDS = float(os.environ.get("HIGHSIDE_SOAK_S", "30"))
LONG = SECONDS > 60
OWN_MS = 20.0 if LONG else 50.0
"""99.9 % of the stalls of the event loop, as far as the process itself has computed meanwhile, are shorter: 20 ms is
what the CAN socket's buffer bridges at 9,000 frames/s. It is 3.5 to 17 ms on an idle machine (five
runs, median 8.5). In the short form about six times that: what came while the machine stood still is worked off in one
go (24.5 ms after 109 ms, once).
"""
OWN_WITH_SENDER_MS = 50.0
"""The same where the sender is a thread of the process: what it sends in one go, and the reader takes in one go, after
the machine has run somebody else for 100 ms (25 ms at a load of 12 on two processors)."""
LAG_MS = 20.0 if LONG else 150.0
"""The same, whoever had the processor. The short form's machine may be busy: ten times what is expected of one that is
shared with one other job."""
SERIAL_RATE = 3840
CAN_RATE = 9000


def given_priority(pid: int = 0) -> str:
    """Real-time priority for all threads of a process (0: this one), and for what they start; returns how it runs."""
    if not LONG:
        return "at usual priority"
    try:
        for task in Path(f"/proc/{pid or 'self'}/task").iterdir():
            with contextlib.suppress(ProcessLookupError):
                os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return "at usual priority: no right to set another"
    return "at real-time priority"


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
def test_a_while_at_3840_frames_a_second_over_a_pty_loses_nothing(tmp_path: Path) -> None:
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
                runs = given_priority(daemon.process.pid)
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
        f"serial, {runs}: {sent} frames, rss {rss_start / 2**20:.1f} MiB {drift:+.2f} MiB, cpu {cpu:.2f} of one core,"
        f" {SERIAL_RATE / cpu:.0f} frames/s per core, loop lag p99.9 {health['loop']['lag_p999_ms']} ms"
        f" max {health['loop']['lag_max_ms']} ms, p99.9 of its own {health['loop']['own_p999_ms']} ms"
    )
    assert health["loop"]["own_p999_ms"] < OWN_MS
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


CAN_DAEMON = """
import asyncio, json, sys, threading, time
from pathlib import Path
import can, psutil
from highside.config.settings import validate
from highside.link.device import DeviceSettings, SimulatedDevice, encode_can
from highside.service.app import Service
from highside.service.interpreter import settle_interpreter

state, rate, seconds = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
settings = validate(
    {
        "tool": {"id": "soak"},
        "link": {"kind": "python-can", "interface": "virtual", "channel": "soak", "wait_at_start": True},
        "codec": {"name": "dbc"},
        "mqtt": {"port": 1},
        "service": {"state_dir": state},
    },
    where="the test",
)

class NoWire:
    address, pending = "", 0

# the frames of a real reading cycle, made beforehand: the sender must not compete for the interpreter
device = SimulatedDevice(DeviceSettings(rate_hz=1000.0), NoWire(), encode_can)
readings = [encode_can(frame) for frame in device.frames(4096)]
cycle = [can.Message(arbitration_id=f.can_id, data=f.data, is_extended_id=f.extended) for cf in readings for f in cf]
sent = 0

def send():
    global sent
    with can.Bus(interface="virtual", channel="soak") as bus:
        start = time.monotonic()
        while (elapsed := time.monotonic() - start) < seconds:
            # what was missed on a busy machine is made up for in steps, not in one that keeps the interpreter
            due = min(int(elapsed * rate), sent + int(0.02 * rate))
            while sent < due:
                bus.send(cycle[sent % len(cycle)])
                sent += 1
            time.sleep(0.005)

async def main():
    service = Service(settings)
    settle_interpreter()  # as `highside run`
    serving = asyncio.create_task(service.run())
    while not service.supervisor.stats.opens:
        await asyncio.sleep(0.01)
    process = psutil.Process()
    cpu_start = process.cpu_times()
    thread = threading.Thread(target=send)
    thread.start()
    await asyncio.sleep(min(seconds / 3, 15))
    rss_start = process.memory_info().rss
    while thread.is_alive():
        await asyncio.sleep(0.1)
    rss_end, cpu_end = process.memory_info().rss, process.cpu_times()
    for _ in range(200):
        if service.supervisor.stats.can_frames == sent:
            break
        await asyncio.sleep(0.05)
    health = service.health()
    can_frames = service.supervisor.stats.can_frames
    service.stop()
    await serving
    print(json.dumps({
        "sent": sent, "per_reading": len(readings[0]), "can_frames": can_frames,
        "health": json.loads(health.model_dump_json()),
        "drift_mib": (rss_end - rss_start) / 2**20,
        "cpu": (cpu_end.user + cpu_end.system - cpu_start.user - cpu_start.system) / seconds,
    }))

asyncio.run(main())
"""
"""The service in a process of its own, as `highside run` has it: the heap of a test runner is ten times as large, and
the collector's looks at it would be measured. The virtual bus lives in one process, so the sender is a thread of it."""


@pytest.mark.timeout(180 + 2 * SECONDS)
def test_a_while_at_9000_can_frames_a_second_loses_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", CAN_DAEMON, str(tmp_path / "state"), str(CAN_RATE), str(SECONDS)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as daemon:
        runs = given_priority(daemon.pid)
        printed, said = daemon.communicate()
    assert daemon.returncode == 0, said[-3000:]
    found = json.loads(printed)
    health, sent = found["health"], found["sent"]
    print(
        f"can, {runs}: {sent} frames ({found['per_reading']} a reading), rss {found['drift_mib']:+.2f} MiB,"
        f" cpu {found['cpu']:.2f} of one core with the sender, loop lag p99.9 {health['loop']['lag_p999_ms']} ms"
        f" max {health['loop']['lag_max_ms']} ms, p99.9 of its own {health['loop']['own_p999_ms']} ms"
    )
    assert health["loop"]["own_p999_ms"] < OWN_WITH_SENDER_MS
    assert health["loop"]["lag_p999_ms"] < LAG_MS
    assert sent >= 0.9 * CAN_RATE * SECONDS
    assert found["can_frames"] == sent
    assert abs(health["monitor"]["received"] - sent // found["per_reading"]) <= 1
    assert health["codec"]["frames_bad"] == 0
    assert all(health["balance"].values())
    assert health["recorder"]["bytes_dropped"] == 0
    assert found["drift_mib"] < 5.0
