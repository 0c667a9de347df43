"""From frames to attitudes: monitor, averaging window, correction, attitude with covariance, stillness, surveys.

Everything here is synchronous and follows *device* time, so that the same bytes give the same results whatever chunks
they arrive in and however fast. A batch is decoded in one call; an attitude is made when the first frame at or after
the next multiple of the output period arrives, from the readings of the averaging window that ends with that frame
(a fixed grid, no waiting for a later frame). An attitude refers to the middle of its window.

Uncertainty of a mean: the readings of a window are freed of a straight line in time (a turning tool is not noise),
the larger of the scatter that is left and the running estimate of the noise is divided by their number.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from highside.attitude.scalar import attitude_with_std
from highside.calibration.correction import Corrected, Correction, Vector
from highside.calibration.rebalance import Rebalancer
from highside.codec.frame import ByteCodec, CanCodec, Frame
from highside.config.rig import ToolfaceSettings, VibrationSettings
from highside.config.settings import (
    MonitorSettings,
    PipelineSettings,
    RebalanceTable,
    Settings,
    SurveySettings,
    ToolSettings,
)
from highside.link.base import Batch, Chunk
from highside.rotation.live import ROTOR_UNKNOWN, LiveCompensation, RotorError, mean_error
from highside.service.drift_stage import Azimuth, DriftStage
from highside.service.monitor import Monitor
from highside.service.rig.shock import ShockMeter
from highside.service.rig.surveys import Gravity, Verdict, judge

HELD_FRAMES = 32
"""Frames that are decoded at once and processed together, when one of them completes an output: ten frames in one go
cost about as much as two that come alone, each to code that has left the processor's caches."""
HELD_S = 0.1
"""How long a frame waits at most while others arrive; a link that falls silent, and whoever reads the counters, asks
for what is held."""
SMALL_WINDOW = 32
"""Readings up to which plain Python is faster than numpy's calls (12 against 45 us at 10 readings)."""
SETTLED = 20
"""Second differences from which the running estimate of the noise is a measure of it."""
MIN_OWN_SCATTER = 8
"""Readings in a window from which its own scatter is used instead of the running estimate of the noise."""
REBALANCE_BLOCK_S = 0.0095
"""Readings within this are averaged before the re-balance sees them: 1.1 deg of a turn at 20 rpm."""
SHAKING = 16.0
"""Variance in a window, in units of the sensor's own, from which the tool shakes or turns."""
QUIET_MEMORY_S = 3600.0
"""In about this time the sensor's own noise may be found to have grown."""
NOISE_MEMORY = 0.02
"""Weight of a new second difference in the running estimate of the noise."""


class Row(NamedTuple):
    """A reading in the window."""

    t: float
    a: Vector
    temp_c: float | None
    rotor: RotorError | None = None


@dataclass(frozen=True, slots=True)
class Attitude:
    """One output of the pipeline; angles in degrees, accelerations in g, times in seconds."""

    t_device_s: float
    t_mono: float
    """arrival of the last byte of the last frame used, monotonic clock"""
    inc_deg: float
    inc_std_deg: float
    tf_deg: float
    tf_std_deg: float
    toolface_deg: float
    """of the bend: that of the sensor and the offset, in [0, 360)"""
    toolface_offset_deg: float
    g_total: float
    g_total_std: float
    """of the reading and of the correction, g"""
    cal_id: str
    zone: str
    flags: tuple[str, ...]
    n: int
    window_s: float
    temp_c: float | None
    azimuth: Azimuth | None = None
    """None for a tool without gyros"""
    comp_id: str | None = None
    """of the rotor-angle compensation in force; a flag says where it was not applied"""


@dataclass(frozen=True, slots=True)
class Survey:
    """The average over a time without motion."""

    attitude: Attitude
    duration_s: float
    g_std: float
    """standard deviation of one reading, root mean square over the axes"""
    verdict: Verdict


class Cut(NamedTuple):
    """A stop that motion ended: what had been collected until then."""

    duration_s: float
    mean: Vector
    variance: Vector
    """of one reading, g^2"""
    n: int
    temp_c: float | None
    rotor: RotorError | None


@dataclass(frozen=True, slots=True)
class Window:
    """Mean of the readings in a window and the covariance of that mean (diagonal, g^2)."""

    mean: Vector
    variance: Vector
    slope_sigmas: float
    """the steepest axis' change over the window, in units of its own standard deviation"""
    span: Vector
    """change over the window along the fitted line, g"""
    scatter: Vector
    """variance of one reading about that line, g^2"""


