"""The demonstration: a simulated tool on a pty, the production pipeline behind it, and a reader at its outbox.

Nothing of the path is special to the demonstration but its two ends: the serial link, the codec, the monitor, the
correction by a calibration record and the outbox are those of `highside run`. No broker is needed: the messages are
taken out of the outbox where the publisher would take them, counted by one who knows nothing of what made them, and
compared with where the simulated tool really was.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from highside.attitude.scalar import attitude
from highside.calibration.method import SolveRequest
from highside.calibration.methods.conventional import METHOD as CONVENTIONAL
from highside.calibration.record import CalibrationRecord, Environment, build_record, solve_poses
from highside.config.settings import Settings, validate
from highside.link.base import LinkState
from highside.link.device import DeviceSettings, SimulatedDevice
from highside.link.wire import PtyWire
from highside.physics.gravity import gravity_direction
from highside.reading import parse_json
from highside.recording.files import write_whole
from highside.service.app import Service
from highside.service.demo_plug import PulledPlug
from highside.service.outputs import AttitudeOutput
from highside.service.publisher import Publisher

TOOL_ID = "demo"
RATE_HZ = 200.0
OUTPUT_RATE_HZ = 20.0

# what the simulated sensor does to gravity: raw = MATRIX @ g + offset
MATRIX = ((0.9991, 0.0038, -0.0007), (-0.0019, 0.9989, 0.0001), (0.0009, 0.0003, 0.9982))
OFFSET_G = (0.0012, -0.0008, 0.0015)
"""of the sensor of `factory_record`"""
DEMO_OFFSET_G = (0.0120, -0.0080, 0.0150)
"""of the demonstration's: a MEMS triad before calibration (data sheets of MPU-6050, LSM6DSO: 20 to 60 mg)"""


@dataclass(slots=True)
class DemoState:
    """What the demonstration knows at one moment; angles in degrees."""

    elapsed_s: float = 0.0
    frames: int = 0
    published: int = 0
    lost: int = 0
    latest: dict[str, Any] | None = None
    truth_inc_deg: float = math.nan
    truth_tf_deg: float = math.nan
    survey: dict[str, Any] | None = None
    surveys: int = 0
    health: dict[str, Any] | None = None
    linked: bool = True
    """whether the tool is heard"""
    latency_ms: list[float] = field(default_factory=list)
    inc_errors_deg: list[float] = field(default_factory=list)
    tf_errors_deg: list[float] = field(default_factory=list)
    """those of toolface; as of inclination, while nothing shakes the tool"""
    shaken_errors_deg: list[float] = field(default_factory=list)
    """of inclination while it is shaken: the acceleration is read as gravity, and its uncertainty says so"""
    raw_inc_deg: float = math.nan
    raw_tf_deg: float = math.nan
    """of the same readings without the calibration"""
    raw_inc_errors_deg: list[float] = field(default_factory=list)
    raw_tf_errors_deg: list[float] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    """seconds since the start and what happened: the plug"""

    def latency_p99_ms(self) -> float | None:
        """From a frame's last byte until its message is taken out of the outbox."""
        return float(np.percentile(self.latency_ms, 99)) if self.latency_ms else None

    def summary(self) -> dict[str, Any]:
        """The object that `highside demo --json` prints."""
        latest = self.latest or {}
        p99 = self.latency_p99_ms()
        return {
            "frames": self.frames,
            "published": self.published,
            "lost": self.lost,
            "inc_deg": latest.get("inc_deg"),
            "tf_deg": latest.get("tf_deg"),
            "truth_inc_deg": None if math.isnan(self.truth_inc_deg) else round(self.truth_inc_deg, 6),
            "truth_tf_deg": None if math.isnan(self.truth_tf_deg) else round(self.truth_tf_deg, 6),
            "latency_p99_ms": None if p99 is None else round(p99, 3),
            "inc_std_deg": latest.get("inc_std_deg"),
            "tf_std_deg": latest.get("tf_std_deg"),
            "inc_error_rms_deg": _rms(self.inc_errors_deg),
            "tf_error_rms_deg": _rms(self.tf_errors_deg),
            "inc_error_rms_uncorrected_deg": _rms(self.raw_inc_errors_deg),
            "tf_error_rms_uncorrected_deg": _rms(self.raw_tf_errors_deg),
            "inc_error_rms_shaken_deg": _rms(self.shaken_errors_deg),
            "events": [f"{at_s:.1f} s: {text}" for at_s, text in self.events],
            "surveys": self.surveys,
            "seconds": round(self.elapsed_s, 3),
        }


def _rms(values: list[float]) -> float | None:
    return round(math.sqrt(sum(v * v for v in values) / len(values)), 6) if values else None


