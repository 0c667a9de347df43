"""The picture of the last day: what the service says of it, what a page makes of it."""

from __future__ import annotations

import asyncio
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import highside
from highside.calibration.correction import IdentityCorrection
from highside.config.rig import WitsItem
from highside.config.settings import Settings, validate
from highside.config.watch import WatchSettings
from highside.errors import InputError, Refused
from highside.service.damage import DamageLog
from highside.service.in_force import CalibrationInForce
from highside.service.messages import PAYLOADS
from highside.service.rig.wits import Latest, record
from highside.service.saved_drift import Stamp
from highside.service.saved_watch import Numbers, SavedWatch, read, write
from highside.service.watch_history import POINTS, SPAN_S, history
from highside.service.watch_keeper import WatchKeeper, WatchParts
from highside.service.watch_messages import WatchHistory, WatchMessage
from highside.service.watch_stage import VERDICTS, Watched, WatchStage
from highside.watch.parameters import CALIBRATION, NAMES
from highside.watch.proposal import read_outcome
from highside.web.tools.state import PAYLOAD_MAX, History, Tools
from highside.web.tools.views import Broker, tool_page
from highside.web.tools.watch_chart import PANELS, watch_chart
from highside.web.tools.watch_words import watch_words
from tests.faults.seeds import watch_stage
from tests.unit.watch_frames import poses_of_a_good_tool

NOW = 1.79e9


@cache
def kept_state() -> SavedWatch:
    return watch_stage().saved()


def a_stage() -> WatchStage:
    """As `watch_stage()`, whose sums are made once."""
    return watch_stage(kept_state())


def test_what_nobody_watches_any_more_is_told_to_no_rig(tmp_path: Path) -> None:
    """A reload with `enabled = false`, or to no record: the last verdict was sent on for ever."""
    settings = validate({"tool": {"id": "t1"}, "link": {"kind": "simulated"}, "codec": {"name": "tool"}}, where="x")
    parts = WatchParts(settings, a_stage())
    keeper = WatchKeeper(tmp_path, lambda *_: None, lambda _: lambda _: None, lambda: parts, DamageLog())
    latest = Latest(watch=keeper.figures)
    items = (WitsItem(code="0740", value="watch_verdict"),)
    keeper.publish()
    assert dict(record(items, latest, 0.0, 30.0)) == {"0740": f"{float(VERDICTS.index(a_stage().said.verdict)):.2f}"}
    before, parts = parts.stage, WatchParts(settings, None)
    keeper.took_over(before)
    assert not record(items, latest, 0.0, 30.0)
    parts = WatchParts(settings, a_stage())
    keeper.took_over(None)
    keeper.publish()
    assert [code for code, _ in record(items, latest, 0.0, 30.0)] == ["0740"]


def a_keeper(folder: Path, parts: list[WatchParts], said: dict[str, list[bytes]] | None = None) -> WatchKeeper:
    """Of the last of the parts; what it says is added to `said`."""
    heard = {} if said is None else said
    retained = lambda name: lambda payload: heard.setdefault(name, []).append(payload)  # noqa: E731
    return WatchKeeper(folder, lambda *_: None, retained, lambda: parts[-1], DamageLog())


def some_settings(watch: dict[str, Any] | None = None) -> Settings:
    tool: dict[str, Any] = {"tool": {"id": "HS-1"}, "link": {"kind": "simulated"}, "codec": {"name": "tool"}}
    return validate(tool | ({} if watch is None else {"watch": watch}), where="x")


def test_a_watch_that_is_switched_off_takes_back_what_it_said_once(tmp_path: Path) -> None:
    """The retained verdict stood at the broker for ever."""
    heard: dict[str, list[bytes]] = {}
    parts = [WatchParts(some_settings(), a_stage())]
    keeper = a_keeper(tmp_path, parts, heard)
    keeper.publish()
    parts.append(WatchParts(some_settings({"enabled": False}), None))
    for _ in range(2):
        keeper.took_over(parts[0].stage)
        keeper.publish()
    assert [WatchMessage.model_validate_json(one).verdict for one in heard["watch"]] == ["learning", "off"]
    assert not WatchHistory.model_validate_json(heard["watch/history"][-1]).times
    assert WatchMessage.model_validate_json(heard["watch"][-1]).began.endswith("switched off in the configuration")

    async def started(folder: Path) -> list[bytes]:
        heard.clear()
        keeper = a_keeper(folder, parts, heard)
        keeper.start()
        await keeper.stop()
        return heard.get("watch", [])

    # a service that begins with it switched off takes back what the run before said, and else says nothing
    assert asyncio.run(started(tmp_path)) == []
    write(tmp_path / "watch.json", "HS-1", Stamp.now(synced=True), {}, kept_state())
    (off,) = asyncio.run(started(tmp_path))
    assert json.loads(off)["verdict"] == "off"
    tools = Tools("highside")
    tools.take("highside/HS-1/watch", off, retained=True, mono=1.0, utc=NOW)
    said = watch_words(tools.tools["HS-1"])
    assert said == "The watch says: off; nothing is watched: it is switched off in the configuration."


