"""Rolling bias correction: the cross-axis offset of this power-up, from the circle that a turning tool draws.

Turn-on bias is hundreds of ug; near vertical it dominates toolface (300 ug at I = 1.2 deg is 0.8 deg). While the tool
turns at steady inclination, the corrected (gx, gy) run on a circle of radius sin I about the offset, whatever the
speed and the toolface: the centre of the circle is the offset (`highside.calibration.circle_fit`).

Indistinguishable from an offset: an acceleration fixed in the tool and proportional to rate squared, of a sensor that
does not lie on the axis of rotation (1 mm at 20 rpm: 0.45 mg). The lever arm is therefore a setting, with its
uncertainty, and the fit works only within limits of rate.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from pydantic import Field, model_validator

from highside.calibration.circle_fit import (
    SECTORS,
    TURN,
    CircleFit,
    Revolution,
    chance_limit,
    degrees_of_freedom,
    fit_circle,
)
from highside.calibration.correction import ZERO_COVARIANCE, Corrected, Correction, Covariance, Vector
from highside.reading.config_table import ConfigTable
from highside.units import STANDARD_GRAVITY_MPS2

SHOCK_SIGMAS = 6.0
"""A reading farther than this from the circle is a shock and counts for nothing."""
MAX_SHOCK_SHARE = 0.05
"""More shocks than this in a revolution are vibration."""
MANY_SHOCKS = 50
"""Fewer may come together in a good revolution."""
SIGNIFICANT = 5.0
"""Standard deviations from which a drift of inclination is believed."""


MAX_TURNS = 30
"""Revolutions kept."""
MIN_INCLINATION_DEG = 0.2
"""Below this the circle is too small for a useful centre."""
MAX_VIBRATION_G = 0.1
"""By the frame's own figure, where it has one."""
MAX_NOISE_G = 0.02
"""Largest scatter about the circle."""
MAGNITUDE_TOLERANCE_G = 5e-3
"""Departure of radius and axial component from one g: several times a turn-on bias."""
MAX_GAP_S = 1.0


class RollingBiasState(StrEnum):
    """State of the rolling bias correction."""

    WAITING = "waiting"
    """the tool does not turn, or no reading has come yet"""
    COLLECTING = "collecting"
    """the tool turns; revolutions are still missing"""
    READY = "ready"
    """the estimate is of the present turning"""
    HELD = "held"
    """the tool no longer turns; the estimate of this power-up stands"""
    DECLINED = "declined"
    """the tool turns, but a condition fails; an earlier estimate stands"""


class DeclineReason(StrEnum):
    """Why there is no new estimate."""

    NONE = "none"
    NOT_TURNING = "not_turning"
    PARTIAL_TURN = "partial_turn"
    """the tool stopped or turned back before a full turn was complete"""
    TOO_SLOW = "too_slow"
    TOO_FAST = "too_fast"
    """centripetal acceleration of an unknown lever arm would pass for an offset"""
    UNEVEN_TURN = "uneven_turn"
    """parts of the turn hold too few readings (stick-slip)"""
    NEAR_VERTICAL = "near_vertical"
    """the circle is too small to be distinguished from noise"""
    INCLINATION_DRIFTS = "inclination_drifts"
    VIBRATION = "vibration"
    INCONSISTENT = "inconsistent"
    """revolutions do not lie on one circle"""
    RADIUS = "radius"
    """radius and axial component do not make one g: the calibration is not of this tool, or the bias is not small"""
    GAP = "gap"
    """readings are missing, or time ran backwards"""


