"""In-run re-balance: the cross-axis offset of this power-up, from the circle that a turning tool draws.

Turn-on bias is hundreds of ug; near vertical it dominates toolface (300 ug at I = 1.2 deg is 0.8 deg). While the tool
turns at steady inclination, the corrected (gx, gy) run on a circle of radius sin I about the offset, whatever the
speed and the toolface: the centre of the circle is the offset.

Theory. About a provisional centre c, with u the unit vector from c to a reading and rho its distance, to first order

    rho = R + R' t + u . d + noise,        d = (true centre) - c.

A drift R' of the inclination must be estimated with it, or a part of it would pass for an offset. This is linear in
(R, dx, dy, R'), so that the sums of products of (1, ux, uy, t, rho, gz) over a revolution say all there is to know:
memory is one 6 x 6 matrix a revolution, and sums taken about an old centre are moved to a new one. For N readings of
noise s over full turns the centre has the covariance `2 s^2 / N` in each axis. The radial noise is taken from the fit.

What cannot be told from an offset: an acceleration fixed in the tool and proportional to rate squared, of a sensor that
does not lie on the axis of rotation (1 mm at 20 rpm: 0.45 mg). The lever arm is therefore a setting, with its
uncertainty, and the fit works only within limits of rate.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from highside.arrays import Array
from highside.calibration.correction import ZERO_COVARIANCE, Corrected, Correction, Covariance, Vector
from highside.errors import InputError
from highside.units import STANDARD_GRAVITY_MPS2

SECTORS = 12
"""Parts of a turn that must each hold their share of the readings."""
SHOCK_SIGMAS = 6.0
"""A reading farther than this from the circle is a shock and counts for nothing."""
MAX_SHOCK_SHARE = 0.05
"""More shocks than this in a revolution are vibration."""
MANY_SHOCKS = 50
"""Fewer may come together in a good revolution."""
SIGNIFICANT = 5.0
"""Standard deviations from which a drift of inclination is believed."""
INCONSISTENT_SIGMAS = 3.7
"""Departure of single revolutions from the common circle that is no chance (once in ten thousand)."""
MIN_NOISE_G = 1e-6
"""Below this a scatter is rounding, not noise."""
TURN = 2.0 * math.pi


class State(StrEnum):
    """Where the re-balance stands."""

    WAITING = "waiting"
    """the tool does not turn, or nothing was heard yet"""
    COLLECTING = "collecting"
    """the tool turns; revolutions are still missing"""
    READY = "ready"
    """the estimate is of the present turning"""
    HELD = "held"
    """the tool no longer turns; the estimate of this power-up stands"""
    DECLINED = "declined"
    """the tool turns, but a condition fails; an earlier estimate stands"""


class Reason(StrEnum):
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
    """the circle is too small to be told from noise"""
    INCLINATION_DRIFTS = "inclination_drifts"
    VIBRATION = "vibration"
    INCONSISTENT = "inconsistent"
    """revolutions do not lie on one circle"""
    RADIUS = "radius"
    """radius and axial component do not make one g: the calibration is not of this tool, or the bias is not small"""
    GAP = "gap"
    """readings are missing, or time ran backwards"""


@dataclass(frozen=True, slots=True)
class RebalanceSettings:
    """When to believe. Rates in revolutions a minute, angles in deg, the lever arm in mm along tool x and y."""

    turns: int = 3
    """revolutions needed for an estimate"""
    max_turns: int = 30
    """revolutions kept"""
    min_rate_rpm: float = 3.0
    max_rate_rpm: float = 120.0
    min_inclination_deg: float = 0.2
    max_drift_deg: float = 0.02
    """largest change of inclination over the revolutions used"""
    max_vibration_g: float = 0.1
    """by the frame's own figure, where it has one"""
    max_noise_g: float = 0.02
    """largest scatter about the circle"""
    max_offset_g: float = 5e-3
    """a larger offset is not a turn-on bias"""
    magnitude_tolerance_g: float = 5e-3
    max_gap_s: float = 1.0
    lever_mm: tuple[float, float] = (0.0, 0.0)
    lever_std_mm: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.turns <= self.max_turns:
            raise InputError("needs 1 <= turns <= max_turns", field="turns")
        if not 0.0 < self.min_rate_rpm < self.max_rate_rpm:
            raise InputError("needs 0 < min_rate_rpm < max_rate_rpm", field="min_rate_rpm")
        if not 0.0 < self.min_inclination_deg < 90.0:
            raise InputError("must lie between 0 and 90", field="min_inclination_deg")
        if self.lever_std_mm < 0.0:
            raise InputError("must not be negative", field="lever_std_mm")


@dataclass(frozen=True, slots=True)
class Offset:
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


