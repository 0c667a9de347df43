"""The short form of `fuzz.py`: some thousand damaged inputs for each parser; what is sound is accepted."""

from __future__ import annotations

import contextlib
import random
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import fuzz
import pytest
from parsers import EVERYWHERE, READING, TOP, Bench, Parser, all_parsers, files_of, what_it_does

from highside.errors import HighsideError

INPUTS, SECONDS = 2000, 2.0


@pytest.fixture(scope="module")
def parsers() -> Iterator[dict[str, Parser]]:
    bench = Bench()
    yield {parser.name: parser for parser in all_parsers(bench)}
    bench.close()


NAMES = (
    "service TOML", "bench TOML", "certificate TOML", "model TOML", "codec TOML", "--set", "DBC text",
    "calibration record", "record, hashed again", "activation", "compensation", "compensation, hashed again",
    "drift state", "drift state, by structure", "watch state", "watch state, by structure", "toolface log",
    "surveys", "surveys, analysed", "survey depths", "watch and tool model", "watch said",
    "watch said, by structure", "starts of the service", "known time",
    "trusted keys", "signature", "journal", "journal, chained again", "recording CSV", "recording CSV.gz",
    "recording Parquet", "pose table", "import CSV", "import containers", "fleet catalogue", "archived message",
    "import profile", ".hsw", "candump", "drift/command", "watch/command", "session/command",
)  # fmt: skip


def test_every_parser_is_named_here(parsers: dict[str, Parser]) -> None:
    assert tuple(parsers) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_what_is_sound_is_accepted_and_nothing_escapes_from_what_is_not(parsers: dict[str, Parser], name: str) -> None:
    parser = parsers[name]
    for sound in parser.sound:
        assert parser.parse(sound)
    tally = fuzz.fuzz(parser, INPUTS, seed=20261122, seconds=SECONDS)
    assert tally.balanced()
    assert tally.inputs >= 64
    assert not tally.escaped, (dict(tally.escaped), {what: data[:300] for what, data in tally.examples.items()})
    # the damage is neither harmless nor nothing but noise
    assert tally.refused


def test_books_that_are_kept_are_gone_on_with(tmp_path: Path) -> None:
    """In two runs the same inputs as in one, none twice; an escape of the first is still told after the second."""
    seen: list[bytes] = []

    def parse(data: bytes) -> bool:
        seen.append(data)
        if len(seen) == 3:
            raise KeyError("x")
        return data[0] < 128

    def made(name: str) -> Parser:
        return Parser("made", lambda rng: rng.randbytes(4), parse, (), (name,))

    def books() -> fuzz.Books:
        return fuzz.Books(tmp_path / "books.json")

    parser = made("codec/can_dbc")
    fuzz.at_most(parser, 70, 5, 60.0, books())
    tally = fuzz.at_most(parser, 200, 5, 60.0, books())
    assert (tally.inputs, tally.escaped.total(), tally.balanced()) == (200, 1, True)
    assert seen == [random.Random(f"5 made {number}").randbytes(4) for number in range(200)]
    assert fuzz.at_most(parser, 200, 5, 60.0, books()).inputs == len(seen) == 200
    # another seed adds to it; code that has changed has had none of them
    assert fuzz.at_most(parser, 264, 6, 60.0, books()).inputs == len(seen) == 264
    changed = made("printable")
    assert fuzz.at_most(changed, 64, 5, 60.0, books()).inputs == 64
    assert books().before(changed).inputs == 264
    assert seen[264:] == seen[:64]


def test_an_exception_a_long_line_and_a_long_time_are_escapes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "LONGEST_S", 1)

    def parse(data: bytes) -> bool:
        if data == b"0":
            raise KeyError("x")
        while data == b"1":
            pass
        return data == b"2"

    made = iter((b"0", b"1", b"2", b"3"))
    tally = fuzz.fuzz(Parser("made", lambda _: next(made), parse, ()), 4, seed=1)
    assert tally.balanced()
    assert (tally.inputs, tally.accepted, tally.refused, tally.escaped.total()) == (4, 1, 1, 2)


@pytest.mark.parametrize("name", NAMES)
def test_the_state_of_a_parsers_code_is_that_of_all_it_runs(parsers: dict[str, Parser], name: str) -> None:
    """What the books call the present code must hold every module that an input passes through."""
    parser = parsers[name]
    counted = {str(path) for path in files_of((*READING, *parser.modules, *EVERYWHERE))}
    ran = set()

    def watch(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_name != "<module>" and code.co_filename.startswith(str(TOP)):
            ran.add(code.co_filename)

    inputs = [*parser.sound, *(parser.make(random.Random(f"state {number}")) for number in range(20))]
    before = sys.getprofile()
    sys.setprofile(watch)
    try:
        for data in inputs:
            with contextlib.suppress(HighsideError):
                parser.parse(data)
    finally:
        sys.setprofile(before)
    assert ran
    assert not ran - counted


def test_a_comment_is_no_other_code(tmp_path: Path) -> None:
    path, same, other = (tmp_path / name for name in ("a.py", "b.py", "c.py"))
    path.write_text('"""What it is."""\n\ndef f(x):\n    """Twice."""\n    return 2 * x\n')
    same.write_text("def f(x):\n    # of old\n    return (2\n        * x)\n")
    other.write_text("def f(x):\n    return 3 * x\n")
    assert what_it_does(path) == what_it_does(same) != what_it_does(other)
