"""`highside simulate --experiment`: the experiments on gyro drift as Recordings, for `highside drift`.

Beside `REC.csv.gz` stand `REC.truth.csv.gz` (inclination, toolface and azimuth, row by row) and `REC.truth.json` (the
imperfections, and when the tool stood: what `highside drift --rest` wants).
"""

from __future__ import annotations

import json
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.papers.drift_scenarios import DriftData


class DriftExperiment(StrEnum):
    TURNTABLE = "turntable"
    VIBRATION_TABLE = "vibration-table"
    DRILLING = "drilling"
    ROTATING_TABLE = "rotating-table"
    CURVED_HOLE = "curved-hole"
    ROTATING_ROD = "rotating-rod"


def write_experiment(name: DriftExperiment, elevation_deg: float, output: Path, seed: int) -> None:
    """Write the Recording of an experiment and the truth beside it; says what was written."""
    import numpy as np

    from highside.papers import drift_scenarios as scenarios
    from highside.recording.files import write_whole
    from highside.recording.table import Recording, write_recording

    made = {
        DriftExperiment.TURNTABLE: scenarios.turntable,
        DriftExperiment.VIBRATION_TABLE: scenarios.vibration_table,
        DriftExperiment.DRILLING: scenarios.drilling,
        DriftExperiment.ROTATING_TABLE: lambda: scenarios.rotating_table(elevation_deg),
        DriftExperiment.CURVED_HOLE: scenarios.curved_hole,
        DriftExperiment.ROTATING_ROD: scenarios.rotating_rod,
    }
    data = scenarios.record(made[name](), seed)
    e = data.experiment
    readings = {f"a{axis}_g": row for axis, row in zip("xyz", data.accel, strict=True)}
    rates = {f"g{axis}_dps": row for axis, row in zip("xyz", np.degrees(data.rate), strict=True)}
    write_recording(output, Recording({"t_s": e.t_s, **readings, **rates}))
    stem = output.name.removesuffix(".gz").removesuffix(".csv")
    rows, words = output.with_name(f"{stem}.truth.csv.gz"), output.with_name(f"{stem}.truth.json")
    truth = {
        "t_s": e.t_s,
        "inc_true_deg": np.degrees(e.theta) + 90.0,
        "tf_true_deg": np.degrees(e.phi) % 360.0,
        "azi_true_deg": np.degrees(e.psi) % 360.0,
    }
    write_recording(rows, Recording(truth))
    write_whole(words, (json.dumps(_truth(name, data, seed), indent=1) + "\n").encode())
    echo(f"{e.t_s.size} rows; wrote {output}, {rows}, {words}", err=True)
    if e.rest.size:
        stood = ",".join(f"{begin:g}-{end:g}" for begin, end in e.rest)
        echo(f"note: the tool stood at --rest {stood}", err=True)


def _truth(name: DriftExperiment, data: DriftData, seed: int) -> dict[str, Any]:
    import numpy as np

    from highside import __version__

    e = data.experiment
    return {
        "schema": "highside.drift-truth/1",
        "version": __version__,
        "experiment": name.value,
        "seed": seed,
        "latitude_deg": float(np.degrees(e.latitude_rad)),
        "azimuth_deg": float(np.degrees(e.psi[0])),
        "rest_s": e.rest.tolist(),
        # of the body frame: across, along the tool, and the third
        "imperfections": asdict(e.triad),
        "bias_end_dps": np.degrees(data.bias_end).tolist(),
    }