def rests(stage: WatchStage) -> None:
    """A rest of a minute that waits for its sums, and half a minute of the next that is being collected."""
    for first, count in ((0.0, 600), (200.0, 300)):
        for k in range(count):
            t = first + 0.1 * k
            stage.close(t, 1000.0 + t, (0.5, 1e-5 * (k % 3), 0.75**0.5), 25.0)
    assert len(stage.waiting) == 1


def test_what_waits_at_a_reload_is_used_under_the_new_limits(tmp_path: Path) -> None:
    calibration = CalibrationInForce(IdentityCorrection(1e-5, 1e-5), a_stage().of.record)
    parts: list[WatchParts] = []
    keeper = a_keeper(tmp_path, parts)
    parts.append(keeper.build(some_settings(), calibration))
    before = parts[0].stage
    assert before is not None
    rests(before)
    for _ in range(2):  # a reload builds twice
        after = keeper.build(some_settings({"interval_s": 7.0}), calibration, parts[0]).stage
    assert after is not None and after is not before
    after.finish()
    while after.waiting:
        after.take_result(after.core.take(after.waiting.popleft()))
    assert (after.said.counts.stills, after.dropped) == (2, 0)
    # one whose sums are being made while the parts are built is carried over, unless they are made already
    before.working = before.waiting.popleft()
    assert before.carried()[1].waiting == (before.working,)
    before.core.take(before.working)
    assert before.carried()[1].waiting == ()


def test_what_waits_when_another_record_comes_in_force_is_counted_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record, other = a_stage().of.record, highside.calibrate(poses_of_a_good_tool(2), "joint", tool="HS-1").record
    parts: list[WatchParts] = []
    keeper = a_keeper(tmp_path, parts)
    parts.append(keeper.build(some_settings(), CalibrationInForce(IdentityCorrection(1e-5, 1e-5), record)))
    before = parts[0].stage
    assert before is not None
    rests(before)
    parts.append(keeper.build(some_settings(), CalibrationInForce(IdentityCorrection(1e-5, 1e-5), other), parts[0]))
    keeper.took_over(before)
    assert parts[-1].stage is not None and parts[-1].stage.health()["dropped"] == 2
    assert "2 stretches before the reload were not used: they are of another record" in caplog.text


def test_what_was_collected_is_used_and_kept_when_the_watch_is_switched_off(tmp_path: Path) -> None:
    parts: list[WatchParts] = []
    keeper = a_keeper(tmp_path, parts)
    calibration = CalibrationInForce(IdentityCorrection(1e-5, 1e-5), a_stage().of.record)
    parts.append(keeper.build(some_settings(), calibration))
    before = parts[0].stage
    assert before is not None
    rests(before)

    async def off() -> None:
        parts.append(WatchParts(some_settings({"enabled": False}), None))
        keeper.took_over(before)
        await keeper.stop()

    asyncio.run(off())
    saved = read(tmp_path / "watch.json", "HS-1", Stamp.now(synced=True))
    assert saved is not None and saved.facts.stills == 2


@pytest.mark.parametrize("t_s", [1e300, -1.0])
def test_a_state_whose_own_time_is_none_is_refused(t_s: float, tmp_path: Path) -> None:
    path, stamp = tmp_path / "watch.json", Stamp.now(synced=True)
    write(path, "t1", stamp, {}, kept_state().model_copy(update={"t_s": t_s}))
    with pytest.raises(Refused, match=r"is no saved watch: state\.t_s"):
        read(path, "t1", stamp)


@pytest.mark.parametrize("member", ["last_s", "onset_s"])
def test_a_state_that_goes_on_after_its_own_time_is_refused(member: str) -> None:
    """No measurement was later than the one before: the random walk stood still for as long."""
    kept = kept_state()
    facts = kept.facts.model_copy(update={member: kept.t_s + 1.0})
    with pytest.raises(Refused, match="after its own time"):
        watch_stage(kept.model_copy(update={"facts": facts}))


