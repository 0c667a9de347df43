"""CAN: DBC files compiled to shifts and masks, foreign signals, the tool's own readings of several messages."""

from __future__ import annotations

import random
from pathlib import Path

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec import tool_can
from highside.codec.axes import AxisMap
from highside.codec.can_dbc import Message, SignalCodec, SignalSource, compile_dbc
from highside.codec.frame import CanFrame
from highside.codec.tool_can import ToolCanCodec
from highside.errors import InputError

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'


@pytest.fixture(scope="module")
def tool_dbc(project_root: Path) -> str:
    return (project_root / "config" / "highside.dbc").read_text()


@pytest.fixture(scope="module")
def messages(tool_dbc: str) -> dict[str, Message]:
    return compile_dbc(tool_dbc)


def can(can_id: int, data: bytes, t: float = 0.0, *, extended: bool = False) -> CanFrame:
    return CanFrame(t, t, can_id, data, extended)


def a_reading(i: int, rng: random.Random, *, gyros: bool = True) -> list[CanFrame]:
    return tool_can.encode(
        i,
        i * 1e-3,
        [rng.uniform(-20, 20) for _ in range(3)],
        gyro_dps=[rng.uniform(-1000, 1000) for _ in range(3)] if gyros else None,
        temp_c=rng.uniform(-50, 200),
        rotor_deg=rng.uniform(0, 360),
    )


def test_compiled_signals_equal_cantools_on_random_layouts() -> None:
    rng = random.Random(11)
    for _ in range(150):
        size = rng.choice([1, 2, 5, 8, 16])
        length = rng.randrange(1, min(32, size * 8) + 1)
        big = rng.random() < 0.5
        if big:
            from_msb = rng.randrange(size * 8 - length + 1)
            start = from_msb // 8 * 8 + 7 - from_msb % 8
        else:
            start = rng.randrange(size * 8 - length + 1)
        sign = rng.choice("+-")
        scale, offset = rng.choice([(1, 0), (0.244, -125), (-0.5, 3)])
        text = HEAD + (
            f'BO_ 100 M: {size} A\n SG_ S : {start}|{length}@{0 if big else 1}{sign} ({scale},{offset}) [0|0] "" A\n'
        )
        message = compile_dbc(text)["M"]
        oracle = cantools.database.load_string(text, "dbc").get_message_by_name("M")
        for _ in range(10):
            data = rng.randbytes(size)
            value = message.signals["S"].extract(*message.numbers(data))
            assert value == pytest.approx(oracle.decode(data)["S"], rel=1e-15, abs=1e-12), text


@pytest.mark.parametrize(("bits", "kind"), [(32, 1), (64, 2)])
def test_floating_point_signals_equal_cantools(bits: int, kind: int) -> None:
    text = HEAD + f'BO_ 100 M: 8 A\n SG_ S : 0|{bits}@1- (2,1) [0|0] "" A\nSIG_VALTYPE_ 100 S : {kind};\n'
    oracle = cantools.database.load_string(text, "dbc").get_message_by_name("M")
    message = compile_dbc(text)["M"]
    data = oracle.encode({"S": -3.25}).ljust(8, b"\0")
    assert message.signals["S"].extract(*message.numbers(data)) == -3.25


def test_the_tools_dbc_says_what_the_encoder_does(tool_dbc: str) -> None:
    database = cantools.database.load_string(tool_dbc, "dbc")
    rng = random.Random(12)
    for i in range(200):
        accel = [rng.uniform(-21, 21) for _ in range(3)]
        gyro = [rng.uniform(-1000, 1000) for _ in range(3)]
        temp, angle, rate = rng.uniform(-100, 200), rng.uniform(0, 359.9), rng.uniform(-1000, 1000)
        parts = tool_can.encode(
            i * 999, i * 7.5, accel, gyro_dps=gyro, temp_c=temp, rotor_deg=angle, rotor_rate_dps=rate
        )
        said = [database.decode_message(part.can_id, part.data) for part in parts]
        merged = {key: float(value) for part in said for key, value in part.items()}  # type: ignore[union-attr, arg-type]
        assert [merged[k] for k in ("AccX", "AccY", "AccZ")] == pytest.approx(accel, abs=2.1e-8)
        assert [merged[k] for k in ("GyrX", "GyrY", "GyrZ")] == pytest.approx(gyro, abs=1.1e-6)
        assert merged["Temperature"] == pytest.approx(temp, abs=0.0126)
        assert merged["RotorAngle"] == pytest.approx(angle, abs=1e-6)
        assert merged["RotorRate"] == pytest.approx(rate, abs=1.1e-6)
        assert merged["TimeUs"] == round(i * 7.5e6) % 2**32
        assert merged["Seq"] == i * 999 % 65536
        assert merged["SeqLow"] == i * 999 % 16


