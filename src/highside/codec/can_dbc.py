"""CAN through a DBC file: read once by cantools, compiled to shifts and masks, any maker's signals mapped to a `Frame`.

A DBC file says of each message where in its payload each signal lies. A signal's bits are consecutive either in the
payload read as one little-endian number (Intel) or as one big-endian number (Motorola; its start bit is that of the
most significant bit, counted within bytes from the least significant one). So a signal is two figures, a shift and a
mask, plus sign, scale and offset. A message of two signals takes 2.1 to 2.5 us with its `Frame`; the library decodes
it in 1.4 to 1.6 and needs 2.2 with the same `Frame` (recorded bus of a car, 2,487 messages): no gain in time, but only
the signals that are mapped are decoded, and a payload of the wrong length is counted, not raised.

Where the quantities lie in several messages, each is taken when it comes, and a frame goes out with the message named
by `emit_on` (the last one of a cycle). Values are used once: a message that was lost leaves a gap, never an old value.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from highside.codec.axes import AxisMap
from highside.codec.frame import FRAME_COLUMNS, NAN, CanFrame, Counts, Frame
from highside.errors import InputError
from highside.reading import check_dbc

LONGEST_SIGNAL_BITS = 512
"""The payload of a CAN FD frame. What J1939 sends in pieces has longer signals, all of them texts."""

Extract = Callable[[int, int], float]
"""(payload as big-endian number, as little-endian number) -> physical value"""


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of a message: the first `bytes_needed` bytes of the payload hold it."""

    name: str
    unit: str
    bytes_needed: int
    extract: Extract


@dataclass(frozen=True, slots=True)
class Message:
    """One message of a DBC file. Signals that reach beyond its length, or are longer than a frame of CAN FD, are left
    out: nobody can decode them as a number."""

    name: str
    can_id: int
    extended: bool
    length: int
    signals: Mapping[str, Signal]
    multiplexed: bool = False

    def numbers(self, data: bytes) -> tuple[int, int]:
        """The payload as a big-endian and a little-endian number of the message's full length."""
        whole = data if len(data) == self.length else data[: self.length].ljust(self.length, b"\0")
        return int.from_bytes(whole, "big"), int.from_bytes(whole, "little")


def compile_dbc(text: str, *, where: str = "DBC") -> dict[str, Message]:
    """Messages by name. Raises InputError naming `where` if the text is no DBC file."""
    import cantools

    check_dbc(text, where=where)
    try:
        database = cantools.database.can.Database(strict=False)
        database.add_dbc_string(text)
        return {message.name: _compile(message) for message in database.messages}
    except Exception as error:
        # the library raises errors of its own, of its parser and of the language, all for the same reason
        what = str(error) or type(error).__name__
        raise InputError(f"is not a readable DBC file: {what}", where=where, remedy="fix the file") from None


def _compile(message: Any) -> Message:
    numbers = (signal for signal in message.signals if 0 < signal.length <= LONGEST_SIGNAL_BITS)
    compiled = (_compile_signal(signal, message.length) for signal in numbers)
    signals = {signal.name: signal for signal in compiled if signal.bytes_needed <= message.length}
    return Message(
        message.name,
        message.frame_id,
        bool(message.is_extended_frame),
        message.length,
        signals,
        bool(message.is_multiplexed()),
    )


def _compile_signal(signal: Any, message_bytes: int) -> Signal:
    length, scale, offset = int(signal.length), float(signal.scale), float(signal.offset)
    big = signal.byte_order == "big_endian"
    if big:
        from_msb = signal.start // 8 * 8 + 7 - signal.start % 8
        shift = message_bytes * 8 - from_msb - length
        needed = (from_msb + length + 7) // 8
    else:
        shift = int(signal.start)
        needed = (shift + length + 7) // 8
    mask = (1 << length) - 1
    return Signal(
        signal.name,
        signal.unit or "",
        needed,
        _extractor(big, shift, mask, length, bool(signal.is_signed), bool(signal.is_float), scale, offset),
    )


