"""Poses without a column of the side of approach: it is taken from the order of the toolfaces, and that is said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside.api.diagnosis import Diagnosis, diagnose
from highside.arrays import Array
from highside.config.model import Model
from highside.diagnosis.approach import WITHOUT_SIDE
from highside.physics.gravity import gravity_direction
from highside.physics.state import SET_ANEW_RAD, approached_from

MODEL = Model.model_validate({"sensor": {"free": ["bias", "scale", "misalignment"]}})
ROW_G, ROWS = 5e-5, 20


@given(st.lists(st.floats(-400.0, 400.0), min_size=1, max_size=30))
def test_it_is_the_sense_of_the_last_change(tf_deg: list[float]) -> None:
    tf = np.radians(tf_deg)
    side, before = approached_from(tf), 1.0
    for k in range(tf.size):
        change = tf[k] - tf[k - 1] if k else 0.0
        if abs(change) > SET_ANEW_RAD:
            before = np.sign(change)
        assert side[k] == before


def with_play(seed: int, play_deg: float, order: Array, **more: Array) -> Diagnosis:
    """Poses in this order of their toolfaces, which stop short of where they were to go by `play_deg`."""
    rng = np.random.default_rng(seed)
    n = order.size
    inc, tf = np.tile([30.0, 75.0, 120.0], n), np.repeat(order, 3)
    side = approached_from(np.radians(tf))
    load = np.asarray(gravity_direction(np.radians(inc), np.radians(tf - side * play_deg)), dtype=float)
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ load + rng.normal(0, 5e-3, (3, 1))
    rows = np.repeat(np.arange(3 * n), ROWS)
    read = read[:, rows] + rng.normal(0, ROW_G, (3, rows.size))
    table = {f"a{axis}_g": read[k] for k, axis in enumerate("xyz")}
    table |= {"t_s": 1.0 * np.arange(rows.size) + 8.0 * rows, "temp_c": np.full(rows.size, 25.0), "pose": 1.0 * rows}
    table |= {name: values[rows] for name, values in more.items()}
    return diagnose({**table, "inc_ref_deg": inc[rows], "tf_ref_deg": tf[rows]}, MODEL)


SHUFFLED = np.array([0, 150, 60, 300, 210, 30, 330, 90, 240, 120, 270, 180], dtype=float)


@pytest.mark.parametrize("play_deg", [0.02, 1.0])
def test_a_play_of_the_toolface_has_its_name_and_size(play_deg: float) -> None:
    made = with_play(1, play_deg, SHUFFLED)
    (claim,) = made.claims
    assert claim.effect in ("backlash", "stiction")
    size = next(abs(p.value) for p in claim.parameters.values() if abs(p.value) > 1e-5)
    assert np.degrees(size) == pytest.approx(play_deg, rel=0.05)
    assert WITHOUT_SIDE in made.notes


def test_without_a_play_nothing_is_said_of_sides() -> None:
    made = with_play(2, 0.0, SHUFFLED)
    assert made.verdict == "nothing_left_out"
    assert made.notes == ()


def test_what_a_column_says_is_not_replaced() -> None:
    made = with_play(1, 0.02, SHUFFLED, direction=np.ones(3 * SHUFFLED.size))
    assert not {claim.effect for claim in made.claims} & {"backlash"}
    assert WITHOUT_SIDE not in made.notes
