"""Survey lists: depth and azimuth are joined, never invented; positions, and what other programs read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import highside
from highside.cli.commands import run
from highside.cli.main import app
from highside.errors import InputError
from highside.recording.survey_files import trajectory_class
from highside.recording.survey_list import SurveyList

N = 12
MD = 30.0 * np.arange(1, N + 1)
INC = np.linspace(2.0, 60.0, N)
AZI = np.linspace(350.0, 372.0, N) % 360.0


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A survey each half hour; the third is refused."""
    path = tmp_path / "surveys.jsonl"
    path.write_text("".join(_line(k) + "\n" for k in range(N)))
    return path


def _line(k: int, **more: object) -> str:
    survey = {"seq": k, "t": 1.79e9 + 1800.0 * k, "inc_deg": INC[k], "tf_deg": 30.0 * k % 360.0, "g_total": 1.0,
              "temp_c": 40.0 + k, "cal_id": "c1", "accepted": k != 2,
              "reasons": ["moved"] if k == 2 else []}  # fmt: skip
    return json.dumps(survey | more)


@pytest.fixture
def depths(tmp_path: Path) -> Path:
    path = tmp_path / "depths.csv"
    path.write_text("seq,md_m\n" + "".join(f"{k},{MD[k]}\n" for k in range(N)))
    return path


@pytest.fixture
def gyro(tmp_path: Path) -> Path:
    """Azimuths of another tool, by depth, 0.3 m away."""
    path = tmp_path / "gyro.csv"
    path.write_text("md_m,azi_deg,azi_std_deg\n" + "".join(f"{MD[k] + 0.3},{AZI[k]},0.5\n" for k in range(N)))
    return path


def test_a_list_has_the_accepted_surveys_by_depth(kept: Path, depths: Path, gyro: Path) -> None:
    found = highside.list_surveys(kept, depths=depths, azimuths=gyro)
    used = np.delete(np.arange(N), 2)
    assert found.left_out == {"refused": 1}
    assert found.table["md_m"] == pytest.approx(MD[used])
    assert found.table["azi_deg"] == pytest.approx(AZI[used])
    assert found.table["azi_std_deg"] == pytest.approx(0.5)


def test_positions_are_those_of_minimum_curvature(kept: Path, depths: Path, gyro: Path) -> None:
    """Against the formula of the textbooks, a leg after the other."""
    table = highside.list_surveys(kept, depths=depths, azimuths=gyro).table
    inc, azi = np.radians(table["inc_deg"]), np.radians(table["azi_deg"])
    t = np.stack([np.sin(inc) * np.cos(azi), np.sin(inc) * np.sin(azi), np.cos(inc)])
    bend = np.arccos(np.clip(np.sum(t[:, 1:] * t[:, :-1], axis=0), -1.0, 1.0))
    legs = (t[:, 1:] + t[:, :-1]) * np.tan(bend / 2.0) / bend * np.diff(table["md_m"])
    for name, of in zip(("north_m", "east_m", "tvd_m"), np.cumsum(legs, axis=1), strict=True):
        assert table[name] == pytest.approx(np.concatenate([[0.0], of]), abs=1e-6)
    assert table["dls_deg_30m"][1:] == pytest.approx(np.degrees(bend) / np.diff(table["md_m"]) * 30.0)


def test_without_azimuths_the_list_says_so_and_has_no_positions(kept: Path, depths: Path) -> None:
    found = highside.list_surveys(kept, depths=depths)
    assert not found.table.has("tvd_m")
    assert np.isnan(found.table.columns["azi_deg"]).all()
    assert "azimuth is not known at 11 of 11 stations" in found.notes[0]


def test_one_missing_azimuth_takes_the_positions_away_and_is_not_interpolated(
    kept: Path, depths: Path, gyro: Path
) -> None:
    lines = gyro.read_text().splitlines()
    gyro.write_text("\n".join([*lines[:6], *lines[7:]]) + "\n")
    found = highside.list_surveys(kept, depths=depths, azimuths=gyro)
    assert int(np.isnan(found.table.columns["azi_deg"]).sum()) == 1
    assert not found.table.has("north_m")
    assert "at 1 of 11 stations" in found.notes[0]


