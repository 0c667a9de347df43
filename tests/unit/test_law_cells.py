"""The cells into which laws of a rotation are looked for: each is represented by a row, and these rise in time."""

from __future__ import annotations

import tracemalloc

import numpy as np

from highside.diagnosis.law_cells import cells_of
from highside.diagnosis.law_sessions import ChainSession
from highside.diagnosis.rows.session import RotationSession
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from highside.physics.law import Axis, Law, LawEffect
from highside.physics.law_functions import Function
from highside.physics.memory import low_pass
from highside.physics.state import ChainState


def test_rows_that_stand_for_cells_rise_in_time() -> None:
    """A cell holds rows of several turns: its mean and the row in its middle may lie on two sides of another cell's."""
    n = 30000
    t = np.arange(n) * 0.02
    rate = np.where((t // 40) % 2 < 1, 3.7, -2.1)
    state = ChainState.build(
        np.full(n, 1.0), np.cumsum(rate) * 0.02, t_s=t, rotor_rate_radps=rate, direction=np.sign(rate), row_seconds=0.02
    )
    left_out = np.random.default_rng(1).random(n) < 0.02
    cells = cells_of(RotationSession(np.zeros((3, n)), state, left_out))
    assert 20 < cells.middle.size < n / 4
    assert np.all(np.diff(state.t_s[cells.middle]) > 0)
    # the row stands in its own cell, and every row that is used is counted once
    assert np.array_equal(cells.number[cells.middle], np.arange(cells.middle.size))
    assert np.array_equal(np.bincount(cells.number[~left_out]), cells.count)
    assert np.all(cells.number[left_out] == -1)


def test_a_temperature_that_lags_begins_at_the_first_row_in_cells_too() -> None:
    """In a minute it moves by little: from the first cell on it would be another function of the time."""
    n = 3000
    t = np.arange(n) * 0.02
    temp = 26.0 + 30.0 * t / t[-1]
    state = ChainState.build(
        np.full(n, 1.0), 0.2 * t, t_s=t, temp_c=temp, rotor_rate_radps=np.full(n, 0.2), row_seconds=0.02
    )
    readings = 1e-4 * np.random.default_rng(2).standard_normal((3, n))
    session = ChainSession.of_rotation(RotationSession(readings, state, np.zeros(n, dtype=bool)), (), readings)
    assert session.cells is not None and session.cells.middle[0] > 0
    model = ForwardModel.of({})
    known = session.problem(model, session.reduced(readings)).covariates
    lagging = low_pass(t, temp, 4000.0)
    assert np.array_equal(known["temp_filtered_4000"], session.cells.mean(lagging))
    assert np.array_equal(known["temp_filtered_613"], session.cells.mean(low_pass(t, temp, 613.0)))
    # and so a law does in the cells what it does in the rows
    axis = Axis("temp_filtered_4000", lagging[0], lagging[-1], (Function("wide_cosine", (9.0,)),))
    law = Law("lagging", "scale", ("y",), (axis,), ((1e-3,),))
    does = session.residual(model) - session.residual(model.with_laws([law]))
    (made,) = session.derivatives(model, [(LawEffect(law), np.zeros(1))])
    assert np.corrcoef(made[0, 1], does[1])[0, 1] > 0.999


def test_what_many_effects_do_is_kept_of_the_rows_that_stand_for_cells_alone() -> None:
    """At all rows of an hour the effects that a law may resemble took a gigabyte."""
    n = 20000
    t = np.arange(n) * 0.02
    state = ChainState.build(
        np.full(n, 1.0), 0.2 * t, t_s=t, temp_c=26.0 + t / 100, rotor_rate_radps=np.full(n, 0.2), row_seconds=0.02
    )
    readings = 1e-4 * np.random.default_rng(2).standard_normal((3, n))
    session = ChainSession.of_rotation(RotationSession(readings, state, np.zeros(n, dtype=bool)), (), readings)
    assert session.cells is not None and session.cells.middle.size < n / 10
    model, step = ForwardModel.of({}), get("bias_step")
    wanted = [(step, np.asarray(step.vector({"t0": at}), dtype=float)) for at in np.linspace(10.0, 390.0, 60)]
    tracemalloc.start()
    made = session.derivatives(model, wanted)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.array_equal(made[7], model.derivatives(state, wanted[7:8])[0][..., session.cells.middle])
    # four parameters, three channels, eight bytes: 115 MB at all rows
    assert most < 0.5 * len(wanted) * 4 * 3 * 8 * n
