"""The certificate as it is printed, by a real browser and by `-o FILE.pdf`: every page of it is read again."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from inside import highside_inside
from pypdf import PdfReader

from highside.errors import InputError
from highside.report.document import Sheets
from tests.few_poses import model_of_few_poses

FURTHER = pytest.mark.further
CHROMIUM = shutil.which("chromium")
HIGHSIDE = Path(sys.executable).parent / "highside"


def highside(*arguments: object, check: int = 0) -> subprocess.CompletedProcess[str]:
    done = highside_inside(*arguments)
    assert done.returncode == check, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done


def printed(page: Path) -> list[str]:
    """The text of each page of the PDF that the browser prints."""
    assert CHROMIUM is not None, "the tests need the browser chromium"
    pdf = page.with_suffix(".pdf")
    subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={pdf}",
         f"--user-data-dir={page.parent / 'profile'}", page.as_uri()],
        capture_output=True, check=True, timeout=120,
    )  # fmt: skip
    return [sheet.extract_text() for sheet in PdfReader(pdf).pages]


def assert_numbered(pages: list[str]) -> None:
    for k, text in enumerate(pages, 1):
        assert re.search(rf"page {k} of {len(pages)}(?!\d)", text), f"page {k}"
        assert "relates only to the item" in text
        body = re.sub(r"page \d+ of \d+|This certi\S+ relates[^.]*\.|Calibration certi\S+ \S+ tool \S+", "", text)
        assert len(body.split()) > 5, f"page {k} is empty"


def outside(path: Path) -> list[tuple[int, str]]:
    """Words of a PDF that lie beyond the margins of their page, or between its text and the head or the foot."""
    millimetre = 72 / 25.4
    found = []
    for number, page in enumerate(PdfReader(path).pages, 1):
        top = float(page.mediabox.height)

        def visit(
            text: str, cm: list[float], tm: list[float], *_: object, number: int = number, top: float = top
        ) -> None:
            if text.strip():
                x, y = (cm[0] * tm[4] + cm[2] * tm[5] + cm[4], cm[1] * tm[4] + cm[3] * tm[5] + cm[5])
                side = 15 * millimetre <= x <= 195 * millimetre
                body = 17 * millimetre <= y <= top - 20 * millimetre
                frame = 8 * millimetre <= y <= 15.5 * millimetre or top - 20 * millimetre <= y <= top - 12 * millimetre
                if not (side and (body or frame)):
                    found.append((number, text.strip()[:40]))

        page.extract_text(visitor_text=visit)
    return found


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two sessions of one tool (1.csv, 2.csv), and the records of both."""
    folder = tmp_path_factory.mktemp("certificate")
    # a certificate says whether bench or sensor is to blame, by a diagnosis, which of all 44 poses takes long
    model = model_of_few_poses(folder / "model.toml", {"inclinations_deg": "[5.004, 30.006, 45.0, 75.006, 90.0]"})
    for seed in (1, 2):
        highside(
            "simulate", model, "-o", folder / f"{seed}.csv.gz",
            "--poses", folder / f"{seed}.csv", "--seed", seed,
        )  # fmt: skip
        highside(
            "calibrate", "solve", folder / f"{seed}.csv", "--method", "joint", "--tool", "tool-7", "--serial", "42",
            "--bench", "bench 1", "--operator", "A. Operator", "--gravity-mps2", 9.8123, "-o", folder / f"{seed}.json",
        )  # fmt: skip
    # a short session: certificates of it are quick
    header, *rows = (folder / "2.csv").read_text().splitlines()
    few = [row for row in rows if round(float(row.split(",")[header.split(",").index("inc_ref_deg")])) in (5, 45, 75)]
    assert len(few) == 12
    (folder / "s.csv").write_text("\n".join([header, *few]) + "\n")
    highside("calibrate", "solve", folder / "s.csv", "--method", "joint", "--tool", "tool-7", "-o", folder / "s.json")
    return folder


