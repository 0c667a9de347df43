"""The simulated tool on a real pty, its faults on command, `highside detect`, and python-can's virtual bus."""

from __future__ import annotations

import asyncio
import json
import math
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from link_bench import Memory, PythonCanWire, supervised, until

from highside.codec.frame import CanFrame, Frame
from highside.codec.tool import ToolCodec
from highside.config.codecs import codec_from_name
from highside.config.links import SimulatedLink
from highside.link.base import LinkReason, LinkState, SupervisorSettings
from highside.link.detect import probe_serial
from highside.link.device import DeviceSettings, SimulatedDevice, encode, encode_can
from highside.link.pythoncan import PythonCanSettings, PythonCanTransport
from highside.link.serial import SerialSettings, SerialTransport, open_port
from highside.link.wire import PtyWire
from highside.physics.motion import Leg, Motion, still

HIGHSIDE = [sys.executable, "-c", "from highside.cli.main import main; main()"]
QUICK = SupervisorSettings(backoff_initial_s=0.05, backoff_max_s=0.5, stale_after_s=0.0)


class DeafWire(PtyWire):
    """Keeps what is written; no pty."""

    def __init__(self) -> None:
        super().__init__()
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data += data


def bench_device(**settings: object) -> tuple[SimulatedDevice, DeafWire]:
    wire = DeafWire()
    return SimulatedDevice(DeviceSettings(**settings), wire), wire  # type: ignore[arg-type]


def decode(data: bytes) -> list[Frame]:
    return ToolCodec().receive(data)


def test_its_content_depends_on_the_seed_alone_not_on_how_frames_fall_into_ticks() -> None:
    rng = random.Random(2)
    one, first = bench_device(seed=9, rate_hz=250.0)
    one.step(1000)
    two, second = bench_device(seed=9, rate_hz=250.0)
    while two.produced < 1000:
        two.step(min(rng.randrange(1, 40), 1000 - two.produced))
    assert first.data == second.data
    other, third = bench_device(seed=10, rate_hz=250.0)
    other.step(1000)
    assert third.data != first.data


def test_its_readings_are_its_truth_through_matrix_offset_and_noise() -> None:
    matrix = ((1.01, 0.02, 0.0), (0.0, 0.99, -0.01), (0.005, 0.0, 1.002))
    motion = Motion(
        (Leg(5.0), Leg(5.0, inclination_to_deg=50.0, turn_deg=200.0), Leg(5.0, inclination_to_deg=20.0)), 20.0
    )
    device, wire = bench_device(
        motion=motion, matrix=matrix, offset_g=(0.01, -0.02, 0.003), noise_density_g=1e-4, rate_hz=200.0
    )
    device.step(3000)
    frames = decode(wire.data)
    assert len(frames) == 3000
    read = np.array([frame[3:6] for frame in frames]).T
    t = np.array([frame.t_s for frame in frames])
    expected = np.array(matrix) @ device.truth_block(t).gravity + np.array([[0.01], [-0.02], [0.003]])
    residual = read - expected
    assert np.std(residual, axis=1) == pytest.approx(1e-4 * math.sqrt(100.0), rel=0.06)
    assert np.abs(residual.mean(axis=1)).max() < 4 * 1e-3 / math.sqrt(3000)
    gyro = np.array([frame[6:9] for frame in frames]).T
    assert np.abs(gyro - np.rad2deg(device.truth_block(t).gyro_rad_s)).max() < 6 * 0.005 * math.sqrt(100.0)
    for k in (0, 1234, 2999):
        truth = device.truth(float(t[k]))
        block = device.truth_block(t[k : k + 1])
        assert truth.inclination_rad == block.inclination_rad[0]
        assert truth.toolface_rad == block.toolface_rad[0] % (2 * math.pi)


def test_gap_silence_and_reset_are_as_a_tool_would_do_them() -> None:
    device, wire = bench_device(motion=Motion((Leg(10.0, turn_deg=360.0),), 30.0))
    device.step(10)
    device.gap(3)
    device.step(5)
    device.silence()
    device.step(4)
    device.silence(False)
    device.noise(b"rubbish")
    device.step(2)
    device.reset()
    device.step(3)
    frames = decode(wire.data)
    assert [frame.seq for frame in frames] == [*range(10), 13, 14, 19, 20, 0, 1, 2]
    assert b"rubbish" in wire.data
    assert (device.produced, device.sent) == (24, 17)
    # after the reset its time is zero again, and the truth is still known: the turn went on
    assert device.truth(0.02).toolface_rad == pytest.approx(device.truth(0.23, boot=0).toolface_rad)


