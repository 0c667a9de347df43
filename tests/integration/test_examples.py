"""Every command's help ends with an example that its parser takes; those that need no hardware do what they say."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import typer
from daemon import HIGHSIDE

from highside.cli.examples import EXAMPLES
from highside.cli.main import app

ROOT = Path(__file__).resolve().parents[2]

TOGETHER = (
    ["simulate"],
    ["predict"],
    ["check"],
    ["schema"],
    ["effects"],
    ["calibrate", "sessions"],
    ["calibrate", "poses"],
    ["calibrate", "solve"],
    ["keys", "new"],
    ["keys", "show"],
    ["keys", "sign"],
    ["keys", "verify"],
    ["calibrate", "show"],
    ["calibrate", "activate"],
    ["calibrate", "history"],
    ["calibrate", "apply"],
    ["calibrate", "certificate"],
)
"""run one after the other, in one folder: each finds what those before it made"""


def commands(command: Any, path: tuple[str, ...] = ()) -> dict[str, Any]:
    """Those that do something, by name; a group that runs without a word behind it is one of them."""
    found = {
        name: leaf
        for word, below in getattr(command, "commands", {}).items()
        for name, leaf in commands(below, (*path, word)).items()
    }
    if path and (not found or command.invoke_without_command):
        found[" ".join(path)] = command
    return found


ALL = commands(typer.main.get_command(app))


def test_every_command_has_an_example_and_every_example_a_command() -> None:
    assert EXAMPLES.keys() == ALL.keys()


@pytest.mark.parametrize("name", ALL)
def test_the_example_stands_in_the_help_and_is_taken_by_the_parser(name: str) -> None:
    command = ALL[name]
    shown = " ".join((command.epilog or "").split())
    assert shown == f"Example: `highside {name} {EXAMPLES[name]}".rstrip() + "`"
    command.make_context(name, shlex.split(EXAMPLES[name]))


def test_the_help_of_a_command_prints_it() -> None:
    help_text = subprocess.run(
        [HIGHSIDE, "keys", "sign", "--help"], capture_output=True, text=True, timeout=60, check=True,
        env={**os.environ, "COLUMNS": "160"},
    ).stdout  # fmt: skip
    assert "Example: highside keys sign cal.json --key lab.key" in " ".join(help_text.split())


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_examples_that_need_no_hardware_do_what_they_say(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "config", tmp_path / "config")
    home = {**os.environ, "HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path / "data")}
    for words in TOGETHER:
        line = [str(HIGHSIDE), *words, *shlex.split(EXAMPLES[" ".join(words)])]
        done = subprocess.run(line, cwd=tmp_path, env=home, capture_output=True, text=True, timeout=200, check=False)
        assert done.returncode == 0, (words, done.stdout[-500:], done.stderr[-500:])
    # a verdict may be any, but it is one
    line = [str(HIGHSIDE), "calibrate", "verify", *shlex.split(EXAMPLES["calibrate verify"])]
    done = subprocess.run(line, cwd=tmp_path, env=home, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode in (0, 1), done.stderr
    made = {path.name for path in tmp_path.iterdir()}
    assert {"session.csv.gz", "poses.csv", "predicted.csv", "cal.json", "lab.key", "corrected.csv"} <= made
    assert "certificate.html" in made
