"""Reports and certificates in each language: no sentence of the catalogue stands in them in English, no word is outside
of the catalogue (a language in brackets shows it), numbers are written alike, and printed sheets count in it too."""

from __future__ import annotations

import html
import re
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from babel.messages.pofile import read_po
from PIL import Image
from rehearsal import Rehearsal

from highside.api.certificate import certify
from highside.bench import photographs
from highside.bench.photographs import Found
from highside.bench.session import plans
from highside.bench.session.entries import Noted, Photographed
from highside.bench.session.journal import Journal, encode_all, read_journal
from highside.bench.session.outcome import replay
from highside.bench.simulated_operator import OperatorMistake
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord, pose_set
from highside.config.certificate import CertificateFields
from highside.errors import InputError
from highside.report.certificate import certificate
from highside.report.certificate_inputs import Inputs
from highside.report.certificate_photographs import BYTES_MAX, SHOWN_MAX
from highside.report.session_page import session_page
from highside.words import LANGUAGES, catalogue, in_language
from tests.brackets import outside
from tests.photograph import a_photograph

OTHERS = sorted(set(LANGUAGES) - {"en"})
FIELDS = CertificateFields.model_validate(
    {
        "issue": {"laboratory": "L1", "customer": "C1", "signatory": "S1", "role": "R1", "number": "N1", "place": "P1"},
        "bench": {"description": "D1", "certificate": "K1", "issued_by": "Q1", "valid_until": date(2027, 1, 1),
                  "inc_expanded_deg": 0.005, "tf_expanded_deg": 0.01},
        "thermometer": {"description": "D2", "expanded_c": 0.3},
        "environment": {"temp_c": [20.0, 24.0], "humidity_percent": [30.0, 40.0]},
        "use": {"readings": 4, "turn_on_g": 2e-5, "step_g": 1e-6, "toolface_zero_deg": 0.02,
                "offset_g_per_c": 1e-6, "temp_half_width_c": 5.0},
        "decision": {"limit_inc_deg": 0.2, "limit_tf_deg": 0.5, "agreed_with": "A1"},
        "next": {"next_calibration": date(2027, 6, 1), "agreed_with": "A2"},
    }
)  # fmt: skip
NAMES = re.compile(
    # units, names of tests, methods, files, keys, standards, commands, and words alike in all languages
    r"(?<!\w)tool(?=\s+7\b)|UTC|chi²|simulated|bench-1|joint|conventional|balance|average|least-squares|all|highside"
    r"|calibrate|show|RECORD|recompute|keys|verify|json|trusted|KEYS|FILE|sig|SHA|GUM|JCGM|session|journal|Gtotal|sigma|deg|hPa|dirty|dev"
    r"|[0-9a-f]{8,}|min|Technician|rehearsal|sin|none"
)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Journal, Path, CalibrationRecord]:
    """A session with mistakes, notes and photographs; its journal and its record."""
    finished = Rehearsal(plans.balance_plan([12.0, 40.0]), mistakes=[(2, OperatorMistake.WRONG_TF)]).run()
    path = tmp_path_factory.mktemp("session") / "tool-1_20261125T080000Z.journal"
    entries = [(entry, 1.0 + k) for k, entry in enumerate(finished.entries)]
    entries.append((Noted("remark", "N2: N3"), 900.0))
    for k in range(SHOWN_MAX + 3):
        picture = photographs.drawn_anew(a_photograph(2400, 1800 + 2 * k))
        photographs.keep(path, picture)
        entries.append((Photographed("A3", "T1", picture.sha256, picture.width, picture.height), 901.0 + k))
    path.write_bytes(encode_all(finished.header, entries))
    with (photographs.folder_of(path) / f"{picture.sha256}.jpg").open("ab") as file:
        file.write(b"more")
    journal = read_journal(path.read_bytes())
    record = replay(journal)[2]
    assert record is not None
    return journal, path, record


def documents(done: tuple[Journal, Path, CalibrationRecord], language: str, *, bare: bool = False) -> dict[str, str]:
    """The texts of the documents of a session, as read; `bare`: of the certificate for which nothing was stated too."""
    journal, path, record = done
    poses = pose_set(record.pose_columns, record.request)
    taken = tuple(photographs.photographs(journal, path))[-2:]
    with in_language(language):
        made = {
            "report": session_page(journal, taken),
            "certificate": certificate(of(record, poses, FIELDS, taken)).html(),
        }
        if bare:
            made["nothing stated"] = certificate(of(record, None, CertificateFields(), ())).html()
    return {name: text_of(page) for name, page in made.items()}


@pytest.fixture(scope="module")
def first(done: tuple[Journal, Path, CalibrationRecord]) -> dict[str, str]:
    """In English."""
    return documents(done, "en")


def of(record: CalibrationRecord, poses: PoseSet | None, fields: CertificateFields, taken: tuple[Found, ...]) -> Inputs:
    previous = None if poses is None else record
    return Inputs(record, fields, "2026-11-25T08:00:00Z", previous, poses, poses, taken)


