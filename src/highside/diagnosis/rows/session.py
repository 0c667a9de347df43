"""Rows of a continuously rotating recording with a known reference: readings of all channels, and the chain's state.

Nothing is averaged: what a rotating tool shows is in the single rows. Gyros, where recorded, are further channels
beside the accelerometers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.rows.policy import GRAMS, ROW_SESSIONS
from highside.errors import InputError
from highside.long_arrays import by_runs, concatenated, counted, is_long, numbered_rows, runs_of
from highside.physics.state import ChainState
from highside.scratch_arrays import evaluated

ACCEL = ("ax", "ay", "az")
GYROS = ("gx", "gy", "gz")
PER_ROW = (
    "t_s",
    "inc_rad",
    "tf_rad",
    "direction",
    "temp_c",
    "rotor_rate_radps",
    "rotor_accel_radps2",
    "inc_rate_radps",
    "vibration_rms_g",
)
"""what is known of each row of a rotation"""
FIRST_GYRO = len(ACCEL)
"""number of the first channel that is a gyro, where there are any"""


@dataclass(frozen=True)
class RotationSession:
    """n rows: `readings` (C, n), accelerometers in g and below them gyros in rad/s, tool frame; `state` n rows."""

    readings: Array
    state: ChainState
    omitted: NDArray[np.bool_] | None = None
    """(n,) rows that say nothing of physics: a reading at its limit"""
    finer_blocks: bool = field(default=False, kw_only=True)
    """whether the noise's levels are followed in blocks of few rows"""

    @property
    def shortest_block_s(self) -> float:
        """Blocks by whose means a noise with memory is observed are no shorter, s."""
        return min(GRAMS.block_s, GRAMS.block_rows * self.step_s) if self.finer_blocks else GRAMS.block_s

    @property
    def n(self) -> int:
        """Number of rows."""
        return int(self.readings.shape[1])

    @property
    def long(self) -> bool:
        """Whether the rows are not in the memory."""
        return is_long(self.readings)

    @property
    def gyros(self) -> bool:
        """Whether rates were recorded."""
        return bool(self.readings.shape[0] > 3)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in their order."""
        return ACCEL + GYROS if self.gyros else ACCEL

    @property
    def step_s(self) -> float:
        """Time from row to row."""
        return self.state.row_seconds

    @cached_property
    def places(self) -> Array:
        """(n,) time of each row since the first in steps; their numbers where no rows are missing."""
        number = numbered_rows(self.state.t_s)
        elapsed = (self.state.t_s - self.state.t_s[0]) / self.step_s
        return np.round(elapsed) if elapsed[-1] > (1 + ROW_SESSIONS.missing) * number[-1] else number

    def thinned(self, rows: int, seed: int) -> RotationSession:
        """About `rows` of the n rows: of each equally long run one, drawn by `seed`, so that no turning keeps step.

        Rows keep their times; `step_s` becomes the length of a run. A last run that is shorter is left out.
        """
        every = -(-self.n // rows)
        first = np.arange(0, self.n - every + 1, every)
        picked = first + np.random.default_rng(seed).integers(0, every, first.size)
        return RotationSession(
            np.ascontiguousarray(self.readings[:, picked]),
            replace(self.state.rows(picked), row_seconds=self.step_s * every),
            None if self.omitted is None else self.omitted[picked],
        )

    @cached_property
    def sample_rows(self) -> NDArray[np.intp]:
        """Rows that stand for all where these are too many: stretches spread over the recording."""
        length = min(ROW_SESSIONS.sample, self.n) // ROW_SESSIONS.sample_stretches
        starts = np.linspace(0, self.n - length, ROW_SESSIONS.sample_stretches).astype(np.intp)
        return np.unique(starts[:, None] + np.arange(length))

    @cached_property
    def sample(self) -> RotationSession:
        """These rows, in the memory."""
        rows = self.sample_rows
        omitted = None if self.omitted is None else self.omitted[rows]
        return RotationSession(np.ascontiguousarray(self.readings[:, rows]), self.state.rows(rows), omitted)

    @property
    def sample_stretch(self) -> tuple[slice, RotationSession]:
        """One stretch of the sample, in the middle: which of its rows, and these."""
        length = self.sample_rows.size // ROW_SESSIONS.sample_stretches
        own = slice(ROW_SESSIONS.sample_stretches // 2 * length, (ROW_SESSIONS.sample_stretches // 2 + 1) * length)
        first = int(self.sample_rows[own.start])
        return own, self.stretch(slice(first, first + length))

    def stretch(self, part: slice) -> RotationSession:
        """A run of the rows, in the memory."""
        if part == slice(0, self.n) and not self.long:
            return self
        omitted = None if self.omitted is None else self.omitted[part]
        return RotationSession(np.ascontiguousarray(self.readings[:, part]), self.state.rows(part), omitted)

    @cached_property
    def rate_group(self) -> NDArray[np.intp]:
        """(n,) number of the steady rate a row belongs to; -1 on ramps. At most so many, of like rates."""
        rate = self.state.rotor_rate_radps
        steady = np.abs(self.state.rotor_accel_radps2) < ROW_SESSIONS.steady * max(float(np.ptp(rate)), 1e-9)
        group = by_runs(rate, (self.n,), lambda part: np.full(part.stop - part.start, -1, dtype=np.intp))
        if np.ptp(rate) == 0 or not steady.any():
            return group
        levels = np.round(rate / (ROW_SESSIONS.level * max(float(np.abs(rate).max()), 1e-9)))
        found, count = counted(levels[part][steady[part]] for part in runs_of(self.n))
        large = np.flatnonzero(count > ROW_SESSIONS.least_share * self.n)
        if large.size < 2:
            return group
        order = np.full(found.size, -1, dtype=np.intp)
        order[large] = np.arange(large.size) * min(ROW_SESSIONS.rate_groups, large.size) // large.size

        def of(part: slice) -> NDArray[np.intp]:
            at = np.minimum(np.searchsorted(found, levels[part]), found.size - 1)
            return np.where(steady[part], order[at], -1)

        return by_runs(rate, (self.n,), of)


def rotation_session(
    columns: Mapping[str, Array],
    accel_g: Array,
    gyro_radps: Array | None = None,
    *,
    gravity_mps2: float,
    latitude_rad: float = 0.0,
    azimuth_rad: float = 0.0,
    omitted: NDArray[np.bool_] | None = None,
) -> RotationSession:
    """The rows of a recording. `columns` (N,) as in the Recording format, `accel_g`, `gyro_radps` (3, N), tool frame.

    Raises InputError that names the column that is lacking, or says that there are too few rows.
    """
    for name in ("inc_ref_deg", "tf_ref_deg"):
        if name not in columns and not (name == "tf_ref_deg" and "rotor_deg" in columns):
            raise InputError(
                "is missing", field=name, remedy="a rotation needs inc_ref_deg and tf_ref_deg or rotor_deg"
            )
    if accel_g.shape[1] < ROW_SESSIONS.min_rows:
        raise InputError(
            f"{accel_g.shape[1]} rows are too few to diagnose a rotation",
            remedy=f"at least {ROW_SESSIONS.min_rows} are needed",
        )
    state = ChainState.from_columns(
        {name: values for name, values in columns.items() if name != "pose"},
        gravity_mps2=gravity_mps2,
        latitude_rad=latitude_rad,
        azimuth_rad=azimuth_rad,
    )
    readings = accel_g if gyro_radps is None else concatenated([accel_g, gyro_radps])
    if is_long(readings):
        # what is read in each pass is worked out once
        made: dict[str, Any] = {name: evaluated(getattr(state, name)) for name in PER_ROW}
        return RotationSession(evaluated(readings), replace(state, **made), omitted)
    return RotationSession(np.ascontiguousarray(readings, dtype=float), state, omitted)