class RollingBiasSettings(ConfigTable):
    """When the estimate is accepted, and where the sensor lies: as the configuration file states it."""

    turns: int = Field(default=3, ge=1, le=MAX_TURNS, description="Revolutions needed for an estimate.")
    min_rate_rpm: float = Field(default=3.0, gt=0)
    max_rate_rpm: float = Field(default=120.0, gt=0)
    max_drift_deg: float = Field(default=0.02, gt=0, description="Largest change of inclination over the revolutions.")
    max_offset_g: float = Field(default=5e-3, gt=0, description="A larger offset is not a turn-on bias.")
    lever_mm: tuple[float, float] = Field(default=(0.0, 0.0), description="Sensor off the axis of rotation, x and y.")
    lever_std_mm: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _range_of_rates(self) -> Self:
        if not self.min_rate_rpm < self.max_rate_rpm:
            raise ValueError("needs min_rate_rpm < max_rate_rpm")
        return self


@dataclass(frozen=True, slots=True)
class CrossAxisBias:
    """Cross-axis offset of this power-up (g, corrected frame) and its covariance `(xx, xy, yy)` (g^2)."""

    bx_g: float
    by_g: float
    cov: tuple[float, float, float]
    turns: int
    t_s: float
    noise_g: float
    """scatter of one reading about the circle"""
    rate_rpm: float

    @property
    def std_g(self) -> tuple[float, float]:
        return math.sqrt(self.cov[0]), math.sqrt(self.cov[2])