def test_it_goes_to_a_pose_smoothly_by_the_short_way() -> None:
    device, wire = bench_device(motion=still(10.0, 350.0), noise_density_g=0.0)
    device.step(10)
    device.set_pose(40.0, 20.0, move_s=1.0)
    device.step(300)
    device.set_pose(70.0, 180.0)
    device.step(10)
    frames = decode(wire.data)
    inclination = [math.degrees(math.atan2(math.hypot(f.ax, f.ay), f.az)) for f in frames]
    toolface = [math.degrees(math.atan2(f.ay, f.ax)) % 360.0 for f in frames]
    assert inclination[0] == pytest.approx(10.0, abs=1e-4)
    assert inclination[200] == pytest.approx(40.0, abs=1e-4)
    assert (toolface[0], toolface[200]) == (pytest.approx(350.0, abs=1e-4), pytest.approx(20.0, abs=1e-4))
    assert all(t >= 349.9 or t <= 20.1 for t in toolface[:310])
    assert np.abs(np.diff(inclination[:310])).max() < 1.0
    assert (inclination[-1], toolface[-1]) == (pytest.approx(70.0, abs=1e-4), pytest.approx(180.0, abs=1e-4))


def test_encoders_and_decoders_are_inverse() -> None:
    frame = Frame(7, 1.25, 0.0, 0.1, -0.2, 0.97, 1.0, -2.0, 3.0, 21.5)
    for back in (decode(encode(frame))[0], codec_from_name("dbc").build().receive_can(encode_can(frame))[0]):  # type: ignore[union-attr]
        assert back.seq == 7
        assert back[3:10] == pytest.approx(frame[3:10], abs=1e-6)


async def test_on_a_pty_it_is_unplugged_silenced_and_plugged_in_under_the_same_name(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "tool")
    device = SimulatedDevice(DeviceSettings(rate_hz=200.0), wire)
    codec, frames = ToolCodec(), []
    memory = Memory()
    settings = SupervisorSettings(backoff_initial_s=0.05, stale_after_s=0.3, reopen_after_s=30.0)
    running = asyncio.create_task(device.run())
    await until(lambda: wire.plugged, what="on")
    async with supervised(lambda: SerialTransport(SerialSettings(port=device.address)), memory, settings):
        await until(lambda: memory.state is LinkState.UP, what="up")
        device.silence()
        await until(lambda: memory.state is LinkState.STALE, what="stale")
        device.silence(False)
        await until(lambda: memory.state is LinkState.UP, what="up again")
        device.unplug()
        await until(lambda: memory.reason is LinkReason.END_OF_FILE, what="unplugged")
        device.plug()
        await until(lambda: memory.state is LinkState.UP, what="back")
        start = len(memory.data)
        await until(lambda: len(memory.data) > start + 5000, what="data")
    running.cancel()
    await asyncio.wait({running})
    assert not wire.plugged
    frames = codec.receive(bytes(memory.data))
    seqs = [frame.seq for frame in frames]
    assert seqs == sorted(seqs), "its counter went on while nobody heard it"
    assert codec.counts.frames_bad <= 2


async def test_the_simulated_link_brings_its_own_tool() -> None:
    link = SimulatedLink(kind="simulated", rate_hz=500.0, motion="still", inclination_deg=12.0, toolface_deg=34.0)
    memory = Memory()
    async with supervised(link.transport, memory, link.supervisor()):
        await until(lambda: len(memory.data) > 10_000, what="data")
    frames = decode(bytes(memory.data))
    assert len(frames) > 200
    mean = np.mean([frame[3:6] for frame in frames], axis=0)
    assert math.degrees(math.atan2(math.hypot(mean[0], mean[1]), mean[2])) == pytest.approx(12.0, abs=0.01)
    assert math.degrees(math.atan2(mean[1], mean[0])) == pytest.approx(34.0, abs=0.05)


