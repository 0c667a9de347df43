"""What commands refuse, in the reader's language: by the sources, where each message of the catalogue stands in
brackets, all is known; and those of `fleet` and `rotation`, told to refuse, say it so."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from highside.cli.commands import run
from highside.words import in_language, told
from tests.brackets import outside
from tests.refusals import refusals

OF_PROGRAMS = (
    # of the live service, whose words stand in its log, of the page's sockets, and of calls that no command makes
    re.compile(r"service/(reload|saved_drift|saved_watch|watch_stage|rig/metrics)\.py:.*"),
    re.compile(r"web/(sockets|tools/listener)\.py:.*"),
    re.compile(r"rotation/(online|samples|linear|fit)\.py:.*"),
    re.compile(r"recording/frames\.py:.*"),
    re.compile(r"calibration/(schedule|sensor|sensor_laws|zone)\.py:.*"),
    re.compile(r"physics/(law|learnt_source)\.py:.*"),
    # what is to be typed
    re.compile(r"importing/profiles\.py:.* (--reference FILE|7 is none)"),
    re.compile(r"importing/forms/delimited\.py:.* highside decode 7 --codec dbc .*"),
    re.compile(r"web/signin/people\.py:.* highside users add NAME .*"),
)
NAMES = re.compile(r"--\S+|\b\w+_\w+\b|`[^`]*`|pip install \S+|highside fleet diagnose|rotation fit|[\w./-]+\.csv\S*")
"""Options, columns and commands, which are the same in every language."""
WORD = re.compile(r"[^\W\d_]{3,}")


def unknown(text: str) -> bool:
    """Whether a word of it is not told; parts may be told one by one."""
    # where it stands is said before
    text = re.sub(r"^7(?=its )", "7: ", text)
    parts = (told(text, "commands"), "; ".join(told(part, "commands") for part in text.split("; ")))
    return all(WORD.search(NAMES.sub("", outside(part))) for part in parts)


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("brackets", [False], indirect=True)
def test_all_that_a_command_may_refuse_is_known() -> None:
    found = {text: where for text, where in refusals(".").items() if not _of_programs(text, where)}
    assert len(found) > 800
    with in_language("de"):
        left = {text: where for text, where in found.items() if unknown(text)}
    assert left == {}, "list them in words.sentences_of_commands; make words, then translate"


def _of_programs(text: str, where: str) -> bool:
    return any(one.fullmatch(f"{where} | {text}") for one in OF_PROGRAMS)


TURN = "t_s,rotor_deg,d_roll_arcmin,rotor_rate_dps\n" + "".join(f"{k},{(10 * k) % 360},0.5,10\n" for k in range(80))
FEW = "t_s,rotor_deg,d_roll_arcmin\n0,0,1\n1,10,1\n"
RADIANS = "t_s,rotor_deg,d_roll_arcmin\n" + "".join(f"{k},{0.3 * k % 6.28:.3f},0.5\n" for k in range(80))
COMPENSATION = '{"schema": "x", "id": "y"}'
FILES = {
    "turn.csv": TURN,
    "few.csv": FEW,
    "rad.csv": RADIANS,
    "none.csv": "t_s,rotor_deg\n0,1\n1,2\n",
    "c.json": COMPENSATION,
}
FILES |= {
    "tools.csv": "tool\n7\n",
    "twice.csv": "uri\na.csv\na.csv\n",
    "gap.csv": "uri,tool\n,7\n",
    "wire.csv": "uri,codec\na.bin,cobs\n",
    "cells.csv": "uri,tool\na.csv\n",
    "nothing.csv": "",
    "back.csv": "t_s,rotor_deg,d_roll_arcmin\n1,0,1\n0,10,1\n",
    "list.csv": "uri\nfew.csv\n",
}


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a command says in that language when it refuses."""
    folder = tmp_path / "7"
    (folder / "empty").mkdir(parents=True)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    monkeypatch.chdir(folder)

    def say(*arguments: str) -> str:
        assert run([*arguments, "--language", "de"]) in (1, 2)
        said = capsys.readouterr()
        assert not said.out
        return said.err

    return say


WRONG = (
    "rotation fit none.csv -o x",
    "rotation fit few.csv -o x",
    "rotation fit rad.csv -o x",
    "rotation fit back.csv -o x",
    "rotation fit nothing.csv -o x",
    "rotation fit turn.csv -o x --method sine --rate-terms 1",
    "rotation fit turn.csv -o x --rate-terms 7",
    "rotation apply c.json turn.csv -o x",
    "rotation apply turn.csv turn.csv -o x",
    "rotation compare none.csv",
    "rotation compare few.csv --rate-terms 3",
    "rotation turntable none.csv -o x",
    "rotation fit-self none.csv -o x",
    "fleet diagnose empty --out o",
    "fleet diagnose tools.csv --out o",
    "fleet solve twice.csv --out o",
    "fleet drift gap.csv --out o",
    "fleet solve wire.csv --out o",
    "fleet solve cells.csv --out o",
    "fleet solve nothing.csv --out o",
    "fleet summary empty",
    "fleet records empty",
    "fleet records few.csv",
    "fleet records empty --limit-deg 100",
)
VALUES = re.compile(
    r"\b(line|CATALOGUE|DIR|uri|codec|json|empty|cobs|sine)\b|\.(bin|csv|gz|parquet|mcap)\b|'highside\.rotation/1'"
)
"""Places, endings and what the files hold"""


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("brackets", [False], indirect=True)
def test_a_command_refuses_in_the_language_that_was_asked_for(refused: Callable[..., str]) -> None:
    escaped = {}
    for arguments in WRONG:
        said = refused(*arguments.split())
        left = VALUES.sub("", NAMES.sub("", outside(said.removeprefix("highside: "), " ")))
        if WORD.search(left) or "⟦" not in said:
            escaped[arguments] = said
    assert escaped == {}


def test_a_refusal_reads_in_german(refused: Callable[..., str]) -> None:
    assert refused("fleet", "solve", "cells.csv", "--out", "o") == (
        "highside: cells.csv: line 2: 1 Zellen unter 2 Namen; berichtigen Sie die Zeile\n"
    )
    assert refused("rotation", "fit", "turn.csv", "-o", "x", "--method", "sine", "--rate-terms", "1") == (
        "highside: --rate-terms: sine hat keine Ratenterme; verwenden Sie polynomial9 oder auto\n"
    )
