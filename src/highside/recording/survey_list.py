"""A survey list: the accepted surveys of a tool by measured depth, with positions by minimum curvature.

A tool of accelerometers knows inclination and toolface; measured depth and azimuth come from elsewhere: from members of
the kept surveys (`md_m`, `azi_deg` of a tool with gyros) or from a table beside, joined by the survey's number (`seq`),
by time (`t`, UTC epoch seconds, at most `NEAREST_S` apart) or, azimuths, by measured depth (at most `NEAREST_M`).
Nothing is interpolated: where the join finds nothing, nothing is known. Positions are given only where every azimuth
is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.recording.kept_surveys import KeptSurvey, KeptSurveys
from highside.recording.table import Table

__all__ = ["SurveyList", "list_of", "minimum_curvature"]

NEAREST_S = 120.0
"""between a survey and a row of a table: the tool stands still for a survey of some ten seconds and for the connection
around it"""
NEAREST_M = 0.5
"""of measured depth between a survey and an azimuth of another tool"""
SAME_DEPTH_M = 0.1
"""surveys closer than this are of one depth: the last one counts"""
POSITIONS = ("tvd_m", "north_m", "east_m")
EXTRA = "positions need welleng, which is not installed"


class JoinTable(Table):
    """Rows with `md_m` or `azi_deg`, and what joins them to surveys."""

    known: ClassVar[tuple[str, ...]] = ("seq", "t", "md_m", "azi_deg", "azi_std_deg")
    rows_are: ClassVar[str] = "rows"


class SurveyList(Table):
    """A row a station, by measured depth: `md_m, inc_deg, azi_deg, tf_deg, tvd_m, north_m, east_m, ...`.

    `azi_deg` is NaN where it is not known; the positions (from the first station, m) are absent unless it is known
    everywhere. `cal_id` is text."""

    mandatory: ClassVar[tuple[str, ...]] = ("md_m", "inc_deg")
    known: ClassVar[tuple[str, ...]] = (
        "md_m",
        "inc_deg",
        "azi_deg",
        "tf_deg",
        "tvd_m",
        "north_m",
        "east_m",
        "dls_deg_30m",
        "inc_std_deg",
        "azi_std_deg",
        "tf_std_deg",
        "g_total",
        "temp_c",
        "t",
        "seq",
    )
    rows_are: ClassVar[str] = "stations"


@dataclass(frozen=True, slots=True)
class Listed:
    """A survey list, and how many surveys are not in it, by reason."""

    table: SurveyList
    left_out: dict[str, int]
    notes: tuple[str, ...]


def list_of(kept: KeptSurveys, depths: Path | None, azimuths: Path | None, *, sensor_offset_m: float = 0.0) -> Listed:
    """The list. `sensor_offset_m`: how far the sensor is behind the depth that the table gives (the bit's).

    Raises InputError for a table without what joins it, and where no survey has a depth."""
    # what a file holds beside surveys is lost to every list that is made of it
    left: Counter[str] = Counter()
    for reason, count in (("no survey", kept.damaged_lines), ("repeats a survey", kept.repeated)):
        if count:
            left[reason] = count
    stations: list[tuple[float, float, float, KeptSurvey]] = []
    md_of = None if depths is None else _Join(depths, "md_m", ("seq", "t"))
    azi_of = None if azimuths is None else _Join(azimuths, "azi_deg", ("seq", "t", "md_m"))
    for one in kept.surveys:
        if not one.accepted or one.inc_deg is None:
            left["refused"] += 1
            continue
        md = one.md_m if md_of is None else md_of.value(one, None)
        if md is None:
            left["no measured depth"] += 1
            continue
        md -= sensor_offset_m if md_of is not None else 0.0
        if azi_of is None:
            azi, azi_std = one.azi_deg, one.azi_std_deg
        else:
            azi, azi_std = azi_of.value(one, md), azi_of.beside(one, md, "azi_std_deg")
        stations.append((md, _or_nan(azi), _or_nan(azi_std), one))
    if not stations:
        raise InputError(
            f"no survey has a measured depth ({left['no measured depth']} without, {left['refused']} refused)",
            where=kept.source if depths is None else str(depths),
            remedy="give a table with md_m and seq or t (UTC epoch seconds) of the surveys as depths=",
        )
    stations.sort(key=lambda row: row[0])
    rows = [row for row, after in zip(stations, [*stations[1:], None], strict=True) if _counts(row, after, left)]
    return _listed(rows, dict(left), azimuths)


def _counts(
    row: tuple[float, float, float, KeptSurvey],
    after: tuple[float, float, float, KeptSurvey] | None,
    left: Counter[str],
) -> bool:
    if after is None or after[0] - row[0] >= SAME_DEPTH_M:
        return True
    left["another survey at the same depth"] += 1
    return False


def _listed(
    rows: Sequence[tuple[float, float, float, KeptSurvey]], left: dict[str, int], azimuths: Path | None
) -> Listed:
    md, azi, azi_std = (np.array([row[k] for row in rows]) for k in range(3))
    surveys = [row[3] for row in rows]

    def column(name: str) -> Array:
        return np.array([_or_nan(getattr(one, name)) for one in surveys])

    columns = {"md_m": md, "inc_deg": column("inc_deg"), "azi_deg": azi, "tf_deg": column("tf_deg")}
    notes = []
    without = int(np.isnan(azi).sum())
    if without:
        where = "in the kept surveys" if azimuths is None else f"in {azimuths.name}"
        notes.append(
            f"azimuth is not known at {without} of {len(rows)} stations ({where}): no positions; an inclinometer does"
            " not measure it, give those of a gyro or another survey tool as azimuths="
        )
    else:
        north, east, tvd, dls = minimum_curvature(md, columns["inc_deg"], azi)
        columns |= {"tvd_m": tvd, "north_m": north, "east_m": east, "dls_deg_30m": dls}
    columns |= {"inc_std_deg": column("inc_std_deg"), "azi_std_deg": azi_std, "tf_std_deg": column("tf_std_deg")}
    columns |= {name: column(name) for name in ("g_total", "temp_c", "t", "seq")}
    table = SurveyList(columns, {"cal_id": tuple(one.cal_id for one in surveys)})
    return Listed(table, left, tuple(notes))


def minimum_curvature(md_m: Array, inc_deg: Array, azi_deg: Array) -> tuple[Array, Array, Array, Array]:
    """North, east and true vertical depth, m, from the first station, and dogleg severity, deg/30 m; (N,) each, by
    welleng. Raises InputError where it is not installed."""
    try:
        from welleng.utils import MinCurve
    except ImportError:
        raise InputError(EXTRA, remedy="pip install 'highside[survey]'") from None
    inc, azi = np.radians(inc_deg), np.radians(azi_deg)
    if md_m.size == 1:
        zero = np.zeros(1)
        return zero, zero, zero, zero
    north, east, tvd = np.asarray(MinCurve(md_m, inc, azi, frame="nev").poss, dtype=np.float64).T
    turned = np.cos(np.diff(inc)) - np.sin(inc[1:]) * np.sin(inc[:-1]) * (1.0 - np.cos(np.diff(azi)))
    dls = np.degrees(np.arccos(np.clip(turned, -1.0, 1.0))) / np.diff(md_m) * 30.0
    return north, east, tvd, np.concatenate([[0.0], dls])


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else float(value)


class _Join:
    """A table beside the surveys, looked up by the first of some keys that it has."""

    def __init__(self, path: Path, name: str, keys: Sequence[str]) -> None:
        self._table = JoinTable.read(path)
        (self._values,) = self._table.require(name)
        self._key = next((key for key in keys if self._table.has(key)), "")
        if not self._key:
            raise InputError(
                f"has none of the columns that join it to surveys ({', '.join(keys)})",
                where=str(path),
                remedy="add seq (number of the survey) or t (UTC, seconds since 1970)",
            )
        self._keys = self._table[self._key]

    def _row(self, survey: KeptSurvey, md_m: float | None) -> int | None:
        at = {"seq": survey.seq, "t": survey.t, "md_m": md_m}[self._key]
        if at is None or not np.isfinite(self._keys).any():
            return None
        row = int(np.nanargmin(np.abs(self._keys - at)))
        most = {"seq": 0.0, "t": NEAREST_S, "md_m": NEAREST_M}[self._key]
        return row if abs(float(self._keys[row]) - at) <= most else None

    def value(self, survey: KeptSurvey, md_m: float | None) -> float | None:
        """Of the row that belongs to a survey."""
        row = self._row(survey, md_m)
        return None if row is None or np.isnan(self._values[row]) else float(self._values[row])

    def beside(self, survey: KeptSurvey, md_m: float | None, name: str) -> float | None:
        """Of another column of the same row."""
        row = self._row(survey, md_m)
        return None if row is None or not self._table.has(name) else float(self._table[name][row])
