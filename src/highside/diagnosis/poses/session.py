"""From the rows of a recording to the poses of a stepped session: one mean, and one state of the chain, for each stop.

Rows are grouped by the recording's `pose` column; where it has none, the still intervals are found by the sensor's own
noise. What happened on the way from pose to pose is left aside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.still_intervals import find_still_intervals
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.floor import NoiseFloor, floor_of_means, floor_of_table
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.outlying import outlying_findings
from highside.diagnosis.core.result import Finding
from highside.diagnosis.poses.exchanged import exchanged_pairs
from highside.diagnosis.poses.policy import POSE_SESSIONS
from highside.diagnosis.poses.within import moving_pose, within_poses
from highside.errors import InputError
from highside.physics.forward import ForwardModel
from highside.physics.state import KNOWN_COLUMNS, ChainState


@dataclass(frozen=True)
class HeldRows:
    """N rows within the poses, in time order: `values` (3, N) in g, the number of each row's `pose`, `t_s`; (N,)."""

    values: Array
    pose: NDArray[np.intp]
    t_s: Array

    @classmethod
    def of(cls, accel_g: Array, groups: list[NDArray[np.intp]], t_s: Array) -> HeldRows:
        """The rows of groups (one for each pose) of a recording."""
        rows = np.concatenate(groups)
        pose = np.repeat(np.arange(len(groups)), [own.size for own in groups])
        return cls(accel_g[:, rows], pose, t_s[rows])

    def select(self, poses: NDArray[np.intp]) -> HeldRows:
        """The rows of these poses."""
        number = np.full(int(self.pose[-1]) + 1, -1, dtype=np.intp)
        number[poses] = np.arange(len(poses))
        kept = number[self.pose] >= 0
        return HeldRows(self.values[:, kept], number[self.pose[kept]], self.t_s[kept])


@dataclass(frozen=True)
class PoseSession:
    """n poses: `mean` (3, n) in g, tool frame; `count` (n,) rows of each; `state` with n rows in time order.

    `scatter` (3, n) is the standard deviation of a row within each pose, g; None where a pose has one row only.
    """

    mean: Array
    count: Array
    state: ChainState
    scatter: Array | None = None
    floor: NoiseFloor | None = None
    """how well the means repeat, by the rows within the poses"""
    within: tuple[Finding, ...] = ()
    """what the rows do while a pose is held"""
    expected: int = 0
    """stops that the reference has"""
    rows: HeldRows | None = None
    numbers: tuple[float, ...] = ()
    """of the poses in the recording's own column, if it has one"""
    sides_told: bool = True
    """whether the recording says from which side each pose was approached; else the states have it from their order"""

    def label(self, pose: int) -> str:
        """The number of a pose as the recording has it, else counted from 1, of how many."""
        return f"{self.numbers[pose]:g}" if self.numbers else f"{pose + 1} of {self.n}"

    @property
    def n(self) -> int:
        """Number of poses."""
        return int(self.mean.shape[1])

    def select(self, poses: NDArray[np.intp]) -> PoseSession:
        """These poses alone."""
        return replace(
            self,
            mean=self.mean[:, poses],
            count=self.count[poses],
            state=self.state.rows(poses),
            scatter=None if self.scatter is None else self.scatter[:, poses],
            floor=None if self.floor is None else NoiseFloor(self.floor.sigma[:, poses], self.floor.freedom),
            rows=None if self.rows is None else self.rows.select(poses),
            numbers=tuple(self.numbers[k] for k in poses) if self.numbers else (),
        )


