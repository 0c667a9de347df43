"""Rows that are missing, times that come in bursts, tables of averages: what poses and magnitudes need is there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from highside import api
from highside.diagnosis.core.result import DiagnosisResult
from highside.physics.forward import ForwardModel
from highside.physics.gravity import attitude_of
from highside.physics.state import ChainState

Array = NDArray[np.float64]

MODEL = {"sensor": {"free": ["bias", "scale", "misalignment"]}}
SENSOR = {"bias": {"b_x": 1.2e-3, "b_y": -8e-4, "b_z": 1.5e-3}, "scale": {"s_x": 3e-3, "s_y": -2e-3, "s_z": 1e-3}}
ROWS = 10


def stepped(seed: int = 1, **effects: dict[str, float]) -> dict[str, Array]:
    """72 poses of ten rows each, one row a second."""
    rng = np.random.default_rng(seed)
    inc, tf = (a.ravel() for a in np.meshgrid([3.0, 20, 45, 70, 90, 120], np.arange(0, 360, 30.0), indexing="ij"))
    t_s = np.arange(inc.size) * 15.0
    state = ChainState.build(np.radians(inc), np.radians(tf), t_s=t_s)
    readings = np.repeat(ForwardModel.of({**SENSOR, **effects}).predict(state), ROWS, axis=1)
    readings = readings + rng.normal(0, 6e-5, readings.shape)
    columns = {"t_s": (t_s[:, None] + np.arange(ROWS)).ravel(), "pose": np.repeat(np.arange(72.0), ROWS)}
    columns |= dict(zip(("ax_g", "ay_g", "az_g"), readings, strict=True))
    return columns | {"inc_ref_deg": np.repeat(inc, ROWS), "tf_ref_deg": np.repeat(tf, ROWS)}


SAG = {"sag": {"s": 1e-3}}


@pytest.mark.parametrize("share", [0.1, 0.3])
@pytest.mark.parametrize("how", ["rows", "values"])
def test_rows_missing_of_poses_do_no_harm(share: float, how: str) -> None:
    """A pose does not need every row; it was refused as bad data."""
    columns = stepped(**SAG)
    lost = np.random.default_rng(2).random(columns["t_s"].size) < share
    if how == "rows":
        columns = {name: column[~lost] for name, column in columns.items()}
    else:
        columns["ay_g"] = np.where(lost, np.nan, columns["ay_g"])
    found = api.diagnose(columns, MODEL).found
    assert found.verdict in ("named", "named_plus")
    assert [claim.effect for claim in found.claims] == ["sag"]
    (finding,) = found.intake
    assert finding.check == ("dropped_frames" if how == "rows" else "missing_values")
    assert "averaged from the rows that are there" in finding.remedy


def test_a_column_that_is_all_but_empty_is_still_bad_data() -> None:
    columns = stepped()
    columns["ay_g"] = np.where(np.arange(columns["ay_g"].size) % 3 > 0, np.nan, columns["ay_g"])
    found = api.diagnose(columns, MODEL).found
    assert found.verdict == "bad_data"
    assert found.intake[0].check == "missing_values"


def averages(seed: int, spread: bool, **effects: dict[str, float]) -> dict[str, Array]:
    """A table of 40 averages: ax, ay, az alone, with or without what each is worth."""
    rng = np.random.default_rng(seed)
    k = np.random.default_rng(40).permutation(40) + 0.5
    z, turn = 1 - 2 * k / 40, np.pi * (1 + np.sqrt(5)) * k
    inc, tf = attitude_of(np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z]))
    readings = ForwardModel.of({**SENSOR, **effects}).predict(ChainState.build(inc, tf, t_s=np.arange(40) * 60.0))
    readings = readings + rng.normal(0, 5e-5, readings.shape)
    table = dict(zip(("ax", "ay", "az"), readings, strict=True))
    if spread:
        table |= {"n": np.full(40, 100.0)} | {f"std_a{axis}": np.full(40, 5e-4) for axis in "xyz"}
    return table


def of_averages(table: dict[str, Array]) -> DiagnosisResult:
    return api.diagnose(table, {**MODEL, "reference": {"kind": "magnitude"}}).found


@pytest.mark.parametrize("spread", [False, True])
def test_a_table_of_averages_without_angles_is_diagnosed_by_its_magnitudes(spread: bool) -> None:
    found = of_averages(averages(1, spread, quadratic={"k2_x": 2e-3, "k2_y": 1e-3, "k2_z": -1e-3}))
    assert [claim.effect for claim in found.claims] == ["quadratic"]
    assert of_averages(averages(2, spread)).verdict == "nothing_left_out"


def test_what_a_table_says_of_its_averages_is_the_floor() -> None:
    found = of_averages(averages(3, True))
    assert found.noise["repeats_g"] == pytest.approx(5e-5, rel=0.01)
