"""What another session must vary to confirm a law, in words."""

from __future__ import annotations

import pytest

from highside.diagnosis.laws.claims import to_vary


@pytest.mark.parametrize(
    ("follows", "rivals", "told"),
    [
        (("temp",), (), "vary temperature over the range that matters"),
        (("temp",), ("temp", "time"), "vary temperature over the range that matters, independently of time"),
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
