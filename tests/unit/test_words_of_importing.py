"""What an import says of a file, in a language in which each message stands in brackets."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from highside.api.importing import rows_of
from highside.errors import InputError
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign, recording_of
from highside.words import in_language, told
from tests.brackets import outside

STILL = "".join(f"{0.1 * k:g},0.01,0.02,1.0\n" for k in range(120))
LATER = STILL.replace("5,0.01", "5.003,0.01", 1) + "3.05,0.1,0,1\n"
COUNTS = "".join(f"{k},{k * 97 % 251},{k * 31 % 83},16384\n" for k in range(120))
FILES = {
    "nothing known": "a,b,c,d\n" + STILL,
    "units by values": "time,ax,ay,az\n" + STILL,
    "units by names": "time_ms,acc x [m/s2],acc y [m/s2],acc z [m/s2]\n" + STILL,
    "counts": "time,ax,ay,az\n" + COUNTS,
    "poses": "inclination,toolface,ax,ay,az\n10,20,.1,.2,.9\n50,60,.3,.1,.8\n",
    "two axes": "t_s,ax_g,ay_g\n" + "".join(f"{k},0,0\n" for k in range(20)),
    "dates": "date,ax,ay,az\n" + "".join(f"2026-01-01T00:00:{k:02d}Z,0,0,1\n" for k in range(40)),
    "a text": "t_s,ax_g,ay_g,az_g\n0,0,0,1\n1,0,0,x\n",
    "a clock set back": "t_s,ax_g,ay_g,az_g\n" + LATER,
    "no rows": "t_s,ax_g,ay_g,az_g\n",
    "empty": "",
}
NAMES = re.compile(
    r"[\w./]*\.csv|\b[agt][xyz]?_(?:g|s|dps|ref_deg)\b|\w+_ref_deg|acc [xyz]|lsb/\d+|ISO|--\S+|[A-Z]{3,}:?\w*"
)
"""Names of files, columns and units, options and what stands for words of one's own"""


def said_of(path: Path) -> Iterator[str]:
    """All that is said of a file: why it is refused, or evidence, doubts and remedies."""
    try:
        proposal = open_foreign(path, Wishes())
        for row in rows_of(proposal):
            yield from (row[3], *row[4].split("; "))
        for doubt in proposal.doubts:
            yield from (*doubt.what.split("; "), doubt.remedy)
        if not any(doubt.open for doubt in proposal.doubts):
            yield from recording_of(proposal).findings
    except InputError as error:
        yield from (*error.what.split("; "), error.remedy)


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("name", FILES)
def test_all_that_is_said_of_a_file_is_known(name: str, tmp_path: Path) -> None:
    path = tmp_path / "file.csv"
    path.write_text(FILES[name])
    said = {text for text in said_of(path) if text}
    assert said
    with in_language("de"):
        unknown = {text for text in said if re.search(r"[^\W\d_]{3,}", NAMES.sub("", outside(told(text, "importing"))))}
    assert unknown == set(), "list them in words.sentences_of_importing, make words, then translate"


def test_a_column_that_is_called_like_a_word_keeps_its_name() -> None:
    with in_language("de"):
        assert told("temp_c from temperature: holds no number", "importing") == (
            "temp_c aus temperature: enthält keine Zahl"
        )
        assert told("--poses, or --rate HZ", "importing") == "--poses, oder --rate HZ"
        assert told("t_s from time: its unit may be s or ms", "importing").endswith("kann s oder ms sein")
