"""What is known about the tool at each row of a recording before any effect acts: the forward model's input.

`ChainState` is a struct of arrays for N rows. The angles are those that the bench *reads* (its encoders): effects of
the bench turn them into where the tool truly is. Quantities that a recording lacks stay at their neutral value, and an
effect that needs them then has no influence (and cannot be detected).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.long_arrays import LongArray, by_runs, is_long, runs_of
from highside.scratch_arrays import stored
from highside.units import STANDARD_GRAVITY_MPS2

Ints = NDArray[np.int64]

_OWN_COLUMNS = (
    "t_s seq pose direction temp_c vibration_rms_g noise_g n ax_g ay_g az_g ax ay az std_ax std_ay std_az "
    "gx_dps gy_dps gz_dps inc_ref_deg tf_ref_deg rotor_deg rotor_rate_dps"
)
KNOWN_COLUMNS = frozenset(_OWN_COLUMNS.split(" "))
"""Columns of a Recording that have a meaning of their own; any other numeric one is kept in `ChainState.extra`."""


@dataclass(frozen=True)
class ChainState:
    """Rows in time order, (N,) arrays; build with `ChainState.build`, which fills in what is not given.

    `direction` is +1 or -1, the side from which the toolface was approached, of poses that do not say it by the order
    in which their toolfaces were set; `pose` counts the stops of a stepped
    session (continuous motion is one pose: the bench does not stop anew); `row_seconds` is the averaging time of a row.
    `since_move_s` is the time since the bench stopped at the pose, in the middle of the `stay_s` seconds that a row
    averages (0 for a single reading). `latitude_rad` is NaN where nobody said where the bench stands.
    """

    t_s: AnyArray
    inc_rad: AnyArray
    tf_rad: AnyArray
    direction: AnyArray
    temp_c: AnyArray
    rotor_rate_radps: AnyArray
    rotor_accel_radps2: AnyArray
    inc_rate_radps: AnyArray
    vibration_rms_g: AnyArray
    pose: Ints
    vibration_x_rms_g: AnyArray
    vibration_y_rms_g: AnyArray
    vibration_z_rms_g: AnyArray
    since_move_s: AnyArray
    stay_s: AnyArray
    row_seconds: float = 1.0
    gravity_mps2: float = STANDARD_GRAVITY_MPS2
    latitude_rad: float = 0.0
    azimuth_rad: float = 0.0
    extra: Mapping[str, AnyArray] = field(default_factory=dict)
    """(N,) further columns of the recording by their names: what a law may depend on"""

    @classmethod
    @cache
    def nowhere(cls) -> Self:
        """A state without rows, for effects that follow the load alone."""
        return cls.build(np.empty(0), np.empty(0))

    @classmethod
    def build(
        cls,
        inc_rad: AnyArray,
        tf_rad: AnyArray,
        *,
        t_s: AnyArray | None = None,
        direction: AnyArray | float = 1.0,
        temp_c: AnyArray | float = 25.0,
        rotor_rate_radps: AnyArray | float = 0.0,
        rotor_accel_radps2: AnyArray | float = 0.0,
        inc_rate_radps: AnyArray | float = 0.0,
        vibration_rms_g: AnyArray | float = 0.0,
        vibration_x_rms_g: AnyArray | float = 0.0,
        vibration_y_rms_g: AnyArray | float = 0.0,
        vibration_z_rms_g: AnyArray | float = 0.0,
        since_move_s: AnyArray | float = 0.0,
        stay_s: AnyArray | float = 0.0,
        pose: Ints | None = None,
        row_seconds: float = 1.0,
        gravity_mps2: float = STANDARD_GRAVITY_MPS2,
        latitude_rad: float = 0.0,
        azimuth_rad: float = 0.0,
        extra: Mapping[str, AnyArray] | None = None,
    ) -> Self:
        """Scalars are spread over the rows; `t_s` defaults to one row each `row_seconds`, `pose` to one pose a row."""
        if is_long(inc_rad):
            inc, tf = inc_rad, tf_rad
        else:
            inc, tf = np.broadcast_arrays(np.asarray(inc_rad, dtype=float), np.asarray(tf_rad, dtype=float))
            inc, tf = inc.reshape(inc.size), tf.reshape(tf.size)
        n = inc.shape[-1]

        def rows(value: AnyArray | float) -> AnyArray:
            if isinstance(value, LongArray):
                return cast(AnyArray, value)
            return np.broadcast_to(np.asarray(value, dtype=float), (n,))

        return cls(
            t_s=rows(np.arange(n) * row_seconds if t_s is None else t_s),
            inc_rad=inc,
            tf_rad=tf,
            direction=rows(direction),
            temp_c=rows(temp_c),
            rotor_rate_radps=rows(rotor_rate_radps),
            rotor_accel_radps2=rows(rotor_accel_radps2),
            inc_rate_radps=rows(inc_rate_radps),
            vibration_rms_g=rows(vibration_rms_g),
            pose=np.arange(n) if pose is None else np.asarray(pose),
            vibration_x_rms_g=rows(vibration_x_rms_g),
            vibration_y_rms_g=rows(vibration_y_rms_g),
            vibration_z_rms_g=rows(vibration_z_rms_g),
            since_move_s=rows(since_move_s),
            stay_s=rows(stay_s),
            row_seconds=row_seconds,
            gravity_mps2=gravity_mps2,
            latitude_rad=latitude_rad,
            azimuth_rad=azimuth_rad,
            extra=dict(extra or {}),
        )

    @classmethod
    def from_columns(
        cls,
        columns: Mapping[str, AnyArray],
        *,
        gravity_mps2: float = STANDARD_GRAVITY_MPS2,
        latitude_rad: float = 0.0,
        azimuth_rad: float = 0.0,
    ) -> Self:
        """The state that a recording tells, from its columns (N,) by their names in the Recording format, in degrees.

        Needs `inc_ref_deg` and `tf_ref_deg` (or `rotor_deg`, which yields to it). Rows without a `pose` column are
        continuous motion: the toolface is then unwrapped, and rates that are not recorded are its differences.
        Raises InputError that names the column that is lacking.
        """
        lacking = [name for name in ("t_s", "inc_ref_deg") if name not in columns]
        if "tf_ref_deg" not in columns and "rotor_deg" not in columns:
            lacking.append("tf_ref_deg (or rotor_deg)")
        if lacking:
            raise InputError(f"lacks the column{'s' if len(lacking) > 1 else ''} {', '.join(lacking)}")
        t_s = columns["t_s"] if is_long(columns["t_s"]) else np.asarray(columns["t_s"], dtype=float)
        toolface = "tf_ref_deg" if "tf_ref_deg" in columns else "rotor_deg"
        inc, tf = np.radians(columns["inc_ref_deg"]), np.radians(columns[toolface])
        moves = "pose" not in columns and t_s.size > 1
        still = np.broadcast_to(0.0, (t_s.size,))
        if moves:
            tf = unwrapped(tf, t_s)
        if "rotor_rate_dps" in columns:
            rate = np.radians(columns["rotor_rate_dps"])
        else:
            rate = slopes(tf, t_s) if moves else still
        pose_number = np.nan_to_num(np.asarray(columns["pose"], dtype=float), nan=-1.0) if "pose" in columns else None
        nowhere = np.broadcast_to(np.int64(0), (t_s.size,))
        pose = nowhere if pose_number is None else pose_number.astype(np.int64)
        return cls.build(
            inc,
            tf,
            t_s=t_s,
            direction=columns.get("direction", np.where(rate < 0, -1.0, 1.0) if np.any(rate) else approached_from(tf)),
            temp_c=columns.get("temp_c", 25.0),
            rotor_rate_radps=rate,
            rotor_accel_radps2=slopes(rate, t_s) if moves else still,
            inc_rate_radps=slopes(inc, t_s) if moves else still,
            vibration_rms_g=columns.get("vibration_rms_g", 0.0),
            vibration_x_rms_g=columns.get("vibration_x_rms_g", 0.0),
            vibration_y_rms_g=columns.get("vibration_y_rms_g", 0.0),
            vibration_z_rms_g=columns.get("vibration_z_rms_g", 0.0),
            since_move_s=still if pose_number is None else since_stop(t_s, pose),
            pose=pose,
            row_seconds=float(np.median(differences(t_s))) if t_s.size > 1 else 1.0,
            gravity_mps2=gravity_mps2,
            latitude_rad=latitude_rad,
            azimuth_rad=azimuth_rad,
            extra={name: values for name, values in columns.items() if name not in KNOWN_COLUMNS},
        )

    @cached_property
    def reading(self) -> AnyArray:
        """What the bench's encoders say, as I, E, T: (3, N) rad."""
        return np.stack([self.inc_rad, np.zeros(self.n), self.tf_rad])

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.t_s.size

    @cached_property
    def inclination_station(self) -> Ints:
        """(N,) number of the inclination station of a row: commanded inclinations that agree to 0.001 deg."""
        return np.unique(np.round(np.degrees(self.inc_rad), 3), return_inverse=True)[1].reshape(-1)

    @cached_property
    def toolface_station(self) -> Ints:
        """(N,) number of the toolface station of a row: encoder readings modulo a turn that agree to 0.001 deg."""
        turn = np.round(np.mod(np.degrees(self.tf_rad), 360.0), 3) % 360.0
        return np.unique(turn, return_inverse=True)[1].reshape(-1)

    @cached_property
    def temp_rate_cps(self) -> AnyArray:
        """(N,) dT/dt in C/s of the recorded temperature."""
        return np.gradient(self.temp_c, self.t_s) if self.n > 1 else np.zeros(self.n)

    def shifted(self, dt_s: AnyArray | float) -> ChainState:
        """The same rows sampled `dt_s` later, by the recorded rates and angular acceleration of the rotor."""
        dt = np.broadcast_to(np.asarray(dt_s, dtype=float), (self.n,))
        return replace(
            self,
            tf_rad=self.tf_rad + self.rotor_rate_radps * dt + 0.5 * self.rotor_accel_radps2 * dt**2,
            inc_rad=self.inc_rad + self.inc_rate_radps * dt,
            rotor_rate_radps=self.rotor_rate_radps + self.rotor_accel_radps2 * dt,
        )

    def rows(self, index: AnyArray | slice) -> ChainState:
        """A selection of rows, by an index or a mask; the averaging time and the place stay."""
        return replace(
            self,
            **{
                name: getattr(self, name)[index]
                for name in (
                    "t_s",
                    "inc_rad",
                    "tf_rad",
                    "direction",
                    "temp_c",
                    "rotor_rate_radps",
                    "rotor_accel_radps2",
                    "inc_rate_radps",
                    "vibration_rms_g",
                    "pose",
                    "vibration_x_rms_g",
                    "vibration_y_rms_g",
                    "vibration_z_rms_g",
                    "since_move_s",
                    "stay_s",
                )
            },
            extra={name: values[index] for name, values in self.extra.items()},
        )


