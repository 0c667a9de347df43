"""A rotation of which rows are missing: each row has its own time, and what is there is diagnosed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside import api
from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.rotation.bursts import found_burst
from highside.diagnosis.rotation.lines import found_lines
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.rows.spectrum import on_grid
from highside.physics.forward import ForwardModel
from highside.physics.noise import autoregressive
from highside.physics.plan import Profile, RotationPlan, Session, Site
from highside.physics.state import ChainState, slopes, unwrapped

Array = NDArray[np.float64]

MODEL = {"sensor": {"free": ["bias", "scale", "misalignment"]}}
SENSOR = {"bias": {"b_x": 1.2e-3, "b_y": -8e-4, "b_z": 1.5e-3}, "scale": {"s_x": 3e-3, "s_y": -2e-3, "s_z": 1e-3}}
SIGMA = 8e-5


def turning(hz: float = 40.0) -> ChainState:
    plan = RotationPlan(62.0, tuple(2 * np.pi * np.array([0.5, -1.0, 2.0, -2.0])), 10.0, 1.0, hz, 20.0)
    return Session(plan, Site(), Profile((25.0, 40.0, 28.0))).rows().state


def lost_rows(n: int, share: float, how: str, seed: int) -> NDArray[np.bool_]:
    rng = np.random.default_rng(seed)
    if how == "single":
        return np.asarray(rng.random(n) < share)
    lost = np.zeros(n, dtype=bool)
    while lost.mean() < share:
        start = int(rng.integers(0, n))
        lost[start : start + int(rng.integers(10, 100))] = True
    return lost


def columns_of(seed: int, colour: float = 0.0, **effects: dict[str, float]) -> dict[str, Array]:
    rng, state = np.random.default_rng(seed), turning()
    readings = ForwardModel.of({**SENSOR, **effects}).simulate(state, rng)
    readings = readings + autoregressive((3, state.n), SIGMA, colour, rng)
    columns = {"t_s": np.asarray(state.t_s), "inc_ref_deg": np.degrees(state.inc_rad)}
    columns |= {"tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0), "temp_c": np.asarray(state.temp_c)}
    return columns | dict(zip(("ax_g", "ay_g", "az_g"), readings, strict=True))


@pytest.mark.parametrize(("how", "colour"), [("single", 0.6), ("burst", 0.0), ("values", 0.0)])
def test_an_effect_is_named_although_rows_are_missing(how: str, colour: float) -> None:
    """It was refused as bad data from 1 % on."""
    columns = columns_of(3, colour, quadratic={"k2_x": 4e-4})
    n = columns["t_s"].size
    lost = lost_rows(n, 0.25, "single" if how == "values" else how, 4)
    if how == "values":
        columns["ay_g"] = np.where(lost, np.nan, columns["ay_g"])
    else:
        columns = {name: column[~lost] for name, column in columns.items()}
    method = ProcedureParts.without("laws") if colour else ProcedureParts()
    found = api.diagnose(columns, MODEL, method=method).found
    assert found.verdict == "named"
    assert [claim.effect for claim in found.claims] == ["quadratic"]
    size = found.claims[0].parameters["k2_x"]
    assert abs(size.value - 4e-4) < 4 * size.std
    (remark,) = found.intake
    assert remark.check == ("missing_values" if how == "values" else "dropped_frames")
    assert str(int(lost.sum())) in remark.remedy or how == "burst"


def test_nothing_is_found_where_nothing_is_left_out() -> None:
    columns = columns_of(5, 0.6)
    lost = lost_rows(columns["t_s"].size, 0.3, "burst", 6)
    kept = {name: column[~lost] for name, column in columns.items()}
    found = api.diagnose(kept, MODEL, method=ProcedureParts.without("laws")).found
    assert found.verdict == "nothing_left_out"
    assert [finding.check for finding in found.intake] == ["dropped_frames"]


def test_a_recording_of_which_most_is_lost_is_still_bad_data() -> None:
    columns = columns_of(5)
    kept = np.random.default_rng(1).random(columns["t_s"].size) < 0.3
    columns |= {"seq": np.arange(columns["t_s"].size, dtype=float)}
    found = api.diagnose({name: column[kept] for name, column in columns.items()}, MODEL).found
    assert found.verdict == "bad_data"
    assert found.intake[0].check == "dropped_frames"


@pytest.mark.parametrize("how", ["single", "burst"])
def test_the_toolface_and_its_rate_go_on_across_a_gap(how: str) -> None:
    """A gap of more than half a turn was unwrapped the short way round, and its rate was wrong on both sides."""
    state = turning()
    kept = ~lost_rows(state.n, 0.3, how, 7)
    t_s, tf = np.asarray(state.t_s)[kept], np.asarray(state.tf_rad)[kept]
    steady = np.abs(np.asarray(state.rotor_accel_radps2)[kept]) < 1e-9
    whole = unwrapped(np.mod(tf, 2 * np.pi), t_s)
    turns = (whole - tf - (whole - tf)[0]) / (2 * np.pi)
    assert np.allclose(turns, np.round(turns), atol=1e-9)
    rate = slopes(whole, t_s)
    off = np.abs(rate - np.asarray(state.rotor_rate_radps)[kept])
    assert np.mean(off[steady] < 1e-6) > 0.98
    assert off.max() < 2 * np.pi * 2


def test_a_line_and_a_burst_keep_their_frequency_across_gaps() -> None:
    state = turning()
    kept = ~lost_rows(state.n, 0.2, "single", 8)
    rng = np.random.default_rng(9)
    t_s = np.asarray(state.t_s)
    hum = SIGMA * rng.standard_normal((3, state.n)) + 4e-5 * np.sin(2 * np.pi * 7.3 * t_s)
    session = RotationSession(hum[:, kept], state.rows(kept))
    lines = [line.value for line in found_lines(session, session.readings) if abs(line.value - 7.3) < 0.02]
    assert lines
    shaken = rng.standard_normal((3, state.n)) + 1.0 * np.sin(2 * np.pi * 11.0 * t_s) * ((t_s > 10) & (t_s < 20))
    burst = found_burst([(slice(0, session.n), shaken[:, kept])], session.places)
    assert burst is not None
    assert abs(burst.frequency * 40.0 - 11.0) < 0.1
    assert abs(burst.start / 40.0 - 10.0) < 2.0
    assert abs(burst.stop / 40.0 - 20.0) < 2.0


def test_rows_at_their_places_leave_the_missing_ones_empty() -> None:
    rows = np.array([[1.0, 2.0, 3.0]])
    assert np.array_equal(on_grid(rows, np.array([5.0, 6.0, 7.0])), rows)
    assert np.array_equal(on_grid(rows, np.array([5.0, 7.0, 8.0])), [[1.0, 0.0, 2.0, 3.0]])
