"""Bulk inclination and toolface beside a C loop.

    python -m tests.bench.bulk_attitude [--samples N] [--pairs K] [--json]

The yardstick is a single-threaded loop compiled with `gcc -O3 -march=native -ffast-math` and `restrict`, doing the same
operations (offset, matrix, I, T). Both run in turn on the same arrays, so that a busy machine disturbs both; the ratio
is the median over the pairs. Our side may use every processor.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from highside.attitude import correct_and_attitude, wrap_signed

LOOP = """
#include <math.h>
#include <stddef.h>
void correct(size_t n, const double *restrict ax, const double *restrict ay, const double *restrict az,
             const double *restrict c, const double *restrict b, double *restrict inc, double *restrict tf)
{
    const double c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3], c4 = c[4], c5 = c[5], c6 = c[6], c7 = c[7], c8 = c[8];
    const double b0 = b[0], b1 = b[1], b2 = b[2];
    for (size_t i = 0; i < n; i++) {
        const double x = ax[i] - b0, y = ay[i] - b1, z = az[i] - b2;
        const double gx = c0 * x + c1 * y + c2 * z;
        const double gy = c3 * x + c4 * y + c5 * z;
        const double gz = c6 * x + c7 * y + c8 * z;
        inc[i] = atan2(sqrt(gx * gx + gy * gy), gz);
        tf[i] = atan2(gy, gx);
    }
}
"""

Loop = Callable[..., None]


def compile_loop(folder: Path) -> Loop:
    """Compile the C loop into `folder` and return it as a function of (raw (3, N), C, b, inc, tf)."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise SystemExit("this benchmark needs gcc")
    source, library = folder / "loop.c", folder / "loop.so"
    source.write_text(LOOP)
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", str(library), str(source), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).correct
    pointer = ctypes.POINTER(ctypes.c_double)
    function.argtypes = [ctypes.c_size_t, *[pointer] * 7]
    function.restype = None

    def run(raw: np.ndarray, C: np.ndarray, b: np.ndarray, inc: np.ndarray, tf: np.ndarray) -> None:
        rows = [a.ctypes.data_as(pointer) for a in (raw[0], raw[1], raw[2], C, b, inc, tf)]
        function(raw.shape[1], *rows)

    return run


def tool_readings(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Raw readings (3, N) of an imperfect tool at every inclination and toolface, and the C and b that correct them."""
    rng = np.random.default_rng(20211)
    inc, tf = rng.uniform(0, np.pi, samples), rng.uniform(0, 2 * np.pi, samples)
    g = np.stack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
    A = np.eye(3) + rng.normal(0, 3e-3, (3, 3))
    b = rng.normal(0, 2e-3, 3)
    return A @ g + b[:, None], np.linalg.inv(A), b


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def compare(samples: int, pairs: int) -> dict[str, Any]:
    """Time both sides in `pairs` pairs and check that they agree."""
    raw, C, b = tool_readings(samples)
    ours, theirs = np.empty((2, samples)), np.empty((2, samples))
    with tempfile.TemporaryDirectory() as folder:
        loop = compile_loop(Path(folder))

        def run_ours() -> None:
            correct_and_attitude(raw, C, b, ours[0], ours[1])

        def run_single() -> None:
            correct_and_attitude(raw, C, b, ours[0], ours[1], threads=1)

        def run_loop() -> None:
            loop(raw, C, b, theirs[0], theirs[1])

        # the first run of each touches its memory and is not counted
        run_ours(), run_loop()
        times = [(seconds(run_ours), seconds(run_loop)) for _ in range(pairs)]
        single = min(seconds(run_single) for _ in range(3))
    # near the axis T magnifies the last bit of gx and gy, in either program: compare the arc
    arc = np.abs(wrap_signed(ours[1] - theirs[1])) * np.sin(theirs[0])
    ratios = sorted(mine / other for mine, other in times)
    return {
        "samples": samples,
        "pairs": pairs,
        "cpus": os.cpu_count(),
        "ns_per_sample": round(statistics.median(mine for mine, _ in times) / samples * 1e9, 2),
        "ns_per_sample_one_thread": round(single / samples * 1e9, 2),
        "ns_per_sample_c": round(statistics.median(other for _, other in times) / samples * 1e9, 2),
        "ratio": round(statistics.median(ratios), 2),
        "ratio_min": round(ratios[0], 2),
        "ratio_max": round(ratios[-1], 2),
        "max_inc_difference_rad": float(np.abs(ours[0] - theirs[0]).max()),
        "max_tf_arc_difference_rad": float(arc.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = compare(options.samples, options.pairs)
    if options.json:
        print(json.dumps(result))
        return
    print(f"{result['samples']:,} samples, {result['cpus']} processors, {result['pairs']} pairs")
    print(f"ours {result['ns_per_sample']} ns/sample (one thread {result['ns_per_sample_one_thread']})")
    print(f"C    {result['ns_per_sample_c']} ns/sample, one thread, -O3 -march=native -ffast-math")
    print(f"ratio {result['ratio']} (from {result['ratio_min']} to {result['ratio_max']})")
    inc, tf = result["max_inc_difference_rad"], result["max_tf_arc_difference_rad"]
    print(f"largest differences: I {inc:.1e} rad, T {tf:.1e} rad of arc")


if __name__ == "__main__":
    main()
