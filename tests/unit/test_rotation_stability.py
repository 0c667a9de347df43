"""Rows that are known by inner products alone: a size that changes over the session is no constant."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.stability import best_change, stability, stability_of_inner
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rotation.steps import found_step
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from studies.scenario import random_sensor
from tests.unit.test_diagnosis_rotation import FREE, SIGMA, turning

FURTHER = pytest.mark.further

N, NOISE = 900, 0.3
T = np.arange(N) / N


@pytest.mark.parametrize(("late", "steady"), [(1.0, True), (0.3, False)])
def test_inner_products_say_of_stability_what_rows_say(late: float, steady: bool) -> None:
    base = np.stack([np.ones(N), np.sin(9 * T)])
    own = np.stack([np.cos(20 * T), T**2])
    wave = np.cos(20 * T) * np.where(T < 0.5, 1, late)
    residual = (wave + NOISE * np.random.default_rng(0).standard_normal(N)) / NOISE
    part = np.arange(N) * 3 // N
    space = span(base / NOISE)
    rows = stability(
        own[:, None],
        lambda c: c.reshape(len(c), -1) / NOISE,
        space,
        outside(space, residual),
        800.0,
        {"thirds": part},
    )
    every = np.concatenate([base / NOISE, own / NOISE, residual[None]])
    cut = np.stack([every * (part == k) for k in range(3)])
    inner = stability_of_inner({"thirds": np.einsum("iak,jbk->ijab", cut, cut)}, len(own), 800.0)
    assert rows is not None and inner is not None
    assert inner.stable == steady
    assert inner.log_p == pytest.approx(rows.log_p, rel=1e-6)
    assert inner.share == pytest.approx(rows.share, rel=1e-6)
    assert inner.factors == pytest.approx(rows.factors, rel=1e-6)


def test_one_change_of_a_size_is_found_where_it_is() -> None:
    wave = np.cos(20 * T)
    residual = (wave * np.where(T < 0.7, 1.0, 2.0)) / NOISE
    every = np.stack([np.ones(N) / NOISE, wave / NOISE, residual])
    blocks = np.stack([rows @ rows.T for rows in np.split(every, 10, axis=1)])
    change = best_change(blocks, np.array([0]), np.array([1]))
    assert change is not None
    assert change.factors[2] == pytest.approx(2 * change.factors[0], rel=0.01)
    assert change.gain == pytest.approx(float(np.sum((residual - residual.mean()) ** 2)), rel=2e-3)


@pytest.mark.parametrize("phase", [0.0, 0.9, 2.4, 4.0])
def test_a_wave_of_a_size_is_found_at_any_phase(phase: float) -> None:
    """One step or a straight line takes a half of what a wave of the size leaves, or nothing."""
    signal = np.cos(200 * T)
    residual = signal * (1 + 0.4 * np.cos(2 * np.pi * T - phase)) / NOISE
    every = np.stack([np.ones(N) / NOISE, signal / NOISE, residual])
    blocks = np.stack([rows @ rows.T for rows in np.split(every, 10, axis=1)])
    change = best_change(blocks, np.array([0]), np.array([1]))
    assert change is not None
    left = float(np.sum((residual - every[1] * (residual @ every[1]) / (every[1] @ every[1])) ** 2))
    assert change.added > 0.85 * left


def reported(factor: np.ndarray) -> DiagnosisResult:
    """A rotation about an axis that the sensors are off by 0.1 mm, times a factor (n,) of each row."""
    state = turning()
    sensor = random_sensor(np.random.default_rng(4))
    plain = sensor.predict(state)
    thrown = sensor.with_effects({"lever_arm": {"r_x": 1.2e-4, "r_y": -9e-5}}).predict(state) - plain
    readings = plain + factor * thrown + SIGMA * np.random.default_rng(8).standard_normal(plain.shape)
    session = RotationSession(readings, state)
    return diagnose_rotation(session, ForwardModel.of({}), FREE, method=ProcedureParts.without("laws"))[0]


@FURTHER
def test_a_lever_arm_that_changes_over_the_session_has_not_that_name() -> None:
    n = turning().n
    constant = reported(np.ones(n))
    assert [(claim.effect, claim.stable) for claim in constant.claims] == [("lever_arm", True)]
    changing = reported(np.where(np.arange(n) < 0.45 * n, 1.35, 0.65))
    assert "lever_arm" not in {name for claim in changing.claims for name in claim.equivalence_class}
    assert "lever_arm" in changing.remainder.changing
    assert any("for it is no constant" in hint for hint in changing.remainder.hints)
    waving = reported(1 + 0.35 * np.cos(2 * np.pi * np.arange(n) / n))
    assert "lever_arm" not in {name for claim in waving.claims for name in claim.equivalence_class}


def test_a_lever_arm_that_comes_and_goes_is_refused_or_reported_as_doubtful() -> None:
    n = turning().n
    found = reported(1 + 0.4 * np.cos(2 * np.pi * np.arange(n) / n))
    names = {name for claim in found.claims for name in claim.equivalence_class}
    assert "lever_arm" not in names or any(hint.startswith("lever_arm may be") for hint in found.remainder.hints)


@pytest.mark.parametrize(("size", "kept"), [(0.0, True), (3e-4, False)])
def test_sizes_beside_a_large_remainder_are_wider_and_warned_of(size: float, kept: bool) -> None:
    state = turning()
    sensor = random_sensor(np.random.default_rng(4))
    readings = sensor.with_effects({"lever_arm": {"r_x": 2.4e-3, "r_y": -1.8e-3}}).predict(state)
    readings = readings + SIGMA * np.random.default_rng(8).standard_normal(readings.shape)
    readings[0] += size * np.sign(np.cos(5 * state.tf_rad)) * np.sign(state.rotor_rate_radps)
    session = RotationSession(readings, state)
    found = diagnose_rotation(session, ForwardModel.of({}), FREE, method=ProcedureParts.without("laws"))[0]
    if kept:
        assert [claim.effect for claim in found.claims] == ["lever_arm"]
    warned = any("beside a remainder of" in hint for hint in found.remainder.hints)
    assert warned != kept or not found.claims


def test_at_one_inclination_a_product_of_loads_ties_with_a_law_of_the_toolface() -> None:
    state = turning()
    sensor = random_sensor(np.random.default_rng(4)).with_effects({"cross_product": {"k_x_xy": 2e-4}})
    readings = sensor.predict(state) + SIGMA * np.random.default_rng(3).standard_normal((3, state.n))
    session = RotationSession(readings, state)
    (claim,) = diagnose_rotation(session, ForwardModel.of({}), FREE, method=ProcedureParts.without("laws"))[0].claims
    assert claim.effect == "cross_product"
    assert "law:offset_x_tf" in claim.equivalence_class
    assert "turn at another inclination too" in claim.next_manoeuvre


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_the_instant_of_a_large_step_is_found_to_a_row(size: float) -> None:
    state = turning()
    residual = SIGMA * np.random.default_rng(2).standard_normal((3, state.n))
    at = round(0.613 * state.n)
    residual[1, at:] += size
    found = found_step(RotationSession(residual, state), residual)
    if size == 0.0:
        assert found is None
    else:
        assert found is not None
        assert state.t_s[at - 1] < found + state.t_s[0] < state.t_s[at]