def _turned(difference_deg: float) -> float:
    """A difference of toolfaces in [-180, 180)."""
    return (difference_deg + 180.0) % 360.0 - 180.0


class Watcher:
    """Whom the messages are for: counts them and their gaps by sequence number, compares them with the truth."""

    def __init__(self, device: SimulatedDevice) -> None:
        self.snapshot = DemoState()
        self._device = device
        self._shown: set[int] = set()

    def take(self, topic: str, message: bytes) -> None:
        """One message as it would go to a broker; the monotonic time of its arrival is now."""
        now_mono = time.monotonic()
        snapshot, payload = self.snapshot, parse_json(message)
        name = topic.rsplit("/", 1)[-1]
        if name == "health":
            snapshot.health = payload
        elif name == "survey":
            snapshot.survey = payload
            snapshot.surveys += 1
        elif name == "attitude" and payload["seq"] not in self._shown:
            self._shown.add(payload["seq"])
            snapshot.published += 1
            # sequence numbers begin at 0 with the demonstration's own outbox
            snapshot.lost = max(self._shown) + 1 - len(self._shown)
            snapshot.latest = payload
            snapshot.latency_ms.append((now_mono - payload["t_mono"]) * 1e3)
            self._compare(payload)

    def uncorrected(self, output: AttitudeOutput) -> None:
        """What the sensor itself says: the mean of the window taken back through the sensor's own errors."""
        raw = np.array(MATRIX) @ np.array(output.accel) + np.array(DEMO_OFFSET_G)
        inclination_rad, toolface_rad = attitude(*raw.tolist())
        self.snapshot.raw_inc_deg = math.degrees(inclination_rad)
        self.snapshot.raw_tf_deg = math.degrees(toolface_rad) % 360.0
        middle_s = output.t_device_s - output.window_s / 2.0
        truth = self._device.truth(middle_s)
        if not self._shaken(middle_s):
            self.snapshot.raw_inc_errors_deg.append(self.snapshot.raw_inc_deg - math.degrees(truth.inclination_rad))
            self.snapshot.raw_tf_errors_deg.append(_turned(self.snapshot.raw_tf_deg - math.degrees(truth.toolface_rad)))

    def _compare(self, payload: dict[str, Any]) -> None:
        snapshot = self.snapshot
        middle_s = payload["t_device_s"] - payload["window_s"] / 2.0
        truth = self._device.truth(middle_s)
        snapshot.truth_inc_deg = math.degrees(truth.inclination_rad)
        snapshot.truth_tf_deg = math.degrees(truth.toolface_rad)
        error_deg = payload["inc_deg"] - snapshot.truth_inc_deg
        if self._shaken(middle_s):
            snapshot.shaken_errors_deg.append(error_deg)
            return
        snapshot.inc_errors_deg.append(error_deg)
        if payload["tf_deg"] is not None:
            snapshot.tf_errors_deg.append(_turned(payload["tf_deg"] - snapshot.truth_tf_deg))

    def _shaken(self, t_s: float) -> bool:
        """Whether the tool is shaken around that time; a window has 0.05 s."""
        return bool((self._device.truth_block([t_s - 0.05, t_s, t_s + 0.05]).vibration_rms_g > 0.0).any())

    def account(self, last_seq: int | None) -> None:
        """At the end: everything up to `last_seq`, the last that the service made, had to arrive."""
        if last_seq is not None:
            self.snapshot.lost = last_seq + 1 - len(self._shown)


class OutboxReader(Publisher):
    """Stands where the publisher stands and hands the messages over inside the process: taken from the outbox in its
    order and acknowledged one by one, as after a broker's PUBACK."""

    def __init__(self, service: Service, to: Callable[[str, bytes], None]) -> None:
        super().__init__(service.settings.mqtt, service.outbox, tool_id=service.settings.tool.id)
        self._from = service.outbox
        self._to = to

    def retained(self, topic: str, payload: bytes) -> None:
        self._to(topic, payload)

    async def run(self) -> None:
        """Take what is there whenever the outbox says that something may be; ends by being cancelled."""
        loop, ready = asyncio.get_running_loop(), asyncio.Event()
        self._from.begin_delivery(lambda: _set_soon(loop, ready), ready.set)
        self.connected = True
        self.connects += 1
        try:
            while True:
                ready.clear()
                while (taken := self._from.take()) is not None:
                    row, _ = taken
                    self._to(row.topic, row.payload)
                    self._from.ack(row.id)
                await ready.wait()
        finally:
            self.connected = False
            self._from.end_delivery()

    async def stop(self, timeout_s: float) -> None:
        """Wait until everything is taken."""
        await _settle(lambda: self._from.stats.queued == 0, timeout_s)


def _set_soon(loop: asyncio.AbstractEventLoop, event: asyncio.Event) -> None:
    """Set an event of `loop` from the outbox's thread."""
    loop.call_soon_threadsafe(event.set)


