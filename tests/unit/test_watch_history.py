"""The picture of the last day: what the service says of it, what a page makes of it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from highside.service.messages import PAYLOADS
from highside.service.watch_history import POINTS, SPAN_S, history
from highside.service.watch_messages import WatchHistory
from highside.service.watch_stage import WatchStage
from highside.watch.parameters import CALIBRATION, NAMES
from highside.web.tools.state import PAYLOAD_MAX, History, Tools
from highside.web.tools.views import Broker, tool_page
from highside.web.tools.watch_chart import PANELS, watch_chart
from tests.faults.seeds import watch_stage

NOW = 1.79e9


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
    said = history(with_trace(watch_stage(), times), NOW)
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
    said = history(with_trace(watch_stage(), np.zeros(0)), NOW)
    assert (said.times, said.parameters["b_x"].value) == ([], [])
    stage = with_trace(watch_stage(), np.array([0.0, 10.0, 20.0]))
    stage._rows.t_s = 2.0 * SPAN_S
    assert history(stage, NOW).times == []


def shown(said: dict[str, Any]) -> History | None:
    tools = Tools("highside")
    tools.take("highside/a/watch/history", json.dumps(said).encode(), retained=True, mono=0.0, utc=NOW)
    return tools.tools["a"].history


def test_the_page_draws_each_parameter_with_its_band_of_two_standard_deviations() -> None:
    said = history(with_trace(watch_stage(), np.arange(0.0, SPAN_S, 600.0)), NOW)
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
    said = json.loads(history(with_trace(watch_stage(), np.arange(0.0, 6000.0, 600.0)), NOW).model_dump_json())
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
    assert "holds, watched for 2 h; it began from the record" in page
    assert "+0.1 ± 0.04" in page
    assert "mg" in page and "<i>" not in page
