"""Lines of delimited text."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec.delimited import DelimitedCodec, DelimitedCodecConfig
from highside.codec.frame import Frame


def layout_of(fields: dict[str, dict[str, float]], **settings: object) -> DelimitedCodecConfig:
    return DelimitedCodecConfig.model_validate({"name": "delimited", "fields": fields} | settings)


ACCEL = {"ax_g": {"column": 1}, "ay_g": {"column": 2}, "az_g": {"column": 3}}


def frames_of(codec: DelimitedCodec, data: bytes, size: int = 1 << 20) -> list[Frame]:
    out = []
    for at in range(0, len(data), size):
        out += codec.receive(data[at : at + size])
        assert codec.counts.balanced()
        assert codec.counts.bytes_pending <= 512
    out += codec.flush()
    assert codec.counts.balanced()
    assert codec.counts.bytes_pending == 0
    return out


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_lines_are_sorted_into_readings_bad_ignored_text_and_junk(size: int) -> None:
    layout = layout_of(ACCEL, columns=4, select={"column": 0, "equals": "3"})
    codec = DelimitedCodec(layout)
    lines = {
        "text": [b"boot\r\n", b"3\r\n", b"GPZDA,1,2\r\n", b"\r\n"],
        "framed": [b"3,0.1,-2e-1,.5\r\n", b"3, 1 ,2,3\n"],
        "ignored": [b"4,1,2,3\r\n"],
        "bad": [
            b"3,1,2\r\n",
            b"3,1,2,3,4\r\n",
            b"3,nan,2,3\r\n",
            b"3,1_0,2,3\n",
            b"3,0x1,2,3\n",
            b"3,1e999,2,3\n",
            b"3,,2,3\n",
        ],
        "junk": [b"3,1,\xff,3\n", b"3,1,2\x00,3\n", b"3," + b"1" * 600 + b",2,3\n"],
    }
    # the last, whose end is missing, may lack digits
    data = b"".join(line for group in lines.values() for line in group) + b"3,1,2,3"
    found = frames_of(codec, data, size)
    assert [f[3:6] for f in found] == [(0.1, -0.2, 0.5), (1.0, 2.0, 3.0)]
    counts = codec.counts
    assert counts.bytes_text == sum(map(len, lines["text"]))
    assert counts.bytes_framed == sum(map(len, lines["framed"]))
    assert counts.bytes_ignored == sum(map(len, lines["ignored"]))
    assert counts.bytes_bad == sum(map(len, lines["bad"]))
    assert counts.bytes_junk == sum(map(len, lines["junk"])) + len(b"3,1,2,3")
    assert (counts.frames_good, counts.frames_bad, counts.frames_ignored) == (2, len(lines["bad"]), 1)


def test_the_end_of_a_line_cut_at_the_start_is_not_taken_for_a_reading() -> None:
    codec = DelimitedCodec(layout_of(ACCEL))
    # the end of "0,11,2,3"
    assert [f.ax for f in frames_of(codec, b"0,1,2,3\n0,11,2,3\n")] == [11.0]
    codec.receive(b"0,1")
    codec.reset()
    assert [f.ax for f in codec.receive(b"5,12,2,3\n0,12,2,3\n")] == [12.0]


def test_nmea_checksums_are_checked_and_then_the_first_line_counts_too() -> None:
    codec = DelimitedCodec(layout_of(ACCEL, prefix="$ACC", checksum="nmea"))
    good = b"$ACC,1,2,3*"
    total = 0
    for byte in good[1:-1]:
        total ^= byte
    line = good + b"%02X\r\n" % total
    found = frames_of(codec, line + line.replace(b"1", b"9", 1) + b"$ACC,1,2,3\n" + b"$GPX,1,2,3*00\n")
    assert [f.ax for f in found] == [1.0]
    assert codec.counts.frames_bad == 2
    assert codec.counts.bytes_text == len(b"$GPX,1,2,3*00\n")


def test_scale_offset_extra_columns_sequence_and_axes() -> None:
    fields = {
        "ax_g": {"column": 1, "scale": 1e-3},
        "ay_g": {"column": 2, "scale": 1e-3},
        "temp_c": {"column": 3, "scale": 0.1, "offset": -40},
        "volts": {"column": 4, "scale": 2.0},
    }
    codec = DelimitedCodec(layout_of(fields, delimiter=";", seq_column=0, seq_modulus=256, axes="y-xz"))
    assert codec.extra_columns == ("volts",)
    assert codec.seq_modulus == 256
    (frame,) = frames_of(codec, b"\n17;500;-250;650;1.5\n")
    assert frame.seq == 17
    assert (frame.ax, frame.ay, frame.temp_c) == pytest.approx((-0.25, -0.5, 25.0))
    assert frame.az != frame.az
    assert frame.extra == (3.0,)


def test_time_adds_up_and_goes_on_over_midnight() -> None:
    layout = layout_of(
        ACCEL, time=({"column": 0}, {"column": 4, "scale": 1.0, "divide_by_column": 5}), time_wrap_s=86400.0
    )
    codec = DelimitedCodec(layout)
    rows = [(86399, 900, 1000), (0, 100, 1000), (0, 200, 1000), (1, 0, 0), (2, 0, 1000)]
    data = b"\n" + b"".join(b"%d,1,2,3,%d,%d\n" % row for row in rows)
    found = frames_of(codec, data)
    assert [f.t_s for f in found] == pytest.approx([86399.9, 86400.1, 86400.2, 86402.0])
    # a division by zero makes a line bad and moves no clock
    assert codec.counts.frames_bad == 1
    # a damaged second of the day is no time
    assert codec.receive(b"99999,1,2,3,0,1000\n") == []
    assert [f.t_s for f in codec.receive(b"3,1,2,3,0,1000\n")] == [86403.0]


@settings(max_examples=200, deadline=None)
@given(
    data=st.binary(max_size=400)
    | st.lists(st.sampled_from([b"3,", b"1", b"\n", b"\r\n", b"nan", b"1e5", b"-", b",", b"9" * 300, b"\xff"])).map(
        b"".join
    )
)
def test_arbitrary_bytes_never_raise_and_chunks_make_no_difference(data: bytes) -> None:
    layout = layout_of(
        ACCEL,
        select={"column": 0, "equals": "3"},
        time=({"column": 0, "scale": 1.0, "divide_by_column": 1},),
        time_wrap_s=100.0,
    )
    whole, single = DelimitedCodec(layout), DelimitedCodec(layout)
    assert frames_of(whole, data) == frames_of(single, data, 1)
    assert whole.counts == single.counts


def test_a_line_that_never_ends_needs_no_memory() -> None:
    codec = DelimitedCodec(layout_of(ACCEL))
    for _ in range(1000):
        codec.receive(b"1" * 100)
        assert codec.counts.bytes_pending <= 512
    assert [f.ax for f in codec.receive(b"\n0,4,2,3\n")] == [4.0]


def test_numbers_survive_the_way_through_text() -> None:
    rng = random.Random(5)
    rows = [tuple(rng.uniform(-20, 20) for _ in range(3)) for _ in range(500)]
    data = b"\n" + b"".join(f"0,{x!r},{y!r},{z!r}\n".encode() for x, y, z in rows)
    assert [f[3:6] for f in frames_of(DelimitedCodec(layout_of(ACCEL)), data, 13)] == rows