LONG_GAP = 1.5
"""usual spacings from which rows are missing between two: healthy clocks jitter by less"""


SET_ANEW_RAD = np.radians(1e-3)
"""change of a toolface from which it was set anew: settings are written down to hundredths of a degree"""


def approached_from(tf_rad: AnyArray) -> AnyArray:
    """(N,) +1 where a toolface was set from below, -1 from above, by the last one that differed; +1 before any did. A
    table that is turned by hand or by a drive goes from one angle to the next, and not over its zero."""
    change = np.diff(tf_rad, prepend=tf_rad[:1])
    moved = np.abs(change) > SET_ANEW_RAD
    last = np.maximum.accumulate(np.where(moved, np.arange(tf_rad.size), 0))
    return np.where(moved[last] & (change[last] < 0), -1.0, 1.0)


def _gaps(t_s: AnyArray) -> NDArray[np.bool_]:
    """(N - 1,) whether rows are missing between two neighbours."""
    steps = np.diff(t_s)
    return np.asarray(steps > LONG_GAP * np.median(steps))


def differences(values: AnyArray) -> AnyArray:
    """(N - 1,) from each row to the next."""
    if not is_long(values):
        return np.diff(values)
    n = values.shape[-1]
    return by_runs(values, (n - 1,), lambda part: np.diff(values[part.start : part.stop + 1]))


