"""What a tool costs beside others in one process (`[[tools]]`), and in a process of its own.

    python -m tests.bench.many_tools [--tools 30] [--seconds 20]

Every tool has a pty on which 100 frames a second are written, and all one real mosquitto. First one process has them
all, then each has its own. CPU is that of all threads by the scheduler's account, memory what the process has for
itself (`Private_*` of /proc/PID/smaps_rollup). A frame that did not arrive, or a message that was not acknowledged, is
counted and ends this with status 1. At last one process has them all again while three of them have a fault each: the
line of the first is pulled, the second cannot write its recordings, the broker of the third is killed and begun anew.
What the others lose by it is counted in the same way; the second and third must lose nothing either.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from highside.codec.tool import encode
from tests.integration.broker import Mosquitto
from tests.integration.daemon import Daemon, Pty, Subscriber

FRAMES_PER_S = 100.0
START_S = 180.0
SETTLE_S = 5.0
LINK = 'kind = "serial"\nport = "{line}"\nstale_after_s = 0\nreopen_after_s = 3600\n'
DRAIN_S = 60.0
"""What a busy machine may need for what it has not done yet."""


class Device(threading.Thread):
    """Writes one frame to every pty at each hundredth of a second."""

    def __init__(self, lines: list[Pty]) -> None:
        super().__init__(daemon=True)
        self.lines, self.sent, self.ending = lines, 0, threading.Event()

    def run(self) -> None:
        begin, seed = time.monotonic(), 1
        while not self.ending.is_set():
            wait = begin + self.sent / FRAMES_PER_S - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            seed = (seed * 1103515245 + 12345) % 2**31
            noise = (seed / 2**31 - 0.5) * 3e-4
            a = (0.35355339 + noise, 0.35355339 - noise, 0.8660254)
            frame = encode(self.sent % 65536, self.sent / FRAMES_PER_S, a, temp_c=25.0)
            for line in self.lines:
                line.write_all(frame)
            self.sent += 1


def cpu_s(pid: int) -> float:
    """Run time of all threads."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9


def private_mib(pid: int) -> float:
    rows = (row.split() for row in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:])
    return sum(int(row[1]) for row in rows if row[0].startswith("Private_")) / 1024


def measured(files: list[Path], ids: list[str], lines: list[Pty], broker: Mosquitto, seconds: float) -> int:
    """One way to run the tools, a line printed; how many frames and messages were lost."""
    heard = Subscriber(broker.port, "highside/+/health")
    daemons = [Daemon(path) for path in files]
    device = Device(lines)

    def health() -> dict[str, dict]:
        found = {}
        for topic, payload, retained, _ in heard.drain():
            if not retained:
                found[topic.split("/")[1]] = json.loads(payload)
        return found

    try:
        until = time.monotonic() + START_S
        while sum(one["link"]["opens"] >= 1 for one in health().values()) < len(ids):
            if time.monotonic() > until or any(daemon.process.poll() is not None for daemon in daemons):
                raise SystemExit("not all tools began:\n" + daemons[0].log[-2000:])
            time.sleep(0.2)
        device.start()
        time.sleep(SETTLE_S)
        pids = [daemon.process.pid for daemon in daemons]
        before, began = sum(map(cpu_s, pids)), time.monotonic()
        time.sleep(seconds)
        used, passed = sum(map(cpu_s, pids)) - before, time.monotonic() - began
        memory = sum(map(private_mib, pids))
        device.ending.set()
        device.join()
        until = time.monotonic() + DRAIN_S
        last = health()
        while time.monotonic() < until and any(
            one["outbox"]["queued"] or one["monitor"]["received"] < device.sent for one in last.values()
        ):
            time.sleep(0.5)
            last = health()
        frames = [device.sent - last[one]["monitor"]["received"] for one in ids]
        waiting = sum(last[one]["outbox"]["queued"] for one in ids)
        held = max(last[one]["loop"]["p99_ms"] for one in ids) if "p99_ms" in last[ids[0]].get("loop", {}) else None
        way = "one process" if len(files) == 1 else f"{len(files)} processes"
        print(
            f"{way}: {len(ids)} tools, {device.sent} frames each, lost {sum(map(abs, frames))}, waiting {waiting};"
            f" CPU {100 * used / passed / len(ids):.2f} % of a core and {memory / len(ids):.1f} MiB of its own a tool"
            + (f", loop held {held:.0f} ms (p99 of the worst)" if held is not None else "")
        )
        return sum(map(abs, frames)) + waiting
    finally:
        device.ending.set()
        for daemon in daemons:
            daemon.process.terminate()
        for daemon in daemons:
            daemon.process.wait(60)
            daemon.close()
        heard.close()