def test_a_state_that_cannot_be_written_is_said_and_ends_nothing(tmp_path: Path) -> None:
    """A host whose clock stepped by centuries over a restart: the watch's own time is beyond what a state may have."""
    stage = a_stage()
    stage._rows.t_s = 2e10
    keeper = a_keeper(tmp_path, [WatchParts(some_settings(), stage)])

    async def runs() -> None:
        keeper.start()
        await keeper.stop()

    asyncio.run(runs())
    assert keeper.alarms() == ["watch_state"]
    assert not (tmp_path / "watch.json").exists()


def with_trace(stage: WatchStage, times: np.ndarray) -> WatchStage:
    """The stage with measurements at `times`, its own time at the last; the k-th says k in all parameters."""
    from dataclasses import replace

    k = np.arange(times.size, dtype=float)
    trace = replace(
        stage.said.trace,
        t_s=times,
        value=1e-6 * np.repeat(k[:, None], CALIBRATION, axis=1),
        std=np.full((times.size, CALIBRATION), 1e-4),
        inclination_deg=k % 90.0,
        evidence=k,
    )
    stage.said = replace(stage.said, trace=trace)
    stage._rows.t_s = float(times[-1]) if times.size else 0.0
    return stage


def test_a_day_is_told_by_the_last_measurement_of_each_ten_minutes_and_no_more() -> None:
    times = np.arange(0.0, 3.0 * SPAN_S, 97.0)
    said = history(with_trace(a_stage(), times), NOW)
    assert len(said.times) <= POINTS
    assert len(said.times) >= POINTS - 1
    ages = NOW - np.array(said.times)
    assert ages[-1] == pytest.approx(0.0, abs=0.1)
    assert ages[0] <= SPAN_S
    assert (np.diff(said.times) > 0.0).all()
    assert np.diff(said.times).max() <= SPAN_S / POINTS + 97.0
    # each is the measurement of its time, not a mean of several
    k = np.rint((times[-1] - ages) / 97.0)
    assert said.parameters["b_x"].value == pytest.approx(1e-6 * k, rel=1e-3)
    assert list(said.parameters) == list(NAMES[:CALIBRATION])
    assert len(said.model_dump_json()) < PAYLOAD_MAX
    assert PAYLOADS["watch/history"] is WatchHistory


def test_before_the_first_measurement_it_is_empty_and_beyond_a_day_it_is_forgotten() -> None:
    said = history(with_trace(a_stage(), np.zeros(0)), NOW)
    assert (said.times, said.parameters["b_x"].value) == ([], [])
    stage = with_trace(a_stage(), np.array([0.0, 10.0, 20.0]))
    stage._rows.t_s = 2.0 * SPAN_S
    assert history(stage, NOW).times == []


def test_it_goes_on_under_another_calibration_and_says_when_that_came_into_force() -> None:
    first = a_stage()
    seen = history(first, NOW)
    assert len(seen.times) == 2
    assert seen.changes == []
    # through the state that is kept, as after a restart of the service
    kept = SavedWatch.model_validate_json(first.saved().model_dump_json()).model_copy(update={"age_s": 0.0})
    other = Watched(first.of.record, 1.001, 1e-4)
    second = WatchStage(WatchSettings(), other, follows=kept, began="began anew: another")
    said = history(second, NOW)
    assert (said.times, said.parameters, said.evidence) == (seen.times, seen.parameters, seen.evidence)
    (change,) = said.changes
    assert (change.t, change.before, change.cal_id, change.why) == (
        NOW,
        seen.cal_id,
        seen.cal_id,
        "began anew: another",
    )
    # what was seen is history alone
    assert (second.said.counts.stills, second.said.duration_s) == (0, 0.0)
    # the watch in force goes on after it
    measure(second, 4000.0)
    then = history(second, NOW)
    before = then.parameters["b_x"].value[: len(seen.times)]
    assert len(then.times) == len(seen.times) + second.said.counts.stills
    assert before == seen.parameters["b_x"].value
    assert (np.diff(then.times) > 0.0).all()
    assert then.times[len(seen.times) - 1] <= then.changes[0].t < then.times[len(seen.times)]
    # a third keeps both, and a restart under the same record too
    third = WatchStage(WatchSettings(), other, follows=second.saved(), began="began anew: a third")
    assert [one.why for one in history(third, NOW).changes] == ["began anew: another", "began anew: a third"]
    again = WatchStage(WatchSettings(), other, third.saved())
    assert history(again, NOW) == history(third, NOW).model_copy(update={"began": again.began})
    # a day later it is forgotten
    again._rows.t_s += SPAN_S
    assert (history(again, NOW).times, history(again, NOW).changes) == ([], [])
    again._rows.t_s -= SPAN_S
    again.begin_again()
    assert (history(again, NOW).times, history(again, NOW).changes) == ([], [])


