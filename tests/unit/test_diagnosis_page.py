"""The report of a diagnosis: drawn along what its intervals are told in, sizes with the digits they have."""

from __future__ import annotations

import re

import numpy as np
import pytest

from highside.diagnosis.result import Claim, Diagnosis, FittedParameter, Location, NotTestable
from highside.diagnosis.rotation_session import RotationSession
from highside.diagnosis.scene import Picture
from highside.physics.plan import RotationPlan, Session, Site
from highside.report.diagnosis_figures import residuals
from highside.report.diagnosis_page import page_of
from highside.report.diagnosis_words import axis_name, rounded, shown, sizes
from highside.report.page import plotting


def picture(before: np.ndarray) -> Picture:
    rates = tuple(2 * np.pi * np.array([-2.0, 0.5, 2.0]))
    state = Session(RotationPlan(62.0, rates, 8.0, 1.0, 50.0), Site()).rows().state
    rng = np.random.default_rng(1)
    noise = 1e-5 * rng.standard_normal((3, state.n))
    signal = np.array([before, before, 0 * before])[:, None] * np.cos(state.tf_rad) * state.rotor_rate_radps
    return Picture(RotationSession(noise, state), noise + signal, noise)


@pytest.mark.parametrize(
    ("covariate", "label"),
    [
        ("rotor_rate_dps x tf_ref_deg", "rate of rotation, deg/s"),
        ("tf_ref_deg", "toolface, deg"),
        ("t_s x tf_ref_deg", "time, s"),
        ("direction x tf_ref_deg", "toolface, deg"),
    ],
)
def test_a_residual_is_drawn_along_what_its_intervals_are_told_in(covariate: str, label: str) -> None:
    place = Location(("ax", "ay"), covariate, ((-720.0, -360.0),), None, 1.0, 1e-9)
    with plotting():
        figures = residuals(picture(np.array(1e-5)), place)
        assert [f.axes[0].get_xlabel() for f in figures] == [label, label]


def test_what_cancels_in_the_mean_is_drawn_as_rms() -> None:
    place = Location(("ax",), "rotor_rate_dps x tf_ref_deg", ((360.0, 720.0),), None, 1.0, 1e-9)
    with plotting():
        axis = residuals(picture(np.array(1e-5)), place)[0].axes[0]
        assert [text.get_text() for text in axis.get_legend().get_texts()] == ["before (rms)", "after (rms)"]
        rms = axis.get_lines()[1].get_ydata()
        assert rms[0] > 3 * rms[len(rms) // 2]


def test_a_page_says_what_was_not_tested_in_words_that_a_phone_can_show() -> None:
    lacking = NotTestable("sag", "it is absorbed", "other inclinations & a roll")
    page = page_of(Diagnosis("nothing_left_out", not_testable=(lacking,)), picture(np.array(0.0)), "rec.csv")
    assert '<div class="wide told"><table>' in page
    assert re.search(r'data-name="what it needs">other inclinations &amp; a roll<', page)
    assert "Diagnosis of rec.csv" in page


@pytest.mark.parametrize(
    ("value", "error", "told"),
    [(0.00080012, 1.5e-7, "0.00080012"), (0.0002, 1e-5, "0.000200"), (-12.3456, 0.5, "-12.35"), (3.0, 0.0, "3"),
     (1e-5, 1e-4, "0.00001")],
)  # fmt: skip
def test_a_size_has_two_digits_of_its_error(value: float, error: float, told: str) -> None:
    assert rounded(value, error) == told


@pytest.mark.parametrize(
    ("parameter", "told"),
    [
        (FittedParameter(0.00800037, 2.5e-7, 0.0079998, 0.0080009, "m"), "r = 8.00037 mm (7.99980 to 8.00090)"),
        (FittedParameter(-2.467e-5, 4e-7, -2.545e-5, -2.388e-5, "g/C"), "r = -24.67 ug/C (-25.45 to -23.88)"),
        (FittedParameter(0.946, 0.055, 0.838, 1.053, "1"), "r = 0.946 (0.838 to 1.053)"),
        (FittedParameter(480.0, 0.0, 480.0, 480.0, "s"), "r = 480 s"),
        (FittedParameter(0.0, 3e-6, -6e-6, 6e-6, "g"), "r = 0.0 ug (-6.0 to 6.0)"),
    ],
)
def test_a_size_is_told_in_a_unit_that_suits_it(parameter: FittedParameter, told: str) -> None:
    claim = Claim("lever_arm", "", "", "kinematic", {"r": parameter}, 0.0, ("lever_arm",), (), "")
    assert sizes(claim) == told


@pytest.mark.parametrize(
    ("value", "unit", "told"),
    [
        (0.02995446, "g", "29.95 mg"),
        (8.6e-6, "g", "8.6 ug"),
        (3.2, "sigma", "3.20 sigma"),
        (0.5, "rad/s", "500 mrad/s"),
    ],
)
def test_a_misfit_is_told_in_a_unit_that_suits_it(value: float, unit: str, told: str) -> None:
    assert shown(value, unit) == told


def test_a_product_is_told_in_words() -> None:
    words = axis_name("temp_c x gravity_direction")
    assert words == "temperature, C (what it does there turns with direction of gravity)"
