"""The `[link]` table: where frames come from, and when the link is tried again.

`kind` says which transport it is; each model makes its transport (`transport()`, a fresh one for every attempt) and
the supervisor's settings (`supervisor()`). `carries` is "bytes" or "can", which the codec has to fit; None where only
the file tells.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from highside.link.base import SupervisorSettings, Transport
from highside.link.device import IDENTITY, DeviceSettings, SimulatedDevice, SimulatedTransport, encode_can
from highside.link.pythoncan import PythonCanSettings, PythonCanTransport
from highside.link.replay import ReplaySettings, ReplayTransport
from highside.link.serial import SerialSettings, SerialTransport
from highside.link.socketcan import SocketCanSettings, SocketCanTransport
from highside.link.wire import CanWire, PtyWire
from highside.physics.motion import demo, still
from highside.recording.wire import WireKind, detect_kind

Carries = Literal["bytes", "can"]
CanId = Annotated[int, Field(ge=0, le=0x1FFFFFFF)]
InterfaceName = Annotated[str, Field(min_length=1, max_length=15, pattern=r"^[^\s/]+$")]


class _Link(BaseModel):
    """What all links have: their supervisor's settings."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    wait_at_start: bool = Field(
        default=False,
        description="A link that cannot be opened when the service starts is waited for; false: the service ends at"
        " once and says why. Later failures are always waited out.",
    )
    backoff_initial_s: float = Field(default=0.1, gt=0, le=60, description="Pause before the first new attempt.")
    backoff_max_s: float = Field(default=5.0, gt=0, le=3600, description="Longest pause between two attempts.")
    jitter: float = Field(
        default=0.2, ge=0, le=1, description="Random share of each pause, so that tools do not knock together."
    )
    stale_after_s: float = Field(
        default=1.8, ge=0, description="Silence after which the link is called stale; 0: never."
    )
    reopen_after_s: float = Field(
        default=9.5, gt=0, description="Silence after which the link is closed and opened anew."
    )

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.backoff_max_s < self.backoff_initial_s:
            raise ValueError("backoff_max_s must not be less than backoff_initial_s")
        if self.reopen_after_s < self.stale_after_s:
            raise ValueError("reopen_after_s must not be less than stale_after_s")
        return self

    @property
    def carries(self) -> Carries | None:
        """What arrives."""
        return "bytes"

    @property
    def place(self) -> str | None:
        """What no two links can hold at once (a device, an adapter); None: nothing of the kind."""
        return None

    @property
    def opens_ahead(self) -> bool:
        """Whether it may be opened before anybody takes what arrives."""
        return True

    def transport(self) -> Transport:
        """A fresh transport for one attempt."""
        raise AssertionError("each kind of link makes its own")

    def supervisor(self) -> SupervisorSettings:
        return SupervisorSettings(
            backoff_initial_s=self.backoff_initial_s,
            backoff_max_s=self.backoff_max_s,
            jitter=self.jitter,
            stale_after_s=self.stale_after_s,
            reopen_after_s=self.reopen_after_s,
        )


class SerialLink(_Link):
    """A serial line, or a network one by pyserial's URLs."""

    kind: Literal["serial"]
    port: str = Field(
        min_length=1,
        description="Device (best /dev/serial/by-id/...), socket://host:port or rfc2217://host:port.",
    )
    baud: int = Field(default=115200, gt=0, le=12_000_000)
    bytesize: Literal[5, 6, 7, 8] = 8
    parity: Literal["N", "E", "O", "M", "S"] = "N"
    stopbits: float = Field(default=1.0, description="1, 1.5 or 2.")
    xonxoff: bool = False
    rtscts: bool = False

    @field_validator("stopbits")
    @classmethod
    def _stopbits_exist(cls, value: float) -> float:
        if value not in (1.0, 1.5, 2.0):
            raise ValueError("must be 1, 1.5 or 2")
        return value

    @property
    def place(self) -> str | None:
        """The device, by whatever name it is called; a terminal server often has one client at a time."""
        return self.port if "://" in self.port else os.path.realpath(self.port)

    def transport(self) -> Transport:
        return SerialTransport(
            SerialSettings(self.port, self.baud, self.bytesize, self.parity, self.stopbits, self.xonxoff, self.rtscts)
        )


class SocketCanLink(_Link):
    """A CAN interface of the kernel."""

    kind: Literal["socketcan"]
    interface: InterfaceName = Field(description="Its name, as `ip link` shows it.")
    fd: bool = Field(default=False, description="Receive CAN FD frames too.")
    can_ids: tuple[CanId, ...] = Field(default=(), description="Only these identifiers; above 0x7ff: extended ones.")
    receive_buffer_bytes: int = Field(default=8 * 1024 * 1024, ge=4096, le=1 << 30)

    @property
    def carries(self) -> Carries | None:
        return "can"

    def transport(self) -> Transport:
        return SocketCanTransport(SocketCanSettings(self.interface, self.fd, self.can_ids, self.receive_buffer_bytes))


