"""A law of the reference's angles, learnt from accelerometers, says nothing of gyros; an effect of the bench does."""

from __future__ import annotations

import numpy as np

from highside.physics.forward import ForwardModel
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function
from highside.physics.state import ChainState

N = 400
T = 0.01 * np.arange(N)
STATE = ChainState.build(np.full(N, 1.2), 3.0 * T, t_s=T, rotor_rate_radps=np.full(N, 3.0), temp_c=np.full(N, 30.0))
WAVES = tuple(Function(kind, (3.0,)) for kind in ("cos", "sin"))
LAW = Law("toolface_tf_tf", "toolface", ("tf",), (Axis("tf", 0.0, 360.0, WAVES),), ((2e-3, 1e-3),))


def test_a_law_of_the_toolface_moves_the_accelerometers_alone() -> None:
    """Of an encoder whose error it is, and whose rate is measured apart, the gyros agree with the rate: with a law that
    turns the tool they were 4.4 deg/s off, and laws of gyros were told to take that back."""
    plain, with_law = ForwardModel.of({}), ForwardModel.of({}).with_laws([LAW])
    assert float(np.abs(with_law.predict(STATE) - plain.predict(STATE)).max()) > 1e-3
    np.testing.assert_array_equal(with_law.gyro(STATE), plain.gyro(STATE))


def test_a_harmonic_of_the_encoder_by_name_turns_the_tool() -> None:
    named = ForwardModel.of({"encoder_first_harmonic": {"c1": 2e-3, "s1": 0.0}})
    assert float(np.abs(named.gyro(STATE) - ForwardModel.of({}).gyro(STATE)).max()) > 1e-3
