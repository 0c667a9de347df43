"""Surveys: judged, kept, and decided rightly over a simulated day of drilling and connections."""

from __future__ import annotations

import json
import math
import resource
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from highside.calibration.correction import IdentityCorrection
from highside.codec.frame import Frame
from highside.codec.tool import ToolCodec
from highside.config.rig import AcceptSettings, SiteSettings
from highside.config.settings import MonitorSettings, PipelineSettings, RollingBiasTable, SurveySettings, ToolSettings
from highside.physics.motion import Leg, Motion
from highside.service.outputs import AttitudeOutput, Survey, SurveyReason
from highside.service.pipeline import Pipeline
from highside.service.rig import surveys
from highside.service.rig.surveys import (
    GravityTrend,
    SurveyLog,
    TrendPoint,
    expected_gravity,
    judge,
    trend_of,
)

GOOD = AttitudeOutput(0.0, 0.0, 30.0, 0.01, 45.0, 0.02, 45.0, 0.0, 1.0, 2e-5, "c", "global", (), 100, 10.0, 60.0)
SITE = expected_gravity(SiteSettings(gravity_mps2=9.81, gravity_std_mps2=0.0001), 9.81, 0.0001)


@pytest.mark.parametrize(
    ("changes", "shock", "complete", "reasons"),
    [
        ({}, 0.1, True, ()),
        ({"g_total": 1.0 + 2.9e-3}, 0.1, True, ()),
        ({"g_total": 1.0 + 3.2e-3}, 0.1, True, (SurveyReason.G_TOTAL_HIGH,)),
        ({"g_total": 1.0 - 3.2e-3}, 0.1, True, (SurveyReason.G_TOTAL_LOW,)),
        ({"g_total": 1.0 - 3.2e-3, "g_total_std": 5e-4}, 0.1, True, ()),
        ({"temp_c": 176.0}, 0.1, True, (SurveyReason.TOO_HOT,)),
        ({"temp_c": -41.0}, 0.1, True, (SurveyReason.TOO_COLD,)),
        ({"temp_c": None}, 0.1, True, ()),
        ({"flags": ("temperature_unknown",)}, 0.1, True, (SurveyReason.TEMPERATURE_UNKNOWN,)),
        ({}, 1.1, True, (SurveyReason.SHOCK,)),
        ({}, 0.1, False, (SurveyReason.MOVED,)),
        ({"flags": ("calibration_refused",)}, 0.1, True, (SurveyReason.NO_CORRECTION,)),
        ({"inc_deg": math.nan, "g_total": math.nan}, 0.1, True, (SurveyReason.NO_CORRECTION,)),
        ({"flags": ("stuck_ax",)}, 0.1, True, (SurveyReason.SENSOR_STUCK,)),
        ({"inc_std_deg": 0.3}, 0.1, True, (SurveyReason.UNCERTAIN,)),
        ({"temp_c": 176.0, "g_total": 1.1}, 2.0, False,
         (SurveyReason.G_TOTAL_HIGH, SurveyReason.TOO_HOT, SurveyReason.SHOCK)),
    ],
)  # fmt: skip
def test_each_reason(changes: dict[str, object], shock: float, complete: bool, reasons: tuple[str, ...]) -> None:
    limits = AcceptSettings(max_inc_std_deg=0.2)
    verdict = judge(replace(GOOD, **changes), SITE, limits, shock, complete=complete)  # type: ignore[arg-type]
    assert verdict.reasons == reasons
    assert verdict.accepted == (not reasons)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("std_mg", [0.02, 0.3, 2.0])
def test_gtotal_may_miss_its_limit_by_two_standard_deviations_and_no_more(sign: float, std_mg: float) -> None:
    limits = AcceptSettings()
    gravity = replace(SITE, std_mg=0.0)
    for times, accepted in ((1.9, True), (2.1, False)):
        off = sign * (limits.g_total_mg + times * std_mg) / gravity.unit_mg
        attitude = replace(GOOD, g_total=gravity.expected + off, g_total_std=std_mg / gravity.unit_mg)
        assert judge(attitude, gravity, limits, 0.1, complete=True).accepted is accepted


