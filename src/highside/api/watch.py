"""Watch: whether a calibration still holds, from a recording of the hole alone."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from highside.api.calibration import Calibration
from highside.arrays import Array
from highside.calibration.applied import corrected_accel
from highside.calibration.record import verify
from highside.config.watch import WatchSettings
from highside.errors import InputError
from highside.recording.calibration_store import read_record
from highside.recording.files import write_folder
from highside.recording.frames import Columns, File, FrameT, source_of, take
from highside.recording.table import Recording
from highside.report.watch_page import error_words, headline, page_of
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot
from highside.version import __version__
from highside.watch import STATED, StatedNoise, Watch, WatchResult, prior_of_record
from highside.watch.proposal import propose, read_outcome
from highside.watch.rows import Rows, feed

__all__ = ["WatchedRecording", "proposal_of", "watch_recording"]

GYROS = ("gx_dps", "gy_dps", "gz_dps")
DEPTH = "tvd_m"
LARGEST_GRAVITY_ERROR = 0.02
"""of `gravity_g` from 1: beyond, it is not gravity in the units of the readings"""


@dataclass(frozen=True)
class WatchedRecording:
    """What a recording says of the calibration it was made under."""

    found: WatchResult
    source: str
    """name of the recording"""
    notes: tuple[str, ...] = ()
    tool: str | None = None
    """of the record; a recording does not say whose it is"""

    @property
    def verdict(self) -> str:
        """`holds`, `learning` or `departs`."""
        return self.found.verdict

    def to_dict(self) -> dict[str, Any]:
        """What goes into `watch.json`."""
        beside = {"recording": self.source, "tool": self.tool, "notes": list(self.notes), "version": __version__}
        return self.found.to_dict() | beside

    def html(self) -> str:
        """The report: one page that needs nothing beside it."""
        return page_of(self.found, self.source, self.notes, self.tool)

    def save(self, folder: File) -> None:
        """Write `watch.json` and `report.html`. Raises InputError for a folder that cannot be made."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        write_folder(Path(folder), {"watch.json": text, "report.html": self.html()})

    def proposal(self, calibration: Calibration | File) -> Calibration:
        """The record that would correct what departs, for a person to put in force; `calibration`: the one that was
        watched. Raises InputError where nothing is to be proposed: nothing departs, or the hole has not named it."""
        return proposal_of(json.dumps(self.to_dict()).encode(), calibration, where=self.source)

    def _repr_html_(self) -> str:
        """What a notebook shows: the verdict, the departures, and what to do."""
        rows = [
            [", ".join(claim.equivalence_class), error_words(claim.error), f"{claim.since_s:.0f}"]
            for claim in self.found.claims
        ]
        return card(["departs", "error", "since, s"], rows, *self.found.advice, title=headline(self.found))

    def plot(self) -> Plot:
        """Deviations of the offsets and of the scales from the calibration over time, with standard deviations."""
        trace, panels = self.found.trace, []
        names = list(self.found.parameters)
        for word, unit, shown in (("offset", "mg", ("b_x", "b_y", "b_z")), ("scale", "mg/g", ("S_xx", "S_yy", "S_zz"))):
            columns = [names.index(name) for name in shown]
            lines = tuple(
                PlotLine(name, 1e3 * trace.value[:, k], 1e3 * trace.std[:, k])
                for name, k in zip(shown, columns, strict=True)
            )
            panels.append(PlotPanel(trace.t_s / 3600.0, lines, "hours", f"{word}, {unit}"))
        return Plot("Deviation from the calibration", tuple(panels))


