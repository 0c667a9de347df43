"""One recording on the processes of a cluster: the answer of the threads, whatever becomes of a process."""

from __future__ import annotations

import json
import os
import pickle
import signal
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, KilledWorker, LocalCluster
from typer.testing import CliRunner

from highside.api.diagnosis import diagnose
from highside.cli.main import app
from highside.diagnosis.core.method import ProcedureParts
from highside.errors import InputError
from highside.fleet import spread
from highside.scratch_arrays import ScratchFile, scratch_shared
from studies.giant_recording import MODEL, differences, written

FURTHER = pytest.mark.further

BARE = ProcedureParts.without("laws")
ROWS = 20_000
"""five runs of rows"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = written(ROWS, tmp_path_factory.mktemp("recorded"))
    path.with_name("model.toml").write_text(MODEL)
    return path


@pytest.fixture(scope="module")
def alone(recorded: Path) -> dict[str, Any]:
    return diagnose(recorded, recorded.with_name("model.toml"), run_by_run=True, method=BARE).to_dict()


@pytest.fixture(scope="module")
def running() -> Iterator[LocalCluster]:
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as begun:
        yield begun


def diagnosed(recorded: Path, address: str, runs: int, scratch: Path) -> dict[str, Any]:
    with spread.on_cluster(address, runs=runs, scratch=scratch):
        found = diagnose(recorded, recorded.with_name("model.toml"), run_by_run=True, method=BARE)
    # nothing is left behind
    assert not list(scratch.iterdir())
    return found.to_dict()


@FURTHER
def test_the_answer_is_that_of_threads(
    recorded: Path, alone: dict[str, Any], running: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    passes = []

    class Counted(spread.Cluster):
        def results(self, work: Any, items: Any, both: Any = None) -> Iterator[Any]:
            passes.append((work.__qualname__.split(".")[0], both is not None))
            return super().results(work, items, both)

    monkeypatch.setattr(spread, "Cluster", Counted)
    found = diagnosed(recorded, running.scheduler_address, 2, tmp_path)
    assert found["verdict"] == alone["verdict"] == "named"
    worst = max(differences(alone, found))
    assert worst[0] < 1e-9, worst
    # base fit and its columns, inner products, sums of squares, means over the turn
    assert {name for name, _ in passes} == {"Observed", "accumulate", "energy", "Sectors"}
    assert ("accumulate", True) in passes


def test_a_task_that_ends_every_process_is_an_error(tmp_path: Path) -> None:
    given: list[tuple[int, int]] = []

    class Dying:
        def result(self) -> list[Any]:
            raise KilledWorker("task", None, 0)

    class Deadly:
        def nthreads(self) -> dict[str, int]:
            return {"tcp://127.0.0.1:1": 1}

        def submit(self, function: Any, place: str, start: int, stop: int, *, pure: bool) -> Any:
            given.append((start, stop))
            return Dying()

    with pytest.raises(InputError, match="runs 0 to 1 of rows ended 3 processes"):
        list(spread.Cluster(Deadly(), tmp_path, 1).results(abs, [1, 2]))
    assert given.count((0, 1)) == 3
    assert not list(tmp_path.iterdir())


def test_the_command_takes_an_address(
    recorded: Path, running: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the search for laws is of rows in the memory, and takes longest
    monkeypatch.setattr("highside.api.diagnosis.diagnose", partial(diagnose, method=BARE))
    monkeypatch.setattr(spread, "SPREAD", replace(spread.SPREAD, runs=1))
    given = ["diagnose", str(recorded), "--model", str(recorded.with_name("model.toml")), "--out", str(tmp_path)]
    given += ["--no-report", "--cluster"]
    done = CliRunner().invoke(app, [*given, running.scheduler_address])
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "diagnosis.json").read_text())["verdict"] == "named"
    for more, words in (
        ([running.scheduler_address, "--in-memory"], "--cluster: rows that are held in the memory are not given out"),
        ([running.scheduler_address, "--effects", str(tmp_path)], "--cluster: its processes do not have effects"),
        ([running.scheduler_address, "--from", "3"], "--cluster: is no rotation with a known reference in Parquet"),
    ):
        done = CliRunner().invoke(app, [*given, *more])
        assert words in str(done.exception), done.output


def test_processes_that_do_not_fit_are_named(
    running: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spread, "__version__", "0.0.1")
    with pytest.raises(InputError, match=r"this is 0\.0\.1"), spread.on_cluster(running.scheduler_address):
        pass
    monkeypatch.setattr(spread, "_seen", _blind)
    with pytest.raises(InputError, match=r"does not see .*TMPDIR"), spread.on_cluster(running.scheduler_address):
        pass


def _blind(token: str) -> str | None:
    return None


def test_a_file_without_a_name_is_not_sent(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="without a name"):
        pickle.dumps(ScratchFile())
    with scratch_shared(tmp_path):
        made = ScratchFile()
        made.append(b"rows")
        sent = pickle.loads(pickle.dumps(made))
        assert sent.read(4, 0) == b"rows"


def test_a_process_that_is_killed_costs_no_answer(
    recorded: Path, alone: dict[str, Any], running: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGKILL of one of two processes while both work on the inner products."""
    killed = []

    class Killing(spread.Cluster):
        now = ""

        def results(self, work: Any, items: Any, both: Any = None) -> Iterator[Any]:
            self.now = work.__qualname__
            return super().results(work, items, both)

        def _submit(self, place: str, part: tuple[int, int]) -> Any:
            future = super()._submit(place, part)
            if self.now.startswith("accumulate") and part[0] == 3 and not killed:
                killed.append(min(client.run(os.getpid).values()))
                os.kill(killed[0], signal.SIGKILL)
            return future

    monkeypatch.setattr(spread, "Cluster", Killing)
    with Client(running) as client:
        found = diagnosed(recorded, running.scheduler_address, 1, tmp_path)
    assert killed
    # sums of single runs are added in their order: the same to the last digit
    assert found == alone
