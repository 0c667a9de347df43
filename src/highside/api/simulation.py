"""Simulation: a model becomes a recording with the truth beside it; what a model says each row of a recording reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from highside.api.bench import ModelLike, model_of
from highside.api.recording import Recording
from highside.arrays import Array
from highside.codec.axes import AxisMap
from highside.config.model import MAX_ROWS, Model
from highside.errors import InputError
from highside.physics import effects
from highside.physics.covariates import COVARIATES
from highside.physics.law import PREFIX
from highside.physics.simulation import Simulated
from highside.physics.simulation import simulate as run
from highside.physics.state import ChainState
from highside.recording.frames import Columns, File, FrameT, take
from highside.recording.table import PoseTable, Readings, Table
from highside.shown.plot import Plot
from highside.version import __version__

__all__ = ["Simulation", "predict", "simulate"]


ACCELEROMETERS = ("ax_g", "ay_g", "az_g")
GYROS = ("gx_dps", "gy_dps", "gz_dps")
POSE_MEANS = ("ax", "ay", "az")
VIBRATIONS = ("vibration_rms_g", "vibration_x_rms_g", "vibration_y_rms_g", "vibration_z_rms_g")
PREDICTED = (*ACCELEROMETERS, *POSE_MEANS, *GYROS)
POSE_SPACING_S = 60.0
"""the poses of a table without times are taken to be so far apart"""


@dataclass(frozen=True, slots=True)
class Simulation:
    """A simulated session: the rows as a link would deliver them, and everything that a judge of them needs."""

    recording: Recording
    """N rows in the maker's axes: `t_s, ax_g, ay_g, az_g`, gyros where the model has them, references, covariates"""
    truth: dict[str, Any]
    """the model, the seed, every parameter in force with its unit, and where the tool truly was at each pose"""
    rows_truth: Recording
    """`t_s, inc_true_deg, tf_true_deg, seq` of every row"""
    poses: PoseTable | None
    """means and standard deviations over each stop; None for a motion without stops"""
    without_size: tuple[str, ...]
    """effects that are included with all their parameters 0"""

    def _repr_html_(self) -> str:
        """What a notebook shows: the recording."""
        return self.recording._repr_html_()

    def plot(self, *names: str) -> Plot:
        """Columns of the recording over time; see `Recording.plot`."""
        return self.recording.plot(*names)


def simulate(model: ModelLike, *, seed: int = 1) -> Simulation:
    """Simulate the session on a bench, or the drilling leg, that the `[motion]` of a model describes.

    `model`: a model file (TOML), its tables as a dict, or a `Model`. The same seed gives the same numbers, bit for bit.
    Raises InputError for a model that is not in order, and for one without a motion.
    """
    knows = model_of(model)
    where = None if isinstance(model, Model | Mapping) else str(model)
    try:
        session = knows.session()
    except InputError as error:
        raise InputError(error.what, where=where, field=error.field, remedy=error.remedy) from None
    if not 1 <= session.plan.row_count <= MAX_ROWS:
        raise InputError(
            f"describes {session.plan.row_count:.3g} rows",
            where=where,
            field="motion",
            remedy=f"between 1 and {MAX_ROWS} can be made: change the durations or the rate of the rows",
        )
    forward = knows.forward(session.plan.row_seconds)
    done = run(forward, session, seed, gyros=bool(knows.motion and knows.motion.gyros))
    parameters = forward.parameters()
    return Simulation(
        Recording(_columns(done, knows.tool.map, knows.sensor.noise_g)),
        _truth(done, knows, parameters, seed, "model" if where is None else Path(where).name),
        Recording(_row_truth(done)),
        _pose_table(done, knows.tool.map) if done.held.any() else None,
        tuple(name for name, values in parameters.items() if not any(_sizes(name, values))),
    )


@overload
def predict(model: ModelLike, recording: File) -> Readings: ...
@overload
def predict(model: ModelLike, recording: Columns) -> dict[str, Array]: ...
@overload
def predict(model: ModelLike, recording: FrameT) -> FrameT: ...
def predict(model: ModelLike, recording: Any) -> Any:
    """What a model says each row of a recording reads: the recording with its readings replaced by predictions.

    `recording` (a file, DataFrame, dict of arrays or Recording of N rows) needs `t_s` in s, `inc_ref_deg` and
    `tf_ref_deg` (or `rotor_deg`); `temp_c`, `direction`, `pose`, `rotor_rate_dps` and others are used where they are
    there. A pose table will do as well. The answer is of the kind that came in: `ax_g, ay_g, az_g` in g (`ax, ay, az`
    of a pose table) and, where gyros were recorded, `gx_dps, gy_dps, gz_dps` in deg/s, in the maker's axes; the other
    columns stay. Rows whose reference, time or a covariate is missing have no prediction. What is random (noise,
    wander) and what only a link does (lost rows, quantisation) is omitted: this is the mean of what would be read.
    Raises InputError for a model or a recording that is not in order.
    """
    knows = model_of(model)
    if knows.reference.kind == "simulation":
        raise InputError("the model says that another program predicts the recording", field="reference.kind")
    taken = take(recording, Readings)
    table = taken.table
    means = "t_s" not in table.columns and table.has(*POSE_MEANS)
    state, rows = state_of(table, knows, means=means)
    forward = knows.forward()
    columns = _spread(_makers(forward.predict(state), knows.tool.map), POSE_MEANS if means else ACCELEROMETERS, rows)
    if any(table.has(name) for name in GYROS):
        rates = np.degrees(_makers(forward.gyro(state), knows.tool.map))
        columns |= {name: row for name, row in _spread(rates, GYROS, rows).items() if table.has(name)}
        if not any(table.has(name) for name in ACCELEROMETERS):
            columns = {name: columns[name] for name in columns if name in GYROS}
    return taken.with_columns(columns)


