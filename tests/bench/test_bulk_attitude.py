"""The bulk paths beside a compiled loop: equal results, and never far from its speed.

Each benchmark runs in a process of its own: a library built with -ffast-math switches off subnormal numbers for the
whole process that loads it, which would spoil every later test of floats.

The target is 2.5 (median of paired runs on a machine of its own: `make bench`). On shared processors a neighbour halves
our two threads and not the one of C, so the gates are ten times the expected median: they find a lost block path, not a
busy machine.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def measure(script: str, samples: int, pairs: int) -> dict[str, Any]:
    run = subprocess.run(
        [sys.executable, "-m", f"tests.bench.{script}", "--samples", str(samples), "--pairs", str(pairs), "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    result: dict[str, Any] = json.loads(run.stdout.strip().splitlines()[-1])
    print(result)
    return result


def test_the_benchmark_compares_equal_results() -> None:
    result = measure("bulk_attitude", 300_000, 1)
    assert result["max_inc_difference_rad"] < 2e-14
    assert result["max_tf_arc_difference_rad"] < 2e-14


@pytest.mark.slow
def test_ten_million_samples_keep_near_the_c_loop() -> None:
    assert measure("bulk_attitude", 10_000_000, 3)["ratio"] <= 20.0


@pytest.mark.slow
def test_two_million_samples_through_a_schedule_keep_near_the_c_loop() -> None:
    assert measure("bulk_schedule", 2_000_000, 3)["ratio"] <= 25.0
