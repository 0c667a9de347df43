"""What a diagnosis says of one recording, and a watch of a tool, is told in the reader's language: every sentence in
their sources is known to the catalogue, which a language in brackets shows, and parameters have names."""

from __future__ import annotations

import ast
import html
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from watch_frames import poses_of_a_good_tool, rows_of_a_well

import highside
from highside.diagnosis.core.result import (
    Claim,
    Curve,
    DiagnosisResult,
    Finding,
    Fit,
    FittedParameter,
    Location,
    NotTestable,
    Remainder,
    Rival,
    Verdict,
)
from highside.diagnosis.table.chain import CELLS as COLUMNS
from highside.physics.effects import all_effects
from highside.physics.places import PLACES
from highside.report import surveys_page, watch_page
from highside.report.diagnosis_hints import CELLS, check_name, hint
from highside.report.diagnosis_page import page_of
from highside.report.parameter_names import OF_EFFECTS, TITLES, parameter_name
from highside.watch.result import WatchResult
from highside.watch.surveys import Detectable
from highside.words import LANGUAGES, catalogue, in_language
from highside.words.marked import in_words
from tests.brackets import outside, written

SOURCES = Path(catalogue.__file__).parents[1] / "diagnosis"
OTHERS = sorted(set(LANGUAGES) - {"en"})
NO_SENTENCES = re.compile(
    # labels of candidates, of functions and of covariates, which are formulas; keys of what is kept
    r"x y|x z|y z|x y z|cos \dT|sin \dT|\|rate\| rate|.*\w_\w+( x .*)?|7 x .*|7 on 7|7 7|7 T|.*_7|toolface harmonic 7"
    r"|direction of approach|sense of rotation|(odd )?power 7|gravity_direction \(\w+ order\)"
    r"|autoregressive per channel"
    r"|per channel( and pose)?|of the magnitude, per reading|the (change of the )?prediction"
    r"|sizes that the table allows|other explanations|rivals of 7|inclination stations left out"
    r"|once more without .*|sets of 7|7\(7\)|7: 7"
    r"|chance drawn from the simulated chain, and a scatter beyond it|only 7|7 7 of 7|inclination station at 7 deg"
)
PARTS = (
    # of sentences that stand as a whole among these, with what is put into them
    "of inclination", "of toolface", "across the plane of the tilt", ", from the other side", "7 deg 7", "are 7 times",
    "ramps of 1 s between standstill and", "7 deg/s at inclination 7 deg", "; leaving out one steady rate at a time: 7",
    ", apart from 7", "rms are left out", ": each pose is averaged from the rows that are there; poses without any: 7",
    " (likewise 7)", "(so do 7)", "deg of toolface", "what is left is taken for errors of the set angles: 7 deg of",
    "(7 with columns n", "magnitudes of still readings", "helps as well7, but has no sure name",
    ", following 7: no effect of the library, a law", "7 frames are lost in 7 gaps (7): ",
)  # fmt: skip


PARTS_OF_WATCH = {
    "the last measurement is", "the last 7 measurements are", "7 far from what was expected: noise that has grown, or a"
    " departure; take two or three rests more, which tell it, and trust no survey before",
    " Near horizontal b_z and S_zz stay out of sight: a still at another inclination is needed.",
    "7 times", "7 7 times",
    # a line of the command and of the log
    "noise of 7 has 7: at rest 7 scatter 7 times what they did (7 mg), since 7 s, in 7 rests",
}  # fmt: skip


def texts(node: ast.AST) -> Iterator[str]:
    """The texts of two words and more below a node, but for what explains the source or is raised."""
    for child in ast.iter_child_nodes(node):
        explains = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
        if explains or isinstance(child, ast.Raise):
            continue
        if isinstance(child, ast.Call) and ast.unparse(child.func).endswith("Error"):
            continue
        text = written(child) if isinstance(child, ast.expr) else None
        if text is not None and sum(any(map(str.isalpha, word)) for word in text.split()) > 1:
            # a factor is put in later; shares that were gained on held-out readings are not shown
            yield text.replace("{factor}", "are 7 times").partition("; gain = ")[0]
        if text is None:
            yield from texts(child)


