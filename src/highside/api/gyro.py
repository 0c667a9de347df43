"""Drift: attitude, azimuth and gyro biases of a recording with gyros, and what the azimuth rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypedDict, TypeVar, Unpack, overload

import numpy as np

from highside.api.recording import Recording
from highside.arrays import Array
from highside.errors import InputError
from highside.gyro.checks import check_units, saturated_rows
from highside.gyro.filter import FilterSettings
from highside.gyro.filter import carried as settings_of_carried
from highside.gyro.follow import METHODS, FollowOptions, MethodName, PolicyName, columns_deg, follow
from highside.gyro.frames import DEG_PER_HOUR, DEG_PER_SQRT_HOUR
from highside.gyro.result import DriftResult
from highside.recording.frames import Columns, File, FrameT, take
from highside.recording.table import Recording as Rows
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot

__all__ = ["Drift", "drift"]

DataT = TypeVar("DataT")

SHORTEST_S = 2.0
"""A shorter recording is refused: the biases that drift is about show over minutes."""
GYROS = ("gx_dps", "gy_dps", "gz_dps")
LITERAL = ("literal", "literal_block")


@dataclass(frozen=True, slots=True)
class Drift(Generic[DataT]):
    """Attitude and gyro biases of N rows, and what the azimuth of them rests on."""

    data: DataT
    """In the kind that came in, N rows: `t_s, inc_deg, tf_deg, azi_deg, azi_std_deg, bias_x_dps, ..., bias_std_x_dps,
    ...` and, where the recording has them, `rotor_deg, rotor_rate_dps`. Missing where a method states none."""
    result: DriftResult
    """the same as arrays in radians, and the verdicts of the gates"""
    method: str
    notes: tuple[str, ...] = field(default=())
    """sentences on what was assumed, degraded or looks wrong"""

    @property
    def basis(self) -> str:
        """What the azimuth rests on, in words: gravity alone gives none to a tool that does not turn."""
        return self.result.basis_words

    def _repr_html_(self) -> str:
        """What a notebook shows: the end of the recording, the basis of the azimuth, the notes."""
        last = {name: column[-1] for name, column in columns_deg(self.result).items()}
        rows = [[name, f"{value:.6g}"] for name, value in last.items()]
        headline = f"Drift by {self.method}, {self.result.t_s.size} rows; azimuth from {self.basis}"
        return card(["at the end", ""], rows, *self.notes, title=headline)

    def plot(self) -> Plot:
        """Azimuth with its standard deviation, inclination, and the three gyro biases, over time."""
        columns = columns_deg(self.result)
        t, azimuth = columns["t_s"], np.unwrap(columns["azi_deg"], period=360.0)
        biases = tuple(
            PlotLine(f"g{axis}", columns[f"bias_{axis}_dps"] * 3600.0, columns[f"bias_std_{axis}_dps"] * 3600.0)
            for axis in "xyz"
        )
        return Plot(
            f"Drift by {self.method}; azimuth from {self.basis}",
            (
                PlotPanel(t, (PlotLine("azimuth", azimuth, columns["azi_std_deg"]),), "time, s", "azimuth, deg"),
                PlotPanel(t, (PlotLine("inclination", columns["inc_deg"]),), "time, s", "inclination, deg"),
                PlotPanel(t, biases, "time, s", "gyro bias, deg/h"),
            ),
        )


class DriftOptions(TypedDict, total=False):
    """What may be said to `drift` beside the recording and the method."""

    latitude_deg: float | None
    azimuth_deg: float | None
    azimuth_std_deg: float
    rest: Sequence[tuple[float, float]]
    azimuth_policy: PolicyName | None
    straight_hole: bool
    smooth: bool
    carried: bool
    gyro_arw: float
    gyro_rrw: float
    gyro_bias_std: float


@overload
def drift(recording: File, method: MethodName = ..., **options: Unpack[DriftOptions]) -> Drift[Recording]: ...
@overload
def drift(recording: Columns, method: MethodName = ..., **options: Unpack[DriftOptions]) -> Drift[dict[str, Array]]: ...
@overload
def drift(recording: FrameT, method: MethodName = ..., **options: Unpack[DriftOptions]) -> Drift[FrameT]: ...
def drift(
    recording: Any,
    method: MethodName = "kinematic",
    *,
    latitude_deg: float | None = None,
    azimuth_deg: float | None = None,
    azimuth_std_deg: float = 0.1,
    rest: Sequence[tuple[float, float]] = (),
    azimuth_policy: PolicyName | None = None,
    straight_hole: bool = False,
    smooth: bool = False,
    carried: bool = False,
    gyro_arw: float = 0.1,
    gyro_rrw: float = 0.1,
    gyro_bias_std: float = 20.0,
) -> Drift[Any]:
    """Follow the attitude by gyros and gravity.

    `recording` (a file, DataFrame, dict of arrays or Recording of N rows) needs `t_s` in s, `ax_g, ay_g, az_g` in g and
    `gx_dps, gy_dps, gz_dps` in deg/s. `method`: "kinematic" (an error-state filter with zero-rate updates; causal
    unless `smooth`), "recursive" (a Mahony complementary filter), "literal" and "literal_block" (the paper's equations;
    `azimuth_policy` "hold", "prev" or "gyro"), or "none" (the gyro alone). `latitude_deg` for the Earth's rotation;
    `azimuth_deg` and `azimuth_std_deg` at the start, clockwise from true north; `rest`: when the tool stood, pairs of s
    (else stops are detected); `straight_hole` asserts that the azimuth stays; `carried`: the sensor is moved by hand.
    `gyro_arw` is the angle random walk in deg/sqrt(h), `gyro_rrw` the rate random walk in deg/h/sqrt(h),
    `gyro_bias_std` the bias to be expected at power-up in deg/h. Raises InputError for a recording or an argument that
    is not in order.
    """
    _require_meaning(
        method, azimuth_policy=azimuth_policy is not None, straight_hole=straight_hole, smooth=smooth, carried=carried
    )
    taken = take(recording, Rows)
    table = taken.table
    t_s, rate, accel = _rows(table)
    for begin, end in rest:
        if end <= t_s[0] or begin >= t_s[-1]:
            raise InputError(
                f"{begin:g}-{end:g} lies outside of the recording ({t_s[0]:g} to {t_s[-1]:g} s)", field="rest"
            )
    settings = FilterSettings(
        latitude_rad=None if latitude_deg is None else math.radians(latitude_deg),
        azimuth_rad=None if azimuth_deg is None else math.radians(azimuth_deg),
        azimuth_std_rad=math.radians(azimuth_std_deg),
        arw=gyro_arw * DEG_PER_SQRT_HOUR,
        rrw=gyro_rrw * DEG_PER_HOUR / 60.0,
        bias_std_radps=gyro_bias_std * DEG_PER_HOUR,
    )
    doubts = check_units(t_s, rate, accel, table.source or "recording", arw=settings.arw)
    options = FollowOptions(np.array(rest, dtype=float).reshape(-1, 2), azimuth_policy, straight_hole, smooth)
    result = follow(method, t_s, rate, accel, settings_of_carried(settings) if carried else settings, options)
    # the rotor's angle goes along: `compensate` takes its error off the azimuth
    rotor = {name: table.columns[name] for name in ("rotor_deg", "rotor_rate_dps") if table.has(name)}
    notes = [*result.notes, *doubts]
    clipped = saturated_rows(rate)
    if clipped:
        notes.append(
            f"a gyro stands at its limit in {clipped} rows: turns beyond its range are lost, and the azimuth with them"
        )
    return Drift(taken.new(Recording(columns_deg(result) | rotor)), result, method, tuple(notes))


def _require_meaning(method: str, **given: bool) -> None:
    """Raises InputError for a method that is unknown, and for an argument that has no meaning with it."""
    if method not in METHODS:
        raise InputError(f"{method!r} is unknown", field="method", remedy=f"one of {', '.join(METHODS)}")
    allowed = {
        "azimuth_policy": LITERAL,
        "straight_hole": ("kinematic", "recursive"),
        "smooth": ("kinematic",),
        "carried": ("kinematic",),
    }
    for name, stated in given.items():
        if stated and method not in allowed[name]:
            raise InputError(f"has no meaning with the method {method}", field=name, remedy="leave it out")


def _rows(table: Rows) -> tuple[Array, Array, Array]:
    """Times (N,) s, rates (3, N) rad/s, accelerations (3, N) g. Raises InputError for rows that cannot be followed."""
    gyros = [name for name in GYROS if not table.has(name)]
    if gyros:
        raise InputError(
            f"lacks the gyro column{'s' if len(gyros) > 1 else ''} {', '.join(gyros)}",
            where=table.source,
            remedy="drift needs a tool with three gyros",
        )
    block = table.complete("t_s", "ax_g", "ay_g", "az_g", *GYROS)
    t_s, accel, rate = block[0], block[1:4], np.radians(block[4:7])
    backwards = np.flatnonzero(np.diff(t_s) <= 0.0)
    if backwards.size:
        raise InputError(
            "time does not increase", where=table.place(int(backwards[0]) + 1), field="t_s", remedy="sort the rows"
        )
    if t_s.size < 2 or t_s[-1] - t_s[0] < SHORTEST_S:
        raise InputError("is shorter than 2 s", where=table.source, remedy="drift shows over minutes")
    return t_s, rate, accel
