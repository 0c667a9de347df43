"""Fit and evaluation times of all rotor-angle methods, side by side as ratios, and the online update.

    python -m tests.bench.rotation_speed [--repeats N] [--json]

All methods run in turn on the same 6,000 rows, so that a busy machine disturbs all alike; ratios are those of the least
times. The yardstick of the fits is method 1, that of the evaluations method 2. Absolute times are of this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from typing import Any

import numpy as np

from highside.papers.reproduce_rotation import measure_times
from highside.papers.rotation_scenarios import B, draw
from highside.rotation import CurveMethod, OnlineFit


def measure(repeats: int) -> dict[str, Any]:
    """Least, median and 95 % of each, ratios, and microseconds of an online update."""
    one = draw(B, 0, 0)
    times = measure_times(one, quick=repeats, slow=max(2, repeats // 8))
    first, second = times[CurveMethod.SINE].fit.min(), times[CurveMethod.HARMONICS2].evaluate.min()
    methods = {
        method.value: {
            "fit_ms": [round(1e3 * float(q), 3) for q in np.quantile(t.fit, [0, 0.5, 0.95])],
            "fit_to_sine": round(float(t.fit.min() / first), 2),
            "evaluate_ms": [round(1e3 * float(q), 3) for q in np.quantile(t.evaluate, [0, 0.5, 0.95])],
            "evaluate_to_harmonics2": round(float(t.evaluate.min() / second), 2),
        }
        for method, t in times.items()
    }
    theta, error = one.theta_rad.tolist(), one.error.tolist()
    updates = []
    for _ in range(5):
        fit = OnlineFit(noise=B.noise, amplitude=0.05)
        start = time.perf_counter()
        for t, y in zip(theta, error, strict=True):
            fit.update(t, y)
        updates.append(1e6 * (time.perf_counter() - start) / len(theta))
    return {
        "rows": one.error.size,
        "repeats": repeats,
        "cpus": os.cpu_count(),
        "methods": methods,
        "online_update_us": [round(float(q), 2) for q in np.quantile(updates, [0, 0.5, 1])],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=80)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.repeats)
    if options.json:
        print(json.dumps(result))
        return
    print(f"{result['rows']:,} rows, {result['cpus']} processors; ms: least / median / 95 %")
    print(f"{'method':<12} {'fit':>26}  x sine  {'evaluate':>24}  x harmonics2")
    for name, row in result["methods"].items():
        fit, evaluate = (" / ".join(f"{ms:.2f}" for ms in row[key]) for key in ("fit_ms", "evaluate_ms"))
        print(f"{name:<12} {fit:>26}  {row['fit_to_sine']:>6}  {evaluate:>24}  {row['evaluate_to_harmonics2']:>6}")
    print("online update, us: " + " / ".join(map(str, result["online_update_us"])))


if __name__ == "__main__":
    main()