def measure(stage: WatchStage, t_s: float) -> None:
    """A rest of a minute at 30 deg, by the tool's own time from `t_s` on."""
    rng = np.random.default_rng(1)
    for t in np.arange(t_s, t_s + 60.0, 0.1):
        x, y, z = np.array([0.5, 0.0, 0.8660254]) + 1e-4 * rng.standard_normal(3)
        stage.add(float(t), 0.0, 0.0, 0.0)
        stage.close(float(t), float(t), (x, y, z), 25.0)
    stage.finish()
    while stage.waiting:
        stage.take_result(stage.core.take(stage.waiting.popleft()))


@pytest.mark.parametrize("damage", ["shape", "order", "future"])
def test_an_earlier_trace_that_is_none_is_damage(damage: str) -> None:
    stage = a_stage()
    kept = stage.saved()
    kept = WatchStage(WatchSettings(), stage.of, follows=kept, began="x").saved()
    (one,) = kept.earlier
    rows = one.rows()
    wrong = {"shape": rows[:, :-1], "order": rows[::-1], "future": rows + one.until_s + 1.0}[damage]
    bad = kept.model_copy(update={"earlier": [one.model_copy(update={"trace": Numbers.of(wrong)})]})
    with pytest.raises(Refused, match="earlier trace"):
        WatchStage(WatchSettings(), stage.of, bad)


def test_the_picture_breaks_its_lines_where_another_calibration_came_into_force() -> None:
    said = json.loads(history(with_trace(a_stage(), np.arange(0.0, 6000.0, 600.0)), NOW).model_dump_json())
    change = {"t": said["times"][4], "before": "a", "cal_id": "b" * 64, "why": "began anew"}
    found = shown(said | {"changes": [change, 5, {"t": None}]})
    assert found is not None
    at = found.hours[4]
    assert found.changes == ((at, "b" * 12),)
    options = watch_chart(found)
    series = {one["name"]: one for one in options["series"]}
    for name in ("b_x", "S_zz, width", "S_zx, lower end", "evidence"):
        data = series[name]["data"]
        assert len(data) == len(found.hours) + 1
        assert data[5] == [at, None]
    marks = [one["markLine"]["data"] for one in options["series"] if "markLine" in one]
    assert len(marks) == len(PANELS) + 1
    assert marks[0] == [{"xAxis": at, "label": {"formatter": f"calibration {'b' * 12}"}}]
    assert f"{-at:.1f} hours ago calibration {'b' * 12} came into force" in options["aria"]["label"]["description"]


def shown(said: dict[str, Any]) -> History | None:
    tools = Tools("highside")
    tools.take("highside/a/watch/history", json.dumps(said).encode(), retained=True, mono=0.0, utc=NOW)
    return tools.tools["a"].history


def test_the_page_draws_each_parameter_with_its_band_of_two_standard_deviations() -> None:
    said = history(with_trace(a_stage(), np.arange(0.0, SPAN_S, 600.0)), NOW)
    found = shown(json.loads(said.model_dump_json()))
    assert found is not None
    assert found.hours[-1] == 0.0
    assert found.hours[0] == pytest.approx(-24.0, abs=0.2)
    series = {one["name"]: one for one in watch_chart(found)["series"]}
    for names in (names for _, names in PANELS):
        for name in names:
            middle, low, wide = (
                np.array(series[label]["data"]) for label in (name, f"{name}, lower end", f"{name}, width")
            )
            # thousandths; the band reaches below zero, where stacking by sign would lose it
            assert middle[:, 1] == pytest.approx(1e3 * np.array(said.parameters[name].value), rel=1e-3)
            assert low[:, 1] == pytest.approx(middle[:, 1] - 0.2, abs=1e-3)
            assert wide[:, 1] == pytest.approx(np.full(middle.shape[0], 0.4))
            assert series[f"{name}, width"]["stackStrategy"] == "all"
    assert series["threshold"]["data"][0][1] == 36.0


@pytest.mark.parametrize(
    "change",
    [{"times": None}, {"times": [3.0, 1.0]}, {"times": ["x"]}, {"t": "now"}, {"times": [1.0] * 2000}],
    ids=["none", "backwards", "words", "no time", "too many"],
)
def test_a_history_that_is_none_is_not_drawn(change: dict[str, Any]) -> None:
    said = json.loads(history(with_trace(a_stage(), np.arange(0.0, 6000.0, 600.0)), NOW).model_dump_json())
    assert shown(said) is not None
    assert shown(said | change) is None


