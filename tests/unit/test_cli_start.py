"""What the command line has loaded before it knows what it is asked."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from highside.cli import commands
from tests.few_poses import model_of_few_poses

HIGHSIDE = Path(sys.executable).parent / "highside"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command as the shell starts it."""
    return subprocess.run([HIGHSIDE, *arguments], capture_output=True, text=True, timeout=60)


def test_numpy_is_not_imported_before_its_threads_are_settled() -> None:
    # OPENBLAS_NUM_THREADS is read when numpy is imported; a diagnosis takes half as long again without it
    program_text = "import highside.cli.main, sys; print('numpy' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", program_text], capture_output=True, text=True).stdout.strip() == "False"
    )


@pytest.mark.parametrize("asked", ["--version", "--help"])
def test_nothing_heavy_is_imported_to_say_what_there_is(asked: str) -> None:
    program_text = (
        "import sys; from highside.cli.main import app; app([sys.argv[1]], standalone_mode=False);"
        " heavy = {'numpy', 'scipy', 'pydantic_settings', 'matplotlib', 'nicegui', 'aiomqtt', 'serial', 'can'};"
        " print('heavy:', *sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program_text, asked], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1].strip() == "heavy:", done.stderr


NEVER = {"matplotlib", "bokeh", "pyarrow", "nicegui", "scipy.stats", "pydantic_settings", "highside.service"}
"""What no diagnosis without a page needs, whatever it finds"""


def modules_of(program: str, *arguments: str) -> set[str]:
    """What a fresh interpreter has loaded when `program` has ended."""
    program_text = f"import sys\n{program}\nprint('loaded:', *sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program_text, *arguments], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].removeprefix("loaded:").split())


def test_the_version_is_reported_without_the_commands() -> None:
    loaded = modules_of("from highside.cli.main import main; main()", "--version")
    own = {name for name in loaded if name.startswith("highside")}
    assert own == {
        "highside",
        "highside.cli",
        "highside.cli.main",
        "highside.cli.say",
        "highside.printable",
        "highside.version",
    }
    assert not loaded & {"typer", "typing_extensions", "asyncio", "importlib.metadata"}


@pytest.mark.parametrize("command", ["diagnose", "decode", "run", "calibrate"])
def test_a_command_loads_no_other(command: str) -> None:
    loaded = modules_of(f"from highside.cli.commands import app_of; app_of({command!r})")
    others = {"confirm", "decode", "detect", "diagnose", "drift", "calibrate", "rotation", "run", "fleet"} - {command}
    assert f"highside.cli.{command}" in loaded
    assert not loaded & {f"highside.cli.{other}" for other in others}


def test_a_diagnosis_without_a_page_loads_what_it_works_with_and_no_more(tmp_path: Path) -> None:
    model = model_of_few_poses(tmp_path / "model.toml")
    recording = tmp_path / "poses.csv"
    assert run("simulate", str(model), "-o", str(recording), "--seed", "1").returncode == 0
    arguments = ("diagnose", str(recording), "--model", str(model), "--out", str(tmp_path), "--no-report")
    loaded = modules_of("from highside.cli.commands import run; run(sys.argv[1:])", *arguments)
    assert not loaded & NEVER
    assert (tmp_path / "diagnosis.json").exists()
    assert not (tmp_path / "report.html").exists()
    # of poses: what other kinds of reference need is loaded by those who have one; a room more is noticed
    assert sum(name.startswith("highside.") for name in loaded) < 300


def test_a_chart_for_the_screen_is_written_without_the_python_of_what_draws_it() -> None:
    program = (
        "import numpy as np; from highside.shown import Plot, PlotLine, PlotPanel\n"
        "x = np.arange(3.0); assert 'Bokeh' in Plot('', (PlotPanel(x, (PlotLine('y', x),)),)).html()"
    )
    assert not {name for name in modules_of(program) if name.split(".")[0] in ("bokeh", "tornado", "matplotlib")}


def test_the_public_names_are_loaded_one_by_one() -> None:
    loaded = modules_of("import highside; highside.read; highside.diagnose")
    others = ("certificate", "confirmation", "gyro", "learning", "rotation", "simulation", "turntable")
    assert not loaded & {f"highside.api.{name}" for name in others}
    assert not loaded & NEVER


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rnu"], "highside: No such command 'rnu'. Did you mean 'run'? (see highside --help)"),
        (["run"], "highside: Missing option '--config'. (see highside run --help)"),
        (["--nope"], "highside: No such option: --nope (see highside --help)"),
        (["demo", "--secnods", "3"], "--seconds"),
        (["demo", "--seconds", "x"], "highside: Invalid value for '--seconds'"),
        (["calibrate", "slve"], "Did you mean 'solve'? (see highside calibrate --help)"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_status_2(arguments: list[str], said: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.startswith("highside: ")
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


@pytest.mark.parametrize("group", [[], ["calibrate"], ["rotation"], ["toolface"], ["reproduce"]])
def test_a_group_without_a_command_prints_its_help(group: list[str]) -> None:
    done = run(*group)
    assert done.returncode == 2
    assert "Commands" in done.stdout
    command = " ".join(["highside", *group])
    assert done.stderr == f"highside: no command given; choose one of those above (see {command} --help)\n"


def test_the_shell_is_reported_how_a_command_goes_on() -> None:
    asked = {"_HIGHSIDE_COMPLETE": "complete_bash", "COMP_WORDS": "highside ca", "COMP_CWORD": "1"}
    done = subprocess.run([HIGHSIDE], capture_output=True, text=True, env=os.environ | asked, timeout=60)
    assert done.stdout.split() == ["calibrate"]


@pytest.mark.parametrize("number", ["nan", "-inf"])
@pytest.mark.parametrize(
    ("asked", "option"),
    [
        ("calibrate poses x.csv -o y.csv", "--window-s"),
        ("calibrate solve x.csv --method joint -o y.json", "--expires-days"),
        ("rotation fit x.csv --method sine -o y.json", "--inclination-deg"),
        ("diagnose x.csv", "--from"),
        ("surveys list x.jsonl", "--sensor-offset-m"),
    ],
)
def test_an_option_that_is_no_number_is_refused_before_a_command_begins(
    asked: str, option: str, number: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert commands.run([*asked.split(), f"{option}={number}"]) == 2
    assert option in (said := capsys.readouterr().err)
    assert said.count("\n") == 1


@pytest.mark.parametrize("option", ["--azimuth-std-deg", "--gyro-arw", "--gyro-rrw", "--gyro-bias-std"])
def test_an_uncertainty_beyond_reason_is_wrong_usage(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.run(["drift", "x.csv", "--method", "kinematic", "-o", "y.csv", f"{option}=1e17"]) == 2
    assert option in capsys.readouterr().err


def test_a_reading_beyond_reason_prints_no_lines_of_this_program(tmp_path: Path) -> None:
    rows = "".join(f"{0.1 * i},{'1e300' if i == 30 else 0.5},0.1,0.86\n" for i in range(100))
    (tmp_path / "r.csv").write_text("t_s,ax_g,ay_g,az_g\n" + rows)
    asked = [HIGHSIDE, "calibrate", "poses", "r.csv", "-o", "p.csv"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONWARNINGS"}
    done = subprocess.run(asked, capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=60)
    assert "Warning" not in done.stderr, done.stderr


@pytest.mark.parametrize("asked", [["schema"], ["effects"], ["examples"]])
def test_an_output_onto_a_full_disk_is_one_line_and_exit_status_2(asked: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([HIGHSIDE, *asked], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("highside: the output cannot be written: No space left on device; make room")


@pytest.mark.parametrize("name", ["x" * 5000, "loop/x.csv"])
def test_a_place_that_cannot_be_used_is_one_line_and_exit_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    assert commands.run(["simulate", "--experiment", "turntable", "-o", name]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert "internal error" not in said.err
    assert name[:100] in said.err


def test_a_folder_that_may_not_be_entered_is_one_line_and_exit_status_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Who tests as root may enter every folder: the answer of the file system is put in its place."""

    def no_entry(path: Path) -> bool:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(Path, "is_file", no_entry)
    assert commands.run(["simulate", "-o", "theirs/x.csv"]) == 2
    assert (
        capsys.readouterr().err == "highside: theirs/x.csv: Permission denied; name another place, or mend this one\n"
    )
