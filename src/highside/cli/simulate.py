"""`highside simulate`: a model file becomes a Recording, with the truth beside it.

Beside `REC.csv.gz` stands `REC.truth.json`: the model, the seed, every parameter in force and the true inclination and
toolface of each pose; for continuous motion the truth row by row in `REC.truth.csv.gz`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.say import echo
from highside.cli.simulate_drift import DriftExperiment, write_experiment

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.codec.axes import AxisMap
    from highside.config.model import Model
    from highside.physics.simulation import Simulated

    Column = NDArray[np.float64]


def simulate(
    *,
    model: Annotated[Path | None, typer.Argument(help="Model file (TOML) with a [motion] table.")] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="The Recording to write; .gz zips it.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same file, byte for byte.")] = 1,
    poses: Annotated[Path | None, typer.Option("--poses", help="Also write the pose table of the stops (CSV).")] = None,
    experiment: Annotated[
        DriftExperiment | None, typer.Option("--experiment", help="An experiment on gyro drift instead of a model.")
    ] = None,
    elevation_deg: Annotated[
        float, typer.Option("--elevation-deg", min=-89, max=89, help="Of the rotating table, above the horizontal.")
    ] = 30.0,
) -> None:
    """Simulate a session on a bench, or a drilling leg, with the effects that the model names."""
    from highside.config.model import MAX_ROWS, load_model
    from highside.errors import InputError
    from highside.physics.simulation import simulate as run
    from highside.recording.files import write_whole
    from highside.recording.table import Recording, write_poses, write_recording

    if (model is None) == (experiment is None):
        raise InputError("either is needed, and not both", field="MODEL, --experiment", remedy="name a model file")
    if experiment is not None:
        if poses is not None:
            raise InputError("has no meaning with --experiment", field="--poses", remedy="leave it out")
        write_experiment(experiment, elevation_deg, output, seed)
        return
    assert model is not None
    knows = load_model(model)
    try:
        session = knows.session()
    except InputError as error:
        raise InputError(error.what, where=str(model), field=error.field, remedy=error.remedy) from None
    if not 1 <= session.plan.row_count <= MAX_ROWS:
        raise InputError(
            f"describes {session.plan.row_count:.3g} rows",
            where=str(model),
            field="motion",
            remedy=f"between 1 and {MAX_ROWS} can be made: change the durations or the rate of the rows",
        )
    forward = knows.forward(session.plan.row_seconds)
    gyros = bool(knows.motion and knows.motion.gyros)
    done = run(forward, session, seed, gyros=gyros)
    if poses is not None and not done.held.any():
        raise InputError("this motion has no stops to make a pose table of", where=str(model), field="motion.kind")

    write_recording(output, Recording(_columns(done, knows.tool.map, knows.sensor.noise_g)))
    stem = output.name.removesuffix(".gz").removesuffix(".csv")
    written = [output, output.with_name(f"{stem}.truth.json")]
    truth = _truth(done, knows, forward.parameters(), seed, model.name)
    write_whole(written[1], (json.dumps(truth, indent=1) + "\n").encode())
    if not done.held.any():
        written.append(output.with_name(f"{stem}.truth.csv.gz"))
        write_recording(written[-1], Recording(_row_truth(done)))
    if poses is not None:
        written.append(poses)
        write_poses(poses, _pose_table(done, knows.tool.map))
    nothing = [name for name, values in forward.parameters().items() if not any(_sized(name, values))]
    for name in nothing:
        echo(f"note: the effect '{name}' is included, but all its parameters are 0", err=True)
    echo(f"{done.accel.shape[1]} rows; wrote {', '.join(str(path) for path in written)}", err=True)


def _sized(effect_id: str, values: dict[str, float]) -> list[float]:
    """The values that give an effect its size."""
    from highside.physics import effects

    effect = effects.get(effect_id)
    return [values[effect.parameters[k].name] for k in effect.amplitudes]


def _columns(done: Simulated, axes: AxisMap, noise_g: float | None) -> dict[str, Column]:
    """The columns of the Recording, in the maker's axes."""
    import numpy as np

    state = done.state
    columns = {"t_s": state.t_s, **dict(zip(("ax_g", "ay_g", "az_g"), _makers(done.accel, axes), strict=True))}
    if done.gyro is not None:
        rates = np.degrees(_makers(done.gyro, axes))
        columns |= dict(zip(("gx_dps", "gy_dps", "gz_dps"), rates, strict=True))
    columns["temp_c"] = state.temp_c
    if np.any(state.rotor_rate_radps):
        columns["rotor_rate_dps"] = np.degrees(state.rotor_rate_radps)
    columns["inc_ref_deg"] = _whole_degrees(np.degrees(state.inc_rad))
    columns["tf_ref_deg"] = _wrapped_deg(state.tf_rad)
    if done.held.any():
        columns["pose"] = np.where(done.held, state.pose.astype(float), np.nan)
    columns["direction"] = state.direction
    if np.any(state.vibration_rms_g):
        columns["vibration_rms_g"] = state.vibration_rms_g
    if noise_g is not None:
        columns["noise_g"] = np.full(state.n, noise_g)
    columns["seq"] = done.seq.astype(float)
    return columns


