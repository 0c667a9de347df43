"""The pipeline: device time rules, chunking does not, uncertainties are honest, surveys need stillness."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from pydantic import ValidationError

from highside.calibration.correction import IdentityCorrection
from highside.codec.frame import Counts, Frame
from highside.config.settings import (
    CalibrationSettings,
    MonitorSettings,
    PipelineSettings,
    RollingBiasTable,
    SurveySettings,
    ToolSettings,
)
from highside.service.outputs import AttitudeOutput, Survey
from highside.service.pipeline import Pipeline
from highside.service.window import WindowReading, window_statistics

RATE_HZ = 100.0


class ListCodec:
    """Hands over frames given as objects: the pipeline without any wire format."""

    name = "list"
    extra_columns: tuple[str, ...] = ()
    seq_modulus = 65536

    def __init__(self) -> None:
        self.counts = Counts()

    def reset(self) -> None: ...

    def receive_can(self, frames: list[Frame]) -> list[Frame]:
        return frames

    def flush(self) -> list[Frame]:
        return []


def make(**changes: object) -> tuple[Pipeline, list[AttitudeOutput | Survey]]:
    out: list[AttitudeOutput | Survey] = []
    pipeline = Pipeline(
        codec=ListCodec(),
        tool=changes.get("tool", ToolSettings()),
        pipeline=changes.get("pipeline", PipelineSettings()),
        monitor=changes.get("monitor", MonitorSettings()),
        survey=changes.get("survey", SurveySettings(still_s=5.0)),
        correction=changes.get("correction", IdentityCorrection(0.0, 0.0)),
        rolling_bias=changes.get("rolling_bias", RollingBiasTable()),
        emit=out.append,
    )
    return pipeline, out


TABLES = {
    "tool": ToolSettings,
    "pipeline": PipelineSettings,
    "monitor": MonitorSettings,
    "survey": SurveySettings,
    "calibration": CalibrationSettings,
    "rolling_bias": RollingBiasTable,
}
NUMBERS = [
    (table, name) for table, kind in TABLES.items() for name, field in kind.model_fields.items()
    if field.annotation in (float, int, float | None)
]  # fmt: skip


@pytest.mark.parametrize("value", [5e-324, 1e-9, 1e18, 1e300])
@pytest.mark.parametrize(("table", "name"), NUMBERS)
def test_an_absurd_setting_is_refused_or_carried_out(table: str, name: str, value: float) -> None:
    try:
        settings = TABLES[table].model_validate({name: value})
    except ValidationError:
        return
    if isinstance(settings, CalibrationSettings):
        pipeline, out = make(correction=IdentityCorrection(settings.bias_std_g, settings.scale_std))
    else:
        pipeline, out = make(**{table: settings})
    with np.errstate(all="ignore"):
        made = frames(1500, lambda t: (30.0, 60.0))
        for frame in made[:1000]:
            pipeline.on_frame(frame)
        # as they come over a link: some wait for the output that is due
        for frame in made[1000:]:
            pipeline.on_batch([frame])
    assert all(0.0 <= one.inc_deg <= 180.0 for one in out if isinstance(one, AttitudeOutput))


def gravity(inc_deg: float, tf_deg: float) -> np.ndarray:
    inc, tf = math.radians(inc_deg), math.radians(tf_deg)
    return np.array([math.sin(inc) * math.cos(tf), math.sin(inc) * math.sin(tf), math.cos(inc)])


def frames(n: int, attitude, *, noise_g: float = 1e-3, seed: int = 1, start: int = 0) -> list[Frame]:
    """`attitude(t) -> (inc_deg, tf_deg)`."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(start, start + n):
        t = i / RATE_HZ
        a = gravity(*attitude(t)) + noise_g * rng.standard_normal(3)
        rows.append(Frame(i % 65536, t, 100.0 + t, *map(float, a), temp_c=25.0))
    return rows


def test_one_attitude_each_output_period_on_the_grid_of_device_time():
    pipeline, out = make(pipeline=PipelineSettings(output_rate_hz=5))
    for f in frames(1000, lambda t: (30.0, 120.0)):
        pipeline.on_frame(f)
    attitudes = [o for o in out if isinstance(o, AttitudeOutput)]
    # the first frame opens the grid, so 0.0 itself gives none
    assert [a.t_device_s for a in attitudes] == pytest.approx([0.2 * k for k in range(1, 50)])
    assert all(a.n == 20 for a in attitudes)
    assert all(a.t_mono == pytest.approx(100.0 + a.t_device_s) for a in attitudes)