def test_depths_by_time_belong_to_the_nearest_row_or_to_none(kept: Path, tmp_path: Path) -> None:
    path = tmp_path / "depths.csv"
    path.write_text(
        "t,md_m\n" + "".join(f"{1.79e9 + 1800.0 * k + (60.0 if k < 6 else 300.0)},{MD[k]}\n" for k in range(N))
    )
    found = highside.list_surveys(kept, depths=path, sensor_offset_m=12.0)
    assert found.table["md_m"] == pytest.approx(np.delete(MD[:6], 2) - 12.0)
    assert found.left_out == {"refused": 1, "no measured depth": 6}


def test_depth_and_azimuth_of_the_tool_itself_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "surveys.jsonl"
    path.write_text("".join(_line(k, md_m=MD[k], azi_deg=AZI[k], azi_std_deg=1.0) + "\n" for k in range(N)))
    assert highside.list_surveys(path).table.has("tvd_m")


def test_of_two_surveys_at_one_depth_the_last_counts(kept: Path, depths: Path) -> None:
    kept.write_text(kept.read_text() + _line(5, seq=99, t=1.79e9 + 1e5, inc_deg=33.0) + "\n")
    depths.write_text(depths.read_text() + f"99,{MD[5]}\n")
    found = highside.list_surveys(kept, depths=depths)
    assert found.left_out == {"refused": 1, "another survey at the same depth": 1}
    assert found.table["inc_deg"][found.table["md_m"] == MD[5]] == pytest.approx([33.0])


def test_the_csv_reads_back(kept: Path, depths: Path, gyro: Path, tmp_path: Path) -> None:
    found = highside.list_surveys(kept, depths=depths, azimuths=gyro)
    found.save(tmp_path / "list.csv")
    again = SurveyList.read(tmp_path / "list.csv")
    for name in ("md_m", "inc_deg", "azi_deg", "tvd_m", "north_m"):
        assert again[name] == pytest.approx(found.table[name], abs=0.0)


@pytest.mark.parametrize("azimuths", [True, False])
def test_las_reads_back_with_a_step_of_zero(
    kept: Path, depths: Path, gyro: Path, tmp_path: Path, azimuths: bool
) -> None:
    lasio = pytest.importorskip("lasio")
    found = highside.list_surveys(kept, depths=depths, azimuths=gyro if azimuths else None)
    found.save(tmp_path / "list.las", wellbore="NO 15/9-A 1", datum="KB")
    las = lasio.read(tmp_path / "list.las")
    assert las.version["VERS"].value == 2.0
    assert las.well["STEP"].value == 0
    assert las.well["WELL"].value == "NO 15/9-A 1" and las.params["DREF"].value == "KB"
    assert las["DEPT"] == pytest.approx(found.table["md_m"], abs=1e-6)
    assert las["INCL"] == pytest.approx(found.table["inc_deg"], abs=1e-6)
    assert ("AZIM" in set(las.keys())) is azimuths
    assert ("TVD" in set(las.keys())) is azimuths


@pytest.mark.parametrize("azimuths", [True, False])
def test_witsml_reads_back_with_all_that_its_schema_needs(
    kept: Path, depths: Path, gyro: Path, tmp_path: Path, azimuths: bool
) -> None:
    witsml = pytest.importorskip("energyml.witsml.v2_0.witsmlv2")
    from xsdata.formats.dataclass.parsers import XmlParser
    from xsdata.formats.dataclass.parsers.config import ParserConfig

    found = highside.list_surveys(kept, depths=depths, azimuths=gyro if azimuths else None)
    path = tmp_path / "list.xml"
    found.save(path, wellbore="A 1", datum="KB", north="grid")
    strict = ParserConfig(
        fail_on_unknown_properties=True, fail_on_unknown_attributes=True, fail_on_converter_warnings=True
    )
    made = XmlParser(config=strict).from_path(path, trajectory_class())
    assert made.schema_version == "2.0" and made.citation.title == "Surveys of A 1"
    plain = XmlParser(config=ParserConfig(fail_on_unknown_properties=False)).from_path(path, witsml.Trajectory)
    assert len(plain.trajectory_station) == 11
    _complete(made)
    assert made.azi_ref is witsml.AziRef.GRID_NORTH and made.wellbore.title == "A 1"
    assert [one.md.value for one in made.trajectory_station] == pytest.approx(list(found.table["md_m"]))
    assert [one.incl.value for one in made.trajectory_station] == pytest.approx(list(found.table["inc_deg"]))
    first, last = made.trajectory_station[0], made.trajectory_station[-1]
    assert first.md.datum == "KB"
    if azimuths:
        assert last.type_traj_station is witsml.TrajStationType.MD_INCL_AND_AZI
        assert last.tvd.value == pytest.approx(found.table["tvd_m"][-1])
        assert last.disp_ns.value == pytest.approx(found.table["north_m"][-1])
    else:
        assert last.type_traj_station is witsml.TrajStationType.MD_AND_INCL
        assert last.azi is None and last.tvd is None


