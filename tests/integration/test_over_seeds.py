"""Monte Carlo of the studies on the processes of a fleet: the figures of a loop, kept, resumed, whoever dies."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies import over_seeds
from studies.over_seeds import NoAnswerError, OnProcesses, in_a_loop

TOP = Path(__file__).parents[2]


def drawn(seed: int, scale: float, folder: str) -> dict[str, Any]:
    """An answer of its seed, and a note that it was asked for."""
    with Path(folder, "calls").open("a") as calls:
        calls.write(f"{seed}\n")
    rng = np.random.default_rng(seed)
    return {
        "rows": scale * rng.standard_normal((2, 3)),
        "none": None,
        "nan": math.nan,
        "of": (seed, rng.random() < 0.5),
    }


def troubled(seed: int, folder: str) -> int:
    """Seed 2 ends the first process that it is given to; 4 has an error, and 5 ends every process, while so told."""
    first = Path(folder, "first")
    if seed == 2 and not first.exists():
        first.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if Path(folder, "troubled").exists():
        if seed == 4:
            raise ValueError("a number that is none")
        if seed == 5:
            os.kill(os.getpid(), signal.SIGKILL)
    return 10 * seed


def test_the_answers_are_those_of_a_loop_and_are_computed_once(tmp_path: Path) -> None:
    parts = tmp_path / "parts-of-it"
    cases = [(seed, 1 / 3, str(tmp_path)) for seed in range(12)]
    looped = in_a_loop(drawn, cases)
    (tmp_path / "calls").unlink()
    over = OnProcesses(2, parts, seconds=5.0)
    np.testing.assert_equal(over(drawn, cases), looped)
    assert sorted((tmp_path / "calls").read_text().split(), key=int) == [str(seed) for seed in range(12)]
    assert len(list((parts / "parts").glob("*.parquet"))) > 1

    # what is there is read; more cases, and others, are computed
    np.testing.assert_equal(over(drawn, list(reversed(cases))), list(reversed(looped)))
    assert len((tmp_path / "calls").read_text().split()) == 12
    more = [*cases, (12, 1 / 3, str(tmp_path)), (0, 0.25, str(tmp_path))]
    found = over(drawn, more)
    np.testing.assert_equal(found[:12], looped)
    assert found[13]["rows"] == (0.75 * np.array(looped[0]["rows"])).tolist()
    assert (tmp_path / "calls").read_text().split()[12:] in (["12", "0"], ["0", "12"])


def test_a_process_that_dies_costs_no_answer_and_a_case_without_one_is_told(tmp_path: Path) -> None:
    (tmp_path / "troubled").touch()
    cases = [(seed, str(tmp_path)) for seed in range(6)]
    over = OnProcesses(2, tmp_path / "kept", seconds=5.0)
    with pytest.raises(NoAnswerError, match=r"2 of 6 cases have no answer") as told:
        over(troubled, cases)
    assert "a number that is none" in str(told.value) or "ended 3 processes" in str(told.value)
    assert (tmp_path / "first").exists()
    # the others are kept, and the study goes on where it stopped
    (tmp_path / "troubled").unlink()
    before = {path.name for path in (tmp_path / "kept" / "parts").iterdir()}
    assert over(troubled, cases) == [0, 10, 20, 30, 40, 50]
    assert before < {path.name for path in (tmp_path / "kept" / "parts").iterdir()}


def test_an_answer_of_other_code_is_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "law.py").write_text("G = 9.81\n")
    monkeypatch.setattr(over_seeds, "CODE", (tmp_path,))
    over_seeds.code_digest.cache_clear()
    try:
        before = over_seeds.key_case("study:one", (1, "x"))
        assert before == over_seeds.key_case("study:one", (1, "x")) != over_seeds.key_case("study:one", (2, "x"))
        over_seeds.code_digest.cache_clear()
        (tmp_path / "law.py").write_text("G = 9.82\n")
        assert over_seeds.key_case("study:one", (1, "x")) != before
    finally:
        over_seeds.code_digest.cache_clear()


def test_a_study_prints_the_same_table_either_way(tmp_path: Path) -> None:
    asked = [sys.executable, "-m", "studies.schedule_coverage", "--sensors", "12", "--only", "joint"]
    runs = [asked, [*asked, "--workers", "2", "--parts", str(tmp_path)]]
    told = [subprocess.run(run, capture_output=True, text=True, cwd=TOP, check=False) for run in runs]
    assert [one.returncode for one in told] == [0, 0], told[1].stderr
    assert told[0].stdout == told[1].stdout
    assert told[0].stdout.count("| joint |") == 2
    assert list((tmp_path / "parts").glob("*.parquet"))