@pytest.mark.usefixtures("brackets")
def test_every_sentence_of_the_diagnosis_is_known() -> None:
    said = {
        text
        for path in sorted(SOURCES.rglob("*.py"))
        if "policy" not in path.name
        for text in texts(ast.parse(path.read_text(encoding="utf-8")))
    }
    said |= {place.title for place in PLACES.values()}
    assert len(said) > 200
    with in_language("de"):
        unknown = {
            text
            for text in said
            if not NO_SENTENCES.fullmatch(text) and not any(part in text for part in PARTS)
            if re.search(r"[^\W\d_]{3,}", outside(str(hint(text))))
        }
    assert unknown == set(), "list them in words.sentences_of_diagnosis, make words, then translate"


@pytest.mark.usefixtures("brackets")
def test_every_sentence_of_the_watch_is_known() -> None:
    tree = ast.parse((SOURCES.parent / "watch" / "words.py").read_text(encoding="utf-8"))
    said = {text.replace("seen.7", "seen.") for text in texts(tree)} - PARTS_OF_WATCH | {"learning", "holds", "departs"}
    for name in ("watch_keeper", "watch_stage"):
        tree = ast.parse((SOURCES.parent / "service" / f"{name}.py").read_text(encoding="utf-8"))
        said |= {text for text in texts(tree) if text.startswith("began")}
    assert len(said) > 25
    with in_language("de"):
        assert {text for text in said if in_words(text, of="watch")[:1] != "⟦"} == set()
        assert "lang=" in in_words("a reason that nobody has translated", of="watch")


@pytest.mark.parametrize("language", OTHERS)
def test_parameters_have_names(language: str) -> None:
    with in_language(language):
        for effect in all_effects().values():
            names = [parameter_name(effect.id, one.name) for one in effect.parameters]
            assert not {one.name for one in effect.parameters} & set(names), effect.id
            assert len(set(names)) == len(names), effect.id
        assert parameter_name("no effect of ours", "tilt_x") == "tilt_x"
    known = {(effect.id, one.name) for effect in all_effects().values() for one in effect.parameters}
    assert {effect for effect, _ in OF_EFFECTS} <= {effect for effect, _ in known}
    named = {name for _, name in known} | {name.partition("_")[0] for _, name in known}
    assert set(TITLES) <= named, "nothing is called that any more"


@pytest.mark.usefixtures("brackets")
def test_hints_name_effects_by_their_titles_and_leave_none_in_english() -> None:
    for text in (
        "whatever its size, it is absorbed by base_tilt, bias",
        "lever_arm is not the cause, for it is no constant: its size over thirds of the session is 0.5 / 1.0 / 1.5"
        " times that over all",
        "record the temperature, and change it up and down; measure at other inclinations than 30 deg as well",
        "10 g is odd",
    ):
        with in_language("de"):
            told = str(hint(text))
        assert ("lang=" in told) == (text == "10 g is odd"), told
        assert not re.search(r"base_tilt|lever_arm|\bbias\b", outside(told)), told
    assert set(CELLS) == set(COLUMNS)
    with in_language("de"):
        assert check_name("clock_step").startswith("⟦") and check_name("clipping").startswith("⟦")


def test_in_english_ids_become_titles_and_words_stay() -> None:
    assert hint("whatever its size, it is absorbed by base_tilt, bias") == (
        "whatever its size, it is absorbed by levelling error of the bench, bias"
    )
    assert hint("ax follows temp_c") == "ax follows temperature"
    assert "t_s" in hint("the table has no column t_s: when each row was taken is not known")


