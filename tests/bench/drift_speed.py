"""Speed of the drift filter: bulk beside vqf's compiled loop on the same data, one sample online, the live stage.

    python -m tests.bench.drift_speed [--runs 7]

The same 10,800 s at 100 Hz go alternately through vqf and through ours, compiled and not; figures are medians. Making
the compiled code (once for an installation) and loading it (once a process) are told apart.
"""

from __future__ import annotations

import argparse
import importlib.util
import statistics
import time
from collections.abc import Callable
from unittest import mock

import numpy as np

from highside.config.drift import DriftSettings
from highside.gyro.compiled import kernels
from highside.gyro.filter import ErrorStateFilter, FilterSettings
from highside.gyro.frames import to_body
from highside.gyro.recording_filter import error_state_filter
from highside.papers import drift_rivals
from highside.papers.drift_scenarios import LATITUDE_RAD, drilling, record, rotating_table
from highside.service.drift_stage import DriftStage

SETTINGS = FilterSettings(latitude_rad=LATITUDE_RAD, azimuth_rad=float(np.radians(60.0)))


def seconds(run: Callable[[], object]) -> float:
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=7)
    runs = parser.parse_args().runs
    print(f"compiled code made or loaded: {seconds(lambda: kernels(10**9)):.2f} s")
    experiment = drilling()
    data = record(experiment, 0)
    rows = experiment.t_s.size
    rates, readings = to_body(data.rate), to_body(data.accel)

    def ours() -> object:
        return error_state_filter(experiment.t_s, data.rate, data.accel, SETTINGS, rest=experiment.rest)

    ours()
    methods: dict[str, Callable[[], object]] = {"kinematic, compiled": ours, "kinematic, numpy": ours}
    if importlib.util.find_spec("vqf"):
        methods["vqf"] = lambda: drift_rivals.vqf(100.0, rates, readings)
    spent: dict[str, list[float]] = {name: [] for name in methods}
    for _ in range(runs):
        for name, run in methods.items():
            if name.endswith("numpy"):
                with mock.patch("highside.gyro.recording_filter.kernels", return_value=None):
                    spent[name].append(seconds(run))
            else:
                spent[name].append(seconds(run))
    print(f"\n{rows} rows (10,800 s at 100 Hz), median of {runs}\n")
    print("| method | s | us/row | of vqf |\n|---|---|---|---|")
    vqf = statistics.median(spent["vqf"]) if "vqf" in spent else float("nan")
    for name, each in spent.items():
        median = statistics.median(each)
        print(f"| {name} | {median:.2f} | {1e6 * median / rows:.2f} | {median / vqf:.2f} |")

    fast = rotating_table(30.0, 60.0, 1000.0)
    quick = record(fast, 0)
    samples = list(zip(fast.t_s.tolist(), to_body(quick.rate).T.tolist(), to_body(quick.accel).T.tolist(), strict=True))
    engine = ErrorStateFilter(SETTINGS)

    def online() -> None:
        for t, w, a in samples:
            engine.update(t, (w[0], w[1], w[2]), (a[0], a[1], a[2]))

    print(f"\nonline, 6 axes at 1 kHz, interpreted: {1e6 * seconds(online) / len(samples):.1f} us a sample")
    stage = DriftStage(DriftSettings(azimuth_deg=60.0), 35.2)
    frames = list(zip(fast.t_s.tolist(), np.degrees(quick.rate).T.tolist(), quick.accel.T.tolist(), strict=True))

    def live(per_batch: int) -> None:
        for i, (t, w, a) in enumerate(frames):
            stage.add(w[0], w[1], w[2])
            if i % per_batch == per_batch - 1:
                stage.close(t, t, (a[0], a[1], a[2]))

    print(
        f"live stage at 1 kHz, micro-batches of 10 ms: {1e6 * seconds(lambda: live(10)) / len(frames):.1f} us a frame"
    )
    stage.restart()
    print(f"live stage at 100 Hz, each frame its own: {1e6 * seconds(lambda: live(1)) / len(frames):.1f} us a frame")
    stage.align(60.0, 0.1, None)
    print(f"asked for the azimuth: {1e6 * seconds(lambda: [stage.azimuth(60.0) for _ in range(2000)]) / 2000:.0f} us")


if __name__ == "__main__":
    main()
