"""The pages of rotation and of a fleet in the reader's language: remarks and refusals of the fits are known to the
catalogue, and no word of a page escapes it, which a language in brackets shows."""

from __future__ import annotations

import ast
import html
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from highside.fleet.common import Change, Common, LotScores, LotTested, Outlier, Proof, ToolScores, judge
from highside.fleet.page import page_of
from highside.fleet.pooling import Pooled
from highside.fleet.records import page_of_records
from highside.fleet.stability import NAMES, Departure, Point, RandomWalk, Stability, ToolHistory, stability
from highside.fleet.summary import FleetSummary, LotView
from highside.report.rotation_page import compare_page, fit_page
from highside.rotation import Compensation, Samples, Validity
from highside.rotation.compare import CurveComparison, compare
from highside.rotation.curve import CurveMethod
from highside.rotation.direction import direction_difference
from highside.rotation.fit import fit
from highside.words import catalogue, in_language, told
from tests.brackets import outside, written

SOURCES = Path(catalogue.__file__).parents[1] / "rotation"
SAYING = ("samples", "linear", "fourier", "network", "fit", "self_reference", "self_turntable", "turntable")
"""Modules whose remarks and refusals a page or a command shows"""
NOT_SHOWN = re.compile(
    # of parts, which stand as a whole below
    r"7 \(7\) was taken; .*"
)
"""What no reader sees as it stands"""


def said_by(path: Path) -> set[str]:
    """Texts that are appended to remarks, named as one, refused with, or returned as words."""
    found: list[ast.expr] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and re.fullmatch(r"remarks\.append|Refused", ast.unparse(node.func)):
            found += node.args[:1]
        elif isinstance(node, ast.Assign) and re.fullmatch(r"remark|why|seen|advice", ast.unparse(node.targets[0])):
            found += [node.value.body, node.value.orelse] if isinstance(node.value, ast.IfExp) else [node.value]
        elif isinstance(node, ast.Return) and path.stem in ("samples", "fit") and node.value is not None:
            found += node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
    return {text for node in found if (text := written(node)) and " " in text}


@pytest.mark.usefixtures("brackets")
def test_every_remark_and_refusal_is_known() -> None:
    said = {text for name in SAYING for text in said_by(SOURCES / f"{name}.py")}
    said = {text for text in said if not NOT_SHOWN.fullmatch(text)}
    assert len(said) > 15
    said = {text.replace("is left7", "is left (and of 7)") for text in said}
    taken = "the highest order of the usual range (9) was taken; orders to 18 fit these rows better, but not turns that"
    said.add(f"{taken} the fit did not use (0.5 against 0.4 rms): these rows are too few to predict it")
    said.add("order 18 was taken, beyond the usual range of 9; turns not used by the fit: 0.5 rms against 0.6")
    with in_language("de"):
        unknown = {text for text in said if re.search(r"[^\W\d_]{3,}", outside(told(text, "rotation")))}
    assert unknown == set(), "list them in words.sentences_of_rotation, make words, then translate"


def rows_of_a_turn(seed: int, *, gap: bool = True) -> Samples:
    """Three turns with two harmonics and noise; a sector without rows."""
    rng = np.random.default_rng(seed)
    theta = np.linspace(0.0, 6.0 * np.pi, 900, endpoint=False)
    kept = (np.mod(theta, 2.0 * np.pi) > 0.9) if gap else np.full(theta.size, fill_value=True)
    error = 2.0 * np.sin(theta) + 0.5 * np.cos(2.0 * theta) + 0.1 * rng.standard_normal(theta.size)
    return Samples.build(theta[kept], error[kept])


def escaped(page: str) -> set[str]:
    """Words outside of all brackets, those of the plots too."""
    assert '<html lang="de">' in page and '<span lang="en">' not in page
    body = re.sub(r"<style.*?</style>|<script.*?</script>|<metadata.*?</metadata>|<[^>]*>", " ", page, flags=re.S)
    return set(re.findall(r"[^\W\d_]{3,}", outside(html.unescape(body), " ")))


