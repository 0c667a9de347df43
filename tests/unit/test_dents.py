"""Which dents of a curve over toolface are one."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.laws.groups import LawGroup, dent_of, within_another
from highside.diagnosis.laws.problem import PlaceField
from highside.physics.law import Axis
from highside.physics.law_functions import Function


def group(centre: float, width: float, channel: str = "z", kind: str = "dent") -> LawGroup:
    axis = Axis("tf", 0.0, 360.0, (Function(kind, (centre, width)),))
    return LawGroup((PlaceField("offset", channel, np.ones((3, 5))),), (axis,), np.zeros(1), np.ones((1, 1, 5)))


@pytest.mark.parametrize(
    ("centre", "width", "channel", "one"),
    [
        (270.0, 6.0, "z", True),
        (290.0, 6.0, "z", True),
        (240.0, 60.0, "z", True),
        (300.0, 6.0, "z", False),
        (270.0, 6.0, "x", False),
    ],
)
def test_a_dent_within_a_dent_of_the_same_channel_is_no_second_one(
    centre: float, width: float, channel: str, one: bool
) -> None:
    assert within_another(group(centre, width, channel), group(270.0, 24.0)) is one


def test_the_short_way_around_counts() -> None:
    assert within_another(group(355.0, 6.0), group(5.0, 12.0))


def test_a_bump_is_no_dent() -> None:
    assert dent_of(group(90.0, 12.0, kind="bump")) is None
    assert not within_another(group(90.0, 12.0, kind="bump"), group(90.0, 12.0))