def without_outlying_poses(
    session: PoseSession, model: ForwardModel, free: Sequence[str]
) -> tuple[PoseSession, tuple[Finding, ...]]:
    """The session without the poses that do not belong to the others, and a finding for each of them; first those whose
    angles were exchanged."""
    session, exchanged = _without_exchanged(session, model, free)
    observed = Observed(session.state, session.mean)
    fitted, residual = base_fit(model, observed, free)
    columns = observed.jacobian(fitted, fitted.free_names(list(free)))

    def place(pose: int) -> str:
        inc, tf = np.degrees(session.state.inc_rad[pose]), np.degrees(session.state.tf_rad[pose]) % 360.0
        return f"pose {session.label(pose)}, at inclination {inc:.4g} and toolface {tf:.4g} deg"

    state = session.state
    covariates = (state.temp_c, state.vibration_rms_g, *state.extra.values())
    out, findings = outlying_findings(residual, columns, ("ax", "ay", "az"), place, covariates)
    kept = session.select(np.setdiff1d(np.arange(session.n), out)) if out else session
    return kept, (*exchanged, *findings)


def _without_exchanged(
    session: PoseSession, model: ForwardModel, free: Sequence[str]
) -> tuple[PoseSession, tuple[Finding, ...]]:
    """The session without the poses that read as each other should, and a finding for each pair."""
    pairs = exchanged_pairs(session.state, session.mean, model, free)
    findings = tuple(
        Finding(
            "exchanged_poses",
            ("ax", "ay", "az"),
            0.0,
            f"poses {session.label(one)} and {session.label(other)} read as each other should: with their angles "
            f"exchanged the misfit falls from {before:.3g} to {after:.3g} g rms. Both were left out: look at what was "
            "written down",
        )
        for (one, other), before, after in pairs
    )
    out = [pose for pair, _, _ in pairs for pose in pair]
    return (session.select(np.setdiff1d(np.arange(session.n), out)) if out else session), findings


def pose_session(
    columns: Mapping[str, Array],
    accel_g: Array,
    *,
    gravity_mps2: float,
    latitude_rad: float = 0.0,
    azimuth_rad: float = 0.0,
) -> PoseSession:
    """The poses of a recording. `columns` (N,) as in the Recording format, `accel_g` (3, N) in the tool frame.

    Raises InputError that names the column that is lacking, or says that there are too few poses.
    """
    for name in ("inc_ref_deg", "tf_ref_deg"):
        if name not in columns and not (name == "tf_ref_deg" and "rotor_deg" in columns):
            raise InputError("is missing", field=name, remedy="a pose reference needs inc_ref_deg and tf_ref_deg")
    groups = rows_of_poses(columns, accel_g)
    if len(groups) < POSE_SESSIONS.min_poses:
        raise InputError(
            f"{len(groups)} poses are too few for a diagnosis", remedy=f"at least {POSE_SESSIONS.min_poses} are needed"
        )

    def each(name: str, how: str) -> Array:
        column = columns[name]
        average = np.mean if how == "mean" else np.median
        return np.array([float(average(column[rows])) for rows in groups])

    hows = {
        "t_s": "mean",
        "inc_ref_deg": "median",
        "tf_ref_deg": "median",
        "rotor_deg": "median",
        "direction": "median",
        "temp_c": "mean",
        "vibration_rms_g": "mean",
        "vibration_x_rms_g": "mean",
        "vibration_y_rms_g": "mean",
        "vibration_z_rms_g": "mean",
    }
    hows |= {name: "mean" for name in columns if name not in KNOWN_COLUMNS}
    table = {name: each(name, how) for name, how in hows.items() if name in columns}
    table["pose"] = np.arange(len(groups), dtype=float)
    state = ChainState.from_columns(
        table, gravity_mps2=gravity_mps2, latitude_rad=latitude_rad, azimuth_rad=azimuth_rad
    )
    since_move_s, stay_s = _stays(columns["t_s"], groups)
    state = replace(state, since_move_s=since_move_s, stay_s=stay_s)
    mean = np.stack([accel_g[:, rows].mean(axis=1) for rows in groups], axis=1)
    count = np.array([float(rows.size) for rows in groups])
    scatter = np.stack([accel_g[:, rows].std(axis=1, ddof=1) for rows in groups], axis=1) if count.min() > 1 else None
    step_s = float(np.median(np.diff(columns["t_s"]))) if columns["t_s"].size > 1 else 1.0
    within = within_poses(accel_g, groups, step_s)
    moved = None if within else moving_pose(accel_g, groups)
    within = within if moved is None else (moved[1],)
    floor = floor_of_means(accel_g, groups) if moved is None else _floor_beside(accel_g, groups, moved[0])
    if floor is None and all(rows.size == 1 for rows in groups):
        floor = floor_of_table(columns, np.concatenate(groups))
    rows = HeldRows.of(accel_g, groups, columns["t_s"])
    stops, numbers, told = _stops(columns), _numbers(columns, groups), "direction" in columns
    return PoseSession(mean, count, state, scatter, floor, within, stops, rows, numbers, told)


