"""Recordings played again: complete, in order, at the pace asked for; into the service, a pty, and by the command."""

from __future__ import annotations

import asyncio
import gzip
import json
import os
import random
import re
import select
import signal
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import pytest
from link_bench import Memory, supervised, until

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.link.base import Batch, Chunk, LinkReason, LinkState, LinkSupervisor, SupervisorSettings
from highside.link.replay import ReplaySettings, ReplayTransport, events, play
from highside.link.serial import SerialSettings, SerialTransport
from highside.link.wire import PtyWire
from highside.recording.candump import format_candump
from tests.segments import SegmentWriter

NO_WATCHDOG = SupervisorSettings(stale_after_s=0.0)
HIGHSIDE = [sys.executable, "-c", "from highside.cli.main import main; main()"]


class FastClock:
    """Sleeping costs no time, but the time passes."""

    def __init__(self) -> None:
        self.now = 500.0

    def monotonic(self) -> float:
        return self.now

    def wall(self) -> float:
        return 1e9 + self.now

    async def sleep(self, seconds: float) -> None:
        self.now += max(0.0, seconds)
        await asyncio.sleep(0)


class Stamped(Memory):
    """Remembers by the clock of the replay when each batch came."""

    def __init__(self, clock: FastClock) -> None:
        super().__init__()
        self._clock = clock
        self.arrived: list[float] = []
        self.chunks: list[Chunk] = []

    def on_batch(self, batch: Batch) -> None:
        super().on_batch(batch)
        self.arrived += [self._clock.now] * (1 if isinstance(batch, Chunk) else len(batch))
        if isinstance(batch, Chunk):
            self.chunks.append(batch)


async def replayed(path: Path, speed: float, byte_rate: float = 11520.0) -> tuple[Stamped, float]:
    """Play to the end on a fast clock; what came, and how long it took by that clock."""
    clock = FastClock()
    memory = Stamped(clock)
    settings = ReplaySettings(path=path, speed=speed, byte_rate=byte_rate)
    await LinkSupervisor(lambda: ReplayTransport(settings, clock), memory, NO_WATCHDOG, clock).run()
    assert (memory.state, memory.reason) == (LinkState.ENDED, LinkReason.FINISHED)
    return memory, clock.now - 500.0


@pytest.fixture
def candump(tmp_path: Path) -> Path:
    frames = [CanFrame(0.0, 1e9 + n / 100.0, 0x100 + n % 7, bytes([n % 256])) for n in range(1000)]
    path = tmp_path / "bus.log"
    path.write_text("".join(format_candump(frame, "can0") for frame in frames))
    return path


@pytest.mark.parametrize(("speed", "duration_s"), [(1.0, 9.99), (4.0, 9.99 / 4), (0.5, 19.98)])
async def test_frames_come_when_they_are_due(candump: Path, speed: float, duration_s: float) -> None:
    memory, took = await replayed(candump, speed)
    assert [frame.data[0] for frame in memory.frames] == [n % 256 for n in range(1000)]
    assert took == pytest.approx(duration_s, abs=1e-3)
    for n, (frame, arrived) in enumerate(zip(memory.frames, memory.arrived, strict=True)):
        assert frame.t_mono == pytest.approx(500.0 + n / 100.0 / speed, abs=1e-5)
        assert frame.t_wall == pytest.approx(1e9 + n / 100.0, abs=1e-5)
        assert arrived == pytest.approx(frame.t_mono, abs=1e-5)


async def test_as_fast_as_possible_takes_no_time_keeps_the_recorded_gaps_and_lets_others_run(candump: Path) -> None:
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    task = asyncio.create_task(other())
    memory, took = await replayed(candump, 0.0)
    task.cancel()
    assert took == 0.0
    assert len(memory.frames) == 1000
    assert memory.frames[-1].t_mono - memory.frames[0].t_mono == pytest.approx(9.99, abs=1e-4)
    assert turns >= 3
    assert max(memory.batches, 1) <= 20, "in batches"


async def test_thirty_seconds_of_a_real_car_bus_come_complete_and_in_order(shared_data: Path) -> None:
    path = shared_data / "can_comma2k19" / "candump_first30s.log.gz"
    # an independent reading of the text
    lines = [
        re.fullmatch(r"\((\d+\.\d+)\) \S+ ([0-9A-F]+)#([0-9A-F]*)", line.strip())
        for line in gzip.decompress(path.read_bytes()).decode().splitlines()
    ]
    expected = [(float(m[1]), int(m[2], 16), bytes.fromhex(m[3])) for m in lines if m]
    memory, took = await replayed(path, 1.0)
    assert [(f.t_wall, f.can_id, f.data) for f in memory.frames] == expected
    assert took == pytest.approx(expected[-1][0] - expected[0][0], abs=0.01)


