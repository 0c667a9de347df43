"""Lines at whole orders of the turn: found beyond doubt or not at all, and sectors that are fine enough for them."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.law_sessions import ChainSession
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.policy import LAW_CELLS
from highside.diagnosis.rotation.lines import found_lines, found_orders
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.noise import autoregressive
from highside.physics.plan import RotationPlan, Session, Site

SIGMA = 8e-5
FREE = ("bias", "scale", "misalignment")


def turning(order: float | None, colour: float = 0.0) -> tuple[RotationSession, np.ndarray]:
    """A rotation of four rates, 50 Hz, and what lies on its readings: noise, and a wave of an order on x."""
    plan = RotationPlan(62.0, tuple(2 * np.pi * np.array([0.5, -0.7, 1.1, -0.9])), 12.0, 1.0, 50.0, 20.0)
    state = Session(plan, Site(latitude_rad=0.9)).rows().state
    added = autoregressive((3, state.n), SIGMA, colour, np.random.default_rng(7))
    if order is not None:
        added[0] += SIGMA * np.cos(order * state.tf_rad + 0.3)
    return RotationSession(ForwardModel.of({}).predict(state) + added, state), added


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_noise_has_no_orders(colour: float) -> None:
    session, left = turning(None, colour)
    assert found_orders(session, left) == ()


def test_a_whole_order_is_a_harmonic_of_the_toolface_and_no_vibration() -> None:
    session, left = turning(14.0)
    assert found_orders(session, left) == (14.0,)
    assert not [line for line in found_lines(session, left) if abs(line.value - 14.0) < 0.1]


def test_an_order_that_is_no_whole_number_stays_a_line() -> None:
    session, left = turning(7.3)
    assert found_orders(session, left) == pytest.approx((7.3,), abs=0.01)
    assert any(line.value == pytest.approx(7.3, abs=0.01) for line in found_lines(session, left))


def test_sectors_are_fine_enough_for_a_line_and_laws_of_its_order_are_tried() -> None:
    session, left = turning(14.0)
    cells, plain = (ChainSession.of_rotation(session, FREE, one) for one in (left, turning(None)[1]))
    wave = np.cos(14 * session.state.tf_rad)
    assert cells.cells is not None and plain.cells is not None
    assert np.std(plain.cells.mean(wave)) < 0.8 * np.std(wave)
    assert np.std(cells.cells.mean(wave)) > 0.9 * np.std(wave)
    # cells of one row are no measure of the scatter within
    assert np.median(cells.floor * np.sqrt(cells.cells.count)) == pytest.approx(SIGMA, rel=0.25)
    problem = cells.problem(ForwardModel.of({}), cells.reduced(left))
    found = [g for g in groups_of(problem) if g.depends_on == ("tf",) and g.axes[0].functions[0].numbers == (14.0,)]
    assert {g.place for g in found} >= {"offset", "toolface"}
    assert cells.cells.count.size < 2 * LAW_CELLS.most