def text_of(page: str) -> str:
    """What is read: without styles, scripts and the points of pictures, plots with their words."""
    assert 'lang="' in page
    page = re.sub(
        r"<style.*?</style>|<script.*?</script>|<metadata.*?</metadata>|base64,[A-Za-z0-9+/=]*", " ", page, flags=re.S
    )
    beside = "\n".join(re.findall(r'(?:alt|aria-label|title)="([^"]*)"', page))
    inside = re.sub(r"<[^>]*>", "\n", re.sub(r"</?(?:b|i|code|span)[^>]*>", "", page))
    return re.sub(r"\s+", " ", html.unescape(f"{inside}\n{beside}"))


def english() -> dict[str, str]:
    """The sentences of the catalogue: from three words on, up to what stands for a value."""
    with (catalogue.LOCALE / "de" / "LC_MESSAGES" / "highside.po").open("rb") as file:
        known = read_po(file, locale="de")
    ids = [one for message in known for one in ([message.id] if isinstance(message.id, str) else message.id)]
    parts = {one: max(re.split(r"%\(\w+\)s", one.replace("%%", "%")), key=len).strip(" ,.;:()") for one in ids}
    return {one: part for one, part in parts.items() if len(part.split()) >= 3}


@pytest.mark.parametrize("language", OTHERS)
def test_no_english_sentence_is_left_and_numbers_are_alike(
    done: tuple[Journal, Path, CalibrationRecord], first: dict[str, str], language: str
) -> None:
    known = english()
    assert len(known) > 500
    for name, text in documents(done, language).items():
        left = {one for one, part in known.items() if part in text and part in first[name]}
        assert left == set(), name
        # the same numbers in the same form: decimal points, no marks between thousands
        assert not re.search(r"\d,\d", re.sub(r"[IT] ?,|\d, ", "", text)), name
        assert re.findall(r"\d+\.\d{3,}", text) == re.findall(r"\d+\.\d{3,}", first[name]), name
    assert sum(1 for part in known.values() if part in first["certificate"]) > 40


@pytest.mark.usefixtures("brackets")
def test_no_word_of_a_document_escapes(done: tuple[Journal, Path, CalibrationRecord]) -> None:
    found = {}
    for name, text in documents(done, "de", bare=True).items():
        words = set(re.findall(r"[^\W\d_]{3,}", NAMES.sub(" ", outside(text, " "))))
        found[name] = words
    assert {name: words for name, words in found.items() if words} == {}


def test_photographs_are_an_annex_of_bounded_size(
    done: tuple[Journal, Path, CalibrationRecord], tmp_path: Path
) -> None:
    journal, path, record = done
    page = certify(record, FIELDS, session=path).sheets().html()
    shown = re.findall(r'data:image/jpeg;base64,([A-Za-z0-9+/=]+)"', page)
    assert len(shown) == SHOWN_MAX and sum(len(one) * 3 // 4 for one in shown) <= BYTES_MAX
    # the file that is kept is named, and what is not that file any more is not shown
    taken = photographs.photographs(journal, path)
    assert taken[0].entry.sha256 in page and "Not shown: photograph" in page
    assert "not shown here: 2." in page
    assert certify(record, FIELDS).sheets().html().count("<img") == 0
    other = Rehearsal(plans.balance_plan([40.0])).run()
    strange = tmp_path / "tool-1_20261125T090000Z.journal"
    strange.write_bytes(encode_all(other.header, [(entry, 1.0) for entry in other.entries]))
    with pytest.raises(InputError, match=r"is not the session that record .* follows from; give the"):
        certify(record, FIELDS, session=strange)


def test_large_photographs_share_the_room(tmp_path: Path, done: tuple[Journal, Path, CalibrationRecord]) -> None:
    """Pictures that do not compress: no more are shown than the bound has room for, and the others are counted."""
    noise = np.random.default_rng(1).integers(0, 256, (1000, 1000, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.jpg", quality=85)
    loud = (tmp_path / "noise.jpg").read_bytes()
    taken = tuple(Found(one.entry, one.at_s, loud) for one in photographs.photographs(done[0], done[1])[:5])
    page = certificate(of(done[2], None, FIELDS, taken)).html()
    shown = page.count("data:image/jpeg")
    assert 1 <= shown < 5 and f"not shown here: {5 - shown}." in page
    assert len(page) < 2 * BYTES_MAX + 1_000_000


def test_a_language_that_there_is_not_is_one_line(done: tuple[Journal, Path, CalibrationRecord]) -> None:
    with pytest.raises(InputError, match="'fr' is no language of a certificate; one of en, de, nb, es"):
        certify(done[2], FIELDS, language="fr")
    page = certify(done[2], FIELDS, language="nb").sheets().html()
    assert '<html lang="nb">' in page and '"side" " " counter(page) " " "av"' in page
