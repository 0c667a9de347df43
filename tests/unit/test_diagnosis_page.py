"""The report of a diagnosis: drawn along what its intervals are told in, sizes with the digits they have."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.problem import ReportData, parts_of
from highside.diagnosis.core.result import (
    Claim,
    Curve,
    Detectable,
    DiagnosisResult,
    Fit,
    FittedParameter,
    Location,
    NotTestable,
    Remainder,
)
from highside.diagnosis.rows.noise import plain
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.table.chain import CELLS
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.plan import RotationPlan, Session, Site
from highside.report import diagnosis_figures
from highside.report.diagnosis_figures import over_time, residuals
from highside.report.diagnosis_page import _places, page_of
from highside.report.diagnosis_words import axis_name, proof, rounded, shown, sizes, verdict_words
from highside.report.drawing import Line, Panel, Points
from highside.report.misfit_steps import steps_of


def report_data(before: np.ndarray) -> ReportData:
    rates = tuple(2 * np.pi * np.array([-2.0, 0.5, 2.0]))
    state = Session(RotationPlan(62.0, rates, 8.0, 1.0, 50.0), Site()).rows().state
    rng = np.random.default_rng(1)
    noise = 1e-5 * rng.standard_normal((3, state.n))
    signal = np.array([before, before, 0 * before])[:, None] * np.cos(state.tf_rad) * state.rotor_rate_radps
    return ReportData(RotationSession(noise, state), noise + signal, noise)


@pytest.mark.parametrize(
    ("covariate", "label"),
    [
        ("rotor_rate_dps x tf_ref_deg", "rate of rotation, deg/s"),
        ("tf_ref_deg", "toolface, deg"),
        ("t_s x tf_ref_deg", "time, s"),
        ("direction x tf_ref_deg", "toolface, deg"),
    ],
)
def test_a_residual_is_drawn_along_what_its_intervals_are_reported_in(covariate: str, label: str) -> None:
    place = Location(("ax", "ay"), covariate, ((-720.0, -360.0),), None, 1.0, 1e-9)
    pictures = residuals(report_data(np.array(1e-5)), place)
    assert [p.panels[0][0].x_label for p in pictures] == [label, label]


def test_what_cancels_in_the_mean_is_drawn_as_rms() -> None:
    place = Location(("ax",), "rotor_rate_dps x tf_ref_deg", ((360.0, 720.0),), None, 1.0, 1e-9)
    panel = residuals(report_data(np.array(1e-5)), place)[0].panels[0][0]
    assert [mark.label for mark in panel.labelled()] == ["before (rms)"]
    rms = lines_of(panel)[0].y
    assert rms[0] > 3 * rms[len(rms) // 2]


def test_of_an_effect_its_own_residual_is_drawn_and_what_is_left_in_units_of_the_noise() -> None:
    """A lever arm of 100 mg must not be seen along temperature, nor hide what is left."""
    one = report_data(np.array(0.0))
    state, n = one.session.state, one.before.shape[1]
    along = np.linspace(20.0, 40.0, n)
    large = 0.1 * np.sign(np.sin(np.arange(n) / 50.0)) * np.ones((3, 1))
    small = 1e-4 * (along - 30.0) / 10.0 * np.ones((3, 1))
    both = replace(
        one, before=one.after + large + small, parts={"lever_arm": large, "temperature_bias": small},
        covariates={"temp_c": along}, sigma=(1e-5, 1e-5, 1e-5), recorded=one.after + large + small,
    )  # fmt: skip
    place = Location(("ax",), "temp_c", ((20.0, 40.0),), None, 1.0, 1e-9)
    above, left = (row[0] for row in residuals(both, place, "temperature_bias")[0].panels)
    assert "sigma" in left.y_label
    assert np.ptp(points_of(above)[0].y) < 400, "ug: the steps of 100,000 ug are taken off"
    fitted = lines_of(above)[-1].y
    assert lines_of(above)[-1].label == "as fitted"
    assert fitted[0] == pytest.approx(-100, abs=3) and fitted[-1] == pytest.approx(100, abs=3)
    assert 0.5 < np.std(points_of(left)[0].y) < 2.0, "noise is one sigma"
    top, middle, whole = (row[0] for row in over_time(both).panels)
    assert [mark.label for mark in top.labelled()] == ["recorded", "simulated before", "simulated after"]
    recorded, before, after = (mark.y for mark in top.labelled())
    assert np.std(recorded - after) < 3e-5 < np.std(recorded - before)
    assert "sigma" in middle.y_label and "sigma" in whole.y_label
    assert state.n == n


def lines_of(panel: Panel) -> list[Line]:
    return [mark for mark in panel.marks if isinstance(mark, Line)]


def points_of(panel: Panel) -> list[Points]:
    return [mark for mark in panel.marks if isinstance(mark, Points)]


def claim_of(effect: str) -> Claim:
    return Claim(effect, "", "", "kinematic", {}, 0.0, (effect,), (), "none needed")


def test_every_column_of_an_error_table_has_a_panel() -> None:
    assert diagnosis_figures.CELLS == CELLS


def test_no_picture_stands_twice_on_the_page() -> None:
    one = report_data(np.array(1e-5))
    place = Location(("ax", "ay"), "tf_ref_deg", ((0.0, 90.0),), 1, 0.5, 1e-9)
    twice = DiagnosisResult("partial", (place, replace(place, share_of_misfit=0.3)))
    assert len(_places(twice, one)) == 1
    claims = (claim_of("lever_arm"), claim_of("time_offset"))
    named = DiagnosisResult("named", (place, place), claims)
    parts = {"lever_arm": one.before - one.after, "time_offset": 0 * one.before}
    assert [effect for _, effect in _places(named, replace(one, parts=parts))] == ["lever_arm", "time_offset"]
    assert len(_places(named, one)) == 1, "where the parts are not known the two are one picture"
    drawn = re.findall(r"<figure>.*?</figure>", page_of(named, replace(one, parts=parts), "rec.csv"), re.S)
    assert len(drawn) == len(set(drawn)) == 4


def test_the_steps_of_the_misfit_go_down_from_the_simulation_to_what_is_left() -> None:
    """Noise alone has no bar; claims share out what is explained in proportion to what each does."""
    noise = report_data(np.array(0.0))
    alone = steps_of(replace(noise, sigma=(1e-5,) * 3))
    assert alone.names == () and alone.levels[0] < 2 * alone.floor
    t = np.linspace(0.0, 1.0, noise.before.shape[1]) * np.ones((3, 1))
    large, small = 3e-5 * np.sin(40 * t), 1e-5 * np.cos(300 * t)
    parts = {"temperature_bias": small, "lever_arm": large}
    steps = steps_of(replace(noise, before=noise.after + large + small, parts=parts, sigma=(1e-5,) * 3))
    assert steps.names == ("lever_arm", "temperature_bias") and steps.unit == "ug"
    assert steps.shares == pytest.approx((0.9, 0.1), abs=0.02)
    assert steps.levels == pytest.approx((1e6 * np.sqrt(5e-10), 1e6 * np.sqrt(0.5e-10), 0.0), rel=0.06, abs=2.0)
    assert steps.left <= 2 * steps.floor


def test_noise_that_remembers_is_as_large_as_a_row_and_tells_less_of_its_size() -> None:
    """Of AR(1) noise a row has 1 / (1 - a^2) of the variance of an innovation, and (1 + a^2) / (1 - a^2) rows tell of
    it what one would by itself. Noise alone is then beyond its floor in 5 % of recordings: here in 15 of 200 at
    most, as 95 % of sets of draws would have it (binomial)."""
    coefficient, n = 0.6, 3000
    noise = replace(plain(np.full(3, 1e-5), n), filters=(np.array([1.0, -coefficient]),) * 3)
    assert noise.row_sigma == pytest.approx(np.full(3, 1e-5 / np.sqrt(1 - coefficient**2)))
    assert noise.rows_per_independent == pytest.approx((1 + coefficient**2) / (1 - coefficient**2))
    rng = np.random.default_rng(5)
    beyond = 0
    for _ in range(200):
        drawn = lfilter([1e-5], [1.0, -coefficient], rng.standard_normal((3, n + 100)))[:, 100:]
        one = ReportData(
            report_data(np.array(0.0)).session, drawn, drawn, rows_per_independent=noise.rows_per_independent
        )
        steps = steps_of(replace(one, sigma=tuple(float(s) for s in noise.row_sigma)))
        beyond += steps.left > steps.floor
    assert 0 < beyond <= 15


def test_channels_of_unlike_units_are_summed_in_units_of_their_noise() -> None:
    one = report_data(np.array(0.0))
    steps = steps_of(replace(one, channels=("ax", "yaw", "gx"), units=("g", "deg", "rad/s"), sigma=(1e-5,) * 3))
    assert steps.unit == "times the noise of one row"


def test_a_law_stands_on_the_page_in_words_with_its_curve_and_band() -> None:
    one = report_data(np.array(1e-5))
    curve = Curve((15.0, 25.0, 40.0), (0.0, 1e-4, -2e-4), (1e-5, 1e-6, 1e-5), "g")
    law = replace(
        claim_of("law:ax_temp"), place="offset", channels=("ax",), depends_on=("temp",), curve=curve,
        range=((15.0, 40.0),), share=0.9, readings=("a loose lead",), confirm="vary temperature", shape_within=0.1,
    )  # fmt: skip
    page = page_of(DiagnosisResult("law", claims=(law,)), one, "rec.csv")
    assert "<h1>The simulation omits an offset of ax that follows temperature (90%" in page
    assert "-200 ug (+-20) at its largest: a curve, over temperature 15 to 40 C" in page
    tied = ("law:offset_x_temp", "law:offset_x_time", "law:offset_x_inc_x_time")
    page_of_tied = page_of(DiagnosisResult("law", claims=(replace(law, equivalence_class=tied),)), one, "rec.csv")
    assert (
        "<h1>The simulation omits an offset of ax that follows temperature, or the time of the session (90%"
        in page_of_tied
    )
    assert "a loose lead" in page and "Another session confirms or refutes it: vary temperature." in page
    assert "law:ax_temp" not in page.split("<details>")[0], "a name is in words before what is folded away"


def test_the_proof_has_one_unit_of_averaging_in_a_sentence() -> None:
    fit = Fit("g", 3e-2, 8.1e-5, 3e-3, 8.7e-6, 0.99, 0.999, 8.5e-6, "means of 92 rows", row_noise=8.2e-5)
    rows, means = proof(fit).split(" On readings ")
    assert "misfit of one row 30 mg before, 81 ug after; noise of one row 82 ug." in rows.lower()
    assert "8.5 ug" not in rows, "the noise of a mean of 92 rows is no measure for a row"
    assert "8.7 ug after, noise 8.5 ug of such means" in means
    plain = proof(replace(fit, row_noise=None))
    assert "noise 8.5 ug." in plain


def test_what_each_effect_does_adds_up_to_what_the_claims_do() -> None:
    """To first order: the parts are those of the fitted model, one effect left out at a time."""
    state = Session(RotationPlan(62.0, tuple(2 * np.pi * np.array([-2.0, 2.0])), 4.0, 1.0, 50.0), Site()).rows().state
    base = ForwardModel.of({"bias": {"b_x": 0.0, "b_y": 0.0, "b_z": 0.0}})
    names = {e: [p.name for p in all_effects()[e].parameters] for e in ("lever_arm", "time_offset")}
    full = base.with_effects(
        {"lever_arm": {names["lever_arm"][0]: 1e-3}, "time_offset": {names["time_offset"][0]: 1e-4}}
    )
    seen = Observed(state, full.predict(state))
    fit = JointFit({"lever_arm": {}, "time_offset": {}}, seen.residual(full), (), model=full)
    parts = parts_of(base, fit, seen)
    total = seen.residual(base) - fit.residual
    assert np.abs(total).max() > 1e-4
    assert np.allclose(parts["lever_arm"] + parts["time_offset"], total, atol=2e-3 * np.abs(total).max())


def test_a_page_says_what_was_not_tested_in_words_that_a_phone_can_show() -> None:
    lacking = NotTestable("sag", "it is absorbed", "other inclinations & a roll")
    page = page_of(DiagnosisResult("nothing_left_out", not_testable=(lacking,)), report_data(np.array(0.0)), "rec.csv")
    assert '<div class="wide stacked"><table>' in page
    assert re.search(r'data-name="what it needs">other inclinations &amp; a roll<', page)
    assert "Diagnosis of rec.csv" in page


@pytest.mark.parametrize(
    ("value", "error", "reported"),
    [(0.00080012, 1.5e-7, "0.00080012"), (0.0002, 1e-5, "0.000200"), (-12.3456, 0.5, "-12.35"), (3.0, 0.0, "3"),
     (1e-5, 1e-4, "0.00001")],
)  # fmt: skip
def test_a_size_has_two_digits_of_its_error(value: float, error: float, reported: str) -> None:
    assert rounded(value, error) == reported


@pytest.mark.parametrize(
    ("parameter", "reported"),
    [
        (FittedParameter(0.00800037, 2.5e-7, 0.0079998, 0.0080009, "m"), "r = 8.00037 mm (7.99980 to 8.00090)"),
        (FittedParameter(-2.467e-5, 4e-7, -2.545e-5, -2.388e-5, "g/C"), "r = -24.67 ug/C (-25.45 to -23.88)"),
        (FittedParameter(0.946, 0.055, 0.838, 1.053, "1"), "r = 0.946 (0.838 to 1.053)"),
        (FittedParameter(480.0, 0.0, 480.0, 480.0, "s"), "r = 480 s"),
        (FittedParameter(0.0, 3e-6, -6e-6, 6e-6, "g"), "r = 0.0 ug (-6.0 to 6.0)"),
    ],
)
def test_a_size_is_reported_in_a_unit_that_suits_it(parameter: FittedParameter, reported: str) -> None:
    claim = Claim("lever_arm", "", "", "kinematic", {"r": parameter}, 0.0, ("lever_arm",), (), "")
    assert sizes(claim) == reported


@pytest.mark.parametrize(
    ("value", "unit", "reported"),
    [
        (0.02995446, "g", "29.95 mg"),
        (8.6e-6, "g", "8.6 ug"),
        (3.2, "sigma", "3.20 sigma"),
        (0.5, "rad/s", "500 mrad/s"),
    ],
)
def test_a_misfit_is_reported_in_a_unit_that_suits_it(value: float, unit: str, reported: str) -> None:
    assert shown(value, unit) == reported


def test_a_product_is_reported_in_words() -> None:
    words = axis_name("temp_c x gravity_direction")
    assert words == "temperature, C (what it does there turns with direction of gravity)"


def test_where_gravity_alone_is_known_nothing_is_reported_with_what_would_not_show() -> None:
    sizes = {"bias_step": Detectable(3.1e-4, "g"), "quadratic": Detectable(2e-4, "1/g")}
    found = DiagnosisResult("nothing_left_out", minimum_detectable=sizes, noise={"repeats_g": 7e-5})
    words = verdict_words(found)
    assert "Nothing" not in words
    assert "step of the zero offset 310 ug" in words
    assert "quadratic" not in words
    assert verdict_words(replace(found, noise={})).startswith("Nothing was left out")


def test_the_steps_end_at_what_is_left_where_the_parts_are_not_known() -> None:
    """A step of |g| that takes all stood on the page with a bar of all that it takes as what is left."""
    one = report_data(np.array(1e-4))
    steps = steps_of(replace(one, channels=("ax", "ay", "az"), sigma=(1e-5,) * 3))
    assert len(steps.names) == 1 and steps.left < 0.1 * steps.levels[0]
    page = page_of(DiagnosisResult("named", claims=(claim_of("bias_step"),)), one, "rec.csv")
    assert "<h1>The simulation omits step of the zero offset (100% of the misfit)" in page


def test_a_share_of_the_misfit_allows_for_what_is_left() -> None:
    """An effect that takes half of the misfit, and all of what is explained, has half of it."""
    one = report_data(np.array(1e-4))
    parts = {"lever_arm": one.before * (1 - np.sqrt(0.5))}
    half = replace(one, after=one.before * np.sqrt(0.5), parts=parts, sigma=(1e-5,) * 3)
    page = page_of(DiagnosisResult("named_plus", claims=(claim_of("lever_arm"),)), half, "rec.csv")
    assert "lever arm (50% of the misfit), and something more" in page


def test_a_sentence_lists_few_claims() -> None:
    one = report_data(np.array(1e-4))
    names = ("lever_arm", "bias", "scale", "time_offset", "bias_drift")
    page = page_of(DiagnosisResult("named", claims=tuple(claim_of(n) for n in names)), one, "rec.csv")
    assert "and 2 smaller things" in page.split("</h1>")[0]


def test_where_nothing_was_found_the_proof_has_one_figure() -> None:
    fit = Fit("g", 3.1e-5, 3.1e-5, 3.5e-5, 3.5e-5, 0.0, 0.0, 3.5e-5, "10 blocks; gain = share removed")
    assert proof(fit) == "Misfit 31 ug; noise 35 ug. On readings that the fit had not seen: 35 ug (10 blocks)."
    words = proof(fit, {"bench_inclination_rad": 8e-5, "bench_toolface_rad": 0.0})
    assert "noise 35 ug of the sensor; the set angles scatter by 80 urad in inclination, which the misfit" in words


def test_of_a_magnitude_what_is_seen_is_stated_with_digits_that_say_something() -> None:
    """At rest a step of 7.9 mg stood as three numbers of which each may be 50 mg, to 0.1 ug."""
    open_ = FittedParameter(-4.505e-3, 1e-7, -50.0321e-3, 50.0324e-3, "g")
    claim = replace(claim_of("bias_step"), parameters={"a_x": open_})
    assert sizes(claim) == "a_x = -5 mg (-50 to 50)"
    one = report_data(np.array(0.0))
    part = np.where(np.arange(one.before.shape[1]) > 100, 7.9e-3, 0.0)[None]
    seen = replace(
        one, before=one.after[:1] + part, after=one.after[:1], channels=("g_total",), parts={"bias_step": part}
    )
    page = page_of(DiagnosisResult("named", claims=(claim,)), seen, "rec.csv")
    assert "it changes the magnitude of gravity by 7.9 mg." in page


def test_the_page_is_there_in_each_language_and_what_is_not_is_marked_as_english() -> None:
    """Effects by name with their story and what to do next; what nobody has translated is marked."""
    from highside.physics.effects import all_effects
    from highside.words import LANGUAGES, in_language, told

    one = report_data(np.array(0.0))
    names = ("lever_arm", "temperature_bias", "bias_step")
    parts = {"lever_arm": 3e-5 * np.ones_like(one.before), "temperature_bias": 1e-5 * np.ones_like(one.before)}
    effects = all_effects()
    claims = tuple(
        replace(claim_of(name), story=effects[name].story, next_manoeuvre=effects[name].splitter) for name in names
    )
    lacking = NotTestable("lever_arm", "a reason that nobody has translated", effects["lever_arm"].splitter)
    found = DiagnosisResult("named", claims=claims, not_testable=(lacking,))
    data = replace(one, parts=parts)
    english = page_of(found, data, "rec.csv")
    assert "a reason that nobody" in english and '<span lang="en">' not in english
    for code in sorted(set(LANGUAGES) - {"en"}):
        with in_language(code):
            page = page_of(found, data, "rec.csv")
            titles = [told(effects[name].title) for name in names]
            assert all(
                title in page and title != effects[name].title for title, name in zip(titles, names, strict=True)
            )
            # every declared text of every effect is there in this language
            for effect in effects.values():
                for text in (effect.title, effect.story, effect.splitter, effect.channel_story, effect.channel_needs):
                    assert not text or told(text) != text, (code, text)
        assert f'<html lang="{code}">' in page
        assert '<span lang="en">a reason that nobody has translated</span>' in page
        left = re.sub(r'<span lang="en">.*?</span>|<style.*?</style>', "", page, flags=re.S)
        for sentence in (effects["lever_arm"].story, effects["lever_arm"].splitter, "share of the misfit", "how sure",
                         "What this recording could not show", "The simulation omits", "what is left"):  # fmt: skip
            assert sentence in english and sentence not in left, (code, sentence)


def test_noise_that_was_learned_is_no_random_walk() -> None:
    walk = DiagnosisResult("wander")
    learned = replace(walk, remainder=Remainder(hints=("what is left is taken for noise: 1/f noise",)))
    for found, words, badge in (
        (walk, "The zero offsets follow a random walk", "random walk"),
        (learned, "What is left is correlated noise", "correlated noise"),
    ):
        assert verdict_words(found).startswith(words)
        page = page_of(found, report_data(np.array(0.0)), "rec.csv")
        assert f"<h1>{words}" in page
        assert f">{badge}<" in page
