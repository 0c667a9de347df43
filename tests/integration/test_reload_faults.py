"""Reload, with a fault at every line that builds or swaps: the service is as it was, or as it should be, never between.

The lines are not listed: they are those that ran in a reload without a fault, so a new step is covered by itself. The
service runs in this process on real ptys; frames flow between the attempts.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import signal
import socket
import socketserver
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from broker import free_port
from daemon import Pty, is_held

from highside.codec.tool import encode
from highside.config.settings import load
from highside.link import base, opened
from highside.service import (
    app,
    drift_keeper,
    in_force,
    leaving,
    parts,
    pipeline,
    places,
    publisher,
    reload,
    watch_keeper,
)
from highside.service.rig import rig

pytestmark = pytest.mark.slow

NOT_INJECTED = {"done", "retire", "_metrics_again", "_link_again"}
"""of `Reload`: they run after the fact, or only where something has failed already"""


def codes() -> set[CodeType]:
    """The functions that a reload is made of."""
    found: list[Any] = [
        *(f for name, f in vars(reload.Reload).items() if callable(f) and name not in NOT_INJECTED),
        reload.open_link, reload._opened_first, parts.make_supervisor, opened.OpenedTransport.open_ahead,
        app.Service.make_publisher, app.Service.make_tap, parts.make_pipeline, watch_keeper.WatchKeeper.build,
        watch_keeper.WatchKeeper._stage,
        app.Service.take, leaving.Leaving.successor, leaving.Leaving.all_gone, pipeline.Pipeline.successor,
        pipeline.Pipeline.correction.fset, pipeline.Pipeline.rotation.fset, rig.Rig.build, rig.Rig.open_metrics,
        base.LinkSupervisor.apply,
        drift_keeper.DriftKeeper.build, drift_keeper._stage, places.ToolLock.__init__, publisher.Publisher.__init__,
        in_force.calibration_for, in_force.rotation_for, in_force._calibration, in_force._record_of,
        in_force.compensation_of,
    ]  # fmt: skip
    return {f.__code__ for f in found}


@pytest.fixture(autouse=True)
def collected_quickly() -> Iterator[None]:
    """What the runner of the tests has loaded is no part of what a refused reload may leave behind: a collection that
    looks at it, too, takes 0.1 s, 200 times."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture(autouse=True)
def listeners_end_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The standard library's servers look every 0.5 s whether they are to end, and a reload may wait for one."""
    serve = socketserver.BaseServer.serve_forever
    monkeypatch.setattr(socketserver.BaseServer, "serve_forever", lambda server: serve(server, 0.01))


class InjectedError(RuntimeError):
    """What no code expects."""


Line = tuple[str, int]


class Tracer:
    """Notes the lines that run, or raises at one of them, once."""

    def __init__(self, target: Line | None = None) -> None:
        self.lines: dict[Line, None] = {}
        self.fired = False
        self._target, self._codes = target, codes()

    def __enter__(self) -> Tracer:
        sys.settrace(self._call)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _call(self, frame: FrameType, event: str, arg: object) -> Any:
        return self._line if frame.f_code in self._codes else None

    def _line(self, frame: FrameType, event: str, arg: object) -> Any:
        if event == "line":
            line = (frame.f_code.co_qualname, frame.f_lineno)
            self.lines[line] = None
            if line == self._target and not self.fired:
                self.fired = True
                raise InjectedError("a fault")
        return self._line


