"""Where the tool is led in a simulated session: stops at poses, turns at steady rates with ramps, or a drilling leg.

A plan is turned into rows by `rows()`: the state of the chain at each row, and which rows belong to a stop. The angles
are what the bench commands and reads; what its imperfections make of them is the business of the effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from highside.arrays import AnyArray
from highside.physics.motion import Leg, Motion
from highside.physics.state import ChainState
from highside.units import STANDARD_GRAVITY_MPS2

PUBLISHED_INCLINATIONS_DEG = (0.612, 1.206, 1.998, 3.006, 5.004, 14.994, 30.006, 45.0, 59.994, 75.006, 90.0)
"""inclination stations of the tables of the balance-correction paper"""
BALANCE_TOOLFACES_DEG = (45.0, 135.0, 225.0, 315.0)
"""one toolface in each quadrant, as a balance correction needs them"""


class Pose(NamedTuple):
    """A stop. `direction` is the side from which the toolface is approached."""

    inclination_deg: float
    toolface_deg: float
    direction: float = 1.0


class SessionRows(NamedTuple):
    """The rows of a session: their state, and a mask (N,) of those taken while the tool stood at a pose."""

    state: ChainState
    held: AnyArray


@dataclass(frozen=True)
class Site:
    """Where the bench stands, and the azimuth of the hole's down direction."""

    gravity_mps2: float = STANDARD_GRAVITY_MPS2
    latitude_rad: float = 0.0
    azimuth_rad: float = 0.0


@dataclass(frozen=True)
class Profile:
    """A quantity over time by straight lines; without times the values are spread evenly over the session."""

    values: tuple[float, ...]
    times_s: tuple[float, ...] = ()

    def at(self, t_s: AnyArray) -> AnyArray:
        """(N,) values at the times; constant before the first and after the last."""
        times = self.times_s or tuple(np.linspace(t_s[0], t_s[-1], len(self.values)))
        return np.interp(t_s, times, self.values)