def _makers(vectors: Column, axes: AxisMap) -> Column:
    """Tool components (3, N) -> maker's components, the inverse of `AxisMap.apply`."""
    import numpy as np

    result = np.empty_like(vectors)
    for tool_axis, (maker_axis, sign) in enumerate(zip(axes.order, axes.signs, strict=True)):
        result[maker_axis] = sign * vectors[tool_axis]
    return result


def _whole_degrees(degrees: Column) -> Column:
    """Without the last digits that the way through radians has left (45.00000000000001): an encoder has none."""
    import numpy as np

    return np.round(degrees, 9) + 0.0


def _wrapped_deg(angle_rad: Column) -> Column:
    """Degrees in [0, 360)."""
    import numpy as np

    return _whole_degrees(np.mod(np.degrees(angle_rad), 360.0)) % 360.0


def _truth(
    done: Simulated, knows: Model, parameters: dict[str, dict[str, float]], seed: int, name: str
) -> dict[str, Any]:
    """What a judge needs: the parameters with units, and where the tool truly was at each pose."""
    import numpy as np

    from highside import __version__
    from highside.physics import effects

    units = {effect_id: {p.name: p.unit for p in effects.get(effect_id).parameters} for effect_id in parameters}
    truth: dict[str, Any] = {
        "schema": "highside.truth/1",
        "version": __version__,
        "model_file": name,
        "model": knows.model_dump(mode="json", exclude_none=True),
        "seed": seed,
        "rows": int(done.accel.shape[1]),
        "row_seconds": done.state.row_seconds,
        "gravity_mps2": done.state.gravity_mps2,
        "effects": {
            effect_id: {key: {"value": value, "unit": units[effect_id][key]} for key, value in values.items()}
            for effect_id, values in parameters.items()
        },
        "power_up_bias_g": done.power_up_bias_g.tolist(),
    }
    if done.held.any():
        pose, first = np.unique(np.where(done.held, done.state.pose, -1), return_index=True)
        stops = [(number, row) for number, row in zip(pose.tolist(), first.tolist(), strict=True) if number >= 0]
        inc_ref, tf_ref = _whole_degrees(np.degrees(done.state.inc_rad)), _wrapped_deg(done.state.tf_rad)
        truth["poses"] = [
            {
                "pose": number,
                "inc_ref_deg": float(inc_ref[row]),
                "tf_ref_deg": float(tf_ref[row]),
                "direction": int(done.state.direction[row]),
                "temp_c": float(done.state.temp_c[row]),
                "inc_true_deg": float(np.degrees(done.inc_true[row])),
                "tf_true_deg": float(np.degrees(done.tf_true[row])),
            }
            for number, row in stops
        ]
    return truth


def _row_truth(done: Simulated) -> dict[str, Column]:
    import numpy as np

    return {
        "t_s": done.state.t_s,
        "inc_true_deg": np.degrees(done.inc_true),
        "tf_true_deg": np.degrees(done.tf_true),
        "seq": done.seq.astype(float),
    }


def _pose_table(done: Simulated, axes: AxisMap) -> Any:
    """Means and standard deviations over each stop."""
    import numpy as np

    from highside.recording.table import PoseTable

    accel = _makers(done.accel, axes)
    inc_ref, tf_ref = _whole_degrees(np.degrees(done.state.inc_rad)), _wrapped_deg(done.state.tf_rad)
    rows = []
    for pose in np.unique(done.state.pose[done.held]):
        at = done.held & (done.state.pose == pose)
        n = int(at.sum())
        std = accel[:, at].std(axis=1, ddof=1) if n > 1 else np.full(3, np.nan)
        first = int(np.flatnonzero(at)[0])
        rows.append([inc_ref[first], tf_ref[first], *accel[:, at].mean(axis=1), n, *std, done.state.temp_c[at].mean()])
    names = ("inc_ref_deg", "tf_ref_deg", "ax", "ay", "az", "n", "std_ax", "std_ay", "std_az", "temp_c")
    table = dict(zip(names, np.array(rows).T, strict=True))
    return PoseTable({name: column for name, column in table.items() if not np.isnan(column).all()})
