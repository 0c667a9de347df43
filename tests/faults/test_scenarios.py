"""The short forms of the scenarios: small numbers, bounds for a busy machine. `make faults` runs the whole numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import run
import scenarios
import storm
from broker import require_mosquitto
from rig import Row

pytestmark = [pytest.mark.slow, pytest.mark.timing, pytest.mark.timeout(280)]


@pytest.mark.parametrize(
    ("scenario", "number"),
    [
        pytest.param(scenarios.unplugs, 20, id="unplugs"),
        pytest.param(scenarios.broker_away, 6, id="broker away"),
        pytest.param(scenarios.backlog, 6_000, id="backlog"),
        pytest.param(storm.storm, 30, id="storm"),
    ],
)
def test_the_scenario_holds_at_a_small_number(tmp_path: Path, scenario: Callable[..., Row], number: int) -> None:
    require_mosquitto()
    row = scenario(number, tmp_path, strict=False)
    print(row.measured)
    assert row.held, row.measured


@pytest.mark.parametrize(
    ("summary", "held"),
    [
        ("1 passed, 17 deselected in 20.60s", True),
        ("1 skipped, 3 deselected in 271.23s (0:04:31)", False),
        ("4 passed, 1 skipped in 3.20s", False),
        ("17 deselected in 0.10s", False),
    ],
)
def test_what_was_skipped_held_nothing(summary: str, held: bool) -> None:
    assert run.whole(summary) is held


def test_every_scenario_has_a_line_and_each_number_of_its_own() -> None:
    """28 scenarios: each is named by some line, and what is run exists."""
    named: set[int] = set()
    for job in run.ALL:
        for part in job.key.replace("storm", "").split(","):
            first, _, last = part.strip().partition("-")
            if first:
                named |= set(range(int(first), int(last or first) + 1))
        if isinstance(job, run.Tests):
            for word in job.nodes.split():
                assert not word.startswith("tests/") or (run.ROOT / word).is_file(), word
    assert named == set(range(1, 29))


def test_a_row_that_was_measured_replaces_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "faults.md"
    page.write_text(f"above\n{run.BEGIN}\n{run.END}\nbelow\n")
    monkeypatch.setattr(run, "TABLE", page)
    run.write([Row("14", "backlog", "10", "9", "slow", False), Row("4", "unplugs", "1", "1", "quick", True)])
    run.write([Row("14", "backlog", "10", "10", "quick", True)])
    lines = page.read_text().splitlines()
    rows = [line for line in lines if line.startswith(("| 4 ", "| 14 "))]
    assert [line.split(" | ")[0] for line in rows] == ["| 4", "| 14"]
    assert "slow" not in page.read_text()
    assert (lines[0], lines[-1]) == ("above", "below")


def test_a_run_that_was_interrupted_goes_on_with_what_did_not_hold(tmp_path: Path) -> None:
    made: list[str] = []
    (tmp_path / "kept").mkdir()

    def row(name: str, held: bool, complete: bool = True) -> Row:
        made.append(name)
        return Row("4", name, "1", "1", "quick", held, complete=complete)

    for _ in range(2):
        kept = run.Kept(tmp_path / "kept")
        assert kept.row("a", lambda: row("held", True)).name == "held"
        kept.row("b", lambda: row("failed", False))
        kept.row("c", lambda: row("in part", True, complete=False))
    assert made == ["held", "failed", "in part", "failed", "in part"]


def test_what_is_asked_wrongly_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    for arguments, says in (
        (["--scenario", "99"], "no scenario 99"),
        (["--number", "0"], "at least 1"),
        (["--keep", str(tmp_path / "file")], "name another place"),
    ):
        monkeypatch.setattr("sys.argv", ["run.py", *arguments])
        with pytest.raises(SystemExit) as left:
            run.main()
        assert left.value.code == 2
        assert says in capsys.readouterr().err
