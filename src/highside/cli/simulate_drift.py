"""`highside simulate --experiment`: the experiments on gyro drift as Recordings, for `highside drift`.

Beside `REC.csv.gz` stand `REC.truth.csv.gz` (inclination, toolface and azimuth, row by row) and `REC.truth.json` (the
imperfections, and when the tool stood: what `highside drift --rest` wants).
"""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path

from highside.cli.say import echo


class ExperimentName(StrEnum):
    TURNTABLE = "turntable"
    VIBRATION_TABLE = "vibration-table"
    DRILLING = "drilling"
    ROTATING_TABLE = "rotating-table"
    CURVED_HOLE = "curved-hole"
    ROTATING_ROD = "rotating-rod"


def write_experiment(name: ExperimentName, elevation_deg: float, output: Path, seed: int) -> None:
    """Write the Recording of an experiment and the truth beside it; says what was written."""
    from highside.papers import drift_scenarios as scenarios
    from highside.recording.files import write_whole
    from highside.recording.table import Recording, write_recording
    from highside.version import __version__

    made = {
        ExperimentName.TURNTABLE: scenarios.turntable,
        ExperimentName.VIBRATION_TABLE: scenarios.vibration_table,
        ExperimentName.DRILLING: scenarios.drilling,
        ExperimentName.ROTATING_TABLE: lambda: scenarios.rotating_table(elevation_deg),
        ExperimentName.CURVED_HOLE: scenarios.curved_hole,
        ExperimentName.ROTATING_ROD: scenarios.rotating_rod,
    }
    data = scenarios.record(made[name](), seed)
    e = data.experiment
    write_recording(output, Recording(data.columns()))
    stem = output.name.removesuffix(".gz").removesuffix(".csv")
    rows, words = output.with_name(f"{stem}.truth.csv.gz"), output.with_name(f"{stem}.truth.json")
    write_recording(rows, Recording(data.true_columns()))
    truth = {"schema": "highside.drift-truth/1", "version": __version__, "experiment": name.value, "seed": seed}
    write_whole(words, (json.dumps(truth | data.about(), indent=1) + "\n").encode())
    echo(f"{e.t_s.size} rows; wrote {output}, {rows}, {words}", err=True)
    if e.rest.size:
        stood = ",".join(f"{begin:g}-{end:g}" for begin, end in e.rest)
        echo(f"note: the tool stood at --rest {stood}", err=True)
