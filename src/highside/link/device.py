"""The simulated tool: our own codec played from the other end, with a tool's faults on command.

Readings are `matrix @ (G + shaking) + offset + noise`, G from `physics.motion`; they are encoded with the tool's own
frame (or as CAN frames) and written to a wire at the frame rate, several a tick. Time and noise are counted by frames,
so that the content of a run depends on the seed alone, whatever the machine's mood: frame k is the reading at k / rate.

Tests and demonstrations may unplug it, plug it in again, silence it, let it send rubbish, skip frames, reset or turn
it. All calls are safe from any thread; `run` drives it in an event loop, `start` in a thread of its own.
"""

from __future__ import annotations

import asyncio
import bisect
import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, InstanceOf

from highside.arrays import Array
from highside.attitude.quaternion import direction_cosines, from_angles, to_tool
from highside.codec import tool, tool_can
from highside.codec.frame import CanFrame, Frame
from highside.link.base import Deliver, LinkError, Transport
from highside.link.wire import Wire
from highside.physics.gravity import EARTH_RATE_RADPS, gravity_direction
from highside.physics.motion import Leg, Motion, MotionBlock, demo, still
from highside.physics.rotation_chain import Faults, inclination_toolface_errors, package_turn
from highside.reading.config_table import ConfigTable

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
MAX_CATCH_UP_S = 1.0
"""after a longer stop of the machine the missed frames are skipped, as a tool does that nobody powered"""

CanEncoder = Callable[[Frame], list[CanFrame]]


class SimulatedSensor(ConfigTable):
    """The sensor of a simulated tool. Noise densities are one-sided; the band is half the frame rate."""

    rate_hz: float = Field(default=100.0, gt=0, le=20_000)
    seed: int = Field(default=1, ge=0)
    matrix: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]] = Field(
        default=IDENTITY, description="raw = matrix @ true + offset"
    )
    offset_g: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_density_g: float = Field(default=20e-6, ge=0, description="g per root hertz.")
    gyros: bool = True
    gyro_bias_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_noise_density_dps: float = Field(default=0.005, ge=0, description="deg/s per root hertz.")
    latitude_deg: float | None = Field(
        default=None, ge=-90, le=90, description="Where it is: its gyros then see the Earth turn."
    )
    azimuth_deg: float = Field(default=0.0, ge=0, le=360, description="Of the hole; held by every motion.")
    temp_c: float | None = 25.0


class DeviceSettings(SimulatedSensor):
    """A simulated tool: its sensor, how it is moved, and how it sends."""

    motion: InstanceOf[Motion] = Field(default_factory=demo)
    rotor_faults: InstanceOf[Faults] | None = Field(
        default=None, description="Of the rotor that turns it, whose angle and rate it then sends too; maybe none."
    )
    tick_s: float = 0.01
    speed: float = Field(default=1.0, description="How much faster than the wall's the tool's clock runs.")

    @property
    def noise_g(self) -> float:
        """Standard deviation of one reading."""
        return self.noise_density_g * math.sqrt(self.rate_hz / 2.0)


class Truth(NamedTuple):
    """Where the tool really was."""

    inclination_rad: float
    toolface_rad: float
    """in [0, 2 pi)"""


class Track:
    """The motions that the tool was given, one after the other, on one time base."""

    def __init__(self, motion: Motion) -> None:
        self._starts: list[float] = [0.0]
        self._motions: list[Motion] = [motion]

    def then(self, start_s: float, motion: Motion) -> None:
        """From `start_s` on (not before the last such call) follow `motion`."""
        self._starts.append(start_s)
        self._motions.append(motion)

    def block(self, t_s: Array) -> MotionBlock:
        """The motion at increasing instants `t_s`, shape (N,)."""
        parts: list[MotionBlock] = []
        edges = [*np.searchsorted(t_s, self._starts[1:], side="left"), len(t_s)]
        begin = 0
        for start, motion, end in zip(self._starts, self._motions, edges, strict=True):
            if end > begin:
                parts.append(motion.block(t_s[begin:end] - start)._replace(t_s=t_s[begin:end]))
            begin = max(begin, int(end))
        if len(parts) == 1:
            return parts[0]
        return MotionBlock(*(np.concatenate(pieces, axis=-1) for pieces in zip(*parts, strict=True)))

    def at(self, t_s: float) -> MotionBlock:
        """The motion at one instant, as a block of one."""
        last = max(0, bisect.bisect_right(self._starts, t_s) - 1)
        return self._motions[last].block(t_s - self._starts[last])


