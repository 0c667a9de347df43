"""Files that go away or change between two looks of a command at them: one line, exit status 2, no output begun."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from highside.cli.commands import run

CONFIG = Path(__file__).parents[2] / "config"
COMMANDS = {
    "calibrate poses rec.csv -o out.csv": ["rec.csv"],
    "calibrate solve poses.csv --method conventional -o out.json": ["poses.csv"],
    "calibrate apply cal.json rec.csv -o out.csv": ["cal.json", "rec.csv"],
    "calibrate verify cal.json poses.csv --limit-inc-deg 0.5 --limit-tf-deg 1": ["cal.json", "poses.csv"],
    "import rec.csv -o out.csv": ["rec.csv"],
    "fleet records folder --html out.html": ["folder/cal.json"],
}


def vanish(path: Path) -> None:
    path.unlink()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:40])


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


class Watched:
    """Changes a file right before it is opened for the `count`-th time. Hooks cannot be taken away: one for all."""

    def __init__(self) -> None:
        self._path, self._change, self._left = Path(), vanish, 0
        sys.addaudithook(self._seen)

    @contextmanager
    def changing(self, path: Path, change: Callable[[Path], None], count: int) -> Iterator[None]:
        self._path, self._change, self._left = path, change, count
        try:
            yield
        finally:
            self._left = 0

    def _seen(self, event: str, arguments: tuple[object, ...]) -> None:
        if not self._left or event != "open" or not isinstance(name := arguments[0], str | os.PathLike):
            return
        if Path(name).absolute() == self._path:
            self._left -= 1
            if not self._left:
                self._change(self._path)


@pytest.fixture(scope="module")
def watched() -> Watched:
    return Watched()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("inputs")
    shutil.copy(CONFIG / "model-bench.toml", place / "model.toml")
    (place / "folder").mkdir()
    for words in (
        f"simulate {place}/model.toml -o {place}/rec.csv",
        f"calibrate poses {place}/rec.csv -o {place}/poses.csv",
        f"calibrate solve {place}/poses.csv --method joint --tool t1 -o {place}/cal.json",
    ):
        assert run(words.split()) == 0
    shutil.copy(place / "cal.json", place / "folder")
    return place


@pytest.mark.parametrize("change", [vanish, cut, folder, pipe])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_that_changes_under_a_command_is_one_line(
    command: str,
    change: Callable[[Path], None],
    inputs: Path,
    watched: Watched,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in COMMANDS[command]:
        for count in (1, 2):
            for old in tmp_path.iterdir():
                shutil.rmtree(old) if old.is_dir() else old.unlink()
            shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
            before = set(tmp_path.iterdir())
            with watched.changing(tmp_path / name, change, count):
                status = run(command.split())
            said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("highside: ")]
            if count == 1 or status not in (0, 1):  # not every command looks twice
                assert (status, len(said)) == (2, 1), (name, count, said)
                assert "internal error" not in said[0]
                assert set(tmp_path.iterdir()) <= before, "an output was begun"
