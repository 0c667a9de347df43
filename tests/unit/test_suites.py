"""`.ci/suites`, which `make test` runs: each part's output is shown, and one part that failed is a failure."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PARTS = {
    "unit and session": "tests --ignore=tests/guest --ignore=tests/integration --ignore=tests/faults",
    "guests": "tests/guest",
    "integration and faults": "tests/integration tests/faults -m not timing",
    "timing": "tests/integration tests/faults -m timing",
}


def run(folder: Path, project_root: Path, failing: str) -> subprocess.CompletedProcess[str]:
    """The script with a program in place of Python that says its arguments and fails for one part."""
    python = folder / "python"
    python.write_text(f'#!/bin/sh\necho "ran: $*"\n[ "$*" != "-m pytest {PARTS.get(failing)}" ] || exit 5\n')
    python.chmod(0o755)
    command = [project_root / ".ci/suites", python, folder / "logs"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("failing", [*PARTS, ""])
def test_each_part_is_shown_and_one_that_fails_is_a_failure(tmp_path: Path, project_root: Path, failing: str) -> None:
    done = run(tmp_path, project_root, failing)
    assert done.returncode == (1 if failing else 0)
    assert [line for line in done.stdout.splitlines() if line.startswith("ran:")] == [
        f"ran: -m pytest {arguments}" for arguments in PARTS.values()
    ]
    told = [line for line in done.stdout.splitlines() if "exit status" in line]
    for name, line in zip(PARTS, told, strict=True):
        assert line.startswith(f"== {name}: exit status {5 if name == failing else 0} after ")


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
