"""What the watch keeps across a restart, as a file: one JSON object, replaced whole, checked when it is read.

It belongs to one tool and one calibration record. Beside the state stands what is said, for
`highside watch propose`. Arrays are written as base64 of little-endian doubles: a state taken up goes on exactly.
"""

from __future__ import annotations

import binascii
import json
from base64 import b64decode, b64encode
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from highside.arrays import Array
from highside.errors import InputError, Refused
from highside.reading import parse_json, read_document
from highside.recording.files import write_whole
from highside.service.saved_drift import Stamp
from highside.service.strict import Strict
from highside.watch.memory import LAYOUT, TRACE_WIDTH, WatchMemory
from highside.watch.proposal import state_sha256

Count = Annotated[int, Field(ge=0)]
SPAN_S = 86_400.0
"""how far back the history of a picture goes, s"""
POINTS = 144
"""of it at most, evenly in time: one each ten minutes of a day, the shortest distance of two onsets. 40 KB as JSON"""

MOST_EARLIER = 12
"""calibrations before the one in force whose traces are kept: one each two hours of the last day"""


class Numbers(Strict):
    """An array of doubles."""

    shape: list[Count]
    data: str

    @classmethod
    def of(cls, values: Array) -> Numbers:
        """As it is written."""
        return cls(shape=list(values.shape), data=b64encode(values.astype("<f8").tobytes()).decode())

    def values(self) -> Array:
        """As it was. Raises ValueError."""
        try:
            found = np.frombuffer(b64decode(self.data, validate=True), dtype="<f8")
        except binascii.Error as error:
            raise ValueError(f"no base64: {error}") from None
        return found.astype(np.float64).reshape(self.shape)


LEAST_SCATTER_G = 1e-15
"""Scatter of readings at rest that a state may hold, beside none at all, g: the least that a double of 10 g resolves.
Source: of less the ratio to a later scatter may overflow, and no message can say it (fuzz of 2026-11-27)."""


class WatchFacts(Strict):
    """The members of `WatchMemory` that are no arrays."""

    start_s: float | None
    last_s: float
    onset_s: float | None
    depth_km: float | None
    deeper_km: float = 0.0
    ref_c: float | None
    warmer_c: float
    alarm_s: float | None
    at_rest: bool
    stills: Count
    turns: Count
    left_out: dict[str, Count]


class EarlierTrace(Strict):
    """What was seen under a calibration before the one in force, for a picture of the last day alone."""

    cal_id: str
    until_s: float
    """of the watch, when the next one began"""
    why: str
    """the next one began anew"""
    trace: Numbers

    def rows(self) -> Array:
        """(K, `TRACE_WIDTH`), as in `WatchMemory`. Raises ValueError."""
        rows = self.trace.values()
        if rows.ndim != 2 or rows.shape[1] != TRACE_WIDTH or not np.isfinite(rows).all():
            raise ValueError("an earlier trace is none")
        if (np.diff(rows[:, 0]) < 0.0).any() or (rows[:, 0] > self.until_s).any():
            raise ValueError("an earlier trace is not in the order of time")
        return rows


class SavedWatch(Strict):
    """What a watch knew. Times in s of the watch."""

    cal_id: str
    layout: str
    gravity: float
    """in units of the corrected readings"""
    t_s: Annotated[float, Field(ge=0, le=1e10)]
    t_device_s: float | None
    calmest_g: Annotated[float, Field(ge=0)] | None
    calmest_s: float
    acknowledged: list[str]
    """the claims, by their key"""
    facts: WatchFacts
    arrays: dict[str, Numbers]
    earlier: list[EarlierTrace] = Field(default_factory=list)
    age_s: float | None = None

    def memory(self) -> WatchMemory:
        """For `Watch.recall`. Raises ValueError."""
        if self.layout != LAYOUT:
            raise ValueError("it is of another version, with other parameters")
        if self.facts.last_s > self.t_s or (self.facts.onset_s or 0.0) > self.t_s:
            raise ValueError("it goes on after its own time")
        arrays = {name: one.values() for name, one in self.arrays.items()}
        for name in ("noise_rests", "noise_changed"):
            values = arrays.get(name, np.zeros((0, 1)))
            if values.ndim != 2:
                raise ValueError(f"{name} has another shape")
            if ((values[:, 1:] > 0.0) & (values[:, 1:] < LEAST_SCATTER_G)).any():
                raise ValueError(f"{name}: a scatter is beyond reason")
        return WatchMemory(arrays, **self.facts.model_dump())


def facts_of(memory: WatchMemory) -> WatchFacts:
    """The part of a memory that is no array."""
    return WatchFacts(
        **{name: getattr(memory, name) for name in WatchFacts.model_fields if name != "left_out"},
        left_out=dict(memory.left_out),
    )


def last_of_each(t_s: Array, now_s: float) -> NDArray[np.intp]:
    """Which of the times (K,) of a trace a picture shows: of the last day the last in each of `POINTS` intervals."""
    # of the watch's own time, so that what was said once does not move
    bins = np.floor(t_s / (SPAN_S / POINTS))
    last = np.append(np.diff(bins) > 0.0, True)[: bins.size]
    return np.flatnonzero(last & (t_s >= now_s - SPAN_S))[-POINTS:]


def earlier_traces(before: SavedWatch, why: str) -> tuple[EarlierTrace, ...]:
    """What a watch that begins anew keeps of the one `before` it: what a picture of the last day shows. Nothing of a
    state that is none."""
    try:
        rows = before.memory().arrays["trace"]
        mine = EarlierTrace(
            cal_id=before.cal_id,
            until_s=before.t_s,
            why=why,
            trace=Numbers.of(rows[last_of_each(rows[:, 0], before.t_s)]),
        )
        found = [*before.earlier, mine]
        return tuple(one for one in found if last_of_each(one.rows()[:, 0], before.t_s).size)[-MOST_EARLIER:]
    except (ValueError, KeyError, IndexError):
        return ()


class WatchFile(Strict):
    """The file."""

    format: Literal["highside.watch-state/1"] = "highside.watch-state/1"
    tool: str
    stamp: Stamp
    said: dict[str, Any]
    """as `watch.json` has it"""
    state: SavedWatch
    sha256: str | None = None
    """`state_sha256`; a file of an earlier version has none"""


def write(path: Path, tool: str, stamp: Stamp, said: dict[str, Any], state: SavedWatch) -> None:
    """Replace the file. Raises InputError where it cannot be written."""
    file = parse_json(WatchFile(tool=tool, stamp=stamp, said=said, state=state).model_dump_json().encode())
    write_whole(path, json.dumps(file | {"sha256": state_sha256(file)}).encode())


def read(path: Path, tool: str, now: Stamp) -> SavedWatch | None:
    """What is on disk, with its age; None where there is nothing. Raises Refused: damaged, or of another tool."""
    if not path.exists():
        return None
    try:
        value = parse_json(read_document(path))
        file = WatchFile.model_validate(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise Refused(f"{path}: is no saved watch: {field}: {first['msg']}") from None
    except InputError as error:
        raise Refused(f"{path}: is no saved watch: {error.what}") from None
    if file.sha256 not in (None, state_sha256(value)):
        raise Refused(f"{path}: is no saved watch: its content is not what was written")
    if file.tool != tool:
        raise Refused(f"{path}: is of the tool {file.tool!r}")
    return file.state.model_copy(update={"age_s": file.stamp.age_s(now)})
