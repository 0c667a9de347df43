"""`highside simulate`: a model file becomes a Recording, with the truth beside it.

Beside `REC.csv.gz` stands `REC.truth.json`: the model, the seed, every parameter in force and the true inclination and
toolface of each pose; for continuous motion the truth row by row in `REC.truth.csv.gz`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo
from highside.cli.simulate_drift import ExperimentName, write_experiment


def simulate(
    *,
    model: Annotated[Path | None, typer.Argument(help="Model file (TOML) with a [motion] table.")] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="The Recording to write; .gz zips it.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same file, byte for byte.")] = 1,
    poses: Annotated[Path | None, typer.Option("--poses", help="Also write the pose table of the stops (CSV).")] = None,
    experiment: Annotated[
        ExperimentName | None, typer.Option("--experiment", help="An experiment on gyro drift instead of a model.")
    ] = None,
    elevation_deg: Annotated[
        float, typer.Option("--elevation-deg", min=-89, max=89, help="Of the rotating table, above the horizontal.")
    ] = 30.0,
    effects: EffectFolders = None,
) -> None:
    """Simulate a session on a bench, or a drilling leg, with the effects that the model names."""
    from highside.errors import InputError

    if (model is None) == (experiment is None):
        raise InputError("either is needed, and not both", field="MODEL, --experiment", remedy="name a model file")
    if experiment is not None:
        if poses is not None:
            raise InputError("has no meaning with --experiment", field="--poses", remedy="leave it out")
        write_experiment(experiment, elevation_deg, output, seed)
        return
    assert model is not None
    take_in(effects)
    from highside.api.simulation import simulate as run
    from highside.recording.files import write_whole

    done = run(model, seed=seed)
    if poses is not None and done.poses is None:
        raise InputError("this motion has no stops to make a pose table of", where=str(model), field="motion.kind")
    done.recording.write(output)
    stem = output.name.removesuffix(".gz").removesuffix(".csv")
    written = [output, output.with_name(f"{stem}.truth.json")]
    write_whole(written[1], (json.dumps(done.truth, indent=1) + "\n").encode())
    if done.poses is None:
        written.append(output.with_name(f"{stem}.truth.csv.gz"))
        done.rows_truth.write(written[-1])
    elif poses is not None:
        written.append(poses)
        done.poses.write(poses)
    for name in done.without_size:
        echo(f"note: the effect '{name}' is included, but all its parameters are 0", err=True)
    echo(f"{done.recording.n} rows; wrote {', '.join(str(path) for path in written)}", err=True)
