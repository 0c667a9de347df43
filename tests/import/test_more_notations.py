"""Notations that other tests do not hold: read right, or refused; what marks a missing value is no number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from foreign_session import session

import highside
from highside.errors import InputError

ACCEL, RATES = ("ax_g", "ay_g", "az_g"), ("gx_dps", "gy_dps", "gz_dps")
S = session(400, 5)


def table(header: str, columns: Sequence[np.ndarray], separator: str = ",", point: str = ".") -> str:
    rows = zip(*[[f"{float(value):.9g}".replace(".", point) for value in column] for column in columns], strict=True)
    return "\n".join([header, *map(separator.join, rows)]) + "\n"


@pytest.mark.parametrize(
    ("header", "scale", "encoding"),
    [
        ("Zeit [s];Beschleunigung X [m/s²];Beschleunigung Y [m/s²];Beschleunigung Z [m/s²];"
         "Drehrate X [°/s];Drehrate Y [°/s];Drehrate Z [°/s];Temperatur [°C]", 9.80665, "utf-8-sig"),
        ("Tid (s);Akselerasjon X (mg);Akselerasjon Y (mg);Akselerasjon Z (mg);"
         "Vinkelhastighet X (deg/s);Vinkelhastighet Y (deg/s);Vinkelhastighet Z (deg/s);Temperatur (C)",
         1000.0, "cp1252"),
    ],
)  # fmt: skip
def test_headers_in_other_languages(tmp_path: Path, header: str, scale: float, encoding: str) -> None:
    text = table(header, [S.t_s, *(scale * S.accel_g), *S.rate_dps, S.temp_c], ";", ",")
    (tmp_path / "x.csv").write_bytes(text.encode(encoding))
    found = highside.import_recording(tmp_path / "x.csv")
    np.testing.assert_allclose([found[name] for name in ACCEL], S.accel_g, atol=1e-6)
    np.testing.assert_allclose([found[name] for name in RATES], S.rate_dps, atol=1e-5)
    np.testing.assert_allclose(found["temp_c"], S.temp_c, atol=1e-6)


@pytest.mark.parametrize("marker", [-999.25, -9999.0, 99999.0])
def test_the_mark_of_a_missing_value_is_no_number_and_is_said(tmp_path: Path, marker: float) -> None:
    spoilt = np.where(np.arange(S.n) % 37 == 5, marker, S.accel_g)
    (tmp_path / "x.csv").write_text(table("t_s,acc_x_g,acc_y_g,acc_z_g", [S.t_s, *spoilt]))
    found = highside.import_recording(tmp_path / "x.csv")
    for name, true in zip(ACCEL, S.accel_g, strict=True):
        assert int(np.isnan(found[name]).sum()) == 11
        assert np.nanmax(np.abs(found[name] - true)) < 1e-6
    assert any("11 cells of acc_x_g hold" in note for note in found.notes)


def test_a_reading_that_is_the_same_as_a_marker_stays(tmp_path: Path) -> None:
    counts = np.rint(1000 * S.accel_g * 16.384)
    counts[2, 7] = 9999.0
    (tmp_path / "x.csv").write_text(table("t_s,ax,ay,az", [S.t_s, *counts]))
    found = highside.import_recording(tmp_path / "x.csv", accept=True)
    assert not np.isnan(found["az_g"]).any()


@pytest.mark.parametrize(
    ("header", "columns", "match"),
    [
        ("time_s,acc_x_g,acc_y_g,acc_z_g,gyr_x_dps,gyr_y_dps,gyr_z_dps",
         [S.t_s, *S.accel_g[[1, 0, 2]], *S.rate_dps], "a sign or a name is wrong"),
        ("time_s,acc_x_g,acc_y_g,acc_z_g,inc_ref_deg,tf_ref_deg",
         [S.t_s, *-S.accel_g, S.inc_deg, S.tf_deg], "that is a mirror"),
        ("tick,acc_x_mg,acc_y_mg,acc_z_mg", [(np.rint(S.t_s * 32768) + 60000) % 65536, *(1000 * S.accel_g)],
         "no column is a time"),
        ("s,X,Y,Z,X,Y,Z", [S.t_s, *S.accel_g, *S.rate_dps], "names this column twice"),
    ],
)  # fmt: skip
def test_what_is_wrong_or_undecided_is_refused(
    tmp_path: Path, header: str, columns: list[np.ndarray], match: str
) -> None:
    (tmp_path / "x.csv").write_text(table(header, columns))
    for accept in (False, True):
        with pytest.raises(InputError, match=match):
            highside.import_recording(tmp_path / "x.csv", accept=accept)
