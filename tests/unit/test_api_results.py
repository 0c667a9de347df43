"""`read` takes files of any kind, nothing silently; methods are the functions; results show and draw themselves."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import highside
from highside.api.importing import _in_arguments
from highside.errors import InputError, Refused
from highside.shown import PlotLine, PlotPanel
from highside.shown.panel import ROWS_DRAWN, thinned

MODEL: dict[str, Any] = {
    "sensor": {"bias_g": [1.2e-3, -0.8e-3, 1.6e-3], "noise_g": 50e-6},
    "motion": {"kind": "poses", "inclinations_deg": [5, 45, 90], "toolfaces_deg": [45, 135, 225, 315], "hold_s": 4},
}


@pytest.fixture(scope="module")
def simulation() -> highside.Simulation:
    return highside.simulate(MODEL, seed=3)


@pytest.fixture(scope="module")
def calibration(simulation: highside.Simulation) -> highside.Calibration:
    assert simulation.poses is not None
    return highside.calibrate(simulation.poses, tool="HS-7", pose_sigma_deg=0.01)


def log(path: Path, header: str, *, gap: bool = False) -> Path:
    """A log of another program: rows of 10 ms at rest, in m/s2."""
    rows = (f"{10 * k + (5000 if gap and k > 100 else 0)},{0.1 + 1e-3 * (k % 7)},0.2,9.8" for k in range(300))
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


# --- read ----------------------------------------------------------------------------------------------------------


def test_what_a_file_says_clearly_is_read_and_reported(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", "time [ms],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording = highside.read(path)
    assert isinstance(recording, highside.Recording)
    assert recording["az_g"][0] == pytest.approx(9.8 / 9.80665)
    assert recording.t_s[1] == pytest.approx(0.01)
    assert any(note.startswith("ax_g is acc_x [m/s2] (m/s2, certain):") for note in recording.notes), recording.notes
    assert recording.notes[0] in recording._repr_html_()
    some = recording.select(np.arange(10))
    assert some.notes == recording.notes, "part of a recording comes from where the whole does"
    np.testing.assert_array_equal(highside.import_recording(path)["ax_g"], recording["ax_g"])


def test_what_rests_on_values_alone_is_refused_until_it_was_seen(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", "time [ms],acc_x,acc_y,acc_z")
    with pytest.raises(InputError) as fault:
        highside.read(path)
    said = str(fault.value)
    assert "accept=True takes what is shown" in said
    assert "--" not in said
    looked = highside.inspect_import(path)
    assert any("likely" in row for row in looked.rows)
    assert looked.doubts
    for shown in (str(looked), looked._repr_html_()):
        assert "acc_x" in shown and "median |a|" in shown
    with pytest.raises(InputError):
        looked.read()
    for taken in (looked.read(accept=True), highside.read(path, accept=True), highside.read(path, units=["m/s2"])):
        assert taken["az_g"][0] == pytest.approx(9.8 / 9.80665)


def test_what_is_open_is_never_read(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", "time [ms],a,b,c")
    with pytest.raises(InputError) as fault:
        highside.read(path, accept=True)
    assert "mapping=" in str(fault.value)
    assert "--" not in str(fault.value)


def test_lost_rows_are_a_warning(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", "time [ms],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]", gap=True)
    with pytest.warns(UserWarning, match=r"log\.csv: .*pause.* line 103") as warned:
        recording = highside.read(path)
    assert warned[0].filename == __file__
    assert any("pause" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("t_s,ax_g\n0.0,0.1\n1.0,0.1 g\n", "line 3"),
        ("t_s,ax_g\n0.0,0.1\n1.0\n", "line 3"),
    ],
)
def test_an_own_file_that_is_damaged_is_not_taken_for_another_programs(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "session.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as fault:
        highside.read(path)
    assert "mapping" not in str(fault.value)


def test_own_forms_are_read_without_a_note(tmp_path: Path, simulation: highside.Simulation) -> None:
    from highside.api.importing import write_imported

    for name in ("a.csv", "a.csv.gz", "a.parquet", "a.mcap"):
        if name.endswith("gz"):
            simulation.recording.write(tmp_path / name)
        else:
            write_imported(simulation.recording, tmp_path / name)
        back = highside.read(tmp_path / name)
        np.testing.assert_array_equal(back["ax_g"], simulation.recording["ax_g"])
        assert back.notes == ()
    with pytest.raises(InputError, match="this is a table"):
        highside.read(simulation.recording, units=["m/s2"])


def test_options_are_named_as_arguments() -> None:
    assert _in_arguments("--rate 100, or --map t_s=COLUMN:ms") == 'rate_hz=100, or mapping={"t_s": "COLUMN:ms"}'
    assert _in_arguments("--units m/s2,rad/s; --yes takes what is shown") == (
        'units=["m/s2", "rad/s"]; accept=True takes what is shown'
    )
    assert _in_arguments("--table NAME says which") == 'table="NAME" says which'


# --- methods and results -------------------------------------------------------------------------------------------


def test_the_methods_of_a_recording_are_the_functions(
    simulation: highside.Simulation, calibration: highside.Calibration, tmp_path: Path
) -> None:
    corrected = simulation.recording.correct(calibration, noise_g=1e-4)
    assert isinstance(corrected, highside.Recording)
    same = calibration.correct(simulation.recording, noise_g=1e-4)
    assert corrected.order == same.order
    np.testing.assert_array_equal(corrected["inc_std_deg"], same["inc_std_deg"])
    calibration.save(tmp_path / "cal.json")
    np.testing.assert_array_equal(simulation.recording.correct(tmp_path / "cal.json")["inc_deg"], corrected["inc_deg"])
    with pytest.raises(Refused, match="HS-7"):
        simulation.recording.correct(calibration, tool="HS-8")
    known = {"sensor": MODEL["sensor"]}
    found, asked = simulation.recording.diagnose(known, seed=4), highside.diagnose(simulation.recording, known, seed=4)
    assert found.to_dict() == asked.to_dict()
    assert str(found).startswith(f"{found.verdict} - ")
    assert repr(found) == f"<Diagnosis of {found.source}: {found.verdict}{': ' if found.claims else ''}" + (
        ", ".join(claim.effect for claim in found.claims) + ">"
    )


def test_a_certificate_shows_its_uncertainties(calibration: highside.Calibration, tmp_path: Path) -> None:
    certificate = highside.certify(calibration, previous=calibration)
    assert "U(I), k = 2, deg" in certificate._repr_html_()
    drawn = certificate.plot().panels[0]
    assert drawn.lines[1].y[0] > 3 * drawn.lines[1].y[-1], "toolface is better the more it is inclined"
    assert certificate.save(tmp_path / "certificate.html") is None
    assert "Calibration certificate" in (tmp_path / "certificate.html").read_text()
    assert np.all(calibration.bias_std_g > 0)
    assert np.all(np.abs(calibration.bias_g - MODEL["sensor"]["bias_g"]) < 5 * calibration.bias_std_g)


def test_results_of_a_rotation_show_and_draw_themselves() -> None:
    angle = np.linspace(0.0, 3600.0, 1500)
    error = 4.0 * np.sin(np.radians(angle)) + np.random.default_rng(5).normal(0.0, 0.05, angle.size)
    rows = {"t_s": angle / 36.0, "rotor_deg": angle, "d_roll_arcmin": error}
    fitted = highside.fit_rotation(rows, method="sine")
    compared = highside.compare_rotation(rows)
    taken_off = highside.compensate(rows, fitted.compensation)
    for result in (fitted, compared, taken_off):
        assert "roll" in result._repr_html_()
        assert result.plot().panels[0].y_label == "roll, arcmin"
    curve = fitted.plot().panels[0].lines[1]
    assert np.ptp(curve.y) == pytest.approx(8.0, rel=0.02)
    assert set(compared) == {"roll"}


def test_a_long_line_is_thinned_and_keeps_its_extremes() -> None:
    y = np.zeros(100_000)
    y[54_321], y[777] = 5.0, -3.0
    y[10_000:20_000] = np.nan
    few = thinned(PlotPanel(np.arange(y.size, dtype=float), (PlotLine("a", y, np.abs(y)), PlotLine("b", -y))))
    assert few.x.size <= ROWS_DRAWN + 2
    assert np.nanmax(few.lines[0].y) == 5.0
    assert few.x[int(np.nanargmin(few.lines[0].y))] == 777.0
    assert few.lines[0].std is not None
    assert few.lines[0].std.size == few.x.size
    short = PlotPanel(np.arange(10.0), (PlotLine("a", np.zeros(10)),))
    assert thinned(short) is short