async def test_segments_keep_their_times_and_bytes(tmp_path: Path) -> None:
    rng = random.Random(4)
    path = tmp_path / "tool.hsw"
    writer = SegmentWriter(path, {"tool": "t"})
    t, content = 100.0, b""
    times = []
    for _ in range(200):
        t += rng.uniform(0.001, 0.2)
        data = rng.randbytes(rng.randrange(1, 300))
        writer.append(data, t_wall=1e9 + t, t_mono=t)
        content += data
        times.append(t)
    writer.close()
    memory, took = await replayed(path, 2.0)
    assert bytes(memory.data) == content
    assert took == pytest.approx((times[-1] - times[0]) / 2.0, abs=1e-6)
    assert [chunk.t_wall for chunk in memory.chunks] == pytest.approx([1e9 + t for t in times])
    assert [chunk.t_mono for chunk in memory.chunks] == pytest.approx([500.0 + (t - times[0]) / 2.0 for t in times])


async def test_raw_bytes_are_paced_by_the_byte_rate(tmp_path: Path) -> None:
    path = tmp_path / "raw.bin"
    path.write_bytes(os.urandom(50_000))
    memory, took = await replayed(path, 1.0, byte_rate=10_000.0)
    assert bytes(memory.data) == path.read_bytes()
    assert took == pytest.approx(5.0, abs=0.05)


