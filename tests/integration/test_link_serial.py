"""Serial links on real ptys and sockets: unplugged, silent, busy, moved, closed from afar."""

from __future__ import annotations

import asyncio
import gc
import os
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from link_bench import Memory, supervised, until

from highside.codec.tool import ToolCodec
from highside.link import serial
from highside.link.base import LinkError, LinkReason, LinkState, SupervisorSettings
from highside.link.device import DeviceSettings, SimulatedDevice
from highside.link.serial import SerialSettings, SerialTransport, open_port
from highside.link.wire import PtyWire

pytestmark = pytest.mark.timing

CYCLES = 100


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def held() -> tuple[int, int, int]:
    """Descriptors, tasks and threads, each the least of several looks: while the device is away an attempt to open it
    takes turns with a pause, which has two tasks more. What leaks is there at every look."""
    looks = []
    for _ in range(10):
        await asyncio.sleep(0.02)
        gc.collect()
        looks.append((descriptors(), len(asyncio.all_tasks()), threading.active_count()))
    least = [min(each) for each in zip(*looks, strict=True)]
    return least[0], least[1], least[2]


async def test_a_hundred_unplugs_are_seen_at_once_and_data_is_back_within_a_second(
    tmp_path: Path, record_property: pytest.RecordProperty
) -> None:
    """No descriptor, task or thread is left behind, and the CPU is idle while the device is away."""
    wire = PtyWire(tmp_path / "tool")
    wire.plug()
    memory = Memory()
    detected, back = [], []
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory) as supervisor:
        for cycle in range(CYCLES):
            seen, start = len(memory.data), time.monotonic()
            while len(memory.data) == seen:
                wire.write(b"reading ")
                await asyncio.sleep(0.002)
            back.append(time.monotonic() - start)
            assert supervisor.stats.state is LinkState.UP
            wire.unplug()
            detected.append(await until(lambda: memory.state is LinkState.DOWN, what="unplug seen", poll_s=0.001))
            assert memory.reason is LinkReason.END_OF_FILE
            if cycle == 0:
                before = await held()
            elif cycle == CYCLES - 1:
                after = await held()
            await asyncio.sleep(0.02)  # away for a moment
            if cycle < CYCLES - 1:
                wire.plug()
        away = time.process_time()
        await asyncio.sleep(2.0)
        cpu_share = (time.process_time() - away) / 2.0
        assert supervisor.stats.opens == CYCLES
        assert supervisor.stats.failures[LinkReason.END_OF_FILE] == CYCLES

    figures = {
        "detected_ms": (1e3 * statistics.median(detected), 1e3 * max(detected)),
        "back_ms": (1e3 * statistics.median(back), 1e3 * max(back)),
    }
    record_property("cpu_share_away", cpu_share)
    for name, figure in figures.items():
        record_property(name, figure)
    seen, returned = (
        f"{figures[name][0]:.1f} ms (at most {figures[name][1]:.1f})" for name in ("detected_ms", "back_ms")
    )
    print(f"{CYCLES} unplugs: seen after {seen}, data back after {returned}, {cpu_share:.1%} of a core while away")
    assert after[0] <= before[0], "descriptors leak"
    # all looks may fall into one pause, which grows with the attempts and has two tasks; a leak would be of each cycle
    assert after[1] <= before[1] + 2, "tasks leak"
    # opening runs in the loop's thread pool, which keeps a few threads for good
    assert after[2] <= before[2] + (os.cpu_count() or 1) + 4, "threads leak"
    assert statistics.median(detected) < 0.5
    assert statistics.median(back) < 1.0
    assert cpu_share < 0.1


