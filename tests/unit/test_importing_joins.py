"""A reference in a second file, and a second topic of the same: on the right times, or refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_importing import ACCEL, session

import highside
from highside.errors import InputError
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign
from highside.importing.joins import Joins, carry_out, open_joined

ANGLES = ["inc_ref_deg", "tf_ref_deg"]
START = 1_752_345_678_000_000_000


def turning(n: int = 1500, seed: int = 0) -> pd.DataFrame:
    """At 50 rows/s, without a period that comes again."""
    own = session(n, 50.0, seed)
    t = own.t_s.to_numpy()
    inc = np.radians(45 + 20 * np.sin(0.9 * t) + 15 * np.sin(0.31 * t + 1) + 5 * np.sin(2.3 * t))
    tf = np.radians(100 + 40 * np.sin(0.7 * t + 1) + 30 * np.sin(0.23 * t))
    u = np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
    a = u + np.random.default_rng(seed).normal(0, 1e-3, u.shape)
    own[ACCEL] = a.T
    return own.assign(inc_ref_deg=np.degrees(inc), tf_ref_deg=np.degrees(tf))


def written(folder: Path, own: pd.DataFrame, late_s: float, *, epoch: bool, every: int = 3) -> tuple[Path, Path]:
    """A log without reference, and the reference of another program whose stamps are late."""
    zero = START if epoch else 0
    stamp = "time_ns" if epoch else "t_s"
    log = own[ACCEL].assign(**{stamp: zero + np.rint(own.t_s * 1e9).astype(np.int64) if epoch else own.t_s})
    log.to_csv(folder / "log.csv", index=False)
    part = own.iloc[::every]
    when = zero + np.rint((part.t_s + late_s) * 1e9).astype(np.int64) if epoch else part.t_s + late_s
    pd.DataFrame({stamp: when, "inclination (deg)": part.inc_ref_deg, "toolface (deg)": part.tf_ref_deg}).to_csv(
        folder / "reference.csv", index=False
    )
    return folder / "log.csv", folder / "reference.csv"


def worst(found: highside.Recording, own: pd.DataFrame) -> float:
    errors = [np.abs(found[name] - own[name].to_numpy()) for name in ANGLES]
    return float(np.nanmax(errors))


def test_a_reference_of_the_same_clock_is_interpolated_and_its_lag_is_said(tmp_path: Path) -> None:
    own = turning()
    log, reference = written(tmp_path, own, 0.0, epoch=True)
    found = highside.import_recording(log, reference=reference)
    assert worst(found, own) < 0.1
    proposal = open_foreign(log, Wishes())
    carried = carry_out(proposal, open_joined(log, Joins.of(references=(reference,))), Joins())
    assert not carried.doubts
    assert any("reference.csv: " in line and "by gravity and the angles" in line for line in carried.findings)
    assert any("rows lie outside of its times" in line for line in carried.findings) == bool(
        np.isnan(found["inc_ref_deg"]).any()
    )


@pytest.mark.parametrize("late_s", [0.35, -1.2, 4.0])
def test_a_reference_that_is_late_is_asked_about_and_measured(tmp_path: Path, late_s: float) -> None:
    own = turning()
    log, reference = written(tmp_path, own, late_s, epoch=True)
    word = "late" if late_s > 0 else "early"
    with pytest.raises(InputError, match=rf"its clock says so, but [0-9.]+ s {word}.*lag_s=float"):
        highside.import_recording(log, reference=reference)
    assert worst(highside.import_recording(log, reference=reference, lag_s=float("nan")), own) < 0.2
    assert worst(highside.import_recording(log, reference=reference, lag_s=late_s), own) < 0.1


def test_clocks_without_a_common_zero_are_compared_by_the_movement(tmp_path: Path) -> None:
    own = turning()
    log, reference = written(tmp_path, own, 731.4, epoch=False)
    with pytest.raises(InputError, match=r"no common clock; 731\.4 s late by gravity and the angles.*accept=True"):
        highside.import_recording(log, reference=reference)
    found = highside.import_recording(log, reference=reference, accept=True)
    assert worst(found, own) < 0.5
    still = own.assign(**dict.fromkeys(ACCEL, 0.577))
    log, reference = written(tmp_path, still, 731.4, epoch=False)
    with pytest.raises(InputError, match=r"nothing moves in both.*lag_s=SECONDS"):
        highside.import_recording(log, reference=reference, accept=True)


def test_a_movement_that_comes_again_does_not_decide_a_lag(tmp_path: Path) -> None:
    own = turning()
    t = own.t_s.to_numpy()
    inc = np.radians(45 + 20 * np.sin(2.0 * t))
    again = own.assign(ax_g=np.sin(inc), ay_g=0.0, az_g=np.cos(inc), inc_ref_deg=np.degrees(inc), tf_ref_deg=0.0)
    log, reference = written(tmp_path, again, 100.0, epoch=False)
    with pytest.raises(InputError, match="nothing moves in both"):
        highside.import_recording(log, reference=reference, accept=True)


def test_axes_are_held_against_a_joined_reference(tmp_path: Path) -> None:
    own = turning()
    log, reference = written(tmp_path, own.assign(ax_g=-own.ay_g, ay_g=own.ax_g), 0.0, epoch=True)
    with pytest.raises(InputError, match="axes y-xz agree with the reference"):
        highside.import_recording(log, reference=reference)
    found = highside.import_recording(log, reference=reference, accept=True)
    np.testing.assert_allclose(found["ax_g"], own.ax_g, atol=1e-9)
    mirrored = own.assign(ay_g=-own.ay_g)
    log, reference = written(tmp_path, mirrored, 0.0, epoch=True)
    with pytest.raises(InputError, match="is a mirror"):
        highside.import_recording(log, reference=reference, accept=True)


def test_angles_go_on_behind_360_deg_and_gaps_stay_empty(tmp_path: Path) -> None:
    t = np.arange(0, 10, 0.1)
    pd.DataFrame({"t_s": t, "ax_g": 0.0, "ay_g": 0.0, "az_g": 1.0}).to_csv(tmp_path / "log.csv", index=False)
    at = np.concatenate((np.arange(0, 4, 0.25), np.arange(6, 9.1, 0.25)))
    pd.DataFrame({"t_s": at, "encoder_deg": (350 + 40 * at) % 360}).to_csv(tmp_path / "e.csv", index=False)
    found = highside.import_recording(tmp_path / "log.csv", reference=tmp_path / "e.csv", lag_s=0.0)
    wanted = np.where((t <= 3.75 + 1e-9) | ((t >= 6 - 1e-9) & (t <= 9 + 1e-9)), (350 + 40 * t) % 360, np.nan)
    np.testing.assert_allclose((found["rotor_deg"] - wanted + 180) % 360, 180 + 0 * wanted, atol=1e-9)
    assert np.isnan(found["rotor_deg"]).sum() == np.isnan(wanted).sum()
    for take in ("nearest", "last"):
        taken = highside.import_recording(tmp_path / "log.csv", reference=tmp_path / "e.csv", lag_s=0.0, take=take)
        assert set(np.round(taken["rotor_deg"][~np.isnan(taken["rotor_deg"])], 6)) <= set(
            np.round((350 + 40 * at) % 360, 6)
        )


def test_two_tables_of_one_file_are_joined_by_their_common_clock(tmp_path: Path) -> None:
    t = np.arange(0, 20, 0.01)
    tilt = 0.5 + 0.4 * np.sin(1.7 * t)
    rate = -np.degrees(0.68 * np.cos(1.7 * t))
    with pd.ExcelWriter(tmp_path / "x.xlsx", engine="openpyxl") as book:
        pd.DataFrame({"time_s": t, "acc_x_g": np.sin(tilt), "acc_y_g": 0.0, "acc_z_g": np.cos(tilt)}).to_excel(
            book, sheet_name="acc", index=False
        )
        pd.DataFrame({"time_s": t + 0.004, "gyro_x_dps": 0.0, "gyro_y_dps": rate, "gyro_z_dps": 0.0}).to_excel(
            book, sheet_name="gyro", index=False
        )
    found = highside.import_recording(tmp_path / "x.xlsx", join=["gyro"])
    wanted = -np.degrees(0.68 * np.cos(1.7 * (t - 0.004)))
    assert float(np.nanmax(np.abs(found["gy_dps"] - wanted))) < 0.01
    with pytest.raises(InputError, match="has no table 'gyr'"):
        highside.import_recording(tmp_path / "x.xlsx", join=["gyr"])