@settings(max_examples=100, deadline=None)
@given(
    seq=st.integers(0, 65535),
    accel=st.tuples(*[st.floats(-21, 21)] * 3),
    gyro=st.none() | st.tuples(*[st.floats(-1000, 1000)] * 3),
    temp=st.none() | st.floats(-200, 200),
    rotor=st.none() | st.floats(0, 359.9),
    order=st.permutations(range(1, 5)),
)
def test_readings_come_back_whatever_the_order_of_their_parts(
    messages: dict[str, Message],
    seq: int,
    accel: tuple[float, float, float],
    gyro: tuple[float, float, float] | None,
    temp: float | None,
    rotor: float | None,
    order: list[int],
) -> None:
    parts = tool_can.encode(seq, 12.5, accel, gyro_dps=gyro, temp_c=temp, rotor_deg=rotor, rotor_rate_dps=5.0)
    shuffled = [parts[0]] + [parts[i] for i in order if i < len(parts)]
    codec = ToolCanCodec(messages)
    (frame,) = codec.receive_can(shuffled)
    assert (frame.seq, frame.t_s) == (seq, 12.5)
    assert frame[3:6] == pytest.approx(accel, abs=2.1e-8)
    assert frame[6:9] == (pytest.approx(gyro, abs=1.1e-6) if gyro else (None, None, None))
    assert frame.temp_c == (None if temp is None else pytest.approx(temp, abs=0.0126))
    assert frame.rotor_deg == (None if rotor is None else pytest.approx(rotor, abs=1e-6))
    assert frame.rotor_rate_dps == (None if rotor is None or gyro is None else pytest.approx(5.0))
    assert codec.counts.balanced()
    assert codec.counts.bytes_pending == 0


def test_lost_messages_lose_their_reading_and_nothing_else(messages: dict[str, Message]) -> None:
    rng = random.Random(13)
    for _ in range(30):
        whole = [a_reading(i, rng, gyros=i % 3 > 0) for i in range(100)]
        wire: list[CanFrame] = []
        expected = []
        for i, parts in enumerate(whole):
            kept = [part for part in parts if rng.random() > 0.1]
            wire += kept
            if len(kept) == len(parts):
                expected.append(i)
        codec = ToolCanCodec(messages)
        found = [frame.seq for frame in codec.receive_can(wire)]
        codec.flush()
        assert found == expected
        assert codec.counts.balanced()
        assert codec.counts.frames_good == len(expected)
        assert codec.counts.frames_bad <= 100 - len(expected)


def test_duplicate_short_remote_error_and_foreign_messages_are_counted_and_harmless(
    messages: dict[str, Message],
) -> None:
    status, xy, z = a_reading(3, random.Random(1), gyros=False)
    strange = [
        status._replace(remote=True, data=b""),
        status._replace(error=True),
        can(0x123, b"12345678"),
        status._replace(extended=True),
    ]
    codec = ToolCanCodec(messages)
    (frame,) = codec.receive_can([*strange, status, xy, xy, z, z])
    assert frame.seq == 3
    assert codec.counts.frames_ignored == 4
    assert codec.counts.bytes_bad == 16
    assert codec.receive_can([status, xy._replace(data=xy.data[:5]), z]) == []
    codec.flush()
    assert codec.counts.balanced()


def test_axes_of_the_tools_own_messages_are_mapped(messages: dict[str, Message]) -> None:
    codec = ToolCanCodec(messages, axes=AxisMap.parse("x-y-z"))
    (frame,) = codec.receive_can(tool_can.encode(0, 0.0, (0.1, 0.2, 0.3), gyro_dps=(1, 2, 3)))
    assert frame[3:9] == pytest.approx((0.1, -0.2, -0.3, 1, -2, -3))