async def test_an_open_but_silent_device_is_stale_within_2_s_and_reopened_within_10_s(tmp_path: Path) -> None:
    """Settings a fifth of the defaults, so bounds a fifth of 2 s and 10 s with room for a busy machine."""
    settings = SupervisorSettings(backoff_initial_s=0.05, stale_after_s=0.36, reopen_after_s=1.9)
    wire = PtyWire(tmp_path / "tool")
    wire.plug()
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory, settings) as supervisor:
        await until(lambda: wire.listened_to, what="open")
        await asyncio.sleep(0.1)
        wire.write(b"hello")
        await until(lambda: memory.state is LinkState.UP, what="up")
        assert 0.2 < await until(lambda: memory.state is LinkState.STALE, what="stale") < 0.9
        assert memory.reason is LinkReason.SILENT
        wire.write(b"again")
        await until(lambda: memory.state is LinkState.UP, what="up again")
        assert supervisor.stats.opens == 1
        await until(lambda: supervisor.stats.opens == 2, timeout_s=3.0, what="re-opened for silence")
        assert supervisor.stats.failures == {LinkReason.SILENT: 1}
        # a device that lives again is heard through the new descriptor
        await asyncio.sleep(0.1)
        wire.write(b"alive")
        await until(lambda: memory.data.endswith(b"alive"), what="data after the re-open")
        assert memory.state is LinkState.UP
    assert memory.data == b"helloagainalive"


async def test_a_device_that_never_speaks_is_not_called_up(tmp_path: Path) -> None:
    settings = SupervisorSettings(backoff_initial_s=0.05, stale_after_s=0.2, reopen_after_s=0.5)
    wire = PtyWire(tmp_path / "tool")
    wire.plug()
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory, settings) as supervisor:
        await until(lambda: supervisor.stats.opens >= 3, what="tried again")
    assert LinkState.UP not in {state for _, state, _, _ in memory.states}


async def test_a_second_opener_is_refused_in_this_process_and_in_another(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "tool")
    wire.plug()
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory):
        await until(lambda: wire.listened_to, what="open")
        with pytest.raises(LinkError) as refused:
            open_port(SerialSettings(port=wire.address))
        assert refused.value.reason is LinkReason.BUSY
        assert f"process {os.getpid()})" in refused.value.message
        script = (
            "import sys\nfrom highside.link.base import LinkError\n"
            "from highside.link.serial import SerialSettings, open_port\n"
            "try:\n    open_port(SerialSettings(port=sys.argv[1]))\n"
            "except LinkError as error:\n    print(error.reason.value)\n"
        )
        other = await asyncio.to_thread(
            subprocess.run, [sys.executable, "-c", script, wire.address], capture_output=True, text=True, timeout=60
        )
        assert other.stdout.strip() == "busy", other.stderr
        # and the first one was not disturbed
        wire.write(b"still here")
        await until(lambda: memory.data == b"still here", what="data to the first")


def test_a_port_that_is_just_being_let_go_is_not_called_busy(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "tool")
    wire.plug()
    owner = open_port(SerialSettings(port=wire.address))
    # as a child that was forked while the port was open: the lock lives for as long as its copy of the descriptor
    with subprocess.Popen(["sleep", "0.2"], pass_fds=[owner.fileno()]):
        owner.close()
        open_port(SerialSettings(port=wire.address)).close()


async def test_a_busy_port_is_taken_over_when_its_owner_lets_go(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "tool")
    wire.plug()
    owner = open_port(SerialSettings(port=wire.address))
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory) as supervisor:
        await until(lambda: memory.state is LinkState.DOWN, what="refused")
        assert memory.reason is LinkReason.BUSY
        owner.close()
        await until(lambda: supervisor.stats.opens == 1, what="taken over")


def two_wires(link: Path) -> tuple[PtyWire, PtyWire]:
    """Two plugged wires, and the link that leads to the first."""
    first, second = PtyWire(), PtyWire()
    first.plug()
    second.plug()
    link.symlink_to(first.address)
    return first, second


@asynccontextmanager
async def followed(link: Path) -> AsyncIterator[tuple[PtyWire, PtyWire, Memory]]:
    """A link that leads to the first of two wires, open through it."""
    first, second = two_wires(link)
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=str(link))), memory):
        await until(lambda: first.listened_to, what="first open")
        yield first, second, memory


async def test_a_device_that_returns_under_another_node_is_found_through_its_link(tmp_path: Path) -> None:
    link = tmp_path / "by-id"
    async with followed(link) as (first, second, memory):
        first.write(b"one ")
        await until(lambda: memory.data == b"one ", what="first data")
        first.unplug()
        link.unlink()
        await until(lambda: memory.reason is LinkReason.NOT_FOUND, what="absent")
        link.symlink_to(second.address)
        assert await until(lambda: second.listened_to, what="second open") < 2.0
        await asyncio.sleep(0.05)
        second.write(b"two")
        await until(lambda: memory.data == b"one two", what="second data")


