"""No text from outside makes a terminal do anything: the one function, the log's formatter, errors, the faces."""

from __future__ import annotations

import io
import logging
import os
from pathlib import Path

import pytest

from highside.errors import InputError, Refused
from highside.printable import one_line, printable
from highside.recording.files import write_whole
from highside.service.logs import SHORT, JournalFormatter, OneAMinute, PlainFormatter

HOSTILE = {
    "screen cleared": "\x1b[2J\x1b[H",
    "title set": "\x1b]0;owned\x07",
    "C1 sequence": "\x9b2J\x9d0;owned\x9c",
    "bidirectional override": "abc\u202etxt.exe\u2066",
    "forged line": "good\n    0.0 s  accepted 16/16 poses",
    "returned and overwritten": "bad\rgood",
    "line separators": "a\u2028b\u2029c\x85d",
    "backspaces": "secret\x08\x08\x08\x08\x08\x08",
    "deleted": "\x7f",
    "lone surrogate": "\udc80",
    "NUL": "a\0b",
}


def harmless(text: str) -> bool:
    """What a terminal prints as itself: no control, no format character, one line."""
    text.encode()
    return all(c.isprintable() or c in "\u00a0\u2009\u202f" for c in text)


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_what_a_terminal_would_obey_is_written_out(text: str) -> None:
    assert harmless(printable(text)) and harmless(one_line(text))
    assert printable(printable(text)) == printable(text)


def test_words_of_any_script_stay() -> None:
    for text in ("inclination 45°, ± 0.1 µg", "Ærøskøbing, 東京, Ολυμπία, שלום", "1 000 m", "naïve – “quoted” → ✓"):
        assert printable(text) == text
    assert printable("\x1b[2J") == "\\x1b[2J", "and it can be read what was tried"


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("formatter", [PlainFormatter("%(levelname)s %(message)s"), JournalFormatter("%(message)s")])
def test_a_log_line_is_one_line_and_nothing_else(text: str, formatter: logging.Formatter) -> None:
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(formatter)
    logger = logging.Logger("tried")
    logger.addHandler(handler)
    logger.warning("from %s: %s", "outside", text)
    try:
        raise ValueError(text)
    except ValueError:
        logger.exception("failed %s", text)
    said = stream.getvalue()
    assert said.endswith("\n")
    lines = said[:-1].split("\n")
    assert all(harmless(line) for line in lines)
    assert sum("from outside" in line for line in lines) == 1
    assert lines[1].endswith(f"failed {printable(text)}") and lines[2].startswith("Traceback")


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_an_error_is_one_printable_line(text: str) -> None:
    for error in (
        InputError(text, where=f"/tmp/{text}", field=text, remedy=text),
        Refused(f"the record of {text} is refused"),
    ):
        assert harmless(str(error))


def test_a_library_that_speaks_with_strangers_says_one_short_line_a_minute() -> None:
    now = [0.0]
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(PlainFormatter("%(message)s"))
    logger = logging.Logger("library")
    logger.addHandler(handler)
    logger.addFilter(OneAMinute(lambda: now[0]))
    for k in range(1000):
        now[0] = 0.1 * k
        try:
            raise RuntimeError("\x1b[2J\n" * 1000)
        except RuntimeError:
            logger.exception("frame %s", k)
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2 and lines[1].endswith("(and 599 more)")
    assert all(harmless(line) and len(line) < SHORT + 30 and "Traceback" not in line for line in lines)


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o027])
def test_a_file_has_the_permissions_of_the_umask_which_nobody_sets(
    tmp_path: Path, umask: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To set it, even for an instant, opens the files that other threads make then to all."""

    def refused(_: int) -> int:
        raise AssertionError("the umask belongs to the whole process")

    before = os.umask(umask)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "umask", refused)
            write_whole(tmp_path / "whole", b"x")
            write_whole(tmp_path / "whole", b"y")
    finally:
        os.umask(before)
    assert (tmp_path / "whole").stat().st_mode & 0o777 == 0o666 & ~umask
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]
