"""One hold: the readings averaged while the tool lies still at a pose, and whether they are valid.

The mean is good enough when its standard error, with the coloured noise that the session has found so far, is below the
plan's. A hold is refused where the tool shook, crept by more than both noise and the bench's own repeatability, lost
readings, or where the sensor gave the same number over and over.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.bench.session.entries import HoldReadings
from highside.bench.session.plans import Limits
from highside.bench.session.reasons import Rejection
from highside.bench.session.stillness import AllanCurve, ReadingWindow, RunningNoiseFloor, drift_sigmas

DRIFT_SIGMAS = 6.0
MAX_GAP_S = 0.5
MAX_LOST_SHARE = 0.05
NOT_ONE_G_SIGMAS = 8.0
TRIM_PIECE = 2
MIN_TRIMMED = 8


class Hold:
    """Collects windows; `pose` is the pose taken for (None where poses are found by themselves)."""

    def __init__(
        self, pose: str | None, floor: RunningNoiseFloor, allan: AllanCurve, limits: Limits, rate_hz: float
    ) -> None:
        self.pose = pose
        self._floor = floor
        self._allan = allan
        self._limits = limits
        self._rate = rate_hz
        self.windows: list[ReadingWindow] = []
        self.disturbed = 0
        """windows omitted from a hold that was continued"""
        self._mean = np.zeros(3)

    def add(self, window: ReadingWindow) -> None:
        self.windows.append(window)
        self._mean += (window.mean - self._mean) / len(self.windows)

    @property
    def mean(self) -> Array:
        """(3,), zero for an empty hold."""
        return self._mean

    def trim(self) -> None:
        """Leave windows out at either end that do not agree with the middle: the way in and the way out, in a hold
        whose limits nobody knew."""
        noise = self._floor.value
        if noise is None or not self.windows:
            return
        while len(self.windows) > MIN_TRIMMED:
            means = self.means()
            quarter = len(self.windows) // 4
            middle = np.median(means[:, quarter : len(self.windows) - quarter], axis=1)
            limit = 6.0 * np.sqrt(self._one() / TRIM_PIECE) + 0.5 * noise
            if np.any(np.abs(means[:, :TRIM_PIECE].mean(axis=1) - middle) > limit):
                del self.windows[0]
            elif np.any(np.abs(means[:, -TRIM_PIECE:].mean(axis=1) - middle) > limit):
                del self.windows[-1]
            else:
                break
        self._mean = self.means().mean(axis=1)

    @property
    def readings(self) -> int:
        return sum(window.a.shape[1] for window in self.windows)

    @property
    def elapsed_s(self) -> float:
        return self.readings / self._rate

    def means(self) -> Array:
        """Window means (3, K)."""
        return np.array([window.mean for window in self.windows]).T.reshape(3, -1)

    def _one(self) -> Array:
        """White variance (3,) of a window's mean."""
        noise = self._floor.value
        own = np.sqrt(np.mean([w.scatter**2 for w in self.windows], axis=0))
        return np.asarray(np.maximum(own, 0.0 if noise is None else noise) ** 2 / self.windows[-1].a.shape[1])

    def std_error(self) -> Array:
        """Standard error (3,) of the mean so far, coloured noise in it."""
        curve = self._allan.with_hold(self.means())
        return np.asarray(np.sqrt(curve.variance_of_mean(len(self.windows), self._one())))

    @property
    def long_enough(self) -> bool:
        return self.elapsed_s >= self._limits.min_hold_s

    def full(self) -> bool:
        """Good enough, or as long as allowed."""
        if not self.long_enough:
            return False
        if self.elapsed_s >= self._limits.max_hold_s:
            return True
        return bool(np.max(self.std_error()) <= self._limits.std_error_g)

    def progress(self) -> float:
        """0 to 1: by time at first, then by the standard error, which falls with the root of time."""
        if not self.windows:
            return 0.0
        by_time = self.elapsed_s / self._limits.min_hold_s
        error = float(np.max(self.std_error()))
        by_error = (self._limits.std_error_g / error) ** 2 if error > 0 else 1.0
        return float(min(1.0, by_time, max(by_error, self.elapsed_s / self._limits.max_hold_s)))

    def verdict(self) -> tuple[Rejection, str] | None:
        """Why it is not valid, or None."""
        limits = self._limits
        if not self.windows or not self.long_enough:
            return Rejection.TOO_SHORT, f"{self.elapsed_s:.1f} of {limits.min_hold_s:g} s"
        if all(window.frozen for window in self.windows):
            return Rejection.FROZEN, ""
        span_s = self.windows[-1].t_s - self.windows[0].t_s
        expected = span_s * self._rate + self.windows[0].a.shape[1]
        if not self.disturbed and self.readings < (1.0 - MAX_LOST_SHARE) * expected:
            return Rejection.GAP, f"{self.readings} of {expected:.0f} readings"
        noise = self._floor.value
        if noise is not None:
            own = np.sqrt(np.mean([w.scatter**2 for w in self.windows], axis=0))
            worst = int(np.argmax(own / noise))
            count = self.readings
            if own[worst] > noise[worst] * (1.3 + 4.0 / np.sqrt(count)):
                return (
                    Rejection.SHAKEN,
                    f"{'xyz'[worst]} scatters {own[worst] / noise[worst]:.1f} times its noise at rest",
                )
        sigmas, change = drift_sigmas(self.means(), self._one())
        harmless = float(np.deg2rad(limits.pose_sigma_deg))
        if self.pose is None:
            # only |g| counts: a tool that sinks into its support by an angle d shortens the mean by d^2 / 24
            harmless = float(np.sqrt(24.0 * limits.std_error_g))
        if sigmas > DRIFT_SIGMAS and float(np.max(np.abs(change))) > harmless:
            return Rejection.CREEPING, f"{1e6 * float(np.max(np.abs(change))):.0f} ug during the hold"
        size = float(np.linalg.norm(self._mean))
        allowed = NOT_ONE_G_SIGMAS * float(np.hypot(limits.prior_offset_g, limits.prior_matrix))
        if abs(size - 1.0) > allowed:
            return Rejection.NOT_ONE_G, f"{size:.4f} g"
        return None

    def result(self) -> HoldReadings:
        """The raw readings and what is known of them."""
        a = np.concatenate([window.a for window in self.windows], axis=1)
        temps = [window.temp_c for window in self.windows if window.temp_c is not None]
        first = self.windows[0]
        error = self.std_error()
        return HoldReadings(
            a=(tuple(a[0].tolist()), tuple(a[1].tolist()), tuple(a[2].tolist())),
            t_start_s=float(first.t_s - (first.a.shape[1] - 1) / self._rate),
            t_stop_s=float(self.windows[-1].t_s),
            temp_c=float(np.mean(temps)) if temps else None,
            std_error_g=(float(error[0]), float(error[1]), float(error[2])),
        )

    def learn(self) -> None:
        """An accepted hold teaches how the means drift at rest."""
        self._allan.add(self.means())
