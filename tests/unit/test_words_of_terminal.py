"""The language of a terminal: that of `--language`, else of `HIGHSIDE_LANGUAGE`, else of the locale; in it stands what
is wrong with the command line, and what an output would replace."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from highside.cli import kinds, overwriting
from highside.cli.commands import run
from highside.words import in_language, told
from highside.words.preferred import preferred_language
from tests.brackets import outside

ENGLISH = "highside: Missing argument 'REC'. (see "
GERMAN = "highside: Es fehlt das Argument 'REC'. (siehe "


@pytest.mark.parametrize(
    ("environment", "language"),
    [
        ({}, "en"),
        ({"LANG": "de_AT.UTF-8"}, "de"),
        ({"LANG": "es"}, "es"),
        ({"LANG": "nn_NO.UTF-8"}, "nb"),
        ({"LANG": "no_NO"}, "nb"),
        ({"LANG": "sr_RS@latin"}, "en"),
        ({"LANG": "C.UTF-8", "LANGUAGE": "de"}, "en"),
        ({"LANG": "POSIX"}, "en"),
        ({"LANG": "fr_FR.UTF-8", "LANGUAGE": "pt:es:de"}, "es"),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "nb_NO.UTF-8"}, "nb"),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "nb_NO.UTF-8", "LC_ALL": "C"}, "en"),
        ({"LANG": "de_DE.UTF-8", "LC_ALL": ""}, "de"),
        ({"LANG": "de_DE.UTF-8", "HIGHSIDE_LANGUAGE": "es"}, "es"),
        ({"LANG": "de_DE.UTF-8", "HIGHSIDE_LANGUAGE": "en"}, "en"),
        ({"LANG": "de_DE.UTF-8", "HIGHSIDE_LANGUAGE": "klingon"}, "en"),
        ({"LANG": "C", "HIGHSIDE_LANGUAGE": "nb_NO"}, "nb"),
    ],
)
def test_the_environment_says_which_language_a_terminal_speaks(environment: dict[str, str], language: str) -> None:
    assert preferred_language(environment) == language


def test_a_command_without_an_option_speaks_as_the_environment_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HIGHSIDE_LANGUAGE", "de")
    assert run(["rotation", "fit"]) == 2
    assert capsys.readouterr().err.startswith(GERMAN)
    monkeypatch.delenv("HIGHSIDE_LANGUAGE")
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    assert run(["rotation", "fit"]) == 2
    assert capsys.readouterr().err.startswith(GERMAN)


@pytest.mark.parametrize("given", [("--language", "en"), ("--language=en",)])
def test_the_option_counts_more_than_the_environment(
    given: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HIGHSIDE_LANGUAGE", "de")
    assert run(["rotation", "fit", *given]) == 2
    assert capsys.readouterr().err.startswith(ENGLISH)


WRONG = (
    "rnu",
    "zzz",
    "--nope",
    "run",
    "rotation",
    "calibrate slve",
    "diagnose",
    "diagnose --outt 3",
    "diagnose --out",
    "diagnose x.csv --out o --seed x",
    "diagnose x.csv --out o --seed 1.5",
    "diagnose x.csv --out o --align zz",
    "diagnose x.csv y.csv --out o",
    "diagnose x.csv --out o --sheet=3 --report=3",
    "demo --secnods 3",
    "demo --seconds x",
    "demo extra 3",
    "fleet records x --limit-deg x",
    "watch",
)
NAMES = re.compile(
    r"--[\w-]+|'[^']*'|(?:highside|python -m pytest[\w.]*)[a-z -]*|\b(?:rnu|zzz|slve|extra|RECORDING|[xy]\.csv)\b"
)
WORD = re.compile(r"[^\W\d_]{3,}")


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("brackets", [False], indirect=True)
def test_what_is_wrong_with_a_command_line_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HIGHSIDE_LANGUAGE", "de")
    escaped = {}
    for line in WRONG:
        assert run(line.split()) == 2
        (said,) = capsys.readouterr().err.splitlines()
        if WORD.search(NAMES.sub("", outside(said.removeprefix("highside: "), " "))) or "⟦" not in said:
            escaped[line] = said
    assert escaped == {}, "the parser's own words: list them in words.sentences_of_terminal; make words, then translate"


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("brackets", [False], indirect=True)
def test_every_kind_of_file_that_is_not_replaced_is_told() -> None:
    named = {one.words for one in vars(kinds).values() if isinstance(one, kinds.Kind)}
    named |= {one.words for one in kinds.ANALYSIS.values()} | set(overwriting.IRREPLACEABLE.values())
    assert len(named) > 20
    with in_language("de"):
        left = {
            words
            for words in named
            if WORD.search(
                re.sub(
                    r"\w+\.json",
                    "",
                    outside(told(f"is there already and is not {words}, and so is not replaced", "commands")),
                )
            )
        }
    assert left == set()


def test_an_output_that_would_replace_another_file_is_refused_in_german(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (("turn.csv", "t_s\n1\n"), ("mine.json", "{}"), ("key", "-----BEGIN X-----\n")):
        Path(name).write_text(text)
    for output, said in (
        ("turn.csv", "ist eine Datei, die dieser Befehl liest; nennen Sie eine andere Datei"),
        (
            "mine.json",
            "ist schon da und etwas anderes als eine Kompensation; es wird daher nicht ersetzt; nennen Sie eine andere "
            "Datei, oder nehmen Sie diese weg",
        ),
        (
            "key",
            "ist schon da und ist ein Schlüssel oder ein Zertifikat, was nicht ersetzt wird; nennen Sie eine andere "
            "Datei, oder nehmen Sie diese weg",
        ),
    ):
        assert run(["rotation", "fit", "turn.csv", "-o", output, "--language", "de"]) == 2
        assert capsys.readouterr().err == f"highside: {output}: --output: {said}\n"
