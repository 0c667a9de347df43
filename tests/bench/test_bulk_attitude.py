"""The bulk path beside a compiled loop: equal results, and never far from its speed."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from types import ModuleType

import pytest


def load_benchmark() -> ModuleType:
    spec = importlib.util.spec_from_file_location("bulk_attitude", Path(__file__).with_name("bulk_attitude.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_benchmark_compares_equal_results() -> None:
    assert shutil.which("gcc"), "the benchmark needs gcc"
    result = load_benchmark().compare(samples=300_000, pairs=1)
    assert result["max_inc_difference_rad"] < 2e-14
    assert result["max_tf_arc_difference_rad"] < 2e-14


@pytest.mark.slow
def test_ten_million_samples_keep_near_the_c_loop() -> None:
    """The target is 2.5 (median of paired runs on a machine of its own: `python tests/bench/bulk_attitude.py`).

    On shared processors a neighbour halves our two threads and not the one of C, so this gates on ten times the
    expected median of 2.0 only: it finds a lost block path, not a busy machine.
    """
    result = load_benchmark().compare(samples=10_000_000, pairs=3)
    print(f"ratio to C {result['ratio']:.2f}: {result}")
    assert result["ratio"] <= 20.0