def state_of(table: Table, knows: Model, *, means: bool = False) -> tuple[ChainState, NDArray[np.bool_]]:
    """What the recording says of the tool at the rows that say it all, and which rows (N,) these are."""
    used = ("inc_ref_deg", "tf_ref_deg", "temp_c", "direction", "rotor_rate_dps", *VIBRATIONS)
    names = [name for name in used if name in table.columns]
    if "tf_ref_deg" not in table.columns and "rotor_deg" in table.columns:
        names.append("rotor_deg")
    # what a law depends on beside these is a column of the recording's own
    own = {name for law in knows.known_laws for name in law.depends_on if name not in COVARIATES}
    table.require(*sorted(own))
    columns = {name: table.columns[name] for name in [*names, *sorted(own)]}
    if means:
        number = np.arange(table.n, dtype=np.float64)
        columns |= {"t_s": np.multiply(POSE_SPACING_S, number), "pose": number}
    else:
        table.require("t_s")
        columns["t_s"] = table.columns["t_s"]
    rows = np.asarray(np.isfinite(np.vstack(list(columns.values()))).all(axis=0))
    if "pose" in table.columns and not means:
        columns["pose"] = table.columns["pose"]
    if not rows.any():
        raise InputError("no row has time, reference and covariates", where=table.source, field=", ".join(names))
    site = knows.site.site
    try:
        state = ChainState.from_columns(
            {name: column[rows] for name, column in columns.items()},
            gravity_mps2=site.gravity_mps2,
            latitude_rad=site.latitude_rad,
            azimuth_rad=site.azimuth_rad,
        )
    except InputError as error:
        raise InputError(error.what, where=table.source, field=error.field, remedy=error.remedy) from None
    return state, rows


def _spread(values: Array, names: tuple[str, ...], rows: NDArray[np.bool_]) -> dict[str, Array]:
    """(3, M) values of some of N rows as columns (N,), NaN elsewhere."""
    columns = {name: np.full(rows.size, np.nan) for name in names}
    for name, row in zip(names, values, strict=True):
        columns[name][rows] = row
    return columns


def _sizes(effect_id: str, values: dict[str, float]) -> list[float]:
    """The values that give an effect its size."""
    if effect_id.startswith(PREFIX):
        return list(values.values())
    effect = effects.get(effect_id)
    return [values[effect.parameters[k].name] for k in effect.amplitudes]


def _columns(done: Simulated, axes: AxisMap, noise_g: float | None) -> dict[str, Array]:
    """The columns of the Recording, in the maker's axes."""
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
    columns |= {name: getattr(state, name) for name in VIBRATIONS if np.any(getattr(state, name))}
    if noise_g is not None:
        columns["noise_g"] = np.full(state.n, noise_g)
    columns["seq"] = done.seq.astype(float)
    return columns


def _makers(vectors: Array, axes: AxisMap) -> Array:
    """Tool components (3, N) -> maker's components, the inverse of `AxisMap.apply`."""
    result = np.empty_like(vectors)
    for tool_axis, (maker_axis, sign) in enumerate(zip(axes.order, axes.signs, strict=True)):
        result[maker_axis] = sign * vectors[tool_axis]
    return result


def _whole_degrees(degrees: Array) -> Array:
    """Without the last digits that the way through radians has left (45.00000000000001): an encoder has none."""
    return np.round(degrees, 9) + 0.0


def _wrapped_deg(angle_rad: Array) -> Array:
    """Degrees in [0, 360)."""
    return _whole_degrees(np.mod(np.degrees(angle_rad), 360.0)) % 360.0


def _truth(
    done: Simulated, knows: Model, parameters: dict[str, dict[str, float]], seed: int, name: str
) -> dict[str, Any]:
    """What a judge needs: the parameters with units, and where the tool truly was at each pose."""
    forward = knows.forward()
    units = {effect_id: {p.name: p.unit for p in forward.effect(effect_id).parameters} for effect_id in parameters}
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


def _row_truth(done: Simulated) -> dict[str, Array]:
    return {
        "t_s": done.state.t_s,
        "inc_true_deg": np.degrees(done.inc_true),
        "tf_true_deg": np.degrees(done.tf_true),
        "seq": done.seq.astype(float),
    }


def _pose_table(done: Simulated, axes: AxisMap) -> PoseTable:
    """Means and standard deviations over each stop."""
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
