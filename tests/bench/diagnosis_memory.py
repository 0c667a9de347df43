"""Memory and processor time of `highside diagnose` over the rows of one rotation, each size in a process of its own.

    python -m tests.bench.diagnosis_memory [--rows 10000 100000 1000000] [--without-laws] [--figure curve.svg]

A recording of three channels with coloured noise and a lever arm of 20 um is made and written as Parquet, and diagnosed
from there. Told are the most memory that the process had at any time (VmHWM; nothing of a scratch file counts), its
processor time, and the verdict. Linux.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.diagnosis_speed import WEAK, rotation

MODEL = "[sensor]\nnoise_g = 8e-5\n[site]\nlatitude_deg = 52.0\nazimuth_deg = 30.0\n"
DIAGNOSED = """
import resource, sys
from pathlib import Path
import highside
import highside.diagnosis.recording as kinds
from highside.diagnosis.core.method import ProcedureParts

if sys.argv[3] == "without":
    whole = kinds.diagnose_rotation
    without = ProcedureParts.without("laws")
    kinds.diagnose_rotation = lambda *a, **k: whole(*a, **{**k, "method": without})
found = highside.diagnose(Path(sys.argv[1]), Path(sys.argv[2]))
used = resource.getrusage(resource.RUSAGE_SELF)
peak = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
print(peak, used.ru_utime + used.ru_stime, found.verdict)
"""


@dataclass(frozen=True)
class Cost:
    """Of one recording of so many rows."""

    rows: int
    peak_mib: float
    cpu_s: float
    verdict: str


def written(rows: int, folder: Path) -> Path:
    """The recording as Parquet."""
    import pyarrow as pa
    from pyarrow import parquet

    session = rotation(rows, WEAK)
    state = session.state
    columns = {
        "t_s": state.t_s,
        "inc_ref_deg": np.degrees(state.inc_rad),
        "tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0),
        "rotor_rate_dps": np.degrees(state.rotor_rate_radps),
        "temp_c": state.temp_c,
        "vibration_rms_g": state.vibration_rms_g,
        **dict(zip(("ax_g", "ay_g", "az_g"), session.readings, strict=True)),
    }
    path = folder / f"{rows}.parquet"
    parquet.write_table(pa.table({name: np.ascontiguousarray(values) for name, values in columns.items()}), path)
    return path


def cost(rows: int, laws: str) -> Cost:
    """Of the diagnosis as a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        path, model = written(rows, Path(place)), Path(place) / "model.toml"
        model.write_text(MODEL)
        done = subprocess.run(
            [sys.executable, "-c", DIAGNOSED, str(path), str(model), laws], capture_output=True, text=True, check=False
        )
    if done.returncode:
        raise SystemExit(f"{rows} rows: {done.stderr}")
    peak, seconds, verdict = done.stdout.split()
    return Cost(rows, int(peak) / 1024, float(seconds), verdict)


def draw(costs: list[Cost], path: Path) -> None:
    """Memory and processor time over rows, both axes logarithmic."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    rows = [one.rows for one in costs]
    for axis, values, label in (
        (axes[0], [one.peak_mib for one in costs], "peak memory, MiB"),
        (axes[1], [one.cpu_s for one in costs], "processor time, s"),
    ):
        axis.loglog(rows, values, "o-")
        axis.set(xlabel="rows", ylabel=label)
        axis.grid(visible=True, which="both", alpha=0.3)
    axes[0].axhline(1024, linestyle="--", color="0.5")
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, nargs="*", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--without-laws", action="store_true")
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    costs = []
    print(f"{'rows':>9s}{'peak MiB':>10s}{'cpu s':>8s}{'cpu us/row':>12s}  verdict")
    for rows in given.rows:
        one = cost(rows, "without" if given.without_laws else "with")
        costs.append(one)
        each = 1e6 * one.cpu_s / one.rows
        print(f"{one.rows:9d}{one.peak_mib:10.0f}{one.cpu_s:8.1f}{each:12.1f}  {one.verdict}", flush=True)
    if given.figure is not None:
        draw(costs, given.figure)


if __name__ == "__main__":
    main()