def _numbers(columns: Mapping[str, Array], groups: list[NDArray[np.intp]]) -> tuple[float, ...]:
    """The poses' numbers in the recording's own column; none where that is the count of a table's rows."""
    if "pose" not in columns:
        return ()
    numbers = np.array([float(columns["pose"][rows[0]]) for rows in groups])
    counted = len(groups) == columns["t_s"].size and np.ptp(numbers - np.arange(len(groups))) == 0
    return () if counted else tuple(map(float, numbers))


def _floor_beside(accel_g: Array, groups: list[NDArray[np.intp]], moved: int) -> NoiseFloor | None:
    """The floor of the means where one pose moved: that of the others, and for its own what its rows (3, N) go through,
    as a mean over a motion is known no better."""
    others = [k for k in range(len(groups)) if k != moved]
    known = floor_of_means(accel_g, [groups[k] for k in others])
    if known is None:
        return None
    sigma = np.empty((len(accel_g), len(groups)))
    sigma[:, others] = known.sigma
    sigma[:, moved] = np.maximum(accel_g[:, groups[moved]].std(axis=1), known.sigma.max(axis=1))
    return NoiseFloor(sigma, known.freedom)


def _stays(t_s: Array, groups: list[NDArray[np.intp]]) -> tuple[Array, Array]:
    """(n,) s each: how long after its first row the middle of each stop was, and how long it took."""
    step = float(np.median(np.diff(t_s)))
    length = np.array([float(t_s[rows[-1]] - t_s[rows[0]]) for rows in groups])
    middle = np.array([float(t_s[rows].mean() - t_s[rows[0]]) for rows in groups])
    return middle, np.where(length > 0, length + step, 0.0)


def rows_of_poses(columns: Mapping[str, Array], accel_g: Array) -> list[NDArray[np.intp]]:
    """Row numbers of each stop, in time order."""
    if "pose" in columns:
        pose = columns["pose"]
        held = np.flatnonzero(~np.isnan(pose))
        borders = np.flatnonzero(np.diff(pose[held])) + 1
        return [rows for rows in np.split(held, borders) if rows.size]
    t_s = columns["t_s"]
    rate_hz = 1.0 / float(np.median(np.diff(t_s)))
    settings = np.round(columns["inc_ref_deg"], 3) * POSE_SESSIONS.key + np.round(
        columns.get("tf_ref_deg", columns["inc_ref_deg"]), 3
    )
    return [interval.rows() for interval in find_still_intervals(accel_g, rate_hz, labels=settings)]


def _stops(columns: Mapping[str, Array]) -> int:
    """How often the reference stands still for as long as half of its usual stop, at least."""
    if "pose" in columns:
        return int(np.unique(columns["pose"][~np.isnan(columns["pose"])]).size)
    settings = np.stack([columns[name] for name in ("inc_ref_deg", "tf_ref_deg", "rotor_deg") if name in columns])
    borders = np.flatnonzero(np.any(np.diff(np.round(settings, 3), axis=1) != 0, axis=0)) + 1
    lengths = np.diff(np.concatenate([[0], borders, [settings.shape[1]]]))
    return int(np.sum(lengths > 0.5 * np.max(lengths)))