async def test_detect_finds_the_tool_on_its_port_and_names_the_others(tmp_path: Path) -> None:
    device = SimulatedDevice(DeviceSettings(rate_hz=100.0), PtyWire(tmp_path / "tool"))
    device.start()
    quiet, taken = PtyWire(tmp_path / "quiet"), PtyWire(tmp_path / "taken")
    quiet.plug()
    taken.plug()
    owner = open_port(SerialSettings(port=taken.address))
    ports = [str(tmp_path / name) for name in ("tool", "quiet", "taken", "absent")]
    command = [*HIGHSIDE, "detect", "--seconds", "0.5", *(word for port in ports for word in ("--port", port))]
    try:
        plain = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=120)
        machine = await asyncio.to_thread(
            subprocess.run, [*command, "--json"], capture_output=True, text=True, timeout=120
        )
        nothing = await asyncio.to_thread(
            subprocess.run, [*command[:5], "0.2", "--port", ports[1]], capture_output=True, text=True, timeout=120
        )
    finally:
        device.stop()
        owner.close()
    assert plain.returncode == machine.returncode == 0, plain.stderr
    assert f'port = "{ports[0]}"' in plain.stdout
    found = {finding["port"]: finding for finding in json.loads(machine.stdout)}
    assert (found[ports[0]]["codec"], found[ports[0]]["share"] > 0.9) == ("tool", True)
    assert found[ports[0]]["frames"] >= 20
    assert "silent" in found[ports[1]]["note"]
    assert "in use" in found[ports[2]]["note"]
    assert "no such device" in found[ports[3]]["note"]
    assert nothing.returncode == 1
    assert nothing.stderr.count("\n") == 1


def test_detect_reports_noise_as_no_frame() -> None:
    wire = PtyWire()
    wire.plug()
    stop = threading.Event()

    def chatter() -> None:
        rng = random.Random(3)
        while not stop.wait(0.01):
            wire.write(rng.randbytes(100))

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        finding = probe_serial(wire.address, (115200, 9600), 0.3)
    finally:
        stop.set()
        thread.join()
        wire.unplug()
    assert finding.codec is None
    assert finding.bytes > 500
    assert "no valid frame" in finding.note


@pytest.mark.timing
async def test_python_cans_virtual_bus_brings_9000_frames_a_second_complete() -> None:
    """1,800 readings of 5 messages a second."""
    device = SimulatedDevice(
        DeviceSettings(rate_hz=1800.0),
        PythonCanWire(PythonCanSettings(interface="virtual", channel="load")),
        encode_can,
    )
    memory = Memory()
    async with supervised(
        lambda: PythonCanTransport(PythonCanSettings(interface="virtual", channel="load")), memory, QUICK
    ) as supervisor:
        await until(lambda: supervisor.stats.opens == 1, what="open")
        start = time.monotonic()
        device.start()
        await asyncio.sleep(2.0)
        device.stop_sending()
        took = time.monotonic() - start
        await until(lambda: len(memory.frames) >= 5 * device.sent, what="all")
        device.stop()
    codec = codec_from_name("dbc").build()
    readings = codec.receive_can(memory.frames)  # type: ignore[union-attr]
    assert [reading.seq for reading in readings] == list(range(device.sent))
    assert codec.counts.frames_bad == 0
    assert 5 * device.sent / took > 4500, "the device kept its rate, roughly"


async def test_a_python_can_bus_that_fails_is_reported_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    import can
    from can.interfaces.virtual import VirtualBus

    broken = asyncio.Event()
    original = VirtualBus._recv_internal

    def failing(self: VirtualBus, timeout: float | None) -> object:
        if broken.is_set():
            raise can.CanOperationError("the adapter was unplugged")
        return original(self, timeout)

    monkeypatch.setattr(VirtualBus, "_recv_internal", failing)
    memory = Memory()
    wire = PythonCanWire(PythonCanSettings(interface="virtual", channel="flaky"))
    wire.plug()
    async with supervised(
        lambda: PythonCanTransport(PythonCanSettings(interface="virtual", channel="flaky")), memory, QUICK
    ) as supervisor:
        await until(lambda: supervisor.stats.opens == 1, what="open")
        wire.write_frames([CanFrame(0, 0, 0x55, b"one")])
        await until(lambda: len(memory.frames) == 1, what="first")
        broken.set()
        await until(lambda: memory.state is LinkState.DOWN, what="seen")
        assert "unplugged" in memory.states[-1][3]
        broken.clear()
        await until(lambda: supervisor.stats.opens >= 2 and supervisor.stats.failures != {}, what="again")
        await asyncio.sleep(0.3)
        wire.write_frames([CanFrame(0, 0, 0x55, b"two", extended=True)])
        await until(lambda: memory.frames[-1].data == b"two", what="second")
    wire.unplug()
    assert memory.frames[-1].extended


async def test_an_unknown_python_can_interface_is_a_wrong_configuration() -> None:
    memory = Memory()
    async with supervised(
        lambda: PythonCanTransport(PythonCanSettings(interface="nonsense", channel=0)), memory, QUICK
    ):
        await until(lambda: memory.state is LinkState.DOWN, what="refused")
    assert memory.reason is LinkReason.CONFIG
    assert "nonsense" in memory.states[-1][3]
