"""How a simulated tool moves: legs of standing, turning, inclining and shaking, as a pure function of time.

Everything is known for every t at once, so the truth can be evaluated anywhere, in any order, for one instant or for
an array, with equal results. Legs follow each other; within a leg the inclination goes to a new value and the toolface
turns by an angle, both along one smooth profile: the rate rises as a raised cosine, stays, and falls again, so that
rates and accelerations are continuous. Shaking is a sum of tones (frequencies and phases drawn once from the seed)
under the same smooth envelope.

Conventions: tool frame right-handed, z along the tool up-hole; the reported gravity direction is

    G(I, T) = [sin I cos T, sin I sin T, cos I]

and, since a direction fixed in space obeys dG/dt = -w x G in the tool frame, the gyros read

    w = [I' sin T, -I' cos T, -T']

(the toolface grows clockwise looking down-hole, that is about -z; the hole's azimuth is held; earth rate is omitted).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field

from highside.arrays import Array

RAMP = 0.25
"""share of a leg in which its rate rises, and again in which it falls"""
TONES = 16
TONE_RANGE_HZ = (4.0, 45.0)


@dataclass(frozen=True, slots=True)
class Leg:
    """A piece of motion. Angles in degrees as one writes a programme by hand; `vibration_g` is the rms of each axis.

    The model file's `[[motion.legs]]` are these too: what is annotated holds for what is read from a file.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", allow_inf_nan=False)

    duration_s: Annotated[float, Field(gt=0)]
    inclination_to_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    """where the inclination is at the end of the leg; None: it stays"""
    turn_deg: float = 0.0
    """by how much the toolface turns, signed, may exceed 360"""
    vibration_g: Annotated[float, Field(ge=0)] = 0.0

    @property
    def still(self) -> bool:
        """Whether a survey may be taken in it."""
        return self.inclination_to_deg is None and self.turn_deg == 0.0 and self.vibration_g == 0.0


class MotionBlock(NamedTuple):
    """The state of motion at N instants, SI and radians."""

    t_s: Array
    inclination_rad: Array
    """(N,)"""
    toolface_rad: Array
    """(N,), not wrapped: it counts turns"""
    inclination_rate_rad_s: Array
    toolface_rate_rad_s: Array
    gravity: Array
    """(3, N): G(I, T), a unit vector"""
    gyro_rad_s: Array
    """(3, N): what ideal gyros read"""
    vibration_g: Array
    """(3, N): linear acceleration of the shaking, to be added to gravity"""
    vibration_rms_g: Array
    """(N,): the rms of one axis of the shaking at that time"""