class Manager:
    """Stands in for systemd: keeps what the service says."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._socket.setblocking(False)

    def heard(self) -> list[str]:
        """Messages since this was last asked, without those that come by themselves."""
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                found.append(self._socket.recv(4096).decode())
        return [text for text in found if not text.startswith("STATUS=")]

    def close(self) -> None:
        self._socket.close()


class Rig:
    """A service at work in this process, its line, its configuration file."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.path = folder, folder / "highside.toml"
        self.line, self.other = Pty(), Pty()
        self.manager = Manager(folder)
        monkeypatch.setenv("NOTIFY_SOCKET", self.manager.address)
        self.sent = 0
        self.service: app.Service

    @contextlib.asynccontextmanager
    async def running(self, text: str) -> AsyncIterator[Rig]:
        self.path.write_text(text)
        self.service = app.Service(load(self.path), reload=lambda: load(self.path))
        task = asyncio.create_task(self.service.run())
        try:
            await self.until(lambda: is_held(self.line.path), "the line")
            await self.until(lambda: any("READY=1" in text for text in self.manager.heard()), "READY")
            yield self
        finally:
            self.service.stop()
            await task
            self.line.close()
            self.other.close()
            self.manager.close()

    async def until(self, condition: Callable[[], Any], what: str, timeout_s: float = 20.0) -> None:
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, f"waited for {what}"
            await asyncio.sleep(0.002)

    async def sighup(self) -> None:
        """A signal, and the answer to it."""
        reloader = self.service.reloader
        before = reloader.count, reloader.refused
        os.kill(os.getpid(), signal.SIGHUP)
        await self.until(lambda: (reloader.count, reloader.refused) != before, "the answer")
        await asyncio.sleep(0)

    async def frames_flow(self, line: Pty) -> None:
        """Frames on a line make attitudes, and none is missing."""
        await self.until(lambda: is_held(line.path), "the line to be held")
        counts, made = self.service.pipeline.monitor.counts, self.service.pipeline.attitudes
        good, gap = counts.good, counts.gap
        line.write_all(
            b"".join(encode(i % 65536, i / 100.0, (0.1 + 1e-5 * (i % 7), 0.2, 0.97), temp_c=25.0)
                     for i in range(self.sent, self.sent + 40))
        )  # fmt: skip
        self.sent += 40
        await self.until(lambda: counts.good == good + 40, "the frames")
        assert counts.gap == gap
        assert self.service.pipeline.attitudes > made
        assert self.service.health().balance == {"bytes": True, "frames": True, "messages": True}