class PythonCanLink(_Link):
    """Any other CAN adapter, through python-can."""

    kind: Literal["python-can"]
    interface: str = Field(
        min_length=1, description="python-can's name of the interface: pcan, kvaser, slcan, virtual, ..."
    )
    channel: str | int | None = None
    bitrate: int | None = Field(default=None, gt=0)
    fd: bool = False
    can_ids: tuple[CanId, ...] = ()
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="Further arguments of can.Bus."
    )

    @property
    def carries(self) -> Carries | None:
        return "can"

    @property
    def place(self) -> str | None:
        """An adapter seldom has more than one user."""
        return f"{self.interface} {self.channel}"

    def transport(self) -> Transport:
        return PythonCanTransport(
            PythonCanSettings(self.interface, self.channel, self.bitrate, self.fd, self.can_ids, dict(self.options))
        )


class ReplayLink(_Link):
    """A wire recording, played as if it came in now."""

    kind: Literal["replay"]
    path: Path = Field(description="A candump log, a recording of serial segments, or raw bytes; may be gzipped.")
    speed: float = Field(default=1.0, ge=0, description="1: in real time, 2: twice as fast; 0: as fast as possible.")
    byte_rate: float = Field(default=11520.0, gt=0, description="Bytes per second of a raw file, which has no times.")

    @property
    def carries(self) -> Carries | None:
        """As the file's beginning tells; None for an empty one. Raises InputError if it cannot be read."""
        if self.path.stat().st_size == 0:
            return None
        return "can" if detect_kind(self.path) is WireKind.CANDUMP else "bytes"

    @field_validator("path")
    @classmethod
    def _file_exists(cls, value: Path) -> Path:
        if not value.is_file():
            raise ValueError(f"no such file: {value}")
        return value

    @property
    def opens_ahead(self) -> bool:
        """It would begin to play, and the file was looked at."""
        return False

    def supervisor(self) -> SupervisorSettings:
        """A recording may be silent as long as it was: re-opening would begin it anew."""
        return replace(super().supervisor(), stale_after_s=0.0)

    def transport(self) -> Transport:
        return ReplayTransport(ReplaySettings(self.path, self.speed, self.byte_rate))


class SimulatedLink(_Link):
    """A simulated tool inside the process, on a pty or on a CAN interface."""

    kind: Literal["simulated"]
    interface: InterfaceName | None = Field(default=None, description="A CAN interface to send on; absent: a pty.")
    rate_hz: float = Field(default=100.0, gt=0, le=20_000)
    motion: Literal["demo", "still"] = "demo"
    inclination_deg: float = Field(default=30.0, ge=0, le=180, description="Where a still tool lies.")
    toolface_deg: float = Field(default=45.0, description="Where a still tool lies.")
    seed: int = Field(default=1, ge=0)
    matrix: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]] = IDENTITY
    offset_g: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_density_g: float = Field(default=20e-6, ge=0, description="g per root hertz.")
    gyros: bool = True
    gyro_bias_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_noise_density_dps: float = Field(default=0.005, ge=0, description="deg/s per root hertz.")
    latitude_deg: float | None = Field(
        default=None, ge=-90, le=90, description="Where it is: its gyros then see the Earth turn."
    )
    azimuth_deg: float = Field(default=0.0, ge=0, le=360, description="Of the hole; held by every motion.")
    temp_c: float = 25.0

    @property
    def carries(self) -> Carries | None:
        return "can" if self.interface else "bytes"

    @property
    def place(self) -> str | None:
        """Two tools on one interface would be heard as one."""
        return self.interface

    @cached_property
    def device(self) -> SimulatedDevice:
        """The tool; one for all attempts."""
        motion = demo(self.seed) if self.motion == "demo" else still(self.inclination_deg, self.toolface_deg)
        settings = DeviceSettings(
            rate_hz=self.rate_hz,
            motion=motion,
            matrix=self.matrix,
            offset_g=self.offset_g,
            noise_density_g=self.noise_density_g,
            gyros=self.gyros,
            gyro_bias_dps=self.gyro_bias_dps,
            gyro_noise_density_dps=self.gyro_noise_density_dps,
            latitude_deg=self.latitude_deg,
            azimuth_deg=self.azimuth_deg,
            temp_c=self.temp_c,
            seed=self.seed,
        )
        if self.interface:
            return SimulatedDevice(settings, CanWire(self.interface), encode_can)
        return SimulatedDevice(settings, PtyWire())

    def transport(self) -> Transport:
        device = self.device
        if self.interface:
            return SimulatedTransport(device, lambda: SocketCanTransport(SocketCanSettings(device.address)))
        return SimulatedTransport(device, lambda: SerialTransport(SerialSettings(device.address)))


LinkConfig = Annotated[
    SerialLink | SocketCanLink | PythonCanLink | ReplayLink | SimulatedLink, Field(discriminator="kind")
]
