"""The technician's side of the page without a browser: the tool on its table, tones, the way to a phone."""

from __future__ import annotations

import math
import re
import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_bench_view import deviation, shown

from highside.bench.session.reasons import Rejection
from highside.bench.session.snapshot import (
    AttitudeState,
    Deviation,
    PlanState,
    PoseRow,
    PoseState,
    SessionState,
    Snapshot,
    Target,
)
from highside.bench.session.time_to_go import in_words
from highside.config.web import WebTable
from highside.web.bench_scene import AZIMUTH_DEG, Seen, seen
from highside.web.cues import Cue, cue
from highside.web.parts import parts_of
from highside.web.phone import qr_svg, qr_text, reachable_host
from highside.web.space import orientation, pointing

ANGLES = st.floats(-180.0, 180.0)


# --- the tool on its table -----------------------------------------------------------------------------------------


@given(st.floats(0.0, 180.0), st.floats(0.0, 360.0), st.floats(0.0, 360.0))
def test_a_table_turned_the_other_way_has_the_same_tool_on_it(inc: float, tf: float, azi: float) -> None:
    """(-I, T + 180) reads as (I, T), and is drawn leaning to the other side."""
    one, other = np.array(orientation(inc, tf, azi)), np.array(orientation(-inc, tf + 180.0, azi))
    assert other[2] == pytest.approx(one[2], abs=1e-12), "up in the tool's frame"
    assert other[:2, 2] == pytest.approx(-one[:2, 2], abs=1e-12), "its axis over the floor"


@given(st.tuples(ANGLES, ANGLES, ANGLES).filter(lambda d: math.hypot(*d) > 1e-3))
def test_a_cone_points_where_it_is_told(direction: tuple[float, float, float]) -> None:
    matrix = np.array(pointing(direction))
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert matrix[:, 1] == pytest.approx(np.array(direction) / math.hypot(*direction), abs=1e-9)


def at(target: Target | None, inc: float, tf: float | None, **missing: float) -> Snapshot:
    way = None if target is None else Deviation(angle_deg=10.0, tolerance_deg=0.5, **missing)  # type: ignore[arg-type]
    return shown(target=target, attitude=AttitudeState(inc_deg=inc, tf_deg=tf, g_total=1.0), deviation=way)


def test_the_arrows_show_what_the_sentence_says() -> None:
    """Turning as the arrow says, a little, brings the tool nearer to its ghost: in space and not in a sign of ours."""
    for target, inc, tf in (
        (Target(pose="1", inc_deg=45.0, tf_deg=135.0), 41.4, 118.0),
        (Target(pose="1", inc_deg=45.0, tf_deg=10.0), 48.0, 350.0),
        (Target(pose="1", inc_deg=-45.0, tf_deg=90.0), 30.0, 250.0),
        (Target(pose="1", inc_deg=-5.0, tf_deg=0.0), 12.0, 200.0),
    ):
        table = (inc, tf) if target.inc_deg >= 0 else (-inc, (tf + 180.0) % 360.0)
        turn = math.remainder(target.tf_deg - table[1], 360.0)
        found = seen(at(target, inc, tf, inc_deg=target.inc_deg - table[0], tf_deg=turn))
        assert found.tool == pytest.approx(table) and found.ghost == (target.inc_deg, target.tf_deg)
        ghost = np.array(orientation(*found.ghost, AZIMUTH_DEG))
        far = _away(np.array(orientation(*table, AZIMUTH_DEG)), ghost)
        nearer = np.array(orientation(table[0] + found.tilt, table[1] + found.turn, AZIMUTH_DEG))
        assert _away(nearer, ghost) < far
        assert ("counterclockwise" in found.said) is (found.turn < 0)


def _away(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(a.T @ b) - 1.0) / 2.0, -1.0, 1.0)))


def test_no_arrow_points_where_nothing_is_to_be_turned() -> None:
    target = Target(pose="1", inc_deg=45.0, tf_deg=135.0)
    here = at(target, 45.1, 135.2, inc_deg=-0.1, tf_deg=-0.2)
    assert (seen(here).turn, seen(here).tilt) == (0, 0)
    hold = here.model_copy(update={"state": SessionState.CAPTURING})
    assert (seen(hold).turn, seen(hold).tilt, seen(hold).ghost) == (0, 0, None)
    gone = seen(shown(attitude=None, deviation=None, target=target))
    assert gone == Seen(None, (45.0, 135.0), said="no readings")
    vertical = seen(at(Target(pose="1", inc_deg=0.0, tf_deg=90.0), 0.01, None, inc_deg=0.0, tf_deg=0.0))
    assert vertical.tool == (0.01, 90.0)


