"""What passes between links, codecs and the pipeline: wire batches in, `Frame`s out, and counts that add up.

A codec is sans-IO: it is given bytes (or CAN frames) with the time at which they arrived and returns the frames that
are complete. It never raises on wire content, never grows without bound, and accounts for every byte.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple, Protocol


class Frame(NamedTuple):
    """One reading of the tool in nominal units, uncorrected, its axes already mapped to the tool frame if configured.

    `seq` is the device's own counter as sent (None where it sends none); `t_s` the device's time in seconds, unwrapped
    (None where it sends none); `t_mono` the monotonic time in seconds at which the frame's last byte was read (0.0 in
    offline decoding); `ax..az` the reported gravity direction in g; `gx..gz` deg/s; `rotor_deg` and `rotor_rate_dps`
    angle and rate of a rotor that turns the tool, by its encoder, for the rotor-angle compensation of I, T and azimuth;
    `extra` the maker's own further quantities, in the order of the codec's `extra_columns`. An acceleration that the
    source does not have (a car's bus gives the lateral one alone) is NaN.
    """

    seq: int | None
    t_s: float | None
    t_mono: float
    ax: float
    ay: float
    az: float
    gx: float | None = None
    gy: float | None = None
    gz: float | None = None
    temp_c: float | None = None
    rotor_deg: float | None = None
    rotor_rate_dps: float | None = None
    extra: tuple[float, ...] | None = None


FRAME_COLUMNS: dict[str, str] = {
    "ax_g": "ax",
    "ay_g": "ay",
    "az_g": "az",
    "gx_dps": "gx",
    "gy_dps": "gy",
    "gz_dps": "gz",
    "temp_c": "temp_c",
    "rotor_deg": "rotor_deg",
    "rotor_rate_dps": "rotor_rate_dps",
}
"""Column of a Recording (with its unit) -> field of `Frame`, in the order in which `Frame` holds them."""

ADDED_COLUMNS = (
    "inc_ref_deg",
    "tf_ref_deg",
    "azi_ref_deg",
    "pose",
    "direction",
    "vibration_rms_g",
    "vibration_x_rms_g",
    "vibration_y_rms_g",
    "vibration_z_rms_g",
    "noise_g",
    "seq",
)
"""Columns of a Recording that no sensor gives: the bench's, and what is found out later."""

NAN = float("nan")


class CanFrame(NamedTuple):
    """One frame from a CAN bus. `t_wall` is the epoch time of its reception (kernel stamp or recording)."""

    t_mono: float
    t_wall: float
    can_id: int
    data: bytes
    extended: bool = False
    error: bool = False
    remote: bool = False
    fd: bool = False


@dataclass(slots=True)
class Counts:
    """Where every byte and every frame went; for CAN the unit of the `bytes_*` is the payload byte.

    A frame is good when a reading is whole with it, so there are as many good frames as readings. At any time
    `bytes_in == bytes_framed + bytes_bad + bytes_text + bytes_ignored + bytes_junk + bytes_pending` and
    `frames == frames_good + frames_bad`. (Duplicates are found by the monitor, which knows the order of frames.)
    """

    bytes_in: int = 0
    bytes_framed: int = 0
    """in frames that passed every check"""
    bytes_bad: int = 0
    """in candidates that began like a frame and failed a check"""
    bytes_text: int = 0
    """in readable text between frames that the codec knows and passes over"""
    bytes_ignored: int = 0
    """in well-formed messages that are not for this codec (`frames_ignored`)"""
    bytes_junk: int = 0
    bytes_pending: int = 0
    """held back: the start of a frame that is not complete yet"""
    frames_good: int = 0
    frames_held: int = 0
    """of the good ones: not handed out yet, because what belongs to it (its time) may still come"""
    frames_part: int = 0
    """good packets that were not the last of their reading, where a sensor splits one over several"""
    frames_bad: int = 0
    """candidates refused by CRC, length, version or range"""
    frames_ignored: int = 0
    """well-formed messages that are not for this codec (another CAN id, another sensor)"""

    @property
    def frames(self) -> int:
        return self.frames_good + self.frames_bad

    def balanced(self) -> bool:
        return self.bytes_in == (
            self.bytes_framed
            + self.bytes_bad
            + self.bytes_text
            + self.bytes_ignored
            + self.bytes_junk
            + self.bytes_pending
        )

    def as_dict(self) -> dict[str, int]:
        return asdict(self) | {"frames": self.frames}


class ByteCodec(Protocol):
    """Decoder of a byte stream."""

    name: str
    counts: Counts
    extra_columns: tuple[str, ...]
    seq_modulus: int | None
    """period of the counter in `Frame.seq` (None: the device sends none)"""

    def receive(self, data: bytes, t_mono: float = 0.0) -> list[Frame]:
        """Take bytes read at `t_mono` and return the frames they complete. Never raises on content."""

    def reset(self) -> None:
        """The link was re-opened: what is pending will never be completed and becomes junk. Counts are kept."""

    def flush(self) -> list[Frame]:
        """The input has ended: return what can still be returned, count the rest; nothing stays pending."""


class CanCodec(Protocol):
    """Decoder of CAN frames."""

    name: str
    counts: Counts
    extra_columns: tuple[str, ...]
    seq_modulus: int | None
    """period of the counter in `Frame.seq` (None: the device sends none)"""

    def receive_can(self, frames: list[CanFrame]) -> list[Frame]:
        """Take CAN frames in order of arrival and return the readings they complete. Never raises on content."""

    def reset(self) -> None: ...

    def flush(self) -> list[Frame]: ...
