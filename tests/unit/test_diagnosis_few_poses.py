"""Stepped sessions of 12 to 15 poses: what so few can show is found, what they cannot is told."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from highside import api
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

Array = NDArray[np.float64]

FURTHER = pytest.mark.further
MODEL = {"sensor": {"free": ["bias", "scale", "misalignment"]}}
SENSOR = {"bias": {"b_x": 1.2e-3, "b_y": -8e-4, "b_z": 1.5e-3}, "scale": {"s_x": 3e-3, "s_y": -2e-3, "s_z": 1e-3}}
ROWS = 10


def stepped(n: int, seed: int, **effects: dict[str, float]) -> dict[str, Array]:
    """Poses of ten rows each, in directions all around."""
    rng = np.random.default_rng(seed)
    inc, tf = np.round(np.degrees(np.arccos(rng.uniform(-1, 1, n))), 3), np.round(rng.uniform(0, 360, n), 3)
    t_s = np.arange(n) * 15.0
    state = ChainState.build(np.radians(inc), np.radians(tf), t_s=t_s)
    readings = np.repeat(ForwardModel.of({**SENSOR, **effects}).predict(state), ROWS, axis=1)
    readings = readings + rng.normal(0, 6e-5, readings.shape)
    columns = {"t_s": (t_s[:, None] + np.arange(ROWS)).ravel(), "pose": np.repeat(np.arange(float(n)), ROWS)}
    columns |= dict(zip(("ax_g", "ay_g", "az_g"), readings, strict=True))
    return columns | {"inc_ref_deg": np.repeat(inc, ROWS), "tf_ref_deg": np.repeat(tf, ROWS)}


@pytest.mark.parametrize("n", [12, 13, 14, 15])
def test_nothing_is_found_in_few_poses_where_nothing_is_left_out(n: int) -> None:
    """They were refused."""
    found = api.diagnose(stepped(n, n), MODEL).found
    assert found.verdict == "nothing_left_out"
    assert found.coverage is not None
    assert found.coverage.intervals_used == n
    # what so few cannot distinguish is said, effect by effect
    assert found.coverage.effects_tested == found.coverage.effects_known - len(found.not_testable)
    assert len(found.not_testable) > 10


@pytest.mark.parametrize("n", [13, 15])
def test_what_few_poses_can_show_is_named(n: int) -> None:
    found = api.diagnose(stepped(n, 2, sag={"s": 2e-3}), MODEL).found
    assert found.verdict == "named"
    (claim,) = found.claims
    assert "sag" in claim.equivalence_class


def test_what_few_poses_show_and_cannot_name_is_no_silence() -> None:
    found = api.diagnose(stepped(12, 2, quadratic={"k2_x": 1e-3}), MODEL).found
    assert found.verdict not in ("nothing_left_out", "bad_data", "not_testable")


@pytest.mark.parametrize("seed", [0, pytest.param(3, marks=FURTHER)])
def test_scatter_that_is_correlated_over_much_of_a_session_is_no_silence(seed: int) -> None:
    """It was "nothing_left_out": noise of such a memory had been identified, in four independent stretches."""
    columns, drawn = stepped(36, seed), np.random.default_rng([seed, 1]).normal(0, 1.8e-4, 66)
    slow = lfilter([1.0], [1.0, -0.8], drawn)[30:]
    columns["ax_g"] = columns["ax_g"] + np.repeat(slow, ROWS)
    found = api.diagnose(columns, MODEL).found
    assert found.verdict == "not_testable"
    assert not found.claims
    assert "record 80 poses or more" in found.remainder.hints[0]


CROSS = {
    "k_x_xy": 4e-4, "k_x_xz": -1.3e-3, "k_x_yz": -2e-3, "k_y_xy": -1.4e-3, "k_y_xz": 3e-4, "k_y_yz": -3e-4,
    "k_z_xy": 6e-4, "k_z_xz": 8e-4, "k_z_yz": -1.4e-3,
}  # fmt: skip


def test_what_the_rest_of_the_library_leaves_is_no_noise_to_a_strong_effect() -> None:
    """It was `unknown`: of 24 poses the columns that could be systematic had no room for nine numbers, and so these
    passed as noise that is 17 times the true one."""
    found = api.diagnose(stepped(24, 4, cross_product=CROSS), MODEL).found
    assert [claim.effect for claim in found.claims] == ["cross_product"]
    for name, fitted in found.claims[0].parameters.items():
        assert abs(fitted.value - CROSS[name]) < 5 * fitted.std
        assert fitted.std < 1e-4