async def run_demo(
    seconds: float | None, on_snapshot: Callable[[DemoState], None], *, interval_s: float = 0.1
) -> DemoState:
    """Run for `seconds` (None: until cancelled), calling `on_snapshot` every `interval_s`; return the last one."""
    with tempfile.TemporaryDirectory(prefix="highside-demo-") as directory:
        return await _run_in(Path(directory), seconds, on_snapshot, interval_s)


async def _run_in(
    directory: Path, seconds: float | None, on_snapshot: Callable[[DemoState], None], interval_s: float
) -> DemoState:
    wire = PtyWire(directory / "tool")  # the name stays when the plug is put back
    device = SimulatedDevice(DeviceSettings(rate_hz=RATE_HZ, matrix=MATRIX, offset_g=DEMO_OFFSET_G), wire)
    watcher = Watcher(device)
    snapshot = watcher.snapshot
    last_seq: int | None = None

    def note(output: object, seq: int) -> None:
        nonlocal last_seq
        if isinstance(output, AttitudeOutput):
            last_seq = seq
            watcher.uncorrected(output)

    device.start()
    try:
        service = Service(_settings(directory, device.address))
        service.on_output = note
        service.parts = replace(service.parts, publisher=OutboxReader(service, watcher.take))
        plug = PulledPlug(device, service, snapshot.events)
        serving = asyncio.create_task(service.run())
        start = time.monotonic()
        try:
            while not serving.done():
                await asyncio.sleep(interval_s)
                snapshot.elapsed_s = time.monotonic() - start
                snapshot.frames = service.pipeline.monitor.counts.good
                snapshot.linked = service.supervisor.stats.state is LinkState.UP
                plug.tend(snapshot.elapsed_s, snapshot.published)
                on_snapshot(snapshot)
                if seconds is not None and snapshot.elapsed_s >= seconds:
                    break
            # the tool falls silent first, so that what it said is delivered before the service leaves
            device.stop()
            await _settle(lambda: service.outbox.stats.queued == 0)
        finally:
            service.stop()
            await serving
            snapshot.frames = service.pipeline.monitor.counts.good
        watcher.account(last_seq)
    finally:
        device.stop()
    return snapshot


async def _settle(done: Callable[[], bool], timeout_s: float = 2.0) -> None:
    """Give the last messages time to arrive."""
    end = time.monotonic() + timeout_s
    while not done() and time.monotonic() < end:
        await asyncio.sleep(0.02)


def factory_record(offset_g: tuple[float, float, float] = OFFSET_G) -> CalibrationRecord:
    """Calibrate the simulated sensor as a bench would: 24 positions, 100 noisy readings each, solved and recorded."""
    rng = np.random.default_rng(24)
    noise_g = DeviceSettings(rate_hz=RATE_HZ).noise_g
    inc = np.repeat([30.0, 90.0, 150.0], 8)
    tf = np.tile(np.arange(0.0, 360.0, 45.0), 3)
    g = gravity_direction(np.deg2rad(inc), np.deg2rad(tf))
    a = np.array(MATRIX) @ g + np.array(offset_g)[:, None] + noise_g / 10.0 * rng.standard_normal(g.shape)
    columns = {"inc_ref_deg": inc, "tf_ref_deg": tf, "ax": a[0], "ay": a[1], "az": a[2], "n": np.full(24, 100.0)}
    columns |= {f"std_a{axis}": np.full(24, noise_g) for axis in "xyz"}
    poses = {name: values.tolist() for name, values in columns.items()}
    request = SolveRequest(CONVENTIONAL.name)
    return build_record(
        tool_id=TOOL_ID,
        serial=None,
        request=request,
        result=solve_poses(poses, request).result,
        pose_columns=poses,
        raw_sha256=hashlib.sha256(json.dumps(poses).encode()).hexdigest(),
        raw_name="simulated bench",
        environment=Environment(bench="simulated", temp_c=25.0),
        now_s=time.time(),
    )


def _settings(directory: Path, port: str) -> Settings:
    record = directory / "calibration.json"
    write_whole(record, factory_record(DEMO_OFFSET_G).to_json().encode())
    return validate(
        {
            "tool": {"id": TOOL_ID},
            "link": {"kind": "serial", "port": port},
            "codec": {"name": "tool"},
            "pipeline": {"output_rate_hz": OUTPUT_RATE_HZ},
            "survey": {"still_s": 4.0},
            "calibration": {"record": str(record)},
            # topics of its own: a second demonstration on this machine is another tool
            "mqtt": {"prefix": directory.name},
            "service": {"state_dir": str(directory / "state"), "health_interval_s": 1.0, "log_level": "error"},
        },
        where="the demonstration's settings",
        environment=False,
    )
