"""The tool's own readings on a CAN bus: several 8-byte messages that belong together.

`config/highside.dbc` is the definition (identifiers, bits, scales). A reading is HS_STATUS (device time, sequence
number, temperature, what follows), HS_ACC_XY and HS_ACC_Z, and with gyros HS_GYR_XY and HS_GYR_Z. HS_STATUS has the
lowest identifier, so it wins the bus first; every other part carries the low four bits of the sequence number, and the
reading is complete when all parts with its number are there, in whatever order. A part that is missing when the next
HS_STATUS comes makes the reading bad; parts without their HS_STATUS are bad too. Nothing is put together from two
readings: sixteen readings would have to be lost within one.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from highside.codec.axes import AxisMap
from highside.codec.can_dbc import Extract, Message
from highside.codec.clock import DeviceClock
from highside.codec.frame import CanFrame, Counts, Frame
from highside.errors import InputError

ID_STATUS, ID_ACC_XY, ID_ACC_Z, ID_GYR_XY, ID_GYR_Z = range(0x300, 0x305)
G_PER_COUNT = 4e-8
DPS_PER_COUNT = 2e-6
CELSIUS_PER_COUNT = 0.025
NO_TEMPERATURE = -8192
TURN_COUNTS = 2**30
SEQ_MODULUS = 65536
TIME_PERIOD_US = 2**32

_SIGNALS = {
    "HS_STATUS": ("TimeUs", "Seq", "Temperature", "HasGyros", "HasRotor"),
    "HS_ACC_XY": ("SeqLow", "AccX", "AccY"),
    "HS_ACC_Z": ("SeqLow", "AccZ", "RotorAngle"),
    "HS_GYR_XY": ("SeqLow", "GyrX", "GyrY"),
    "HS_GYR_Z": ("SeqLow", "GyrZ", "RotorRate"),
}
_ACCELERATIONS = frozenset({"HS_ACC_XY", "HS_ACC_Z"})
_WITH_GYROS = _ACCELERATIONS | {"HS_GYR_XY", "HS_GYR_Z"}
_WORD = struct.Struct("<Q")
_LOW30 = (1 << 30) - 1


def _counts(value: float, per_count: float) -> int:
    """Saturating 30-bit count, as the low 30 bits of its two's complement."""
    return max(-(1 << 29), min((1 << 29) - 1, round(value / per_count))) & _LOW30


def encode(
    seq: int,
    t_s: float,
    accel_g: Sequence[float],
    *,
    gyro_dps: Sequence[float] | None = None,
    temp_c: float | None = None,
    rotor_deg: float | None = None,
    rotor_rate_dps: float = 0.0,
    t_mono: float = 0.0,
    t_wall: float = 0.0,
) -> list[CanFrame]:
    """The messages of one reading, in the order in which the device sends them: the codec in the other role.

    The rotor's rate travels with the gyros. Raises ValueError for a value that is not finite.
    """
    low = seq & 15
    temperature = NO_TEMPERATURE
    if temp_c is not None:
        temperature = max(NO_TEMPERATURE + 1, min(8191, round(temp_c / CELSIUS_PER_COUNT)))
    angle = 0
    if rotor_deg is not None:
        if not math.isfinite(rotor_deg):
            raise ValueError("the rotor angle is not finite")
        angle = round(rotor_deg / 360.0 * TURN_COUNTS) % TURN_COUNTS
    status = (
        round(t_s * 1e6) % TIME_PERIOD_US
        | (seq % SEQ_MODULUS) << 32
        | (temperature & 0x3FFF) << 48
        | (gyro_dps is not None) << 62
        | (rotor_deg is not None) << 63
    )
    x, y, z = (_counts(a, G_PER_COUNT) for a in accel_g)
    words = [(ID_STATUS, status), (ID_ACC_XY, low | x << 4 | y << 34), (ID_ACC_Z, low | z << 4 | angle << 34)]
    if gyro_dps is not None:
        x, y, z = (_counts(rate, DPS_PER_COUNT) for rate in gyro_dps)
        rate = _counts(rotor_rate_dps, DPS_PER_COUNT)
        words += [(ID_GYR_XY, low | x << 4 | y << 34), (ID_GYR_Z, low | z << 4 | rate << 34)]
    return [CanFrame(t_mono, t_wall, can_id, _WORD.pack(word)) for can_id, word in words]


