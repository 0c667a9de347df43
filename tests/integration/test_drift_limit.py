"""The least azimuth drift by recursion and by one sparse least-squares problem: the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from highside.gyro.frames import to_body
from highside.gyro.recording_filter import error_state_filter
from highside.papers.drift_bound import azimuth_bound
from highside.papers.drift_scenarios import DriftExperiment, drilling, record, rotating_rod, rotating_table, turntable
from studies import drift_limit as study

CASES: dict[str, tuple[DriftExperiment, bool]] = {
    "turning, level": (rotating_table(0.0, 900.0, 20.0), False),
    "turning, 30 deg": (rotating_table(30.0, 900.0, 20.0), False),
    "standing": (turntable(900.0, 20.0), False),
    "standing, declared for half": (replace(turntable(900.0, 20.0), rest=np.array([[0.0, 450.0]])), True),
    "drilling": (drilling(900.0, 20.0, leg_s=300.0), True),
    "turning rod": (rotating_rod(900.0, 20.0), True),
}


@pytest.mark.parametrize("name", CASES)
def test_both_ways_find_the_same_bound(name: str) -> None:
    e, declared = CASES[name]
    rest = e.rest if declared else None
    recursion = azimuth_bound(e, azimuth_std_rad=study.AZIMUTH_STD_RAD, rest=rest)[-1]
    bound = study.Problem(e, rest).bound_rad
    assert bound == pytest.approx(recursion, rel=0.005)
    # the length of the readings (1 g, here alone) shows something of the accelerometers' biases
    assert 0.9 * bound < study.Problem(e, rest, length=True).bound_rad < 1.0001 * bound


def test_the_optimum_errs_by_the_bound_and_the_filter_by_little_more() -> None:
    e, _ = CASES["turning, 30 deg"]
    problem = study.Problem(e, None)
    settings = replace(study.SETTINGS, detect_stops=False, azimuth_std_rad=1e-5)
    best, own = [], []
    for seed in range(50):
        data = record(e, seed)
        best.append(problem.optimum_error_rad(to_body(data.rate), to_body(data.accel)))
        result = error_state_filter(e.t_s, data.rate, data.accel, settings)
        own.append(float(result.azi_rad[-1] - e.psi[-1]))
    optimum, ours = (float(np.sqrt(np.mean(np.square(each)))) for each in (best, own))
    # fifty runs tell a standard deviation to 10 %
    assert optimum == pytest.approx(problem.bound_rad, rel=0.3)
    assert ours < 1.05 * optimum
