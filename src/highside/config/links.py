"""The `[link]` table: where frames come from, and when the link is tried again.

`kind` says which transport it is; each model makes its transport (`transport()`, a fresh one for every attempt) and
the supervisor's settings (`supervisor()`). `carries` is "bytes" or "can", which the codec has to fit; None where only
the file tells.
"""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from highside.link.base import SupervisorSettings, Transport
from highside.link.device import (
    DeviceSettings,
    SimulatedDevice,
    SimulatedSensor,
    SimulatedTransport,
    encode_can,
)
from highside.link.pythoncan import PythonCanSettings, PythonCanTransport
from highside.link.replay import ReplaySettings, ReplayTransport
from highside.link.serial import SerialSettings, SerialTransport
from highside.link.socketcan import SocketCanSettings, SocketCanTransport
from highside.link.tcp_wire import local_reader, local_wire
from highside.link.wire import CanWire
from highside.physics.motion import demo, still
from highside.recording.wire import WireKind, detect_kind

Carries = Literal["bytes", "can"]
InterfaceName = Annotated[str, Field(min_length=1, max_length=15, pattern=r"^[^\s/]+$")]


class _Link(SupervisorSettings):
    """What all links have: their supervisor's settings."""

    wait_at_start: bool = Field(
        default=False,
        description="A link that cannot be opened when the service starts is waited for; false: the service ends at"
        " once and says why. Later failures are always waited out.",
    )

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

    def same_line(self, other: _Link) -> bool:
        """Whether the other describes the same open link, and differs in when it is called silent or tried again at
        most."""
        if type(self) is not type(other):
            return False
        when = (*SupervisorSettings.model_fields, "wait_at_start")
        return self.model_copy(update={name: getattr(other, name) for name in when}) == other

    def transport(self) -> Transport:
        """A fresh transport for one attempt."""
        raise AssertionError("each kind of link makes its own")

    def supervisor(self) -> SupervisorSettings:
        return self


class SerialLink(SerialSettings, _Link):
    """A serial line, or a network one by pyserial's URLs."""

    kind: Literal["serial"]

    @property
    def place(self) -> str | None:
        """The device, by whatever name it is called; a terminal server often has one client at a time."""
        return self.port if "://" in self.port else os.path.realpath(self.port)

    def transport(self) -> Transport:
        return SerialTransport(self)


class SocketCanLink(SocketCanSettings, _Link):
    """A CAN interface of the kernel."""

    kind: Literal["socketcan"]
    interface: InterfaceName = Field(description="Its name, as `ip link` shows it.")

    @property
    def carries(self) -> Carries | None:
        return "can"

    def transport(self) -> Transport:
        return SocketCanTransport(self)


class PythonCanLink(PythonCanSettings, _Link):
    """Any other CAN adapter, through python-can."""

    kind: Literal["python-can"]

    @property
    def carries(self) -> Carries | None:
        return "can"

    @property
    def place(self) -> str | None:
        """An adapter seldom has more than one user."""
        return f"{self.interface} {self.channel}"

    def transport(self) -> Transport:
        return PythonCanTransport(self)


class ReplayLink(ReplaySettings, _Link):
    """A wire recording, played as if it came in now."""

    kind: Literal["replay"]

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
        return self.model_copy(update={"stale_after_s": 0.0})

    def transport(self) -> Transport:
        return ReplayTransport(self)


class SimulatedLink(SimulatedSensor, _Link):
    """A simulated tool inside the process, on a pty or on a CAN interface."""

    kind: Literal["simulated"]
    interface: InterfaceName | None = Field(default=None, description="A CAN interface to send on; absent: a pty.")
    motion: Literal["demo", "still"] = "demo"
    inclination_deg: float = Field(default=30.0, ge=0, le=180, description="Where a still tool lies.")
    toolface_deg: float = Field(default=45.0, description="Where a still tool lies.")

    @property
    def carries(self) -> Carries | None:
        return "can" if self.interface else "bytes"

    @property
    def place(self) -> str | None:
        """Two tools on one interface would be received as one."""
        return self.interface

    @cached_property
    def device(self) -> SimulatedDevice:
        """The tool; one for all attempts."""
        motion = demo(self.seed) if self.motion == "demo" else still(self.inclination_deg, self.toolface_deg)
        sensor = {name: getattr(self, name) for name in SimulatedSensor.model_fields}
        settings = DeviceSettings(motion=motion, **sensor)
        if self.interface:
            return SimulatedDevice(settings, CanWire(self.interface), encode_can)
        return SimulatedDevice(settings, local_wire())

    def transport(self) -> Transport:
        device = self.device
        if self.interface:
            return SimulatedTransport(device, lambda: SocketCanTransport(SocketCanSettings(interface=device.address)))
        return SimulatedTransport(device, lambda: local_reader(device.address))


LinkConfig = Annotated[
    SerialLink | SocketCanLink | PythonCanLink | ReplayLink | SimulatedLink, Field(discriminator="kind")
]
