"""The cells into which laws of a rotation are looked for: each is represented by a row, and these rise in time."""

from __future__ import annotations

import numpy as np

from highside.diagnosis.law_sessions import cells_of
from highside.diagnosis.rows.session import RotationSession
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
