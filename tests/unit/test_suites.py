"""`.ci/suites`, which `make test` runs: every test file in one piece, two pieces of live parts at a time and one
that computes at a lower priority; each one's output is shown, and one that failed is a failure."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PYTHON = """#!/bin/sh
echo "ran: $*"
echo "begin $*" >> "{books}"
echo "$(nice) $*" >> "{priorities}"
sleep {pause}
echo "end $*" >> "{books}"
case "$*" in {failing}) exit 5;; esac
"""
"""A program in place of Python: says its arguments, takes a while, and fails for some arguments."""
CHECKS = "all-checks"
FAILING = {
    "checks": CHECKS,
    "guests": "*tests/guest*",
    "unit 2 of 4": "*tests/unit/test_*.py*",
    "timing": "*-m?timing",
    "": "nothing",
}


def suites(folder: Path, project_root: Path, failing: str = "", pause: float = 0.05) -> list[str | Path]:
    """The command, with the program in place of Python."""
    python, pattern = folder / "python", FAILING[failing]
    if failing.startswith("unit"):
        # one file of that piece
        files = sorted((project_root / "tests/unit").glob("test_*.py"))
        pattern = f"*tests/unit/{files[1].name}*"
    python.write_text(
        PYTHON.format(books=folder / "books", priorities=folder / "priorities", pause=pause, failing=pattern)
    )
    python.chmod(0o755)
    return [project_root / ".ci/suites", python, folder / "logs", python, CHECKS]


def waits_for_others(arguments: str) -> bool:
    """Whether a piece plays live parts, by the places that its command names."""
    return any(f"tests/{place}" in arguments for place in ("guest", "integration", "faults", "session"))


@pytest.mark.parametrize("failing", FAILING)
def test_each_piece_is_shown_and_one_that_fails_is_a_failure(tmp_path: Path, project_root: Path, failing: str) -> None:
    command = suites(tmp_path, project_root, failing)
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == (1 if failing else 0), done.stdout + done.stderr
    pieces = dict(
        line.removeprefix("== ").split(": exit status ") for line in done.stdout.splitlines() if "exit status" in line
    )
    assert {name: status.split()[0] for name, status in pieces.items() if not status.startswith("0 after")} == (
        {failing: "5"} if failing else {}
    )
    assert {"checks", "guests", "integration 1 of 8", "faults", "unit 4 of 4", "session", "timing"} <= set(pieces)
    assert len([line for line in done.stdout.splitlines() if line.startswith("ran: ")]) == len(pieces)


def test_every_test_file_is_in_one_piece_and_those_that_judge_a_pace_run_alone(
    tmp_path: Path, project_root: Path
) -> None:
    subprocess.run(suites(tmp_path, project_root), capture_output=True, check=True, timeout=100)
    books = [line.partition(" ")[::2] for line in (tmp_path / "books").read_text().splitlines()]
    running: list[str] = []
    most_live = most = 0
    for what, arguments in books:
        if what == "end":
            running.remove(arguments)
            continue
        running.append(arguments)
        most = max(most, len(running))
        most_live = max(most_live, sum(map(waits_for_others, running)))
        if arguments.endswith("-m timing"):
            assert running == [arguments]
    assert most_live == 2
    assert most == 3
    for line in (tmp_path / "priorities").read_text().splitlines():
        priority, _, arguments = line.partition(" ")
        # 19 is the lowest there is, and this test may run at it
        assert int(priority) == min(os.nice(0) + (0 if waits_for_others(arguments) else 5), 19), line
    given = [arguments for what, arguments in books if what == "begin" and "-m timing" not in arguments]
    places = [word for arguments in given for word in arguments.split() if word.startswith("tests/")]
    for path in sorted((project_root / "tests").rglob("test_*.py")):
        name = path.relative_to(project_root).as_posix()
        if not name.startswith("tests/guest_suite/"):  # run by tests/guest, inside
            assert sum(name == place or name.startswith(f"{place}/") for place in places) == 1, name
    with_timing = {arguments for arguments in given if "tests/integration/" in arguments or "tests/faults" in arguments}
    assert all(arguments.endswith("-m not timing") for arguments in with_timing)


def test_interrupted_it_ends_what_runs_and_shows_its_last_lines(tmp_path: Path, project_root: Path) -> None:
    command = suites(tmp_path, project_root, pause=100.0)
    logs = [tmp_path / "logs" / f"{piece}.log" for piece in ("checks", "guests")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60.0
        while not all(log.exists() and "ran: " in log.read_text() for log in logs):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert "== checks, interrupted\nran: all-checks\n" in said
    assert "== guests, interrupted\nran: -m pytest tests/guest " in said


def test_under_ci_a_test_that_is_skipped_has_failed(tmp_path: Path, project_root: Path) -> None:
    (tmp_path / "tests/data").mkdir(parents=True)
    (tmp_path / "tests/data/recordings.json").write_text('{"recordings": []}')
    (tmp_path / "tests/conftest.py").write_text((project_root / "tests/conftest.py").read_text())
    (tmp_path / "tests/test_some.py").write_text(
        "import pytest\n"
        "def test_skipped(): pytest.skip('no such part')\n"
        "@pytest.mark.skipif(True, reason='by a mark')\ndef test_marked(): pass\n"
        "@pytest.mark.xfail\ndef test_known(): assert False\n"
    )
    for ci, outcome in (("false", "2 skipped, 1 xfailed"), ("true", "1 failed, 1 xfailed, 1 error")):
        command = [sys.executable, "-m", "pytest", "-qra", "-p", "no:cacheprovider", "tests"]
        done = subprocess.run(
            command, cwd=tmp_path, env=os.environ | {"CI": ci}, capture_output=True, text=True, check=False
        )
        assert done.stdout.splitlines()[-1].startswith(outcome), done.stdout
        assert "no such part" in done.stdout


AGAIN = """
from pathlib import Path
def test_of_live_parts():
    flag = Path(__file__).with_suffix(".seen")
    seen, _ = flag.exists(), flag.touch()
    assert seen
