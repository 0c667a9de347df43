"""Where a mismatch sits: the shortest range that explains it; what a design cannot show is said, and how to show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.diagnosis.core.location import products
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.support import cells_of, support
from highside.diagnosis.core.untestable import what_splits
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.rows.session import RotationSession
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from highside.physics.plan import RotationPlan, Session, Site
from studies import diagnosis_deck as deck
from studies.scenario import random_sensor

FURTHER = pytest.mark.further
WAYS = pytest.mark.parametrize(
    "method",
    [
        pytest.param(ProcedureParts.without("laws"), id="names alone"),
        pytest.param(WHOLE, id="with laws", marks=FURTHER),
    ],
)
"""Of what the names settle among themselves; that laws leave them alone: `test_diagnosis_engine`."""

STATE = deck.design()
FREE = ("bias", "scale", "misalignment")


def overlap(inside_interval: tuple[tuple[float, float], ...], low: float, high: float) -> float:
    common = sum(max(min(b, high) - max(a, low), 0.0) for a, b in inside_interval)
    return common / (sum(b - a for a, b in inside_interval) + high - low - common)


@settings(max_examples=40, deadline=None)
@given(first=st.integers(0, 23), length=st.integers(1, 5), circular=st.booleans())
def test_a_range_is_found_again_through_a_base_that_absorbs_a_part_of_it(
    first: int, length: int, circular: bool
) -> None:
    # no more than a fifth of a turn: a third of it, with the first harmonic taken off, is no clear range any more
    rng = np.random.default_rng([first, length, circular])
    if not circular:
        first = min(first, 24 - length)
    along = rng.uniform(0, 360, 3000)
    cells = cells_of("x", along, circular=circular)
    inside = np.isin(cells.of, (first + np.arange(length)) % 24)
    turn = np.radians(along)
    base = span(np.stack([np.ones(3000), np.cos(turn), np.sin(turn)]))
    residual = outside(base, 0.6 * inside + rng.standard_normal(3000))
    found = support(cells, *products(cells.functions(), residual, base))
    inside_interval = np.any([(along >= a) & (along <= b) for a, b in found.intervals], axis=0)
    # but for a cell at either end, which chance may add or take
    assert np.sum(inside_interval != inside) < 2.3 * 3000 / 24
    assert found.gain > 0.5 * float(residual @ residual - 3000) - 200


def test_chance_alone_has_hardly_any_range() -> None:
    rng = np.random.default_rng(4)
    cells = cells_of("x", rng.uniform(0, 360, 2000), circular=True)
    nothing = np.empty((0, 2000))
    gains = [
        support(cells, *products(cells.functions(), rng.standard_normal(2000), nothing)).gain for _ in range(50)
    ]  # fmt: skip
    assert np.median(gains) < 15


def test_settings_are_cells_and_a_range_over_the_turn_is_reported_in_two_parts() -> None:
    along = np.tile(np.arange(0.0, 360.0, 30.0), 20)
    cells = cells_of("tf_ref_deg", along, circular=True)
    assert cells.count == 12
    residual = np.where((along == 0) | (along == 330), 3.0, 0.0) + np.random.default_rng(1).standard_normal(along.size)
    found = support(cells, *products(cells.functions(), residual, np.empty((0, along.size))))
    assert found.intervals == ((0.0, 15.0), (315.0, 360.0))


def test_a_bump_over_the_toolface_is_located_where_it_is() -> None:
    found = deck.diagnosed(deck.outsider(STATE, "bump at one toolface", 400.0, seed=21))
    assert [claim.depends_on for claim in found.claims] == [("tf",)]
    place = found.location[0]
    assert (place.channels, place.covariate) == (("ay",), "tf_ref_deg")
    assert overlap(place.intervals, 80.0, 180.0) > 0.6


@pytest.mark.parametrize("inclination", [pytest.param(20.0, marks=FURTHER), pytest.param(45.0, marks=FURTHER), 90.0])
def test_one_inclination_that_is_off_is_no_noise_that_remembers_but_that_inclination(inclination: float) -> None:
    rng = np.random.default_rng(int(inclination))
    sensor, base = deck.sensor_and_base(STATE, rng)
    signal = np.zeros((3, STATE.n))
    signal[2] = np.abs(np.degrees(STATE.inc_rad) - inclination) < 0.1
    mean = sensor.predict(STATE) + signal * deck.scaled(signal, base, 400.0) + deck.white_noise(STATE, rng)
    found = deck.diagnosed(PoseSession(mean, np.ones(STATE.n), STATE))
    assert found.verdict in ("unknown", "law")
    # the load on z is a function of the inclination: either is told, with the other in its class
    assert all("law:offset_z_inc" in (claim.effect, *claim.equivalence_class) for claim in found.claims)
    place = found.location[0]
    assert place.channels == ("az",)
    along = {"inc_ref_deg": inclination, "load": np.cos(np.radians(inclination))}[place.covariate]
    assert any(low <= along <= high for low, high in place.intervals)
    width = sum(high - low for low, high in place.intervals)
    assert width < (60.0 if place.covariate == "inc_ref_deg" else 1.0)


@WAYS
def test_a_step_sits_after_its_time_and_a_lever_arm_where_the_tool_turns_fast(method: ProcedureParts) -> None:
    session, truth = deck.single(STATE, "bias_step", 400.0, seed=5)
    place = deck.diagnosed(session, method).location[0]
    assert place.covariate == "t_s"
    assert overlap(place.intervals, truth["t0"], float(STATE.t_s[-1])) > 0.9
    rates = tuple(2 * np.pi * np.array([0.5, -1.0, 2.0, -2.0, 1.0]))
    state = Session(RotationPlan(62.0, rates, 8.0, 1.0, 50.0), Site(latitude_rad=0.9)).rows().state
    rng = np.random.default_rng(1)
    sensor = random_sensor(rng).with_effects({"lever_arm": {"r_x": 4e-4, "r_y": 0.0}})
    turning = RotationSession(sensor.simulate(state, rng) + 8e-5 * rng.standard_normal((3, state.n)), state)
    found = diagnose_rotation(turning, ForwardModel.of({}), FREE, method=method)[0]
    assert found.claims[0].effect == "lever_arm"
    assert found.location[0].covariate == "rotor_rate_dps"
    assert [low * high > 0 and min(abs(low), abs(high)) > 400.0 for low, high in found.location[0].intervals] == [
        True, True,
    ]  # fmt: skip


def test_one_side_of_approach_cannot_show_backlash_and_it_is_reported_what_can() -> None:
    one_side = replace(STATE, direction=np.ones(STATE.n))
    rng = np.random.default_rng(2)
    sensor, _ = deck.sensor_and_base(one_side, rng)
    mean = sensor.predict(one_side) + deck.white_noise(one_side, rng)
    found = deck.diagnosed(PoseSession(mean, np.ones(one_side.n), one_side), ProcedureParts.without("laws"))
    needs = {entry.effect: entry.needs for entry in found.not_testable}
    assert needs["backlash"].startswith("approach the same poses from both sides")
    assert "rotates" in needs["lever_arm"]
    assert "backlash" not in found.minimum_detectable


def turning_rows(signal_share: float, seed: int) -> tuple[RotationSession, tuple[float, float]]:
    """A rotation with a square wave of a while on x, and when it was there."""
    rates = tuple(2 * np.pi * np.array([0.5, -1.0, 2.0, -2.0, 1.0]))
    state = Session(RotationPlan(62.0, rates, 16.0, 1.0, 50.0), Site(latitude_rad=0.9)).rows().state
    rng = np.random.default_rng(seed)
    # it grows and shrinks, and remembers: neither is a burst
    white = rng.standard_normal((3, state.n)) * (1.0 + 0.6 * np.sin(0.07 * state.t_s))
    noise = 8e-5 * (white + 0.7 * np.concatenate([np.zeros((3, 1)), white[:, :-1]], axis=1))
    middle = float(state.t_s[-1]) * 0.6
    during = np.abs(state.t_s - middle) < 5.0
    signal = np.zeros((3, state.n))
    signal[0] = np.where(during, np.sign(np.sin(8.1 * state.t_s)), 0.0) * signal_share * 8e-5
    readings = random_sensor(rng).simulate(state, rng) + noise + signal
    return RotationSession(readings, state), (middle - 5.0, middle + 5.0)


@WAYS
def test_a_vibration_of_a_while_is_found_when_it_was_there(method: ProcedureParts) -> None:
    session, (first, last) = turning_rows(1.6, 1)
    found = diagnose_rotation(session, ForwardModel.of({}), FREE, method=method)[0]
    assert found.verdict == "unknown"
    assert "comes and goes on ax" in found.remainder.hints[0]
    assert (found.location[0].channels, found.location[0].covariate) == (("ax",), "t_s")
    assert overlap(found.location[0].intervals, first, last) > 0.6


@FURTHER
@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=FURTHER)])
def test_noise_that_grows_and_shrinks_and_remembers_is_no_burst(seed: int) -> None:
    session, _ = turning_rows(0.0, seed)
    assert diagnose_rotation(session, ForwardModel.of({}), FREE)[0].verdict == "nothing_left_out"


def test_what_splits_a_lever_arm_from_the_size_of_the_triad_is_no_repetition_of_what_was_done() -> None:
    lever, size = get("lever_arm"), get("size_effect")
    assert what_splits(lever, [size]) == size.splitter
    assert what_splits(get("sag"), []) == get("sag").splitter
