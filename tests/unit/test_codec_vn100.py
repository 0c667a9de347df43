"""VN-100 frames and the time line behind them."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec.axes import AxisMap
from highside.codec.vn100 import FRAME_BYTES, HEADER, Vn100Codec, encode
from highside.units import STANDARD_GRAVITY_MPS2

VALUES = tuple(float(i) / 8 for i in range(29))


def frames_of(codec: Vn100Codec, data: bytes, size: int | None = None) -> list[tuple[float | None, float]]:
    """(time, first acceleration) of every frame, fed in pieces of `size`."""
    out = []
    for at in range(0, len(data), size or max(1, len(data))):
        out += codec.receive(data[at : at + (size or len(data))])
        assert codec.counts.balanced()
        assert codec.counts.bytes_pending < FRAME_BYTES
    out += codec.flush()
    assert codec.counts.balanced()
    return [(frame.t_s, frame.ax) for frame in out]


def test_a_frame_goes_out_as_soon_as_its_time_line_is_complete() -> None:
    codec = Vn100Codec()
    assert codec.receive(encode(VALUES)) == []
    assert codec.receive(b"\nM,78") == []
    (frame,) = codec.receive(b"85\n")
    assert frame.t_s == 7.885
    assert frame[3:6] == pytest.approx([v / STANDARD_GRAVITY_MPS2 for v in VALUES[3:6]], rel=1e-7)
    assert frame[6:9] == pytest.approx([math.degrees(v) for v in VALUES[6:9]], rel=1e-7)
    assert frame.extra == VALUES[:14]
    assert frame.temp_c == VALUES[9]


@pytest.mark.parametrize(
    "behind",
    [
        b"",
        b"\nM,78x5\n",
        b"\n$GPVTG,0.00*32\r\nM,7885\n",
        b"\n\xff\nM,7885\n",
        b"\nM,\n",
        b"\nM,99999999999\n",
        b"\n" * 9,
    ],
)
@pytest.mark.parametrize("size", [1, 3, 1000])
def test_a_frame_whose_time_line_is_damaged_goes_out_without_time_and_no_later_one_is_taken(
    behind: bytes, size: int
) -> None:
    data = encode(VALUES) + behind + encode(VALUES, 8000)
    times = [t for t, _ in frames_of(Vn100Codec(), data, size)]
    assert times == [None, 8.0]


def test_a_bare_sensor_gives_its_frames_at_once() -> None:
    codec = Vn100Codec(time_line=False)
    (frame,) = codec.receive(encode(VALUES))
    assert frame.t_s is None


def test_a_frame_held_over_an_interruption_is_not_lost_and_takes_no_foreign_time() -> None:
    codec = Vn100Codec()
    assert codec.receive(encode(VALUES)) == []
    codec.reset()
    (frame,) = codec.receive(b"\nM,9999\n")
    assert frame.t_s is None
    assert codec.counts.balanced()


def test_look_alikes_are_bad_and_the_frame_inside_is_found() -> None:
    codec = Vn100Codec()
    data = HEADER + encode(VALUES, 100) + bytes(200)
    assert [t for t, _ in frames_of(codec, data)] == [0.1]
    assert codec.counts.frames_bad == 1
    assert codec.counts.bytes_bad == len(HEADER)


def test_time_goes_on_over_the_wrap_of_the_milliseconds() -> None:
    data = encode(VALUES, 2**32 - 50) + encode(VALUES, 50)
    times = [t for t, _ in frames_of(Vn100Codec(), data)]
    assert times == [pytest.approx(2**32 / 1000 - 0.05), pytest.approx(2**32 / 1000 + 0.05)]


def test_axes_are_mapped_but_the_makers_columns_are_not() -> None:
    (frame,) = Vn100Codec(AxisMap.parse("x-y-z")).receive(encode(VALUES, 1))
    assert frame.az == pytest.approx(-VALUES[5] / STANDARD_GRAVITY_MPS2)
    assert frame.gy == pytest.approx(-math.degrees(VALUES[7]))
    assert frame.extra == VALUES[:14]


@settings(max_examples=200, deadline=None)
@given(
    data=st.binary(max_size=600)
    | st.lists(st.sampled_from([HEADER, b"\nM,", b"123\n", encode(VALUES), b"\r\n", bytes(120)])).map(b"".join)
)
def test_arbitrary_bytes_never_raise_and_chunks_make_no_difference(data: bytes) -> None:
    whole, single = Vn100Codec(), Vn100Codec()
    assert frames_of(whole, data) == frames_of(single, data, 1)
    assert whole.counts == single.counts


def test_random_values_come_back_exactly_between_junk() -> None:
    rng = random.Random(3)
    codec = Vn100Codec()
    rows, data = [], b""
    for i in range(200):
        row = tuple(rng.uniform(-100, 100) for _ in range(29))
        data += rng.randbytes(rng.randrange(30)) + encode(row, i * 100)
        rows.append(row)
    out = []
    at = 0
    while at < len(data):
        size = rng.randrange(1, 300)
        out += codec.receive(data[at : at + size])
        at += size
    assert len(out) == 200
    assert [frame.t_s for frame in out] == [i / 10 for i in range(200)]
    assert all(frame.extra == pytest.approx(row[:14], rel=1e-7) for frame, row in zip(out, rows, strict=True))
