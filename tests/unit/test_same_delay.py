"""Beside a prediction: a filter's lag and channels that are late by the same."""

from dataclasses import replace

import numpy as np
import pytest

from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Remainder, Rival
from highside.diagnosis.simulation.same_delay import taken_alike, with_the_other
from highside.physics.channels import Channels
from highside.physics.effects.bandwidth_lag import EFFECT as BANDWIDTH_LAG

KINDS = {"accel": [0, 1, 2], "rate": [3, 4, 5]}
STEP_S = 0.04


def _wave(t_s: np.ndarray, hz: float) -> np.ndarray:
    return np.sin(2 * np.pi * hz * t_s)


def _channels(hz: float, about: dict[str, tuple[float, ...]]) -> Channels:
    """Two accelerations of one wave, whose prediction knows the past of the first row."""
    t_s = np.arange(3.1, 12.0, STEP_S)
    return Channels(
        ("ax_g", "ay_g"),
        ("g", "g"),
        np.zeros((2, t_s.size)),
        np.stack([_wave(t_s, hz)] * 2),
        t_s,
        STEP_S,
        about=about,
        slope=np.stack([2 * np.pi * hz * np.cos(2 * np.pi * hz * t_s)] * 2),
        at=lambda later_s: np.stack([_wave(t_s - later_s, hz)] * 2),
    )


def test_a_delay_shared_out_is_taken_whole_by_lag_and_by_lateness() -> None:
    shared = {"bandwidth_lag": (3e-4, 0.0), "late_channel": (12e-4, 11e-4, 13e-4, 0.0, 0.0)}
    found = taken_alike(shared, KINDS, 5, 6)
    np.testing.assert_allclose(found["bandwidth_lag"], (14e-4, 0.0))
    np.testing.assert_allclose(found["late_channel"], (15e-4, 14e-4, 16e-4, 0.0, 0.0))


def test_the_rival_of_a_lag_is_taken_where_the_lag_is_and_the_reverse() -> None:
    assert taken_alike({"bandwidth_lag": (4e-3, 0.0)}, KINDS, 5, 6)["late_channel"] == (4e-3, 4e-3, 4e-3, 0.0, 0.0)
    assert taken_alike({"late_channel": (4e-3, 4e-3, 5e-3, 0.0, 0.0)}, KINDS, 5, 6)["bandwidth_lag"] == (4e-3, 0.0)


def test_one_late_channel_is_no_delay_of_its_kind() -> None:
    one = {"late_channel": (0.0, 4e-3, 0.0, 0.0, 0.0), "time_offset": (1e-2,)}
    assert taken_alike(one, KINDS, 5, 6) == one
    # the channel by which the clock is told is in time: the others of its kind have no delay in common with it
    assert "bandwidth_lag" not in taken_alike({"late_channel": (0.0, 0.0, 0.0, 4e-3, 4e-3)}, KINDS, 5, 6)


def test_a_lag_far_below_the_step_is_tried_as_the_delay_that_it_is() -> None:
    data = _channels(1.0, {})
    (term,) = BANDWIDTH_LAG.on_channels(data)
    np.testing.assert_allclose(term.columns[0][0], -data.slope)


def test_a_lag_is_exact_from_the_first_row_on() -> None:
    hz, tau = 2.0, 4e-3
    data = _channels(hz, {"bandwidth_lag": (tau,)})
    (term,) = BANDWIDTH_LAG.on_channels(data)
    response = 1 / (1 + 2j * np.pi * hz * tau)
    lagged = np.imag(response * np.exp(2j * np.pi * hz * data.t_s)) - _wave(data.t_s, hz)
    np.testing.assert_allclose(tau * term.columns[0][0, 0], lagged, atol=1e-9)


@pytest.mark.parametrize(("behind", "told"), [(24.0, True), (40.0, False)])
def test_more_parameters_do_not_rule_out_channels_that_are_late_by_the_same(behind: float, told: bool) -> None:
    claim = Claim("bandwidth_lag", "", "", "", {}, 0.0, ("bandwidth_lag",), (Rival("late_channel", behind),), "")
    claim = replace(claim, channels=("ax_g", "ay_g", "az_g"))
    fit = Fit("g", 1.0, 0.1, 1.0, 0.1, 0.9, 1.0, 0.1, "")
    found = DiagnosisResult("named", (), (claim,), fit, (), Remainder(), (), {}, {}, 1, "")
    # two parameters more are 2 log 1000 = 13.8 of BIC
    (given,) = with_the_other(found, [["ax_g", "ay_g", "az_g"], ["gx_dps"]], 1000.0).claims
    assert ("late_channel" in given.equivalence_class) == told
    assert bool(given.rivals_ruled_out) != told
