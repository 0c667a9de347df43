"""The words of the pages: no catalogue misses a message or has one too many, placeholders match, what travels compiled
is what is written, and the reader's language is found as browsers ask for it."""

from __future__ import annotations

import gettext
import pickle
import re
from copy import deepcopy
from functools import cache
from io import BytesIO
from pathlib import Path

import pytest
from babel.messages.catalog import Catalog
from babel.messages.extract import extract
from babel.messages.pofile import read_po

from highside.bench.session.guidance import instruction
from highside.bench.session.labels import LABELS
from highside.bench.session.reasons import Fault, Refusal, Rejection
from highside.bench.session.snapshot import Deviation
from highside.calibration.verification import Conformity
from highside.config.settings import load
from highside.errors import InputError
from highside.service.alarms import ALARMS
from highside.web import words
from highside.words import catalogue as catalogue_of
from highside.words import extraction, in_language, said
from highside.words.errors import error_told
from highside.words.sentences import SENTENCES
from tests.brackets import outside

SOURCES = Path(catalogue_of.__file__).parents[1]
TEMPLATES = ("web", "report")
DECLARED = ("physics/effects/*.py", "physics/covariates.py")
"""What effects say of themselves."""
MARKED = re.compile(r"(?<![\w.])(?:_|said|said_later|several)\(")
OTHERS = sorted(set(words.LANGUAGES) - {"en"})
PLACEHOLDER = re.compile(r"%\(\w+\)[sd]|%[sd]")
KEYWORDS = {"_": None, "said_later": None, "said": None, "several": (1, 2)}


@cache
def messages() -> set[str]:
    """What the sources say."""
    found: set[str] = set()
    for path in SOURCES.rglob("*.py"):
        # what marks no message is not read twice
        if MARKED.search(text := path.read_text(encoding="utf-8")):
            found |= {one_of(message) for _, message, _, _ in extract("python", BytesIO(text.encode()), KEYWORDS)}
    declared = [path for pattern in DECLARED for path in sorted(SOURCES.glob(pattern))]
    assert len(declared) > 60
    for path in declared:
        with path.open("rb") as file:
            found |= {str(message) for _, _, message, _ in extraction.declared(file, (), (), {})}
    for folder in TEMPLATES:
        for path in (SOURCES / folder).rglob("*.html"):
            with path.open("rb") as file:
                given = extract("jinja2", file, KEYWORDS, (), {"encoding": "utf-8"})
                found |= {one_of(message) for _, message, _, _ in given}
    return found


def one_of(message: str | tuple[str, ...]) -> str:
    """A message by its singular."""
    return message if isinstance(message, str) else message[0]


def catalogue(language: str) -> Catalog:
    with (catalogue_of.LOCALE / language / "LC_MESSAGES" / "highside.po").open("rb") as file:
        return read_po(file, locale=language)


@pytest.mark.parametrize("language", OTHERS)
def test_no_catalogue_misses_a_message_or_has_one_too_many(language: str) -> None:
    said = {one_of(message.id) for message in catalogue(language) if message.id}
    assert messages() - said == set(), "make words, then translate"
    assert said - messages() == set(), "nobody says that any more"
    assert len(said) > 90


@pytest.mark.parametrize("language", OTHERS)
def test_every_message_is_translated_with_its_placeholders(language: str) -> None:
    for message in catalogue(language):
        if not message.id:
            continue
        assert not message.fuzzy, message.id
        # singular and plural are two texts, each translated
        texts = message.string if message.pluralizable else (message.string,)
        origins = message.id if message.pluralizable else (message.id,)
        for text, origin in zip(texts, origins, strict=True):
            assert text.strip(), origin
            assert sorted(PLACEHOLDER.findall(text)) == sorted(PLACEHOLDER.findall(origin)), origin
            assert text[-1:] in ".?:" or origin[-1] not in ".?:", origin


@pytest.mark.parametrize("language", OTHERS)
def test_what_is_compiled_is_what_is_written(language: str) -> None:
    compiled = catalogue_of.catalogue(language)
    assert isinstance(compiled, gettext.GNUTranslations)
    for message in catalogue(language):
        if message.pluralizable:
            given = tuple(compiled.ngettext(*message.id, count) for count in (1, 2))
            assert given == tuple(message.string), "make words"
        elif message.id:
            assert compiled.gettext(message.id) == message.string, "make words"


