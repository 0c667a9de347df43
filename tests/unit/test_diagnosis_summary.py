"""Diagnosis of error tables: the chain is simulated faithfully, what is left out is found, and nothing is invented."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.calibration.conventional import position_plan
from highside.diagnosis.table.chain import Correction, Linear, Procedure, Sessions, draw, predict_cells
from highside.diagnosis.table.engine import Summarised, diagnose_summary
from highside.diagnosis.table.instrument import predict_table
from highside.errors import InputError
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

Array = NDArray[np.float64]
Effects = dict[str, dict[str, float]]

INC_DEG = np.array([90.0, 70.0, 45.0, 20.0, 5.0, 2.0, 0.8])
STEP = float(np.radians(0.009))
BENCH = {"pose_error": {"inc_station": STEP, "tf_station": STEP, "inc_pose": 0.0, "tf_pose": 0.0}}
SENSOR = {
    "bias": {"b_x": 3e-4, "b_y": -2e-4, "b_z": 7e-4},
    "scale": {"s_x": 2e-3, "s_y": -1e-3, "s_z": 3e-3},
    "misalignment": {"m_xy": 3e-3, "m_zx": -2e-3},
}


def table(effects: Effects, seed: int, noise_g: float = 30e-6) -> Array:
    """Mean and peak-to-peak of one real session, written down reading by reading: shares no code with the chain."""
    rng = np.random.default_rng(seed)
    model = ForwardModel.of({**SENSOR, **BENCH, **effects})
    stations = np.linspace(0, 360, 73)
    three_inc, three_tf = position_plan(3)
    state = ChainState.build(
        np.concatenate([np.repeat(np.radians(INC_DEG), 73), three_inc]),
        np.concatenate([np.tile(np.radians(stations), INC_DEG.size), three_tf]),
    )
    clean = model.chain(state, model.draw(state, rng)).reported
    readings = clean[:, :, None] + noise_g * rng.standard_normal((*clean.shape, 4))
    matrix = np.linalg.inv(readings[:, -3:].mean(axis=2))
    g = np.einsum("ij,jnk->ink", matrix, readings[:, :-3]).reshape(3, INC_DEG.size, -1)
    inc = np.degrees(np.arctan2(np.hypot(g[0], g[1]), g[2])) - INC_DEG[:, None]
    tf = (np.degrees(np.arctan2(g[1], g[0])) - np.repeat(stations, 4) + 180) % 360 - 180
    return np.stack([inc.mean(axis=1), np.ptp(inc, axis=1), tf.mean(axis=1), np.ptp(tf, axis=1)], axis=1)


def diagnosed(printed: Array) -> Summarised:
    return diagnose_summary(
        INC_DEG, printed, Procedure("conventional3"), ForwardModel.of({}), ("bias", "scale", "misalignment")
    )


@pytest.mark.parametrize("corrected_by", ["conventional3", "balance-average", "none"])
def test_the_slopes_of_the_cells_are_their_differences(corrected_by: Correction) -> None:
    model = ForwardModel.of({**BENCH, "bias": SENSOR["bias"]})
    sessions = Sessions.of(np.radians(INC_DEG[1:]), Procedure(corrected_by, stations=37, readings=2))
    columns = np.asarray(model.jacobian(sessions.state, ["bias", "base_tilt", "encoder_second_harmonic"]))
    linear = Linear.about(sessions, model, columns)
    draws = draw(sessions, model, 4, 1, 40e-6)
    at = np.array([1e-4, -2e-4, 3e-4, 4e-4, -3e-4, 5e-4, 2e-4])
    slope = predict_cells(linear, at, 40e-6, draws).slope
    for k in range(at.size):
        step = np.zeros(at.size)
        step[k] = 2e-6
        up, down = (predict_cells(linear, at + s * step, 40e-6, draws).cells.mean(axis=0) for s in (1, -1))
        # single precision, and an extreme may pass to the next station within the step
        assert np.allclose((up - down) / 4e-6, slope[k], atol=0.05 * np.abs(slope[k]).max() + 0.5)


def test_a_predicted_table_is_the_one_that_is_measured() -> None:
    effects: Effects = {"base_tilt": {"tilt_x": 2e-4, "tilt_y": -3e-4}, "encoder_second_harmonic": {"c2": 4e-4}}
    said = predict_table(
        INC_DEG, Procedure("conventional3"), ForwardModel.of({**SENSOR, **BENCH, **effects}), 30e-6, count=200
    )
    measured = np.array([table(effects, seed) for seed in range(40)])
    error = (measured.mean(axis=0) - said.cells) / said.std
    # the mean of forty sessions against that of two hundred
    assert np.all(np.abs(error) < 5 * np.sqrt(1 / 40 + 1 / 200))
    assert np.all(np.abs(np.log(measured.std(axis=0) / said.std)) < 0.5)


def test_a_correction_of_its_own_inclination_takes_up_what_is_linear() -> None:
    bare = {**BENCH, "bias": SENSOR["bias"]}
    named = {**bare, "base_tilt": {"tilt_x": 4e-4, "tilt_y": 4e-4}, "scale": SENSOR["scale"]}
    cells = [
        predict_table(INC_DEG[1:], Procedure("balance-average"), ForwardModel.of(model), 30e-6, count=20).cells
        for model in (bare, named)
    ]
    assert np.allclose(cells[0], cells[1], rtol=0.05, atol=2e-4)


def test_at_90_deg_the_balance_average_has_no_meaning() -> None:
    said = predict_table(INC_DEG, Procedure("balance-average"), ForwardModel.of({**SENSOR, **BENCH}), 30e-6, count=5)
    assert np.isnan(said.cells[0]).all()
    assert np.isfinite(said.cells[1:]).all()


def test_nothing_is_left_out_of_a_complete_model() -> None:
    found = diagnosed(table({}, 1)).diagnosis
    assert found.verdict == "nothing_left_out"
    assert found.claims == ()
    assert {"backlash", "bias_drift", "mounting"} <= {n.effect for n in found.not_testable}


@FURTHER
def test_a_bench_that_is_not_level_is_named_with_its_size_and_place() -> None:
    found = diagnosed(table({"base_tilt": {"tilt_x": 3e-4, "tilt_y": -4e-4}}, 2)).diagnosis
    assert found.verdict in ("named", "named_plus")
    assert [claim.effect for claim in found.claims] == ["base_tilt"]
    size = found.claims[0].parameters
    assert abs(size["tilt_x"].value - 3e-4) < 4 * size["tilt_x"].std
    assert abs(size["tilt_y"].value + 4e-4) < max(4 * size["tilt_y"].std, 1e-5)
    assert "d_tf_mean_deg" in found.location[0].channels
    assert found.fit is not None and found.fit.unit == "sigma"
    assert found.fit.heldout_rmse_before is not None and found.fit.heldout_rmse_after is not None
    assert found.fit.heldout_rmse_after < 0.5 * found.fit.heldout_rmse_before


@FURTHER
def test_a_row_that_was_measured_wrongly_is_named() -> None:
    printed = table({"base_tilt": {"tilt_x": 3e-4, "tilt_y": -4e-4}}, 3)
    printed[3, 2] += 0.05
    found = diagnosed(printed).diagnosis
    assert "20 deg" in " ".join(found.remainder.hints)
    assert [claim.effect for claim in found.claims] in (["base_tilt"], [])


def test_lost_cells_are_no_zeros() -> None:
    printed = table({}, 4)
    printed[2, 1] = printed[5, 3] = np.nan
    assert diagnosed(printed).diagnosis.verdict == "nothing_left_out"


def test_too_few_cells_are_refused() -> None:
    with pytest.raises(InputError, match="too few"):
        diagnose_summary(INC_DEG[:2], table({}, 1)[:2], Procedure("none"), ForwardModel.of({}), ())
