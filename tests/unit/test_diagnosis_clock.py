"""Clocks beside another program's prediction: lags of any size, a rate that is off, times of files on their own."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.spatial.transform import Rotation

from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_simulation
from highside.diagnosis.simulation.alignment import align
from highside.diagnosis.simulation.session import RATES, SimulationSession, simulation_session
from highside.diagnosis.simulation.starts import measured_start
from studies.open_world import beside_simulation
from studies.open_world.deck import rng_of

Array = NDArray[np.float64]
Columns = dict[str, Array]

FURTHER = pytest.mark.further
RATE_HZ, LENGTH_S, NOISE_G = 100.0, 40.0, 1e-3
AXES = ("ax_g", "ay_g", "az_g")
T_S = np.arange(0, LENGTH_S, 1 / RATE_HZ)


@cache
def by_hand(seed: int = 1) -> Array:
    """(3, N) specific force of a sensor that a hand turns and moves about, g."""
    rng = np.random.default_rng(seed)
    turning = sosfiltfilt(butter(2, [0.2, 2.5], "band", fs=RATE_HZ, output="sos"), rng.standard_normal((3, T_S.size)))
    turning *= np.radians(60) / turning.std(axis=1, keepdims=True)
    attitude, down = np.eye(3), np.empty((3, T_S.size))
    for k, step in enumerate(Rotation.from_rotvec(turning.T / RATE_HZ).as_matrix()):
        down[:, k] = attitude.T[:, 2]
        attitude = attitude @ step
    moved = sosfiltfilt(butter(2, [0.3, 4.0], "band", fs=RATE_HZ, output="sos"), rng.standard_normal((3, T_S.size)))
    return np.asarray(down + 0.2 * moved / moved.std())


def missing_motion() -> Array:
    """(3, N) that the prediction does not have, for some seconds, g."""
    rng = np.random.default_rng(4)
    moved = sosfiltfilt(butter(2, [0.5, 4.0], "band", fs=RATE_HZ, output="sos"), rng.standard_normal((3, T_S.size)))
    return np.asarray(0.15 * np.exp(-(((T_S - 20.0) / 8.0) ** 2)) * moved / moved.std())


def of(force: Array, t_s: Array = T_S, noise: float = 0.0, seed: int = 7) -> Columns:
    """A file's columns."""
    rows = force + noise * np.random.default_rng(seed).standard_normal(force.shape)
    return {"t_s": t_s, **dict(zip(AXES, rows, strict=False))}


def reported(recorded: Columns, predicted: Columns, *, laws: bool = True) -> tuple[DiagnosisResult, SimulationSession]:
    session = simulation_session(recorded, predicted)
    return diagnose_simulation(session, (), method=WHOLE if laws else ProcedureParts.without("laws"))[0], session


def names(found: DiagnosisResult) -> list[str]:
    """The effects of the library that are claimed: what a filter at the end of the band leaves may be a law beside."""
    return [claim.effect for claim in found.claims if not claim.effect.startswith("law")]


@pytest.mark.parametrize(
    "early_s", [0.01, pytest.param(0.03, marks=FURTHER), 0.05, pytest.param(0.2, marks=FURTHER), 2.0, -0.03]
)
def test_a_prediction_that_is_early_is_named_a_time_offset_and_nothing_else(early_s: float) -> None:
    """At 50 ms it was a lag of 40 ms beside an offset of 17 ms, at 200 ms a lag of 0.6 s, a scale and a lever arm."""
    found, session = reported(of(by_hand(), noise=NOISE_G), of(by_hand(), T_S - early_s))
    assert [claim.effect for claim in found.claims] == ["time_offset"]
    offset = found.claims[0].parameters["t0"]
    assert offset.value == pytest.approx(early_s, abs=1e-4)
    assert abs(offset.value - early_s) < 4 * offset.std
    assert session.alignment.same_clock
    assert session.alignment.lag_s == pytest.approx(early_s, abs=1e-3)
    assert dict(session.alignment.lags_s) == pytest.approx(dict.fromkeys(AXES, early_s), abs=1e-3)


def test_where_a_low_pass_begins_and_ends_nothing_is_compared() -> None:
    """The recording began where the prediction went on: 1,000 times the noise, for which six laws of two gyros were
    claimed beside the clock."""
    rng = np.random.default_rng(5)
    waves = list(zip(rng.uniform(0.1, 1.0, 5), rng.uniform(0, 6, 5), strict=True))

    def motion(t_s: Array) -> Array:
        return np.stack([sum(np.sin(2 * np.pi * f * t_s + p + axis) for f, p in waves) for axis in range(3)])

    longer = np.arange(-4.0, LENGTH_S + 4.0, 1 / 143)
    session = simulation_session(of(motion(T_S), noise=NOISE_G), of(motion(longer), longer - 0.01))
    moved = session.about({"time_offset": (0.01,)})
    assert moved.low_passed
    assert moved.omitted is not None
    left = np.abs(moved.readings - moved.predicted)
    assert left[:, ~moved.omitted].max() < 5 * NOISE_G
    # a second and a half of either end, and no more
    assert moved.omitted.mean() < 0.2
    # what is as long as the recording ends with it
    ends = simulation_session(of(motion(T_S), noise=NOISE_G), of(motion(T_S), T_S - 0.01))
    about = ends.about({"time_offset": (0.01,)})
    assert about.omitted is not None
    assert np.abs(about.readings - about.predicted)[:, ~about.omitted].max() < 5 * NOISE_G