@pytest.mark.parametrize(
    ("header", "language"),
    [
        ("", "en"),
        ("de", "de"),
        ("de-CH,en;q=0.5", "de"),
        ("en-GB,de;q=0.9", "en"),
        ("fr,no;q=0.4,es;q=0.3", "nb"),
        ("nn-NO", "nb"),
        ("fr, de;q=0", "en"),
        ("de;q=0.1,es;q=0.9", "es"),
        ("*;q=x,,;;=,de;q=nan", "en"),
        ("../../etc,\x00," * 1000 + "de", "en"),
    ],
)
def test_the_language_is_the_best_that_the_browser_asks_for(header: str, language: str) -> None:
    assert words.accepted(header) == language
    scope = {"headers": [(b"accept-language", header.encode("latin-1"))]}
    assert words.language_of(scope) == language
    for chosen in ("es", "xx", "../de", ""):
        cookie = (b"cookie", f"highside_language={chosen}".encode())
        expected = chosen if chosen in words.LANGUAGES else language
        assert words.language_of({"headers": [*scope["headers"], cookie]}) == expected


def test_every_reason_of_a_session_and_every_alarm_is_among_the_sentences() -> None:
    texts = {one.text for kind in (Rejection, Refusal, Fault) for one in kind} | set(ALARMS.values())
    texts |= {label for label, _ in LABELS.values()} | {Conformity.PASS.value, Conformity.FAIL.value}
    assert texts - set(SENTENCES) == set()
    assert len(set(SENTENCES)) == len(SENTENCES)


def in_german(text: str) -> str:
    with in_language("de"):
        return words.told(text)


def test_a_sentence_with_values_in_it_is_told_with_them() -> None:
    way = instruction(Deviation(inc_deg=3.63, tf_deg=-16.58, angle_deg=11.9, tolerance_deg=0.61))
    told = in_german(f"Set 3 (inclination 45, toolface 135): {way}.")
    assert told == (
        "Stellung 3 einstellen (Neigung 45, Toolface 135): um 17° gegen den Uhrzeigersinn drehen, um 3.6° heben."
    )
    assert in_german(Rejection.OUTLIER.text + " (5.1 standard deviations from what the other poses predict)").endswith(
        "(5.1 Standardabweichungen von dem, was die anderen Stellungen erwarten lassen)"
    )
    said = "Clamp the tool, check that the table is level, then choose Start (roll test at 45 deg)."
    assert in_german(said).endswith("dann wählen Sie Start (Rollversuch bei 45°).")


def test_a_sentence_with_its_values_is_told_by_what_it_was_made_of() -> None:
    inner = said("raise %(angle)s deg", angle="3.6")
    one = said("Set %(pose)s (inclination %(inc)s, toolface %(tf)s): %(how)s.", pose=3, inc=45, tf=135, how=inner)
    assert one == "Set 3 (inclination 45, toolface 135): raise 3.6 deg."
    assert in_german(one) == "Stellung 3 einstellen (Neigung 45, Toolface 135): um 3.6° heben."
    for copy in (pickle.loads(pickle.dumps(one)), deepcopy(one)):
        assert copy == one and in_german(copy) == in_german(one)
    assert in_german(said("alarm %(name)s", name="100 %s of (nothing)")) == "Alarm 100 %s of (nothing)"


def test_a_sentence_that_nobody_knows_is_left_as_it_is() -> None:
    for text in ("", "tool-7", "100 % of nothing", "(((", "%(pose)s", "a (b (c (d (e (f))))) " * 40, "x" * 100_000):
        assert in_german(text) == text


SETTINGS_WITH_MISTAKES = """
[tool]
id = 5
serail = "1"
[link]
kind = "serial"
port = 3
baud = "x"
silence_s = -1
[mqtt]
host = "h"
reconnect_max_s = 1
reconnect_min_s = 5
"""


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("text", ["", "a = = 3", '[tool]\nid = "a"\n[link]\nkind = "serail"', SETTINGS_WITH_MISTAKES])
def test_mistakes_in_a_file_of_settings_are_told(text: str, tmp_path: Path) -> None:
    file = tmp_path / "7.toml"
    file.write_text(text)
    with pytest.raises(InputError) as wrong:
        load(file)
    with in_language("de"):
        line = outside(error_told(wrong.value, "settings").removeprefix(str(file)), " ")
    # left are names of fields, and what the parser of TOML says
    line = re.sub(r"[a-z]+(\.[a-z_]+)*:", "", line)
    assert not re.search(r"[^\W\d_]{3,}", line), line
