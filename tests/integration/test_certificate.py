"""The certificate as it is printed: a real browser makes the PDF, and every page of it is read again."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pypdf import PdfReader

from highside.errors import InputError
from highside.report.sheets import Sheets

CHROMIUM = shutil.which("chromium")
HIGHSIDE = Path(sys.executable).parent / "highside"


def highside(*arguments: object, check: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([HIGHSIDE, *map(str, arguments)], capture_output=True, text=True, check=False)
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


def assert_numbered(pages: list[str], html: str) -> None:
    count = html.count('<section class="sheet"')
    assert len(pages) == count, "a sheet is a page: nothing runs over"
    for k, text in enumerate(pages, 1):
        assert re.search(rf"page {k} of {count}\b", text), f"page {k}"
        assert "relates only to the item" in text


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """A folder with two sessions of one tool (1.csv, 2.csv), and the records of both."""
    folder = tmp_path_factory.mktemp("certificate")
    for seed in (1, 2):
        highside(
            "simulate", project_root / "config/model-bench.toml", "-o", folder / f"{seed}.csv.gz",
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
    assert "as found: Pass" in done.stdout and "as left: Pass" in done.stdout
    html, pages = page.read_text(), printed(page)
    assert_numbered(pages, html)
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
    assert_numbered(pages, page.read_text())
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
    assert_numbered(pages, page.read_text())
    text = " ".join(" ".join(pages).split())
    assert "not calibrated" in text
    assert "takes up every error common to the poses of a ring" in text


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


@pytest.mark.parametrize("seed", range(2))
def test_words_of_any_length_never_run_over_a_sheet(tmp_path: Path, seed: int) -> None:
    """Long remarks, wide words, long tables: a sheet stays one page, and every word is printed."""
    rng = np.random.default_rng(seed)
    out = Sheets("Test", ("left", "right"), "This certificate relates only to the item described in it.")
    marks = []
    for k in range(40):
        mark = f"MARK{k:03d}"
        marks.append(mark)
        words = " ".join(rng.choice(["WWWWMMMM", "a", "calibration", "0.12345", "iiii"], rng.integers(1, 250)))
        match k % 4:
            case 0:
                out.heading(f"Heading {k}")
                out.paragraph(f"{words} {mark}")
            case 1:
                out.bullets([f"{words} {mark}"])
            case 2:
                out.pairs([("label", words[:400]), (mark, "value")])
            case _:
                rows = [
                    [str(i), words[: int(rng.integers(1, 120))], f"{i / 7:.4f}"] for i in range(rng.integers(1, 60))
                ]
                out.table(["n", "words", "value"], [*rows, [mark, "", ""]], (20, 60, 20), caption="Caption", words=(1,))
    page = tmp_path / "sheets.html"
    page.write_text(out.html())
    pages = printed(page)
    assert_numbered(pages, page.read_text())
    text = "".join(pages)
    assert [mark for mark in marks if mark not in text] == []
    # nothing is hidden behind the foot of a sheet
    assert tall_sheets(page) == []


def tall_sheets(page: Path) -> list[int]:
    """Numbers of the sheets whose content reaches below the line of the footer."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page()
        tab.goto(page.as_uri())
        found = tab.evaluate(
            """() => {
                 const box = (s, name) => s.querySelector(name).getBoundingClientRect();
                 return [...document.querySelectorAll('.sheet')]
                   .map((s, i) => box(s, 'main').bottom > box(s, 'footer').top ? i + 1 : 0).filter(n => n)
               }"""
        )
        browser.close()
    return list(found)


def test_a_fields_file_that_is_wrong_is_named(tmp_path: Path) -> None:
    from highside.config.certificate import load_certificate_fields

    wrong = tmp_path / "wrong.toml"
    wrong.write_text('[issue]\nlaboratry = "x"\n')
    with pytest.raises(InputError, match="laborat"):
        load_certificate_fields(wrong)
