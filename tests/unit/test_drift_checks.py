"""Gyros and accelerometers in the wrong unit, silent or hanging: refused or doubted; good ones never."""

from __future__ import annotations

import numpy as np
import pytest

from highside.errors import InputError
from highside.gyro.checks import check_units, saturated_rows
from highside.gyro.frames import DEG_PER_SQRT_HOUR
from highside.papers.drift_scenarios import (
    DriftExperiment,
    curved_hole,
    drilling,
    record,
    rotating_rod,
    rotating_table,
    turntable,
    vibration_table,
)

ARW = 0.1 * DEG_PER_SQRT_HOUR
MOTIONS = {
    "standing": turntable(200.0, 50.0),
    "shaken": vibration_table(200.0, 50.0),
    "drilling": drilling(400.0, 50.0, leg_s=150.0),
    "a turning rod": rotating_rod(300.0, 50.0),
    "turning slowly": rotating_table(30.0, 200.0, 50.0),
    "a turn each look": rotating_table(30.0, 200.0, 100.0, rate_dps=720.0),
    "turning fast": rotating_table(0.0, 200.0, 100.0, rate_dps=1800.0),
    "a curved hole": curved_hole(rate_hz=50.0),
}


def _said(e: DriftExperiment, rate: np.ndarray, accel: np.ndarray) -> str:
    """The refusal or the doubts."""
    try:
        return "; ".join(check_units(e.t_s, rate, accel, arw=ARW))
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("e", MOTIONS.values(), ids=MOTIONS.keys())
def test_good_readings_are_not_doubted(e: DriftExperiment) -> None:
    for seed in range(2):
        data = record(e, seed)
        assert check_units(e.t_s, data.rate, data.accel, arw=ARW) == ()


@pytest.mark.parametrize("name", ["standing", "shaken", "drilling", "a turning rod", "turning slowly", "turning fast"])
def test_radians_are_refused_or_doubted(name: str) -> None:
    e = MOTIONS[name]
    data = record(e, 1)
    said = _said(e, np.radians(data.rate), data.accel)
    assert "rad/s" in said or "times less" in said


@pytest.mark.parametrize("factor", [180.0 / np.pi, 1000.0, 3600.0])
@pytest.mark.parametrize("name", ["standing", "turning slowly"])
def test_rates_in_a_smaller_unit_are_refused_or_doubted(name: str, factor: float) -> None:
    e = MOTIONS[name]
    data = record(e, 1)
    said = _said(e, factor * data.rate, data.accel)
    assert "give deg/s" in said or "times more" in said


def test_axes_that_are_not_those_of_the_accelerometers_are_refused() -> None:
    e = MOTIONS["turning slowly"]
    data = record(e, 1)
    with pytest.raises(InputError, match="axes"):
        check_units(e.t_s, -data.rate, data.accel, arw=ARW)


def test_silent_and_hanging_gyros_are_reported() -> None:
    e = MOTIONS["standing"]
    data = record(e, 1)
    silent, hanging = data.rate.copy(), data.rate.copy()
    silent[1] = 0.0
    hanging[2] = 1e-4
    with pytest.raises(InputError, match=r"gy_dps.*silent"):
        check_units(e.t_s, silent, data.accel)
    doubts = check_units(e.t_s, hanging, data.accel)
    assert len(doubts) == 1
    assert doubts[0].startswith("gz_dps never changes")


@pytest.mark.parametrize(("factor", "unit"), [(9.80665, "m/s2"), (1000.0, "mg"), (0.01, "another unit")])
def test_accelerometers_are_in_g(factor: float, unit: str) -> None:
    e = MOTIONS["standing"]
    data = record(e, 1)
    with pytest.raises(InputError, match=unit):
        check_units(e.t_s, data.rate, factor * data.accel)


def test_a_gyro_at_its_limit_is_counted_and_a_fast_one_is_not() -> None:
    e = rotating_table(30.0, 60.0, 50.0, rate_dps=50.0)
    rate = record(e, 1).rate
    assert saturated_rows(rate) == 0
    limit = np.radians(49.0)
    assert saturated_rows(np.clip(rate, -limit, limit)) == e.t_s.size
