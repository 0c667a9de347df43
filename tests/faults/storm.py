"""All faults at once, at 3,840 frames a second: nothing is lost, and the books balance to the byte.

The broker is killed, configurations of every bad kind are loaded, the cable is pulled, noise comes in, the process is
stopped, SIGHUP comes in bursts, the wall clock is set by an hour, a day and a month (libfaketime), the disk is full. At
the end each frame that the tool sent is in the accounts, and each attitude is at the subscriber.
"""

from __future__ import annotations

import contextlib
import os
import random
import resource
import signal
import socket
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
from rig import Checks, Gate, Row, Tool, books, configuration
from scenarios import delivered, health_of, rising

from bad_reloads import bad_files  # isort: skip
from daemon import Daemon, Subscriber, running, wait_for  # isort: skip
from test_clock_steps import Wall  # isort: skip

RATE_HZ = 3840.0
HOUR, DAY = 3600, 86_400
STEPS_S = (HOUR, 0, -HOUR, 0, DAY, 0, -DAY, 0, 31 * DAY, 0, -31 * DAY, 0)
DISK_MIB = 128


class Disk:
    """The daemon's state: a file system of its own that can be full; without the right to mount, a limit of size."""

    def __init__(self, place: Path) -> None:
        self.place = place
        place.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", str(place)]
        self.own = os.geteuid() == 0 and subprocess.run(mount, capture_output=True, check=False).returncode == 0

    @contextlib.contextmanager
    def full(self, pid: int) -> Iterator[None]:
        if self.own:
            ballast = self.place / "ballast"
            with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
                while True:
                    file.write(bytes(1 << 16))
            yield
            ballast.unlink()
        else:
            before = resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
            yield
            resource.prlimit(pid, resource.RLIMIT_FSIZE, before)

    def close(self) -> None:
        if self.own:
            subprocess.run(["umount", "--lazy", str(self.place)], check=True)


class Storm:
    """Does one fault after the other; each ends as it began."""

    def __init__(
        self, daemon: Daemon, tool: Tool, gate: Gate, subscriber: Subscriber, disk: Disk, wall: Wall, path: Path,
        taken_port: int,
    ) -> None:  # fmt: skip
        self._daemon, self._tool, self._gate, self._subscriber = daemon, tool, gate, subscriber
        self._disk, self._wall, self._path = disk, wall, path
        self._rng = random.Random(20261122)
        self._good = path.read_text()
        self._bad = list(bad_files(self._good, tool.wire.address, taken_port, path.parent).items())
        self.kinds = len(self._bad)
        self._steps = 0
        self.done: Counter[str] = Counter()
        self.refused: set[str] = set()

    def _hup(self) -> None:
        self._daemon.process.send_signal(signal.SIGHUP)

    def bad_reload(self) -> None:
        kind, content = self._bad[self.done["bad reloads"] % len(self._bad)]
        before = health_of(self._subscriber)["reload"].get("t")
        self._path.write_text(content)
        self._hup()
        self._until(
            lambda health: health["reload"]["refused"] and health["reload"]["t"] != before, f"refusal of {kind}"
        )
        self._path.write_text(self._good)
        self.refused.add(kind)
        self.done["bad reloads"] += 1

    def hangups(self) -> None:
        for _ in range(5):
            self._hup()
            time.sleep(self._rng.uniform(0.0, 0.05))
        self.done["SIGHUPs"] += 5

    def unplug(self) -> None:
        """The daemon's own counts say when it has all that was sent, and when it has opened the port again."""
        tool = self._tool
        tool.drain()
        sent = tool.frame_bytes + tool.noise_bytes
        self._until(lambda health: health["codec"]["bytes_in"] >= sent, "all bytes")
        opens = health_of(self._subscriber)["link"]["opens"]
        tool.disconnect()
        time.sleep(self._rng.uniform(0.05, 1.0))
        tool.connect(opened=lambda: self._until(lambda health: health["link"]["opens"] > opens, "the open port"))
        self.done["unplugs"] += 1

    def _until(self, true: Callable[[dict[str, Any]], bool], what: str) -> None:
        try:
            wait_for(lambda: (health := health_of(self._subscriber)) and true(health), 30, what, self._daemon)
        except AssertionError:
            health, tool = health_of(self._subscriber), self._tool
            raise AssertionError(
                f"{what}: not told within 30 s; the tool sent {tool.frame_bytes} + {tool.noise_bytes} bytes, of which"
                f" its end of the line dropped {tool.wire.unheard} as nobody had the port open; the daemon says"
                f" {health['codec']}, {health['link']}, {health['broker']}"
            ) from None

    def noise(self) -> None:
        self._tool.noise(self._rng.randbytes(self._rng.randrange(1, 20_000)))
        self.done["bursts of noise"] += 1

    def stop(self) -> None:
        self._daemon.process.send_signal(signal.SIGSTOP)
        time.sleep(self._rng.uniform(0.05, 2.0))
        self._daemon.process.send_signal(signal.SIGCONT)
        self.done["SIGSTOPs"] += 1

    def set_clock(self) -> None:
        self._wall.set(STEPS_S[self._steps % len(STEPS_S)])
        self._steps += 1
        self.done["clock steps"] += 1

    def kill_broker(self) -> None:
        self._gate.take_away()
        time.sleep(self._rng.uniform(0.2, 3.0))
        self._gate.bring_back(self._subscriber)
        self.done["kills of the broker"] += 1

    def fill_disk(self) -> None:
        """The broker is away meanwhile: nothing can leave, and nothing can be stored."""
        with self._disk.full(self._daemon.process.pid):
            self.kill_broker()
            time.sleep(1.0)
        self.done["full disks"] += 1

    def blow(self, seconds: float, *, all_kinds: bool = True) -> None:
        """Each kind of bad file at least once, the other faults in between at random, on until the time is over."""
        others: list[Callable[[], None]] = [
            self.hangups, self.unplug, self.noise, self.noise, self.stop, self.set_clock, self.kill_broker,
            self.fill_disk,
        ]  # fmt: skip
        end = time.monotonic() + seconds
        queue: list[Callable[[], None]] = []
        while time.monotonic() < end or (all_kinds and self.done["bad reloads"] < self.kinds) or queue:
            if not queue:
                queue = [*others, *[self.bad_reload] * 7]
                self._rng.shuffle(queue)
            queue.pop()()
            time.sleep(0.1)


