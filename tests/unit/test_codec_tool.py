"""The tool's own serial frame: round trips, damage, re-synchronisation, time."""

from __future__ import annotations

import random
from binascii import crc_hqx

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec.axes import AxisMap
from highside.codec.frame import Frame
from highside.codec.tool import MAX_FRAME_BYTES, MIN_FRAME_BYTES, SYNC, ToolCodec, encode

CHUNKS = st.lists(st.integers(1, 80), min_size=1, max_size=20)


def frames_of(codec: ToolCodec, data: bytes, sizes: list[int] | None = None) -> list[Frame]:
    """Feed in pieces of the given sizes (used in turn), then end the input."""
    out: list[Frame] = []
    at = turn = 0
    while at < len(data):
        size = sizes[turn % len(sizes)] if sizes else len(data)
        out += codec.receive(data[at : at + size])
        assert codec.counts.balanced()
        assert codec.counts.bytes_pending < MAX_FRAME_BYTES
        at, turn = at + size, turn + 1
    out += codec.flush()
    assert codec.counts.balanced()
    assert codec.counts.bytes_pending == 0
    return out


def stream(n: int, rng: random.Random) -> tuple[bytes, list[bytes]]:
    """n frames of random kinds, and each by itself."""
    frames = [
        encode(
            i,
            i * 1e-3,
            [rng.uniform(-20, 20) for _ in range(3)],
            gyro_dps=[rng.uniform(-2000, 2000) for _ in range(3)] if rng.random() < 0.5 else None,
            temp_c=rng.uniform(-40, 200) if rng.random() < 0.5 else None,
            rotor_deg=rng.uniform(0, 360) if rng.random() < 0.5 else None,
            rotor_rate_dps=rng.uniform(-1000, 1000),
        )
        for i in range(n)
    ]
    return b"".join(frames), frames


def test_base_frame_is_24_bytes_and_laid_out_as_documented() -> None:
    frame = encode(0x1234, 1.5, (1.0, -1.0, 0.5))
    assert len(frame) == MIN_FRAME_BYTES == 24
    assert frame[:6] == bytes.fromhex("c8f3 10 18 1234")
    assert int.from_bytes(frame[6:10], "big") == 1_500_000
    assert int.from_bytes(frame[10:14], "big", signed=True) == 100_000_000
    assert int.from_bytes(frame[14:18], "big", signed=True) == -100_000_000
    assert int.from_bytes(frame[22:24], "big") == crc_hqx(frame[2:22], 0xFFFF)


finite = st.floats(-20, 20)
rates = st.floats(-2000, 2000)


@settings(max_examples=200, deadline=None)
@given(
    seq=st.integers(0, 65535),
    t_us=st.integers(0, 2**32 - 1),
    accel=st.tuples(finite, finite, finite),
    gyro=st.none() | st.tuples(rates, rates, rates),
    temp=st.none() | st.floats(-300, 300),
    rotor=st.none() | st.floats(0, 359.99),
    rate=rates,
    sizes=CHUNKS,
)
def test_what_is_encoded_is_decoded_to_half_a_count(
    seq: int,
    t_us: int,
    accel: tuple[float, float, float],
    gyro: tuple[float, float, float] | None,
    temp: float | None,
    rotor: float | None,
    rate: float,
    sizes: list[int],
) -> None:
    data = encode(seq, t_us * 1e-6, accel, gyro_dps=gyro, temp_c=temp, rotor_deg=rotor, rotor_rate_dps=rate)
    (frame,) = frames_of(ToolCodec(), data, sizes)
    assert frame.seq == seq
    assert frame.t_s == pytest.approx(t_us * 1e-6, abs=0.6e-6)
    assert frame[3:6] == pytest.approx(accel, abs=0.51e-8)
    if gyro is None:
        assert frame[6:9] == (None, None, None)
    else:
        assert frame[6:9] == pytest.approx(gyro, abs=0.51e-6)
    assert frame.temp_c == (None if temp is None else pytest.approx(temp, abs=0.0051))
    assert frame.rotor_deg == (None if rotor is None else pytest.approx(rotor, abs=1e-7))
    assert frame.rotor_rate_dps == (None if rotor is None else pytest.approx(rate, abs=0.51e-6))


def test_values_beyond_the_range_saturate_and_nonsense_is_refused() -> None:
    (frame,) = ToolCodec().receive(encode(0, 0.0, (30.0, -30.0, 0.0), temp_c=1e4))
    assert (frame.ax, frame.ay) == (pytest.approx(21.47483647), pytest.approx(-21.47483648))
    assert frame.temp_c == pytest.approx(327.67)
    with pytest.raises(ValueError):
        encode(0, 0.0, (float("nan"), 0.0, 0.0))
    with pytest.raises(ValueError):
        encode(0, 0.0, (0.0, 0.0, 0.0), rotor_deg=float("nan"))