def test_what_is_missing_or_foreign_in_a_history_leaves_gaps() -> None:
    found = shown({
        "t": 10.0, "times": [1.0, 2.0], "parameters": {"<b>": {"value": [1.0], "std": "x"}, "b_x": 5}, "evidence": 7
    })  # fmt: skip
    assert found is not None
    assert found.parameters["<b>"].value == (1.0, None)
    assert found.parameters["<b>"].std == (None, None)
    assert (found.evidence, found.threshold) == ((None, None), None)
    json.dumps(watch_chart(found), allow_nan=False)


def test_the_page_says_what_the_watch_says_in_words_and_numbers() -> None:
    tools = Tools("highside")
    said = {
        "verdict": "holds", "watched_s": 7200.0, "began": "began from the record",
        "parameters": {"b_x": {"value": 1e-4, "std": 2e-5, "unit": "g", "observable": True}, "<i>": 3},
    }  # fmt: skip
    here = Broker("127.0.0.1:1883", True, "", 0.0)
    tools.take("highside/a/status", b"online", retained=True, mono=0.0, utc=NOW)
    assert "Nothing watches" in tool_page(tools.tools["a"], here, 0.0).watch
    tools.take("highside/a/watch", json.dumps(said).encode(), retained=True, mono=0.0, utc=NOW)
    page = tool_page(tools.tools["a"], here, 0.0).watch
    assert "holds, watched for 2 h; began from the record" in page
    assert "+0.100 ±\u00a00.040" in page
    assert "mg" in page and "<i>" not in page


def test_the_page_says_what_departs_what_to_do_and_what_would_show_the_rest() -> None:
    error = {"inc_deg": 0.0231, "tf_sin_inc_deg": -0.0472, "tf_deg": None}
    claim = {
        "effect": "bias_step", "parameter": "b_x", "equivalence_class": ["b_x", "S_xz"], "size": -8e-4, "std": 4e-5,
        "unit": "g", "error": error,
    }  # fmt: skip
    said = {
        "verdict": "departs", "claims": [claim, 7, {"parameter": "<b>", "size": "x", "error": [1]}],
        "noise_changes": [{"axis": "y", "factor": 4.13}, {"axis": "<i>", "factor": 2.0}, "z"], "undecided": 0,
        "advice": ["take a roll test"], "not_observable": {"b_z": "needs <u>", "S_zz": "needs <u>", "kT_x": 5},
        "parameters": {"b_x": {"value": -8e-4, "std": 4e-5, "unit": "g", "observable": True}},
    }  # fmt: skip
    tools, here = Tools("highside"), Broker("127.0.0.1:1883", True, "", 0.0)
    tools.take("highside/a/status", b"online", retained=True, mono=0.0, utc=NOW)

    def shown() -> str:
        tools.take("highside/a/watch", json.dumps(said).encode(), retained=True, mono=0.0, utc=NOW)
        return tool_page(tools.tools["a"], here, 0.0).watch

    page = shown()
    assert "b_x / S_xz: b_x \u22120.800 ±\u00a00.080 mg; ΔI +0.023°, ΔT·sin I \u22120.047°" in page
    assert "y 4.1 ×" in page
    assert "<b>b_z, S_zz</b>" in page
    assert "needs &lt;u&gt;" in page
    assert "<u>" not in page and "<i>" not in page
    # the advice stands at the top of the page where it departs, and here where it does not
    assert "take a roll test" not in page
    said |= {"verdict": "learning", "claims": [], "undecided": 2}
    page = shown()
    assert "take a roll test" in page
    assert "noise that has grown or a departure" in page
    said |= {"claims": "x", "advice": 3, "not_observable": [1], "noise_changes": {"axis": "y"}, "undecided": "x"}
    assert "departs" not in shown()


def test_a_kept_state_goes_on_only_as_it_was_written(tmp_path: Path) -> None:
    """One letter of its numbers changed makes other numbers, mostly such as could be."""
    path, stamp = tmp_path / "watch.json", Stamp.now(synced=True)
    write(path, "t1", stamp, {"verdict": "holds"}, kept_state())
    whole = path.read_bytes()
    assert read(path, "t1", stamp) is not None
    at = whole.index(b'"data": "') + 20
    for place, other in ((at, b"B" if whole[at : at + 1] != b"B" else b"C"), (whole.index(b"holds"), b"H")):
        path.write_bytes(whole[:place] + other + whole[place + 1 :])
        with pytest.raises(Refused, match="not what was written"):
            read(path, "t1", stamp)
        with pytest.raises(InputError, match="damaged"):
            read_outcome(path.read_bytes(), "watch.json")
    file = json.loads(whole)
    del file["sha256"]
    path.write_text(json.dumps(file))
    assert read(path, "t1", stamp) is not None, "an earlier version's"