def test_stated_uncertainty_is_the_scatter_of_the_error():
    pipeline, out = make()
    for f in frames(20000, lambda t: (12.0, 200.0)):
        pipeline.on_frame(f)
    attitudes = [o for o in out if isinstance(o, AttitudeOutput)]
    inc_z = np.array([(a.inc_deg - 12.0) / a.inc_std_deg for a in attitudes])
    tf_z = np.array([(a.tf_deg - 200.0) / a.tf_std_deg for a in attitudes])
    # 1999 windows of 10 readings; the larger of two estimates of the noise errs to the safe side
    assert 0.8 < inc_z.std() < 1.05
    assert 0.8 < tf_z.std() < 1.05
    assert abs(inc_z.mean()) < 0.15


def test_a_turning_tool_has_the_attitude_of_the_middle_of_its_window_and_is_flagged_moving():
    pipeline, out = make()
    for f in frames(600, lambda t: (45.0, (120.0 * t) % 360.0), noise_g=1e-4):
        pipeline.on_frame(f)
    for a in [o for o in out if isinstance(o, AttitudeOutput)]:
        middle = a.t_device_s - a.window_s / 2.0
        error = (a.tf_deg - 120.0 * middle + 180.0) % 360.0 - 180.0
        assert abs(error) < 0.05
        assert "moving" in a.flags


def test_a_still_tool_gives_one_survey_and_another_after_it_has_moved():
    def attitude(t: float) -> tuple[float, float]:
        return (20.0, 90.0) if t < 12.0 else (20.0, 90.0 + 30.0 * min(t - 12.0, 2.0))

    pipeline, out = make()
    for f in frames(3000, attitude):
        pipeline.on_frame(f)
    surveys = [o for o in out if isinstance(o, Survey)]
    assert len(surveys) == 2
    assert surveys[0].attitude.tf_deg == pytest.approx(90.0, abs=4 * surveys[0].attitude.tf_std_deg)
    assert surveys[1].attitude.tf_deg == pytest.approx(150.0, abs=4 * surveys[1].attitude.tf_std_deg)
    assert surveys[0].duration_s >= 5.0
    assert surveys[0].g_std == pytest.approx(1e-3, rel=0.1)
    # 500 readings of 1 mg
    assert surveys[0].attitude.inc_std_deg == pytest.approx(math.degrees(1e-3 / math.sqrt(500)), rel=0.2)


def test_a_dead_converter_behind_a_living_counter_gives_no_survey_and_is_flagged():
    pipeline, out = make()
    for f in frames(2000, lambda t: (20.0, 90.0), noise_g=0.0):
        pipeline.on_frame(f)
    assert not [o for o in out if isinstance(o, Survey)]
    assert all("frozen" in o.flags for o in out if isinstance(o, AttitudeOutput) and o.t_device_s > 3.0)


def test_a_slow_creep_is_never_a_survey():
    pipeline, out = make()
    for f in frames(6000, lambda t: (20.0, 90.0 + 0.5 * t)):
        pipeline.on_frame(f)
    assert not [o for o in out if isinstance(o, Survey)]


def test_a_gap_in_the_stream_ends_stillness():
    pipeline, out = make()
    stream = frames(900, lambda t: (20.0, 90.0))
    for f in stream[:400] + stream[460:]:
        pipeline.on_frame(f)
    assert not [o for o in out if isinstance(o, Survey)]
    assert pipeline.monitor.counts.gap == 60


def test_a_device_reset_starts_a_new_grid_and_loses_nothing_after_it():
    pipeline, out = make()
    for f in frames(250, lambda t: (20.0, 90.0), start=1000):
        pipeline.on_frame(f)
    before = len(out)
    for f in frames(250, lambda t: (20.0, 90.0)):
        pipeline.on_frame(f)
    assert len(out) - before == 24
    assert pipeline.monitor.counts.resets == 1


def test_vertical_has_no_toolface_and_says_so():
    pipeline, out = make()
    for f in frames(5000, lambda t: (0.0, 0.0), noise_g=1e-4):
        pipeline.on_frame(f)
    attitudes = [a for a in out if isinstance(a, AttitudeOutput)]
    flagged = [a for a in attitudes if "toolface_undefined" in a.flags]
    assert len(flagged) >= 0.9 * len(attitudes)
    assert all(a.tf_std_deg > 20.0 for a in flagged)