@dataclass(frozen=True)
class Motion:
    """A programme of legs from a starting attitude, repeated for ever or held at its end.

    Raises ValueError when it has no legs, when a duration is not positive, or when a repeated programme does not end at
    the inclination at which it began (the tool would jump).
    """

    legs: tuple[Leg, ...]
    inclination_deg: float = 5.0
    toolface_deg: float = 30.0
    repeat: bool = True
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.legs or any(not leg.duration_s > 0.0 for leg in self.legs):
            raise ValueError("a motion needs legs, each of a positive duration")
        if self.repeat and abs(self._inclinations_deg[-1] - self.inclination_deg) > 1e-9:
            raise ValueError(
                f"a repeated motion must end where it began: at {self.inclination_deg} deg of inclination,"
                f" not {self._inclinations_deg[-1]} deg"
            )

    @property
    def duration_s(self) -> float:
        """Length of one pass through the programme."""
        return float(self._starts_s[-1])

    def block(self, t_s: ArrayLike) -> MotionBlock:
        """The motion at the instants `t_s`, shape (N,), in seconds from the start; before 0 it stands at the start."""
        t = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        period = self.duration_s
        passes = np.floor(np.maximum(t, 0.0) / period) if self.repeat else np.zeros_like(t)
        phase = np.clip(np.maximum(t, 0.0) - passes * period, 0.0, period)
        starts = self._starts_s
        leg = np.clip(np.searchsorted(starts, phase, side="right") - 1, 0, len(self.legs) - 1)
        duration = np.diff(starts)[leg]
        travelled, rate, envelope = _profile((phase - starts[leg]) / duration)
        moving = t >= 0.0

        inclinations, turns = np.deg2rad(self._inclinations_deg), np.deg2rad(self._turns_deg)
        di, dt = np.diff(inclinations)[leg], np.diff(turns)[leg]
        inclination = inclinations[leg] + di * travelled
        toolface = turns[leg] + dt * travelled + passes * (turns[-1] - turns[0])
        inclination_rate = np.where(moving, di * rate / duration, 0.0)
        toolface_rate = np.where(moving, dt * rate / duration, 0.0)

        sin_t, cos_t = np.sin(toolface), np.cos(toolface)
        sin_i = np.sin(inclination)
        rms = np.where(moving, np.array([leg.vibration_g for leg in self.legs])[leg] * envelope, 0.0)
        return MotionBlock(
            t,
            inclination,
            toolface,
            inclination_rate,
            toolface_rate,
            np.stack([sin_i * cos_t, sin_i * sin_t, np.cos(inclination)]),
            np.stack([inclination_rate * sin_t, -inclination_rate * cos_t, -toolface_rate]),
            rms * self._tones(t),
            rms,
        )

    def still_intervals(self, until_s: float) -> list[tuple[float, float]]:
        """Where the tool neither moves nor shakes: (start, end) of those that begin before `until_s`, joined."""
        found: list[tuple[float, float]] = []
        base = 0.0
        while base < until_s:
            for leg, start in zip(self.legs, self._starts_s[:-1], strict=True):
                begin, end = base + float(start), base + float(start) + leg.duration_s
                if not leg.still or begin >= until_s:
                    continue
                if found and abs(found[-1][1] - begin) < 1e-9:
                    begin = found.pop()[0]
                found.append((begin, end))
            base += self.duration_s
            if not self.repeat:
                break
        return found

    @cached_property
    def _starts_s(self) -> Array:
        return np.concatenate([[0.0], np.cumsum([leg.duration_s for leg in self.legs])])

    @cached_property
    def _inclinations_deg(self) -> Array:
        values = [self.inclination_deg]
        for leg in self.legs:
            values.append(values[-1] if leg.inclination_to_deg is None else leg.inclination_to_deg)
        return np.array(values)

    @cached_property
    def _turns_deg(self) -> Array:
        return self.toolface_deg + np.concatenate([[0.0], np.cumsum([leg.turn_deg for leg in self.legs])])

    @cached_property
    def _tone_table(self) -> tuple[Array, Array]:
        rng = np.random.default_rng(self.seed)
        frequency_hz = rng.uniform(*TONE_RANGE_HZ, size=(3, TONES))
        return 2.0 * np.pi * frequency_hz, rng.uniform(0.0, 2.0 * np.pi, size=(3, TONES))

    def _tones(self, t: Array) -> Array:
        """(3, N): shaking of rms 1 an axis."""
        omega, phase = self._tone_table
        shaken = np.sin(omega[:, :, None] * t + phase[:, :, None]).sum(axis=1)
        return np.asarray(shaken * np.sqrt(2.0 / TONES), dtype=np.float64)


def _profile(u: Array) -> tuple[Array, Array, Array]:
    """Share travelled, rate (its derivative) and envelope (rate over top rate) at the share `u` of a leg's time.

    The rate rises as (1 - cos(pi u / r)) / 2 for u < r, is 1 up to 1 - r, and falls as it rose; divided by its area
    1 - r. The share travelled is its integral.
    """
    r = RAMP
    v = np.minimum(u, 1.0 - u)  # the profile is symmetric about the middle
    rising = v < r
    envelope = np.where(rising, 0.5 * (1.0 - np.cos(np.pi * v / r)), 1.0)
    half = np.where(rising, 0.5 * (v - r / np.pi * np.sin(np.pi * v / r)), v - 0.5 * r) / (1.0 - r)
    return np.where(u <= 0.5, half, 1.0 - half), envelope / (1.0 - r), envelope


def still(inclination_deg: float, toolface_deg: float, duration_s: float = 3600.0) -> Motion:
    """A tool that lies still in one attitude."""
    return Motion((Leg(duration_s),), inclination_deg, toolface_deg)


def demo(seed: int = 1) -> Motion:
    """The demonstration's two minutes: 5 to 60 deg of inclination, turns at several rates, stops, shakes."""
    legs: Sequence[Leg] = (
        Leg(8.0),
        Leg(6.0, turn_deg=90.0),
        Leg(8.0),
        Leg(6.0, inclination_to_deg=15.0),
        Leg(7.0),
        Leg(5.0, turn_deg=-150.0),
        Leg(4.0, vibration_g=0.02),
        Leg(8.0),
        Leg(6.0, inclination_to_deg=30.0, turn_deg=45.0),
        Leg(8.0),
        Leg(8.0, turn_deg=720.0),
        Leg(8.0),
        Leg(8.0, inclination_to_deg=60.0),
        Leg(8.0),
        Leg(6.0, turn_deg=200.0, vibration_g=0.05),
        Leg(8.0),
        Leg(10.0, inclination_to_deg=5.0, turn_deg=60.0),
    )
    return Motion(tuple(legs), inclination_deg=5.0, toolface_deg=30.0, seed=seed)