async def test_a_clock_set_back_while_recording_does_not_stop_the_replay(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    times = [100.0, 100.1, 40.0, 40.1, 100.3]
    path.write_text("".join(format_candump(CanFrame(0, t, 1, bytes([n])), "can0") for n, t in enumerate(times)))
    memory, took = await replayed(path, 1.0)
    assert [frame.data[0] for frame in memory.frames] == [0, 1, 2, 3, 4]
    assert took == pytest.approx(0.3, abs=1e-5)


async def test_real_time_is_real(tmp_path: Path) -> None:
    """On the machine's own clock: 0.5 s of recording take 0.5 s, no more than a busy machine adds."""
    path = tmp_path / "bus.log"
    path.write_text("".join(format_candump(CanFrame(0, 10 + n / 100, 1, b""), "can0") for n in range(51)))
    memory = Memory()
    start = time.monotonic()
    await LinkSupervisor(lambda: ReplayTransport(ReplaySettings(path=path)), memory, NO_WATCHDOG).run()
    assert 0.499 < time.monotonic() - start < 3.0
    assert len(memory.frames) == 51
    assert memory.batches > 5


async def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    memory = Memory()
    async with supervised(lambda: ReplayTransport(ReplaySettings(path=tmp_path / "gone.log")), memory, NO_WATCHDOG):
        await until(lambda: memory.state is LinkState.DOWN, what="refused")
    assert memory.reason is LinkReason.CONFIG
    assert "gone.log" in memory.states[-1][3]
    with pytest.raises(InputError, match=r"gone\.log"):
        events(tmp_path / "gone.log")


async def test_a_recording_played_into_a_pty_arrives_byte_for_byte(shared_data: Path) -> None:
    path = shared_data / "serial_vn100" / "F00379_first60pct.bin"
    wire = PtyWire()
    wire.plug()
    memory = Memory()
    async with supervised(lambda: SerialTransport(SerialSettings(port=wire.address)), memory):
        await until(lambda: wire.listened_to, what="open")
        await asyncio.sleep(0.1)
        played = await asyncio.wait_for(play(events(path), wire, speed=0.0), 60.0)
        wire.unplug()
        await until(lambda: memory.state is LinkState.DOWN, what="end seen")
    assert bytes(memory.data) == path.read_bytes()
    assert (played.bytes, played.unheard) == (path.stat().st_size, 0)


def read_all(address: str, delay_s: float = 0.0) -> bytes:
    """What a foreign program reads: open, and read until the end of file."""
    fd = os.open(address, os.O_RDONLY | os.O_NOCTTY)
    tty.setraw(fd)
    data = b""
    try:
        while select.select([fd], [], [], 30.0)[0]:
            try:
                piece = os.read(fd, 4096)
            except OSError:
                break
            if not piece:
                break
            data += piece
            time.sleep(delay_s)
    finally:
        os.close(fd)
    return data


def test_the_command_prints_the_pty_waits_for_a_reader_and_loses_nothing(tmp_path: Path) -> None:
    recording, link = tmp_path / "raw.bin", tmp_path / "port"
    recording.write_bytes(os.urandom(40_000))
    command = [*HIGHSIDE, "replay", str(recording), "--to", "pty", "--speed", "0", "--link", str(link), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == str(link)
        data = read_all(str(link), delay_s=0.002)  # a slow reader
        rest, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    assert data == recording.read_bytes()
    assert json.loads(rest)["bytes"] == 40_000
    assert not link.is_symlink()


def test_the_command_says_when_its_reader_left(tmp_path: Path) -> None:
    recording = tmp_path / "raw.bin"
    recording.write_bytes(os.urandom(20_000))
    command = [*HIGHSIDE, "replay", str(recording), "--to", "pty", "--byte-rate", "10000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        fd = os.open(process.stdout.readline().strip(), os.O_RDONLY | os.O_NOCTTY)
        assert select.select([fd], [], [], 30.0)[0]
        os.close(fd)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "the reader left" in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_the_command_takes_its_link_away_when_it_is_stopped(tmp_path: Path, sign: signal.Signals) -> None:
    recording, link = tmp_path / "raw.bin", tmp_path / "port"
    recording.write_bytes(bytes(1000))
    command = [*HIGHSIDE, "replay", str(recording), "--to", "pty", "--link", str(link)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()  # from here on it waits for a reader
        process.send_signal(sign)
        try:
            _, errors = process.communicate(timeout=30)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not link.is_symlink()


def test_a_foreign_table_and_a_missing_reader_are_named(tmp_path: Path) -> None:
    table = tmp_path / "foreign.csv"
    table.write_text("Time;Roll;Pitch\n0,1;2,3;4,5\n")
    with subprocess.Popen(
        [*HIGHSIDE, "replay", str(table), "--to", "pty"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        ends = threading.Timer(20.0, process.kill)  # what does not say so waits for ever
        ends.start()
        try:
            port = process.stdout.readline().strip()
            said = [process.stderr.readline(), process.stderr.readline()]
            process.send_signal(signal.SIGTERM)
            _, rest = process.communicate(timeout=30)
        finally:
            ends.cancel()
            process.kill()
    assert "foreign.csv: begins like a table and is played as the text that it is; `highside import`" in said[0]
    assert said[1].startswith(f"{port}: waits for a program that opens it")
    assert f"0 records (0 CAN frames, 0 bytes) in 0.0 s, 0 unheard; no program has opened {port}" in rest


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["missing.log", "--to", "pty"], "missing.log: no such file"),
        (["bus.log", "--to", "pty"], "use --to can:INTERFACE"),
        (["raw.bin", "--to", "can:vcan0"], "use --to pty"),
        (["raw.bin", "--to", "tcp"], "--to: 'tcp' is no target"),
        (["bus.log", "--to", "can:none9"], "none9: no such CAN interface"),
        (["raw.bin", "--to", "pty", "--link", "raw.bin"], "raw.bin: exists and is not a symbolic link"),
        (["readings.csv", "--to", "pty"], "readings.csv: holds readings, not bytes of the wire"),
        (["readings.csv.gz", "--to", "pty"], "readings.csv.gz: holds readings, not bytes of the wire"),
        (["readings.parquet", "--to", "pty"], "readings.parquet: holds readings, not bytes of the wire"),
    ],
)
def test_the_command_refuses_wrong_input_in_one_line(tmp_path: Path, arguments: list[str], complaint: str) -> None:
    (tmp_path / "bus.log").write_text(format_candump(CanFrame(0, 1.0, 1, b""), "can0"))
    (tmp_path / "raw.bin").write_bytes(b"\x00" * 10)
    readings = b"t_s,ax_g,ay_g,az_g\n0,0,0,1\n"
    (tmp_path / "readings.csv").write_bytes(readings)
    (tmp_path / "readings.csv.gz").write_bytes(gzip.compress(readings))
    (tmp_path / "readings.parquet").write_bytes(b"PAR1" + bytes(40))
    done = subprocess.run(
        [*HIGHSIDE, "replay", *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert complaint in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