def storm(seconds: int, folder: Path, *, strict: bool) -> Row:
    """See the module."""
    checks = Checks()
    tool, path, disk = Tool(folder / "tty", RATE_HZ), folder / "highside.toml", Disk(folder / "disk")
    wall = Wall(folder, 0)
    # read anew at each call it would cost a system call for each of thousands of frames
    env = {name: value for name, value in wall.env.items() if name != "FAKETIME_NO_CACHE"}
    env["FAKETIME_CACHE_DURATION"] = "1"
    with contextlib.closing(disk), socket.create_server(("127.0.0.1", 0)) as taken, Gate(folder / "broker") as gate:
        subscriber = Subscriber(gate.port)
        path.write_text(
            configuration(folder, tool, gate.gate, state=disk.place / "state").replace("_s = 0.5", "_s = 0.2")
        )
        with running(path, env=env) as daemon:
            tool.start()
            tool.connect(
                opened=lambda: wait_for(
                    lambda: (h := health_of(subscriber)) and h["link"]["opens"], 30, "the open port", daemon
                )
            )
            process = psutil.Process(daemon.process.pid)
            begun = time.monotonic()
            faults = Storm(daemon, tool, gate, subscriber, disk, wall, path, taken.getsockname()[1])
            faults.blow(5.0, all_kinds=False)
            rss, descriptors = process.memory_info().rss, process.num_fds()
            faults.blow(seconds - 5.0)
            took_s = time.monotonic() - begun
            wall.set(0)
            time.sleep(1.0)
            tool.drain()
            last_health = wait_for(
                lambda: (
                    (h := health_of(subscriber))
                    and h["monitor"]["received"] >= tool.frames
                    and not h["outbox"]["queued"]
                    and not (h["recorder"]["bytes_queued"])
                    and h
                ),
                60, "all frames and an empty outbox", daemon,
            )  # fmt: skip
            made = last_health["pipeline"]["attitudes"]
            with contextlib.suppress(AssertionError):
                wait_for(lambda: len({p["seq"] for p in subscriber.payloads("attitude")}) >= made, 10)
            more, grown = process.num_fds() - descriptors, (process.memory_info().rss - rss) / 2**20
            attitudes = subscriber.payloads("attitude")
            checks.ask(daemon.terminate() == 0, "orderly end")
            checks.ask("Traceback" not in daemon.log, "no traceback in the log")
        subscriber.close()
    tool.stop()
    books(checks, last_health, tool)
    twice = delivered(checks, attitudes, made)
    rising(checks, attitudes)
    outbox, recorder = last_health["outbox"], last_health["recorder"]
    checks.ask(not outbox["dropped"], f"messages dropped: {outbox['dropped']}")
    checks.ask(outbox["produced"] == outbox["acknowledged"] + outbox["queued"], "produced = acknowledged + queued")
    checks.ask(len(faults.refused) == faults.kinds, "every kind of bad file refused")
    checks.ask(recorder["bytes_in"] == last_health["codec"]["bytes_in"], "the recorder was given every byte")
    checks.ask(more <= 3, f"descriptors {more:+d}")
    checks.ask(tool.frames + tool.unheard >= 0.95 * RATE_HZ * took_s, "the tool kept its rate")
    checks.say(
        f"{took_s:.0f} s: {', '.join(f'{count} {name}' for name, count in faults.done.items())}"
        f" ({'a full file system' if disk.own else 'a limit of file size'}); {made:,} attitudes, each at the subscriber"
        f" ({twice} twice); recorder {recorder['bytes_written']:,} bytes written + {recorder['bytes_dropped']:,}"
        f" dropped and counted; memory {grown:+.1f} MiB"
    )
    return checks.into(Row("storm", "all faults at once, 3,840 frames/s", "300 s", f"{seconds} s"))