async def test_a_link_that_moves_while_the_old_node_stays_open_is_followed(tmp_path: Path) -> None:
    link = tmp_path / "by-id"
    async with followed(link) as (first, second, _):
        link.unlink()
        link.symlink_to(second.address)
        await until(lambda: second.listened_to and not first.listened_to, what="moved")


async def test_a_link_that_appears_while_it_is_being_opened_leads_to_no_other_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The port was closed and opened again half a second later, and what the tool said meanwhile was lost."""
    wire = PtyWire(tmp_path / "tty")

    def plugged_in_at_last(settings: SerialSettings) -> serial.SerialPort:
        wire.plug()
        return open_port(settings)

    monkeypatch.setattr(serial, "open_port", plugged_in_at_last)
    transport = SerialTransport(SerialSettings(port=str(tmp_path / "tty")))
    await transport.open(lambda batch: None)
    try:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(transport.wait_closed(), 3 * serial.WATCH_S)
    finally:
        await transport.close()
        wire.remove()


async def test_a_missing_port_is_named_and_opened_as_soon_as_it_appears(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "tool")
    memory = Memory()
    patient = SupervisorSettings(backoff_initial_s=30.0, backoff_max_s=60.0)
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory, patient):
        await until(lambda: memory.state is LinkState.DOWN, what="refused")
        assert memory.reason is LinkReason.NOT_FOUND
        assert str(tmp_path / "tool") in memory.states[-1][3]
        wire.plug()
        assert await until(lambda: wire.listened_to, what="opened") < 5.0


def test_a_port_without_permission_says_so() -> None:
    """Asked by a process that has given its rights away after importing what it needs."""
    wire = PtyWire()
    wire.plug()
    Path(wire.address).chmod(0)
    script = (
        "import os, sys\nimport serial\nfrom highside.link.base import LinkError\n"
        "from highside.link.serial import SerialSettings, open_port\n"
        "if os.geteuid() == 0:\n    os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "try:\n    open_port(SerialSettings(port=sys.argv[1]))\n"
        "except LinkError as error:\n    print(error.reason.value, error)\n"
    )
    other = subprocess.run([sys.executable, "-c", script, wire.address], capture_output=True, text=True, timeout=60)
    assert other.stdout.startswith("no_permission "), other.stderr
    assert wire.address in other.stdout
    wire.unplug()


@pytest.mark.parametrize(
    ("port", "reason"),
    [("/dev/null", LinkReason.CONFIG), ("nonsense://somewhere", LinkReason.CONFIG), ("/dev", LinkReason.IO_ERROR)],
)
def test_what_is_no_serial_port_is_refused_with_its_name(port: str, reason: LinkReason) -> None:
    with pytest.raises(LinkError, match=port) as refused:
        open_port(SerialSettings(port=port))
    assert refused.value.reason is reason


async def test_4000_frames_a_second_arrive_complete_and_in_order() -> None:
    device = SimulatedDevice(DeviceSettings(rate_hz=4000.0, seed=5), PtyWire())
    device.plug()
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=device.address)), memory):
        await until(lambda: device.wire.listened_to, what="open")
        await asyncio.sleep(0.05)
        device.start()
        await asyncio.sleep(2.0)
        device.stop_sending()
        await until(lambda: not device.wire.pending and not device.wire.unread, what="all read")
        await asyncio.sleep(0.05)
    device.stop()
    codec = ToolCodec()
    frames = codec.receive(bytes(memory.data))
    assert device.wire.unheard == 0
    assert [frame.seq for frame in frames] == list(range(device.sent))
    assert device.sent > 2000
    assert codec.counts.bytes_framed == len(memory.data)


class Server:
    """A TCP server that sends what it is told to its one client."""

    def __init__(self) -> None:
        self.clients: list[asyncio.StreamWriter] = []
        self.port = 0

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._on_client, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _on_client(self, _reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients.append(writer)

    async def stop(self) -> None:
        self._server.close()
        for client in self.clients:
            client.close()
        self.clients.clear()


async def test_a_terminal_server_that_closes_is_reported_and_connected_to_again() -> None:
    server = Server()
    await server.start()
    memory = Memory()
    url = f"socket://127.0.0.1:{server.port}"
    async with supervised(lambda: SerialTransport(SerialSettings(port=url)), memory):
        await until(lambda: bool(server.clients), what="connected")
        await asyncio.sleep(0.1)
        server.clients[0].write(b"first ")
        await until(lambda: memory.data == b"first ", what="data")
        await server.stop()
        await until(lambda: memory.state is LinkState.DOWN, what="seen")
        assert (LinkState.DOWN, LinkReason.REMOTE_CLOSED) in {(s, r) for _, s, r, _ in memory.states}
        await until(lambda: memory.reason is LinkReason.NOT_FOUND, what="refused while the server is away")
        await server.start()
        await until(lambda: bool(server.clients), what="connected again")
        await asyncio.sleep(0.1)
        server.clients[0].write(b"second")
        await until(lambda: memory.data == b"first second", what="data again")
    await server.stop()


class Rfc2217Server:
    """pyserial's own RFC 2217 server side before its loop-back port, for one connection at a time."""

    def __init__(self) -> None:
        import serial

        self._line = serial.serial_for_url("loop://", baudrate=921600, timeout=0.05)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._connection: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        import serial.rfc2217

        while True:
            try:
                self._connection, _ = self._listener.accept()
            except OSError:
                return
            connection = self._connection
            connection.settimeout(0.05)
            out = threading.Lock()

            class Writer:
                def write(self, data: bytes, connection: socket.socket = connection, out: object = out) -> None:
                    with out:  # type: ignore[attr-defined]
                        connection.sendall(data)

            manager = serial.rfc2217.PortManager(self._line, Writer())
            try:
                while True:
                    try:
                        received = connection.recv(1024)
                        if not received:
                            break
                        for _ in manager.filter(received):
                            pass
                    except TimeoutError:
                        pass
                    data = self._line.read(max(1, self._line.in_waiting))
                    if data:
                        Writer().write(b"".join(manager.escape(data)))
            except OSError:
                pass

    def send(self, data: bytes) -> None:
        self._line.write(data)

    def drop(self) -> None:
        if self._connection is not None:
            self._connection.shutdown(socket.SHUT_RDWR)
            self._connection.close()

    def close(self) -> None:
        self._listener.close()
        self.drop()