def test_a_shaken_or_wrongly_scaled_tool_is_flagged():
    pipeline, out = make()
    for f in frames(100, lambda t: (30.0, 0.0)):
        pipeline.on_frame(f._replace(ax=f.ax * 1.1, ay=f.ay * 1.1, az=f.az * 1.1))
    assert all("g_total" in a.flags for a in out if isinstance(a, AttitudeOutput))


def test_averaging_may_be_longer_than_the_output_period():
    pipeline, out = make(pipeline=PipelineSettings(output_rate_hz=10, averaging_s=1.0))
    for f in frames(500, lambda t: (30.0, 10.0)):
        pipeline.on_frame(f)
    attitudes = [o for o in out if isinstance(o, AttitudeOutput)]
    assert all(a.n == 100 for a in attitudes[10:])
    assert len(attitudes) == 49


def test_a_swapped_correction_is_used_from_the_next_output_on():
    pipeline, out = make()
    stream = frames(400, lambda t: (30.0, 10.0))
    for f in stream[:205]:
        pipeline.on_frame(f)
    pipeline.correction = IdentityCorrection(0.0, 0.0, cal_id="new")
    for f in stream[205:]:
        pipeline.on_frame(f)
    ids = [a.cal_id for a in out if isinstance(a, AttitudeOutput)]
    assert ids == ["none"] * 20 + ["new"] * 19


def test_short_windows_use_the_running_estimate_of_the_noise():
    random_rows = random.Random(5)
    rows = [WindowReading(i * 0.01, (random_rows.gauss(0, 1), 0.0, 1.0), None) for i in range(4)]
    window = window_statistics(rows, (1e-6, 1e-6, 1e-6))
    assert window.variance == pytest.approx((2.5e-7, 2.5e-7, 2.5e-7))


def test_the_scatter_about_a_line_is_the_variance_of_a_long_window():
    rng = np.random.default_rng(3)
    t = np.arange(4000) * 1e-3
    data = np.vstack([0.1 + 0.5 * t, 0.2 - 0.1 * t, 0.9 + 0 * t]) + 1e-3 * rng.standard_normal((3, t.size))
    rows = [WindowReading(float(ti), (*map(float, column),), None) for ti, column in zip(t, data.T, strict=True)]
    window = window_statistics(rows, (1e-9, 1e-9, 1e-9))
    assert np.sqrt(np.array(window.variance) * t.size) == pytest.approx([1e-3] * 3, rel=0.05)
    assert window.span == pytest.approx((0.5 * t[-1], -0.1 * t[-1], 0.0), abs=5e-4)


@pytest.mark.parametrize("apply", [False, True])
def test_the_offset_of_this_power_up_is_found_while_turning_and_taken_off_only_where_configured(apply):
    """300 ug on x and y at I = 1.2 deg, 20 rpm, 100 frames/s: the toolface error is 0.8 deg without the re-balance."""
    pipeline, out = make(rolling_bias=RollingBiasTable(apply=apply))
    for f in frames(2000, lambda t: (1.2, (120.0 * t) % 360.0), noise_g=350e-6):
        pipeline.on_frame(f._replace(ax=f.ax + 300e-6, ay=f.ay + 300e-6))
    offset = pipeline.rolling_bias.offset
    assert offset is not None
    assert offset.bx_g == pytest.approx(300e-6, abs=5 * offset.std_g[0])
    assert offset.by_g == pytest.approx(300e-6, abs=5 * offset.std_g[1])
    errors = [
        (a.tf_deg - 120.0 * (a.t_device_s - a.window_s / 2) + 180.0) % 360.0 - 180.0
        for a in out
        if isinstance(a, AttitudeOutput) and a.t_device_s > 12.0
    ]
    rms = float(np.sqrt(np.mean(np.square(errors))))
    noise_limit = math.degrees(350e-6 / math.sqrt(10) / math.sin(math.radians(1.2)))
    if apply:
        assert rms < 1.3 * noise_limit
        assert all("rolling_bias" in o.flags for o in out if isinstance(o, AttitudeOutput) and o.t_device_s > 12.0)
    else:
        assert rms > 2.0 * noise_limit
