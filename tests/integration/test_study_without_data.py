"""A study that finds no data has measured nothing, and must not pass for one that did."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_a_study_without_its_recordings_fails(tmp_path: Path, project_root: Path) -> None:
    command = [sys.executable, "-m", "studies.drift_real", str(tmp_path)]
    done = subprocess.run(command, cwd=project_root, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1
    assert "nothing measured" in done.stderr and "Traceback" not in done.stderr