@dataclass(frozen=True)
class PosePlan:
    """A stepped session. Each pose is held for `hold_s` with a row every `row_s`; reaching it takes `move_s`.

    With `record_moves` the rows on the way are written too (the angles then move along a raised cosine). For each of
    `plateaus_c` the whole sequence is repeated at that temperature; the oven needs `soak_s` in between.
    """

    poses: tuple[Pose, ...]
    hold_s: float = 10.0
    row_s: float = 1.0
    move_s: float = 20.0
    record_moves: bool = False
    plateaus_c: tuple[float, ...] = ()
    soak_s: float = 3600.0

    @property
    def row_seconds(self) -> float:
        """Averaging time of a row."""
        return self.row_s

    @property
    def row_count(self) -> float:
        """Number of rows, at most; known before any is made."""
        seconds = self.hold_s + (self.move_s if self.record_moves else 0.0)
        return len(self.poses) * max(1, len(self.plateaus_c)) * (seconds / self.row_s + 2)

    def rows(self, site: Site) -> SessionRows:
        held_rows, move_rows = max(1, round(self.hold_s / self.row_s)), round(self.move_s / self.row_s)
        poses = np.array(self.poses * max(1, len(self.plateaus_c)), dtype=float)
        count, per_plateau = len(poses), len(self.poses)
        plateau = np.arange(count) // per_plateau
        start = np.arange(count) * (held_rows * self.row_s + self.move_s) + plateau * self.soak_s
        inc, tf = np.radians(poses[:, 0]), np.radians(poses[:, 1])
        during = np.arange(held_rows) * self.row_s
        t = [(start[:, None] + during).ravel()]
        parts = [np.stack([np.repeat(q, held_rows) for q in (inc, tf, poses[:, 2], np.arange(count))])]
        rates = [np.zeros((3, count * held_rows))]
        if self.record_moves and move_rows and count > 1:
            u = np.arange(move_rows) / move_rows
            travelled, rate, accel = (1 - np.cos(np.pi * u)) / 2, np.pi / 2 * np.sin(np.pi * u), np.cos(np.pi * u)
            # the way round in the sense in which the next pose is approached
            turn = np.mod(np.diff(tf) * poses[1:, 2], 2 * np.pi) * poses[1:, 2]
            tilt = np.diff(inc)
            t.append((start[1:, None] - self.move_s + u * self.move_s).ravel())
            parts.append(
                np.stack(
                    [
                        (inc[:-1, None] + tilt[:, None] * travelled).ravel(),
                        (tf[:-1, None] + turn[:, None] * travelled).ravel(),
                        np.repeat(poses[1:, 2], move_rows),
                        np.repeat(np.arange(1, count), move_rows),
                    ]
                )
            )
            rates.append(
                np.stack(
                    [
                        (turn[:, None] * rate / self.move_s).ravel(),
                        (turn[:, None] * accel * np.pi**2 / 2 / self.move_s**2).ravel(),
                        (tilt[:, None] * rate / self.move_s).ravel(),
                    ]
                )
            )
        times = np.concatenate(t)
        order = np.argsort(times, kind="stable")
        angles, motion = np.concatenate(parts, axis=1)[:, order], np.concatenate(rates, axis=1)[:, order]
        held = (np.arange(times.size) < count * held_rows)[order]
        temperature = 25.0 if not self.plateaus_c else np.array(self.plateaus_c)[angles[3].astype(int) // per_plateau]
        state = ChainState.build(
            angles[0],
            angles[1],
            t_s=times[order],
            direction=angles[2],
            temp_c=temperature,
            rotor_rate_radps=motion[0],
            rotor_accel_radps2=motion[1],
            inc_rate_radps=motion[2],
            pose=angles[3].astype(np.int64),
            since_move_s=np.maximum(times[order] - start[angles[3].astype(int)], 0.0),
            row_seconds=self.row_seconds,
        )
        return SessionRows(_placed(state, site), held)


@dataclass(frozen=True)
class RotationPlan:
    """Continuous rotation at one inclination: each rate is held for `hold_s`, linear ramps of `ramp_s` between them."""

    inclination_deg: float
    rates_radps: tuple[float, ...]
    hold_s: float = 20.0
    ramp_s: float = 2.0
    sample_hz: float = 50.0
    toolface_deg: float = 0.0
    vibration_rms_g: tuple[float, ...] = ()
    """one value for each rate (or one for all, or none)"""

    @property
    def row_seconds(self) -> float:
        """Averaging time of a row."""
        return 1 / self.sample_hz

    @property
    def row_count(self) -> float:
        """Number of rows, to rounding; known before any is made."""
        steps = len(self.rates_radps)
        return (steps * self.hold_s + (steps - 1) * self.ramp_s) * self.sample_hz

    def rows(self, site: Site) -> SessionRows:
        rates = np.array(self.rates_radps)
        n = rates.size
        lengths = np.array([self.hold_s, self.ramp_s] * n)[:-1]
        starts = np.concatenate([[0.0], np.cumsum(lengths)])
        first = np.repeat(rates, 2)[:-1]
        accel = np.zeros(2 * n - 1)
        if self.ramp_s > 0:
            accel[1::2] = np.diff(rates) / self.ramp_s
        angles = np.concatenate([[0.0], np.cumsum(first * lengths + accel * lengths**2 / 2)])
        t = np.arange(round(starts[-1] * self.sample_hz)) / self.sample_hz
        k = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, 2 * n - 2)
        s = t - starts[k]
        rate = first[k] + accel[k] * s
        shaking = np.broadcast_to(np.array(self.vibration_rms_g or (0.0,)), (n,))
        state = ChainState.build(
            np.full(t.size, np.radians(self.inclination_deg)),
            np.radians(self.toolface_deg) + angles[k] + first[k] * s + accel[k] * s**2 / 2,
            t_s=t,
            direction=np.where(rate < 0, -1.0, 1.0),
            rotor_rate_radps=rate,
            rotor_accel_radps2=accel[k],
            vibration_rms_g=np.interp(t, starts[:-1][::2] + self.hold_s / 2, shaking),
            pose=np.zeros(t.size, dtype=np.int64),
            row_seconds=self.row_seconds,
        )
        return SessionRows(_placed(state, site), np.zeros(t.size, dtype=bool))