class NoiseEstimate:
    """Running variance of one reading, an axis each, from second differences: blind to offsets and steady turns."""

    def __init__(self, known_g: float | None) -> None:
        self._known = known_g
        self._variance = [0.0, 0.0, 0.0]
        self._n = 0
        self._before: Vector | None = None
        self._last: Vector | None = None
        self._quiet: list[float] | None = None
        self._quiet_at = 0.0

    def quiet(self, t: float) -> Vector:
        """The sensor's own share of the variance: the least that was seen, forgotten slowly; ask at rising times."""
        now = self.variance
        if self._known is not None or self._n < SETTLED:
            return now
        if self._quiet is None:
            self._quiet, self._quiet_at = list(now), t
        share = min(max(t - self._quiet_at, 0.0) / QUIET_MEMORY_S, 1.0)
        self._quiet_at = t
        for axis in range(3):
            before = self._quiet[axis]
            self._quiet[axis] = min(now[axis], before + share * (now[axis] - before))
        return (self._quiet[0], self._quiet[1], self._quiet[2])

    def add(self, a: Vector) -> None:
        before, last = self._before, self._last
        if before is not None and last is not None:
            self._n += 1
            weight = max(NOISE_MEMORY, 1.0 / self._n)
            for axis in range(3):
                second = a[axis] - 2.0 * last[axis] + before[axis]
                self._variance[axis] += weight * (second * second / 6.0 - self._variance[axis])
        self._before, self._last = last, a

    def forget(self) -> None:
        """The stream was interrupted: the next reading does not follow the last one."""
        self._before = self._last = None

    @property
    def variance(self) -> Vector:
        """Variance of one reading an axis, g^2."""
        if self._known is not None:
            known = self._known * self._known
            return (known, known, known)
        return (self._variance[0], self._variance[1], self._variance[2])


class Stillness:
    """Collects readings for as long as window means stay where they were, within their own noise."""

    def __init__(self, settings: SurveySettings) -> None:
        self._settings = settings
        self._restart()

    def _restart(self) -> None:
        self._n = 0
        self._windows = 0
        self._sum = [0.0, 0.0, 0.0]
        self._sum2 = [0.0, 0.0, 0.0]
        self._reference: Vector = (0.0, 0.0, 0.0)
        self._temp_sum, self._temp_n = 0.0, 0
        self._rotor: list[RotorError | None] = []
        """the mean of each window"""
        self._start_s = self._end_s = 0.0
        self.reported = False

    def forget(self) -> None:
        """A gap or a device reset: stillness begins anew."""
        self._restart()

    def again(self) -> None:
        """The stop goes on, but what was collected is not to be used: collect anew."""
        self._restart()

    def cut(self) -> Cut | None:
        """What is collected, to be kept before motion takes it away; None: nothing."""
        return Cut(self._end_s - self._start_s, *self.mean(), mean_error(self._rotor)) if self._n else None

    def add(self, window: Window, frames: list[Row], own: Vector) -> float:
        """Take a window and the frames that are new in it; returns the seconds of stillness so far (0: it moved).

        `own` is the variance of one reading that is the sensor's own, g^2 an axis. A turning tool whose means stand
        still (a whole turn in a window) betrays itself by more scatter than that.
        """
        settings = self._settings
        floor = settings.floor_g**2
        for scatter, noise in zip(window.scatter, own, strict=True):
            if scatter > max(SHAKING * noise, floor) or scatter > settings.max_noise_g**2:
                self._restart()
                return 0.0
        if self._n:
            n = self._n
            for axis in range(3):
                departure = abs(window.mean[axis] - self._reference[axis] - self._sum[axis] / n)
                sigma = math.sqrt(window.variance[axis] * (1.0 + 1.0 / self._windows))
                if departure > max(settings.sigma * sigma, settings.floor_g):
                    self._restart()
                    return 0.0
        if window.slope_sigmas > settings.sigma and max(abs(s) for s in window.span) > settings.floor_g:
            self._restart()
            return 0.0
        if not frames:
            return 0.0
        if not self._n:
            self._reference = frames[0].a
            self._start_s = frames[0].t
        for frame in frames:
            for axis in range(3):
                d = frame.a[axis] - self._reference[axis]
                self._sum[axis] += d
                self._sum2[axis] += d * d
            if frame.temp_c is not None:
                self._temp_sum += frame.temp_c
                self._temp_n += 1
        self._n += len(frames)
        self._windows += 1
        if frames[-1].rotor is not None:
            self._rotor.append(mean_error(frame.rotor for frame in frames))
        self._end_s = frames[-1].t
        return self._end_s - self._start_s

    def mean(self) -> tuple[Vector, Vector, int, float | None]:
        """Mean (g), variance of one reading (g^2), number of readings, mean temperature."""
        n = self._n
        mean = [s / n for s in self._sum]
        variance = [max(s2 / n - m * m, 0.0) * n / max(n - 1, 1) for s2, m in zip(self._sum2, mean, strict=True)]
        temp = self._temp_sum / self._temp_n if self._temp_n else None
        where = [m + r for m, r in zip(mean, self._reference, strict=True)]
        return (where[0], where[1], where[2]), (variance[0], variance[1], variance[2]), n, temp