@pytest.mark.usefixtures("brackets")
def test_no_word_of_the_pages_of_rotation_escapes() -> None:
    samples = rows_of_a_turn(1)
    comparison = compare(samples, (CurveMethod.SINE, CurveMethod.POLYNOMIAL9, CurveMethod.AUTO))
    why = "the rotor stood at too few different angles for a curve over the turn"
    comparison = CurveComparison(comparison.scores, {CurveMethod.HARMONICS2: why})
    curve = comparison.scores[CurveMethod.AUTO].curve
    assert any("is a guess in there" in remark for remark in curve.remarks)
    curve = replace(curve, remarks=(*curve.remarks, "a remark of which nobody knows"))
    made = Compensation({"roll": curve, "toolface": curve}, Validity(30.0, 1.0, 2.0), "R1", "0" * 64)
    with in_language("de"):
        pages = [
            compare_page("R1", {"pitch": (samples, comparison)}),
            fit_page(made, dict.fromkeys(made.curves, samples)),
        ]
    strange = '<span lang="en">a remark of which nobody knows</span>'
    assert pages[1].count(strange) == 2, "said to be English, for a screen reader"
    for page in pages:
        assert escaped(page.replace(strange, "").replace(made.id, "")) <= {"deg", "rms"}


def pooled(values: list[float]) -> Pooled:
    size = np.array(values)
    return Pooled(size, np.diag(np.square(size / 9.0)), np.abs(size) / 5.0, 7)


def a_fleet() -> FleetSummary:
    """A lot with something in common that changes, a law, a tool that stands out; one with too few tools."""
    one = Common(
        "7", "wobble[k=1]", ("ck", "sk"), pooled([1e-4, 2e-4]), 1e-6, ("wobble[k=1]", "law:offset_x_temp[7]"),
        Proof(12.0, 3.0), Change("7", pooled([1e-4, 1e-4]), pooled([2e-4, 2e-4]), 1e-5),
    )  # fmt: skip
    (few,) = judge([LotScores("8", (), (), (ToolScores("1", np.zeros(0), np.zeros((0, 0))),))], [])
    outlier = Outlier("7", "1", "bias", ("bias",), 1e-5, np.array([1e-4]))
    view = LotView(("1", "2"), np.array([[1e-4, 2e-4]] * 2), np.full((2, 2), 1e-5), ("rad", "rad"))
    return FleetSummary(
        "7", 9, 7, {"named": 8, "error": 1}, (("8", "sort the rows by time"),), 2,
        (LotTested("7", 7, (one,), (outlier,)), few),
        {"wobble[k=1]": ("rad", "rad"), "bias": ("g",)}, {"wobble[k=1]": ("ck", "sk"), "bias": ("b_x",)},
        {("7", "wobble[k=1]"): view},
    )  # fmt: skip


@pytest.mark.usefixtures("brackets")
def test_no_word_of_the_pages_of_a_fleet_escapes() -> None:
    found = a_fleet()
    with in_language("de"):
        pages = [page_of(found, "7"), page_of(replace(found, lots=found.lots[1:]), "7")]
    points = [Point("7", f"{k}", 1.7e9 + 1e7 * k, np.zeros(len(NAMES)), 1e-10 * np.eye(len(NAMES))) for k in range(3)]
    moved = Departure("1", points[1].at_s, NAMES[0], 1e-4, 5.0, 1e-6)
    whole = Stability(
        (RandomWalk(NAMES[0], 1e-6, 5e-7, 2e-6),), (ToolHistory("7", tuple(points), (moved,), points[2].at_s),), 7, 0.1
    )
    none = stability(points[:1], 0.1)
    with in_language("de"):
        pages += [page_of_records(whole, {"7": "sort the rows by time"}, "7"), page_of_records(none, {}, "7")]
    for page in pages:
        assert escaped(page) <= {"deg", "rad", "degC"}


@pytest.mark.usefixtures("brackets")
def test_what_depends_on_the_direction_is_known_to_the_terminal() -> None:
    rng = np.random.default_rng(3)
    angles = np.concatenate([np.linspace(0.0, 8.0 * np.pi, 600), np.linspace(8.0 * np.pi, 0.0, 600)])
    noise = 0.01 * rng.standard_normal(angles.size)
    ways = np.repeat([0.4, -0.4], 600)
    for size in (1.0, 0.0):
        samples = Samples.build(np.mod(angles, 2.0 * np.pi), np.sin(angles) + size * ways + noise)
        found = direction_difference(samples, fit(samples, CurveMethod.SINE))
        assert found is not None
        assert found.found == bool(size)
        with in_language("de"):
            assert not re.search(r"[^\W\d_]{3,}", outside(told(found.sentence, "rotation"))), found.sentence