def watch_recording(
    recording: File | Columns | FrameT,
    calibration: Calibration | File,
    *,
    gravity_g: float = 1.0,
    repeat_g: float = STATED.repeat_g,
    random_walk_g: float = STATED.offset_random_walk,
    still_floor_g: float = STATED.still_floor_g,
    window_floor_g: float = STATED.window_floor_g,
    whirl_m: float = STATED.whirl_m,
    tool: str | None = None,
    serial: str | None = None,
) -> WatchedRecording:
    """Whether a calibration holds over a recording made in the hole (or anywhere, without a reference).

    `recording` (a file, DataFrame, dict of arrays or Recording of N rows): `t_s` in s and raw `ax_g, ay_g, az_g`;
    with `gx_dps, gy_dps, gz_dps` rotation is used too; `temp_c`, `vibration_rms_g` and `tvd_m` (true vertical depth)
    where they are. `calibration`: the record in force. `gravity_g`: of the site at the start, in the units of the
    readings (1 where they are in units of local g). An expired record is watched all the same.

    What the tool may do while its calibration holds, one standard deviation each, as in the table `[watch]` of the
    service; the defaults are a good quartz tool's: `repeat_g` of an offset from the bench to the hole, `random_walk_g`
    in g/sqrt(h) (of the elements of the matrix the same numbers), `still_floor_g` and `window_floor_g` of the mean at
    rest and of a harmonic while it turns, `whirl_m` of the collar in m. `tool`, `serial`: whose the recording is.
    Raises InputError for a recording, record or number that is not in order, RecordError for a record of another tool.
    """
    if not abs(gravity_g - 1.0) < LARGEST_GRAVITY_ERROR:
        raise InputError(
            f"{gravity_g:g} is not gravity in g", field="gravity_g", remedy="give local gravity / 9.80665, near 1"
        )
    record = calibration.record if isinstance(calibration, Calibration) else read_record(Path(calibration))
    verify(record, tool_id=tool, serial=serial)
    may = _stated(
        repeat_g=repeat_g,
        random_walk_g=random_walk_g,
        still_floor_g=still_floor_g,
        window_floor_g=window_floor_g,
        whirl_m=whirl_m,
    )
    prior = prior_of_record(record, may)
    table = take(recording, Recording).table
    where = table.source or "recording"
    _in_order(table, where)
    temp = table.columns.get("temp_c")
    corrected = corrected_accel(record, table.accel(), temp, where=where, columns=table.columns) / gravity_g
    notes = []
    has_gyros = table.has(*GYROS)
    if not has_gyros:
        notes.append("no gyros were recorded: rotation is not used, rests alone say little")
    if temp is None:
        notes.append("no temperature was recorded: an offset that follows it is read as a drift or a step")
    watch = Watch(prior, record.id)
    rates = np.radians(np.vstack([table.columns[name] for name in GYROS])) if has_gyros else None
    feed(watch, Rows(table.t_s, corrected, rates, temp, table.columns.get(DEPTH), _vibration(table)))
    found = watch.result(float(table.t_s[-1]))
    return WatchedRecording(found, source_of(recording, table)[0], tuple(notes), record.tool_id)


def _stated(**given: float) -> StatedNoise:
    """What a tool may do, within the limits that the service's settings have. Raises InputError."""
    try:
        return WatchSettings(**given).noise(0.0)
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        raise InputError(
            f"{wrong['input']!r} is out of range", field=str(wrong["loc"][0]), remedy=wrong["msg"].lower()
        ) from None


def _in_order(table: Recording, where: str) -> None:
    """Raises InputError where time does not advance."""
    back = np.flatnonzero(np.diff(table.t_s) < 0)
    if back.size:
        raise InputError(
            "time goes back", where=table.place(int(back[0]) + 1), field="t_s", remedy="sort the rows by time"
        )
    if table.n < 2 or not float(np.median(np.diff(table.t_s))) > 0.0:
        raise InputError("time does not advance", where=where, field="t_s")


def _vibration(table: Recording) -> Array | None:
    return table.columns.get("vibration_rms_g")


def proposal_of(said: bytes, calibration: Calibration | File, *, where: str) -> Calibration:
    """The record that what a watch `said` (the bytes of its `watch.json`, or of the service's state) would have put in
    force. Raises InputError where nothing is to be proposed."""
    record = calibration.record if isinstance(calibration, Calibration) else read_record(Path(calibration))
    return Calibration(propose(record, read_outcome(said, where), now_s=time.time(), where=where))
