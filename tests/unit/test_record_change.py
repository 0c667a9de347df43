"""What a new calibration changes: by coefficient and by reading, held against the same record and a known step."""

from __future__ import annotations

import numpy as np
import pytest
from test_record import make

from highside.calibration.change import change


def test_a_record_changes_nothing_against_itself() -> None:
    record = make("joint", 3)
    found = change(record, record)
    assert found.coefficients and all(row.difference == 0.0 for row in found.coefficients)
    held = [row for row in found.readings if row.inc_change_deg is not None]
    assert held and all(row.inc_change_deg == 0.0 and row.tf_change_deg == 0.0 for row in held)
    assert (found.only_before, found.only_after) == ((), ())


def test_two_sensors_differ_by_their_own_errors() -> None:
    """Sensors whose matrices differ by some 2e-3: 0.1 deg is what that turns a reading by, far beyond the bands."""
    before, after = make("conventional", 0), make("conventional", 1)
    found = change(before, after)
    named = {row.name: row for row in found.coefficients}
    for name, value in zip(("b_x", "b_y", "b_z"), after.result.b - before.result.b, strict=True):
        assert named[name].difference == pytest.approx(value, abs=1e-15)
        assert named[name].unit == "g"
    assert max(row.sigmas for row in found.coefficients if row.sigmas is not None) > 20.0
    worst = max(row.inc_change_deg for row in found.readings if row.inc_change_deg is not None)
    assert 0.05 < worst < 1.0
    # the largest change is that of the corrections themselves, at one attitude of the grid
    raw = np.array([[np.sin(np.deg2rad(90.0))], [0.0], [0.0]])
    inc = [np.rad2deg(np.arctan2(np.hypot(g[0], g[1]), g[2])) for g in (r.result.correct(raw) for r in (before, after))]
    at_90 = next(row for row in found.readings if row.inc_deg == 90.0)
    assert at_90.inc_change_deg is not None
    assert at_90.inc_change_deg >= abs(float(inc[1].item() - inc[0].item())) - 1e-12


def test_zones_without_a_counterpart_are_named_and_where_one_does_not_hold_nothing_is_said() -> None:
    balance, joint = make("balance", 0), make("joint", 0)
    found = change(joint, balance)
    assert found.coefficients == ()
    assert found.only_before == tuple(zone.name for zone in joint.result.zones)
    assert found.only_after == tuple(zone.name for zone in balance.result.zones)
    at = {row.inc_deg: row for row in found.readings}
    assert at[90.0].inc_change_deg is None and at[90.0].tf_std_deg is None
    assert at[45.0].inc_change_deg is not None