@dataclass(slots=True)
class _Revolution:
    """One turn in progress or complete: sums of products of v = (1, ux, uy, t - t0, rho, gz)."""

    t0: float
    centre: tuple[float, float]
    sums: list[float]
    counts: list[int]
    angle: float = 0.0
    """unwrapped angle since its beginning"""
    end_s: float = 0.0
    shocks: int = 0
    outward: int = 0
    """shocks outside of the circle less those inside: a drifting radius has them all on one side"""
    frames: int = 0

    @classmethod
    def begin(cls, t_s: float, centre: tuple[float, float], angle: float = 0.0) -> _Revolution:
        return cls(t_s, centre, [0.0] * 21, [0] * SECTORS, angle, end_s=t_s)

    def moments(self, t_ref: float, centre: tuple[float, float]) -> Array:
        """The 6 x 6 sums about another time and another provisional centre."""
        M = np.zeros((6, 6))
        M[np.triu_indices(6)] = self.sums
        M = M + np.triu(M, 1).T
        L = np.eye(6)
        L[3, 0] = self.t0 - t_ref
        # rho about the new centre is smaller by u . (new - old)
        L[4, 1], L[4, 2] = self.centre[0] - centre[0], self.centre[1] - centre[1]
        return np.asarray(L @ M @ L.T)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Circle over some revolutions: `theta` = (R, dx, dy, R'), covariance, and what the gates ask for."""

    theta: Array
    covariance: Array
    noise_g: float
    gz: float
    drift_deg: float
    drift_std_deg: float
    consistency: float
    rate_rpm: float


class Rebalancer:
    """Takes corrected readings one by one and keeps the offset of this power-up.

    Feed it with readings corrected *without* its own offset. `offset` stays until `reset` (a new power-up).
    """

    def __init__(self, settings: RebalanceSettings = RebalanceSettings()) -> None:
        self._settings = settings
        self._lever_g_s2 = tuple(1e-3 * arm / STANDARD_GRAVITY_MPS2 for arm in settings.lever_mm)
        self._lever_std_g_s2 = 1e-3 * settings.lever_std_mm / STANDARD_GRAVITY_MPS2
        self.state = State.WAITING
        self.reason = Reason.NOT_TURNING
        self._offset: Offset | None = None
        self._centre = (0.0, 0.0)
        self._noise_g: float | None = None
        self._radius: float | None = None
        self._done: deque[_Revolution] = deque(maxlen=settings.max_turns)
        self._turning: _Revolution | None = None
        self._last_t: float | None = None
        self._last_angle = 0.0
        self._farthest = 0.0

    def reset(self) -> None:
        """A new power-up: the offset is forgotten."""
        self._offset = None
        self.state = State.WAITING
        self.reason = Reason.NOT_TURNING
        self._restart()

    @property
    def offset(self) -> Offset | None:
        """The offset of this power-up, None as long as there is none."""
        return self._offset

    @property
    def turns_collected(self) -> int:
        """Good revolutions in hand."""
        return len(self._done)

    def wrap(self, correction: Correction) -> Correction:
        """The correction with the present offset taken off; the correction itself where there is none."""
        return correction if self._offset is None else RebalancedCorrection(correction, self._offset)

    def add(self, t_s: float, gx: float, gy: float, gz: float, vibration_g: float | None = None) -> None:
        """Take one corrected reading (g) at device time `t_s`."""
        settings = self._settings
        last = self._last_t
        self._last_t = t_s
        if not math.isfinite(gx + gy + gz + t_s):
            self._decline(Reason.GAP)
            return
        if last is not None and not 0.0 < t_s - last <= settings.max_gap_s:
            self._decline(Reason.GAP)
            return
        if vibration_g is not None and vibration_g > settings.max_vibration_g:
            self._decline(Reason.VIBRATION)
            return
        cx, cy = self._centre
        x, y = gx - cx, gy - cy
        rho = math.hypot(x, y)
        if rho == 0.0:
            return
        revolution = self._turning
        if revolution is not None and self._is_shock(revolution, rho):
            return
        angle = math.atan2(y, x)
        if revolution is None:
            self._turning = revolution = _Revolution.begin(t_s, self._centre)
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
            if self._farthest > _STANDING_RAD and self.state is not State.READY:
                self.state = State.COLLECTING
        elif self._farthest - abs(turned) > _TURNED_BACK_RAD:
            self._decline(Reason.PARTIAL_TURN)
            return
        if t_s - revolution.t0 > TURN / (settings.min_rate_rpm * TURN / 60.0):
            # longer than a turn may last: it stands, or creeps
            self._decline(Reason.NOT_TURNING if self._farthest < _STANDING_RAD else self._why_not_full(revolution))
            return
        self._sum(revolution, t_s, x / rho, y / rho, rho, gz, angle)
        if abs(turned) >= TURN:
            revolution.end_s = t_s
            self._complete(revolution)

    def _is_shock(self, r: _Revolution, rho: float) -> bool:
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

    def _sum(self, r: _Revolution, t_s: float, ux: float, uy: float, rho: float, gz: float, angle: float) -> None:
        t = t_s - r.t0
        s = r.sums
        s[0] += 1.0
        s[1] += ux
        s[2] += uy
        s[3] += t
        s[4] += rho
        s[5] += gz
        s[6] += ux * ux
        s[7] += ux * uy
        s[8] += ux * t
        s[9] += ux * rho
        s[10] += ux * gz
        s[11] += uy * uy
        s[12] += uy * t
        s[13] += uy * rho
        s[14] += uy * gz
        s[15] += t * t
        s[16] += t * rho
        s[17] += t * gz
        s[18] += rho * rho
        s[19] += rho * gz
        s[20] += gz * gz
        r.counts[int((angle + math.pi) / TURN * SECTORS) % SECTORS] += 1

    def _complete(self, revolution: _Revolution) -> None:
        """A full turn is in hand: judge it alone, then with those before it."""
        reason = self._fault_of(revolution)
        if reason is not Reason.NONE:
            self._decline(reason)
            return
        self._done.append(revolution)
        fit = self._fit(self._done, self._centre)
        reason = self._fault_of_fit(fit, len(self._done))
        while reason in _CURED_BY_FORGETTING and len(self._done) > self._settings.turns:
            self._done.popleft()
            fit = self._fit(self._done, self._centre)
            reason = self._fault_of_fit(fit, len(self._done))
        if reason is not Reason.NONE:
            self._decline(reason)
            return
        self._centre = (self._centre[0] + float(fit.theta[1]), self._centre[1] + float(fit.theta[2]))
        span = revolution.end_s - self._done[0].t0
        self._noise_g, self._radius = fit.noise_g, float(fit.theta[0] + fit.theta[3] * span)
        # the next turn begins where this one ended, about the better centre
        excess = math.copysign(abs(revolution.angle) - TURN, revolution.angle)
        self._turning = _Revolution.begin(revolution.end_s, self._centre, excess)
        self._farthest = abs(excess)
        if len(self._done) < self._settings.turns:
            self.state, self.reason = State.COLLECTING, Reason.NONE
            return
        self._accept(fit)

    def _accept(self, fit: _Fit) -> None:
        omega2 = (fit.rate_rpm * TURN / 60.0) ** 2
        # a sensor at +x is accelerated towards the axis, along -x, and reports that
        lever = (-omega2 * self._lever_g_s2[0], -omega2 * self._lever_g_s2[1])
        lever_var = (omega2 * self._lever_std_g_s2) ** 2
        grown = max(1.0, fit.consistency)
        cov = fit.covariance[1:3, 1:3] * grown
        self._offset = Offset(
            bx_g=self._centre[0] - lever[0],
            by_g=self._centre[1] - lever[1],
            cov=(float(cov[0, 0]) + lever_var, float(cov[0, 1]), float(cov[1, 1]) + lever_var),
            turns=len(self._done),
            t_s=self._done[-1].end_s,
            noise_g=fit.noise_g,
            rate_rpm=fit.rate_rpm,
        )
        self.state, self.reason = State.READY, Reason.NONE

    def _fault_of(self, r: _Revolution) -> Reason:
        settings = self._settings
        rpm = 60.0 / max(r.end_s - r.t0, 1e-9)
        if rpm > settings.max_rate_rpm:
            return Reason.TOO_FAST
        if rpm < settings.min_rate_rpm:
            return Reason.TOO_SLOW
        if r.shocks > MAX_SHOCK_SHARE * r.frames:
            return _fault_of_shocks(r)
        if min(r.counts) * SECTORS * 4 < sum(r.counts):
            return Reason.UNEVEN_TURN
        return Reason.NONE

    def _fault_of_fit(self, fit: _Fit, turns: int) -> Reason:
        settings = self._settings
        radius = float(fit.theta[0])
        if fit.noise_g > settings.max_noise_g:
            return Reason.VIBRATION
        inclination = math.degrees(math.atan2(radius, fit.gz))
        if inclination < settings.min_inclination_deg or radius < 4.0 * fit.noise_g:
            return Reason.NEAR_VERTICAL
        if abs(fit.drift_deg) > max(settings.max_drift_deg, SIGNIFICANT * fit.drift_std_deg):
            return Reason.INCLINATION_DRIFTS
        if turns > 1 and fit.consistency > _chance_limit(_degrees_of_freedom(turns)):
            return Reason.INCONSISTENT
        if abs(math.hypot(radius, fit.gz) - 1.0) > settings.magnitude_tolerance_g:
            return Reason.RADIUS
        centre = (self._centre[0] + float(fit.theta[1]), self._centre[1] + float(fit.theta[2]))
        if math.hypot(*centre) > settings.max_offset_g:
            return Reason.RADIUS
        return Reason.NONE

    def _fit(self, revolutions: Sequence[_Revolution], centre: tuple[float, float]) -> _Fit:
        t_ref = revolutions[0].t0
        parts = [r.moments(t_ref, centre) for r in revolutions]
        M = np.sum(parts, axis=0)
        n = M[0, 0]
        normal = M[:4, :4]
        inverse = np.linalg.inv(normal)
        theta = inverse @ M[:4, 4]
        axial = inverse @ M[:4, 5]
        dof = max(n - 4.0, 1.0)
        variance = max(float(M[4, 4] - theta @ M[:4, 4]) / dof, MIN_NOISE_G**2)
        axial_variance = max(float(M[5, 5] - axial @ M[:4, 5]), 0.0) / dof
        radius, gz = float(theta[0]), float(axial[0])
        size = math.hypot(radius, gz)
        cos_i, sin_i = gz / size, radius / size
        span = revolutions[-1].end_s - t_ref
        drift = (theta[3] * cos_i - axial[3] * sin_i) * span
        drift_variance = inverse[3, 3] * (variance * cos_i**2 + axial_variance * sin_i**2) * span**2
        turned = sum(abs(r.angle) for r in revolutions)
        return _Fit(
            theta=theta,
            covariance=inverse * variance,
            noise_g=math.sqrt(variance),
            gz=gz,
            drift_deg=math.degrees(float(drift)),
            drift_std_deg=math.degrees(math.sqrt(max(float(drift_variance), 0.0))),
            consistency=_consistency(parts, theta, variance),
            rate_rpm=60.0 * turned / TURN / max(sum(r.end_s - r.t0 for r in revolutions), 1e-9),
        )

    def _why_not_full(self, revolution: _Revolution) -> Reason:
        """A turn was begun and not completed in the time of the slowest one."""
        counts = [count for count in revolution.counts if count]
        # a creeping tool spreads its time over what it turned; one that stopped heaps it up in one sector
        creeps = max(revolution.counts) < 3.0 * sum(counts) / max(len(counts), 1)
        return Reason.TOO_SLOW if creeps else Reason.PARTIAL_TURN

    def _decline(self, reason: Reason) -> None:
        self._restart()
        self.reason = reason
        if reason is Reason.NOT_TURNING:
            self.state = State.WAITING if self._offset is None else State.HELD
        else:
            self.state = State.DECLINED

    def _restart(self) -> None:
        self._done.clear()
        self._turning = None
        self._last_t = None
        self._last_angle = 0.0
        self._farthest = 0.0
        if self._offset is None:
            self._centre = (0.0, 0.0)
        self._noise_g = self._radius = None


_TURNED_BACK_RAD = math.radians(60.0)
"""Turning back by more than noise can."""
_STANDING_RAD = math.radians(45.0)
"""Less than this in the time of the slowest turn is a standing tool."""
_CURED_BY_FORGETTING = (Reason.INCLINATION_DRIFTS, Reason.INCONSISTENT)
"""Faults that the last few revolutions may not have though many together do."""


def _fault_of_shocks(r: _Revolution) -> Reason:
    return Reason.INCLINATION_DRIFTS if abs(r.outward) > 0.9 * r.shocks else Reason.VIBRATION


def _consistency(parts: Sequence[Array], theta: Array, variance: float) -> float:
    """How far the revolutions depart from the common circle: chi squared a degree of freedom (1 by noise alone).

    Each revolution is asked for its own radius and centre, (1, ux, uy), from what the common fit leaves.
    """
    if len(parts) < 2 or variance <= 0.0:
        return 1.0
    chi2 = 0.0
    for M in parts:
        left = M[:3, 4] - M[:3, :4] @ theta
        chi2 += float(left @ np.linalg.solve(M[:3, :3], left)) / variance
    return chi2 / _degrees_of_freedom(len(parts))


def _degrees_of_freedom(turns: int) -> float:
    """Three numbers of each revolution, less the four of the common fit."""
    return 3.0 * turns - 4.0


def _chance_limit(dof: float) -> float:
    """Chi squared a degree of freedom that chance exceeds once in ten thousand (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * dof)
    return (1.0 - part + INCONSISTENT_SIGMAS * math.sqrt(part)) ** 3


@dataclass(frozen=True, slots=True)
class RebalancedCorrection:
    """A correction with the cross-axis offset of this power-up taken off its output."""

    base: Correction
    offset: Offset

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
            (*one.flags, "rebalanced"),
        )