def test_of_a_motion_that_runs_fast_the_same_parts_are_low_passed() -> None:
    """A low-pass of one edge took more of the faster one: `cross_coupling` was named beside `clock_skew`."""
    off, parts = 0.05, ((2.4, 1.0), (4.8, 0.3), (7.2, 0.1), (9.6, 0.03))

    def motion(t_s: Array) -> Array:
        return np.stack([sum(a * np.cos(2 * np.pi * f * t_s + axis) for f, a in parts) for axis in range(3)])

    session = simulation_session(of(motion(T_S), noise=NOISE_G), of(motion((1 + off) * T_S)))
    assert session.low_passed
    moved = session.about({"clock_skew": (off / (1 + off),)})
    assert moved.omitted is not None
    left = (moved.readings - moved.predicted)[:, ~moved.omitted]
    assert np.abs(left).max() < 5 * NOISE_G


def filtered(tau_s: float) -> Array:
    """What a first-order filter of this time constant makes of the motion."""
    decay, force = np.exp(-1 / RATE_HZ / tau_s), by_hand()
    start = force[:, :1]
    return np.asarray(lfilter([(1 - decay) / 2, (1 - decay) / 2], [1.0, -decay], force - start, axis=1) + start)


def test_a_filters_delay_is_no_time_offset() -> None:
    found, session = reported(of(filtered(0.04), noise=NOISE_G), of(by_hand()))
    assert names(found) == ["bandwidth_lag"]
    assert found.claims[0].parameters["tau_accel"].value == pytest.approx(0.04, abs=1e-3)
    assert session.alignment.lag_s > 0.02


def test_an_offset_beside_another_effect_keeps_its_size() -> None:
    force = by_hand() * np.array([[1.01], [1.0], [1.0]])
    found, _ = reported(of(force, noise=NOISE_G), of(by_hand(), T_S - 0.03))
    sizes = {claim.effect: claim.parameters for claim in found.claims}
    assert set(sizes) == {"time_offset", "scale"}
    assert sizes["time_offset"]["t0"].value == pytest.approx(0.03, abs=1e-4)
    assert sizes["scale"]["k_ax_g"].value == pytest.approx(0.01, abs=5e-4)


def pendulum(frequency_hz: float) -> Array:
    """(2, N) along and across of a pendulum that starts from one side."""
    phase = 2 * np.pi * frequency_hz * T_S
    return np.stack([0.2 * np.sin(phase), 0.05 * np.cos(2 * phase)])


@pytest.mark.parametrize("off", [0.02, -0.03, 0.05])
def test_a_periodic_motion_with_a_constant_that_is_off_is_a_rate(off: float) -> None:
    """Shifted by whole periods until too little was left to compare, once."""
    found, session = reported(of(pendulum(0.8 * (1 - off)), noise=NOISE_G), of(pendulum(0.8)))
    assert names(found) == ["clock_skew"]
    assert found.claims[0].parameters["eps"].value == pytest.approx(off, abs=2e-4)
    assert "rate of the clock or of the motion" in found.claims[0].story
    assert session.alignment.same_clock
    assert session.alignment.rate == pytest.approx(off, abs=2e-3)


@pytest.mark.parametrize("off", [-0.03, -0.06, 0.04])
def test_beyond_the_end_of_a_slow_prediction_nothing_is_compared(off: float) -> None:
    """Its last value was taken to go on: whole periods of the motion were a lag, of which less lay beyond the end."""
    own = dict(zip(AXES, pendulum(0.8 * (1 - off)), strict=False))
    found = align(T_S, own, T_S, dict(zip(AXES, pendulum(0.8), strict=False)))
    assert found.rate == pytest.approx(off, abs=2e-3)
    assert found.lag_s == pytest.approx(0.0, abs=0.02)


