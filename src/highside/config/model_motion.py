"""The table `[motion]` of the model file: how the tool of a simulation is moved, by `kind`.

What a kind means in poses and rows is a plan of `physics.plan`; the tables are the ways to write one down. They are not
the plans: inclinations times toolfaces, single poses, full turns, rates in Hz or deg/s all become the same few plans.
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, Field, model_validator

from highside.physics.motion import Leg
from highside.physics.plan import LegPlan, Plan, Pose, PosePlan, Profile, RotationPlan, full_turns, station_poses
from highside.reading.config_table import ConfigTable

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Inclination = Annotated[float, Field(ge=-180, le=180)]


class _Motion(ConfigTable):
    """What all kinds of motion have."""

    temperatures_c: tuple[Finite, ...] = Field(default=(), description="Temperatures, joined by straight lines.")
    temperature_times_s: tuple[Finite, ...] = Field(default=(), description="Their times; evenly spread where absent.")
    gyros: bool = Field(default=False, description="Write gyro channels even if no effect of gyros is included.")

    @model_validator(mode="after")
    def _profile(self) -> Self:
        times = self.temperature_times_s
        if times and len(times) != len(self.temperatures_c):
            raise ValueError("temperature_times_s and temperatures_c must have the same length")
        if any(later <= earlier for earlier, later in itertools.pairwise(times)):
            raise ValueError("temperature_times_s must rise")
        return self

    @property
    def temperature(self) -> Profile | None:
        return Profile(self.temperatures_c, self.temperature_times_s) if self.temperatures_c else None

    @property
    def vibration(self) -> Profile | None:
        return None


class _StoppedMotion(_Motion):
    hold_s: Positive = Field(default=10.0, description="How long a pose is held.")
    row_s: Positive = Field(default=1.0, description="Averaging time of one row.")
    move_s: Annotated[float, Field(ge=0)] = Field(default=20.0, description="Time to reach a pose.")
    record_moves: bool = Field(default=False, description="Also write the rows on the way from pose to pose.")
    plateaus_c: tuple[Finite, ...] = Field(default=(), description="Repeat the whole session at each temperature.")
    soak_s: Annotated[float, Field(ge=0)] = Field(default=3600.0, description="Time for the oven to change.")
    vibration_rms_g: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        default=(), description="Spread evenly over time."
    )

    @property
    def vibration(self) -> Profile | None:
        return Profile(self.vibration_rms_g) if self.vibration_rms_g else None

    def _plan(self, poses: tuple[Pose, ...], hold_s: float) -> PosePlan:
        return PosePlan(poses, hold_s, self.row_s, self.move_s, self.record_moves, self.plateaus_c, self.soak_s)


class PosesMotion(_StoppedMotion):
    """A stepped session: inclinations times toolfaces and single poses."""

    kind: Literal["poses"]
    inclinations_deg: tuple[Inclination, ...] = ()
    toolfaces_deg: tuple[Finite, ...] = ()
    poses: tuple[tuple[Inclination, Finite] | tuple[Inclination, Finite, Literal[-1, 1]], ...] = Field(
        default=(), description="Further poses [inclination, toolface] or [inclination, toolface, direction]."
    )
    returns: bool = Field(default=False, description="Each inclination a second time backwards, from the other side.")
    closure_every: int = Field(default=0, ge=0, description="Return to the first pose after so many poses; 0: never.")

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if bool(self.inclinations_deg) != bool(self.toolfaces_deg):
            raise ValueError("inclinations_deg and toolfaces_deg go together: give both or none")
        if not self.inclinations_deg and not self.poses:
            raise ValueError("has no poses: give inclinations_deg and toolfaces_deg, or poses")
        return self

    def plan(self) -> Plan:
        at_stations = (
            station_poses(
                self.inclinations_deg, self.toolfaces_deg, returns=self.returns, closure_every=self.closure_every
            )
            if self.inclinations_deg
            else ()
        )
        return self._plan((*at_stations, *(Pose(*pose) for pose in self.poses)), self.hold_s)


class TurnsMotion(_StoppedMotion):
    """Full turns: stations from 0 to 360 deg inclusive at each inclination, some readings at each."""

    kind: Literal["turns"]
    inclinations_deg: Annotated[tuple[Inclination, ...], Field(min_length=1)]
    stations: int = Field(default=73, ge=2)
    readings: int = Field(default=4, ge=1)

    def plan(self) -> Plan:
        return self._plan(full_turns(self.inclinations_deg, self.stations), self.readings * self.row_s)


class RotationMotion(_Motion):
    """Continuous rotation at one inclination, in steps of the rate."""

    kind: Literal["rotation"]
    inclination_deg: Inclination = 60.0
    toolface_deg: Finite = 0.0
    rates_hz: tuple[Finite, ...] = ()
    rates_dps: tuple[Finite, ...] = ()
    hold_s: Positive = 20.0
    ramp_s: Annotated[float, Field(ge=0)] = 2.0
    sample_hz: Positive = 50.0
    vibration_rms_g: tuple[Annotated[float, Field(ge=0)], ...] = Field(default=(), description="One for each rate.")

    @model_validator(mode="after")
    def _rates(self) -> Self:
        if bool(self.rates_hz) == bool(self.rates_dps):
            raise ValueError("give either rates_hz or rates_dps")
        if len(self.vibration_rms_g) not in (0, 1, len(self.rates_hz or self.rates_dps)):
            raise ValueError("vibration_rms_g needs one value, or one for each rate")
        return self

    def plan(self) -> Plan:
        rates = [2 * math.pi * rate for rate in self.rates_hz] or [math.radians(rate) for rate in self.rates_dps]
        return RotationPlan(
            self.inclination_deg,
            tuple(rates),
            self.hold_s,
            self.ramp_s,
            self.sample_hz,
            self.toolface_deg,
            self.vibration_rms_g,
        )


class LegsMotion(_Motion):
    """A programme of legs: standing, turning, inclining, shaking."""

    kind: Literal["legs"]
    legs: Annotated[tuple[Leg, ...], Field(min_length=1)]
    inclination_deg: Annotated[float, Field(ge=0, le=180)] = 5.0
    toolface_deg: Finite = 0.0
    sample_hz: Positive = 50.0

    def plan(self) -> Plan:
        return LegPlan(self.legs, self.inclination_deg, self.toolface_deg, self.sample_hz)


KINDS: dict[str, type[BaseModel]] = {
    "poses": PosesMotion,
    "turns": TurnsMotion,
    "rotation": RotationMotion,
    "legs": LegsMotion,
}
Motion = Annotated[PosesMotion | TurnsMotion | RotationMotion | LegsMotion, Field(discriminator="kind")]
