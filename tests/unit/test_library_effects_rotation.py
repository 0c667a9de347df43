"""Effects of the library on gyros and in rotation, each concealed in a rotating session: it is named, with its size."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rows.session import RotationSession
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.plan import Profile, RotationPlan, Session
from studies import diagnosis_deck as deck
from studies.scenario import random_sensor

FURTHER = pytest.mark.further
Sizes = dict[str, float]

FREE = (*deck.FREE, "gyro_bias", "gyro_scale")


def turning(effects: dict[str, Sizes], seed: int = 2) -> RotationSession:
    """Five rates of both signs, with gyros, while the temperature goes up and down."""
    rates = tuple(2 * np.pi * np.array([0.3, -0.8, 1.5, -1.5, 0.8]))
    plan = RotationPlan(62.0, rates, 20.0, 1.0, 12.5, 20.0)
    state = Session(plan, temperature=Profile((25.0, 45.0, 33.0, 40.0))).rows().state
    rng = np.random.default_rng(seed)
    sensor = random_sensor(rng).with_effects(effects)
    accel = sensor.predict(state) + 8e-5 * rng.standard_normal((3, state.n))
    gyro = sensor.gyro(state) + 2e-4 * rng.standard_normal((3, state.n))
    return RotationSession(np.concatenate([accel, gyro]), state)


@pytest.mark.parametrize(
    ("effect", "sizes"),
    [
        pytest.param("gyro_temperature_bias", {"bt_x": 2e-5, "bt_z": -3e-5}, marks=FURTHER),
        ("gyro_temperature_scale", {"st_z": 1e-5}),
        ("gyro_warmup", {"a_x": 4e-4, "a_y": -5e-4, "tau": 30.0}),
        pytest.param("gyro_bias_step", {"a_y": 3e-4, "a_z": -2e-4, "t0": 60.0}, marks=FURTHER),
        # in a stepped session too
        pytest.param("load_hysteresis", {"h_x": 1.5e-4, "h_y": -1.2e-4, "width": 0.1}, marks=FURTHER),
    ],
)
def test_named_with_its_size(effect: str, sizes: Sizes) -> None:
    found = diagnose_rotation(turning({effect: sizes}), ForwardModel.of({}), FREE)[0]
    assert [claim.effect for claim in found.claims] == [effect], deck.in_words(found)
    shapes = {p.name for p in library.get(effect).shapes}
    for name, value in sizes.items():
        if name not in shapes:
            fitted = found.claims[0].parameters[name]
            half = (fitted.high - fitted.low) / 2
            assert abs(fitted.value - value) <= 1.5 * half
            assert half < abs(value)
