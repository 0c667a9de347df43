"""The tool's own binary serial frame.

All integers are big-endian two's complement. A frame is 24 bytes (accelerations alone) to 46 bytes (everything), so
921,600 baud carry 3,840 base frames a second.

    offset  size  content
    0       2     sync C8 F3
    2       1     version (high nibble, now 1) and content flags (low nibble: 1 gyros, 2 temperature, 4 rotor, 8 zero)
    3       1     length of the whole frame in bytes; must be the one that the flags imply
    4       2     sequence number, counts every frame, wraps at 65,536
    6       4     device time in us since power-up, wraps at 2^32 (71.6 minutes; unwrapped here)
    10      12    acceleration x, y, z: int32 in units of 1e-8 g (+-21.47 g)
    ...     12    if flag 1: angular rate x, y, z: int32 in units of 1e-6 deg/s (+-2147 deg/s)
    ...     2     if flag 2: temperature: int16 in units of 0.01 deg C
    ...     8     if flag 4: rotor angle: uint32 in units of 360/2^32 deg; rotor rate: int32 in units of 1e-6 deg/s
    last 2  2     CRC-16/CCITT-FALSE (polynomial 1021, start FFFF) of everything between the sync and the CRC

Accelerations are the reported gravity direction in g: at rest, vertical, az = +1. A value beyond its range saturates,
as a converter does. CRC-16/CCITT finds every error of up to three bits in a frame of this size; what is worse passes
with a probability of 2^-16, and only where sync, version, flags and length happen to fit too.
"""

from __future__ import annotations

import math
from binascii import crc_hqx
from collections.abc import Sequence
from struct import Struct
from typing import ClassVar, Literal

from highside.codec.axes import AxisMap
from highside.codec.clock import DeviceClock
from highside.codec.frame import Frame
from highside.codec.registry import CodecTable
from highside.codec.stream import DAMAGED, MORE, READING, REFUSED, Packet, SyncStream

SYNC = b"\xc8\xf3"
VERSION = 1
HAS_GYROS, HAS_TEMPERATURE, HAS_ROTOR = 1, 2, 4

G_PER_COUNT = 1e-8
DPS_PER_COUNT = 1e-6
CELSIUS_PER_COUNT = 0.01
TURN_COUNTS = 2**32
SEQ_MODULUS = 65536
TIME_PERIOD_US = 2**32
_CRC_START = 0xFFFF


def _layout(flags: int) -> tuple[int, Struct, int]:
    """Length in bytes, struct from the sequence number to the CRC, and the flags of one kind of frame."""
    fields = "HIiii"
    if flags & HAS_GYROS:
        fields += "iii"
    if flags & HAS_TEMPERATURE:
        fields += "h"
    if flags & HAS_ROTOR:
        fields += "Ii"
    body = Struct(">" + fields + "H")
    return 4 + body.size, body, flags


_LAYOUTS: dict[bytes, tuple[int, Struct, int]] = {}
for _flags in range(8):
    _entry = _layout(_flags)
    _LAYOUTS[bytes((VERSION << 4 | _flags, _entry[0]))] = _entry

MIN_FRAME_BYTES = min(entry[0] for entry in _LAYOUTS.values())
MAX_FRAME_BYTES = max(entry[0] for entry in _LAYOUTS.values())


def _counts(value: float, per_count: float, bits: int) -> int:
    limit = 1 << (bits - 1)
    return max(-limit, min(limit - 1, round(value / per_count)))


