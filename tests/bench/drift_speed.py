"""Speed of the drift filter: bulk beside vqf's compiled loop on the same data, one sample online, the live stage.

    python -m tests.bench.drift_speed [--runs 7]

The same 10,800 s at 100 Hz go alternately through vqf and through ours, compiled and not; figures are medians. Making
the compiled code (once for an installation) and loading it (once a process) are told apart. What is called sample by
sample is told in processor time, and as a multiple of vqf's `update` of the same samples, one call each.
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


def processor_us(run: Callable[[], object], calls: int) -> float:
    """Of a call, the median of five runs, us: a processor that others use as well changes it little."""
    spent = []
    for _ in range(5):
        began = time.thread_time()
        run()
        spent.append(1e6 * (time.thread_time() - began) / calls)
    return statistics.median(spent)


def vqf_online(samples: list[tuple[float, list[float], list[float]]]) -> float:
    """Processor time of one update by vqf, us; NaN where it is not installed."""
    if not importlib.util.find_spec("vqf"):
        return float("nan")
    from vqf import VQF

    arrays = [(np.array(w), np.array(a)) for _, w, a in samples]
    peer = VQF(samples[1][0] - samples[0][0])

    def run() -> None:
        for w, a in arrays:
            peer.update(w, a)

    return processor_us(run, len(arrays))


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
    peer = vqf_online(samples)
    print(f"\nvqf, one update at 1 kHz: {peer:.1f} us of processor time; the others as multiples of it")

    def online() -> None:
        engine = ErrorStateFilter(SETTINGS)
        for t, w, a in samples:
            engine.update(t, (w[0], w[1], w[2]), (a[0], a[1], a[2]))

    def tell(what: str, run: Callable[[], object], calls: int) -> None:
        each = processor_us(run, calls)
        print(f"{what}: {each:.1f} us, {each / peer:.1f} times")

    tell("online, 6 axes at 1 kHz, interpreted, a sample", online, len(samples))
    stage = DriftStage(DriftSettings(azimuth_deg=60.0), 35.2)
    frames = list(zip(fast.t_s.tolist(), np.degrees(quick.rate).T.tolist(), quick.accel.T.tolist(), strict=True))

    def live(per_batch: int) -> None:
        stage.restart()
        for i, (t, w, a) in enumerate(frames):
            stage.add(w[0], w[1], w[2])
            if i % per_batch == per_batch - 1:
                stage.close(t, t, (a[0], a[1], a[2]))

    tell("live stage at 1 kHz, micro-batches of 10 ms, a frame", lambda: live(10), len(frames))
    tell("live stage at 100 Hz, each frame its own, a frame", lambda: live(1), len(frames))
    stage.align(60.0, 0.1, None)
    tell("asked for the azimuth", lambda: [stage.azimuth(60.0) for _ in range(2000)], 2000)


if __name__ == "__main__":
    main()