def test_the_printed_certificate_says_all_it_must(records: Path, project_root: Path) -> None:
    page = records / "full.html"
    done = highside(
        "calibrate", "certificate", records / "2.json", "--fields", project_root / "config/certificate.toml",
        "--previous", records / "1.json", "-o", page,
    )  # fmt: skip
    assert "As found: Pass" in done.stdout and "As left: Pass" in done.stdout
    pages = printed(page)
    assert_numbered(pages)
    text = " ".join(" ".join(pages).split())
    record = json.loads((records / "2.json").read_text())
    for said in (
        "2026-0117", "tool-7", "A. Operator", "bench 1", "Certificate", "T-0000", "TH-0000", "9.81230",
        "joint estimate of sensor and bench", "k = 2", "GUM", "Assumptions", "Uncertainty budget", "Decision rule",
        "As found (record", "As left (this record", "no independent proof", "cannot prove", "Methods side by side",
        "Bench or sensor", "balance", "conventional", record["raw"]["sha256"], record["id"], "End of certificate",
    ):  # fmt: skip
        assert said.lower() in text.lower(), said
    assert "next calibration" not in text.lower(), "nobody agreed to one"
    # every pose with its settings
    for name, inc in zip(record["result"]["poses"]["ids"], record["pose_table"]["inc_ref_deg"], strict=True):
        assert re.search(rf"\b{name} {inc:.3f} ", text)
    # the combined uncertainty is the root sum of squares of what stands above it, T at 45 deg included
    budget = text[text.index("At I = 45°") : text.index("At I = 90°")]
    rows = [list(map(float, m)) for m in re.findall(r"(?:normal|rectangular) \S+ (\S+) (\S+)", budget)]
    combined = [float(v) for v in re.search(r"combined standard uncertainty (\S+) (\S+)", budget).groups()]  # type: ignore[union-attr]
    assert len(rows) >= 6
    np.testing.assert_allclose(np.sqrt((np.array(rows) ** 2).sum(axis=0)), combined, rtol=0.06)


def test_what_was_not_stated_is_not_made_up(records: Path) -> None:
    page = records / "bare.html"
    highside("calibrate", "certificate", records / "s.json", "-o", page)
    pages = printed(page)
    assert_numbered(pages)
    text = " ".join(" ".join(pages).split())
    assert text.count("not stated") >= 5
    assert "no statement of conformity" in text
    assert "its scatter was not stated" in text
    assert "next calibration" not in text.lower()


def test_a_next_date_needs_the_customers_consent(records: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.toml"
    alone.write_text("[next]\nnext_calibration = 2027-11-30\n")
    done = highside(
        "calibrate", "certificate", records / "2.json", "--fields", alone, "-o", tmp_path / "x.html", check=2
    )
    assert "agreed_with" in done.stderr and done.stderr.count("\n") == 1
    agreed = tmp_path / "agreed.toml"
    agreed.write_text('[next]\nnext_calibration = 2027-11-30\nagreed_with = "B. Customer"\n')
    highside("calibrate", "certificate", records / "s.json", "--fields", agreed, "-o", tmp_path / "x.html")
    assert "2027-11-30, as agreed with B. Customer" in (tmp_path / "x.html").read_text()


def test_a_local_calibration_says_where_it_does_not_hold(records: Path) -> None:
    highside("calibrate", "solve", records / "s.csv", "--method", "balance", "-o", records / "b.json")
    page = records / "balance.html"
    highside("calibrate", "certificate", records / "b.json", "-o", page)
    pages = printed(page)
    assert_numbered(pages)
    text = " ".join(" ".join(pages).split())
    assert "not calibrated" in text
    assert "absorbs every error common to the four poses of an inclination" in text


def test_a_record_of_another_tool_is_not_what_was_found(records: Path) -> None:
    highside(
        "calibrate", "solve", records / "s.csv", "--method", "balance", "--tool", "other", "-o", records / "o.json"
    )
    done = highside(
        "calibrate",
        "certificate",
        records / "2.json",
        "--previous",
        records / "o.json",
        "-o",
        records / "x.html",
        check=1,
    )
    assert "wrong_tool" in done.stderr
    assert not (records / "x.html").exists()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=FURTHER)])
