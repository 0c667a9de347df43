"""What the live service costs beside a script that only reads, averages and publishes: CPU, latency, wear of the disk.

    python -m tests.bench.live_cost [--seconds 30] [--recorder] [--away] [--json]

Each gets a pty on which the same 100 frames a second are written, and both a real mosquitto; they run at the same time,
so that a busy machine hurts both. CPU is the run time of all threads by the scheduler's account; latency is from the
write of the frame that completes a message (its device time tells which one that was) to its arrival at a subscriber;
bytes are those that the process caused to be written (`write_bytes` of /proc/PID/io: whole pages of 4 KiB), the
recordings apart. `--away` measures the bytes with no broker there, when every message is kept on the disk. Ends with
status 1 where there is no mosquitto: a benchmark that measures nothing has failed.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from highside.codec.tool import encode
from highside.service.outbox_inspect import inspect
from tests.integration.broker import MOSQUITTO, Mosquitto, free_port
from tests.integration.daemon import HIGHSIDE, Pty, Subscriber

FRAMES_PER_S = 100.0
START_S = 60.0
SETTLE_S = 3.0
"""Not measured, after the first messages of both."""
A = (0.35355339, 0.35355339, 0.8660254)


class Device(threading.Thread):
    """Writes frame k to every pty at `begin + k / rate`; `written` tells when it really did."""

    def __init__(self, lines: list[Pty]) -> None:
        super().__init__(daemon=True)
        self.lines, self.written, self.ending = lines, [0.0], threading.Event()
        self.seed = 1

    def run(self) -> None:
        begin = time.monotonic()
        while not self.ending.is_set():
            k = len(self.written)
            wait = begin + k / FRAMES_PER_S - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            # cheap noise of about 1e-4 g: what a still tool shows
            self.seed = (self.seed * 1103515245 + 12345) % 2**31
            noise = (self.seed / 2**31 - 0.5) * 3e-4
            frame = encode(k % 65536, k / FRAMES_PER_S, (A[0] + noise, A[1] - noise, A[2]), temp_c=25.0)
            self.written.append(time.monotonic())
            for line in self.lines:
                line.write_all(frame)


def cpu_s(pid: int) -> float:
    """Run time of all threads, s."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        total += int((task / "schedstat").read_text().split()[0])
    return total * 1e-9


def written_bytes(pid: int) -> int:
    lines = Path(f"/proc/{pid}/io").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("write_bytes"))