def listening(host: str, port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection((host, port), 0.5):
        return True
    return False


def toml(folder: Path, port: str, *, baud: int = 115200, stale_s: float = 60, mqtt: str = "", extra: str = "") -> str:
    """A service whose link is not opened anew by itself, however slow the machine is."""
    return (
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{port}"\nbaud = {baud}\nstale_after_s = {stale_s}\n'
        f'reopen_after_s = 600\n[codec]\nname = "tool"\n'
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
        f"[mqtt]\nport = {UNUSED}\n{mqtt}\n{extra}"
    )


UNUSED = free_port()
"""of a broker that is away all the time"""


async def inline(function: Callable[..., Any], *arguments: Any) -> Any:
    """Instead of `asyncio.to_thread`: the tracer sees one thread."""
    return function(*arguments)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", ["beside", "in its place", "limits alone"])
async def test_a_fault_at_any_line_of_a_reload_changes_nothing(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(reload.asyncio, "to_thread", inline)
    # what must not be listened at stands at addresses that no other test uses
    figures, new_figures, wits = free_port(), free_port(), free_port()
    everything = (
        "[pipeline]\noutput_rate_hz = 50\n[monitor]\nrange_g = 5\n[survey]\nstill_s = 3\n[rolling_bias]\napply = true\n"
        "[recorder]\nenabled = false\n[vibration]\ncorner_hz = 2.0\n[site]\nlatitude_deg = 50.0\n[drift]\n"
        f'azimuth_deg = 10.0\n[[wits]]\nkind = "tcp_server"\nhost = "127.0.0.3"\nport = {wits}\n[home_assistant]\n'
    )
    bench = Rig(tmp_path, monkeypatch)
    old = toml(tmp_path, bench.line.path, extra=f"[metrics]\nport = {figures}\n")
    if kind == "beside":
        line = bench.other
        more = f'{everything}[metrics]\nport = {new_figures}\nhost = "127.0.0.4"\n'
        new = toml(tmp_path, line.path, mqtt='prefix = "drill"', extra=more)
    elif kind == "limits alone":
        # the port stays open
        line = bench.line
        new = toml(tmp_path, line.path, stale_s=61, extra=f"[metrics]\nport = {figures}\n")
    else:
        # the same port with another baud rate, the same listening port on another address
        line = bench.line
        more = f'{everything}[metrics]\nport = {figures}\nhost = "127.0.0.2"\n'
        new = toml(tmp_path, line.path, baud=57600, extra=more).replace('name = "tool"', 'name = "tool"\naxes = "-yxz"')
    async with bench.running(old):
        service = bench.service
        await bench.frames_flow(bench.line)
        tasks = len(asyncio.all_tasks())
        with Tracer() as tracer:
            bench.path.write_text(new)
            wanted = load(bench.path)
            await bench.sighup()
        assert service.reloader.refused is None
        await bench.frames_flow(line)
        bench.path.write_text(old)
        await bench.sighup()
        await bench.frames_flow(bench.line)
        lines = list(tracer.lines)
        names = {name for name, _ in lines}
        assert {"Reload._read", "Reload._build", "Reload._swap", "Service.take"} <= names
        assert ("LinkSupervisor.apply" in names) is (kind == "limits alone")
        opens = service.parts.supervisor.stats.opens
        assert len(lines) > (80 if kind != "limits alone" else 50)
        refused = 0
        for target in lines:
            before = service.parts
            bench.manager.heard()
            bench.path.write_text(new)
            with Tracer(target) as tracer:
                await bench.sighup()
            assert tracer.fired, target
            answered = bench.manager.heard()
            assert [text.split("\n")[0] for text in answered] == ["RELOADING=1", "READY=1"], target
            if service.reloader.refused is None:
                # a line of reading the calibration or after the swap: the new configuration is in force, whole
                assert service.settings == wanted, target
                bench.path.write_text(old)
                await bench.sighup()
            else:
                refused += 1
                refusal = service.reloader.refused
                assert "InjectedError: a fault" in refusal["refused"], target
                assert "reload_refused" in service.health().alarms
                assert f"STATUS=reload refused: {refusal['refused']}"[:80] in answered[1]
                assert_unchanged(before, service.parts, target)
                await bench.until(lambda: len(asyncio.all_tasks()) <= tasks, f"{target}: no task is left over")
                gc.collect()
                if kind == "beside":
                    assert not is_held(bench.other.path), target
                    assert not listening("127.0.0.4", new_figures), target
                    places.ToolLock("t1", load(bench.path).mqtt).release()
                assert not listening("127.0.0.2", figures), target
                assert not listening("127.0.0.3", wits), target
            if kind == "limits alone":
                assert (service.parts.link_task, service.parts.supervisor) == (before.link_task, before.supervisor)
                assert service.parts.supervisor._settings.stale_after_s == 60, target
                assert service.parts.supervisor.stats.opens == opens, target
            # a server that is not yet at its turn takes no more callers than its queue holds
            await bench.until(lambda: listening("127.0.0.1", figures), f"{target}: the figures are served")
            await bench.frames_flow(bench.line)
        print(f"{len(lines)} lines, refused at {refused}")
        assert refused > (60 if kind != "limits alone" else 40)
        # and the same file, without a fault, takes effect
        bench.path.write_text(new)
        await bench.sighup()
        assert service.settings == wanted
        await bench.frames_flow(line)


def assert_unchanged(before: parts.ServiceParts, after: parts.ServiceParts, target: Line) -> None:
    for name in ("settings", "calibration", "rotation", "pipeline", "publisher", "tap", "supervisor", "drift"):
        assert getattr(after, name) is getattr(before, name), (target, name)
    assert after.rig.outputs is before.rig.outputs, target
    assert after.tool_lock is before.tool_lock, target
    assert after.publisher_task is before.publisher_task, target
    assert after.link_task is not None, target
    assert not after.link_task.done(), target