def full(verdict: Verdict) -> DiagnosisResult:
    """A diagnosis in which every part of its report is there."""
    effects = all_effects()
    parameters = {
        one.name: FittedParameter(2e-4, 1e-5, 1.8e-4, 2.2e-4, one.unit) for one in effects["wobble"].parameters
    }
    named = Claim(
        "wobble", effects["wobble"].story, effects["wobble"].formula, "pose", parameters, 1e-13,
        ("wobble", "base_tilt"),
        (Rival("sag", 25.0),), "measure these poses (inclination, toolface in deg): (30, 90), (45, 180, from the other"
        f" side); otherwise: {effects['wobble'].splitter}", share=0.6, channels=("ax",), stable=False,
    )  # fmt: skip
    law = Claim(
        "law:offset_x_temp", "", None, "thermal", {}, 1e-5, ("law:offset_x_temp", "law:offset_x_time"), (),
        "record another session and vary temperature over the range that matters and over several turns, independently"
        " of time", share=0.3, channels=("ax",), place="offset", depends_on=("temp",), range=((15.0, 40.0),),
        curve=Curve((15.0, 25.0, 40.0), (0.0, 1e-4, -2e-4), (1e-5, 1e-6, 1e-5), "g"), shape_within=0.1,
        readings=("temperature drift of the zero offset (to tell: a ramp up and one down)",),
        confirm="vary temperature over the range that matters", resembles=("thermal_lag",),
    )  # fmt: skip
    hints = (
        "the zero offsets follow a random walk: slow effects cannot be distinguished from it here",
        "what is left is taken for errors of the set angles: 0.01 deg of inclination, 0.02 deg of toolface; in 12 poses"
        " these cannot be distinguished from something that the angles follow: record 40 poses or more, or each pose"
        " several times",
        "something like sag helps as well (so do base_tilt, scale), but has no sure name: other sets without it come"
        " near",
    )
    finding = Finding("clock_step", ("t_s",), 1e-9, "the clock steps by 0.1 s at t = 12.5 s without a frame lost:"
                      " correct the times")  # fmt: skip
    lacking = tuple(
        NotTestable(name, why, f"record the temperature, and change it up and down; {effects[name].splitter}")
        for name, why in (
            ("scale", "whatever its size, it is absorbed by base_tilt, bias"),
            ("tone", "it would show from 0.001 g on, and is not plausible beyond 0.1 g"),
        )
    )
    place = Location(("ax",), "tf_ref_deg", ((0.0, 90.0),), 2, 0.5, 1e-9)
    fit = Fit("g", 3e-4, 4e-5, 5e-5, 3e-4, 0.8, 0.9, 4e-5, "5 contiguous blocks of poses; gain = share removed", 3e-5)
    claims = () if verdict in ("nothing_left_out", "unknown", "bad_data") else (named, law)
    return DiagnosisResult(
        verdict, (place, place)[: len(claims)], claims, not_testable=lacking, intake=(finding,), fit=fit,
        remainder=Remainder((place,), hints, 1e-4, ("sag",)),
    )  # fmt: skip


@pytest.mark.usefixtures("brackets")
@pytest.mark.parametrize("verdict", ["nothing_left_out", "named_plus", "law", "unknown", "bad_data"])
def test_no_word_of_a_report_escapes(verdict: Verdict) -> None:
    with in_language("de"):
        page = page_of(full(verdict), None, "R1")
    assert '<span lang="en">' not in page
    body = re.sub(r"<(style|script|svg)\b.*?</\1>", " ", page, flags=re.S)
    left = outside(html.unescape(re.sub(r"<[^>]*>", "", body)))
    # units, channels, formulas and their symbols, and names of programs
    left = re.sub(
        r"rms|urad|rad|deg|sin|cos|sigma|BIC|highside|wobble|law:\w+|cos kT|sin kT|seed|DIAGNOSIS|R1", " ", left
    )
    assert re.findall(r"[^\W\d_]{3,}", left) == []
    assert not re.search(r"base_tilt|lever_arm|tilt_x|temp_c", left)


@pytest.fixture(scope="module")
def watched() -> list[WatchResult]:
    """What is found of a tool whose z axis steps, and of one of which too little is seen."""
    calibration = highside.calibrate(poses_of_a_good_tool(1), "joint", tool="HS-1", temp_c=25.0)
    steps = rows_of_a_well(3, stands=8, inclinations_deg=(5.0, 50.0), step_g=(2e-3, 0.0, 0.0), step_at=4, rate_hz=12.0)
    rests = rows_of_a_well(6, stands=4, inclinations_deg=(45.0, 45.0))
    few = {name: column for name, column in rests.items() if not name.startswith("g")}
    return [highside.watch_recording(rows, calibration).found for rows in (steps, few)]


NO_WORDS_OF_WATCH = frozenset(("deg", "degC", "mrad", "per", "arm", "tilt", "gravity", "growth"))
"""Units, and names of parameters"""


@pytest.mark.usefixtures("brackets")
def test_no_word_of_the_report_of_a_watch_escapes(watched: list[WatchResult]) -> None:
    assert [found.verdict for found in watched] == ["departs", "learning"]
    seen = Detectable("b_x", "g", 1e-4, None, ("S_xx",))
    for found in (replace(one, cal_id="1") for one in watched):
        with in_language("de"):
            pages = [watch_page.page_of(found, "1", tool="1"), surveys_page.page_of(found, [seen], [], "1", "record")]
        for page in pages:
            body = re.sub(r"<svg.*?</svg>|<style.*?</style>|<script.*?</script>|<[^>]*>", " ", page, flags=re.S)
            escaped = re.findall(r"[^\W\d_]{3,}", outside(html.unescape(body)))
            assert set(escaped) <= NO_WORDS_OF_WATCH