class _Block:
    """Readings averaged before the re-balance sees them, which needs no more than a hundred a second."""

    def __init__(self) -> None:
        self._n = 0
        self._sum = [0.0, 0.0, 0.0]
        self._t_sum = 0.0
        self.start = self.t = 0.0
        self._temp_c: float | None = None

    def add(self, t: float, a: Vector, temp_c: float | None) -> None:
        if not self._n:
            self.start = self.t if t - self.t < 2.0 * REBALANCE_BLOCK_S else t
        self.t = t
        self._n += 1
        self._t_sum += t
        self._sum[0] += a[0]
        self._sum[1] += a[1]
        self._sum[2] += a[2]
        self._temp_c = temp_c

    def take(self) -> tuple[float, Vector, float | None]:
        """Mean time, mean reading, last temperature; begins a new block."""
        n, (x, y, z) = self._n, self._sum
        mean = (self._t_sum / n, (x / n, y / n, z / n), self._temp_c)
        self._n, self._t_sum, self._sum = 0, 0.0, [0.0, 0.0, 0.0]
        return mean


class Pipeline:
    """Takes batches from a link and hands attitudes and surveys to `emit`.

    Other settings, another calibration or compensation: `successor` takes this one's place between two batches.
    """

    def __init__(
        self,
        *,
        codec: ByteCodec | CanCodec,
        tool: ToolSettings,
        pipeline: PipelineSettings,
        monitor: MonitorSettings,
        survey: SurveySettings,
        correction: Correction,
        rebalance: RebalanceTable,
        emit: Callable[[Attitude | Survey], None],
        vibration: VibrationSettings | None = None,
        toolface: ToolfaceSettings | None = None,
        drift: DriftStage | None = None,
        rotation: LiveCompensation | None = None,
    ) -> None:
        self.codec = codec
        self._rotation = rotation
        self.drift = drift
        """the azimuth, for tools with gyros"""
        self._correction = correction
        self._rebalance = rebalance
        self.rebalancer = Rebalancer(rebalance.build())
        self._block = _Block()
        self._gyro_rotor: tuple[float | None, float | None] = (None, None)
        """rotor angle and rate (deg, deg/s) at the reading that the azimuth refers to"""
        self.monitor = Monitor(
            seq_modulus=codec.seq_modulus, range_g=monitor.range_g, stuck_frames=monitor.stuck_frames
        )
        self.shock = ShockMeter(vibration or VibrationSettings())
        self.gravity = Gravity(1.0, 0.0, 1e3)
        """what Gtotal should be at this site; the service knows"""
        self.toolface_offset_deg = 0.0
        self._toolface = toolface or ToolfaceSettings()
        self._held: list[Frame] = []
        """decoded, not yet processed"""
        self._refusals = 0
        """surveys refused at this stop: the next one waits the longer"""
        self.attitudes = 0
        self.surveys = 0
        self.extra_flags: tuple[str, ...] = ()
        """flags that the service adds to every output, such as `calibration_refused`"""
        self._emit = emit
        self._settings = pipeline
        self._survey_settings = survey
        self._noise = NoiseEstimate(tool.noise_g)
        self._stillness = Stillness(survey)
        self._window: deque[Row] = deque()
        self._fresh = 0
        self._due: float | None = None
        self._last_t: float | None = None
        self._last_step = 0.0
        self._device_has_time = False

    @property
    def correction(self) -> Correction:
        """The calibration in force. Setting one with another id also forgets the offset found with the old one."""
        return self._correction

    @correction.setter
    def correction(self, correction: Correction) -> None:
        if correction.cal_id != self._correction.cal_id:
            self.rebalancer = Rebalancer(self._rebalance.build())
        self._correction = correction

    @property
    def rotation(self) -> LiveCompensation | None:
        """The compensation by rotor angle in force. What another one said of earlier frames is not used."""
        return self._rotation

    @rotation.setter
    def rotation(self, rotation: LiveCompensation | None) -> None:
        before = None if self._rotation is None else self._rotation.id
        self._rotation = rotation
        if before != (None if rotation is None else rotation.id):
            self._window = deque(row._replace(rotor=None) for row in self._window)
            self._gyro_rotor = (None, None)
            self._stillness = Stillness(self._survey_settings)

    def successor(
        self,
        before: Settings,
        settings: Settings,
        *,
        correction: Correction,
        rotation: LiveCompensation | None,
        drift: DriftStage | None,
    ) -> Pipeline:
        """A pipeline under new `settings` that goes on where this one, made under `before`, stands.

        This one is left as it is, so that it can go on if the successor is not wanted. Codec, counters and window are
        the same objects: between two batches one takes the other's place, and only one of them is given batches. What
        a setting decides is made anew where that setting has changed.
        """
        self.process_held()
        new = copy.copy(self)
        new._held = []
        new.drift = drift
        # the codec and its counters go on: not a byte is lost for a new limit
        new.monitor = copy.copy(self.monitor)
        new.monitor.apply(range_g=settings.monitor.range_g, stuck_frames=settings.monitor.stuck_frames)
        if settings.rebalance != before.rebalance:
            new._rebalance = settings.rebalance
            new.rebalancer, new._block = Rebalancer(settings.rebalance.build()), _Block()
        if settings.vibration != before.vibration:
            new.shock = ShockMeter(settings.vibration)
        new._toolface = settings.toolface
        made_of = (settings.tool, settings.pipeline, settings.survey)
        if made_of != (before.tool, before.pipeline, before.survey):
            new._settings, new._survey_settings = settings.pipeline, settings.survey
            new._noise = NoiseEstimate(settings.tool.noise_g)
            new._stillness = Stillness(settings.survey)
            new._due = None
        new.correction = correction
        new.rotation = rotation
        return new

    def on_batch(self, batch: Batch) -> int:
        """Decode and process a batch; returns the number of frames in it."""
        if isinstance(batch, Chunk):
            frames = self.codec.receive(batch.data, batch.t_mono)  # type: ignore[union-attr]
        else:
            frames = self.codec.receive_can(batch)  # type: ignore[union-attr]
        if frames:
            held, last = self._held, frames[-1]
            held += frames
            t, due = last.t_mono if last.t_s is None else last.t_s, self._due
            # an output is due, or time went back (a reset), or it is simply time
            if (
                due is None
                or not due - 2.0 / self._settings.output_rate_hz <= t < due
                or len(held) >= HELD_FRAMES
                or last.t_mono - held[0].t_mono >= HELD_S
            ):
                self.process_held()
        return len(frames)

    def process_held(self) -> None:
        """Process what was decoded and waits for the next output: before counters are read or anything is changed."""
        held, self._held = self._held, []
        for frame in held:
            self.on_frame(frame)

    def on_link_reopened(self) -> None:
        """The link was interrupted: nothing pending will be completed."""
        self.process_held()
        self.codec.reset()
        self.monitor.link_reopened()
        self._noise.forget()
        self._stillness.forget()

    def finish(self) -> None:
        """The input has ended: what the codec still holds is processed."""
        self.process_held()
        for frame in self.codec.flush():
            self.on_frame(frame)

    def on_frame(self, frame: Frame) -> None:
        """Process one frame."""
        beyond = self.monitor.counts.out_of_range
        if not self.monitor.check(frame):
            if self.monitor.counts.out_of_range != beyond:
                self.shock.add(frame.t_mono if frame.t_s is None else frame.t_s, frame.ax, frame.ay, frame.az)
            return
        t = frame.t_s
        last = self._last_t
        if t is not None:
            self._device_has_time = True
        elif self._device_has_time and last is not None:
            # this frame's time was damaged: the tool goes on at its pace
            t = last + self._last_step
        else:
            t = frame.t_mono
        if last is not None:
            step = t - last
            if step < 0.0:
                self._begin_anew()
            elif step > self._settings.window_s and 0.0 < 3.0 * self._last_step < step:
                # nothing came for a while: who knows what the tool did meanwhile
                self._noise.forget()
                self._stillness.forget()
            self._last_step = step
        self._last_t = t
        a = (frame.ax, frame.ay, frame.az)
        self._noise.add(a)
        self.shock.add(t, *a)
        window, oldest = self._window, t - self._settings.window_s
        while window and window[0].t < oldest:
            window.popleft()
        rotor = None if self._rotation is None else self._rotation.at(frame.rotor_deg, frame.rotor_rate_dps)
        window.append(Row(t, a, frame.temp_c, rotor))
        self._fresh += 1
        self._block.add(t, a, frame.temp_c)
        if self.drift is not None and frame.gx is not None and frame.gy is not None and frame.gz is not None:
            self.drift.add(frame.gx, frame.gy, frame.gz)
        if self._block.t - self._block.start >= REBALANCE_BLOCK_S:
            self._close_block(frame)
        if self._due is None:
            self._due = self._next_due(t)
        elif t >= self._due:
            self._due = self._next_due(t)
            self._output(frame, t)

    def _close_block(self, frame: Frame) -> None:
        block = self._block
        t, mean, temp = block.take()
        corrected = self._correction.correct(mean, temp_c=temp)
        self.rebalancer.add(t, corrected.gx, corrected.gy, corrected.gz)
        if self.drift is not None:
            if self._rebalance.apply:
                corrected = self._in_force().correct(mean, temp_c=temp)
            gx, gy, gz = corrected.gx, corrected.gy, corrected.gz
            heading: float | None = 0.0
            if self._rotation is not None and self._rotation.corrects_heading:
                self._gyro_rotor = frame.rotor_deg, frame.rotor_rate_dps
                said = self._rotation.heading(*self._gyro_rotor, math.atan2(math.hypot(gx, gy), gz))
                heading = None if ROTOR_UNKNOWN in said.flags else said.error_rad
            self.drift.close(block.t, frame.t_mono, (gx, gy, gz), heading)

    def _begin_anew(self) -> None:
        # the device began again: a new power-up has a new turn-on bias
        self.rebalancer.reset()
        if self.drift is not None:
            self.drift.device_restarted()
        self._block = _Block()
        self._window.clear()
        self._fresh = 0
        self._due = None
        self._noise.forget()
        self._stillness.forget()

    def _next_due(self, t: float) -> float:
        rate = self._settings.output_rate_hz
        # the small addend keeps a frame that lies on the grid but for rounding from making two outputs
        return (math.floor(t * rate + 1e-6) + 1.0) / rate

    def _output(self, frame: Frame, t: float) -> None:
        window = self._window
        oldest = t - self._settings.window_s * (1.0 - 1e-6)
        while window[0].t <= oldest and len(window) > 1:
            window.popleft()
        rows = list(window)
        statistics = window_statistics(rows, self._noise.variance)
        flags: list[str] = []
        if statistics.slope_sigmas > 6.0 and max(abs(s) for s in statistics.span) > self._survey_settings.floor_g:
            flags.append("moving")
        xx, yy, zz = statistics.variance
        temps = [row.temp_c for row in rows if row.temp_c is not None]
        temp = sum(temps) / len(temps) if temps else None
        corrected = self._in_force().correct(statistics.mean, (xx, 0.0, 0.0, yy, 0.0, zz), temp)
        rotor = None if self._rotation is None else mean_error(row.rotor for row in rows)
        attitude = self._attitude(corrected, frame, t, len(rows), t - rows[0].t, temp, flags, rotor)
        self.attitudes += 1
        self._emit(attitude)
        if self._survey_settings.enabled:
            fresh = rows[-min(self._fresh, len(rows)) :]
            self._watch_stillness(statistics, fresh, frame, t)
        self._fresh = 0

    def _in_force(self) -> Correction:
        return self.rebalancer.wrap(self._correction) if self._rebalance.apply else self._correction

    def _watch_stillness(self, window: Window, fresh: list[Row], frame: Frame, t: float) -> None:
        still, settings = self._stillness, self._survey_settings
        before = None if still.reported else still.cut()
        if max(self.shock.since_g) > settings.accept.shock_g:
            # a jolt ends the average, whether or not the mean has moved
            still.forget()
            duration = 0.0
        else:
            duration = still.add(window, fresh, self._noise.quiet(t))
        if duration <= 0.0:
            least = settings.still_s * settings.accept.min_still_share
            if before is not None and before.duration_s >= least and not self._refusals:
                self._survey(before, frame, t, complete=False)
            self._refusals = 0
            self.shock.begin_watch()
            return
        # after a refusal the stop is given another chance, then another after twice the wait, and so on
        if still.reported or duration < settings.still_s * 2.0 ** min(max(self._refusals - 1, 0), 8):
            return
        stop = still.cut()
        if stop is None or self._survey(stop, frame, t, complete=True):
            still.reported = True
        else:
            self._refusals += 1
            still.again()
            self.shock.begin_watch()

    def _survey(self, stop: Cut, frame: Frame, t: float, *, complete: bool) -> bool:
        """Make a survey of a stop; returns whether nothing more is to be had of it."""
        duration, mean, variance, n, temp, rotor = stop
        if not any(variance):
            # not one bit of noise in all that time: a dead converter, not a still tool
            return True
        noise = tuple(v / n for v in variance)
        corrected = self._in_force().correct(mean, (noise[0], 0.0, 0.0, noise[1], 0.0, noise[2]), temp)
        attitude = self._attitude(corrected, frame, t, n, duration, temp, [], rotor)
        accept = self._survey_settings.accept
        verdict = judge(attitude, self.gravity, accept, max(self.shock.since_g), complete=complete)
        self.surveys += 1
        self._emit(Survey(attitude, duration, math.sqrt(sum(variance) / 3.0), verdict))
        return verdict.accepted

    def _attitude(
        self,
        corrected: Corrected,
        frame: Frame,
        t: float,
        n: int,
        window_s: float,
        temp: float | None,
        flags: list[str],
        rotor: RotorError | None,
    ) -> Attitude:
        gx, gy, gz = corrected.gx, corrected.gy, corrected.gz
        g_total = math.sqrt(gx * gx + gy * gy + gz * gz)
        g_total_std = math.nan
        if math.isnan(g_total):
            # no correction holds here (its flag says so): no angle, rather than a wrong one
            inc = inc_std = tf = tf_std = felt_inc = math.nan
        else:
            xx, xy, xz, yy, yz, zz = corrected.cov
            along = gx * gx * xx + gy * gy * yy + gz * gz * zz + 2.0 * (gx * gy * xy + gx * gz * xz + gy * gz * yz)
            g_total_std = math.sqrt(max(along, 0.0)) / g_total if g_total > 0.0 else math.nan
            result = attitude_with_std(gx, gy, gz, corrected.cov)
            inc, inc_std, tf, tf_std = result.inc_rad, result.inc_std_rad, result.tf_rad, result.tf_std_rad
            felt_inc = inc
            if self._rotation is not None:
                inc, tf, own_inc, own_tf, said = self._rotation.apply(inc, tf, rotor)
                inc_std, tf_std = math.hypot(inc_std, own_inc), math.hypot(tf_std, own_tf)
                flags.extend(said)
            if result.toolface_undefined:
                flags.append("toolface_undefined")
            low = self._toolface.low_inclination_deg
            if not low <= math.degrees(inc) <= 180.0 - low:
                flags.append("low_inclination")
        if abs(g_total - 1.0) > self._settings.g_tolerance:
            flags.append("g_total")
        flags.extend(f"stuck_{axis}" for axis in self.monitor.stuck_axes)
        if self.monitor.frozen:
            flags.append("frozen")
        azimuth = None if self.drift is None else self._azimuth(self.drift, t, felt_inc)
        if azimuth is not None:
            flags.extend(flag for flag in azimuth.flags if flag not in flags)
        return Attitude(
            t_device_s=t,
            t_mono=frame.t_mono,
            inc_deg=math.degrees(inc),
            inc_std_deg=math.degrees(inc_std),
            tf_deg=math.degrees(tf),
            tf_std_deg=math.degrees(tf_std),
            toolface_deg=(math.degrees(tf) + self.toolface_offset_deg) % 360.0,
            toolface_offset_deg=self.toolface_offset_deg,
            g_total=g_total,
            g_total_std=g_total_std,
            cal_id=self._correction.cal_id,
            zone=corrected.zone,
            flags=(*corrected.flags, *flags, *self.extra_flags),
            n=n,
            window_s=window_s,
            temp_c=temp,
            azimuth=azimuth,
            comp_id=None if self._rotation is None else self._rotation.id,
        )

    def _azimuth(self, drift: DriftStage, t: float, inc_rad: float) -> Azimuth | None:
        """The azimuth, freed of the rotor's error where there is something to free."""
        azimuth, rotation = drift.azimuth(t), self._rotation
        if azimuth is None or azimuth.azi_deg is None or rotation is None or not rotation.corrects_heading:
            return azimuth
        error, own_std, said = rotation.heading(*self._gyro_rotor, inc_rad)
        std = azimuth.azi_std_deg
        return Azimuth(
            (azimuth.azi_deg - math.degrees(error)) % 360.0,
            None if std is None else math.hypot(std, math.degrees(own_std)),
            azimuth.basis,
            azimuth.flags + said,
        )


