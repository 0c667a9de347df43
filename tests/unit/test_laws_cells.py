"""Cells stand for the rows of a rotation: every row once, one rate and one sector each, means as they are."""

from dataclasses import replace

import numpy as np
import pytest

from highside.diagnosis.law_cells import CellMeans, cells_of
from highside.diagnosis.law_sessions import ChainSession
from highside.diagnosis.laws.policy import LAW_CELLS
from highside.diagnosis.laws.problem import functions_of
from highside.diagnosis.rows.session import RotationSession, rotation_session
from highside.physics.forward import ForwardModel
from highside.physics.law import Axis
from highside.physics.law_functions import Function


def session(step: float = 0.0) -> RotationSession:
    rng = np.random.default_rng(1)
    n = 20_000
    t = np.arange(n) / 50
    rate = np.where(t < 200, 40.0, -90.0)
    tf = np.cumsum(rate) / 50
    columns = {"t_s": t, "inc_ref_deg": np.full(n, 60.0), "tf_ref_deg": tf % 360, "rotor_rate_dps": rate}
    read = np.stack([np.sin(np.radians(tf)), np.cos(np.radians(tf)), np.full(n, 0.5)]) + 1e-3 * rng.normal(size=(3, n))
    read = np.round(read / step) * step if step else read
    return rotation_session(columns, read, gravity_mps2=9.81)


def test_every_row_is_in_one_cell_of_one_rate_and_one_sector() -> None:
    rows = session()
    cells = cells_of(rows)
    assert cells.count.sum() == rows.n
    assert cells.count.size < 2 * LAW_CELLS.most
    rate, tf = rows.state.rotor_rate_radps, np.mod(rows.state.tf_rad, 2 * np.pi)
    away = np.angle(np.exp(1j * (tf - tf[cells.middle][cells.number])))
    # the first row of a stretch may have the rate of the one before
    assert np.mean(rate == rate[cells.middle][cells.number]) > 0.999
    assert np.abs(away).max() < 2 * np.pi / LAW_CELLS.sectors + 0.1
    np.testing.assert_allclose(cells.mean(np.ones(rows.n)), 1.0)
    assert np.all(np.diff(cells.middle) > 0)


def test_the_floor_of_a_cell_is_the_scatter_of_its_rows_whatever_a_slow_misfit_does() -> None:
    rows = session()
    noise = 1e-3 * np.random.default_rng(2).normal(size=(3, rows.n))
    misfit = 5e-3 * np.sin(rows.state.t_s / 100)
    floor = ChainSession.of_rotation(rows, ("bias",), noise + misfit).floor
    count = cells_of(rows).count
    assert np.median(floor * np.sqrt(count)) == pytest.approx(1e-3, rel=0.15)


@pytest.mark.parametrize("step", [0.0, 2 / 2048])
def test_the_lattice_of_the_readings_is_known(step: float) -> None:
    laws = ChainSession.of_rotation(session(step), ("bias",), np.zeros((3, 20_000)) + 1e-3)
    np.testing.assert_allclose(laws.lattice, step, rtol=1e-6)


def test_a_cell_is_where_its_rows_are_on_the_average() -> None:
    """The row in its middle stood for it: a law of a thousand sigmas then left twenty of them, and laws of those."""
    rows = session()
    cells = cells_of(rows)
    state = cells.state(rows.state)
    away = np.angle(np.exp(1j * (rows.state.tf_rad - state.tf_rad[cells.number])))
    np.testing.assert_allclose(cells.mean(away), 0.0, atol=1e-9)
    np.testing.assert_allclose(state.rotor_rate_radps, cells.mean(rows.state.rotor_rate_radps))
    np.testing.assert_array_equal(state.t_s, rows.state.t_s[cells.middle])


def test_rates_that_never_rest_make_no_more_cells_than_a_search_can_pass() -> None:
    rng, n, hz = np.random.default_rng(3), 14_000, 20.0
    t = np.arange(n) / hz
    rate = 300.0 * (1 + 0.9 * np.sin(2 * np.pi * 0.7 * t + rng.uniform(0, 6)))
    tf = np.cumsum(rate) / hz
    columns = {"t_s": t, "inc_ref_deg": np.full(n, 60.0), "tf_ref_deg": tf % 360, "rotor_rate_dps": rate}
    read = np.stack([np.sin(np.radians(tf)), np.cos(np.radians(tf)), np.full(n, 0.5)]) + 1e-3 * rng.normal(size=(3, n))
    cells = cells_of(rotation_session(columns, read, gravity_mps2=9.81))
    assert cells.count.sum() == n
    assert cells.count.size <= LAW_CELLS.limit


