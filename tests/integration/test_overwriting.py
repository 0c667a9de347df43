"""A command whose output is one of its inputs is refused, and what was there is there."""

from __future__ import annotations

import hashlib
import inspect
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from daemon import HIGHSIDE

from highside.cli import overwriting
from highside.cli.commands import app_of

CASES = {
    "apply": "calibrate apply cal.json rec.csv -o rec.csv",
    "apply to the record": "calibrate apply cal.json rec.csv -o cal.json",
    "by another path": "calibrate apply cal.json rec.csv -o ./sub/../rec.csv",
    "by a link": "predict model.toml rec.csv -o link.csv",
    "predict": "predict model.toml rec.csv -o rec.csv",
    "poses": "calibrate poses rec.csv -o rec.csv",
    "solve": "calibrate solve poses.csv --method joint -o poses.csv",
    "import": "import rec.csv --yes -o rec.csv",
    "export": "export rec.csv --to csv -o rec.csv",
    "learnt model": "diagnose rec.csv --model model.toml --out report --write-model model.toml",
    "simulate over its model": "simulate model.toml -o model.toml",
    "two answers": "simulate model.toml -o new.csv --poses new.csv",
    "verification": "calibrate verify cal.json poses.csv --limit-inc-deg 1 --limit-tf-deg 1 -o poses.csv",
    "page": "rotation compare rec.csv --html rec.csv",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    made = tmp_path_factory.mktemp("inputs")
    (made / "model.toml").write_bytes((project_root / "config/model-bench.toml").read_bytes())
    for words in (
        "simulate model.toml -o rec.csv --poses poses.csv",
        "calibrate solve poses.csv --method joint -o cal.json",
    ):
        subprocess.run([HIGHSIDE, *words.split()], cwd=made, check=True, capture_output=True, timeout=120)
    (made / "link.csv").symlink_to("rec.csv")
    (made / "sub").mkdir()
    return made


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("case", CASES)
def test_an_input_is_not_written_over(folder: Path, case: str) -> None:
    before = digests(folder)
    done = subprocess.run([HIGHSIDE, *CASES[case].split()], cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2, done.stdout
    assert len(done.stderr.splitlines()) == 1 and "name another file" in done.stderr
    assert digests(folder) == before


def commands(app: typer.Typer) -> Iterator[Any]:
    yield from (command.callback for command in app.registered_commands)
    for group in app.registered_groups:
        assert group.typer_instance is not None
        yield from commands(group.typer_instance)


def test_every_command_that_names_an_output_is_guarded() -> None:
    guarded = {command.__name__ for command in commands(app_of()) if hasattr(command, "__wrapped__")}
    written = {
        command.__name__ for command in commands(app_of()) if dict(overwriting._outputs(inspect.unwrap(command)))
    }
    assert guarded == written and len(guarded) > 20


PRECIOUS = {
    "mine.key": b"-----BEGIN PRIVATE KEY-----\nMC4CAQ==\n-----END PRIVATE KEY-----\n",
    "wire.hsw": b"HSWIRE1\n{}\n",
    "outbox.sqlite": b"SQLite format 3\0" + b"\0" * 84,
    "bench.journal": b'{"n":0,"e":"session"}\n',
}


@pytest.mark.parametrize("name", PRECIOUS)
@pytest.mark.parametrize("words", ["calibrate poses rec.csv -o", "export rec.csv --to csv -o"])
def test_what_nobody_can_make_again_is_not_replaced(folder: Path, tmp_path: Path, name: str, words: str) -> None:
    there = tmp_path / name
    there.write_bytes(PRECIOUS[name])
    command = [HIGHSIDE, *words.split(), str(there)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2, done.stdout
    assert len(done.stderr.splitlines()) == 1
    assert "is not replaced" in done.stderr and str(there) in done.stderr
    assert there.read_bytes() == PRECIOUS[name]


def test_a_command_replaces_its_own_earlier_answer(folder: Path, tmp_path: Path) -> None:
    for _ in range(2):
        command = [HIGHSIDE, "export", "rec.csv", "--to", "csv", "-o", str(tmp_path / "out.csv")]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=120)