@pytest.mark.parametrize(
    ("site", "expected", "std"),
    [
        ({}, None, None),
        ({"latitude_deg": 52.0}, None, None),
        ({"height_m": 10.0, "depth_m": 3000.0}, None, None),
        # Moritz, Geodetic Reference System 1980: 9.806199203 at 45 deg; free air 3.086e-6 a metre
        ({"latitude_deg": 45.0, "height_m": 0.0}, 9.806199, 3e-4),
        ({"latitude_deg": 45.0, "height_m": 1000.0}, 9.803113, 3e-4),
        ({"gravity_mps2": 9.8131}, 9.8131, 5e-4),
        ({"gravity_mps2": 9.8131, "depth_m": 3000.0, "density_kgpm3": 2700.0}, 9.8131 + 2.47e-3, 8.0e-4),
    ],
)
def test_gravity_of_the_site_is_measured_or_follows_from_latitude_height_and_depth(
    site: dict[str, float], expected: float | None, std: float | None
) -> None:
    found = SiteSettings(**site).local_gravity()  # type: ignore[arg-type]
    if expected is None:
        assert found is None
        return
    assert found == (pytest.approx(expected, abs=1e-5), pytest.approx(std, rel=0.02))
    assert expected_gravity(SiteSettings(**site), 9.81, 0.0).expected == pytest.approx(found[0] / 9.81)  # type: ignore[arg-type]


def test_gtotal_is_compared_with_the_sites_gravity_in_units_of_the_benchs() -> None:
    gravity = expected_gravity(SiteSettings(gravity_mps2=9.7803, gravity_std_mps2=0.0002), 9.8322, 0.0001)
    assert gravity.expected == pytest.approx(9.7803 / 9.8322)
    right = judge(replace(GOOD, g_total=9.7803 / 9.8322), gravity, AcceptSettings(), 0.0, complete=True)
    assert right.accepted
    assert right.g_error_mg == pytest.approx(0.0, abs=1e-9)
    # without knowing where it is, 5.3 mg between pole and equator could not be judged; with it they are
    wrong = judge(replace(GOOD, g_total=1.0), gravity, AcceptSettings(), 0.0, complete=True)
    assert wrong.reasons == (SurveyReason.G_TOTAL_HIGH,)
    assert wrong.g_error_mg == pytest.approx(1e3 * (9.8322 - 9.7803) / 9.80665, rel=1e-6)
    assert wrong.g_std_mg == pytest.approx(math.hypot(0.02, math.hypot(0.2, 0.1) / 9.80665), rel=0.02)
    unknown = expected_gravity(SiteSettings(), 9.8322, 0.0001)
    assert judge(replace(GOOD, g_total=1.0 + 5e-3), unknown, AcceptSettings(), 0.0, complete=True).accepted


def test_every_survey_is_kept_also_after_a_torn_line(tmp_path: Path) -> None:
    path = tmp_path / "surveys.jsonl"
    path.write_bytes(b'{"seq":1}\n{"seq":2,"t"')
    log = SurveyLog(path)
    log.start()
    for seq in range(3, 50):
        log.keep({"seq": seq})
    log.stop(5.0)
    assert log.kept == 47
    assert [s["seq"] for s in log.recent(1000)] == [1, *range(3, 50)]
    assert len(path.read_bytes().splitlines()) == 49


def test_a_disk_that_refuses_is_said_and_nothing_stops(tmp_path: Path) -> None:
    log = SurveyLog(tmp_path / "absent" / "surveys.jsonl")
    log.start()
    log.keep({"seq": 1})
    log.stop(5.0)
    assert (log.kept, log.failed) == (0, 1)
    assert "No such file" in log.error


def test_a_disk_that_takes_again_has_every_survey_and_ends_the_alarm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surveys, "RETRY_S", 0.05)
    log = SurveyLog(tmp_path / "later" / "surveys.jsonl")
    log.start()
    for seq in range(5):
        log.keep({"seq": seq})
    until(lambda: log.failed == 5 and log.error)
    (tmp_path / "later").mkdir()
    # no new survey comes
    until(lambda: log.kept == 5)
    assert (log.failed, log.error) == (0, "")
    log.stop(5.0)
    assert [s["seq"] for s in log.recent()] == list(range(5))


