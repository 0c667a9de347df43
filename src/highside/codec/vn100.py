r"""VectorNav VN-100 binary frames between the text of a logger.

A frame is 124 bytes: sync FA, groups 14 (IMU and attitude), IMU fields 003E (magnetic field, acceleration, angular
rate, temperature, pressure), attitude fields 003A (yaw-pitch-roll, DCM, magnetic field and acceleration north-east-
down), 29 little-endian float32, and VectorNav's CRC-16 (polynomial 1021, start 0, big-endian) of all but the sync.

The logger writes text between the frames (boot text, NMEA sentences) and, after each thing that it logged, a line
`M,<milliseconds>`: the time at which it did. So the time of a frame comes after it. A frame is held until that line is
complete; when what follows is anything else (the line was lost or damaged), the frame goes out at once without a time
(`t_s` None), for the next `M` line belongs to something else. Without text between frames (`time_line=False`) a frame
goes out with its last byte.

Accelerations are the maker's, in m/s2 / 9.80665, with the maker's axes and signs unless `axes` maps them; angular rates
are converted from rad/s to deg/s. The extra columns are the maker's own names and units, unconverted and unmapped.
"""

from __future__ import annotations

import math
import re
from binascii import crc_hqx
from struct import Struct
from typing import ClassVar, Literal

from pydantic import Field

from highside.codec.axes import AxisMap
from highside.codec.clock import DeviceClock
from highside.codec.frame import Frame
from highside.codec.registry import CodecTable
from highside.codec.stream import DAMAGED, READING, Packet, SyncStream
from highside.units import STANDARD_GRAVITY_MPS2

HEADER = bytes.fromhex("fa143e003a00")
_VALUES = Struct("<29f")
FRAME_BYTES = len(HEADER) + _VALUES.size + 2
_DEG = 180.0 / math.pi
_TEXT = bytes((*range(0x20, 0x7F), 9, 10, 13))

_TIME_LINE = re.compile(rb"[\r\n]{0,4}M,(\d{1,10})[\r\n]")
_TIME_LINE_BEGUN = re.compile(rb"[\r\n]{0,4}(?:M(?:,\d{0,10})?)?")


def encode(values: tuple[float, ...], t_ms: int | None = None) -> bytes:
    """A frame of 29 values as the sensor sends it, with the logger's time line behind it if `t_ms` is given."""
    content = HEADER[1:] + _VALUES.pack(*values)
    frame = HEADER[:1] + content + crc_hqx(content, 0).to_bytes(2, "big")
    return frame if t_ms is None else frame + b"\nM,%d\n\r\n" % t_ms


class Vn100Codec(SyncStream):
    """Decoder of the frames described above."""

    name = "vn100"
    extra_columns: tuple[str, ...] = (
        *("MagX", "MagY", "MagZ", "AccX", "AccY", "AccZ", "GyroX", "GyroY", "GyroZ"),
        *("Temp", "Pres", "Yaw", "Pitch", "Roll"),
    )
    sync = HEADER
    header_bytes = len(HEADER)
    max_frame_bytes = FRAME_BYTES

    def __init__(self, axes: AxisMap | None = None, *, time_line: bool = True) -> None:
        super().__init__()
        self._axes = None if axes is None or axes.identity else axes
        self._time_line = time_line
        self._held: Frame | None = None
        self._behind = b""
        self.clock = DeviceClock(2**32, 1000)

    def _length(self, buffer: bytes, start: int, available: int) -> int:
        return FRAME_BYTES

    def _accept(self, buffer: bytes, start: int, stop: int, t_mono: float, out: list[Frame]) -> Packet:
        if crc_hqx(buffer[start + 1 : stop], 0):
            return DAMAGED
        values = _VALUES.unpack_from(buffer, start + len(HEADER))
        ax, ay, az = (value / STANDARD_GRAVITY_MPS2 for value in values[3:6])
        gx, gy, gz = (value * _DEG for value in values[6:9])
        if self._axes is not None:
            ax, ay, az = self._axes.apply(ax, ay, az)
            gx, gy, gz = self._axes.apply(gx, gy, gz)
        self._release(out)
        frame = Frame(None, None, t_mono, ax, ay, az, gx, gy, gz, values[9], extra=values[:14])
        if self._time_line:
            self._held = frame
            self.counts.frames_held = 1
        else:
            out.append(frame)
        return READING

    def _release(self, out: list[Frame], t_s: float | None = None) -> None:
        """The held frame goes out, with its time if that is known."""
        if self._held is not None:
            out.append(self._held if t_s is None else self._held._replace(t_s=t_s))
            self._held = None
            self.counts.frames_held = 0
        self._behind = b""

    def _pass_by(self, chunk: bytes, out: list[Frame]) -> None:
        held = self._held
        if held is None:
            return
        # 4 line ends, `M,`, 10 digits and a line end are all that a time line may need
        self._behind += chunk[:17]
        if match := _TIME_LINE.match(self._behind):
            milliseconds = int(match[1])
            in_range = milliseconds < 2**32
            self._release(out, self.clock.seconds(milliseconds, held.t_mono) if in_range else None)
        elif not _TIME_LINE_BEGUN.fullmatch(self._behind):
            self._release(out)

    def _is_text(self, chunk: bytes) -> int:
        return len(chunk) - len(chunk.translate(None, _TEXT))

    def flush(self) -> list[Frame]:
        out = super().flush()
        self._release(out)
        return out

    def reset(self) -> None:
        super().reset()
        # a held frame is good, but its time was lost with the link: no text may match any more, and it goes out with
        # whatever comes next
        if self._held is not None:
            self._behind = b"?"


class Vn100CodecConfig(CodecTable):
    """VectorNav VN-100 binary frames, possibly between text."""

    detectable: ClassVar[bool] = True

    name: Literal["vn100"]
    time_line: bool = Field(
        default=True,
        description="A text line `M,<milliseconds>` behind each frame is its time; false for a bare sensor.",
    )

    def build(self) -> Vn100Codec:
        return Vn100Codec(self.axis_map(), time_line=self.time_line)


CODEC = Vn100CodecConfig