def test_a_motion_that_runs_slow_with_its_rates_is_no_clock() -> None:
    """The factor of the rates explains little of all, and was let go: 300 times the noise was left of them."""
    case = beside_simulation.frequency_off("slow", rng_of("b1", "slow"), -0.03)
    assert case.prediction is not None
    gyros = ({"t_s": side["t_s"], **{n: side[n] for n in RATES}} for side in (case.recording, case.prediction))
    session = simulation_session(*gyros)
    found = diagnose_simulation(session, (), method=ProcedureParts.without("laws"))[0]
    assert (found.verdict, names(found)) == ("named", ["motion_rate"])
    assert found.claims[0].parameters["eps"].value == pytest.approx(-0.03 / 0.97, rel=1e-3)
    assert found.claims[0].share == pytest.approx(1.0)
    assert found.remainder.hints[0].startswith("the motion of the prediction and its rates are 0.97 times as fast")


@pytest.mark.parametrize("late_s", [0.005, pytest.param(0.3, marks=FURTHER)])
def test_beside_a_motion_that_is_missing_the_shift_of_the_clock_is_told(late_s: float) -> None:
    """What is missing withdrew every name, and laws of single channels shared the shift out among them."""
    found, _ = reported(of(by_hand() + missing_motion(), noise=NOISE_G), of(by_hand(), T_S - late_s))
    assert names(found) == ["time_offset"]
    offset = found.claims[0].parameters["t0"]
    assert offset.value == pytest.approx(late_s, abs=1e-3)
    assert offset.low < late_s < offset.high


def test_one_late_channel_is_no_clock_beside_a_motion_that_is_missing() -> None:
    late = np.stack([np.interp(T_S - tau, T_S, row) for tau, row in zip((0.0, 0.0, 0.03), by_hand(), strict=True)])
    found, _ = reported(of(late + missing_motion(), noise=NOISE_G), of(by_hand()))
    assert "time_offset" not in names(found)


def test_a_clock_that_runs_off_by_little_is_a_rate_too() -> None:
    force = np.stack([CubicSpline(T_S, row)(T_S * (1 - 5e-4)) for row in by_hand()])
    found, _ = reported(of(force, noise=NOISE_G), of(by_hand()))
    assert names(found) == ["clock_skew"]
    assert found.claims[0].parameters["eps"].value == pytest.approx(5e-4, abs=5e-6)


def test_of_a_periodic_motion_the_nearest_lag_is_taken() -> None:
    session = simulation_session(of(pendulum(0.8), noise=NOISE_G), of(pendulum(0.8), T_S - 0.1))
    assert session.alignment.lag_s == pytest.approx(0.1, abs=2e-3)
    assert session.alignment.rate == 0.0


@pytest.mark.parametrize(("how", "same"), [("auto", True), ("none", True), ("offset", False)])
def test_whose_clock_it_is_may_be_said(how: str, same: bool) -> None:
    session = simulation_session(of(by_hand(), noise=NOISE_G), of(by_hand(), T_S - 0.5), how)  # type: ignore[arg-type]
    assert session.alignment.same_clock is same
    assert session.alignment.lag_s == pytest.approx(0.5, abs=1e-3)
    assert session.alignment.shift_s == pytest.approx(0.0 if same else 0.5, abs=1e-3)


def test_files_with_a_zero_of_time_of_their_own_leave_no_offset_behind() -> None:
    """The lag is measured to a share of a row; what it lacks is adjusted, and no physics."""
    found, session = reported(of(by_hand(), noise=NOISE_G), of(by_hand(), T_S + 5000.003))
    assert not session.alignment.same_clock
    assert found.verdict == "nothing_left_out"
    assert "time_offset" in {entry.effect for entry in found.not_testable}


@pytest.mark.parametrize("late_s", [0.004, 0.05])
def test_one_channel_that_is_late_is_named_with_its_delay(late_s: float) -> None:
    """4 ms were three laws without a name."""
    force = by_hand().copy()
    force[1] = CubicSpline(T_S, force[1])(T_S - late_s)
    found, _ = reported(of(force, noise=NOISE_G), of(by_hand()), laws=False)
    assert names(found) == ["late_channel"]
    assert {n: p.value for n, p in found.claims[0].parameters.items()} == {"t0_ay_g": pytest.approx(late_s, abs=1e-4)}


def test_a_start_is_what_was_measured_beyond_first_order() -> None:
    force = by_hand().copy()
    force[1] = CubicSpline(T_S, force[1])(T_S - 0.05)
    session = simulation_session(of(force, noise=NOISE_G), of(by_hand()))
    (own_s,) = measured_start(session).values()
    assert max(own_s) == pytest.approx(0.05, abs=2e-3)
    assert sorted(own_s)[0] == 0.0
    # all of them late are a clock
    late = simulation_session(of(by_hand(), noise=NOISE_G), of(by_hand(), T_S - 0.05))
    assert measured_start(late) == {"time_offset": (pytest.approx(0.05, abs=2e-3),)}
    # a rate that is off is no offset as well, by which it is measured wrongly
    slow = simulation_session(of(pendulum(0.8 * 1.01), noise=NOISE_G), of(pendulum(0.8)))
    assert measured_start(slow).keys() == {"clock_skew"}
