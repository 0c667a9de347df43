"""From readings to windows: stillness, temperature and the sense of turning, on the tool's own time.

Windows hold a fixed number of readings, whatever batches they came in. A jump of the tool's time, forward or back, ends
the window under way and whatever hold was in progress.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.bench.session.guidance import handedness
from highside.bench.session.plans import Limits, TemperatureStage
from highside.bench.session.stillness import (
    MIN_WINDOW_READINGS,
    WINDOW_S,
    AllanCurve,
    ReadingWindow,
    RunningNoiseFloor,
    StillnessMonitor,
    make_window,
)
from highside.codec.frame import Frame

RATE_READINGS = 12
GAP_S = 0.5
GAP_READINGS = 6.0
RANGE_G = 20.0
MIN_TURN_RAD2 = 5e-3
"""Sum of the squared turns of windows before the sense of turning is judged: a quarter turn at any usual rate."""
TRACE = 200


class Gap(NamedTuple):
    """Readings are missing here, or the tool's time jumped."""

    missing_s: float


class Tracker:
    """Cuts the stream into windows and keeps what is known of noise, temperature and sense of turning."""

    def __init__(self, limits: Limits, known_noise_g: float | None = None) -> None:
        self._limits = limits
        self.floor = RunningNoiseFloor(known_noise_g)
        self.allan = AllanCurve()
        self.stillness = StillnessMonitor(self.floor, self.allan)
        self.rate_hz: float | None = None
        self.trace: deque[float] = deque(maxlen=TRACE)
        self.latest: ReadingWindow | None = None
        self.temp_c: float | None = None
        self.lost = 0
        self._pending: list[tuple[float, float, float, float, float | None, tuple[float, float, float] | None]] = []
        self._last_t: float | None = None
        self._window_n = 0
        self._temps: deque[tuple[float, float]] = deque(maxlen=20_000)
        self._last_mean: Array | None = None
        self._agree = [0.0, 0.0]

    def forget(self) -> None:
        """The stream was interrupted: nothing that follows belongs to what was before."""
        self._pending.clear()
        self._last_t = None
        self._last_mean = None
        self.stillness.forget()

    def windows(self, frames: Sequence[Frame]) -> Iterator[ReadingWindow | Gap]:
        """The windows that these frames complete, in order. Readings that are no numbers are omitted."""
        for frame in frames:
            t = frame.t_s if frame.t_s is not None else frame.t_mono
            x, y, z = frame.ax, frame.ay, frame.az
            if not (abs(x) <= RANGE_G and abs(y) <= RANGE_G and abs(z) <= RANGE_G):
                self.lost += 1
                continue
            if self._last_t is not None:
                step = t - self._last_t
                if step == 0.0:
                    continue  # the same frame again
                allowed = GAP_S if self.rate_hz is None else max(GAP_S, GAP_READINGS / self.rate_hz)
                if not 0.0 < step <= allowed and (self.rate_hz is not None or step < 0.0 or step > 60.0):
                    self.forget()
                    yield Gap(step)
            self._last_t = t
            gyro = None
            if frame.gx is not None and frame.gy is not None and frame.gz is not None:
                gyro = (frame.gx, frame.gy, frame.gz)
            self._pending.append((t, x, y, z, frame.temp_c, gyro))
            if self.rate_hz is None and len(self._pending) >= RATE_READINGS:
                steps = np.diff([row[0] for row in self._pending])
                self.rate_hz = float(1.0 / np.median(steps))
                self._window_n = max(MIN_WINDOW_READINGS, round(WINDOW_S * self.rate_hz))
            if self.rate_hz is not None and len(self._pending) >= self._window_n:
                rows, self._pending = self._pending[: self._window_n], self._pending[self._window_n :]
                yield self._complete(rows)

    def _complete(
        self, rows: list[tuple[float, float, float, float, float | None, tuple[float, float, float] | None]]
    ) -> ReadingWindow:
        temps = [row[4] for row in rows if row[4] is not None]
        temp = sum(temps) / len(temps) if temps else None
        window = make_window(rows[-1][0], np.array([row[1:4] for row in rows]).T, temp)
        if temp is not None:
            self.temp_c = temp
            if not self._temps or window.t_s - self._temps[-1][0] >= 1.0 or window.t_s < self._temps[-1][0]:
                self._temps.append((window.t_s, temp))
        gyros = [row[5] for row in rows if row[5] is not None]
        if self._last_mean is not None and len(gyros) == len(rows):
            turned = np.deg2rad(np.mean(gyros, axis=0)) * self.window_s
            middle = 0.5 * (window.mean + self._last_mean)
            for k, value in enumerate(handedness(middle, window.mean - self._last_mean, turned)):
                self._agree[k] += value
        self._last_mean = window.mean
        self.latest = window
        return window

    def judge(self, window: ReadingWindow, hold: Array | None) -> float:
        """Stillness of the newest window, and its trace."""
        value = self.stillness.add(window, hold)
        self.trace.append(min(value, 99.0))
        return value

    @property
    def window_s(self) -> float:
        return WINDOW_S if self.rate_hz is None else self._window_n / self.rate_hz

    def mirrored(self) -> bool | None:
        """Whether the moves so far turned the opposite way by rate sensors and accelerometers; None: not known yet."""
        agreeing, size = self._agree
        if size < MIN_TURN_RAD2:
            return None
        return agreeing < -0.3 * size

    def at_temperature(self, stage: TemperatureStage) -> bool:
        """Whether the temperature of a stage is reached, and steady where that is requested."""
        if stage.temp_c is None:
            return True
        limits = self._limits
        if self.temp_c is None or abs(self.temp_c - stage.temp_c) > limits.temp_tolerance_c:
            return False
        if not stage.steady:
            return True
        end = self._temps[-1][0]
        if end - self._temps[0][0] < limits.soak_s:
            return False
        part = np.array([row for row in self._temps if end - row[0] <= limits.soak_s])
        if len(part) < 3:
            return False
        if float(np.max(np.abs(part[:, 1] - stage.temp_c))) > limits.temp_tolerance_c:
            return False
        minutes = (part[:, 0] - part[0, 0]) / 60.0
        centred = minutes - minutes.mean()
        slope = float(centred @ part[:, 1] / (centred @ centred))
        # the slope of a thermometer of 0.01 deg steps is no better than this
        doubt = 0.02 / max(float(minutes[-1]), 1e-9)
        return abs(slope) <= limits.temp_rate_c_min + doubt

    def left_temperature(self, stage: TemperatureStage) -> bool:
        """Whether a steady stage is lost."""
        if stage.temp_c is None or not stage.steady or self.temp_c is None:
            return False
        return abs(self.temp_c - stage.temp_c) > 2.0 * self._limits.temp_tolerance_c
