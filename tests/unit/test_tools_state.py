"""What the tools' page knows: folded from messages, stale by this process's clock, lenient with what others send."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from highside.attitude.scalar import gravity_vector
from highside.web.space import orientation
from highside.web.tools.drawings import dial, trend
from highside.web.tools.state import STALE_S, TOOLS_MAX, TOPICS, TREND_LENGTH, Tools, ToolState
from highside.web.tools.views import Broker, list_page, tool_page
from highside.words.worded import worded

HERE = Broker("broker:1883", True, "", 0.0)
ATTITUDE = {
    "t": 1.7e9, "inc_deg": 12.5, "inc_std_deg": 0.01, "tf_deg": 100.0, "tf_std_deg": 0.1, "motor_toolface_deg": 110.0,
    "g_total": 1.0001, "cal_id": "a" * 64, "zone": "all", "flags": [], "historical": False,
}  # fmt: skip


def said(
    tools: Tools, name: str, payload: object, *, mono: float = 0.0, retained: bool = False, tool: str = "a"
) -> None:
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    tools.take(f"highside/{tool}/{name}", data, retained=retained, mono=mono, utc=1.7e9 + mono)


@pytest.fixture
def tools() -> Tools:
    return Tools("highside")


def test_a_tool_is_live_silent_offline_by_what_was_heard_when(tools: Tools) -> None:
    said(tools, "status", b"online", retained=True)
    tool = tools.tools["a"]
    assert tool.condition(0.0) == "silent", "online and no attitude has come"
    said(tools, "attitude", ATTITUDE, mono=1.0)
    assert tool.condition(1.0 + STALE_S) == "live"
    assert tool.condition(1.1 + STALE_S) == "silent"
    said(tools, "status", b"offline", mono=2.0)
    assert tool.condition(2.0) == "offline", "its last will is believed over an attitude of a second ago"


def test_a_slow_tool_is_not_called_silent_between_its_attitudes(tools: Tools) -> None:
    for k in range(6):
        said(tools, "attitude", ATTITUDE, mono=10.0 * k)
    assert tools.tools["a"].condition(50.0 + 29.0) == "live"
    assert tools.tools["a"].condition(50.0 + 31.0) == "silent"


@pytest.mark.parametrize("more", [{"historical": True}, {"retained": True}])
def test_what_comes_late_is_counted_and_never_shown_as_the_present(tools: Tools, more: dict[str, bool]) -> None:
    said(
        tools, "attitude", ATTITUDE | {k: v for k, v in more.items() if k == "historical"}, retained="retained" in more
    )
    tool = tools.tools["a"]
    assert (tool.reading, tool.late, tool.attitudes) == (None, 1, 1)
    assert tool.condition(0.0) == "unknown"


def test_changes_are_logged_once_and_ordinary_flags_are_not(tools: Tools) -> None:
    for flags in ([], ["moving"], ["uncalibrated"], ["uncalibrated"], []):
        said(tools, "attitude", ATTITUDE | {"flags": flags})
    said(tools, "attitude", ATTITUDE | {"cal_id": "b" * 64})
    said(tools, "health", {"alarms": ["link_down"]})
    said(tools, "health", {"alarms": []})
    said(tools, "survey", ATTITUDE | {"accepted": False, "reasons": ["moved"], "duration_s": 10.0})
    said(tools, "watch", {"verdict": "departs", "claims": [{"effect": "bias_step"}], "advice": ["take a roll test"]})
    assert [event.text for event in tools.tools["a"].events] == [
        "flag uncalibrated", "flag uncalibrated is over",
        "calibration bbbbbbbbbbbb in force, before it aaaaaaaaaaaa",
        "alarm link_down", "alarm link_down is over", "survey refused: moved", "watch: departs",
    ]  # fmt: skip


def test_those_that_need_attention_come_first(tools: Tools) -> None:
    for name in ("a", "b", "c"):
        said(tools, "status", b"online", tool=name)
        said(tools, "attitude", ATTITUDE, tool=name)
    said(tools, "health", {"alarms": ["link_stale"]}, tool="b")
    said(tools, "watch", {"verdict": "departs"}, tool="c")
    assert [tool.tool for tool in tools.in_order(0.0)] == ["b", "c", "a"]
    page = list_page(tools, HERE, 0.0)
    assert "2 of 3 tools need attention." in page
    assert "power and wiring of the tool" in page, "the alarm says what to do"


@given(
    st.binary(max_size=200),
    st.sampled_from(TOPICS),
)
def test_no_message_ends_the_page(payload: bytes, name: str) -> None:
    tools = Tools("highside")
    said(tools, name, payload)
    for tool in tools.tools.values():
        tool_page(tool, HERE, 1.0)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
members = st.sampled_from([
    *ATTITUDE, "alarms", "link", "outbox", "recorder", "calibration", "surveys", "vibration", "version", "verdict",
    "claims", "advice", "accepted", "reasons", "duration_s", "temp_c", "g_error_mg", "motion",
])  # fmt: skip


@settings(suppress_health_check=[HealthCheck.too_slow])  # of a busy machine
@given(
    st.dictionaries(members, anything, max_size=12),
    st.sampled_from([name for name in TOPICS if name != "status"]),
)
def test_no_member_of_another_type_ends_the_page(message: dict[str, object], name: str) -> None:
    tools = Tools("highside")
    try:
        data = json.dumps(message, allow_nan=True).encode()
    except UnicodeEncodeError:
        return
    said(tools, name, data)
    said(tools, "attitude", ATTITUDE)
    page = tool_page(tools.tools["a"], HERE, 1.0)
    assert "12.500°" in page.figures
    list_page(tools, HERE, 1.0)


@given(st.text(min_size=1, max_size=40))
def test_nothing_from_outside_becomes_markup(evil: str) -> None:
    tools = Tools("highside")
    name = f"<b>{evil}</b><script>"
    said(tools, "attitude", ATTITUDE | {"flags": [name], "cal_id": name})
    said(tools, "health", {"alarms": [name], "link": {"state": name}, "calibration": {"refused": name, "cal_id": name}})
    said(tools, "survey", ATTITUDE | {"reasons": [name]})
    page = tool_page(tools.tools["a"], HERE, 1.0)
    for part in (page.head, page.parts, page.surveys, page.events, list_page(tools, HERE, 1.0)):
        assert "<script>" not in part
    said(tools, "status", b"online", tool="<script>")
    assert "<script>" not in list_page(tools, HERE, 1.0)


def test_a_crowd_of_tools_is_bounded_and_counted(tools: Tools) -> None:
    for k in range(TOOLS_MAX + 5):
        said(tools, "status", b"online", tool=f"t{k}")
    said(tools, "status", b"online", tool="a/b")
    tools.take("elsewhere/a/status", b"online", retained=False, mono=0.0, utc=0.0)
    assert (len(tools.tools), tools.refused) == (TOOLS_MAX, 7)


def test_the_trend_is_thinned_and_bounded(tools: Tools) -> None:
    for k in range(20 * TREND_LENGTH):
        said(tools, "attitude", ATTITUDE, mono=0.1 * k)
    tool = tools.tools["a"]
    assert len(tool.trend) == TREND_LENGTH
    steps = np.diff([point.mono for point in tool.trend])
    assert steps.min() >= 1.0 - 1e-9


def test_the_digits_shown_follow_the_uncertainty(tools: Tools) -> None:
    for std, text in ((0.2, "12.35°"), (0.004, "12.3457°"), (3.0, "12.3°"), (30.0, "12°"), (None, "12.35°")):
        said(tools, "attitude", ATTITUDE | {"inc_deg": 12.345678, "inc_std_deg": std})
        assert text in tool_page(tools.tools["a"], HERE, 0.0).figures


def test_nothing_is_shown_as_minus_nothing(tools: Tools) -> None:
    for error, text in ((-0.004, "+0.00"), (0.004, "+0.00"), (-0.006, "-0.01")):
        said(tools, "survey", ATTITUDE | {"g_error_mg": error, "accepted": True})
        assert f">{text}<" in tool_page(tools.tools["a"], HERE, 0.0).surveys
        tools.tools["a"].surveys.clear()


def test_without_a_broker_nothing_is_shown_as_live(tools: Tools) -> None:
    said(tools, "attitude", ATTITUDE)
    away = Broker("broker:1883", False, "connection lost", 5.0)
    page = tool_page(tools.tools["a"], away, 0.1)
    assert "stale" in page.figures
    assert "connection lost" in page.head
    assert "card stale" in list_page(tools, away, 0.1)


# --- drawings ----------------------------------------------------------------------------------------------------

angles = st.floats(0.0, 360.0)


@given(st.floats(0.0, 180.0), angles, angles)
def test_the_tool_is_drawn_as_its_accelerometers_report_it(inc: float, tf: float, azi: float) -> None:
    matrix = np.array(orientation(inc, tf, azi))
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert matrix[2] == pytest.approx(gravity_vector(math.radians(inc), math.radians(tf)), abs=1e-12)
    down = -matrix[:, 2]
    assert down[0] == pytest.approx(math.sin(math.radians(inc)) * math.sin(math.radians(azi)), abs=1e-12)
    assert down[1] == pytest.approx(math.sin(math.radians(inc)) * math.cos(math.radians(azi)), abs=1e-12)


def test_the_dial_has_zero_at_the_top_and_turns_clockwise() -> None:
    for tf, x, y in ((0.0, 0.0, -1.0), (90.0, 1.0, 0.0), (180.0, 0.0, 1.0), (270.0, -1.0, 0.0)):
        needle = dial(tf, 1.0, []).needle
        assert needle is not None
        assert (needle.x / 92.0, needle.y / 92.0) == pytest.approx((x, y), abs=1e-12)
    drawn = dial(None, None, [10.0] * 20)
    assert (drawn.needle, drawn.band, len(drawn.past)) == (None, "", 8)
    assert "not known" in drawn.summary


def test_a_toolface_that_passes_the_high_side_is_no_line_across_the_panel(tools: Tools) -> None:
    for k, tf in enumerate((350.0, 355.0, 2.0, 8.0)):
        said(tools, "attitude", ATTITUDE | {"motor_toolface_deg": tf}, mono=float(k))
    line = next(row for row in trend(list(tools.tools["a"].trend), 3.0)["series"] if row["name"] == "toolface, deg")
    assert [pair[1] for pair in line["data"]] == [350.0, 355.0, None, 2.0, 8.0]


def test_the_panel_of_the_toolface_is_a_turn_and_a_band_below_zero_is_drawn(tools: Tools) -> None:
    said(tools, "attitude", ATTITUDE | {"motor_toolface_deg": -2.0, "tf_std_deg": 3.0}, mono=0.0)
    drawn = trend(list(tools.tools["a"].trend), 0.0)
    of_inclination, of_toolface, _ = drawn["yAxis"]
    assert (of_toolface["min"], of_toolface["max"]) == (0, 360) and "min" not in of_inclination
    line = next(row for row in drawn["series"] if row["name"] == "toolface, deg")
    assert line["data"][0][1] == 358.0
    # by default a picture stacks by sign: of a band from -6 on nothing would be seen below 0
    assert {row["stackStrategy"] for row in drawn["series"] if "stack" in row} == {"all"}


def test_a_tool_that_names_the_toolface_of_the_bend_as_before_is_understood(tools: Tools) -> None:
    before = {"toolface_deg" if name == "motor_toolface_deg" else name: value for name, value in ATTITUDE.items()}
    said(tools, "attitude", before, mono=0.0)
    reading = tools.tools["a"].reading
    assert reading is not None and reading.motor_toolface_deg == 110.0


def test_an_empty_tool_has_a_page() -> None:
    page = tool_page(ToolState("a"), HERE, 0.0)
    assert "has said nothing since" in page.head
    assert "nothing has been published" in page.parts


def test_the_needle_hides_no_number_of_the_dial() -> None:
    page = worded("highside.web.tools").get_template("dial.html")
    drawn = page.render(dial=dial(92.5, 1.0, []), ticks=range(0, 360, 15), fresh=True)
    assert drawn.count("<text") == 4 and drawn.index("needle") < drawn.index("<text")
