"""Bulk inclination and toolface through a schedule of balance zones, beside the C loop of `bulk_attitude`.

    python -m tests.bench.bulk_schedule [--samples N] [--pairs K]

The log is a well: inclination from 0.3 to 60 deg, the tool turning. The C loop applies one matrix and no schedule. Ours
is compiled where numba is installed; `--numpy` measures the way without it.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from highside.attitude import compiled
from highside.calibration.balance import balance
from highside.calibration.conventional import conventional
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.poses import PoseSet
from highside.calibration.schedule import ScheduledCorrection
from highside.physics.gravity import gravity_direction
from tests.bench.bulk_attitude import compile_loop, seconds

INCLINATIONS_DEG = (0.612, 1.206, 3.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)


def schedule(A: np.ndarray, b: np.ndarray) -> ScheduledCorrection:
    """Nine zones and a global fallback."""
    inc = np.deg2rad(np.repeat(INCLINATIONS_DEG, 4))
    tf = np.deg2rad(np.tile([45.0, 135.0, 225.0, 315.0], len(INCLINATIONS_DEG)))
    poses = PoseSet.build(
        A @ gravity_direction(inc, tf) + b[:, None], inc_ref_rad=inc, tf_ref_rad=tf, n=1000.0, std=5e-4
    )
    zones = tuple(LinearCorrection(zone, guarded=False) for zone in balance(poses).zones)
    return ScheduledCorrection(zones, fallback=LinearCorrection(conventional(poses).main))


def compare(samples: int, pairs: int) -> dict[str, float]:
    """Time both in `pairs` pairs, ns a sample; `cpu_ns_one_thread` is processor time, which a busy machine stretches
    less."""
    n = samples
    rng = np.random.default_rng(0)
    A, b = np.eye(3) + 3e-3 * rng.standard_normal((3, 3)), 2e-3 * rng.standard_normal(3)
    inc, tf = np.deg2rad(np.linspace(0.3, 60.0, n)), 2.0 * np.pi * np.arange(n) / 300.0
    raw = np.ascontiguousarray(A @ gravity_direction(inc, tf) + b[:, None] + 3e-4 * rng.standard_normal((3, n)))
    correction = schedule(A, b)
    C = np.linalg.inv(A)
    out = np.empty((2, n))
    with tempfile.TemporaryDirectory() as folder:
        loop = compile_loop(Path(folder))

        def run_ours() -> None:
            correction.attitude(raw, None, out[0], out[1])

        def run_loop() -> None:
            loop(raw, C, b, out[0], out[1])

        run_loop(), run_ours()
        times = [(seconds(run_ours), seconds(run_loop)) for _ in range(pairs)]
        one, cpu = [], []
        for _ in range(3):
            before = time.process_time()
            one.append(seconds(lambda: correction.attitude(raw, None, out[0], out[1], threads=1)))
            cpu.append(time.process_time() - before)
    ours, theirs = (statistics.median(t[k] for t in times) / n * 1e9 for k in (0, 1))
    ratios = sorted(mine / other for mine, other in times)
    return {
        "ns": ours,
        "ns_one_thread": min(one) / n * 1e9,
        "cpu_ns_one_thread": min(cpu) / n * 1e9,
        "ns_c": theirs,
        "ratio": statistics.median(ratios),
        "ratio_min": ratios[0],
        "ratio_max": ratios[-1],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--numpy", action="store_true", help="do not compile")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.numpy:
        compiled.COMPILED_FROM = options.samples + 1
    elif not compiled.wanted(options.samples):
        print("without compiler: numba is not installed, or too few samples")
    r = compare(options.samples, options.pairs)
    if options.json:
        print(json.dumps(r))
        return
    print(f"{options.samples:,} samples: schedule {r['ns']:.1f} ns/sample, C loop {r['ns_c']:.1f}")
    print(f"one thread {r['ns_one_thread']:.1f} ns/sample, of the processor {r['cpu_ns_one_thread']:.1f}")
    print(f"ratio {r['ratio']:.2f} (from {r['ratio_min']:.2f} to {r['ratio_max']:.2f})")


if __name__ == "__main__":
    main()
