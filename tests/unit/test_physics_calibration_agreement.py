"""The estimator's own fast form of a session and the library of effects are one physics, reading by reading.

The joint estimator keeps the few effects that it fits in closed form, for speed; here they are held equal to the
library that simulates and diagnoses.
"""

from __future__ import annotations

import numpy as np
import pytest

from highside.calibration.forward import ENCODER_NAMES, GROUPS, linearise
from highside.calibration.result import MATRIX_NAMES, OFFSET_NAMES, TILT_NAMES
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

NAMES = (*MATRIX_NAMES, *OFFSET_NAMES, *TILT_NAMES, *(name for group in GROUPS.values() for name in group))


def in_the_library(name: str) -> str:
    """`effect.parameter` of the library for a parameter of the estimator."""
    kind, _, index = name.partition("_")
    if kind == "A":
        return f"scale.s_{index[0]}" if index[0] == index[1] else f"misalignment.m_{index}"
    if name in ENCODER_NAMES:
        return f"encoder_{'first' if index[1] == '1' else 'second'}_harmonic.{index}"
    effect, parameter = {
        "b": ("bias", f"b_{index}"),
        "tilt": ("base_tilt", name),
        "K2": ("quadratic", f"k2_{index}"),
        "K3": ("cubic", f"k3_{index}"),
        "KX": ("cross_product", f"k_{index}"),
    }[kind]
    return f"{effect}.{parameter}"


@pytest.fixture
def both() -> tuple[tuple[np.ndarray, ...], ForwardModel, ChainState, list[str]]:
    """A random session in both forms, rings beyond 90 deg and at -I among it."""
    rng = np.random.default_rng(4)
    inc, tf = rng.uniform(-0.8, 3.0, 50), rng.uniform(0, 2 * np.pi, 50)
    sizes = {"A": 3e-3, "b": 2e-3, "tilt": 5e-4, "K2": 1e-3, "K3": 1e-3, "KX": 1e-3, "enc": 2e-4}
    small = np.array([rng.normal(0, sizes[name.partition("_")[0]]) for name in NAMES])
    nominal = np.array([1.0 if name in ("A_xx", "A_yy", "A_zz") else 0.0 for name in NAMES])
    free = [in_the_library(name) for name in NAMES]
    model = ForwardModel.of({}).set_free(small, free)
    return linearise(NAMES, nominal + small, inc, tf), model, ChainState.build(inc, tf), free


def test_readings_are_equal(both) -> None:  # type: ignore[no-untyped-def]
    (reading, *_), model, state, _ = both
    # the two ways to write a tilt differ in third order: 5e-4 cubed
    np.testing.assert_allclose(reading, model.predict(state), atol=2e-9)


def test_derivatives_by_every_parameter_are_equal(both) -> None:  # type: ignore[no-untyped-def]
    (_, design, *_), model, state, free = both
    jacobian = model.jacobian(state, free)
    for j, name in enumerate(NAMES):
        # the library passes the derivatives of the bench through K2, K3 and KX as well (milli-g on 1 g)
        tolerance = 2e-2 if name in TILT_NAMES or name in ENCODER_NAMES else 1e-6
        np.testing.assert_allclose(design[:, :, j], jacobian[j], atol=tolerance, err_msg=name)


def test_derivatives_by_pose_are_equal(both) -> None:  # type: ignore[no-untyped-def]
    (_, _, by_inc, by_tf), model, state, _ = both
    sensitivity = model.pose_sensitivity(state)
    np.testing.assert_allclose(by_inc, sensitivity[:, 0], atol=2e-2)
    np.testing.assert_allclose(by_tf, sensitivity[:, 2], atol=2e-2)