def test_words_of_any_length_never_run_over_a_sheet(tmp_path: Path, seed: int) -> None:
    """Long remarks, wide words, long tables: numbered pages, every word printed within the margins of one."""
    rng = np.random.default_rng(seed)
    out = Sheets("Test", ("left", "right"), "This certificate relates only to the item described in it.")
    marks = []
    for k in range(24):
        mark = f"MARK{k:03d}"
        marks.append(mark)
        words = " ".join(rng.choice(["WWWWMMMM", "a", "calibration", "0.12345", "iiii"], rng.integers(1, 250)))
        match k % 4:
            case 0:
                out.heading(f"Heading {k}")
                out.paragraph(f"{words} {mark}")
            case 1:
                out.bullets([f"{words} {mark}", "W" * 300])
            case 2:
                out.facts([("label", words[:400]), (mark, "value")])
            case _:
                rows = [
                    [str(i), words[: int(rng.integers(1, 120))], f"{i / 7:.4f}"] for i in range(rng.integers(1, 60))
                ]
                out.table(["n", "words", "value"], [*rows, [mark, "", ""]], caption="Caption", words=(1,))
    page, pdf = tmp_path / "sheets.html", tmp_path / "ours.pdf"
    page.write_text(out.html())
    data, count = out.pdf()
    pdf.write_bytes(data)
    ours = [sheet.extract_text() for sheet in PdfReader(pdf).pages]
    assert len(ours) == count
    for pages in (printed(page), ours):
        assert_numbered(pages)
        text = "".join(pages)
        assert [mark for mark in marks if mark not in text] == []
    assert outside(pdf) == []


def test_the_certificate_as_pdf(records: Path, project_root: Path) -> None:
    path = records / "by-command.pdf"
    done = highside(
        "calibrate", "certificate", records / "2.json", "--fields", project_root / "config/certificate.toml",
        "--previous", records / "1.json", "-o", path,
    )  # fmt: skip
    pages = [sheet.extract_text() for sheet in PdfReader(path).pages]
    assert f"{len(pages)} pages" in done.stdout
    assert_numbered(pages)
    text = " ".join(" ".join(pages).split())
    record = json.loads((records / "2.json").read_text())
    assert record["id"] in text and "End of certificate" in text
    for name, inc in zip(record["result"]["poses"]["ids"], record["pose_table"]["inc_ref_deg"], strict=True):
        assert re.search(rf"\b{name} {inc:.3f} ", text), "numbers are not broken"
    # tables and figures are whole: a heading never ends a page
    for page in pages:
        lines = [line for line in page.splitlines() if not re.match(r"page \d+ of|This certificate relates", line)]
        assert lines[-1] not in ("Result", "Uncertainty budget", "Method", "Poses and residuals", "Remarks", "Identity")


def test_without_what_prints_it_html_is_offered_and_nothing_is_written(records: Path, tmp_path: Path) -> None:
    """WeasyPrint that is not there, and WeasyPrint without the library below it."""
    for fault, says in (("ImportError('no')", "highside[pdf]"), ("OSError('cannot load library')", "libpangoft2")):
        folder = tmp_path / says
        folder.mkdir()
        (folder / "weasyprint.py").write_text(f"raise {fault}\n")
        done = subprocess.run(
            [HIGHSIDE, "calibrate", "certificate", records / "s.json", "-o", folder / "x.pdf"],
            capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": str(folder)},
        )  # fmt: skip
        assert done.returncode == 2
        assert says in done.stderr and "HTML" in done.stderr and done.stderr.count("\n") == 1
        assert not (folder / "x.pdf").exists()


def test_names_from_outside_are_words_and_never_markup(tmp_path: Path) -> None:
    evil = '</style><script>alert(1)</script> "; } * { display: none } \\ ü & <b>'
    out = Sheets(evil, (evil, evil), evil)
    out.title(evil)
    out.facts([(evil, evil)])
    out.table([evil], [[evil]], evil, words=(0,))
    out.code(evil, evil)
    html = out.html()
    assert "<script" not in html and "<b>" not in html
    assert html.count("</style>") == 1
    style = html[html.index("<style>") : html.index("</style>")]
    assert "alert" in style and "{ display: none }" not in style, "a word of the head, and no rule"
    data, _ = out.pdf()
    (tmp_path / "evil.pdf").write_bytes(data)
    (page,) = PdfReader(tmp_path / "evil.pdf").pages
    text = page.extract_text()
    assert text.count("<script>alert(1)</script>") >= 6, "head and foot say it as well"


def test_a_fields_file_that_is_wrong_is_named(tmp_path: Path) -> None:
    from highside.config.certificate import load_certificate_fields

    wrong = tmp_path / "wrong.toml"
    wrong.write_text('[issue]\nlaboratry = "x"\n')
    with pytest.raises(InputError, match="laborat"):
        load_certificate_fields(wrong)
    # its square is beyond all numbers
    wrong.write_text("[bench]\ninc_expanded_deg = 1e200\n[environment]\ntemp_c = [22.5, 1e300]\n")
    with pytest.raises(InputError, match=r"bench.inc_expanded_deg: .*environment.temp_c.1: "):
        load_certificate_fields(wrong)
