"""A benchmark that finds no data has measured nothing, and must not pass for one that did."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_a_benchmark_without_its_recordings_fails(tmp_path: Path) -> None:
    script = Path(__file__).with_name("drift_real.py")
    done = subprocess.run([sys.executable, script, tmp_path], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1
    assert "nothing measured" in done.stderr and "Traceback" not in done.stderr