def encode(
    seq: int,
    t_s: float,
    accel_g: Sequence[float],
    *,
    gyro_dps: Sequence[float] | None = None,
    temp_c: float | None = None,
    rotor_deg: float | None = None,
    rotor_rate_dps: float = 0.0,
) -> bytes:
    """One frame as the device sends it: the codec in the other role.

    `seq` and `t_s` (seconds since power-up) are wrapped here; `accel_g` and `gyro_dps` hold x, y, z. Raises ValueError
    for a value that is not finite.
    """
    values = [seq % SEQ_MODULUS, round(t_s * 1e6) % TIME_PERIOD_US, *(_counts(a, G_PER_COUNT, 32) for a in accel_g)]
    flags = 0
    if gyro_dps is not None:
        flags |= HAS_GYROS
        values += [_counts(rate, DPS_PER_COUNT, 32) for rate in gyro_dps]
    if temp_c is not None:
        flags |= HAS_TEMPERATURE
        values.append(_counts(temp_c, CELSIUS_PER_COUNT, 16))
    if rotor_deg is not None:
        flags |= HAS_ROTOR
        if not math.isfinite(rotor_deg):
            raise ValueError("the rotor angle is not finite")
        values += [round(rotor_deg / 360.0 * TURN_COUNTS) % TURN_COUNTS, _counts(rotor_rate_dps, DPS_PER_COUNT, 32)]
    length, body, _ = _layout(flags)
    head = bytes((VERSION << 4 | flags, length))
    content = head + body.pack(*values, 0)[:-2]
    return SYNC + content + crc_hqx(content, _CRC_START).to_bytes(2, "big")


class ToolCodec(SyncStream):
    """Decoder of the tool's own frames. `axes` maps the sensor's axes to the tool's."""

    name = "tool"
    seq_modulus: int | None = SEQ_MODULUS
    sync = SYNC
    header_bytes = 4
    max_frame_bytes = MAX_FRAME_BYTES

    def __init__(self, axes: AxisMap | None = None) -> None:
        super().__init__()
        self._axes = None if axes is None or axes.identity else axes
        self.clock = DeviceClock(TIME_PERIOD_US, 1_000_000)

    def _length(self, buffer: bytes, start: int, available: int) -> int:
        if available < 4:
            return MORE
        layout = _LAYOUTS.get(buffer[start + 2 : start + 4])
        return layout[0] if layout else REFUSED

    def _accept(self, buffer: bytes, start: int, stop: int, t_mono: float, out: list[Frame]) -> Packet:
        # the CRC of a message with its own CRC behind it is zero
        if crc_hqx(buffer[start + 2 : stop], _CRC_START):
            return DAMAGED
        _, body, flags = _LAYOUTS[buffer[start + 2 : start + 4]]
        values = body.unpack_from(buffer, start + 4)
        ax, ay, az = values[2] * G_PER_COUNT, values[3] * G_PER_COUNT, values[4] * G_PER_COUNT
        gx: float | None = None
        gy: float | None = None
        gz: float | None = None
        temp_c: float | None = None
        rotor_deg: float | None = None
        rotor_rate_dps: float | None = None
        if flags:
            at = 5
            if flags & HAS_GYROS:
                gx, gy, gz = values[5] * DPS_PER_COUNT, values[6] * DPS_PER_COUNT, values[7] * DPS_PER_COUNT
                at = 8
            if flags & HAS_TEMPERATURE:
                temp_c = values[at] * CELSIUS_PER_COUNT
                at += 1
            if flags & HAS_ROTOR:
                rotor_deg = values[at] * (360.0 / TURN_COUNTS)
                rotor_rate_dps = values[at + 1] * DPS_PER_COUNT
        if self._axes is not None:
            ax, ay, az = self._axes.apply(ax, ay, az)
            gx, gy, gz = self._axes.apply(gx, gy, gz)
        t_s = self.clock.seconds(values[1], t_mono)
        out.append(Frame(values[0], t_s, t_mono, ax, ay, az, gx, gy, gz, temp_c, rotor_deg, rotor_rate_dps))
        return READING


class ToolCodecConfig(CodecTable):
    """The tool's own binary serial frame."""

    detectable: ClassVar[bool] = True

    name: Literal["tool"]

    @property
    def speaks_as_the_tool(self) -> bool:
        return True

    def build(self) -> ToolCodec:
        return ToolCodec(self.axis_map())


CODEC = ToolCodecConfig