FOREIGN = HEAD + (
    'BO_ 256 ACC: 6 A\n SG_ X : 0|16@1- (0.001,0) [0|0] "m/s2" A\n SG_ Y : 16|16@1- (0.001,0) [0|0] "m/s2" A\n'
    ' SG_ Z : 32|16@1- (0.001,0) [0|0] "m/s2" A\n'
    'BO_ 2147484160 GYR: 2 A\n SG_ RZ : 7|16@0- (0.01,0) [0|0] "deg/s" A\n'
    ' SG_ LONG : 7|24@0- (0.01,0) [0|0] "" A\n'
    'BO_ 300 MUX: 8 A\n SG_ M M : 0|8@1+ (1,0) [0|0] "" A\n SG_ V m1 : 8|8@1+ (1,0) [0|0] "" A\n'
)
MAPPING = {
    "ax_g": SignalSource("ACC", "X", 1 / 9.80665),
    "ay_g": SignalSource("ACC", "Y", 1 / 9.80665),
    "az_g": SignalSource("ACC", "Z", 1 / 9.80665),
    "gz_dps": SignalSource("GYR", "RZ"),
    "raw_z": SignalSource("ACC", "Z"),
}


def test_foreign_signals_of_two_messages_make_one_frame_and_are_never_used_twice() -> None:
    codec = SignalCodec(compile_dbc(FOREIGN), MAPPING, emit_on="ACC")
    acc = can(256, b"".join(v.to_bytes(2, "little", signed=True) for v in (100, -200, 9807)))
    gyr = can(512, (-150).to_bytes(2, "big", signed=True), extended=True)
    first, second = codec.receive_can([gyr, acc, acc])
    assert first[3:9] == pytest.approx((0.1 / 9.80665, -0.2 / 9.80665, 9.807 / 9.80665, None, None, -1.5))
    assert first.extra == pytest.approx((9.807,))
    assert second.gz is None
    assert codec.receive_can([can(256, acc.data[:5]), can(512, gyr.data)]) == []
    assert (codec.counts.frames_bad, codec.counts.frames_ignored) == (1, 1)
    codec.receive_can([gyr])
    assert codec.counts.bytes_pending == 2
    codec.reset()
    assert codec.counts.balanced()


@pytest.mark.parametrize(
    ("fields", "emit_on", "says"),
    [
        ({"ax_g": SignalSource("NONE", "X")}, None, "no message 'NONE'; it has: ACC, GYR, MUX"),
        ({"ax_g": SignalSource("ACC", "Q")}, None, "no signal 'Q' within its 6 bytes; it has: X, Y, Z"),
        ({"ax_g": SignalSource("GYR", "LONG")}, None, "no signal 'LONG' within its 2 bytes; it has: RZ"),
        ({"ax_g": SignalSource("MUX", "V")}, None, "multiplexed"),
        ({"ax_g": SignalSource("ACC", "X"), "gz_dps": SignalSource("GYR", "RZ")}, None, "name the last one: ACC, GYR"),
        ({"ax_g": SignalSource("ACC", "X")}, "GYR", "'GYR' is not mapped; allowed: ACC"),
        ({}, None, "map at least one signal"),
    ],
)
def test_a_wrong_mapping_is_refused_in_one_line(
    fields: dict[str, SignalSource], emit_on: str | None, says: str
) -> None:
    with pytest.raises(InputError, match=says) as caught:
        SignalCodec(compile_dbc(FOREIGN), fields, emit_on=emit_on, where="car.dbc")
    assert "\n" not in str(caught.value)


def test_what_is_no_dbc_file_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"car\.dbc: is not a readable DBC file") as caught:
        compile_dbc("BO_ nonsense\n\n???", where="car.dbc")
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no message HS_STATUS"):
        ToolCanCodec(compile_dbc(FOREIGN))


@settings(max_examples=200, deadline=None)
@given(
    wire=st.lists(
        st.builds(
            CanFrame,
            st.just(0.0),
            st.just(0.0),
            st.sampled_from([0x300, 0x301, 0x302, 0x303, 0x304, 256, 512]),
            st.binary(max_size=8) | st.sampled_from([b"\0" * 8, b"\0" * 7 + b"\x40"]),
            st.booleans(),
            st.booleans(),
            st.booleans(),
        ),
        max_size=40,
    )
)
def test_arbitrary_can_frames_never_raise_and_balance(messages: dict[str, Message], wire: list[CanFrame]) -> None:
    for codec in (ToolCanCodec(messages), SignalCodec(compile_dbc(FOREIGN), MAPPING, emit_on="ACC")):
        one_by_one = [frame for part in wire for frame in codec.receive_can([part])]
        assert codec.counts.balanced()
        assert codec.counts.bytes_pending <= 40
        codec.flush()
        assert codec.counts.bytes_pending == 0
        assert codec.counts.balanced()
        assert len(one_by_one) == codec.counts.frames_good
