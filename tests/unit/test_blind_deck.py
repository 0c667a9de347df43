"""The sealed deck's own world and highside's library describe the same physics, though they share no code."""

from __future__ import annotations

import numpy as np
import pytest

from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies.sealed import deck, world

PLAIN = world.Sensor(np.zeros(3), np.eye(3), np.zeros(3), np.eye(3))


def both(design: str, effect: str, draw: deck.Draw) -> list[tuple[np.ndarray, np.ndarray]]:
    """What the effect changes, by the deck and by the library: the triad's readings, and the gyros' (rotation)."""
    rng = np.random.default_rng(3)
    gyros = design == "rotation"
    p = deck._programme(design, rng, gyros=gyros)
    values = draw(np.random.default_rng(5))
    accel, gyro = world.readings(p, PLAIN, {effect: values})
    accel0, gyro0 = world.readings(p, PLAIN, {})
    columns = deck._columns(p, deck._stacked(accel0, gyro0))
    state = ChainState.from_columns(
        columns, gravity_mps2=world.G0, latitude_rad=p.latitude, azimuth_rad=p.azimuth
    )  # fmt: skip
    model, plain = ForwardModel.of({effect: values}), ForwardModel.of({})
    found = [(accel - accel0, model.predict(state) - plain.predict(state))]
    if gyro is not None and gyro0 is not None:
        found.append((gyro - gyro0, model.gyro(state) - plain.gyro(state)))
    return found


CASES = [("poses", *item) for item in deck.POSE_EFFECTS.items()] + [
    ("rotation", *item) for item in (deck.ROTATION_EFFECTS | {"earth_rotation": lambda rng: {"share": 1.0}}).items()
]


@pytest.mark.parametrize(("design", "effect", "draw"), CASES, ids=[f"{d}-{e}" for d, e, _ in CASES])
def test_the_deck_and_the_library_mean_the_same_effect(design: str, effect: str, draw: deck.Draw) -> None:
    for theirs, ours in both(design, effect, draw):
        size = float(np.sqrt(np.mean(theirs**2)))
        if size < 1e-12:
            assert np.abs(ours).max() < 1e-9
            continue
        # what the library takes as small angles and rates at the rows, the deck steps through time
        assert float(np.sqrt(np.mean((ours - theirs) ** 2))) < 3e-3 * size


def test_a_case_has_the_strength_that_it_says() -> None:
    made = deck.cases("test", deck.Size(0, 1, (100.0,), 0, 0, 0, 0))
    for name in ("single/poses/thermal_lag/100/0", "single/rotation/tone/100/0"):
        case = made[name]()
        assert case.strength == 100.0
        assert len(case.truth) == 1
        again = deck.cases("test", deck.Size(0, 1, (100.0,), 0, 0, 0, 0))[name]()
        for column, values in case.columns.items():
            assert np.array_equal(values, again.columns[column]), "the same seed makes the same case"


def test_the_full_deck_is_as_large_as_promised() -> None:
    made = deck.cases("test", deck.Size())
    nulls = [name for name in made if name.startswith("null/")]
    assert len(nulls) >= 300
    assert len(made) - len(nulls) >= 600
    assert len({name.split("/")[2] for name in made if name.startswith("single/")}) >= 25
