"""What the watch costs the live service: two daemons on the same frames at the same time, one with it, one without.

    python -m tests.bench.watch_cost [--rates 100 3840] [--seconds 120] [--json]

Each gets a pty on which the same frames with gyros are written, and both a real mosquitto; both have the same record in
force. The tool rests and turns at 60 rpm, half a minute each: a stretch ends, and its sums are made, each half minute,
more often than in any hole. CPU is the run time of all threads by the scheduler's account. Ends with
status 1 where there is no mosquitto, where a daemon lost frames, or where the watch has used nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import highside
from highside.codec.tool import encode
from tests.bench.live_cost import cpu_s
from tests.integration.broker import MOSQUITTO, Mosquitto
from tests.integration.daemon import HIGHSIDE, Pty, Subscriber
from tests.unit.watch_frames import poses_of_a_good_tool

PERIOD_S, TURN_DPS, INC_RAD = 30.0, 360.0, math.radians(30.0)
BATCH_S = 0.01
TOOLS = ("without", "with")
START_S = 60.0


class Device(threading.Thread):
    """Writes the frames that are due to every pty, a batch each hundredth of a second."""

    def __init__(self, lines: list[Pty], rate_hz: float) -> None:
        super().__init__(daemon=True)
        self.lines, self.rate, self.ending, self.sent = lines, rate_hz, threading.Event(), 0

    def run(self) -> None:
        begin, rng, tf, k = time.monotonic(), random.Random(1), 0.3, 0
        s, c, step = math.sin(INC_RAD), math.cos(INC_RAD), 1.0 / self.rate
        while not self.ending.is_set():
            due = int((time.monotonic() - begin) * self.rate)
            data = bytearray()
            for k in range(self.sent, due):
                turning = (k * step) % (2.0 * PERIOD_S) >= PERIOD_S
                tf += math.radians(TURN_DPS) * step * turning
                noise = (rng.random() - 0.5) * 6e-4
                a = (s * math.cos(tf) + noise, s * math.sin(tf) - noise, c + noise)
                data += encode(k, k * step, a, gyro_dps=(0.0, 0.0, -TURN_DPS * turning), temp_c=25.0)
            for line in self.lines:
                line.write_all(bytes(data))
            self.sent = due
            time.sleep(BATCH_S)


def measure(folder: Path, broker: Mosquitto, records: Path, rate_hz: float, seconds: float) -> dict[str, Any]:
    """CPU of both at one rate, and what the watch used meanwhile."""
    folder.mkdir(parents=True)
    lines = {name: Pty() for name in TOOLS}
    ears = {name: Subscriber(broker.port, f"highside/{name}/health") for name in lines}
    processes: dict[str, subprocess.Popen[bytes]] = {}
    device = Device(list(lines.values()), rate_hz)
    try:
        for name, line in lines.items():
            config = folder / f"{name}.toml"
            config.write_text(
                f'[tool]\nid = "{name}"\n[link]\nkind = "serial"\nport = "{line.path}"\n[codec]\nname = "tool"\n'
                f'[mqtt]\nport = {broker.port}\n[service]\nstate_dir = "{folder / name}"\n[recorder]\nenabled = false\n'
                f'[calibration]\nrecord = "{records / name}.json"\n[watch]\nenabled = {str(name == "with").lower()}\n'
            )
            with (folder / f"{name}.log").open("wb") as log:
                command = [str(HIGHSIDE), "run", "--config", str(config)]
                processes[name] = subprocess.Popen(command, stdout=log, stderr=log)
        deadline = time.monotonic() + START_S
        while not all(ear.payloads("health") for ear in ears.values()) and time.monotonic() < deadline:
            time.sleep(0.1)
        device.start()
        time.sleep(3.0)
        before, begun = {name: cpu_s(one.pid) for name, one in processes.items()}, time.monotonic()
        time.sleep(seconds)
        cpu = {name: cpu_s(one.pid) - before[name] for name, one in processes.items()}
        lasted = time.monotonic() - begun
        sent = device.sent
        device.ending.set()
        time.sleep(6.0)  # the next health message
        health = {name: ears[name].payloads("health")[-1] for name in ears}
    finally:
        device.ending.set()
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            process.wait(15)
        for ear in ears.values():
            ear.close()
        for line in lines.values():
            line.close()
    watch = health["with"]["watch"]
    return {
        "frames_per_s": round(sent / (lasted + 3.0), 1),
        "cpu_percent": {name: round(100.0 * value / lasted, 3) for name, value in cpu.items()},
        "ratio": round(cpu["with"] / cpu["without"], 4),
        "beyond_percent_of_a_core": round(100.0 * (cpu["with"] - cpu["without"]) / lasted, 3),
        "lost": {name: device.sent - one["monitor"]["received"] for name, one in health.items()},
        "stills": watch["stills"],
        "turns": watch["turns"],
        "dropped": watch["dropped"],
        "stall_p999_ms": {name: one["loop"].get("lag_p999_ms") for name, one in health.items()},
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 3840.0])
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if MOSQUITTO is None:
        print("no mosquitto on this machine", file=sys.stderr)
        return 1
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="watch-cost-") as name:
        folder = Path(name)
        for tool in TOOLS:
            highside.calibrate(poses_of_a_good_tool(1), "joint", tool=tool, temp_c=25.0).save(folder / f"{tool}.json")
        with Mosquitto(folder / "broker") as broker:
            for rate in options.rates:
                found[f"{rate:g}"] = measure(folder / f"{rate:g}", broker, folder, rate, options.seconds)
    if options.json:
        print(json.dumps(found))
    else:
        for rate_name, one in found.items():
            print(f"{rate_name} frames/s: {one}")
    good = all(not any(one["lost"].values()) and one["stills"] + one["turns"] for one in found.values())
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