def window_statistics(rows: list[Row], noise_variance: Vector) -> Window:
    """Mean, variance of the mean, and drift over a window.

    The variance (g^2) of the mean is the scatter about a straight line in time, or `noise_variance` (of one reading)
    if that is larger, divided by n; with fewer than 8 readings it is `noise_variance` divided by n.
    """
    n = len(rows)
    if MIN_OWN_SCATTER <= n <= SMALL_WINDOW:
        return _small_window(rows, noise_variance)
    if n >= MIN_OWN_SCATTER:
        time = np.array([row.t for row in rows])
        time -= time.mean()
        a = np.array([row.a for row in rows]).T
        mean = a.mean(axis=1)
        centred = a - mean[:, None]
        tt = float(time @ time)
        slope = centred @ time / tt if tt > 0.0 else np.zeros(3)
        rest = np.einsum("ij,ij->i", centred, centred) - slope * slope * tt
        scatter = np.maximum(rest, 0.0) / (n - 2)
        # few degrees of freedom may show far too little scatter by chance
        own = [max(float(s), v) for s, v in zip(scatter, noise_variance, strict=True)]
        span = slope * (time[-1] - time[0])
        sigma_slope = np.sqrt(np.maximum(own, 1e-18) / tt) if tt > 0.0 else np.full(3, np.inf)
        return Window(
            (float(mean[0]), float(mean[1]), float(mean[2])),
            (own[0] / n, own[1] / n, own[2] / n),
            float(np.max(np.abs(slope) / sigma_slope)) if tt > 0.0 else 0.0,
            (float(span[0]), float(span[1]), float(span[2])),
            (float(scatter[0]), float(scatter[1]), float(scatter[2])),
        )
    mean3 = [sum(row.a[axis] for row in rows) / n for axis in range(3)]
    span3 = [rows[-1].a[axis] - rows[0].a[axis] for axis in range(3)]
    sigmas = max(abs(s) / math.sqrt(2.0 * v) if v > 0.0 else 0.0 for s, v in zip(span3, noise_variance, strict=True))
    return Window(
        (mean3[0], mean3[1], mean3[2]),
        (noise_variance[0] / n, noise_variance[1] / n, noise_variance[2] / n),
        sigmas,
        (span3[0], span3[1], span3[2]),
        noise_variance,
    )


