"""A recording that begins in motion: no thresholds of rest can be learned from it, which is said, and claimed less."""

from __future__ import annotations

import numpy as np
import pytest

from highside.api.gyro import MethodName, drift

RATE_HZ, INC_DEG = 50.0, 60.0
BEGUN_S = 60.0


def recording(begins: str) -> dict[str, np.ndarray]:
    """A straight hole: 60 s of what it begins with, 120 s of rest, 60 s of rotation, 120 s of rest."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 360.0, 1.0 / RATE_HZ)
    first = t < BEGUN_S
    turn, shaken = np.zeros(t.size), np.zeros(t.size)
    if begins == "rotation":
        turn[first] = 6.0
    elif begins == "slow rotation":
        turn[first] = 1.0
    elif begins == "to and fro":
        turn[first] = 20.0 * np.sin(t[first])
    elif begins == "vibration":
        shaken[first] = 0.1
    turn[(t >= 180.0) & (t < 240.0)] = 6.0
    tf, inc = np.radians(np.cumsum(turn) / RATE_HZ), np.radians(INC_DEG)
    accel = np.stack([-np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.full(t.size, np.cos(inc))])
    accel += (1e-3 + shaken) * rng.standard_normal(accel.shape)
    rate = np.array([[10.0], [-5.0], [8.0]]) / 3600.0 + 0.1 / 60.0 * np.sqrt(RATE_HZ) * rng.standard_normal(accel.shape)
    rate[2] += turn
    names = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")
    return {"t_s": t} | dict(zip(names, [*accel, *rate], strict=True))


MOVING = ("rotation", "slow rotation", "to and fro", "vibration")


@pytest.mark.parametrize("begins", MOVING)
def test_kinematic_says_that_no_stop_is_found_and_claims_less(begins: str) -> None:
    found, at_rest = drift(recording(begins)), drift(recording("rest"))
    found_notes = [note for note in found.notes if "does not begin with 20 s of rest" in note]
    assert len(found_notes) == 1 and "rest=" in found_notes[0] and "no stop is found" in found_notes[0]
    assert "zero-rate" not in found.basis and "zero-rate" in at_rest.basis
    assert not any("20 s of rest" in note for note in at_rest.notes)
    std, known = (one.data["azi_std_deg"][-1] for one in (found, at_rest))
    assert std > 3.0 * known, "what it does not know is in its uncertainty"
    off = (found.data["azi_deg"] + 180.0) % 360.0 - 180.0
    assert np.all(np.abs(off) < 3.0 * found.data["azi_std_deg"])
    assert np.abs(found.data["inc_deg"] - INC_DEG)[int(BEGUN_S * RATE_HZ) :].max() < 0.3


@pytest.mark.parametrize("method", ["literal", "literal_block"])
@pytest.mark.parametrize("begins", MOVING)
def test_the_paper_s_gate_says_with_what_it_could_not_compare(begins: str, method: MethodName) -> None:
    found = drift(recording(begins), method)
    found_notes = [note for note in found.notes if note.startswith("gravity believed in")]
    assert len(found_notes) == 1 and "does not begin with 20 s of rest" in found_notes[0] and "rest=" in found_notes[0]
    # rough vibration is not believed without anything to compare it with
    assert ("in 18000 of 18000" in found_notes[0]) == (begins != "vibration")
    assert not any("20 s of rest" in note for note in drift(recording("rest"), method).notes)


def test_with_the_stops_named_nothing_is_missed() -> None:
    found = drift(recording("rotation"), rest=[(60.0, 180.0), (240.0, 360.0)])
    assert not any("20 s of rest" in note for note in found.notes)
    assert "zero-rate" in found.basis
    assert found.data["azi_std_deg"][-1] < drift(recording("rotation")).data["azi_std_deg"][-1]


@pytest.mark.parametrize("method", ["kinematic", "literal"])
def test_a_recording_too_short_to_learn_from_says_so(method: MethodName) -> None:
    short = {name: values[: int(10 * RATE_HZ)] for name, values in recording("rest").items()}
    assert any("does not begin with 20 s of rest" in note for note in drift(short, method).notes)