# --- tones ---------------------------------------------------------------------------------------------------------


def stage(state: SessionState, done: int = 4, attempts: int = 4, rejected: str | None = None) -> Snapshot:
    rows = [PoseRow(pose="1", inc_deg=5.0, tf_deg=45.0, state=PoseState.OPEN, attempts=attempts)]
    plan = PlanState(kind="joint", title="joint", method="joint", poses=12, done=done, skipped=0)
    return shown(state=state, plan=plan, poses=rows, last_rejection=rejected)


S = SessionState


@pytest.mark.parametrize(
    ("before", "after", "heard"),
    [
        (stage(S.SETTLING), stage(S.CAPTURING), Cue.HANDS_OFF),
        (stage(S.CAPTURING), stage(S.GUIDING, done=5, attempts=5), Cue.DONE),
        # two steps between two pictures: what is done comes first
        (stage(S.GUIDING), stage(S.CAPTURING, done=5, attempts=5), Cue.DONE),
        (stage(S.CAPTURING), stage(S.SETTLING, attempts=5, rejected=Rejection.MOVED.text), Cue.KNOCK),
        # the same refusal for the fourth time is no more written down, and heard all the same
        (
            stage(S.CAPTURING, rejected=Rejection.MOVED.text),
            stage(S.SETTLING, rejected=Rejection.MOVED.text),
            Cue.KNOCK,
        ),
        (stage(S.CAPTURING), stage(S.NO_DATA), Cue.NO_DATA),
        (stage(S.SOLVING, done=12), stage(S.REVIEW, done=12), Cue.ALL),
        (stage(S.CAPTURING), stage(S.CAPTURING), None),
        (stage(S.NO_DATA), stage(S.NO_DATA), None),
        (stage(S.CAPTURING), stage(S.PAUSED), None),
        # taken back by its operator
        (stage(S.GUIDING), stage(S.GUIDING, done=3), None),
    ],
)
def test_what_is_heard(before: Snapshot, after: Snapshot, heard: Cue | None) -> None:
    assert cue(before, after) is heard


# --- time to go ----------------------------------------------------------------------------------------------------


def test_the_time_to_go_stands_beside_the_state_and_only_while_it_is_known() -> None:
    plan = PlanState(kind="joint", title="joint", method="joint", poses=16, done=7, skipped=0)
    assert "7 of 16, about 9 min" in parts_of(shown(plan=plan, to_go_s=540.0)).sign
    assert "to-go" not in parts_of(shown(plan=plan)).sign
    oven = plan.model_copy(update={"stages": 3, "stage_temp_c": 80.0})
    assert "warming up not counted" in parts_of(shown(plan=oven, to_go_s=540.0)).sign


def test_an_estimate_has_no_more_digits_than_it_knows() -> None:
    said = [in_words(s) for s in (10.0, 44.0, 46.0, 540.0, 780.0, 3500.0, 7300.0)]
    assert said == [
        "less than a minute", "less than a minute", "about 1 min", "about 9 min", "about 15 min", "about 1 h 00 min",
        "about 2 h 00 min",
    ]  # fmt: skip


# --- the way to a phone --------------------------------------------------------------------------------------------


def test_a_phone_is_told_an_address_that_it_can_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    assert reachable_host(WebTable()) is None
    assert reachable_host(WebTable(host="localhost")) is None
    assert reachable_host(WebTable(host="10.1.2.3")) == "10.1.2.3"
    assert reachable_host(WebTable(host="bench-1.example")) == "bench-1.example"
    assert reachable_host(WebTable(host="fd00::7")) == "[fd00::7]"
    monkeypatch.setattr("highside.web.phone._own_address", lambda family: "10.0.0.7")
    assert reachable_host(WebTable(host="0.0.0.0")) == "10.0.0.7"
    # no way to anybody: the name is what is left
    monkeypatch.setattr("highside.web.phone._own_address", lambda family: None)
    assert reachable_host(WebTable(host="::")) == socket.gethostname()


def test_the_code_is_dark_on_light_and_of_that_link_alone() -> None:
    link = "http://10.0.0.7:8765/?token=abcdefghijklmnopqrstuvwx"
    drawn = qr_svg(link)
    assert drawn != qr_svg(link + "y")
    assert 'fill="#fff"' in drawn and 'stroke="#000"' in drawn and "token" not in drawn
    rows = qr_text(link).rstrip("\n").split("\n")
    assert len(rows) > 15 and set(re.sub(r"\x1b\[[0-9;]*m", "", "".join(rows))) <= set(" ▀▄█")


def test_deviation_is_what_the_scene_is_drawn_of() -> None:
    assert seen(shown(deviation=deviation(0.0, 0.0, 0.1))).said == "hold it there"