def _small_window(rows: list[Row], noise_variance: Vector) -> Window:
    """The same without numpy, whose calls cost more than the sums of a few readings."""
    n = len(rows)
    middle = math.fsum(row.t for row in rows) / n
    times = [row.t - middle for row in rows]
    tt = math.fsum([t * t for t in times])
    means, variances, spans, scatters, sigmas = [], [], [], [], 0.0
    for axis in range(3):
        values = [row.a[axis] for row in rows]
        mean = math.fsum(values) / n
        centred = [value - mean for value in values]
        slope = sum([c * t for c, t in zip(centred, times, strict=True)]) / tt if tt > 0.0 else 0.0
        rest = sum([c * c for c in centred]) - slope * slope * tt
        scatter = max(rest, 0.0) / (n - 2)
        # few degrees of freedom may show far too little scatter by chance
        own = max(scatter, noise_variance[axis])
        if tt > 0.0:
            sigmas = max(sigmas, abs(slope) / math.sqrt(max(own, 1e-18) / tt))
        means.append(mean)
        variances.append(own / n)
        spans.append(slope * (times[-1] - times[0]))
        scatters.append(scatter)
    return Window(
        (means[0], means[1], means[2]),
        (variances[0], variances[1], variances[2]),
        sigmas,
        (spans[0], spans[1], spans[2]),
        (scatters[0], scatters[1], scatters[2]),
    )
