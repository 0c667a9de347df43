"""From frames to attitudes: monitor, averaging window, correction, attitude with covariance, stillness, surveys.

Everything here is synchronous and follows *device* time, so that the same bytes give the same results whatever chunks
they arrive in and however fast. A batch is decoded in one call; an attitude is made when the first frame at or after
the next multiple of the output period arrives, from the readings of the averaging window that ends with that frame
(a fixed grid, no waiting for a later frame). An attitude refers to the middle of its window. What is made of a window
is in `window`, of a stop in `stillness` and `surveys`.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Iterator

from highside.attitude.scalar import attitude_with_std
from highside.calibration.correction import Corrected, Correction
from highside.calibration.rolling_bias import RollingBias
from highside.calibration.sensor_laws import knowing
from highside.codec.frame import ByteCodec, CanCodec, Frame
from highside.config.rig import ToolfaceSettings, VibrationSettings
from highside.config.settings import (
    MonitorSettings,
    PipelineSettings,
    RollingBiasTable,
    Settings,
    SurveySettings,
    ToolSettings,
)
from highside.link.base import Batch
from highside.rotation.live import ROTOR_UNKNOWN, LiveCompensation, RotorError, mean_error
from highside.service.drift_stage import DriftStage
from highside.service.held import Held
from highside.service.hole_azimuth import hole_azimuth
from highside.service.monitor import Monitor
from highside.service.outputs import AttitudeOutput, Survey
from highside.service.rig.shock import ShockMeter
from highside.service.rig.surveys import Gravity, judge
from highside.service.stillness import Cut, StillnessDetector
from highside.service.watch_stage import DEPARTS, DEPTH, WatchStage
from highside.service.window import (
    ROLLING_BIAS_BLOCK_S,
    NoiseEstimate,
    ReadingBlock,
    WindowReading,
    WindowStatistics,
    window_statistics,
)


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
        rolling_bias: RollingBiasTable,
        emit: Callable[[AttitudeOutput | Survey], None],
        vibration: VibrationSettings | None = None,
        toolface: ToolfaceSettings | None = None,
        drift: DriftStage | None = None,
        rotation: LiveCompensation | None = None,
        watch: WatchStage | None = None,
    ) -> None:
        self.codec = codec
        self._rotation = rotation
        self.drift, self.watch = drift, watch
        """the azimuth, for tools with gyros; whether the calibration still holds"""
        self._correction = correction
        self._rolling_bias_settings = rolling_bias
        self.rolling_bias = RollingBias(rolling_bias)
        self._block = ReadingBlock()
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
        self._held = Held(codec, pipeline.output_rate_hz)
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
        self._stillness = StillnessDetector(survey)
        self._window: deque[WindowReading] = deque()
        self._fresh = 0
        self._due: float | None = None
        self._last_t: float | None = None
        self._last_step = 0.0
        self._device_has_time = False

    @property
    def decoder_faults(self) -> int:
        """How often the decoder has failed, as far as somebody counts it (`GuardedCodec`)."""
        return getattr(self.codec, "faults", 0)

    @property
    def correction(self) -> Correction:
        """The calibration in force. Setting one with another id also forgets the offset found with the old one."""
        return self._correction

    @correction.setter
    def correction(self, correction: Correction) -> None:
        if correction.cal_id != self._correction.cal_id:
            self.rolling_bias = RollingBias(self._rolling_bias_settings)
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
            self._stillness = StillnessDetector(self._survey_settings)

    def successor(
        self,
        before: Settings,
        settings: Settings,
        *,
        correction: Correction,
        rotation: LiveCompensation | None,
        drift: DriftStage | None,
        watch: WatchStage | None,
    ) -> Pipeline:
        """A pipeline under new `settings` that goes on where this one, made under `before`, stands.

        This one is left as it is, and can go on if the successor is not wanted. Codec, counters and window are the same
        objects: only one of the two is given batches. What a setting decides is made anew where that has changed.
        """
        self.process_held()
        new = copy.copy(self)
        new._held = Held(self.codec, settings.pipeline.output_rate_hz)
        new.drift, new.watch = drift, watch
        # the codec and its counters go on: not a byte is lost for a new limit
        new.monitor = copy.copy(self.monitor)
        new.monitor.apply(range_g=settings.monitor.range_g, stuck_frames=settings.monitor.stuck_frames)
        if settings.rolling_bias != before.rolling_bias:
            new._rolling_bias_settings = settings.rolling_bias
            new.rolling_bias, new._block = RollingBias(settings.rolling_bias), ReadingBlock()
        if settings.vibration != before.vibration:
            new.shock = ShockMeter(settings.vibration)
        new._toolface = settings.toolface
        made_of = (settings.tool, settings.pipeline, settings.survey)
        if made_of != (before.tool, before.pipeline, before.survey):
            new._settings, new._survey_settings = settings.pipeline, settings.survey
            new._noise = NoiseEstimate(settings.tool.noise_g)
            new._stillness = StillnessDetector(settings.survey)
            new._due = None
        new.correction = correction
        new.rotation = rotation
        return new

    def on_batch(self, batch: Batch) -> None:
        """Take a batch; it is decoded and processed as soon as an output may be due with it."""
        frames = self._held.add(batch, self._due)
        if frames is not None:
            self._process(frames)

    def process_held(self) -> None:
        """Process what waits for the next output: before counters are read or anything is changed."""
        self._process(self._held.take())

    def _process(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.on_frame(frame)
        self._held.expect(self._due, self._last_step)

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
        if self.watch is not None:
            self.watch.finish()

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
        window.append(WindowReading(t, a, frame.temp_c, rotor))
        self._fresh += 1
        self._block.add(t, a, frame.temp_c)
        if frame.gx is not None and frame.gy is not None and frame.gz is not None:
            if self.drift is not None:
                self.drift.add(frame.gx, frame.gy, frame.gz)
            if self.watch is not None:
                self.watch.add(t, frame.gx, frame.gy, frame.gz)
        if self._block.t - self._block.start >= ROLLING_BIAS_BLOCK_S:
            self._close_block(frame)
        if self._due is None:
            self._due = self._next_due(t)
        elif t >= self._due:
            self._due = self._next_due(t)
            self._output(frame, t)

    def _close_block(self, frame: Frame) -> None:
        block = self._block
        t, mean, temp = block.take()
        corrected = knowing(self._correction, frame, self.codec.extra_columns).correct(mean, temp_c=temp)
        self.rolling_bias.add(t, corrected.gx, corrected.gy, corrected.gz)
        if self.watch is not None:
            depth = dict(zip(self.codec.extra_columns, frame.extra or (), strict=False)).get(DEPTH)
            self.watch.close(t, frame.t_mono, corrected[:3], temp, depth, math.hypot(*self.shock.rms_g))
        if self.drift is not None:
            if self._rolling_bias_settings.apply:
                corrected = self._in_force(frame).correct(mean, temp_c=temp)
            gx, gy, gz = corrected.gx, corrected.gy, corrected.gz
            heading: float | None = 0.0
            if self._rotation is not None and self._rotation.corrects_heading:
                self._gyro_rotor = frame.rotor_deg, frame.rotor_rate_dps
                error = self._rotation.heading(*self._gyro_rotor, math.atan2(math.hypot(gx, gy), gz))
                heading = None if ROTOR_UNKNOWN in error.flags else error.error_rad
            self.drift.close(block.t, frame.t_mono, (gx, gy, gz), heading)

    def _begin_anew(self) -> None:
        # the device began again: a new power-up has a new turn-on bias
        self.rolling_bias.reset()
        if self.drift is not None:
            self.drift.device_restarted()
        self._block = ReadingBlock()
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
        corrected = self._in_force(frame).correct(statistics.mean, (xx, 0.0, 0.0, yy, 0.0, zz), temp)
        rotor = None if self._rotation is None else mean_error(row.rotor for row in rows)
        attitude = self._attitude(corrected, frame, t, len(rows), t - rows[0].t, temp, flags, rotor)
        self.attitudes += 1
        self._emit(attitude)
        if self._survey_settings.enabled:
            fresh = rows[-min(self._fresh, len(rows)) :]
            self._watch_stillness(statistics, fresh, frame, t)
        self._fresh = 0

    def _in_force(self, frame: Frame) -> Correction:
        correction = knowing(self._correction, frame, self.codec.extra_columns)
        return self.rolling_bias.wrap(correction) if self._rolling_bias_settings.apply else correction

    def _watch_stillness(self, window: WindowStatistics, fresh: list[WindowReading], frame: Frame, t: float) -> None:
        still, settings = self._stillness, self._survey_settings
        before = None if still.reported else still.cut()
        if max(self.shock.since_g) > settings.accept.shock_g:
            # a shock ends the average, whether or not the mean has moved
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
        duration, mean, variance, n, temp, rotor, scatter = stop
        if not any(variance):
            # not one bit of noise in all that time: a dead converter, not a still tool
            return True
        noise = tuple(v / n for v in variance)
        corrected = self._in_force(frame).correct(mean, (noise[0], 0.0, 0.0, noise[1], 0.0, noise[2]), temp)
        attitude = self._attitude(corrected, frame, t, n, duration, temp, [], rotor)
        accept = self._survey_settings.accept
        verdict = judge(attitude, self.gravity, accept, max(self.shock.since_g), complete=complete)
        self.surveys += 1
        self._emit(Survey(attitude, duration, math.sqrt(sum(variance) / 3.0), verdict, scatter))
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
    ) -> AttitudeOutput:
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
            if self.watch is not None and self.watch.exceeds((gx, gy, gz), inc_std, tf_std):
                flags.append(DEPARTS)
            if self._rotation is not None:
                inc, tf, own_inc, own_tf, doubts = self._rotation.apply(inc, tf, rotor)
                inc_std, tf_std = math.hypot(inc_std, own_inc), math.hypot(tf_std, own_tf)
                flags.extend(doubts)
            if result.toolface_undefined:
                flags.append("toolface_undefined")
            low = self._toolface.low_inclination_deg
            if not low <= math.degrees(inc) <= 180.0 - low:
                flags.append("low_inclination")
        flags.extend(self._reading_flags(g_total))
        azimuth = hole_azimuth(self.drift, self._rotation, self._gyro_rotor, t, felt_inc)
        if azimuth is not None:
            flags.extend(flag for flag in azimuth.flags if flag not in flags)
        return AttitudeOutput(
            t_device_s=t,
            t_mono=frame.t_mono,
            inc_deg=math.degrees(inc),
            inc_std_deg=math.degrees(inc_std),
            tf_deg=math.degrees(tf),
            tf_std_deg=math.degrees(tf_std),
            motor_toolface_deg=(math.degrees(tf) + self.toolface_offset_deg) % 360.0,
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
            accel=(gx, gy, gz),
        )

    def _reading_flags(self, g_total: float) -> Iterator[str]:
        """What is doubtful about the readings themselves."""
        if abs(g_total - 1.0) > self._settings.g_tolerance:
            yield "g_total"
        yield from (f"stuck_{axis}" for axis in self.monitor.stuck_axes)
        if self.monitor.frozen:
            yield "frozen"
