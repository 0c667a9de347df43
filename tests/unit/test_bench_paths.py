"""Relative paths of a bench session's file start at the file, those of --set at the working directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from highside.config.bench import PATHS, BenchFile, load_bench
from highside.config.places import calibrations, sessions
from highside.errors import InputError

FILE = '[simulated]\n[plan]\nkind = "custom"\nfile = "poses.csv"\n'


def test_relative_names_start_at_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, elsewhere = tmp_path / "bench", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    config = folder / "bench.toml"
    config.write_text(FILE)
    found = load_bench(Path("../bench/bench.toml"))
    assert (found.store.directory, found.store.sessions) == (calibrations(), sessions())
    assert found.plan.file == folder / "poses.csv"  # type: ignore[union-attr]
    # one given, one not
    config.write_text(FILE + '[store]\nsessions = "journals"\n')
    found = load_bench(config)
    assert found.store.sessions == folder / "journals"
    assert found.store.directory == calibrations()
    # absolute ones and overrides are taken as they are
    config.write_text(FILE + '[store]\nsessions = "/var/lib/journals"\n')
    found = load_bench(config, ["store.directory=here", 'plan={kind="custom",file="mine.csv"}'])
    assert found.store.sessions == Path("/var/lib/journals")
    assert found.store.directory == Path("here")
    assert found.plan.file == Path("mine.csv")  # type: ignore[union-attr]


def test_a_store_that_is_no_table_is_said(tmp_path: Path) -> None:
    config = tmp_path / "bench.toml"
    config.write_text('store = "here"\n' + FILE)
    with pytest.raises(InputError, match="store"):
        load_bench(config)


def test_every_path_of_the_file_is_anchored() -> None:
    def paths(model: type[BaseModel], above: tuple[str, ...]) -> set[tuple[str, ...]]:
        out: set[tuple[str, ...]] = set()
        for name, field in model.model_fields.items():
            for kind in flat(field.annotation):
                if kind is Path:
                    out.add((*above, name))
                elif isinstance(kind, type) and issubclass(kind, BaseModel):
                    out |= paths(kind, (*above, name))
        return out

    def flat(kind: Any) -> list[Any]:
        parts = get_args(kind)
        return [kind] if not parts else [deep for part in parts for deep in flat(part)]

    assert paths(BenchFile, ()) == set(PATHS)