@settings(max_examples=200, deadline=None)
@given(
    data=st.binary(max_size=400) | st.lists(st.sampled_from([SYNC, b"\x10\x18", b"\x17\x2e", b"\0" * 9])).map(b"".join)
)
def test_arbitrary_bytes_never_raise_and_always_balance(data: bytes) -> None:
    whole, single = ToolCodec(), ToolCodec()
    assert frames_of(whole, data) == frames_of(single, data, [1])
    assert whole.counts == single.counts


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32), junk=st.lists(st.binary(max_size=60), min_size=6, max_size=6), sizes=CHUNKS)
def test_frames_between_junk_are_all_found_whatever_the_chunks(seed: int, junk: list[bytes], sizes: list[int]) -> None:
    _, parts = stream(6, random.Random(seed))
    data = b"".join(piece for pair in zip(junk, parts, strict=True) for piece in pair)
    codec = ToolCodec()
    found = frames_of(codec, data, sizes)
    assert [f.seq for f in found] == [0, 1, 2, 3, 4, 5]
    assert codec.counts.bytes_framed == sum(map(len, parts))
    assert codec.counts.bytes_bad + codec.counts.bytes_junk == sum(map(len, junk))


def test_sync_and_a_whole_frame_header_inside_the_payload_do_no_harm() -> None:
    # accelerations whose counts spell sync, version and length
    value = int.from_bytes(SYNC + b"\x10\x18", "big", signed=True) * 1e-8
    data = b"".join(encode(i, i * 1e-3, (value, value, value)) for i in range(50))
    codec = ToolCodec()
    assert len(frames_of(codec, data, [7])) == 50
    assert codec.counts.frames_bad == 0
    # joined in the middle of the first frame: resynchronised within one frame
    codec = ToolCodec()
    assert [f.seq for f in frames_of(codec, data[11:], [5])] == list(range(1, 50))


def test_good_frame_inside_a_damaged_one_is_not_lost() -> None:
    cut = encode(0, 0.0, (0, 0, 1), gyro_dps=(1, 2, 3))[:13]
    good = encode(1, 0.001, (0, 0, 1))
    codec = ToolCodec()
    assert [f.seq for f in frames_of(codec, cut + good)] == [1]
    assert codec.counts.bytes_bad + codec.counts.bytes_junk == 13


def test_every_single_double_and_triple_bit_flip_behind_the_header_is_refused() -> None:
    frame = encode(7, 1.25, (0.1, -0.2, 0.97))
    bits = [(byte, bit) for byte in range(4, len(frame)) for bit in range(8)]
    rng = random.Random(1)
    patterns = [[a] for a in bits]
    patterns += [[a, b] for i, a in enumerate(bits) for b in bits[i + 1 :]]
    patterns += [rng.sample(bits, 3) for _ in range(5000)]
    for pattern in patterns:
        damaged = bytearray(frame)
        for byte, bit in pattern:
            damaged[byte] ^= 1 << bit
        codec = ToolCodec()
        assert codec.receive(bytes(damaged)) + codec.flush() == []


@pytest.mark.slow
def test_heavy_damage_passes_no_more_often_than_a_16_bit_crc_lets_it() -> None:
    rng = random.Random(2)
    frame = encode(7, 1.25, (0.1, -0.2, 0.97), gyro_dps=(1, 2, 3))
    trials, passed = 100_000, 0
    codec = ToolCodec()
    for _ in range(trials):
        damaged = bytearray(frame)
        for _ in range(rng.randrange(4, 40)):
            damaged[rng.randrange(4, len(frame))] ^= 1 << rng.randrange(8)
        if damaged != frame:
            passed += len(codec.receive(bytes(damaged))) + len(codec.flush())
    # 100,000 / 65,536 = 1.5 are expected; 9 or more has a probability below 1e-4
    assert passed < 9
    assert codec.counts.balanced()


def test_time_goes_on_over_the_wrap_of_the_counter() -> None:
    codec = ToolCodec()
    start = 2**32 * 1e-6 - 0.0015
    times = [f.t_s for i in range(4) for f in codec.receive(encode(i, start + i * 1e-3, (0, 0, 1)))]
    assert times == pytest.approx([start + i * 1e-3 for i in range(4)], abs=1e-6)


def test_a_silence_longer_than_the_counters_period_is_taken_from_the_arrival_times() -> None:
    codec = ToolCodec()
    (first,) = codec.receive(encode(0, 10.0, (0, 0, 1)), 100.0)
    (second,) = codec.receive(encode(1, 10.0 + 9000.0, (0, 0, 1)), 100.0 + 9000.2)
    assert first.t_s is not None
    assert second.t_s is not None
    assert second.t_s - first.t_s == pytest.approx(9000.0, abs=1e-5)


def test_a_restarted_device_goes_backwards_and_is_counted() -> None:
    codec = ToolCodec()
    codec.receive(encode(9, 1000.0, (0, 0, 1)))
    (frame,) = codec.receive(encode(0, 0.5, (0, 0, 1)))
    assert frame.t_s == pytest.approx(0.5)
    assert codec.clock.backward == 1


def test_reset_drops_what_is_pending_into_junk() -> None:
    codec = ToolCodec()
    codec.receive(encode(0, 0.0, (0, 0, 1))[:15])
    codec.reset()
    assert codec.counts.bytes_junk == 15
    assert [f.seq for f in codec.receive(encode(1, 0.0, (0, 0, 1)))] == [1]
    assert codec.counts.balanced()


def test_axes_are_mapped_for_accelerations_and_rates() -> None:
    codec = ToolCodec(AxisMap.parse("-yxz"))
    (frame,) = codec.receive(encode(0, 0.0, (0.1, 0.2, 0.3), gyro_dps=(1, 2, 3)))
    assert frame[3:9] == pytest.approx((-0.2, 0.1, 0.3, -2, 1, 3))
    (frame,) = codec.receive(encode(1, 0.0, (0.1, 0.2, 0.3)))
    assert frame[6:9] == (None, None, None)