def test_a_disk_that_is_full_in_the_middle_of_a_line_leaves_no_line_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surveys, "RETRY_S", 0.05)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    log = SurveyLog(tmp_path / "surveys.jsonl")
    try:
        # room for three lines and a half
        resource.setrlimit(resource.RLIMIT_FSIZE, (35, hard))
        log.start()
        for seq in range(10, 20):
            log.keep({"seq": seq})
        until(lambda: log.error and log.kept + log.failed == 10)
        time.sleep(0.3)
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        until(lambda: log.kept == 10)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
        log.stop(5.0)
    lines = (tmp_path / "surveys.jsonl").read_bytes().split(b"\n")
    assert [json.loads(line)["seq"] for line in lines if line] == list(range(10, 20))


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("seed", range(5))
def test_the_trend_speaks_when_gtotal_follows_temperature_and_is_silent_otherwise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    temps = np.linspace(40.0, 120.0, 40)
    points = [
        {"t": 1e9 + 600.0 * i, "temp_c": float(temp), "g_error_mg": float(rng.normal(0.1, 0.05)), "g_noise_mg": 0.02,
         "reasons": [], "cal_id": "c"}
        for i, temp in enumerate(temps)
    ]  # fmt: skip
    quiet = trend_of(points, "c").as_dict()
    assert quiet["advice"] is None
    assert quiet["mean_mg"] == pytest.approx(0.1, abs=0.03)
    grown = trend_of([p | {"g_error_mg": p["g_error_mg"] + 0.01 * (p["temp_c"] - 40.0)} for p in points], "c").as_dict()
    assert "grown with temperature: run `diagnose`" in grown["advice"]
    assert grown["slope_mg_per_degc"] == pytest.approx(0.01, abs=4 * grown["slope_std_mg_per_degc"])
    assert trend_of(points, "other").as_dict()["surveys"] == 0


def test_false_alarms_of_the_trend_are_rare() -> None:
    """Four standard deviations on two slopes: 1.3 alarms in 10,000 trends are to be expected; 3 in 1,000 are not."""
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(1000):
        trend = GravityTrend()
        for i in range(30):
            trend.add(TrendPoint(1e9 + 3600.0 * i, float(rng.uniform(40, 120)), float(rng.normal(0, 0.1)), 0.1))
        alarms += trend.as_dict()["advice"] is not None
    assert alarms <= 2


# --- a day ---------------------------------------------------------------------------------------------------------

RATE_HZ = 10.0
STILL_S = 30.0


@dataclass
class Stop:
    """A connection of the simulated day: when the tool stands, what happens then, what must come of it."""

    begin: float
    end: float
    kind: str


def a_day() -> tuple[Motion, list[Stop]]:
    kinds = ["plain", "plain", "shock", "hot", "short", "plain", "heavy", "tiny"]
    legs: list[Leg] = []
    stops: list[Stop] = []
    t = 0.0
    inclination = 5.0
    for stand in range(40):
        inclination = min(inclination + 2.0, 88.0)
        kind = kinds[stand % len(kinds)]
        for leg in (
            Leg(1200.0, inclination_to_deg=inclination, turn_deg=360.0 * 1200.0 / 2.0, vibration_g=0.3),
            Leg(600.0, turn_deg=35.0, vibration_g=0.1),  # sliding
            Leg(60.0, turn_deg=200.0),  # off bottom, turned to the connection
        ):
            legs.append(leg)
            t += leg.duration_s
        rest = {"short": 22.0, "tiny": 1.5}.get(kind, 180.0)
        legs.append(Leg(rest))
        stops.append(Stop(t, t + rest, kind))
        t += rest
    return Motion(tuple(legs), 5.0, 30.0, repeat=False, seed=7), stops


