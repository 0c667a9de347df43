"""WITS level 0: what is written reads back, rubbish is survived, records keep their bytes."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec.wits0 import Parser, encode
from highside.config.rig import DEFAULT_ITEMS, WitsItem
from highside.errors import InputError
from highside.service.rig.wits import Latest, record

codes = st.from_regex(r"[0-9]{4}", fullmatch=True)
values = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20).map(str.strip)
items = st.lists(st.tuples(codes, values), max_size=20).map(tuple)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(records=st.lists(items, max_size=5), cuts=st.randoms(use_true_random=False))
def test_what_is_written_reads_back_in_any_pieces(records, cuts) -> None:
    stream = b"".join(encode(r) for r in records)
    parser, found, at = Parser(), [], 0
    while at < len(stream):
        step = cuts.randint(1, 40)
        found += parser.receive(stream[at : at + step])
        at += step
    assert found == records
    assert (parser.bad_lines, parser.broken, parser.records) == (0, 0, len(records))


@settings(max_examples=300, deadline=None, derandomize=True)
@given(rubbish=st.binary(max_size=2000), good=items)
def test_a_record_after_rubbish_is_read(rubbish: bytes, good) -> None:
    parser = Parser()
    parser.receive(rubbish)
    # a line end closes whatever the rubbish had begun
    assert parser.receive(b"\r\n" + encode(good))[-1] == good


def test_a_record_cut_half_way_is_counted_and_the_next_one_is_read() -> None:
    parser = Parser()
    assert parser.receive(b"&&\r\n07131.00\r\n&&\r\n07132.00\r\n!!\r\n") == [(("0713", "2.00"),)]
    assert parser.broken == 1


def test_a_line_without_end_does_not_fill_the_memory() -> None:
    parser = Parser()
    for _ in range(100):
        parser.receive(b"x" * 10_000)
    assert len(parser._tail) <= 10_000
    assert parser.receive(b"\r\n&&\r\n0713 4\r\n!!\r\n") == [(("0713", "4"),)]


@pytest.mark.parametrize("item", [("713", "1"), ("07a3", "1"), ("0713", "1\n2"), ("0713", "ü"), ("0713", " 1")])
def test_what_would_break_a_record_is_refused(item: tuple[str, str]) -> None:
    with pytest.raises(InputError):
        encode([item])


def test_the_bytes_of_a_record() -> None:
    latest = Latest(
        {"inc_deg": 34.2649, "motor_toolface_deg": 359.97, "azi_deg": None}, 100.0, 1_700_000_000.0, depth="2841.5",
        depth_s=90.0,
    )  # fmt: skip
    data = encode(record(DEFAULT_ITEMS, latest, 101.0, 30.0))
    # 2023-11-14 22:13:20 UTC; an azimuth that is not known is left out; 359.97 is 0 to one decimal
    assert data == b"&&\r\n0705231114\r\n0706221320\r\n07082841.5\r\n071334.26\r\n07170.0\r\n!!\r\n"
    assert re.fullmatch(rb"&&\r\n(\d{4}[^\r\n]*\r\n)+!!\r\n", data)


def test_stale_readings_and_unknown_ones_are_not_sent() -> None:
    latest = Latest({"inc_deg": 1.0}, 100.0, 1e9)
    assert record(DEFAULT_ITEMS, latest, 131.0, 30.0) == ()
    assert record(DEFAULT_ITEMS, Latest({"inc_deg": float("nan")}, 100.0, 1e9), 100.0, 30.0) == ()
    survey = (WitsItem(code="0713", value="inc_deg", source="survey"), WitsItem(code="0705", value="date"))
    assert record(survey, latest, 101.0, 30.0) == ()
    latest.survey = {"inc_deg": 2.0}
    assert record(survey, latest, 101.0, 30.0)[0] == ("0713", "2.00")


def test_an_item_that_names_the_toolface_of_the_bend_as_before_means_it() -> None:
    assert WitsItem.model_validate({"code": "0717", "value": "toolface_deg"}).value == "motor_toolface_deg"
