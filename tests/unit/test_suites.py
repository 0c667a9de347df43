"""`.ci/suites`, which `make test` runs: every test file in one piece, two pieces of live parts at a time and one
that computes at a lower priority, after them what judges a pace and one that computes at the lowest; each one's output
is shown, and one that failed is a failure."""

from __future__ import annotations

import ast
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
    "unit": "*tests/unit/test_*.py*",
    "timing": "*-m?timing",
    "": "nothing",
}


def suites(folder: Path, project_root: Path, failing: str = "", pause: float = 0.05) -> list[str | Path]:
    """The command, with the program in place of Python."""
    python, pattern = folder / "python", FAILING[failing]
    if failing == "unit":
        # the piece that this file is in
        pattern = f"*tests/unit/{Path(__file__).name}*"
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
    failed = {name: status.split()[0] for name, status in pieces.items() if not status.startswith("0 after")}
    assert list(failed.values()) == (["5"] if failing else [])
    assert all(name == failing or (name.startswith("unit ") and failing == "unit") for name in failed)
    assert {"checks", "guests", "integration 1 of 8", "faults", "unit 8 of 8", "session", "timing"} <= set(pieces)
    assert len([line for line in done.stdout.splitlines() if line.startswith("ran: ")]) == len(pieces)


@pytest.fixture(scope="module")
def a_run(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """The folder of a whole run in which nothing fails."""
    folder = tmp_path_factory.mktemp("run")
    subprocess.run(suites(folder, project_root), capture_output=True, check=True, timeout=100)
    return folder


def books_of(run: Path) -> list[tuple[str, str]]:
    """What began and ended, in that order: "begin" or "end", and the arguments of a piece."""
    lines = (run / "books").read_text().splitlines()
    return [(what, arguments) for what, _, arguments in (line.partition(" ") for line in lines)]


def test_every_test_file_is_in_one_piece_and_no_live_one_runs_beside_those_that_judge_a_pace(
    a_run: Path, project_root: Path
) -> None:
    books = books_of(a_run)
    running: list[str] = []
    most_live = most = 0
    for what, arguments in books:
        if what == "end":
            running.remove(arguments)
            continue
        running.append(arguments)
        most = max(most, len(running))
        most_live = max(most_live, sum(map(waits_for_others, running)))
        if any(one.endswith("-m timing") for one in running):
            assert sum(map(waits_for_others, running)) == 1
            assert len(running) <= 2
    assert most_live == 2
    assert most == 3
    # 19 is the lowest there is, and this test may run at it
    before, beside_a_pace = min(os.nice(0) + 5, 19), 19
    computing = set()
    for line in (a_run / "priorities").read_text().splitlines():
        priority, _, arguments = line.partition(" ")
        if waits_for_others(arguments):
            assert int(priority) == os.nice(0), line
        else:
            computing.add(int(priority))
    assert computing == {before, beside_a_pace}
    given = [arguments for what, arguments in books if what == "begin" and "-m timing" not in arguments]
    places = [word for arguments in given for word in arguments.split() if word.startswith("tests/")]
    for path in sorted((project_root / "tests").rglob("test_*.py")):
        name = path.relative_to(project_root).as_posix()
        if not name.startswith("tests/guest_suite/"):  # run by tests/guest, inside
            assert sum(name == place or name.startswith(f"{place}/") for place in places) == 1, name
    for arguments in given:
        if "tests/integration/" in arguments:
            assert arguments.endswith("-m not timing and not further")
        elif "tests/faults" in arguments:
            assert arguments.endswith("-m not timing")
        elif "tests/unit/" in arguments:
            assert arguments.endswith("-m not further")
        else:
            assert "-m not" not in arguments


def test_files_are_dealt_out_by_the_time_that_they_take(a_run: Path, project_root: Path) -> None:
    """Those that are listed are there; and no piece of the files has much more to do than another."""
    listed = [line.split() for line in (project_root / ".ci/seconds").read_text().splitlines() if line[0] != "#"]
    seconds = {name: float(cost) for cost, name in listed}
    assert len(seconds) == len(listed)
    assert [name for name in seconds if not (project_root / name).is_file()] == []
    books = books_of(a_run)
    for place in ("tests/unit/", "tests/integration/"):
        given = [arguments for what, arguments in books if what == "begin" and place in arguments]
        sums = [sum(seconds.get(word, 5.0) for word in one.split() if word.startswith(place)) for one in given]
        assert len(sums) == 8
        assert max(sums) < min(sums) + 6.0 or max(sums) < max(seconds.values()) + 1.0


def test_of_each_kind_that_has_further_cases_some_stay(project_root: Path) -> None:
    """`further` is a mark of cases of a parametrisation, of which one in four stays, and of tests of a file, of which
    half stay; never of a file."""
    marked = 0
    for path in sorted((project_root / "tests").rglob("test_*.py")):
        text = path.read_text()
        if "mark.further" not in text or path == Path(__file__):
            continue
        tree = ast.parse(text)
        allowed = {"FURTHER = pytest.mark.further"}
        assert [line for line in text.splitlines() if "mark.further" in line] == list(allowed), path
        used = sum(isinstance(node, ast.Name) and node.id == "FURTHER" for node in ast.walk(tree)) - 1
        functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        tests = [node for node in functions if node.name.startswith("test_")]
        gone = [test for test in tests if "FURTHER" in map(ast.unparse, test.decorator_list)]
        assert 2 * len(gone) <= len(tests), path
        used -= len(gone)
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.mark.parametrize":
                cases = node.args[1].elts if isinstance(node.args[1], ast.List) else []
                away = [case for case in cases if isinstance(case, ast.Call) and "FURTHER" in ast.unparse(case)]
                assert len(away) <= 3 * (len(cases) - len(away)), (path, node.lineno)
                used -= len(away)
                marked += len(away)
        assert used == 0, path
    assert marked > 0
    assert "-m further tests/unit tests/integration" in (project_root / "Makefile").read_text()


def test_interrupted_it_ends_what_runs_and_shows_its_last_lines(tmp_path: Path, project_root: Path) -> None:
    command = suites(tmp_path, project_root, pause=100.0)
    # all that run at first: of a signal that comes just before a shell waits for them it hears after one has ended
    logs = [tmp_path / "logs" / f"{piece}.log" for piece in ("checks", "guests", "integration-1-of-8")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60.0
        while not all(log.exists() and "ran: " in log.read_text() for log in logs):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(1.0)
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
ONLY_WHERE = """#!/bin/sh
case "$*" in {wanted}) exec {python} "$@";; esac
"""
"""In place of Python: it is started for the pieces that a test is about. The others, some twenty, hold in any case."""
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
        "unit": 8,
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
    python = tmp_path / "python"
    files = "|".join(f"*/test_{place}_{number}.py*" for number in range(len(contents)))
    python.write_text(ONLY_WHERE.format(wanted=f"{files}|*-m?timing", python=sys.executable))
    python.chmod(0o755)
    # what the tests in there do needs no plugin, and each piece would import all that are installed
    bare = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        [script, python, tmp_path / "logs"], capture_output=True, text=True, check=False, timeout=200, env=bare
    )
    assert done.returncode == (0 if passes else 1), done.stdout + done.stderr
    told = [line for line in done.stdout.splitlines() if line.startswith("== passed only when run a second time: ")]
    assert sorted(told) == [
        f"== passed only when run a second time: tests/integration/test_integration_{number}.py::test_of_live_parts"
        for number in range(len(contents) if passes else 0)
    ]
