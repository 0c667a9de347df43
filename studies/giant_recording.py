"""One giant recording: cost and memory of a diagnosis over the rows, read run by run beside held in the memory.

    python -m studies.giant_recording [--rows 10000 100000 1000000 20000000] [--memory 10000 100000 1000000]
                                      [--without-laws] [--threads 2] [--folder F] [--figure curve.svg]

Recordings of three channels at 50 Hz: ten rates with ramps between, coloured noise, a temperature that varies, a lever
arm of 20 um that the model lacks, written as Parquet. Each diagnosis is a process of its own; told are the most memory
that it had at any time (VmHWM), its processor time, and the answer; of sizes that were diagnosed in both ways the
largest relative difference of any number of `diagnosis.json`. Linux.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# as the command does: a library of several threads waits for them in the processor, four times as long
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lfilter

from studies import diagnosis_deck as deck
from studies import rotation_cases as cases

MODEL = "[sensor]\nnoise_g = 8e-5\n[site]\nlatitude_deg = 52.0\nazimuth_deg = 30.0\n"
LEFT_OUT = {"lever_arm": {"r_x": 1e-5, "r_y": 2e-5}}
AR = 0.55
"""coefficient of the noise from row to row"""
ROWS = 1 << 18
"""rows that are made at a time"""
BIG_EVIDENCE = ("memory_evidence", "memory_lead")
"""differences of log likelihoods of 1e6 and more: compared to 1e-9 of these"""
DIAGNOSED = """
import json, resource, sys
from pathlib import Path
import highside
from highside.diagnosis.core.method import WHOLE, ProcedureParts

recording, model, way, laws, threads, out = sys.argv[1:]
method = WHOLE if laws == "with" else ProcedureParts.without("laws")
found = highside.diagnose(recording, model, run_by_run=way == "run by run", threads=int(threads), method=method)
Path(out).write_text(json.dumps(found.to_dict()))
used = resource.getrusage(resource.RUSAGE_SELF)
peak = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
print(json.dumps([int(peak) / 1024, used.ru_utime + used.ru_stime, found.verdict, [c.effect for c in found.claims]]))
"""


@dataclass(frozen=True)
class Cost:
    """Of one diagnosis."""

    rows: int
    way: str
    peak_mib: float
    cpu_s: float
    answer: str
    found: dict[str, Any]


def written(rows: int, folder: Path) -> Path:
    """The recording, unless it is there."""
    import pyarrow as pa
    from pyarrow import parquet

    path = folder / f"rotation-{rows}.parquet"
    if path.exists():
        return path
    state = cases.design(3, seconds=rows / 50)
    rng = np.random.default_rng(1)
    model = deck.random_sensor(rng).with_effects(LEFT_OUT)
    begun = np.zeros((3, 1))
    writer = None
    for start in range(0, state.n, ROWS):
        own = state.rows(np.concatenate([[0], np.arange(start, min(start + ROWS, state.n))]))
        drive = np.sqrt(1 - AR**2) * rng.standard_normal((3, own.n - 1))
        noise, begun = lfilter([1.0], [1.0, -AR], drive, axis=1, zi=begun)
        readings = model.predict(own)[:, 1:] + cases.SIGMA_G * noise
        columns = {
            "t_s": own.t_s,
            "inc_ref_deg": np.degrees(own.inc_rad),
            "tf_ref_deg": np.mod(np.degrees(own.tf_rad), 360.0),
            "rotor_rate_dps": np.degrees(own.rotor_rate_radps),
            "temp_c": own.temp_c,
            "vibration_rms_g": own.vibration_rms_g,
        }
        named = {name: np.ascontiguousarray(values[1:]) for name, values in columns.items()}
        table = pa.table({**named, **dict(zip(("ax_g", "ay_g", "az_g"), readings, strict=True))})
        if writer is None:
            writer = parquet.ParquetWriter(path.with_suffix(".part"), table.schema)
        writer.write_table(table)
    assert writer is not None
    writer.close()
    path.with_suffix(".part").rename(path)
    return path


def cost(path: Path, rows: int, way: str, laws: str, threads: int) -> Cost:
    """Of the diagnosis as a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        model, out = Path(place) / "model.toml", Path(place) / "diagnosis.json"
        model.write_text(MODEL)
        given = [str(path), str(model), way, laws, str(threads), str(out)]
        done = subprocess.run([sys.executable, "-c", DIAGNOSED, *given], capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{rows} rows: {done.stderr}")
        peak, seconds, verdict, claims = json.loads(done.stdout)
        return Cost(rows, way, peak, seconds, f"{verdict} {' '.join(claims)}", json.loads(out.read_text()))


def differences(one: Any, other: Any, name: str = "") -> Iterator[tuple[float, str]]:
    """Relative difference of each number of two answers, and where it stands."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {*one, *other}:
            yield from differences(one.get(key), other.get(key), f"{name}/{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(a, b, f"{name}/{k}")
    elif isinstance(one, float) and isinstance(other, float):
        scale = max(abs(one), abs(other), 1.0 if any(word in name for word in BIG_EVIDENCE) else 0.0, 1e-300)
        yield abs(one - other) / scale, name
    elif one != other and "/hints" not in name:
        yield math.inf, f"{name}: {one} and {other}"


def draw(costs: list[Cost], path: Path) -> None:
    """Memory and processor time over rows, both axes logarithmic."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    for way, mark in (("run by run", "o-"), ("in the memory", "s--")):
        own = [one for one in costs if one.way == way]
        for axis, values in ((axes[0], [c.peak_mib for c in own]), (axes[1], [c.cpu_s for c in own])):
            axis.loglog([c.rows for c in own], values, mark, label=way)
    for axis, label in ((axes[0], "peak memory, MiB"), (axes[1], "processor time, s")):
        axis.set(xlabel="rows", ylabel=label)
        axis.grid(visible=True, which="both", alpha=0.3)
    axes[0].axhline(1024, linestyle=":", color="0.3", label="1 GiB")
    axes[0].legend()
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, nargs="*", default=[10_000, 100_000, 1_000_000, 20_000_000])
    parser.add_argument("--memory", type=int, nargs="*", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--without-laws", action="store_true")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="keep the recordings there")
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    laws = "without" if given.without_laws else "with"
    costs: list[Cost] = []
    print(f"{'rows':>9s}  {'way':14s}{'peak MiB':>10s}{'cpu s':>8s}{'cpu us/row':>12s}  answer", flush=True)
    with tempfile.TemporaryDirectory() as place:
        for rows in sorted({*given.rows, *given.memory}):
            path = written(rows, given.folder or Path(place))
            ways = [("in the memory", given.memory), ("run by run", given.rows)]
            made = [cost(path, rows, way, laws, given.threads) for way, which in ways if rows in which]
            for one in made:
                each = 1e6 * one.cpu_s / rows
                print(
                    f"{rows:9d}  {one.way:14s}{one.peak_mib:10.0f}{one.cpu_s:8.1f}{each:12.1f}  {one.answer}",
                    flush=True,
                )
            if len(made) == len(ways):
                worst = max(differences(made[0].found, made[1].found))
                print(f"           largest relative difference {worst[0]:.1e} at {worst[1]}", flush=True)
            costs += made
    if given.figure is not None:
        draw(costs, given.figure)


if __name__ == "__main__":
    main()