def faulty(folder: Path, ids: list[str], lines: list[Pty], broker: Mosquitto, other: Mosquitto, seconds: float) -> int:
    """Three tools with a fault each beside the others in one process: how many frames and messages were lost."""
    (folder / "faulty" / ids[1]).mkdir(parents=True)
    (folder / "faulty" / ids[1] / "recordings").write_text("in the way")
    path = folder / "faulty.toml"
    tables = []
    for i, line in zip(ids, lines, strict=True):
        port = other.port if i == ids[2] else broker.port
        tables.append(f'[[tools]]\nid = "{i}"\nmqtt = {{ port = {port} }}\n[tools.link]\n{LINK.format(line=line.path)}')
    head = f'[codec]\nname = "tool"\n[service]\nhealth_interval_s = 2\nstate_dir = "{folder}/faulty"\n'
    path.write_text(head + "".join(tables))
    heard = [Subscriber(where.port, "highside/#") for where in (broker, other)]
    daemon, device = Daemon(path), Device(lines)
    numbers: dict[str, set[int]] = {i: set() for i in ids}
    last: dict[str, dict] = {}

    def listen() -> None:
        for topic, payload, retained, _ in (message for one in heard for message in one.drain()):
            _, tool, kind = topic.split("/")[:3]
            if kind == "attitude":
                numbers[tool].add(json.loads(payload)["seq"])
            elif kind == "health" and not retained:
                last[tool] = json.loads(payload)

    def until(true: Callable[[], bool], limit_s: float) -> bool:
        end = time.monotonic() + limit_s
        while not true() and time.monotonic() < end:
            time.sleep(0.2)
            listen()
        return true()

    try:
        if not until(lambda: len(last) == len(ids) and all(one["link"]["opens"] for one in last.values()), START_S):
            raise SystemExit("not all tools began:\n" + daemon.log[-2000:])
        device.start()
        until(lambda: False, seconds / 4)
        device.lines = lines[1:]  # nothing is written to what is pulled
        lines[0].close()
        other.kill()
        until(lambda: False, seconds / 2)
        other.start()
        until(lambda: False, seconds / 4)
        device.ending.set()
        device.join()
        rest = ids[1:]
        until(lambda: all(_arrived(last[i], device.sent) for i in rest), DRAIN_S)
        untouched = ids[3:]
        lost = sum(abs(device.sent - last[i]["monitor"]["received"]) for i in rest)
        gaps = sum(max(numbers[i]) + 1 - len(numbers[i]) for i in untouched)
        again = sum(last[i]["link"]["opens"] - 1 for i in untouched)
        waiting = sum(last[i]["outbox"]["queued"] for i in rest)
        outbox = last[ids[2]]["outbox"]
        dropped = sum(outbox["dropped"].values())
        print(
            f"three faults: {lost} frames lost and {waiting} messages waiting, of all but the pulled one; of the "
            f"{len(untouched)} others {gaps} numbers missing, {again} links opened again; the one without a broker "
            f"produced {outbox['produced']}, acknowledged {outbox['acknowledged']}, dropped {dropped}"
        )
        return lost + gaps + again + waiting + dropped
    finally:
        device.ending.set()
        daemon.process.terminate()
        daemon.process.wait(60)
        daemon.close()
        for one in heard:
            one.close()


def _arrived(health: dict, sent: int) -> bool:
    return health["monitor"]["received"] == sent and not health["outbox"]["queued"]


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    asked.add_argument("--tools", type=int, default=30)
    asked.add_argument("--seconds", type=float, default=20.0)
    options = asked.parse_args()
    with tempfile.TemporaryDirectory() as name, Mosquitto(Path(name) / "broker") as broker:
        folder = Path(name)
        lines = [Pty() for _ in range(options.tools)]
        ids = [f"t{i}" for i in range(options.tools)]
        rest = f'[codec]\nname = "tool"\n[mqtt]\nport = {broker.port}\n[service]\nhealth_interval_s = 2\n'
        links = [LINK.format(line=line.path) for line in lines]
        one = folder / "one.toml"
        entries = [f'[[tools]]\nid = "{i}"\n[tools.link]\n{link}' for i, link in zip(ids, links, strict=True)]
        one.write_text(rest + f'state_dir = "{folder}/one"\n' + "".join(entries))
        each = []
        for i, link in zip(ids, links, strict=True):
            path = folder / f"{i}.toml"
            path.write_text(f'[tool]\nid = "{i}"\n[link]\n{link}{rest}state_dir = "{folder}/each/{i}"\n')
            each.append(path)
        lost = measured([one], ids, lines, broker, options.seconds)
        lost += measured(each, ids, lines, broker, options.seconds)
        with Mosquitto(folder / "other") as other:
            lost += faulty(folder, ids, lines, broker, other, options.seconds)
    sys.exit(1 if lost else 0)


if __name__ == "__main__":
    main()