def test_what_sets_in_within_a_cell_acts_on_a_part_of_it() -> None:
    """Its mean time is before the onset or after it: a step of twelve sigmas was placed twenty rows early."""
    rows = session()
    laws = ChainSession.of_rotation(rows, ("bias",), np.zeros((3, rows.n)) + 1e-3)
    columns, _ = laws.effect_columns(ForwardModel.of({}), "bias_step", {"t0": 150.0})
    acts = cells_of(rows).mean((rows.state.t_s >= 150.0).astype(float))
    assert np.any((acts > 0.1) & (acts < 0.9))
    np.testing.assert_allclose(np.abs(columns[0, 0]), acts, atol=1e-9)


def test_a_function_over_cells_is_the_mean_of_what_it_is_at_their_rows() -> None:
    """Of a temperature that moves by a tenth of its range within a cell the function of its mean is another one."""
    rows = session()
    state = replace(rows.state, temp_c=20.0 + 30.0 * np.sin(rows.state.t_s / 9.0))
    laws = ChainSession.of_rotation(replace(rows, state=state), ("bias",), np.zeros((3, rows.n)) + 1e-3)
    model = ForwardModel.of({})
    problem = laws.problem(model, np.zeros_like(laws.floor))
    axis = Axis("temp", -10.0, 50.0, tuple(Function("wide_cosine", (float(k),)) for k in (1, 9, 16)))
    made = functions_of(problem.covariates, axis)
    exact = cells_of(rows).mean(axis.basis(np.asarray(state.temp_c)))
    np.testing.assert_allclose(made, exact, atol=2e-4)
    slow = replace(axis, functions=axis.functions[:1])
    made_slow, exact_slow = functions_of(problem.covariates, slow), exact[:1]
    np.testing.assert_allclose(made_slow, exact_slow, atol=1e-4)
    assert np.abs(made - axis.basis(problem.covariates["temp"])).max() > 0.01


@pytest.mark.parametrize("kind", ["even", "skewed", "of two values", "of one value"])
def test_few_nodes_stand_for_all_rows_of_a_cell(kind: str) -> None:
    """Nodes and weights give the mean of a smooth function over rows; of few values they are these."""
    rng = np.random.default_rng(1)
    number = np.concatenate([np.arange(300), rng.integers(0, 300, 20_000)])
    cells = CellMeans(number, np.bincount(number).astype(float), np.arange(300))
    middle = rng.uniform(0.0, 360.0, 300)[number]
    away = {
        "even": rng.uniform(-6.0, 6.0, number.size),
        "skewed": rng.exponential(2.0, number.size),
        "of two values": np.where(rng.random(number.size) < 0.3, 1.0, -2.0),
        "of one value": np.zeros(number.size),
    }[kind]
    values = middle + away
    at, weights, spread = cells.nodes(values)
    np.testing.assert_allclose(spread**2, np.maximum(cells.mean(values**2) - cells.mean(values) ** 2, 0.0), atol=1e-6)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-12)
    for power in range(6):
        exact = cells.mean((values / 360.0) ** power)
        np.testing.assert_allclose(np.sum((at / 360.0) ** power * weights, axis=0), exact, rtol=1e-9, atol=1e-12)
    exact = cells.mean(np.cos(np.radians(4.0 * values)))
    np.testing.assert_allclose(np.sum(np.cos(np.radians(4.0 * at)) * weights, axis=0), exact, atol=1e-5)


@pytest.mark.parametrize(
    ("covariate", "function"),
    [
        ("time", Function("step", (151.4,))),
        ("time", Function("ramp", (92.3,))),
        ("time", Function("decay", (120.0, 12.0))),
        ("time", Function("decay", (0.0, 0.4))),
        ("tf", Function("dent", (40.0, 6.0))),
        ("tf", Function("dent", (350.0, 24.0))),
    ],
    ids=str,
)
def test_functions_with_corners_and_narrow_ones_are_means_over_the_rows_of_a_cell(
    covariate: str, function: Function
) -> None:
    rows = session()
    laws = ChainSession.of_rotation(rows, ("bias",), np.zeros((3, rows.n)) + 1e-3)
    problem = laws.problem(ForwardModel.of({}), np.zeros_like(laws.floor))
    values = rows.state.t_s if covariate == "time" else np.mod(np.degrees(rows.state.tf_rad), 360.0)
    axis = Axis(covariate, float(values.min()), float(values.max()), (function,))
    exact = cells_of(rows).mean(axis.basis(values))
    assert np.ptp(exact) > 0.3
    np.testing.assert_allclose(functions_of(problem.covariates, axis), exact, atol=1e-4)