class ToolCanCodec:
    """Decoder of the tool's own messages, laid out as the given DBC messages say."""

    name = "dbc"
    seq_modulus: int | None = SEQ_MODULUS
    extra_columns: tuple[str, ...] = ()

    def __init__(self, messages: Mapping[str, Message], *, axes: AxisMap | None = None, where: str = "DBC") -> None:
        self.counts = Counts()
        self.clock = DeviceClock(TIME_PERIOD_US, 1_000_000)
        self._axes = None if axes is None or axes.identity else axes
        self._parts: dict[tuple[int, bool], tuple[str, int, list[Extract]]] = {}
        for name, signals in _SIGNALS.items():
            message = messages.get(name)
            missing = [s for s in signals if message is None or s not in message.signals]
            if message is None or missing:
                raise InputError(
                    f"has no message {name} with the signals {', '.join(signals)}",
                    where=where,
                    remedy="map the signals of another maker's DBC file in the table codec.fields",
                )
            extracts = [message.signals[signal].extract for signal in signals]
            self._parts[message.can_id, message.extended] = (name, message.length, extracts)
        self._status: list[float] | None = None
        self._values: dict[str, list[float]] = {}
        self._expected: frozenset[str] = _ACCELERATIONS
        self._held_bytes = 0
        self._orphans_of: int | None = None

    def receive_can(self, frames: list[CanFrame]) -> list[Frame]:
        counts = self.counts
        out: list[Frame] = []
        for frame in frames:
            size = len(frame.data)
            counts.bytes_in += size
            part = self._parts.get((frame.can_id, frame.extended))
            if part is None or frame.error or frame.remote:
                counts.frames_ignored += 1
                counts.bytes_ignored += size
                continue
            name, length, extracts = part
            if size != length:
                self._abandon()
                counts.frames_bad += 1
                counts.bytes_bad += size
                continue
            msb, lsb = int.from_bytes(frame.data, "big"), int.from_bytes(frame.data, "little")
            values = [extract(msb, lsb) for extract in extracts]
            if name == "HS_STATUS":
                self._abandon()
                self._status, self._held_bytes, self._orphans_of = values, size, None
                self._expected = _WITH_GYROS if values[3] else _ACCELERATIONS
                continue
            status = self._status
            low = int(values[0])
            if status is None or low != int(status[1]) & 15 or name in self._values or name not in self._expected:
                # without its status a part says nothing; a reading of such parts is counted once
                if self._orphans_of != low:
                    self._orphans_of = low
                    counts.frames_bad += 1
                counts.bytes_bad += size
                continue
            self._values[name] = values
            self._held_bytes += size
            if len(self._values) == len(self._expected):
                counts.frames_good += 1
                counts.bytes_framed += self._held_bytes
                out.append(self._reading(status, frame.t_mono))
                self._clear()
        counts.bytes_pending = self._held_bytes
        return out

    def _reading(self, status: list[float], t_mono: float) -> Frame:
        time_us, seq, temperature, has_gyros, has_rotor = status
        parts = self._values
        ax, ay, az = parts["HS_ACC_XY"][1], parts["HS_ACC_XY"][2], parts["HS_ACC_Z"][1]
        gx: float | None = None
        gy: float | None = None
        gz: float | None = None
        rotor_deg = parts["HS_ACC_Z"][2] if has_rotor else None
        rotor_rate_dps: float | None = None
        if has_gyros:
            gx, gy, gz = parts["HS_GYR_XY"][1], parts["HS_GYR_XY"][2], parts["HS_GYR_Z"][1]
            rotor_rate_dps = parts["HS_GYR_Z"][2] if has_rotor else None
        if self._axes is not None:
            ax, ay, az = self._axes.apply(ax, ay, az)
            gx, gy, gz = self._axes.apply(gx, gy, gz)
        t_s = self.clock.seconds(int(time_us), t_mono)
        temp_c = None if round(temperature / CELSIUS_PER_COUNT) == NO_TEMPERATURE else temperature
        return Frame(int(seq), t_s, t_mono, ax, ay, az, gx, gy, gz, temp_c, rotor_deg, rotor_rate_dps)

    def _clear(self) -> None:
        self._status = None
        self._values = {}
        self._held_bytes = 0

    def _abandon(self) -> None:
        """The reading in hand will not be completed."""
        if self._status is not None:
            self.counts.frames_bad += 1
            self.counts.bytes_bad += self._held_bytes
        self._clear()

    def reset(self) -> None:
        self.counts.bytes_junk += self._held_bytes
        self._clear()
        self._orphans_of = None
        self.counts.bytes_pending = 0

    def flush(self) -> list[Frame]:
        self.reset()
        return []
