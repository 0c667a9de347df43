"""Long recordings: worked on in runs of rows, some rows diagnosed first, and what is rare not overlooked."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.fit import base_fit, joint_fit, second_order_of
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.rival_refit import beside_refits
from highside.diagnosis.core.rivals import Refitted, Rivalry
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rotation.pilot import may_be_nonlinear
from highside.diagnosis.rotation.policy import PILOT
from highside.diagnosis.rows.design import ChainDesign
from highside.diagnosis.rows.noise import plain
from highside.diagnosis.rows.session import RotationSession
from highside.physics.effect import Effect
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.plan import Profile, RotationPlan, Session, Site
from highside.physics.state import ChainState
from studies.scenario import random_sensor

FURTHER = pytest.mark.further

Array = NDArray[np.float64]
FREE = ("bias", "scale", "misalignment")
STRONG = {"lever_arm": {"r_x": 8e-3, "r_y": -3e-3}, "time_offset": {"t0": 2e-3}}


def turning(hold_s: float) -> ChainState:
    """Five rates at 50 Hz, ramps of one second between them."""
    plan = RotationPlan(
        62.0,
        tuple(2 * np.pi * np.array([0.5, -1.0, 2.0, -2.0, 1.0])),
        hold_s,
        1.0,
        50.0,
        20.0,
        (0.1, 0.5, 0.2, 0.4, 0.3),
    )
    return Session(plan, Site(latitude_rad=0.9), Profile((25.0, 40.0, 28.0))).rows().state


def recording(effects: dict[str, dict[str, float]], state: ChainState, *, gyros: bool = False) -> RotationSession:
    rng = np.random.default_rng(3)
    sensor = random_sensor(rng).with_effects(effects)
    readings = sensor.predict(state) + 8e-5 * rng.standard_normal((3, state.n))
    if gyros:
        readings = np.concatenate([readings, sensor.gyro(state) + 4e-4 * rng.standard_normal((3, state.n))])
    return RotationSession(readings, state)


@pytest.mark.parametrize("effect", [e for e in all_effects().values() if not e.random], ids=lambda e: e.id)
def test_an_effect_that_does_not_remember_does_the_same_in_a_run_of_rows(effect: Effect) -> None:
    state = turning(6.0)
    vector = np.array([p.default if p.shape else p.typical for p in effect.parameters])
    model = ForwardModel.of({effect.id: dict(zip((p.name for p in effect.parameters), vector, strict=True))})
    whole = np.concatenate([model.predict(state), model.gyro(state)])
    part = state.rows(np.concatenate([[0], np.arange(700, 1000)]))
    alone = np.concatenate([model.predict(part), model.gyro(part)])[:, 1:]
    same = np.allclose(alone, whole[:, 700:1000], atol=1e-13)
    # one that remembers must say so; a loop that is not run through may look the same for a while
    assert same or effect.remembers


def test_inner_products_and_bends_by_runs_are_those_of_the_whole() -> None:
    session = recording(STRONG, turning(25.0))
    whole = Observed(session.state, session.readings)
    parts = Observed(session.state, session.readings, by_parts=True)
    model, residual = base_fit(ForwardModel.of({}), whole, FREE)
    _, other = base_fit(ForwardModel.of({}), parts, FREE)
    assert np.abs(residual - other).max() < 1e-12
    design = ChainDesign(session, model, FREE)
    names = [c.id for c in design.candidates]
    terms = [Term(names.index(name), 0) for name in STRONG]
    noise = plain(np.full(3, 8e-5), session.n)
    one, two = (joint_fit(model, seen, FREE, design.candidates, terms, noise, 1e4) for seen in (whole, parts))
    for name in STRONG:
        for key, value in one.parameters[name].items():
            assert two.parameters[name][key].value == pytest.approx(value.value, rel=1e-9)
            assert two.parameters[name][key].std == pytest.approx(value.std, rel=1e-6)
    assert one.second_order is not None
    results = [second_order_of(model, one, seen, FREE, design.candidates, terms) for seen in (whole, parts)]
    assert np.abs(results[0] - results[1]).max() < 1e-12
    assert np.abs(results[0] - one.second_order).max() < 1e-12


def test_some_functions_are_those_among_all() -> None:
    session = recording({}, turning(25.0), gyros=True)
    design = ChainDesign(session, ForwardModel.of({}), FREE)
    rng = np.random.default_rng(2)
    only = [rng.permutation(m)[: m // 3] for m in design.sizes]
    part = slice(300, 500)
    some, every = design.functions(part, session.readings, only), design.functions(part, session.readings)
    for few, own, many in zip(some, only, every, strict=True):
        assert np.array_equal(few[:-1], many[own])
        assert np.array_equal(few[-1], many[-1])


def test_some_rows_are_drawn_one_from_each_run() -> None:
    session = recording({}, turning(25.0))
    some = session.thinned(1000, 1)
    every = -(-session.n // 1000)
    rows = np.searchsorted(session.state.t_s, some.state.t_s)
    assert np.array_equal(rows // every, np.arange(some.n))
    assert len(np.unique(rows % every)) == every
    assert np.array_equal(some.readings, session.readings[:, rows])
    assert some.step_s == pytest.approx(every * session.step_s)


def test_a_column_shows_on_a_channel_that_it_reaches_in_rare_ramps_alone() -> None:
    # ramps are 4 of 1504 s: what a late clock does to the rate about the tool's axis shows in them alone
    session = recording({}, turning(300.0), gyros=True)
    design = ChainDesign(session, ForwardModel.of({}), FREE)
    late = next(c for c in design.candidates if c.id == "time_offset")
    assert np.all(design.where[late.variants[0].columns][:, [0, 1, 5]] >= 0)


def test_only_a_strong_effect_is_looked_for_in_some_rows_first() -> None:
    state = turning(160.0)
    assert state.n > PILOT.many_rows
    assert may_be_nonlinear(recording(STRONG, state), ForwardModel.of({}), FREE, 1)
    assert not may_be_nonlinear(
        recording({"lever_arm": {"r_x": 2e-5, "r_y": 1e-5}}, state), ForwardModel.of({}), FREE, 1
    )


@FURTHER
def test_strong_effects_of_a_long_recording_are_distinguished_from_what_is_the_same_to_first_order() -> None:
    session = recording(STRONG, turning(160.0))
    diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE)
    assert diagnosis.verdict == "named"
    assert {c.effect: c.equivalence_class for c in diagnosis.claims} == {
        "lever_arm": ("lever_arm",),
        "time_offset": ("time_offset",),
    }
    for claim in diagnosis.claims:
        for name, value in STRONG[claim.effect].items():
            fitted = claim.parameters[name]
            assert fitted.low - fitted.std < value < fitted.high + fitted.std


def test_weak_effects_of_a_long_recording_keep_their_class() -> None:
    session = recording({"time_offset": {"t0": 4e-5}}, turning(160.0))
    diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE)
    (claim,) = diagnosis.claims
    # laws that this recording cannot tell from the name may be told beside its rivals
    assert {name for name in claim.equivalence_class if not name.startswith("law:")} == {"time_offset", "bandwidth_lag"}


def test_a_full_fit_puts_a_rival_into_the_class_and_takes_it_out() -> None:
    best = [Term(k, 0) for k in range(4)]
    found = Rivalry(np.array([0.0, 1.4, 50.0, 8.0]), best, (0, 1, 3))
    results = beside_refits(found, [Refitted(best[1], 400.0), Refitted(best[2], 2.0), Refitted(best[3], 9.0)])
    assert results.same == (0, 3, 2)
    assert results.delta_bic.tolist() == [0.0, 400.0, 2.0, 9.0]