class SimulatedDevice:
    """A tool on a wire. With `can_encoder` it sends CAN frames, else the tool's own serial frame.

    `sent` counts frames handed to the wire, `produced` all of them (also those that fell into a silence, a gap or an
    unplugged time).
    """

    def __init__(self, settings: DeviceSettings, wire: Wire, can_encoder: CanEncoder | None = None) -> None:
        self.settings = settings
        self.wire = wire
        self.produced = 0
        self.sent = 0
        self._can_encoder = can_encoder
        self._rng = np.random.default_rng(settings.seed)
        self._matrix = np.array(settings.matrix, dtype=np.float64)
        self._offset = np.array(settings.offset_g, dtype=np.float64)[:, None]
        self._gyro_bias = np.array(settings.gyro_bias_dps, dtype=np.float64)[:, None]
        self._track = Track(settings.motion)
        self._lock = threading.RLock()
        self._silent = False
        self._skip = 0
        self._boots: list[int] = [0]
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    # what it knows

    @property
    def address(self) -> str:
        """What a reader has to open."""
        return self.wire.address

    @property
    def time_s(self) -> float:
        """Seconds since it was first switched on, by its own count of frames."""
        return self.produced / self.settings.rate_hz

    def truth(self, t_s: float, boot: int = -1) -> Truth:
        """Where it was at the device time `t_s` as sent in frames; `boot` counts its resets, the last by default."""
        with self._lock:
            state = self._track.at(t_s + self._boots[boot] / self.settings.rate_hz)
        return Truth(float(state.inclination_rad[0]), float(state.toolface_rad[0]) % (2.0 * math.pi))

    def truth_block(self, t_s: ArrayLike, boot: int = -1) -> MotionBlock:
        """All of the motion at increasing device times, shape (N,)."""
        with self._lock:
            return self._track.block(np.asarray(t_s, dtype=np.float64) + self._boots[boot] / self.settings.rate_hz)

    # commands

    def plug(self) -> None:
        with self._lock:
            self.wire.plug()

    def unplug(self) -> None:
        """The cable is pulled. The tool goes on, unheard."""
        with self._lock:
            self.wire.unplug()

    def silence(self, silent: bool = True) -> None:
        """Stay connected and send nothing (its frames are lost), or speak again."""
        with self._lock:
            self._silent = silent

    def gap(self, frames: int) -> None:
        """Leave out the next so many frames."""
        with self._lock:
            self._skip += frames

    def noise(self, data: bytes) -> None:
        """Put bytes on the line that are no frame."""
        with self._lock:
            self.wire.write(data)

    def reset(self) -> None:
        """Restart: its sequence number and its time begin at zero again; the motion goes on."""
        with self._lock:
            self._boots.append(self.produced)

    def set_pose(self, inclination_deg: float, toolface_deg: float, move_s: float = 0.0) -> None:
        """From the next frame on go to an attitude, by the short way in `move_s` seconds, and stay there."""
        with self._lock:
            now = self._track.at(self.time_s)
            if move_s <= 0.0:
                self._track.then(self.time_s, still(inclination_deg, toolface_deg))
                return
            from_deg = math.degrees(float(now.toolface_rad[0]))
            turn = (toolface_deg - from_deg + 180.0) % 360.0 - 180.0
            leg = Leg(move_s, inclination_to_deg=inclination_deg, turn_deg=turn)
            start = math.degrees(float(now.inclination_rad[0]))
            self._track.then(self.time_s, Motion((leg,), start, from_deg, repeat=False, seed=self.settings.seed))

    def set_motion(self, motion: Motion) -> None:
        """From the next frame on follow another programme, from its beginning."""
        with self._lock:
            self._track.then(self.time_s, motion)

    # its work

    def frames(self, count: int) -> Iterator[Frame]:
        """The next `count` readings, uncounted losses included; advances the device's time."""
        settings = self.settings
        with self._lock:
            first = self.produced
            self.produced += count
            index = np.arange(first, first + count)
            motion = self._track.block(index / settings.rate_hz)
            # one row a frame, always all columns: the content does not depend on how frames fall into ticks
            noise = self._rng.standard_normal((count, 6)).T
            accel = self._matrix @ (self._felt(motion) + motion.vibration_g) + self._offset
            accel += settings.noise_g * noise[:3]
            gyro = np.rad2deg(self._rates(motion)) + self._gyro_bias
            gyro += settings.gyro_noise_density_dps * math.sqrt(settings.rate_hz / 2.0) * noise[3:]
            boot = self._boots[-1]
        rotor: list[tuple[float | None, float | None]] = [(None, None)] * count
        if settings.rotor_faults is not None:
            angle, rate = np.rad2deg(motion.toolface_rad) % 360.0, np.rad2deg(-motion.gyro_rad_s[2])
            rotor = list(zip(angle.tolist(), rate.tolist(), strict=True))
        # Python floats: the encoder packs one frame at a time
        rows = zip(range(first - boot, first - boot + count), accel.T.tolist(), gyro.T.tolist(), rotor, strict=True)
        for k, a, w, turned in rows:
            gx, gy, gz = w if settings.gyros else (None, None, None)
            t_s = k / settings.rate_hz
            yield Frame(k % tool.SEQ_MODULUS, t_s, 0.0, a[0], a[1], a[2], gx, gy, gz, settings.temp_c, *turned)

    def _felt(self, motion: MotionBlock) -> Array:
        """Gravity in the tool's axes, (3, N): a rotor with faults holds the tool other than its encoder says."""
        faults = self.settings.rotor_faults
        if not faults:
            return motion.gravity
        d_inc, d_tf = inclination_toolface_errors(motion.toolface_rad, motion.inclination_rad, faults)
        return gravity_direction(motion.inclination_rad + d_inc, motion.toolface_rad + d_tf)

    def _rates(self, motion: MotionBlock) -> Array:
        """What its gyros feel, (3, N) rad/s: a rotor with faults turns the tool other than its encoder says."""
        rates = motion.gyro_rad_s + self._earth(motion)
        faults = self.settings.rotor_faults
        if not faults:
            return rates
        inc, tf = motion.inclination_rad, motion.toolface_rad
        wx, wy, wz = motion.gyro_rad_s
        inc_rate, tf_rate = wx * np.sin(tf) - wy * np.cos(tf), -wz
        h = 1e-4
        before, now, after = (package_turn(tf + k * tf_rate, inc + k * inc_rate, faults) for k in (-h, 0.0, h))
        # u = E u_perfect and du/dt = -w x u for every direction u fixed in space: [w]x = E [w_perfect]x E^T - dE/dt E^T
        own = np.einsum("ijn,kjn->ikn", (after - before) / (2.0 * h), now)
        turn = 0.5 * np.stack([own[2, 1] - own[1, 2], own[0, 2] - own[2, 0], own[1, 0] - own[0, 1]])
        return np.asarray(np.einsum("ijn,jn->in", now, rates) - turn)

    def _earth(self, motion: MotionBlock) -> Array:
        """The Earth's rotation in the tool's axes, (3, N) rad/s."""
        settings = self.settings
        if settings.latitude_deg is None:
            return np.zeros((3, 1))
        theta = motion.inclination_rad - 0.5 * math.pi
        q = from_angles(theta, motion.toolface_rad, math.radians(settings.azimuth_deg))
        latitude = math.radians(settings.latitude_deg)
        earth = EARTH_RATE_RADPS * np.array([0.0, math.cos(latitude), math.sin(latitude)])
        return to_tool(np.einsum("ijn,j->in", direction_cosines(q), earth))

    def step(self, count: int) -> None:
        """Produce and send the next `count` frames."""
        with self._lock:
            frames = list(self.frames(count))
            skipped = min(self._skip, count)
            self._skip -= skipped
            frames = [] if self._silent else frames[skipped:]
            self.sent += len(frames)
            if self._can_encoder is not None:
                self.wire.write_frames([can_frame for frame in frames for can_frame in self._can_encoder(frame)])
            else:
                self.wire.write(b"".join(map(encode, frames)))

    def _ticks(self) -> Iterator[float]:
        """Work off what is due, and say how long to wait until the next tick."""
        settings = self.settings
        rate_hz = settings.rate_hz * settings.speed
        start, base = time.monotonic(), self.produced
        # slow tools send on the beat of their frames, fast ones several frames a tick
        frames_a_tick = max(1, round(rate_hz * settings.tick_s))
        while True:
            due = int((time.monotonic() - start) * rate_hz) + base - self.produced
            if due > max(1.0, MAX_CATCH_UP_S * rate_hz):
                start, base = time.monotonic(), self.produced
                due = 1
            if due > 0 or self.wire.pending:
                self.step(due)
            wait_s = start + (self.produced - base + frames_a_tick) / rate_hz - time.monotonic()
            yield max(0.0, min(wait_s, settings.tick_s) if self.wire.pending else wait_s)

    async def run(self) -> None:
        """Send at the frame rate until cancelled; plugs in at the start and unplugs at the end."""
        self.plug()
        try:
            for wait_s in self._ticks():
                await asyncio.sleep(wait_s)
        finally:
            self.unplug()

    def start(self) -> None:
        """Like `run`, in a thread of its own, until `stop`."""
        self.plug()
        self._stop.clear()
        self._thread = threading.Thread(target=self._run_in_thread, name="simulated tool", daemon=True)
        self._thread.start()

    def _run_in_thread(self) -> None:
        for wait_s in self._ticks():
            if self._stop.wait(wait_s):
                return

    def stop_sending(self) -> None:
        """End the thread and stay connected, so that a reader can take what is on its way."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            self.wire.flush()

    def stop(self) -> None:
        """End the thread and unplug."""
        self.stop_sending()
        with contextlib.suppress(OSError):
            self.unplug()


def encode(frame: Frame) -> bytes:
    """A reading as the tool's own serial frame."""
    return tool.encode(frame.seq or 0, frame.t_s or 0.0, frame[3:6], **_measured(frame))


