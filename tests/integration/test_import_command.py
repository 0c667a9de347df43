"""`highside import` from a file of another program to poses and a diagnosis, and its refusals."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from inside import highside_inside

from highside.recording.table import Recording, read_recording
from tests.few_poses import model_of_few_poses


def highside(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return highside_inside(*arguments, cwd=folder, environment={"XDG_CONFIG_HOME": str(folder / "config-home")})


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated session of the bench, and the same as other programs would have written it."""
    folder = tmp_path_factory.mktemp("bench")
    model = model_of_few_poses(folder / "model.toml")
    made = highside(folder, "simulate", str(model), "-o", "s.csv", "--seed", "3")
    assert made.returncode == 0, made.stderr
    for kind in ("mcap", "parquet"):
        assert highside(folder, "export", "s.csv", "--to", kind).returncode == 0
    own = pd.read_csv(folder / "s.csv")
    when = pd.to_datetime(1.75e18 + own.t_s * 1e9)
    in_si = own.assign(**{name: own[name] * 9.80665 for name in ("ax_g", "ay_g", "az_g")})
    names = {"ax_g": "accel_x", "ay_g": "accel_y", "az_g": "accel_z", "inc_ref_deg": "ref_inclination_deg",
             "tf_ref_deg": "ref_toolface_deg", "t_s": "timestamp", "temp_c": "temperature"}  # fmt: skip
    dump = in_si.assign(t_s=when).rename(columns=names)
    dump.to_csv(folder / "pandas.csv")
    dump.to_csv(folder / "pandas_noindex.csv", index=False)
    dump.to_parquet(folder / "pandas.parquet")
    in_si.to_csv(folder / "si.csv", index=False)
    own.to_csv(folder / "eu.csv", sep=";", decimal=",", index=False)
    own.assign(t_s=when.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")).to_csv(folder / "iso.csv", index=False)
    own.to_csv(folder / "bom.csv", index=False, encoding="utf-8-sig")
    return folder


WAYS = {
    "pandas.csv": ["--yes"],
    "pandas_noindex.csv": ["--units", "m/s2,C"],
    "pandas.parquet": ["--yes"],
    "si.csv": ["--units", "m/s2"],
    "eu.csv": [],
    "iso.csv": [],
    "bom.csv": [],
    "s.parquet": [],
    "s.mcap": [],
}


@pytest.mark.parametrize("file", WAYS)
def test_the_disguises_of_one_recording_are_one_recording(bench: Path, file: str) -> None:
    done = highside(bench, "import", file, "-o", f"{file}.out.csv.gz", *WAYS[file])
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    found, wanted = read_recording(bench / f"{file}.out.csv.gz"), read_recording(bench / "s.csv")
    for name in ("t_s", "ax_g", "ay_g", "az_g", "temp_c", "inc_ref_deg", "tf_ref_deg", "pose", "direction"):
        np.testing.assert_allclose(found[name], wanted[name], rtol=0, atol=1e-9, err_msg=name)


def test_from_a_dump_to_poses_and_a_diagnosis(bench: Path, project_root: Path) -> None:
    assert highside(bench, "import", "pandas.csv", "-o", "d.csv.gz", "--yes").returncode == 0
    done = highside(bench, "calibrate", "poses", "d.csv.gz", "-o", "poses.csv")
    assert done.stdout.startswith("poses.csv: 20 poses, 200 of 200 readings")
    model = project_root / "config" / "model-known.toml"
    done = highside(bench, "diagnose", "d.csv.gz", "--model", str(model), "--out", "report")
    assert done.returncode == 0, done.stderr
    found = json.loads((bench / "report" / "diagnosis.json").read_text())
    assert (found["verdict"], [claim["effect"] for claim in found["claims"]]) == ("named", ["base_tilt"])


@pytest.mark.parametrize("file", ["s.mcap", "s.parquet"])
def test_the_commands_take_what_export_writes(bench: Path, file: str) -> None:
    plain = highside(bench, "calibrate", "poses", "s.csv", "-o", "plain.csv")
    done = highside(bench, "calibrate", "poses", file, "-o", "other.csv")
    assert done.returncode == plain.returncode == 0, done.stderr
    assert (bench / "other.csv").read_bytes() == (bench / "plain.csv").read_bytes()


def test_what_is_uncertain_is_refused_without_a_terminal(bench: Path) -> None:
    done = highside(bench, "import", "pandas.csv", "-o", "never.csv")
    assert done.returncode == 2
    *shown, last = done.stderr.splitlines()
    assert last.startswith("highside: pandas.csv: ax_g from accel_x in m/s2 rests on its values alone")
    assert "--units m/s2" in last
    assert "--yes takes what is shown" in last
    assert any(re.match(r"  ax_g +accel_x +m/s2 +likely +no unit named; median \|a\| 9\.8", line) for line in shown)
    assert not (bench / "never.csv").exists()
    done = highside(bench, "import", "si.csv", "-o", "never.csv", "--yes")
    assert done.returncode == 2, "name and values contradict one another: no --yes takes that"
    assert "named g, but then |a| is 9.83 g; --units m/s2" in done.stderr


def test_a_file_is_inspected_and_nothing_is_written(bench: Path) -> None:
    before = sorted(path.name for path in bench.iterdir())
    done = highside(bench, "import", "pandas.csv", "--inspect")
    assert (done.returncode, done.stdout) == (0, "") and "median |a| 9.8" in done.stderr
    said = json.loads(highside(bench, "import", "pandas.csv", "--inspect", "--json").stdout)
    assert not said["own"] and said["rows"] == 200
    assert ["ax_g", "accel_x", "m/s2", "likely"] in [row[:4] for row in said["columns"]]
    assert said["doubts"] and not any(doubt["open"] for doubt in said["doubts"])
    said = json.loads(highside(bench, "import", "si.csv", "--inspect", "--json").stdout)
    assert any(doubt["open"] and "--units m/s2" in doubt["remedy"] for doubt in said["doubts"])
    assert json.loads(highside(bench, "import", "s.csv", "--inspect", "--json").stdout)["own"]
    assert sorted(path.name for path in bench.iterdir()) == before
    done = highside(bench, "import", "s.csv")
    assert done.returncode == 2 and "--output" in done.stderr and done.stderr.count("\n") == 1


def test_that_the_sign_of_gravity_is_assumed_is_said_where_nothing_shows_it(bench: Path) -> None:
    own = pd.read_csv(bench / "s.csv")
    own.drop(columns=["inc_ref_deg", "tf_ref_deg"]).to_csv(bench / "bare.csv", index=False)
    (bench / "shown.csv").write_bytes((bench / "s.csv").read_bytes())
    assumed = "up reads +1 g or -1 g; +1 g is assumed"
    for file, says in (("bare.csv", True), ("shown.csv", False)):
        done = highside(bench, "import", file, "-o", f"{file}.out.csv.gz")
        assert done.returncode == 0 and (assumed in done.stderr) == says, done.stderr


def test_a_profile_is_kept_and_used(bench: Path) -> None:
    done = highside(bench, "import", "pandas.csv", "-o", "one.csv", "--yes", "--profile", "dump")
    assert "kept as profile dump" in done.stderr
    again = highside(bench, "import", "pandas.csv", "-o", "two.csv", "--profile", "dump")
    assert again.returncode == 0, again.stderr
    assert (bench / "one.csv").read_bytes() == (bench / "two.csv").read_bytes()
    wrong = highside(bench, "import", "pandas.csv", "-o", "three.csv", "--profile", "../dump")
    assert (wrong.returncode, "is no name of a profile" in wrong.stderr) == (2, True)


@pytest.mark.parametrize(("name", "count"), [("out.csv", 3), ("out.csv.gz", 3), ("out.parquet", 3)])
def test_the_name_of_the_output_says_its_form(tmp_path: Path, name: str, count: int) -> None:
    (tmp_path / "x.tsv").write_text("t_s\tax_g\tay_g\taz_g\n0\t0\t0\t1\n0.01\t0\t0\t1\n0.02\t0\t0\t1\n")
    done = highside(tmp_path, "import", "x.tsv", "-o", name)
    assert done.returncode == 0, done.stderr
    assert Recording.read(tmp_path / name).n == count


def test_the_commands_of_the_page_are_taken_by_the_parser(project_root: Path) -> None:
    import typer

    from highside.cli.main import app

    command = typer.main.get_command(app).commands["import"]  # type: ignore[attr-defined]
    page = (project_root / "docs" / "import.md").read_text()
    lines = re.findall(r"^highside import (.*)$", page, re.MULTILINE)
    assert len(lines) == 10
    for line in lines:
        command.make_context("import", shlex.split(line))