def switches(pid: int) -> int:
    """Times that a thread went to sleep of its own will: each is a wake-up."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        lines = (task / "status").read_text().splitlines()
        total += next(int(line.split()[1]) for line in lines if line.startswith("voluntary"))
    return total


def heard(subscriber: Subscriber) -> bool:
    return any(topic.endswith("/attitude") for topic, *_ in subscriber.drain())


def measure(folder: Path, broker: Mosquitto, rate_hz: float, seconds: float, *, recorder: bool) -> dict[str, Any]:
    """Both at one message rate; figures of each."""
    folder.mkdir(parents=True)
    lines = {"script": Pty(), "highside": Pty()}
    config = folder / "highside.toml"
    config.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{lines["highside"].path}"\n[codec]\nname = "tool"\n'
        f'[mqtt]\nport = {broker.port}\n[service]\nstate_dir = "{folder / "state"}"\n'
        f"[pipeline]\noutput_rate_hz = {rate_hz}\n[recorder]\nenabled = {str(recorder).lower()}\n"
    )
    peer = Path(__file__).with_name("live_peer.py")
    commands = {
        "script": [sys.executable, str(peer), lines["script"].path, str(broker.port), str(rate_hz)],
        "highside": [str(HIGHSIDE), "run", "--config", str(config)],
    }
    subscribers = {"script": Subscriber(broker.port, "peer/#"), "highside": Subscriber(broker.port, "highside/#")}
    processes: dict[str, subprocess.Popen[bytes]] = {}
    device = Device(list(lines.values()))
    try:
        for name, command in commands.items():
            with (folder / f"{name}.log").open("wb") as log:
                processes[name] = subprocess.Popen(command, stdout=log, stderr=log)
        time.sleep(2.0)
        device.start()
        deadline = time.monotonic() + START_S
        while not all(heard(subscriber) for subscriber in subscribers.values()) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(SETTLE_S)
        before = {name: _state(process.pid) for name, process in processes.items()}
        first = len(device.written)
        time.sleep(seconds)
        after = {name: _state(process.pid) for name, process in processes.items()}
        last = len(device.written)
        time.sleep(0.5)
    finally:
        device.ending.set()
        for process in processes.values():
            process.send_signal(signal.SIGTERM)
            process.wait(20.0)
        for line in lines.values():
            line.close()
        for subscriber in subscribers.values():
            subscriber.close()
    found = {}
    for name, subscriber in subscribers.items():
        delays = []
        for topic, payload, _, arrived in subscriber.drain():
            if topic.endswith("/attitude"):
                k = round(json.loads(payload)["t_device_s"] * FRAMES_PER_S)
                if first <= k < last:
                    delays.append((arrived - device.written[k]) * 1e3)
        cpu, io, woken = (b - a for a, b in zip(before[name], after[name], strict=True))
        if not delays:
            said = (folder / f"{name}.log").read_text()[-500:]
            raise SystemExit(f"{name}: no message arrived, nothing was measured: {said}")
        found[name] = figures(delays, cpu / seconds, io, woken / seconds)
    return found


def measure_away(folder: Path, rate_hz: float, seconds: float) -> dict[str, float]:
    """Bytes written a message while no broker is there; as many messages as come in `seconds`."""
    folder.mkdir(parents=True)
    line = Pty()
    config, state = folder / "highside.toml", folder / "state"
    config.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{line.path}"\n[codec]\nname = "tool"\n'
        f'[mqtt]\nport = {free_port()}\n[service]\nstate_dir = "{state}"\n'
        f"[pipeline]\noutput_rate_hz = {rate_hz}\n[recorder]\nenabled = false\n"
    )
    with (folder / "highside.log").open("wb") as log:
        process = subprocess.Popen([str(HIGHSIDE), "run", "--config", str(config)], stdout=log, stderr=log)
    device = Device([line])
    outbox = state / "outbox.sqlite"
    try:
        time.sleep(2.0)
        device.start()
        deadline = time.monotonic() + START_S
        while not (outbox.exists() and inspect(outbox).queued) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(SETTLE_S)
        queued, written = inspect(outbox).queued, written_bytes(process.pid)
        time.sleep(seconds)
        queued, written = inspect(outbox).queued - queued, written_bytes(process.pid) - written
    finally:
        device.ending.set()
        process.send_signal(signal.SIGTERM)
        process.wait(20.0)
        line.close()
    if queued <= 0:
        raise SystemExit(f"no message was kept, nothing was measured: {(folder / 'highside.log').read_text()[-500:]}")
    return {
        "messages": queued,
        "bytes_per_message": written / queued,
        "bytes_per_day": written / queued * rate_hz * 86400,
    }


def _state(pid: int) -> tuple[float, int, int]:
    return cpu_s(pid), written_bytes(pid), switches(pid)


def figures(delays_ms: list[float], cpu: float, written: int, wakes_per_s: float) -> dict[str, float]:
    ordered = sorted(delays_ms)
    return {
        "messages": len(ordered),
        "cpu_percent": 100.0 * cpu,
        "wakes_per_s": wakes_per_s,
        "p50_ms": statistics.median(ordered),
        "p99_ms": ordered[min(int(0.99 * len(ordered)), len(ordered) - 1)],
        "bytes_per_message": written / len(ordered),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 100.0])
    parser.add_argument("--recorder", action="store_true", help="with the recordings, which write to the disk as well")
    parser.add_argument("--away", action="store_true", help="the bytes alone, with no broker to take the messages")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.away:
        away(options.rates, options.seconds, as_json=options.json)
        return
    if MOSQUITTO is None:
        raise SystemExit("needs mosquitto (apt-get install mosquitto): nothing was measured")
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="live_cost.", dir=os.environ.get("TMPDIR")) as folder:
        for rate_hz in options.rates:
            with Mosquitto(Path(folder) / f"broker{rate_hz:g}") as broker:
                where = Path(folder) / f"{rate_hz:g}"
                found = measure(where, broker, rate_hz, options.seconds, recorder=options.recorder)
            ratio = found["highside"]["cpu_percent"] / found["script"]["cpu_percent"]
            per_day = found["highside"]["bytes_per_message"] * rate_hz * 86_400.0
            results[f"{rate_hz:g}"] = {**found, "cpu_ratio": ratio, "bytes_per_day": per_day}
            if not options.json:
                report(rate_hz, found, ratio, per_day)
    if options.json:
        print(json.dumps(results, indent=1))


def away(rates: list[float], seconds: float, *, as_json: bool) -> None:
    results = {}
    with tempfile.TemporaryDirectory(prefix="live_cost.", dir=os.environ.get("TMPDIR")) as folder:
        for rate_hz in rates:
            results[f"{rate_hz:g}"] = found = measure_away(Path(folder) / f"{rate_hz:g}", rate_hz, seconds)
            if not as_json:
                print(
                    f"no broker, {rate_hz:g} messages/s: {found['bytes_per_message']:,.0f} bytes written a message"
                    f" ({found['messages']:.0f} messages), {found['bytes_per_day'] / 1e6:,.1f} MB a day"
                )
    if as_json:
        print(json.dumps(results, indent=1))


def report(rate_hz: float, found: dict[str, dict[str, float]], ratio: float, per_day: float) -> None:
    print(f"{FRAMES_PER_S:g} frames/s, {rate_hz:g} messages/s: CPU {ratio:.2f} times the script's")
    for name, values in found.items():
        print(
            f"  {name:9} {values['cpu_percent']:5.2f} % of a core, {values['wakes_per_s']:5.0f} wake-ups/s,"
            f" latency p50 {values['p50_ms']:5.2f} p99 {values['p99_ms']:6.2f} ms,"
            f" {values['bytes_per_message']:7,.0f} bytes written a message ({values['messages']:.0f} messages)"
        )
    print(f"  highside writes {per_day / 1e6:,.1f} MB a day")


if __name__ == "__main__":
    main()