def encode_can(frame: Frame) -> list[CanFrame]:
    """A reading as the tool's own CAN messages (`config/highside.dbc`)."""
    return tool_can.encode(frame.seq or 0, frame.t_s or 0.0, frame[3:6], **_measured(frame))


class _Measured(TypedDict):
    """What both encoders take beside the accelerations."""

    gyro_dps: tuple[float, float, float] | None
    temp_c: float | None
    rotor_deg: float | None
    rotor_rate_dps: float


def _measured(frame: Frame) -> _Measured:
    x, y, z = frame.gx, frame.gy, frame.gz
    return {
        "gyro_dps": None if x is None or y is None or z is None else (x, y, z),
        "temp_c": frame.temp_c,
        "rotor_deg": frame.rotor_deg,
        "rotor_rate_dps": frame.rotor_rate_dps or 0.0,
    }


class SimulatedTransport:
    """A link with its tool built in: the device on its wire, and the real transport that reads the other end.

    For trying out a configuration without hardware. `reader` makes the transport once the device is plugged in; a fresh
    attempt goes on with the same device.
    """

    def __init__(self, device: SimulatedDevice, reader: Callable[[], Transport]) -> None:
        self.device = device
        self._make_reader = reader
        self._reader: Transport | None = None
        self._running: asyncio.Task[None] | None = None

    @property
    def kernel_drops(self) -> int:
        return self._reader.kernel_drops if self._reader is not None else 0

    async def open(self, deliver: Deliver) -> None:
        self.device.plug()
        self._reader = self._make_reader()
        await self._reader.open(deliver)
        self._running = asyncio.create_task(self.device.run())

    async def wait_closed(self) -> LinkError:
        assert self._reader is not None, "open first"
        return await self._reader.wait_closed()

    async def wait_ready(self) -> None:
        if self._reader is not None:
            await self._reader.wait_ready()

    async def close(self) -> None:
        if self._running is not None:
            self._running.cancel()
            await asyncio.wait({self._running})
            self._running = None
        if self._reader is not None:
            await self._reader.close()