@dataclass(frozen=True)
class LegPlan:
    """A programme of legs (standing, turning, inclining, shaking) at `sample_hz`, smooth at its joints."""

    legs: tuple[Leg, ...]
    inclination_deg: float = 5.0
    toolface_deg: float = 0.0
    sample_hz: float = 50.0

    @property
    def row_seconds(self) -> float:
        """Averaging time of a row."""
        return 1 / self.sample_hz

    @property
    def row_count(self) -> float:
        """Number of rows, to rounding; known before any is made."""
        return sum(leg.duration_s for leg in self.legs) * self.sample_hz

    def rows(self, site: Site) -> SessionRows:
        motion = Motion(self.legs, self.inclination_deg, self.toolface_deg, repeat=False)
        t = np.arange(round(motion.duration_s * self.sample_hz)) / self.sample_hz
        block = motion.block(t)
        h = 1e-4
        accel = (motion.block(t + h).toolface_rate_rad_s - motion.block(t - h).toolface_rate_rad_s) / (2 * h)
        state = ChainState.build(
            block.inclination_rad,
            block.toolface_rad,
            t_s=t,
            direction=np.where(block.toolface_rate_rad_s < 0, -1.0, 1.0),
            rotor_rate_radps=block.toolface_rate_rad_s,
            rotor_accel_radps2=accel,
            inc_rate_radps=block.inclination_rate_rad_s,
            vibration_rms_g=block.vibration_rms_g,
            pose=np.zeros(t.size, dtype=np.int64),
            row_seconds=self.row_seconds,
        )
        return SessionRows(_placed(state, site), np.zeros(t.size, dtype=bool))


Plan = PosePlan | RotationPlan | LegPlan


@dataclass(frozen=True)
class Session:
    """A plan with the temperature and the vibration that go with it."""

    plan: Plan
    site: Site = field(default_factory=Site)
    temperature: Profile | None = None
    vibration: Profile | None = None

    def rows(self) -> SessionRows:
        """The rows of the session; a given profile of temperature or vibration replaces what the plan says of it."""
        state, held = self.plan.rows(self.site)
        if self.temperature is not None:
            state = replace(state, temp_c=self.temperature.at(state.t_s))
        if self.vibration is not None:
            state = replace(state, vibration_rms_g=self.vibration.at(state.t_s))
        return SessionRows(state, held)


def station_poses(
    inclinations_deg: Sequence[float],
    toolfaces_deg: Sequence[float],
    *,
    returns: bool = False,
    closure_every: int = 0,
) -> tuple[Pose, ...]:
    """All toolfaces at each inclination in turn; inclinations below 0 or beyond 90 deg are reached by reversal.

    `returns` goes through each inclination a second time backwards, approached from the other side; `closure_every`
    comes back to the very first pose after so many poses, to tell a drift from an error of the bench.
    """
    poses: list[Pose] = []
    for inclination in inclinations_deg:
        forth = [Pose(inclination, toolface, 1.0) for toolface in toolfaces_deg]
        poses += forth
        if returns:
            poses += [pose._replace(direction=-1.0) for pose in reversed(forth)]
    if closure_every:
        with_closures: list[Pose] = []
        for k, pose in enumerate(poses):
            if k and k % closure_every == 0:
                with_closures.append(poses[0])
            with_closures.append(pose)
        poses = [*with_closures, poses[0]]
    return tuple(poses)


def full_turns(inclinations_deg: Sequence[float], stations: int = 73) -> tuple[Pose, ...]:
    """Stations evenly over a turn from 0 to 360 deg inclusive, at each inclination: the published verification."""
    return station_poses(inclinations_deg, tuple(np.linspace(0.0, 360.0, stations).tolist()))


def _placed(state: ChainState, site: Site) -> ChainState:
    """The rows at their place on the Earth."""
    return replace(state, gravity_mps2=site.gravity_mps2, latitude_rad=site.latitude_rad, azimuth_rad=site.azimuth_rad)


def pose_grid(inclinations_deg: Sequence[float], toolfaces_deg: Sequence[float]) -> tuple[AnyArray, AnyArray]:
    """All combinations, all toolfaces of an inclination before the next: (N,) inclinations and (N,) toolfaces in
    rad."""
    inc, tf = np.meshgrid(np.radians(inclinations_deg), np.radians(toolfaces_deg), indexing="ij")
    return inc.ravel(), tf.ravel()
