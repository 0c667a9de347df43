"""What the scenarios share: a tool on a pty that is unplugged, a daemon beside it, and a row of the table."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "integration")]

from broker import Mosquitto, Proxy  # noqa: E402

from highside.codec.tool import encode  # noqa: E402
from highside.link.wire import PtyWire  # noqa: E402

if TYPE_CHECKING:
    from daemon import Subscriber

SETTLE_S = 0.2
"""after a port was opened: what a driver held from before is thrown away by the reader, so the tool waits that long"""


@dataclass
class Row:
    """A line of the table in docs/faults.md."""

    scenario: str
    name: str
    asked: str
    run: str = ""
    measured: str = ""
    held: bool = False
    command: str = ""
    seconds: float = 0.0
    complete: bool = True
    """whether all that is asked was run; if not, the next run goes on with it"""
    date: str = ""

    def markdown(self) -> str:
        held = "yes" if self.held else "**no**"
        return (
            f"| {self.scenario} | {self.name} | {self.asked} | {self.run} | {self.measured} | {held} |"
            f" {self.seconds:.0f} s | `{self.command}` |"
        )

    def json(self) -> str:
        return json.dumps(asdict(self))


class Checks:
    """Collects what was asked and whether it held, so that a row tells all of it and not the first miss alone."""

    def __init__(self) -> None:
        self.missed: list[str] = []
        self.said: list[str] = []

    def say(self, text: str) -> None:
        self.said.append(text)

    def ask(self, good: bool, text: str) -> None:
        if not good:
            self.missed.append(text)

    def into(self, row: Row) -> Row:
        row.measured = "; ".join(self.said + [f"MISSED: {text}" for text in self.missed])
        row.held = not self.missed
        return row


def frame(k: int, rate_hz: float) -> bytes:
    """Reading k of a tool that lies still but for a pattern that no two neighbours share."""
    return encode(k % 65536, k / rate_hz, (0.1 + 1e-4 * (k % 7), 0.2 - 1e-4 * (k % 11), 0.97 + 1e-4 * (k % 5)))


class Tool(threading.Thread):
    """Sends frames at a rate on a pty until stopped; goes on unheard while it is unplugged. Keeps books to the byte."""

    def __init__(self, link: Path, rate_hz: float) -> None:
        super().__init__(daemon=True)
        self.wire = PtyWire(link)
        self._rate = rate_hz
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._muted = True
        self._next = self._now = 0
        self.frames = self.unheard = self.noise_bytes = self.frame_bytes = 0
        self.wire.plug()

    def run(self) -> None:
        begin = time.monotonic()
        while not self._ending.wait(0.005):
            with self._lock:
                due = int((time.monotonic() - begin) * self._rate)
                self._send_until(due)
                self._now = due

    def _send_until(self, due: int) -> None:
        if self._muted:
            return
        if self.frames:
            # what it would have sent while it was away
            self.unheard += self._now - self._next
        data = b"".join(frame(k, self._rate) for k in range(self._now, due))
        self.wire.write(data)
        self.frames += due - self._now
        self.frame_bytes += len(data)
        self._now = self._next = due

    def connect(self, timeout_s: float = 20.0, opened: Callable[[], object] | None = None) -> float:
        """Plug in and speak as soon as somebody listens; returns when it was plugged in (monotonic).

        `opened` waits until the reader says that it has opened the port; otherwise the tool waits `SETTLE_S`.
        """
        self.wire.plug()
        at = time.monotonic()
        while not self.wire.listened_to:
            assert time.monotonic() < at + timeout_s, f"nobody opened the port within {timeout_s} s"
            time.sleep(0.002)
        if opened is None:
            time.sleep(SETTLE_S)
        else:
            opened()
        with self._lock:
            self._muted = False
        return at

    def drain(self, timeout_s: float = 20.0) -> None:
        """Stop speaking, and wait until the reader has everything."""
        with self._lock:
            self._muted = True
        end, empty = time.monotonic() + timeout_s, 0
        # the kernel hands what was written over to the other side a little later: looked at three times
        while empty < 3:
            assert time.monotonic() < end, f"the reader did not take what was sent within {timeout_s} s"
            with self._lock:
                self.wire.flush()
            empty = 0 if self.wire.pending or self.wire.unread else empty + 1
            time.sleep(0.005)

    def disconnect(self) -> float:
        """Pull the cable when all that was sent has been taken, so that the books can be exact; says when.

        Its link goes too, as a by-id link does: the number of the pty may be given to another program at once.
        """
        self.drain()
        at = time.monotonic()
        self.wire.remove()
        return at

    def noise(self, data: bytes) -> None:
        with self._lock:
            self.wire.write(data)
            self.noise_bytes += len(data)

    def stop(self) -> None:
        self._ending.set()
        self.join()
        self.wire.remove()


class Gate:
    """A mosquitto that is killed and comes back, behind a relay that the daemon connects to (`gate`).

    A broker that was killed has forgotten its subscribers, and what it takes before they are back is lost by the
    broker; so the relay lets the daemon in when the subscriber is there. In the same way the daemon is cut off a moment
    before the kill: what the broker had acknowledged and not yet passed on would be lost with it.
    """

    def __init__(self, folder: Path) -> None:
        self._broker = Mosquitto(folder)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._proxy = Proxy(self._broker.port)

    def __enter__(self) -> Gate:
        self._broker.start()
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._proxy.__aenter__(), self._loop).result(10)
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.run_coroutine_threadsafe(self._proxy.__aexit__(), self._loop).result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._broker.kill()

    @property
    def port(self) -> int:
        return self._broker.port

    @property
    def gate(self) -> int:
        return self._proxy.port

    def take_away(self) -> None:
        """The daemon's connection is reset in the midst of what it sends, then the broker is killed."""
        self._proxy.refusing = True
        self._loop.call_soon_threadsafe(self._proxy.cut)
        time.sleep(0.2)
        self._broker.kill()

    def bring_back(self, subscriber: Subscriber, timeout_s: float = 20.0) -> None:
        before = subscriber.subscriptions
        self._broker.start()
        end = time.monotonic() + timeout_s
        while subscriber.subscriptions == before:
            assert time.monotonic() < end, "the subscriber did not come back"
            time.sleep(0.01)
        self._proxy.refusing = False


