"""What the command line has loaded before it knows what it is asked."""

from __future__ import annotations

import subprocess
import sys


def test_numpy_is_not_imported_before_its_threads_are_settled() -> None:
    # OPENBLAS_NUM_THREADS is read when numpy is imported; a diagnosis takes half as long again without it
    told = "import highside.cli.main, sys; print('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", told], capture_output=True, text=True).stdout.strip() == "False"