def test_that_holds():
    assert not Path(__file__).with_suffix(".cold").exists()
    Path(__file__).with_suffix(".cold").touch()
"""
"""A test that fails the first time, and one that fails the second."""
HOLDS = "def test_holds(): pass\n"
FAILS = "def test_fails(): assert False\n"


@pytest.mark.parametrize(
    ("place", "contents", "passes"),
    [
        ("integration", (AGAIN,), True),
        ("integration", (AGAIN, AGAIN, AGAIN), True),
        ("integration", (AGAIN, AGAIN, AGAIN, AGAIN), False),
        ("integration", (FAILS,), False),
        ("integration", ("import nothing_of_that_name",), False),
        ("unit", (AGAIN,), False),
    ],
    ids=["once", "three", "four are no pause", "each time", "not collected", "what only computes"],
)
def test_few_tests_of_live_parts_that_failed_get_a_second_try(
    tmp_path: Path, project_root: Path, place: str, contents: tuple[str, ...], passes: bool
) -> None:
    (tmp_path / ".ci").mkdir()
    script = tmp_path / ".ci/suites"
    script.write_bytes((project_root / ".ci/suites").read_bytes())
    script.chmod(0o755)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = timing\n")
    for folder, files in {
        "guest": 1,
        "integration": 8,
        "unit": 4,
        "faults": 1,
        "session": 1,
        "bench": 1,
        "import": 1,
    }.items():
        (tmp_path / "tests" / folder).mkdir(parents=True)
        for number in range(files):
            (tmp_path / "tests" / folder / f"test_{folder}_{number}.py").write_text(HOLDS)
    (tmp_path / "tests/faults/test_pace.py").write_text(f"import pytest\n@pytest.mark.timing\n{HOLDS}")
    (tmp_path / "tests/integration/test_pace_there.py").write_text(HOLDS)
    for number, content in enumerate(contents):
        (tmp_path / "tests" / place / f"test_{place}_{number}.py").write_text(content)
    done = subprocess.run(
        [script, sys.executable, tmp_path / "logs"], capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == (0 if passes else 1), done.stdout + done.stderr
    told = [line for line in done.stdout.splitlines() if line.startswith("== passed only when run a second time: ")]
    assert sorted(told) == [
        f"== passed only when run a second time: tests/integration/test_integration_{number}.py::test_of_live_parts"
        for number in range(len(contents) if passes else 0)
    ]