def unwrapped(angle_rad: AnyArray, t_s: AnyArray) -> AnyArray:
    """(N,) an angle without its turns; where rows are missing it goes on at the mean of the rates on both sides."""
    return stored(angle_rad, angle_rad.shape, _unwrapped_runs(angle_rad, t_s))


def _unwrapped_runs(angle_rad: AnyArray, t_s: AnyArray) -> Iterator[AnyArray]:
    """Runs of an angle, with the turns counted: whole numbers, so that no rounding adds up."""
    n = t_s.shape[-1]
    usual = float(np.median(differences(t_s))) if n > 1 else 0.0
    turns, rate = 0.0, np.empty(0)
    for part in runs_of(n):
        rows = slice(max(part.start - 1, 0), part.stop)
        angle, seconds = angle_rad[rows], np.diff(t_s[rows])
        change = np.diff(angle)
        wrapped = _shortest(change)
        lost = seconds > LONG_GAP * usual
        if lost.any() and not (lost.all() and n == part.stop - part.start):
            after = slice(part.stop - 1, min(part.stop + 1, n))
            behind = _shortest(np.diff(angle_rad[after])) / np.diff(t_s[after])
            wrapped[lost] = _at_mean_rate(change, seconds, lost, (rate, wrapped / seconds, behind))
        whole = turns + np.cumsum(np.round((wrapped - change) / (2 * np.pi)))
        if part.start == 0:
            whole = np.append(0.0, whole)
            angle = np.append(angle[:1], angle)
        known = np.flatnonzero(~lost)
        rate = wrapped[known[-1:]] / seconds[known[-1:]] if known.size else rate
        turns = float(whole[-1]) if whole.size else turns
        yield angle[1:] + 2 * np.pi * whole


