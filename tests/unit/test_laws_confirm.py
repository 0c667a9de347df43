"""What another session must vary to confirm a law, in words."""

from __future__ import annotations

import pytest

from highside.diagnosis.core.result import Claim
from highside.diagnosis.laws.to_vary import to_vary
from highside.report.diagnosis_claims import confounded, law_words


@pytest.mark.parametrize(
    ("follows", "rivals", "told"),
    [
        (("temp",), (), "vary temperature over the range that matters"),
        (("temp",), ("temp", "time"), "vary temperature over the range that matters, independently of time"),
        (
            ("temp_filtered_60",),
            ("temp_filtered_60", "temp_filtered_90", "temp_filtered_4000", "time", "temp"),
            "vary temperature that lags by 60 s over the range that matters, independently of temperature, time, "
            "temperature with lags from 90 to 4000 s",
        ),
        (("tf",), ("tf_fraction",), "vary toolface over the range that matters and over several turns"),
        (
            ("load_x",),
            ("tf_fraction", "inc"),
            "vary load on x over the range that matters and over several turns, independently of inclination, toolface",
        ),
    ],
)
def test_what_to_vary_is_told_with_what_it_must_be_parted_from(
    follows: tuple[str, ...], rivals: tuple[str, ...], told: str
) -> None:
    assert to_vary(follows, rivals) == told


@pytest.mark.parametrize(
    ("others", "title", "class_told"),
    [
        (
            ["temp_x_rate", "temp_filtered_60_x_rate", "temp_filtered_5850_x_rate", "time"],
            "temperature (at once or with a lag) and rotation rate",
            "temperature and rotation rate, or temperature with lags from 60 to 5850 s and rotation rate, or time",
        ),
        (
            ["temp_filtered_60_x_rate", "temp_x_tf"],
            "temperature that lags by 300 s and rotation rate",
            "temperature that lags by 60 s and rotation rate, or temperature and toolface",
        ),
    ],
)
def test_laws_that_differ_in_a_lag_alone_are_one_to_a_reader(others: list[str], title: str, class_told: str) -> None:
    own = "law:toolface_tf_temp_filtered_300_x_rate"
    every = (own, *(f"law:toolface_tf_{name}" for name in others))
    follows = ("temp_filtered_300", "rate")
    claim = Claim(own, "", None, "", {}, 1e-9, every, (), "", place="toolface", channels=("tf",), depends_on=follows)
    assert law_words(claim) == f"an error of the reference toolface that follows {title}"
    assert confounded(claim) == f"this, or the same following {class_told}"


def test_the_same_of_another_channel_says_nothing_of_the_lag() -> None:
    own = "law:offset_x_temp_filtered_300"
    every = (own, "law:offset_y_temp")
    follows = ("temp_filtered_300",)
    claim = Claim(own, "", None, "", {}, 1e-9, every, (), "", place="offset", channels=("ax",), depends_on=follows)
    assert law_words(claim) == "an offset of ax that follows temperature that lags by 300 s"
