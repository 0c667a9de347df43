"""Every form that `export` writes is read by the commands that take a recording, with the same outcome."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from daemon import HIGHSIDE

FORMS = ("csv", "parquet", "mcap")
"""what `export` writes"""
COMMANDS = {
    "poses": ("calibrate", "poses", "{rec}", "-o", "{out}"),
    "predict": ("predict", "{model}", "{rec}", "-o", "{out}"),
    "export": ("export", "{rec}", "--to", "csv", "-o", "{out}"),
    "apply": ("calibrate", "apply", "{cal}", "{rec}", "-o", "{out}"),
}


def highside(*arguments: str | Path) -> None:
    done = subprocess.run([HIGHSIDE, *arguments], capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    made = tmp_path_factory.mktemp("forms")
    model = project_root / "config" / "model-bench.toml"
    highside("simulate", model, "-o", made / "rec.csv.gz", "--seed", "3")
    for form in ("csv", "parquet", "mcap"):
        highside("export", made / "rec.csv.gz", "--to", form, "-o", made / f"rec.{form}")
    highside("calibrate", "poses", made / "rec.csv.gz", "-o", made / "poses.csv")
    highside("calibrate", "solve", made / "poses.csv", "--method", "joint", "-o", made / "cal.json")
    return made


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_reads_every_form_alike(folder: Path, project_root: Path, command: str) -> None:
    outcomes = {}
    for form in FORMS:
        out = folder / f"{command}-{form}.csv"
        places = {
            "rec": str(folder / f"rec.{form}"), "out": str(out), "cal": str(folder / "cal.json"),
            "model": str(project_root / "config" / "model-bench.toml"),
        }  # fmt: skip
        highside(*(word.format(**places) for word in COMMANDS[command]))
        outcomes[form] = out.read_text()
    assert len(outcomes["csv"].splitlines()) > 5
    assert len(set(outcomes.values())) == 1, [form for form in FORMS if outcomes[form] != outcomes["csv"]]
