"""Choices in a rotating recording: time beside the programme, memory that forgets, two that oppose, proof in means."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rotation.lines import found_lines
from highside.diagnosis.rotation.means import Sectors, mean_errors
from highside.diagnosis.rows.design import ChainDesign
from highside.diagnosis.rows.gram import HeldOutRows, RandomWalkChannel, RandomWalkGrams, accumulate
from highside.diagnosis.rows.noise import estimate
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.plan import Profile, RotationPlan, Session, Site
from highside.physics.state import ChainState
from studies.scenario import random_sensor

Array = NDArray[np.float64]

FREE = ("bias", "scale", "misalignment")
SIGMA = 8e-5
FURTHER = pytest.mark.further
WAYS = pytest.mark.parametrize(
    "method",
    [
        pytest.param(ProcedureParts.without("laws"), id="names alone"),
        pytest.param(WHOLE, id="with laws", marks=FURTHER),
    ],
)
"""Of what the names settle among themselves; that laws leave them alone: `test_library_effects_rotation`."""


@pytest.fixture(scope="module")
def rising() -> ChainState:
    """Rates that only rise, through zero: time and rate run alike."""
    rates = tuple(2 * np.pi * np.array([-2.0, -1.2, -0.5, -0.2, 0.2, 0.6, 1.2, 2.0]))
    plan = RotationPlan(50.0, rates, 20.0, 1.0, 50.0, 20.0, (0.2, 0.5, 0.1, 0.4, 0.3, 0.6, 0.2, 0.4))
    return Session(plan, Site(latitude_rad=0.9), Profile((25.0, 38.0, 33.0, 37.0, 27.0))).rows().state


def reported(
    effects: dict[str, dict[str, float]], state: ChainState, method: ProcedureParts = WHOLE
) -> DiagnosisResult:
    rng = np.random.default_rng(3)
    readings = random_sensor(rng).with_effects(effects).predict(state) + SIGMA * rng.standard_normal((3, state.n))
    return diagnose_rotation(RotationSession(readings, state), ForwardModel.of({}), FREE, method=method)[0]


def test_a_warm_up_is_not_taken_for_what_rises_with_the_rate(rising: ChainState) -> None:
    diagnosis = reported({"warmup": {"a_x": 1e-5, "a_y": -5e-5, "a_z": 4e-5, "tau": 25.0}}, rising)
    assert [claim.effect for claim in diagnosis.claims] == ["warmup"]


@WAYS
def test_two_that_nearly_cancel_are_found_together(rising: ChainState, method: ProcedureParts) -> None:
    diagnosis = reported({"backlash": {"h_tf": 2.6e-5}, "time_offset": {"t0": 3.5e-6}}, rising, method)
    assert len(diagnosis.claims) == 2
    assert "backlash" in {claim.effect for claim in diagnosis.claims}
    assert any("time_offset" in claim.equivalence_class for claim in diagnosis.claims)


@WAYS
def test_two_that_cancel_so_far_that_neither_passes_alone_are_found(rising: ChainState, method: ProcedureParts) -> None:
    diagnosis = reported({"backlash": {"h_tf": 2e-5}, "bandwidth_lag": {"tau": 2.5e-6}}, rising, method)
    assert {claim.effect for claim in diagnosis.claims} == {"backlash", "bandwidth_lag"}


@WAYS
def test_of_two_slacks_that_look_alike_the_one_without_memory_stands_first(
    rising: ChainState, method: ProcedureParts
) -> None:
    diagnosis = reported({"backlash": {"h_tf": -3e-5}}, rising, method)
    assert [claim.effect for claim in diagnosis.claims] == ["backlash"]
    assert "stiction" in diagnosis.claims[0].equivalence_class


@WAYS
def test_held_out_means_show_what_was_closed(rising: ChainState, method: ProcedureParts) -> None:
    fit = reported({"lever_arm": {"r_x": 4e-6, "r_y": -3e-6}}, rising, method).fit
    assert fit is not None and fit.heldout_rmse_before is not None and fit.heldout_rmse_after is not None
    room = fit.heldout_rmse_before**2 - fit.noise_floor**2
    assert room > 0.2 * fit.heldout_rmse_before**2
    assert (fit.heldout_rmse_before**2 - fit.heldout_rmse_after**2) / room == pytest.approx(1.0, abs=0.3)


def test_means_of_noise_are_as_large_as_they_are_expected_to_be(rising: ChainState) -> None:
    rng = np.random.default_rng(8)
    session = RotationSession(
        random_sensor(rng).predict(rising) + SIGMA * rng.standard_normal((3, rising.n)), rising
    )  # fmt: skip
    model, residual = base_fit(ForwardModel.of({}), Observed(rising, session.readings), FREE)
    design = ChainDesign(session, model, FREE)
    noise = estimate(design, residual, 1)
    grams, segments = accumulate(design, noise, residual)
    sectors = Sectors.of(design, noise, residual, segments, design.base, [0])
    errors = mean_errors(HeldOutRows(design, grams), sectors, np.empty(0, dtype=np.intp))
    count = float(errors.count.sum())
    assert count == 360
    assert errors.expected.sum() > count
    assert abs(errors.energy.sum() - errors.expected.sum()) < 4 * np.sqrt(2 * count)


def test_what_forgets_is_no_walk(rising: ChainState) -> None:
    """A colour that the filter leaves is found as a level that forgets, a walk as a walk."""
    rng = np.random.default_rng(4)
    white = rng.standard_normal((3, rising.n))
    forgets = np.zeros_like(white)
    keep = float(np.exp(-1 / 100.0))
    drive = np.sqrt(0.006 * (1 - keep**2)) * rng.standard_normal(white.shape)
    for k in range(1, rising.n):
        forgets[:, k] = keep * forgets[:, k - 1] + drive[:, k]
    walk = 0.01 * np.cumsum(rng.standard_normal(white.shape), axis=1)
    sensor = random_sensor(rng).predict(rising)
    for level, walks in ((forgets, False), (walk, True)):
        session = RotationSession(sensor + SIGMA * (white + level), rising)
        model, residual = base_fit(ForwardModel.of({}), Observed(rising, session.readings), FREE)
        design = ChainDesign(session, model, FREE)
        # the colour is left to the memory on purpose
        grams, _ = accumulate(design, estimate(design, residual, 1, coloured=False), residual)
        base = np.unique(design.where[design.base])
        found = [
            RandomWalkChannel(RandomWalkGrams.of(gram), base[base >= 0]).memory(np.empty(0, dtype=np.intp))
            for gram in grams
        ]
        # a walk runs on all three channels; one of them may by chance be what the slowest level that forgets does too
        assert sum(memory.is_random_walk for memory in found) >= (2 if walks else 0)
        assert walks or not any(memory.is_random_walk for memory in found)


@pytest.mark.parametrize("seed", range(5, 11))
def test_a_line_between_two_frequencies_of_the_spectrum_is_found(rising: ChainState, seed: int) -> None:
    """At a strength of 100; at 70 it stays below the threshold with some noises."""
    rng = np.random.default_rng(seed)
    seconds = float(np.ptp(rising.t_s))
    hertz = (np.round(7.3 * seconds) + 0.5) / seconds
    session = RotationSession(
        random_sensor(rng).predict(rising) + SIGMA * rng.standard_normal((3, rising.n)), rising
    )  # fmt: skip
    session.readings[1] += SIGMA * np.sqrt(2 * 100.0 / rising.n) * np.sin(2 * np.pi * hertz * rising.t_s)
    _, residual = base_fit(ForwardModel.of({}), Observed(rising, session.readings), FREE)
    tones = [line.value for line in found_lines(session, residual) if line.effect == "tone"]
    assert min(abs(tone - hertz) for tone in tones) < 0.3 / seconds