def configuration(
    folder: Path, tool: Tool, port: int, *, state: Path | None = None, rate_hz: float = 50, mqtt: str = ""
) -> str:
    """A daemon on the tool's line."""
    return (
        f'[tool]\nid = "t"\n[link]\nkind = "serial"\nport = "{tool.wire.address}"\n[codec]\nname = "tool"\n'
        f"[pipeline]\noutput_rate_hz = {rate_hz}\n[mqtt]\nport = {port}\n{mqtt}"
        f'[service]\nstate_dir = "{state or folder / "state"}"\nhealth_interval_s = 0.5\n'
    )


def open_port(pid: int) -> Path | None:
    """The descriptor of a process that leads to a pseudo-terminal, as a path below /proc; None if there is none."""
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        if not closed(descriptor):
            return descriptor
    return None


def closed(descriptor: Path) -> bool:
    try:
        return not str(descriptor.readlink()).startswith("/dev/pts/")
    except OSError:
        return True


def books(checks: Checks, health: dict[str, Any], tool: Tool) -> None:
    """Every byte and frame of the tool is in the daemon's accounts, exactly."""
    codec, monitor = health["codec"], health["monitor"]
    other = codec["bytes_bad"] + codec["bytes_text"] + codec["bytes_ignored"] + codec["bytes_junk"]
    pairs = {
        "bytes in": (codec["bytes_in"], tool.frame_bytes + tool.noise_bytes),
        "bytes framed": (codec["bytes_framed"], tool.frame_bytes),
        "bytes of noise": (other + codec["bytes_pending"], tool.noise_bytes),
        "frames": (monitor["good"], tool.frames),
        "gap": (monitor["gap"], tool.unheard),
        "duplicates": (monitor["duplicate"] + monitor["late"], 0),
    }
    for name, (counted, sent) in pairs.items():
        checks.ask(counted == sent, f"{name}: the daemon says {counted}, the tool {sent}")
    checks.ask(
        not tool.wire.unheard,
        f"{tool.wire.unheard} bytes were sent while nobody had the port open, by the tool's books",
    )
    checks.ask(all(health["balance"].values()), f"balance {health['balance']}")
    checks.ask(health["recorder"]["balanced"], f"recorder {health['recorder']}")
    checks.say(
        f"{tool.frames:,} frames, {codec['bytes_in']:,} bytes = {codec['bytes_framed']:,} framed + {other:,} noise,"
        f" {tool.unheard:,} frames not sent while unplugged = gap"
    )


def quantile(values: list[float], q: float) -> float:
    return sorted(values)[min(int(q * len(values)), len(values) - 1)]