def test_a_day_of_drilling_and_connections() -> None:
    motion, stops = a_day()
    assert motion.duration_s > 0.9 * 86_400 - 6_000
    found: list[tuple[float, Survey]] = []
    now = [0.0]
    pipeline = Pipeline(
        codec=ToolCodec(), tool=ToolSettings(), pipeline=PipelineSettings(output_rate_hz=1.0, averaging_s=1.0),
        monitor=MonitorSettings(), survey=SurveySettings(still_s=STILL_S), correction=IdentityCorrection(1e-5, 1e-5),
        rolling_bias=RollingBiasTable(), emit=lambda o: found.append((now[0], o)) if isinstance(o, Survey) else None,
    )  # fmt: skip
    pipeline.gravity = SITE
    rng = np.random.default_rng(11)
    for start in range(0, int(motion.duration_s * RATE_HZ), 50_000):
        t = np.arange(start, min(start + 50_000, int(motion.duration_s * RATE_HZ))) / RATE_HZ
        block = motion.block(t)
        a = block.gravity + block.vibration_g + rng.normal(0, 1e-4, (3, t.size))
        temp = np.full(t.size, 80.0)
        for stop in stops:
            inside = (t >= stop.begin - 60.0) & (t < stop.end + 60.0)
            if stop.kind == "shock":
                for after, size in ((20.3, 4.0), (20.4, -4.0)):
                    a[0, np.abs(t - stop.begin - after) < 0.5 / RATE_HZ] += size
            elif stop.kind == "hot":
                temp[inside] = 181.0
            elif stop.kind == "heavy":
                a[:, inside] *= 1.005
        for time_s, row, temp_c in zip(t.tolist(), a.T.tolist(), temp.tolist(), strict=True):
            now[0] = time_s
            pipeline.on_frame(
                Frame(seq=None, t_mono=time_s, t_s=time_s, ax=row[0], ay=row[1], az=row[2], temp_c=temp_c)
            )

    expected = {
        "plain": [()],
        "hot": [(SurveyReason.TOO_HOT,)],
        "heavy": [(SurveyReason.G_TOTAL_HIGH,)],
        "short": [(SurveyReason.MOVED,)],
        "tiny": [],
        "shock": [(SurveyReason.SHOCK,)],
    }
    used = 0
    for stop in stops:
        here = [(t, s) for t, s in found if stop.begin < t <= stop.end + 15.0]  # a slow start shows late
        used += len(here)
        reasons = [s.verdict.reasons for _, s in here]
        assert reasons[:1] == expected[stop.kind], (stop, reasons)
        if stop.kind == "plain":
            # one is enough
            assert len(here) == 1
        elif stop.kind == "shock":
            # the shock only delays it
            assert reasons[1:] == [()]
        elif stop.kind in ("hot", "heavy"):
            # asked again, after longer and longer waits, always with the same answer
            assert 2 <= len(here) <= 4
            assert set(reasons) == set(expected[stop.kind])
        for t, survey in here:
            if not survey.verdict.accepted:
                continue
            assert t <= stop.end
    # not one was accepted while the tool moved or shook by more than its noise shows. (Legs begin and end softly:
    # between two of them the tool may stand for half a minute, and a survey of that is a good one.)
    between = 0
    for t, survey in found:
        if not survey.verdict.accepted:
            continue
        truth = motion.block(np.arange(t - survey.duration_s, t, 0.1))
        assert np.ptp(truth.gravity, axis=1).max() < 1e-3, f"it moved before {t}"
        assert truth.vibration_rms_g.max() < 6e-3, f"it shook before {t}"
        assert survey.attitude.inc_deg == pytest.approx(math.degrees(truth.inclination_rad.mean()), abs=0.01)
        error = math.remainder(survey.attitude.tf_deg - math.degrees(truth.toolface_rad.mean()), 360.0)
        assert abs(error) < 0.1
        between += not any(stop.begin < t <= stop.end for stop in stops)
    assert used + between <= len(found)
    assert between < 120, "between each stop there are three soft changes at most"
    assert json.dumps(sorted({s.kind for s in stops})) == json.dumps(sorted(expected))
