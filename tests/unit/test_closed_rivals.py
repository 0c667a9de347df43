"""Names where only |g| is known: beside closed forms of a load, and of tables that have no times."""

from __future__ import annotations

import re

import pytest

import highside
from highside.report.diagnosis_words import verdict_words
from studies import hand_outsiders

FURTHER = pytest.mark.further

MODEL = {
    "sensor": {"noise_g": hand_outsiders.NOISE_G, "free": ["bias", "scale", "misalignment"]},
    "reference": {"kind": "magnitude"},
}


@pytest.mark.parametrize("seed", [500, 507, 516])
def test_a_law_that_the_library_lacks_is_no_name(seed: int) -> None:
    """A kink of a load, a step of the temperature and a sine of a load, of strength 400."""
    case = hand_outsiders.case("laws", seed, 400.0)
    found = highside.diagnose(case.columns, MODEL).to_dict()
    assert found["verdict"] == "law"
    place, follows = ("offset", "temp" if "temp" in case.name else "load")
    assert any(c["place"] == place and c["depends_on"] == [follows] for c in found["claims"])


def test_a_form_that_is_nearly_as_good_is_told_beside_the_name() -> None:
    """A fourth power is ahead of a square by four to six nats at this strength."""
    case = hand_outsiders.case("laws", 505, 400.0)
    (claim,) = highside.diagnose(case.columns, MODEL).to_dict()["claims"]
    assert claim["effect"] == "quadratic"
    assert "law:offset_z_load" in claim["equivalence_class"]


@pytest.mark.parametrize("seed", [504, 506, 510])
def test_an_effect_of_the_library_keeps_its_name(seed: int) -> None:
    """A square, a modulus and a step in time, of strength 400: no closed form is as good."""
    case = hand_outsiders.case("effects", seed, 400.0)
    found = highside.diagnose(case.columns, MODEL).to_dict()
    assert [c["effect"] for c in found["claims"]] == [case.name]
    assert not any("as good as" in hint for hint in found["remainder"]["hints"])


def test_of_a_table_without_times_nothing_is_said_of_time() -> None:
    """A drift from row to row is no drift in ug/s where nothing says when the rows were taken."""
    case = hand_outsiders.case("effects", 502, 4e4)
    assert case.name == "bias_drift"
    timed = highside.diagnose(case.columns, MODEL)
    assert [c.effect for c in timed.found.claims] == ["bias_drift"]
    untimed = highside.diagnose({name: v for name, v in case.columns.items() if name != "t_s"}, MODEL)
    lacking = {entry.effect: entry.why for entry in untimed.found.not_testable}
    for name in ("bias_drift", "bias_step", "warmup", "thermal_lag"):
        assert "no column t_s" in lacking[name]
        assert name not in untimed.found.minimum_detectable
    assert untimed.verdict == "unknown"
    assert not untimed.found.claims
    assert "follows the order of the rows" in untimed.found.remainder.hints[0]
    assert any("no column t_s" in note for note in untimed.notes)
    assert re.search(r"has no name for\. It is [\d.]+ ug rms beyond the noise", verdict_words(untimed.found))


def test_what_needs_no_clock_keeps_its_name_in_a_table_without_times() -> None:
    case = hand_outsiders.case("effects", 504, 4e3)
    found = highside.diagnose({name: v for name, v in case.columns.items() if name != "t_s"}, MODEL).found
    assert [c.effect for c in found.claims] == ["quadratic"]


@pytest.mark.parametrize("seed", [506, pytest.param(513, marks=FURTHER)])
def test_a_name_that_grows_beyond_its_plausible_range_is_refused_by_name(seed: int) -> None:
    """A modulus and a square of 20 mg and more: laws do not take what the name explains, and what an offset
    that was fitted without it does to |g| beyond first order is no law."""
    case = hand_outsiders.case("effects", seed, 1e6)
    made = highside.diagnose(case.columns, MODEL)
    found = made.to_dict()
    assert found["verdict"] == "implausible_fit"
    assert re.search(r"The misfit is [\d.]+ mg rms beyond the noise", verdict_words(made.found))
    assert found["remainder"]["resembles"][0] == case.name
    assert "of a size that no instrument has" in found["remainder"]["hints"][0]


def test_a_large_law_that_names_of_no_plausible_size_only_approximate_is_a_law() -> None:
    """A power 1.5 of the temperature, which a line and a square of it make together."""
    case = hand_outsiders.case("laws", 518, 1e6)
    found = highside.diagnose(case.columns, MODEL).to_dict()
    assert [c["depends_on"] for c in found["claims"]] == [["temp"]]


def test_where_a_small_name_gives_way_to_a_form_the_large_one_is_still_named() -> None:
    """A temperature coefficient of 20 mg beside noise of two sizes, of which a part resembled a second name."""
    case = hand_outsiders.case("effects", 1012, 1e6)
    found = highside.diagnose(case.columns, MODEL).to_dict()
    assert case.name == "temperature_bias"
    assert found["verdict"] == "named_plus"
    assert [c["effect"] for c in found["claims"]] == ["temperature_bias"]
    left = found["fit"]["rmse_after"]
    assert left < 0.02 * found["fit"]["rmse_before"]
    assert not any(
        "mg rms are left out" in hint or "e+03 ug rms are left out" in hint for hint in found["remainder"]["hints"]
    )