def _complete(thing: object) -> None:
    """Every element and attribute that the schema requires is there."""
    from dataclasses import fields, is_dataclass

    for one in fields(thing):  # type: ignore[arg-type]
        value = getattr(thing, one.name)
        assert value is not None or not one.metadata.get("required"), f"{type(thing).__name__}.{one.name}"
        for part in value if isinstance(value, list) else [value]:
            if is_dataclass(part):
                _complete(part)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("md_m\n1\n", "has none of the columns that join it to surveys (seq, t)"),
        ("seq,depth\n1,2\n", "md_m"),
        ("seq,md_m\n77,100\n", "no survey has a measured depth (11 without, 1 refused)"),
    ],
)
def test_a_table_that_cannot_be_joined_is_one_line(kept: Path, tmp_path: Path, content: str, says: str) -> None:
    path = tmp_path / "depths.csv"
    path.write_text(content)
    with pytest.raises(InputError) as error:
        highside.list_surveys(kept, depths=path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_the_commands_print_and_write(kept: Path, depths: Path, gyro: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["surveys", "list", str(kept), "--depths", str(depths)])
    assert done.exit_code == 0
    assert done.output.splitlines()[0].split() == ["md_m", "inc_deg", "azi_deg", "tf_deg"]
    out = tmp_path / "made.las"
    line = [
        "surveys",
        "export",
        str(kept),
        "--to",
        "las",
        "-o",
        str(out),
        "--depths",
        str(depths),
        "--azimuths",
        str(gyro),
    ]
    assert CliRunner().invoke(app, line).exit_code == 0
    assert out.read_text().startswith("~Version")
    done = CliRunner().invoke(app, [*line, "--north", "down"])
    assert isinstance(done.exception, InputError) and "--north" in str(done.exception)
    assert isinstance(CliRunner().invoke(app, ["surveys", "list", str(kept)]).exception, InputError)


def test_lines_that_are_no_surveys_are_counted_in_the_list_and_said(tmp_path: Path, depths: Path) -> None:
    path = tmp_path / "torn.jsonl"
    path.write_text("".join(_line(k) + "\n" for k in (*range(N), 5)) + _line(3, inc_deg=200.0) + '\n{"seq": 1')
    assert highside.list_surveys(path, depths=depths).left_out == {"no survey": 2, "repeats a survey": 1, "refused": 1}
    out = tmp_path / "list.csv"
    command = ["surveys", "export", str(path), "--to", "csv", "-o", str(out), "--depths", str(depths)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "left out: 2 (no survey)" in done.output


def test_a_word_that_is_no_text_is_one_line_and_nothing_is_written(
    kept: Path, depths: Path, gyro: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bytes of a terminal that does not speak UTF-8, in what is written into the file."""
    out = tmp_path / "out.las"
    line = ["surveys", "export", str(kept), "--to", "las", "-o", str(out), "--depths", str(depths), "--datum"]
    assert run([*line, "M\udcfcller"]) == 2
    assert capsys.readouterr().err == "highside: M\\udcfcller: holds bytes that are no text; write it in UTF-8\n"
    assert not out.exists()
    assert run([*line, "Müller"]) == 0