def _extractor(
    big: bool, shift: int, mask: int, length: int, signed: bool, is_float: bool, scale: float, offset: float
) -> Extract:
    if is_float:
        form = struct.Struct({16: ">e", 32: ">f", 64: ">d"}[length])

        def floating(msb: int, lsb: int) -> float:
            raw = (((msb if big else lsb) >> shift) & mask).to_bytes(length // 8, "big")
            return float(form.unpack(raw)[0]) * scale + offset

        return floating
    if signed:
        sign = 1 << (length - 1)

        def with_sign(msb: int, lsb: int) -> float:
            return ((((msb if big else lsb) >> shift & mask) ^ sign) - sign) * scale + offset

        return with_sign

    def without_sign(msb: int, lsb: int) -> float:
        return ((msb if big else lsb) >> shift & mask) * scale + offset

    return without_sign


@dataclass(frozen=True, slots=True)
class SignalSource:
    """Where a quantity comes from: a signal of a message, times `scale` plus `offset` (the DBC's own come first)."""

    message: str
    signal: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(slots=True)
class _Wanted:
    """What is taken out of one message: bytes it must have, and (place, extract, scale, offset) for each value."""

    bytes_needed: int
    message: Message
    emits: bool
    values: list[tuple[int, Extract, float, float]]


class SignalCodec:
    """Decoder of mapped signals of any DBC file.

    `fields` maps the columns of a Recording (`ax_g`, `gz_dps`, ...) and extra columns (any other name) to their
    sources. An axis without a source is NaN in the frames (acceleration) or absent (rates). Raises InputError for a
    message or signal that the DBC file does not have, and for multiplexed messages (their signals change places).
    """

    name = "dbc"
    seq_modulus: int | None = None

    def __init__(
        self,
        messages: Mapping[str, Message],
        fields: Mapping[str, SignalSource],
        *,
        emit_on: str | None = None,
        axes: AxisMap | None = None,
        where: str = "DBC",
    ) -> None:
        self.counts = Counts()
        self.extra_columns = tuple(name for name in fields if name not in FRAME_COLUMNS)
        self._axes = None if axes is None or axes.identity else axes
        order = (*FRAME_COLUMNS, *self.extra_columns)
        self._blank: list[float | None] = [None] * len(order)
        self._values = self._blank.copy()
        self._pending = 0
        self._wanted: dict[tuple[int, bool], _Wanted] = {}
        named = {source.message for source in fields.values()}
        if emit_on is None and len(named) > 1:
            raise InputError(
                "several messages are mapped", field="codec.emit_on", remedy=f"name the last one: {_names(named)}"
            )
        last = emit_on if emit_on is not None else next(iter(named), None)
        if last is None:
            raise InputError("nothing is mapped", field="codec.fields", remedy="map at least one signal")
        if last not in named:
            raise InputError(f"{last!r} is not mapped", field="codec.emit_on", remedy=f"allowed: {_names(named)}")
        for column, source in fields.items():
            at = f"codec.fields.{column}"
            message = messages.get(source.message)
            if message is None:
                raise InputError(
                    f"no message {source.message!r}", where=where, field=at, remedy=f"it has: {_names(messages)}"
                )
            if message.multiplexed:
                raise InputError(
                    f"message {message.name!r} is multiplexed, which is not supported", where=where, field=at
                )
            signal = message.signals.get(source.signal)
            if signal is None:
                raise InputError(
                    f"message {message.name!r} has no signal {source.signal!r} within its {message.length} bytes",
                    where=where,
                    field=at,
                    remedy=f"it has: {_names(message.signals)}",
                )
            key = (message.can_id, message.extended)
            wanted = self._wanted.setdefault(key, _Wanted(0, message, message.name == last, []))
            wanted.bytes_needed = max(wanted.bytes_needed, signal.bytes_needed)
            wanted.values.append((order.index(column), signal.extract, source.scale, source.offset))

    def receive_can(self, frames: list[CanFrame]) -> list[Frame]:
        counts = self.counts
        out: list[Frame] = []
        for frame in frames:
            data = frame.data
            size = len(data)
            counts.bytes_in += size
            wanted = self._wanted.get((frame.can_id, frame.extended))
            if wanted is None or frame.error or frame.remote:
                counts.frames_ignored += 1
                counts.bytes_ignored += size
                continue
            if size < wanted.bytes_needed:
                counts.frames_bad += 1
                counts.bytes_bad += size
                continue
            msb, lsb = wanted.message.numbers(data)
            values = self._values
            for place, extract, scale, offset in wanted.values:
                values[place] = extract(msb, lsb) * scale + offset
            self._pending += size
            if wanted.emits:
                counts.frames_good += 1
                counts.bytes_framed += self._pending
                self._pending = 0
                self._values = self._blank.copy()
                out.append(self._frame(values, frame.t_mono))
        counts.bytes_pending = self._pending
        return out

    def _frame(self, values: list[float | None], t_mono: float) -> Frame:
        ax, ay, az, gx, gy, gz, temp_c, rotor_deg, rotor_rate_dps, *rest = values
        x, y, z = (NAN if a is None else a for a in (ax, ay, az))
        if self._axes is not None:
            x, y, z = self._axes.apply(x, y, z)
            gx, gy, gz = self._axes.apply(gx, gy, gz)
        extra = tuple(NAN if value is None else value for value in rest) or None
        return Frame(None, None, t_mono, x, y, z, gx, gy, gz, temp_c, rotor_deg, rotor_rate_dps, extra)

    def reset(self) -> None:
        self.counts.bytes_junk += self._pending
        self.counts.bytes_pending = self._pending = 0
        self._values = self._blank.copy()

    def flush(self) -> list[Frame]:
        self.reset()
        return []


def _names(names: Any) -> str:
    return ", ".join(sorted(names)) or "nothing"
