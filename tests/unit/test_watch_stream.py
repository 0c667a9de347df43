"""The watch on a stream: the same as on a recording, kept and taken up exactly, and what may be proposed of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from watch_frames import poses_of_a_good_tool, rows_of_a_well

import highside
from highside.api.watch import proposal_of
from highside.arrays import Array
from highside.calibration.applied import corrected_accel
from highside.calibration.record import correction_from_record, largest_difference, parse_record, recompute
from highside.cli.commands import run
from highside.codec.frame import Counts, Frame
from highside.config.settings import MonitorSettings, PipelineSettings, RollingBiasTable, SurveySettings, ToolSettings
from highside.config.watch import WatchSettings
from highside.errors import InputError, Refused
from highside.recording.calibration_store import CalibrationStore
from highside.service.pipeline import Pipeline
from highside.service.saved_watch import Numbers, SavedWatch
from highside.service.watch_said import message
from highside.service.watch_stage import Watched, WatchStage
from highside.watch import POLICY, STATED, Still, Watch, WatchResult, prior_of_record
from highside.watch.live import LiveRows, LiveWatch, Stretch
from highside.watch.proposal import propose, read_outcome
from highside.watch.rows import wanders
from highside.watch.turning import TurningRows, fit_turning, mean_span
from studies.survey_analysis import calibration as calibration_of_surveys
from studies.watch_beyond import sliding
from studies.watch_noise import streamed

AXES, RATES = ("ax_g", "ay_g", "az_g"), ("gx_dps", "gy_dps", "gz_dps")


@pytest.fixture(scope="module")
def calibration() -> highside.Calibration:
    return highside.calibrate(poses_of_a_good_tool(1), "joint", tool="HS-1", temp_c=25.0)


@pytest.fixture(scope="module")
def shocked() -> dict[str, Array]:
    return rows_of_a_well(3, stands=12, inclinations_deg=(5.0, 50.0), step_g=(8e-4, 0.0, 0.0), step_at=6)


@pytest.fixture(scope="module")
def named(calibration: highside.Calibration) -> highside.WatchedRecording:
    """A departure that a whole build has named."""
    rows = rows_of_a_well(
        3, stands=24, inclinations_deg=(5.0, 88.0), step_g=(2e-3, 0.0, 0.0), step_at=6, rate_hz=12.0, turns_s=60.0
    )
    return highside.watch_recording(rows, calibration)


def stretches(rows: dict[str, Array], calibration: highside.Calibration, live: LiveRows | None = None) -> list[Stretch]:
    a = np.vstack([rows[name] for name in AXES])
    c = corrected_accel(calibration.record, a, rows["temp_c"], where="rows", columns=rows).T.tolist()
    w = np.radians(np.vstack([rows[name] for name in RATES])).T.tolist()
    live = LiveRows() if live is None else live
    found = [
        live.add(t, (ci[0], ci[1], ci[2]), (wi[0], wi[1], wi[2]), 25.0)
        for t, ci, wi in zip(rows["t_s"].tolist(), c, w, strict=True)
    ]
    return [one for one in (*found, live.cut()) if one is not None]


def a_watch(calibration: highside.Calibration) -> LiveWatch:
    return LiveWatch(Watch(prior_of_record(calibration.record), calibration.record.id))


def said_after(watch: LiveWatch, parts: list[Stretch]) -> WatchResult:
    for part in parts:
        watch.take(part)
    return watch.result()


def test_a_stream_says_what_its_recording_says(calibration: highside.Calibration, shocked: dict[str, Array]) -> None:
    whole = highside.watch_recording(shocked, calibration).found
    live = said_after(a_watch(calibration), stretches(shocked, calibration))
    assert live.verdict == whole.verdict == "departs"
    assert (live.counts.stills, live.counts.turns) == (whole.counts.stills, whole.counts.turns)
    assert live.claims[0].equivalence_class == whole.claims[0].equivalence_class
    mine, theirs = (one.claims[0].parameters["b_x"] for one in (live, whole))
    assert abs(mine.value - theirs.value) < theirs.std
    assert abs(live.claims[0].since_s - whole.claims[0].since_s) < 60.0


def test_readings_are_cut_where_the_tool_stops_or_was_not_heard(calibration: highside.Calibration) -> None:
    rows = rows_of_a_well(4, stands=2, inclinations_deg=(20.0, 30.0))
    parts = stretches(rows, calibration)
    assert [part.turning for part in parts] == [False, True, False, True]
    assert not any(part.power_up for part in parts)
    again = {name: column.copy() for name, column in rows.items()}
    again["t_s"] = np.where(rows["t_s"] >= 1800.0, rows["t_s"] - 1800.0, rows["t_s"])
    live = LiveRows()
    assert [part.power_up for part in stretches(again, calibration, live)] == [False, False, True, False]
    # the watch's time never goes back
    assert live.t_s > 350.0


def test_what_is_kept_is_gone_on_with_as_if_nothing_had_been(
    calibration: highside.Calibration, shocked: dict[str, Array]
) -> None:
    parts = stretches(shocked, calibration)
    whole, first = a_watch(calibration), a_watch(calibration)
    said_after(first, parts[:15])
    second = Watch(prior_of_record(calibration.record), calibration.record.id)
    second.recall(first.memory())
    after = said_after(LiveWatch(second, *first.calmest), parts[15:])
    other = said_after(whole, parts)
    assert (after.verdict, after.counts, after.claims[0].equivalence_class) == (
        *(other.verdict, other.counts),
        other.claims[0].equivalence_class,
    )
    # rounding aside: numpy sums in another order where an array lies otherwise in memory
    for one, two in ((after.covariance, other.covariance), (after.trace.value, other.trace.value)):
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-15)
    assert after.claims[0].evidence == pytest.approx(other.claims[0].evidence, rel=1e-9)


@pytest.mark.parametrize("damage", ["of", "covariance", "state", "information", "start"])
def test_a_memory_that_is_none_is_refused(calibration: highside.Calibration, damage: str) -> None:
    watch = a_watch(calibration)
    said_after(watch, stretches(rows_of_a_well(4, stands=2, inclinations_deg=(20.0, 30.0)), calibration))
    memory = watch.memory()
    arrays = dict(memory.arrays)
    if damage == "of":
        arrays["bank_of"] = arrays["bank_of"][::-1].copy()
    elif damage == "covariance":
        arrays["covariance"] = -arrays["covariance"]
    elif damage == "state":
        arrays["state"] = np.full(24, np.nan)
    elif damage == "information":
        arrays["bank_information"] = arrays["bank_information"] - 1e9
    bad = replace(memory, arrays=arrays, start_s=1e9 if damage == "start" else memory.start_s)
    with pytest.raises(ValueError, match=r"\w"):
        Watch(prior_of_record(calibration.record), "x").recall(bad)


def test_a_tool_switched_on_again_may_have_another_offset(calibration: highside.Calibration) -> None:
    """A step within what is stated of a power-up is a departure while the tool runs, and none where it was off."""
    rows = rows_of_a_well(11, stands=30, inclinations_deg=(5.0, 85.0), step_g=(3e-4, 0.0, 0.0), step_at=20)
    parts = stretches(rows, calibration)
    assert said_after(a_watch(calibration), parts).verdict == "departs"
    at = next(k for k, part in enumerate(parts) if part.rows.t_s[0] >= 20 * 1800.0)
    parts[at] = replace(parts[at], power_up=True)
    assert said_after(a_watch(calibration), parts).verdict != "departs"


def test_a_mean_over_a_part_of_the_turn_is_not_read_as_a_scale_error() -> None:
    """10 readings in 10 ms at 120 rpm shorten gravity's circle by 0.65 mg/g."""
    rate, n, step = 4.0 * np.pi, 10, 1e-3
    t = np.arange(0.0, 60.0, step)
    c = np.stack([0.7 * np.cos(rate * t), 0.7 * np.sin(rate * t), np.full_like(t, 0.714)])
    means = c.reshape(3, -1, n).mean(axis=2) + 1e-6 * np.random.default_rng(1).standard_normal((3, t.size // n))
    middle = t.reshape(-1, n).mean(axis=1)
    rates = np.full(middle.size, -rate)
    span = np.full(middle.size, mean_span(0.0, (n - 1) * step, n))
    plain, right = (fit_turning(TurningRows(middle, means, rates, span_s=one)) for one in (None, span))
    sizes = [float(np.hypot(*one.harmonics_g[0, 1:])) / 0.7 - 1.0 for one in (plain, right)]  # type: ignore[union-attr]
    assert sizes[0] == pytest.approx(-6.5e-4, rel=0.05)
    assert abs(sizes[1]) < 2e-6


def test_a_month_takes_no_more_memory_than_a_week(calibration: highside.Calibration) -> None:
    few = replace(POLICY, most_onsets=60, most_traced=60)
    watch = Watch(prior_of_record(calibration.record), "x", few)
    rng = np.random.default_rng(2)
    sizes = []
    for k in range(1500):  # half an hour apart
        f = rng.standard_normal(3)
        watch.still(still_of(1800.0 * k, f / np.linalg.norm(f) + 1e-5 * rng.standard_normal(3)))
        if k in (336, 1499):
            sizes.append({name: values.shape for name, values in watch.memory().arrays.items()})
    assert sizes[0] == sizes[1]


def still_of(t_s: float, mean_g: Array) -> Still:

    return Still(t_s, mean_g, 1e-5)


# --- the stage -----------------------------------------------------------------------------------------------


def a_stage(calibration: highside.Calibration, saved: SavedWatch | None = None) -> WatchStage:
    return WatchStage(WatchSettings(), Watched(calibration.record, 1.0, 1e-5), saved)


def test_a_record_read_again_is_watched_as_the_same(calibration: highside.Calibration) -> None:
    # a reload reads the file anew: other arrays, the same record
    again = parse_record(calibration.record.to_json().encode(), where="record")
    assert again is not calibration.record
    assert Watched(again, 1.0, 1e-4) == Watched(calibration.record, 1.0, 1e-4)
    assert Watched(again, 1.0, 1e-4) != Watched(calibration.record, 1.001, 1e-4)


def test_an_attitude_is_flagged_where_its_error_exceeds_two_of_its_sigmas(calibration: highside.Calibration) -> None:
    stage = a_stage(calibration)
    g = (0.5, 0.0, float(np.sqrt(0.75)))
    assert not stage.exceeds(g, 1e-9, 1e-9)
    departure = np.zeros(12)
    departure[0] = 1e-3  # b_x at toolface 0, 30 deg: cos 30 deg of it moves the inclination
    stage.take_result(replace(stage.said, departure=departure))
    moved = 1e-3 * np.cos(np.radians(30.0))
    assert stage.exceeds(g, 0.49 * moved, 1.0)
    assert not stage.exceeds(g, 0.51 * moved, 1.0)
    # at toolface 90 it moves toolface alone, by 1 / sin I
    g = (0.0, 0.5, float(np.sqrt(0.75)))
    assert stage.exceeds(g, 1.0, 0.49 * 2e-3)
    assert not stage.exceeds(g, 1.0, 0.51 * 2e-3)


def test_a_state_of_another_kind_is_refused_and_what_is_said_is_a_message(
    calibration: highside.Calibration, shocked: dict[str, Array]
) -> None:
    stage, correction = a_stage(calibration), correction_from_record(calibration.record)
    for k, t in enumerate(shocked["t_s"].tolist()):
        a, w = ([float(shocked[name][k]) for name in names] for names in (AXES, RATES))
        corrected = correction.correct((a[0], a[1], a[2]), temp_c=25.0)
        stage.add(t, *w)
        stage.close(t, 1000.0 + t, corrected[:3], 25.0)
    stage.finish()
    while stage.waiting:
        stage.take_result(stage.core.take(stage.waiting.popleft()))
    told = message(stage, 1.79e9)
    assert told.verdict == "departs"
    assert told.claims[0].since_low_t <= told.claims[0].since_t <= told.claims[0].alarm_t <= told.t
    assert stage.departs
    assert stage.acknowledge() is None
    assert not stage.departs
    saved = SavedWatch.model_validate_json(stage.saved().model_dump_json())
    again = a_stage(calibration, saved)
    assert again.said.claims[0].equivalence_class == stage.said.claims[0].equivalence_class
    np.testing.assert_allclose(again.said.covariance, stage.said.covariance, rtol=1e-9, atol=1e-15)
    assert not again.departs
    # beside a scatter of nothing any other is infinitely more, which no message can say
    tiny = np.zeros_like(saved.arrays["noise_changed"].values())
    tiny[0] = 1.0, 1e-310, 1e-310, 1e-310
    for damaged, why in ((tiny, ": a scatter is beyond reason"), (np.array(1.0), " has another shape")):
        state = saved.model_copy(update={"arrays": saved.arrays | {"noise_changed": Numbers.of(damaged)}})
        with pytest.raises(Refused, match=f"noise_changed{why}"):
            a_stage(calibration, state)
    del saved.arrays["bank_since"]
    with pytest.raises(Refused, match="no saved watch"):
        a_stage(calibration, saved)


def test_the_service_says_how_old_its_verdict_is_and_counts_readings_without_numbers(
    calibration: highside.Calibration,
) -> None:
    """A tool whose axis has no numbers any more is seen by nobody: after two hours nothing is said to hold."""
    rows = rows_of_a_well(5, stands=12, inclinations_deg=(5.0, 50.0))
    stage, correct = a_stage(calibration), correction_from_record(calibration.record).correct
    for k, t in enumerate(rows["t_s"].tolist()):
        a, w = ([float(rows[name][k]) for name in names] for names in (AXES, RATES))
        stage.add(t, *w)
        stage.close(t, 1000.0 + t, correct((a[0], a[1], a[2]), temp_c=25.0)[:3], 25.0)
        while stage.waiting:
            stage.take_result(stage.core.take(stage.waiting.popleft()))
    last_s = float(rows["t_s"][-1])
    told = message(stage, 1.79e9, 1000.0 + last_s + 60.0)
    assert told.verdict == "holds"
    assert told.measured_t is not None
    assert told.age_s == pytest.approx(told.t - told.measured_t, abs=0.01)
    assert 60.0 < told.age_s < 2000.0
    assert "reading without numbers" not in told.left_out
    for k in range(10_000):
        t = last_s + 1.0 + k
        stage.close(t, 1000.0 + t, (0.5, np.nan, 0.8), 25.0)
    assert stage.left_out["reading without numbers"] >= 10_000
    now = 1000.0 + last_s + 10_001.0
    assert stage.grown_old(now)
    assert not stage.grown_old(now)
    told = message(stage, 1.79e9, now)
    assert (told.verdict, told.stale) == ("learning", True)
    assert told.age_s > 10_000.0
    assert told.advice[0].startswith("for 2.")
    # not heard of for three weeks: the state was read, and no reading has come
    saved = SavedWatch.model_validate_json(stage.saved().model_dump_json())
    again = a_stage(calibration, saved.model_copy(update={"age_s": 21 * 86_400.0}))
    assert again.grown_old(0.0)
    assert again.said.age_s > 21 * 86_400.0


class _Codec:
    """Hands over nothing: frames are given to the pipeline as they are."""

    name, seq_modulus, extra_columns = "list", 65536, ("tvd_m",)

    def __init__(self) -> None:
        self.counts = Counts()


def shaken_well(kv_g: float, deeper: float) -> dict[str, Array]:
    """A well in which the turning tool shakes along z, more in some stands than in others, and gravity grows by
    `deeper` over 3 km of depth."""
    stands, rate_hz = 14, 50.0
    rows = rows_of_a_well(9, stands=stands, inclinations_deg=(5.0, 60.0), rate_hz=rate_hz)
    stand, within = np.divmod(rows["t_s"], 1800.0)
    share = stand / (stands - 1)
    rms = np.where(within > 90.0, np.random.default_rng(2).uniform(0.3, 1.6, stands)[stand.astype(int)], 0.0)
    for name in AXES:
        rows[name] *= 1.0 + deeper * share
    rows["az_g"] += np.sqrt(2.0) * rms * np.sin(2.0 * np.pi * 20.0 * within) + kv_g * rms**2
    return rows | {"tvd_m": np.where(stand == 5, -9999.0, 3000.0 * share)}


def test_the_service_sees_depth_and_what_its_own_stream_says_of_vibration(calibration: highside.Calibration) -> None:
    """Depth by a column of the codec, vibration by the readings: rectification is named, and gravity's growth is not
    taken for the tool's."""
    rows = shaken_well(15e-3, 3.0 * STATED.gravity_per_km)
    stage = WatchStage(WatchSettings(), Watched(calibration.record, 1.0, 1e-5))
    pipeline = Pipeline(
        codec=_Codec(),  # type: ignore[arg-type]
        tool=ToolSettings(noise_g=3e-4),
        pipeline=PipelineSettings(output_rate_hz=0.1, averaging_s=1.0),
        monitor=MonitorSettings(),
        survey=SurveySettings(enabled=False),
        correction=correction_from_record(calibration.record),
        rolling_bias=RollingBiasTable(),
        emit=lambda _: None,
        watch=stage,
    )
    columns = np.column_stack([rows[name] for name in ("t_s", *AXES, *RATES, "tvd_m")]).tolist()
    for k, (t, ax, ay, az, gx, gy, gz, depth) in enumerate(columns):
        pipeline.on_frame(Frame(k, t, 100.0 + t, ax, ay, az, gx, gy, gz, temp_c=25.0, extra=(depth,)))
    stage.finish()
    parts = list(stage.waiting)
    assert len(parts) == 28
    for part in parts:
        vibration, depth = part.rows.vibration_g, part.rows.depth_m
        assert vibration is not None
        assert (np.median(vibration) > 0.2) == part.turning
        at_s = part.rows.t_s[0]
        # a marker of a missing value is no depth
        assert depth is None if at_s // 1800.0 == 5 else depth == pytest.approx(3000.0 * (at_s // 1800.0) / 13.0)
    while stage.waiting:
        said = stage.core.take(stage.waiting.popleft())
    (claim,) = said.claims
    assert "kV_z" in claim.equivalence_class
    assert claim.parameter == "kV_z"
    assert claim.parameters["kV_z"].value == pytest.approx(15e-3, rel=0.25)


def test_without_vibration_and_with_gravity_that_grows_with_depth_nothing_departs(
    calibration: highside.Calibration,
) -> None:
    """A depth that is missing for a stand is the one of before; hours are no kilometres."""
    watch = Watch(prior_of_record(calibration.record))
    rng = np.random.default_rng(3)
    for k in range(120):
        deeper = 4.0 * k / 120.0
        f = rng.standard_normal(3)
        length = 1.0 + deeper * STATED.gravity_per_km + 1e-5 * rng.standard_normal()
        depth = None if k % 7 == 3 else 1.0 + deeper
        watch.still(Still(1800.0 * k, f / np.linalg.norm(f) * length, 1e-5, 25.0, depth))
        if k == 60:
            memory = watch.memory()
            watch = Watch(prior_of_record(calibration.record))
            watch.recall(memory)
    said = watch.result()
    assert said.verdict != "departs"
    assert abs(said.parameters["growth"].value) < 4.0 * said.parameters["growth"].std


# --- proposals -----------------------------------------------------------------------------------------------


def test_what_the_hole_has_named_is_proposed_and_corrects_it(
    calibration: highside.Calibration, named: highside.WatchedRecording
) -> None:
    made = named.proposal(calibration)
    content = made.record.content
    assert (content["valid"], content["parent"]) == ("in-hole", calibration.id)
    assert content["evidence"]["parameter"] == "b_x"
    assert parse_record(made.record.to_json()).id == made.id != calibration.id
    assert largest_difference(made.record, recompute(made.record)) < 1e-12
    shift = made.record.result.b - calibration.record.result.b
    std = made.record.result.main.parameters.std("b_x")
    # beside the step the tool's own offset, as the rows have it
    truth = np.array([2e-3, 0.0, 0.0]) + 5e-5 * np.random.default_rng(3).standard_normal(3)
    assert 4.0 * std < 4e-4
    assert np.abs(shift - truth).max() < 4.0 * std
    # what the new record corrects does not depart any more
    after = rows_of_a_well(
        3, stands=24, inclinations_deg=(5.0, 88.0), step_g=(2e-3, 0.0, 0.0), step_at=0, rate_hz=12.0, turns_s=60.0
    )
    assert highside.watch_recording(after, calibration).verdict == "departs"
    assert highside.watch_recording(after, made).verdict == "holds"


def test_the_state_of_another_tool_is_one_line_and_status_2(
    calibration: highside.Calibration,
    named: highside.WatchedRecording,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    other = highside.calibrate(poses_of_a_good_tool(2), "joint", tool="HS-2", temp_c=25.0)
    for of in (calibration, other):
        of.save(tmp_path / f"{of.record.tool_id}.json")
        CalibrationStore(tmp_path / f"store-{of.record.tool_id}").add(of.record)
    state = {"format": "highside.watch-state/1", "tool": "HS-1", "said": named.to_dict()}

    def says(changed: dict[str, object], *arguments: str) -> str:
        (tmp_path / "watch.json").write_text(json.dumps(state | changed))
        words = ["watch", "propose", str(tmp_path / "watch.json"), "-o", str(tmp_path / "out.json"), *arguments]
        status, said = run(words), capsys.readouterr()
        assert (status, said.out, said.err.count("\n")) == (2, "", 1), said
        assert not (tmp_path / "out.json").exists()
        return said.err

    record, elsewhere = str(tmp_path / "HS-1.json"), str(tmp_path / "HS-2.json")
    assert "is the state of tool HS-2; record" in says({"tool": "HS-2"}, "--calibration", record)
    assert "is the state of tool HS-1; record" in says({}, "--calibration", elsewhere)
    found = says({}, "--store", str(tmp_path / "store-HS-2"))
    assert f"watched record {calibration.id[:12]} of tool HS-1, which is not in" in found
    assert "another version" in says({"format": "highside.watch-state/2"}, "--calibration", record)
    assert "tool: " in says({"tool": 5}, "--calibration", record)


def test_nothing_is_proposed_of_what_the_attitudes_do_not_name(
    calibration: highside.Calibration, shocked: dict[str, Array], named: highside.WatchedRecording
) -> None:
    found = highside.watch_recording(shocked, calibration)
    assert len(found.found.claims[0].equivalence_class) > 1
    with pytest.raises(InputError, match=r"not told apart .* roll tests"):
        found.proposal(calibration)
    quiet = highside.watch_recording(rows_of_a_well(5, stands=2, inclinations_deg=(5.0, 9.0)), calibration)
    with pytest.raises(InputError, match="nothing departs"):
        quiet.proposal(calibration)
    other = highside.calibrate(poses_of_a_good_tool(2), "joint", tool="HS-1", temp_c=25.0)
    with pytest.raises(InputError, match="the record that was in force"):
        named.proposal(other)
    said = named.to_dict()
    claim = said["claims"][0] | {"parameter": "gravity", "equivalence_class": ["gravity"]}
    with pytest.raises(InputError, match="no offset or matrix"):
        proposal_of(json.dumps(said | {"claims": [claim]}).encode(), calibration, where="w")
    for member, value in (("covariance", [[0.0] * 12] * 12), ("parameters", {}), ("schema", "x"), ("claims", [{}])):
        with pytest.raises(InputError, match=r"^w: "):
            propose(
                calibration.record, read_outcome(json.dumps(said | {member: value}).encode(), "w"), now_s=1e9, where="w"
            )


def test_the_picture_shows_deviations_over_time(named: highside.WatchedRecording) -> None:
    plot = named.plot()
    assert [panel.y_label for panel in plot.panels] == ["offset, mg", "scale, mg/g"]
    line = plot.panels[0].lines[0]
    assert line.name == "b_x"
    assert line.y[-1] == pytest.approx(2.0, abs=0.2)


ABSURD = {
    "a state of 1e6 g": {"state": 1e6},
    "a state of the filter alone": {"alone_state": -20.0},
    "a variance": {"covariance": 1e6},
    "a variance below zero": {"alone_covariance": -1e-12},
    "no variance": {"covariance": 0.0},
    "a walk": {"walked": 1e6},
    "the trace": {"trace": 1e4},
    "an onset to come": {"bank_since": 1e9},
    "a jump of the noise": {"jump": 1e7},
    "squares": {"squares": 1e13},
}
FACTS: dict[str, dict[str, float]] = {
    "time": {"last_s": 1e300},
    "a time that is none": {"last_s": float("nan")},
    "a depth": {"depth_km": 1e14},
    "a temperature": {"ref_c": float("nan")},
    "a difference of temperatures": {"warmer_c": -1e300},
    "a count": {"stills": 10**300},
}


def test_a_memory_with_a_number_beyond_reason_is_refused(calibration: highside.Calibration) -> None:
    """Each was taken up: the watch then said that all holds, or ended with every stretch, without a word."""
    watch = a_watch(calibration)
    said_after(watch, stretches(rows_of_a_well(4, stands=2, inclinations_deg=(20.0, 30.0)), calibration))
    memory, prior = watch.memory(), prior_of_record(calibration.record)
    Watch(prior, "x").recall(memory)
    wrong = {what: replace(memory, **values) for what, values in FACTS.items()}  # type: ignore[arg-type]
    for what, values in ABSURD.items():
        for first_only in (True, False):
            for name, value in values.items():
                bad = memory.arrays[name].copy()
                bad.flat[slice(0, 1 if first_only else None)] = value
                wrong[f"{what}, {first_only}"] = replace(memory, arrays={**memory.arrays, name: bad})
    for name in ("state", "alone_state", "covariance", "trace", "bank_since", "squares", "f"):
        longer = np.concatenate([memory.arrays[name].ravel(), [0.0]])
        wrong[f"{name}, longer"] = replace(memory, arrays={**memory.arrays, name: longer})
    for what, bad_memory in wrong.items():
        with pytest.raises(ValueError, match=r"\w"):
            pytest.fail(f"{what} was taken up: {Watch(prior, 'x').recall(bad_memory)}")


@pytest.mark.parametrize(("wander_deg", "over_s"), [(10.0, 60.0), (5.0, 60.0)])
def test_a_tool_that_slides_slowly_is_not_at_rest(wander_deg: float, over_s: float) -> None:
    """Its mean is shorter than gravity by half the variance of its direction, which would be read as a departure."""
    rows = sliding(81_000_003, wander_deg, over_s)
    said = streamed(rows)
    assert said.verdict != "departs"
    assert said.counts.left_out["rest in which the tool moves slowly"] > 0
    assert said.counts.stills >= 16
    assert highside.watch_recording(rows, calibration_of_surveys()).verdict != "departs"


def test_a_noisy_sensor_at_rest_does_not_move() -> None:
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 120.0, 0.05)
    f = np.array([[0.5], [0.0], [np.sqrt(0.75)]])
    moves = 0
    for _ in range(200):
        white = 20e-3 * rng.standard_normal((3, t.size))
        slow = 3e-4 * np.cumsum(rng.standard_normal((3, 120)), axis=1) / np.sqrt(120)
        moves += wanders(t, f + white + np.repeat(slow, 20, axis=1))
    assert moves == 0
    turned = np.radians(3.0) * t / t[-1]
    assert wanders(t, np.array([0.5 * np.cos(turned), 0.5 * np.sin(turned), 0.0 * t + np.sqrt(0.75)]))