def _shortest(change: AnyArray) -> AnyArray:
    """A change of an angle without whole turns."""
    return np.asarray(np.mod(change + np.pi, 2 * np.pi) - np.pi)


def _at_mean_rate(
    change: AnyArray, seconds: AnyArray, lost: NDArray[np.bool_], rates: tuple[AnyArray, AnyArray, AnyArray]
) -> AnyArray:
    """Changes over the steps in which rows are missing, at the mean of the rates of the steps beside: of those before
    the run, in the run and behind it."""
    before, own, behind = rates
    every = np.concatenate([before, own, behind])
    known = np.flatnonzero(~np.concatenate([np.zeros(before.size, bool), lost, np.zeros(behind.size, bool)]))
    if not known.size:
        return _shortest(change[lost])
    place = np.searchsorted(known, np.flatnonzero(lost) + before.size)
    sides = known[np.maximum(place - 1, 0)], known[np.minimum(place, known.size - 1)]
    about = (every[sides[0]] + every[sides[1]]) / 2 * seconds[lost]
    return np.asarray(about + _shortest(change[lost] - about))


def slopes(values: AnyArray, t_s: AnyArray) -> AnyArray:
    """(N,) derivative by time: central differences, beside missing rows those of the side that is there."""
    if is_long(t_s):
        usual = float(np.median(differences(t_s)))

        def of(part: slice) -> AnyArray:
            rows = slice(max(part.start - 2, 0), min(part.stop + 2, t_s.shape[-1]))
            times = t_s[rows]
            found = _slopes(values[rows], times, np.diff(times) > LONG_GAP * usual)
            return found[part.start - rows.start : part.stop - rows.start]

        return by_runs(t_s, t_s.shape, of)
    return _slopes(values, t_s, _gaps(t_s))


def _slopes(values: AnyArray, t_s: AnyArray, gaps: NDArray[np.bool_]) -> AnyArray:
    """Of rows of which some are missing at `gaps` (N - 1,)."""
    found = np.gradient(values, t_s)
    if gaps.any():
        each = np.diff(values) / np.diff(t_s)
        before, behind = gaps[1:] & ~gaps[:-1], gaps[:-1] & ~gaps[1:]
        found[1:-1] = np.where(before, each[:-1], np.where(behind, each[1:], found[1:-1]))
    return np.asarray(found)


def since_stop(t_s: AnyArray, pose: Ints) -> AnyArray:
    """(N,) s since the first row of the pose that each row belongs to."""
    new = np.concatenate([[True], np.diff(pose) != 0]) if t_s.size else np.zeros(0, dtype=bool)
    return np.asarray(t_s - t_s[np.flatnonzero(new)][np.cumsum(new) - 1])