class RollingBias:
    """Processes corrected readings one by one and keeps the offset of this power-up.

    Give it readings corrected *without* its own offset. `offset` stays until `reset` (a new power-up).
    """

    def __init__(self, settings: RollingBiasSettings | None = None) -> None:
        settings = settings or RollingBiasSettings()
        self._settings = settings
        self._lever_g_s2 = tuple(1e-3 * arm / STANDARD_GRAVITY_MPS2 for arm in settings.lever_mm)
        self._lever_std_g_s2 = 1e-3 * settings.lever_std_mm / STANDARD_GRAVITY_MPS2
        self.state = RollingBiasState.WAITING
        self.reason = DeclineReason.NOT_TURNING
        self._offset: CrossAxisBias | None = None
        self._centre = (0.0, 0.0)
        self._noise_g: float | None = None
        self._radius: float | None = None
        self._done: deque[Revolution] = deque(maxlen=MAX_TURNS)
        self._revolution: Revolution | None = None
        self._last_t: float | None = None
        self._last_angle = 0.0
        self._farthest = 0.0

    def reset(self) -> None:
        """A new power-up: the offset is forgotten."""
        self._offset = None
        self.state = RollingBiasState.WAITING
        self.reason = DeclineReason.NOT_TURNING
        self._restart()

    @property
    def offset(self) -> CrossAxisBias | None:
        """The offset of this power-up, None as long as there is none."""
        return self._offset

    @property
    def turns_collected(self) -> int:
        """Good revolutions in hand."""
        return len(self._done)

    def wrap(self, correction: Correction) -> Correction:
        """The correction with the present offset taken off; the correction itself where there is none."""
        return correction if self._offset is None else BiasCorrected(correction, self._offset)

    def add(self, t_s: float, gx: float, gy: float, gz: float, vibration_g: float | None = None) -> None:
        """Process one corrected reading (g) at device time `t_s`."""
        settings = self._settings
        last = self._last_t
        self._last_t = t_s
        if not math.isfinite(gx + gy + gz + t_s):
            self._decline(DeclineReason.GAP)
            return
        if last is not None and not 0.0 < t_s - last <= MAX_GAP_S:
            self._decline(DeclineReason.GAP)
            return
        if vibration_g is not None and vibration_g > MAX_VIBRATION_G:
            self._decline(DeclineReason.VIBRATION)
            return
        cx, cy = self._centre
        x, y = gx - cx, gy - cy
        rho = math.hypot(x, y)
        if rho == 0.0:
            return
        revolution = self._revolution
        if revolution is not None and self._is_shock(revolution, rho):
            return
        angle = math.atan2(y, x)
        if revolution is None:
            self._revolution = revolution = Revolution.begin(t_s, self._centre)
            self._last_angle = angle
        step = angle - self._last_angle
        if step > math.pi:
            step -= TURN
        elif step < -math.pi:
            step += TURN
        self._last_angle = angle
        revolution.angle += step
        turned = revolution.angle
        revolution.frames += 1
        if abs(turned) > self._farthest:
            self._farthest = abs(turned)
            if self._farthest > _STOPPED_RAD and self.state is not RollingBiasState.READY:
                self.state = RollingBiasState.COLLECTING
        elif self._farthest - abs(turned) > _TURNED_BACK_RAD:
            self._decline(DeclineReason.PARTIAL_TURN)
            return
        if (t_s - revolution.t0) * settings.min_rate_rpm > 60.0:
            # longer than a turn may last: it is at rest, or creeps
            self._decline(
                DeclineReason.NOT_TURNING if self._farthest < _STOPPED_RAD else self._why_incomplete(revolution)
            )
            return
        revolution.add(t_s, x / rho, y / rho, rho, gz, angle)
        if abs(turned) >= TURN:
            revolution.end_s = t_s
            self._complete(revolution)

    def _is_shock(self, r: Revolution, rho: float) -> bool:
        """Count a reading that is far from the circle. It may not turn the angle either; too many end the turn."""
        noise, radius = self._noise_g, self._radius
        if noise is None or radius is None or abs(rho - radius) <= SHOCK_SIGMAS * noise:
            return False
        r.frames += 1
        r.shocks += 1
        r.outward += 1 if rho > radius else -1
        if r.shocks > MANY_SHOCKS and r.shocks > MAX_SHOCK_SHARE * r.frames:
            self._decline(_fault_of_shocks(r))
        return True

    def _complete(self, revolution: Revolution) -> None:
        """A full turn is in hand: test it alone, then with those before it."""
        reason = self._check_revolution(revolution)
        if reason is not DeclineReason.NONE:
            self._decline(reason)
            return
        self._done.append(revolution)
        fit = fit_circle(self._done, self._centre)
        reason = self._check_fit(fit, len(self._done))
        while reason in _CURED_BY_DISCARDING and len(self._done) > self._settings.turns:
            self._done.popleft()
            fit = fit_circle(self._done, self._centre)
            reason = self._check_fit(fit, len(self._done))
        if reason is not DeclineReason.NONE:
            self._decline(reason)
            return
        self._centre = (self._centre[0] + float(fit.theta[1]), self._centre[1] + float(fit.theta[2]))
        span = revolution.end_s - self._done[0].t0
        self._noise_g, self._radius = fit.noise_g, float(fit.theta[0] + fit.theta[3] * span)
        # the next turn begins where this one ended, about the better centre
        excess = math.copysign(abs(revolution.angle) - TURN, revolution.angle)
        self._revolution = Revolution.begin(revolution.end_s, self._centre, excess)
        self._farthest = abs(excess)
        if len(self._done) < self._settings.turns:
            self.state, self.reason = RollingBiasState.COLLECTING, DeclineReason.NONE
            return
        self._accept(fit)

    def _accept(self, fit: CircleFit) -> None:
        omega2 = (fit.rate_rpm * TURN / 60.0) ** 2
        # a sensor at +x is accelerated towards the axis, along -x, and reports that
        lever = (-omega2 * self._lever_g_s2[0], -omega2 * self._lever_g_s2[1])
        lever_var = (omega2 * self._lever_std_g_s2) ** 2
        grown = max(1.0, fit.consistency)
        cov = fit.covariance[1:3, 1:3] * grown
        self._offset = CrossAxisBias(
            bx_g=self._centre[0] - lever[0],
            by_g=self._centre[1] - lever[1],
            cov=(float(cov[0, 0]) + lever_var, float(cov[0, 1]), float(cov[1, 1]) + lever_var),
            turns=len(self._done),
            t_s=self._done[-1].end_s,
            noise_g=fit.noise_g,
            rate_rpm=fit.rate_rpm,
        )
        self.state, self.reason = RollingBiasState.READY, DeclineReason.NONE

    def _check_revolution(self, r: Revolution) -> DeclineReason:
        settings = self._settings
        rpm = 60.0 / max(r.end_s - r.t0, 1e-9)
        if rpm > settings.max_rate_rpm:
            return DeclineReason.TOO_FAST
        if rpm < settings.min_rate_rpm:
            return DeclineReason.TOO_SLOW
        if r.shocks > MAX_SHOCK_SHARE * r.frames:
            return _fault_of_shocks(r)
        if min(r.counts) * SECTORS * 4 < sum(r.counts):
            return DeclineReason.UNEVEN_TURN
        return DeclineReason.NONE

    def _check_fit(self, fit: CircleFit, turns: int) -> DeclineReason:
        settings = self._settings
        radius = float(fit.theta[0])
        if fit.noise_g > MAX_NOISE_G:
            return DeclineReason.VIBRATION
        inclination = math.degrees(math.atan2(radius, fit.gz))
        if inclination < MIN_INCLINATION_DEG or radius < 4.0 * fit.noise_g:
            return DeclineReason.NEAR_VERTICAL
        if abs(fit.drift_deg) > max(settings.max_drift_deg, SIGNIFICANT * fit.drift_std_deg):
            return DeclineReason.INCLINATION_DRIFTS
        if turns > 1 and fit.consistency > chance_limit(degrees_of_freedom(turns)):
            return DeclineReason.INCONSISTENT
        if abs(math.hypot(radius, fit.gz) - 1.0) > MAGNITUDE_TOLERANCE_G:
            return DeclineReason.RADIUS
        centre = (self._centre[0] + float(fit.theta[1]), self._centre[1] + float(fit.theta[2]))
        if math.hypot(*centre) > settings.max_offset_g:
            return DeclineReason.RADIUS
        return DeclineReason.NONE

    def _why_incomplete(self, revolution: Revolution) -> DeclineReason:
        """A turn was begun and not completed in the time of the slowest one."""
        counts = [count for count in revolution.counts if count]
        # a creeping tool spreads its time over what it turned; one that stopped heaps it up in one sector
        creeps = max(revolution.counts) < 3.0 * sum(counts) / max(len(counts), 1)
        return DeclineReason.TOO_SLOW if creeps else DeclineReason.PARTIAL_TURN

    def _decline(self, reason: DeclineReason) -> None:
        self._restart()
        self.reason = reason
        if reason is DeclineReason.NOT_TURNING:
            self.state = RollingBiasState.WAITING if self._offset is None else RollingBiasState.HELD
        else:
            self.state = RollingBiasState.DECLINED

    def _restart(self) -> None:
        self._done.clear()
        self._revolution = None
        self._last_t = None
        self._last_angle = 0.0
        self._farthest = 0.0
        if self._offset is None:
            self._centre = (0.0, 0.0)
        self._noise_g = self._radius = None