async def test_rfc2217_is_read_through_a_thread_and_survives_a_dropped_connection() -> None:
    server = Rfc2217Server()
    memory = Memory()
    url = f"rfc2217://127.0.0.1:{server.port}"
    content = bytes(range(256)) * 4  # with the byte 255 that Telnet escapes
    async with supervised(lambda: SerialTransport(SerialSettings(port=url)), memory) as supervisor:
        await until(lambda: supervisor.stats.opens == 1, what="negotiated")
        await asyncio.to_thread(server.send, content)
        await until(lambda: len(memory.data) >= len(content), what="data")
        assert memory.data == content
        server.drop()
        await until(lambda: memory.state is LinkState.DOWN, what="drop seen")
        assert memory.reason is LinkReason.REMOTE_CLOSED
        await until(lambda: supervisor.stats.opens == 2, what="negotiated again")
        await asyncio.to_thread(server.send, b"back")
        await until(lambda: memory.data[len(content) :] == b"back", what="data again")
    server.close()


def test_after_a_stall_no_more_is_read_at_once_than_others_can_wait_for() -> None:
    """64 KiB, 2,700 frames, were taken in one go: 40 ms in which the loop answered nobody."""
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    os.write(writer, bytes(60_000))
    got: list[int] = []
    transport = SerialTransport(SerialSettings(port="a pipe"))
    transport._fd, transport._deliver = reader, lambda batch: got.append(len(batch.data))
    for _ in range(4):
        transport._readable()
    os.close(reader)
    os.close(writer)
    assert got == [16_384, 16_384, 16_384, 60_000 - 3 * 16_384]
