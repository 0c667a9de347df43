"""What the drift stage keeps across a restart, as a file: one JSON object, replaced whole, checked when it is read.

Its age is determined as `clock` says; where no clock can tell, nothing of it is taken up. Whether the tool was switched
off meanwhile is known from the tool's own time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from highside.errors import InputError, Refused
from highside.gyro.gates import StillStatistics
from highside.reading import parse_json, read_document
from highside.recording.files import write_whole
from highside.service import clock
from highside.service.strict import Strict

SAVED = {"q": 4, "bias": 3, "scale": 1, "accel_bias": 3, "P": 100, "psi0": 1, "stop": 5, "tally": 10}
"""parts of the filter's state that are kept, and how many numbers each has (P by rows)"""


class HeadingAlignment(Strict):
    """When and how the azimuth was given."""

    azimuth_deg: Annotated[float, Field(ge=0, le=360)]
    std_deg: Annotated[float, Field(ge=0)]
    by: Literal["configuration", "command"]
    t: float | None = Field(description="UTC, seconds since 1970; null: not known.")


class Stamp(Strict):
    """When something was kept, by three clocks: a `clock.Moment` as it stands in a file."""

    wall_s: float
    synced: bool
    boot_id: str
    boot_s: float

    @classmethod
    def now(cls, *, synced: bool) -> Self:
        """The host's clocks."""
        return cls.model_validate(clock.now(synced=synced)._asdict())

    def age_s(self, now: Stamp) -> float | None:
        """Seconds from this to `now`; None where no clock can tell."""
        return clock.age_s(self, now)


class SavedDrift(Strict):
    """What a drift stage knew."""

    latitude_deg: float | None
    t_device_s: float
    motion: Annotated[int, Field(ge=0, le=3)]
    memory: dict[str, list[float]]
    """the filter's, body frame"""
    still: list[float] | None
    """the tool at rest: norm std, norm error, rate std, rate (3)"""
    alignment: HeadingAlignment | None
    azi_deg: float
    azi_std_deg: float
    constrained: bool
    saturated: bool
    repowered: bool = False
    age_s: float | None = None

    @field_validator("memory")
    @classmethod
    def _without_scratch(cls, memory: dict[str, list[float]]) -> dict[str, list[float]]:
        # older files hold the filter's scratch space too
        return {name: values for name, values in memory.items() if name != "work"}

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if {name: len(values) for name, values in self.memory.items()} != SAVED:
            raise ValueError("the filter's memory has another shape")
        P = np.array(self.memory["P"]).reshape(10, 10)
        if not np.allclose(P, P.T, rtol=1e-6, atol=1e-300) or (np.diag(P) < 0.0).any():
            raise ValueError("the covariance is none")
        if abs(float(np.linalg.norm(self.memory["q"])) - 1.0) > 1e-6:
            raise ValueError("the attitude is none")
        if self.still is not None and (len(self.still) != 6 or min(self.still[0], self.still[2]) < 0.0):
            raise ValueError("the still record has another shape")
        return self

    def still_statistics(self) -> StillStatistics | None:
        """For the gate."""
        if self.still is None:
            return None
        return StillStatistics(self.still[0], self.still[1], self.still[2], np.array(self.still[3:]))


class DriftFile(Strict):
    """The file."""

    format: Literal["highside.drift/1"] = "highside.drift/1"
    tool: str
    stamp: Stamp
    state: SavedDrift


def write(path: Path, tool: str, stamp: Stamp, state: SavedDrift) -> None:
    """Replace the file. Raises InputError where it cannot be written."""
    write_whole(path, DriftFile(tool=tool, stamp=stamp, state=state).model_dump_json().encode())


def read(path: Path, tool: str, now: Stamp) -> SavedDrift | None:
    """What is on disk, with its age; None where there is nothing. Raises Refused: damaged, or of another tool."""
    if not path.exists():
        return None
    try:
        file = DriftFile.model_validate(parse_json(read_document(path)))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise Refused(f"{path}: is no saved drift state: {field}: {first['msg']}; align anew") from None
    except InputError as error:
        raise Refused(f"{path}: is no saved drift state: {error.what}; align anew") from None
    if file.tool != tool:
        raise Refused(f"{path}: is of the tool {file.tool!r}; align anew")
    return file.state.model_copy(update={"age_s": file.stamp.age_s(now)})