_TURNED_BACK_RAD = math.radians(60.0)
"""Turning back by more than noise can."""
_STOPPED_RAD = math.radians(45.0)
"""Less than this in the time of the slowest turn is a tool at rest."""
_CURED_BY_DISCARDING = (DeclineReason.INCLINATION_DRIFTS, DeclineReason.INCONSISTENT)
"""Faults that the last few revolutions may not have though many together do."""


def _fault_of_shocks(r: Revolution) -> DeclineReason:
    return DeclineReason.INCLINATION_DRIFTS if abs(r.outward) > 0.9 * r.shocks else DeclineReason.VIBRATION


@dataclass(frozen=True, slots=True)
class BiasCorrected:
    """A correction with the cross-axis offset of this power-up taken off its output."""

    base: Correction
    offset: CrossAxisBias

    @property
    def cal_id(self) -> str:
        return self.base.cal_id

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        one = self.base.correct(a, cov, temp_c)
        xx, xy, xz, yy, yz, zz = one.cov
        dxx, dxy, dyy = self.offset.cov
        return Corrected(
            one.gx - self.offset.bx_g,
            one.gy - self.offset.by_g,
            one.gz,
            (xx + dxx, xy + dxy, xz, yy + dyy, yz, zz),
            one.zone,
            (*one.flags, "rolling_bias"),
        )
