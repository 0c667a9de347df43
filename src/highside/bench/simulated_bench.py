"""The simulated bench: a tool with a sensor of known faults, clamped to a turntable that can be commanded where to
turn.

Like a real bench it is not level (`tilt_deg`), sets each pose with an error of its own (`pose_sigma_deg`, part of it
common to all settings of one inclination or one toolface), overshoots and comes back, shakes a little after a move, and
may drift in temperature towards what its oven is set to, with the sensor's offset following. Its operator may do worse:
set a pose wrong, strike the table, pull the plug. The tool speaks through its wire as any other; nothing but the wire
connects it to who listens.

`DeviceSettings.speed` runs its clock faster than the wall's: a session of minutes in seconds, all else unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from highside.arrays import Array
from highside.codec.axes import AxisMap
from highside.codec.frame import Frame
from highside.config.bench import SimulatedTurntable
from highside.link.device import CanEncoder, DeviceSettings, SimulatedDevice
from highside.link.wire import Wire
from highside.physics.motion import Leg, Motion

STATION_SHARE = 0.5
"""Share of the variance of a setting that repeats with the inclination or the toolface station."""


class SimulatedBench(SimulatedDevice):
    """A simulated tool whose `turn_to` moves it as a table would; see the module's docstring."""

    def __init__(
        self,
        device: DeviceSettings,
        bench: SimulatedTurntable,
        wire: Wire,
        can_encoder: CanEncoder | None = None,
    ) -> None:
        super().__init__(device, wire, can_encoder)
        self.bench = bench
        self.plugged_in = False
        """whether the plug is in"""
        self._pose_rng = np.random.default_rng([bench.seed, 77])
        self._common: dict[tuple[str, int], float] = {}
        self._oven_target = bench.temp_c
        self._oven_from = (0.0, bench.temp_c)
        self._axes = AxisMap.parse(bench.axes, allow_mirror=True)

    # commands

    def plug(self) -> None:
        super().plug()
        self.plugged_in = True

    def unplug(self) -> None:
        super().unplug()
        self.plugged_in = False

    def turn_to(
        self, inclination_deg: float, toolface_deg: float, *, wrong_inc_deg: float = 0.0, wrong_tf_deg: float = 0.0
    ) -> float:
        """Set a pose (negative inclination: the table turned the other way); returns when it will be at rest, s.

        `wrong_*`: how far off the operator sets it.
        """
        inc = inclination_deg + wrong_inc_deg + self._setting_error("inc", inclination_deg)
        tf = toolface_deg + wrong_tf_deg + self._setting_error("tf", toolface_deg % 360.0)
        tf += self._encoder_error(toolface_deg + wrong_tf_deg)
        true_inc, true_tf = self._with_tilt(inc, tf)
        with self._lock:
            start = self.time_s
            legs, duration = self._legs(start, true_inc, true_tf)
            self._track.then(start, legs)
        return start + duration + self.bench.settle_s

    def shock(self, size_g: float = 0.05, seconds: float = 0.5) -> None:
        """Shake the tool where it is."""
        self.tremble(size_g, seconds)

    def tremble(self, size_g: float, seconds: float) -> None:
        """Shake the tool for a time, then leave it at rest where it is."""
        with self._lock:
            now = self._track.at(self.time_s)
            inc, tf = float(np.rad2deg(now.inclination_rad[0])), float(np.rad2deg(now.toolface_rad[0]))
            legs = (Leg(seconds, vibration_g=size_g), Leg(3600.0))
            self._track.then(self.time_s, Motion(legs, inc, tf, repeat=False, seed=self.produced + 1))

    def set_oven(self, temp_c: float) -> None:
        """Let the tool's temperature go to `temp_c`, exponentially."""
        with self._lock:
            self._oven_from = (self.time_s, self.temperature(self.time_s))
            self._oven_target = temp_c

    # what it does

    def temperature(self, t_s: float) -> float:
        """Temperature of the sensor at the bench's time."""
        since, value = self._oven_from
        gone = math.exp(-max(0.0, t_s - since) / self.bench.oven_tau_s)
        return self._oven_target + (value - self._oven_target) * gone

    def true_offset(self, temp_c: float) -> Array:
        """Offset (3,) of the sensor at a temperature, g."""
        drift = np.array(self.bench.offset_per_c) * (temp_c - self.bench.temp_c)
        return np.asarray(self.settings.offset_g) + drift

    def frames(self, count: int) -> Iterator[Frame]:
        first = self.produced
        axes = self._axes
        for k, frame in enumerate(super().frames(count), first):
            temp = self.temperature(k / self.settings.rate_hz)
            drift = [c * (temp - self.bench.temp_c) for c in self.bench.offset_per_c]
            ax, ay, az = axes.apply(frame.ax + drift[0], frame.ay + drift[1], frame.az + drift[2])
            yield frame._replace(ax=ax, ay=ay, az=az, temp_c=round(temp, 2))

    def _setting_error(self, what: str, setting_deg: float) -> float:
        bench = self.bench
        key = (what, round(setting_deg * 1000))
        if key not in self._common:
            # drawn by the setting itself, so that a session gone on with meets the same bench
            rng = np.random.default_rng([bench.seed, 101, what == "inc", key[1] % 2**32])
            self._common[key] = float(rng.standard_normal())
        common = self._common[key] * math.sqrt(STATION_SHARE)
        own = float(self._pose_rng.standard_normal()) * math.sqrt(1.0 - STATION_SHARE)
        return bench.pose_sigma_deg * (common + own)

    def _encoder_error(self, reading_deg: float) -> float:
        angle = math.radians(reading_deg)
        return sum(
            c * math.cos(k * angle) + s * math.sin(k * angle)
            for k, (c, s) in enumerate(self.bench.encoder_deg, start=1)
        )

    def _with_tilt(self, inc_deg: float, tf_deg: float) -> tuple[float, float]:
        """True inclination (in [0, 180]) and toolface of a setting on a bench that is not level."""
        tx, ty = np.deg2rad(self.bench.tilt_deg)
        inc, tf = math.radians(inc_deg) + tx, math.radians(tf_deg)
        across, along = math.sin(ty), math.cos(ty)
        x = math.sin(inc) * along * math.cos(tf) - across * math.sin(tf)
        y = math.sin(inc) * along * math.sin(tf) + across * math.cos(tf)
        z = math.cos(inc) * along
        return math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x))

    def _legs(self, start_s: float, inc_deg: float, tf_deg: float) -> tuple[Motion, float]:
        bench = self.bench
        now = self._track.at(start_s)
        from_inc, from_tf = float(np.rad2deg(now.inclination_rad[0])), float(np.rad2deg(now.toolface_rad[0]))
        turn = math.remainder(tf_deg - from_tf, 360.0)
        way = max(abs(turn), abs(inc_deg - from_inc))
        move_s = max(0.5, 1.5 * way / bench.turn_rate_dps)
        over = math.copysign(min(bench.overshoot_deg, abs(turn)), turn) if turn else 0.0
        legs = [Leg(move_s, inclination_to_deg=inc_deg, turn_deg=turn + over)]
        if over:
            legs.append(Leg(0.6, turn_deg=-over))
        if bench.shake_g:
            legs.append(Leg(bench.settle_s, vibration_g=bench.shake_g))
        duration = sum(leg.duration_s for leg in legs)
        legs.append(Leg(3600.0))
        return Motion(tuple(legs), from_inc, from_tf, repeat=False, seed=self.produced + 1), duration
