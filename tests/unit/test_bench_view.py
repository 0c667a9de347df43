"""The bench page without a browser: pictures and parts for any snapshot, tokens, the table [web]."""

from __future__ import annotations

import io
import math
import re
import socket
import xml.etree.ElementTree as ET
from html import unescape
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import SecretStr

from highside.bench.session.reasons import Fault, Refusal, Rejection
from highside.bench.session.snapshot import (
    AttitudeState,
    Capture,
    ClosureState,
    CommandName,
    Deviation,
    FaultState,
    ForceState,
    PlanState,
    PoseRow,
    PoseState,
    ResultState,
    SessionState,
    Snapshot,
    StillnessState,
    Target,
    UncertaintyState,
    VerdictRow,
    VerdictState,
    table_reads,
)
from highside.cli.bench_face import picture
from highside.config.web import WebTable
from highside.errors import InputError
from highside.web.access import COOKIE_MAX_AGE_S, Access
from highside.web.drawings import bulls_eye, place, radius_of
from highside.web.front import HostNames
from highside.web.parts import STATES, parts_of

ANGLES = st.floats(-180, 180, allow_nan=False)
SIZES = st.floats(0, 1e6, allow_nan=False)
NAMES = st.one_of(
    st.sampled_from(["1", "<script>alert(1)</script>", "\"&'", "Ω–x"]), st.text(min_size=1, max_size=12)
).map(lambda text: re.sub(r"[\x00-\x1f\x7f\ud800-\udfff\ufffe\uffff]", "?", text))
MAYBE = st.none()

deviations = st.builds(
    Deviation, inc_deg=ANGLES, tf_deg=st.one_of(MAYBE, ANGLES), angle_deg=st.floats(0, 180),
    tolerance_deg=st.floats(0.01, 20),
)  # fmt: skip
targets = st.builds(Target, pose=NAMES, inc_deg=ANGLES, tf_deg=ANGLES, temp_c=MAYBE)
attitudes = st.builds(
    AttitudeState, inc_deg=st.floats(0, 180), tf_deg=st.one_of(MAYBE, st.floats(0, 360)), g_total=st.floats(0.5, 1.5)
)
stillnesses = st.builds(
    StillnessState, value=SIZES, limit=st.just(1.0), still=st.booleans(), noise_g=MAYBE,
    trace=st.lists(SIZES, max_size=30), trace_step_s=st.just(0.5),
)  # fmt: skip
captures = st.builds(
    Capture, progress=st.floats(0, 1), elapsed_s=SIZES, readings=st.integers(0, 10**6),
    std_error_g=st.one_of(MAYBE, st.floats(0, 1)), target_std_error_g=st.one_of(MAYBE, st.floats(0, 1)),
)  # fmt: skip
rows = st.builds(
    PoseRow, pose=NAMES, inc_deg=st.one_of(MAYBE, ANGLES), tf_deg=st.one_of(MAYBE, ANGLES), temp_c=MAYBE,
    stage=st.just(0), state=st.sampled_from(PoseState), attempts=st.integers(0, 5),
    std_error_g=st.one_of(MAYBE, st.floats(0, 1)), readings=st.integers(0, 100), sigmas=st.one_of(MAYBE, ANGLES),
    reason=MAYBE, text=st.one_of(MAYBE, NAMES),
)  # fmt: skip


@st.composite
def uncertainties(draw: st.DrawFn) -> UncertaintyState:
    count = draw(st.integers(0, 6))
    values = st.lists(st.floats(0, 104), min_size=count, max_size=count)
    return UncertaintyState(
        inc_deg=draw(values), inc_std_deg=draw(values), tf_std_deg=draw(values), rms_inc_std_deg=0.1, rms_tf_std_deg=0.2
    )


closures = st.builds(
    ClosureState, inc_deg=ANGLES, size_g=st.floats(0, 1), p=st.floats(0, 1), good=st.booleans(),
    poses=st.lists(NAMES, max_size=4), worst=NAMES,
)  # fmt: skip
numbers = st.one_of(MAYBE, st.floats(-180, 180))
verdicts = st.builds(
    VerdictState, kind=st.sampled_from(["verification", "roll_test"]), record=NAMES,
    verdict=st.sampled_from(["pass", "fail", "undecided", "not_covered"]), text=NAMES,
    consistent=st.one_of(MAYBE, st.booleans()), limit_inc_deg=st.floats(0.01, 1), limit_tf_deg=numbers,
    limit_g_total_g=numbers,
    rows=st.lists(
        st.builds(VerdictRow, name=NAMES, inc_error_deg=numbers, inc_u_deg=numbers, tf_error_deg=numbers,
                  tf_u_deg=numbers, g_error_g=numbers, g_u_g=numbers, verdict=NAMES),
        max_size=3,
    ),
)  # fmt: skip
results = st.builds(
    ResultState, verdict=st.one_of(MAYBE, verdicts), method=NAMES,
    record_id=st.one_of(MAYBE, NAMES), inc_std_deg=st.one_of(MAYBE, st.floats(0, 9)),
    tf_std_deg=st.one_of(MAYBE, st.floats(0, 9)), poses=st.just(3), retaken=st.just(0),
    refused=st.lists(NAMES, max_size=2), remarks=st.lists(NAMES, max_size=2),
)  # fmt: skip
snapshots = st.builds(
    Snapshot, seq=st.just(1), session=NAMES, tool=NAMES, serial=st.one_of(MAYBE, NAMES),
    state=st.sampled_from(SessionState), back_to=MAYBE,
    plan=st.builds(PlanState, kind=NAMES, title=NAMES, method=NAMES, poses=st.one_of(MAYBE, st.just(9)),
                   done=st.integers(0, 9), skipped=st.just(0), stage=st.just(0), stages=st.integers(1, 3),
                   stage_temp_c=MAYBE),
    prompt=NAMES, target=st.one_of(MAYBE, targets), attitude=st.one_of(MAYBE, attitudes),
    deviation=st.one_of(MAYBE, deviations), stillness=st.one_of(MAYBE, stillnesses), capture=st.one_of(MAYBE, captures),
    temp_c=st.one_of(MAYBE, ANGLES), poses=st.lists(rows, max_size=5), uncertainty=st.one_of(MAYBE, uncertainties()),
    closures=st.lists(closures, max_size=3),
    faults=st.lists(st.builds(FaultState, code=NAMES, text=NAMES, since_s=SIZES, detail=NAMES), max_size=2),
    last_rejection=st.one_of(MAYBE, NAMES), operator=st.one_of(MAYBE, NAMES), allowed=st.just(list(CommandName)),
    result=st.one_of(MAYBE, results), elapsed_s=SIZES,
    in_force=st.one_of(MAYBE, st.builds(ForceState, present=st.one_of(MAYBE, NAMES), before=st.one_of(MAYBE, NAMES))),
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(snapshots)
def test_every_snapshot_gives_whole_markup_in_which_nothing_from_outside_is_markup(snapshot: Snapshot) -> None:
    parts = parts_of(snapshot)
    for name in parts.__slots__:
        content = getattr(parts, name)
        # whole: every tag is closed, every value escaped
        tree = ET.fromstring(f"<div>{content}</div>")
        assert not list(tree.iter("script")), name
        assert "nan" not in "".join(x for e in tree.iter() for x in e.attrib.values() if "," in x or x[:1].isdigit()), (
            name
        )
        for drawn in tree.iter("svg"):
            assert drawn.get("aria-label")
            assert_inside(drawn)


def assert_inside(drawn: ET.Element) -> None:
    """Coordinates are finite and lie in the picture, a stroke's width aside."""
    x0, y0, width, height = map(float, drawn.get("viewBox", "").split())
    for element in drawn.iter():
        for key, low, high in (
            ("cx", x0, x0 + width),
            ("x1", x0, x0 + width),
            ("y1", y0, y0 + height),
            ("cy", y0, y0 + height),
        ):
            if element.get(key) is not None:
                assert low - 5 <= float(element.get(key, "")) <= high + 5
        for pair in element.get("points", "").split():
            x, y = map(float, pair.split(","))
            assert x0 - 5 <= x <= x0 + width + 5 and y0 - 5 <= y <= y0 + height + 5


def test_every_state_has_its_sign() -> None:
    assert set(STATES) == set(SessionState)


@given(st.floats(0, 180), st.floats(0, 180), st.floats(0.01, 20))
def test_farther_off_is_drawn_farther_out_and_the_ring_is_the_tolerance(a: float, b: float, tolerance: float) -> None:
    near, far = sorted((a, b))
    assert 0.0 <= radius_of(near, tolerance) <= radius_of(far, tolerance) <= 1.0
    assert (radius_of(a, tolerance) <= radius_of(tolerance, tolerance)) == (a <= tolerance)


def deviation(inc: float, tf: float | None, angle: float) -> Deviation:
    return Deviation(inc_deg=inc, tf_deg=tf, angle_deg=angle, tolerance_deg=0.5)


def test_the_dot_lies_opposite_to_what_is_missing() -> None:
    target = Target(pose="1", inc_deg=90.0, tf_deg=45.0)
    x, y = place(deviation(10.0, 0.0, 10.0), target)
    assert x == pytest.approx(0.0) and y > 0, "10 deg to raise: the tool is below"
    x, y = place(deviation(0.0, 10.0, 10.0), target)
    assert x < 0 and y == pytest.approx(0.0), "10 deg to turn clockwise: the tool is left"
    assert 'class="tool hit"' in bulls_eye(deviation(0.1, 0.1, 0.14), target)
    assert 'class="tool"' in bulls_eye(deviation(5.0, 0.1, 5.0), target)


def test_a_table_turned_the_other_way_reads_as_its_scales_do() -> None:
    at = AttitudeState(inc_deg=30.0, tf_deg=200.0, g_total=1.0)
    assert table_reads(at, Target(pose="1", inc_deg=-30.0, tf_deg=20.0)) == (-30.0, 20.0)
    assert table_reads(at, Target(pose="1", inc_deg=30.0, tf_deg=20.0)) == (30.0, 200.0)
    assert table_reads(at, None) == (30.0, 200.0)


@given(snapshots, attitudes)
@settings(max_examples=60, deadline=None)
def test_terminal_and_page_show_the_same_setting_in_every_state(shown: Snapshot, at: AttitudeState) -> None:
    """A negative inclination is the table turned the other way, also before the session has begun."""
    from rich.console import Console

    shown = shown.model_copy(update={"attitude": at, "result": None})
    inc, tf = table_reads(at, shown.target)
    console = Console(width=300, height=200, file=io.StringIO(), record=True)
    console.print(picture(shown))
    terminal = next(line for line in console.export_text().splitlines() if line.startswith("now"))
    page = parts_of(shown).numbers
    for face in (terminal, page):
        assert re.search(rf"(?<![\d.-]){re.escape(f'{inc:.2f}')}°", face), (inc, face)
        assert tf is None or re.search(rf"(?<![\d.-]){re.escape(f'{tf:.2f}')}°", face), (tf, face)
    assert (tf is None) == ("undefined" in terminal)


@given(st.text(min_size=1, max_size=40))
def test_only_the_token_opens(shown: str) -> None:
    access = Access(SecretStr("the token of this session"))
    assert not access.by_token(shown) and not access.by_cookie(shown) and not access.by_header(shown)
    assert not access.by_header(f"Bearer {shown}")


def test_the_token_opens_and_the_cookie_is_not_the_token() -> None:
    access = Access(SecretStr("the-token-of-this-session"))
    assert access.by_token("the-token-of-this-session") and access.by_header("Bearer the-token-of-this-session")
    cookie = access.cookie()
    assert access.by_cookie(cookie)
    assert not access.by_token(cookie) and "token" not in cookie
    assert not access.by_header("Basic the-token-of-this-session")
    for nothing in (None, ""):
        assert not access.by_token(nothing) and not access.by_cookie(nothing) and not access.by_header(nothing)


def test_a_cookie_is_good_for_a_week_and_cannot_be_made_younger() -> None:
    now = [1e9]
    access = Access(SecretStr("the-token-of-this-session"), lambda: now[0])
    cookie = access.cookie()
    assert access.by_cookie(cookie)
    now[0] += COOKIE_MAX_AGE_S - 1
    assert access.by_cookie(cookie)
    now[0] += 2
    assert not access.by_cookie(cookie)
    given, _, seal = cookie.partition(".")
    assert not access.by_cookie(f"{int(given) + 1000}.{seal}")
    now[0] -= 2 * COOKIE_MAX_AGE_S
    assert access.by_cookie(cookie), "a clock that was set back shuts nobody out"


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("::", False), ("bench-1", False)],
)
def test_the_page_answers_to_its_own_names_alone(host: str, loopback: bool) -> None:
    """Rebinding: a page elsewhere has its own name point here, and its scripts would then be of our origin."""
    table = WebTable(host=host)
    assert table.is_loopback is loopback and (table.warning is None) is loopback
    names = HostNames(table)
    for good in ("localhost", "LOCALHOST:8765", "127.0.0.1:8765", "[::1]:8765", "localhost."):
        assert names.answers(good, "127.0.0.1")
    for evil in ("evil.example", "evil.example:8765", "localhost.evil.example", "127.0.0.1.evil.example", ""):
        assert not names.answers(evil, "192.0.2.7")
    own = socket.gethostname()
    for wide in (own, f"{own}:8765", "192.0.2.7:8765", f"{own.partition('.')[0]}.local"):
        assert names.answers(wide, "192.0.2.7") is not loopback
    assert not names.answers("192.0.2.8", "192.0.2.7"), "an address of somebody else"
    assert not names.answers("192.0.2.7", None)
    assert names.answers("192.0.2.7", "::ffff:192.0.2.7") is not loopback
    assert HostNames(WebTable(host=host, allowed_hosts=("bench.lab",))).answers("Bench.Lab:80", "127.0.0.1")


def test_a_token_comes_from_its_file_or_is_new_each_time(tmp_path: Path) -> None:
    kept = tmp_path / "token"
    kept.write_text("a token of twenty letters\n")
    kept.chmod(0o600)
    assert WebTable(token_file=kept).read_token().get_secret_value() == "a token of twenty letters"
    first, second = (WebTable().read_token().get_secret_value() for _ in range(2))
    assert first != second and math.log2(64) * len(first) > 128
    kept.write_text("short")
    with pytest.raises(InputError, match="at least 16"):
        WebTable(token_file=kept).read_token()
    with pytest.raises(InputError, match=r"web\.token_file"):
        WebTable(token_file=tmp_path / "none").read_token()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644])
def test_a_token_that_others_may_read_is_refused_with_the_remedy(tmp_path: Path, mode: int) -> None:
    kept = tmp_path / "token"
    kept.write_text("a token of twenty letters\n")
    kept.chmod(mode)
    with pytest.raises(InputError, match=rf"web\.token_file: may be read by others \(mode {mode:o}\); chmod 600 "):
        WebTable(token_file=kept).read_token()


def shown(**changed: object) -> Snapshot:
    """A snapshot of a session that measures."""
    return Snapshot(
        seq=1, session="s", tool="tool-7", state=SessionState.GUIDING, prompt="Set 1.",
        target=Target(pose="1", inc_deg=5.0, tf_deg=45.0),
        attitude=AttitudeState(inc_deg=5.0, tf_deg=45.0, g_total=1.0), deviation=deviation(0.0, 0.0, 0.1),
        stillness=None,
        plan=PlanState(kind="joint", title="joint", method="joint", poses=4, done=4, skipped=0), capture=None,
        temp_c=None, poses=[], uncertainty=None, closures=[], faults=[], operator="ann", allowed=[], result=None,
        last_rejection=None, elapsed_s=10.0,
    ).model_copy(update=changed)  # fmt: skip


def test_without_data_no_number_stands_and_every_sentence_stands_once() -> None:
    """A cable pulled during a hold: headline, alarm, warning and list all had the same to say."""
    lost, link = Rejection.DATA_LOST.text, Fault.LINK_DOWN
    parts = parts_of(
        shown(
            state=SessionState.NO_DATA, prompt=link.text, attitude=None, deviation=None, last_rejection=lost,
            faults=[FaultState(code=link.value, text=link.text, since_s=1.0, detail="ttyUSB0 is gone")],
            poses=[PoseRow(pose="1", inc_deg=5.0, tf_deg=45.0, state=PoseState.OPEN, attempts=1, text=lost)],
        )
    )  # fmt: skip
    page = unescape("".join(getattr(parts, name) for name in parts.__slots__))
    assert page.count(link.text) == 1 and page.count(lost) == 1
    assert "ttyUSB0 is gone" in parts.alarms
    assert "stale" in parts.numbers and "45" not in re.sub(r'class="goal-of">[^<]*', "", parts.numbers)
    assert "needle" not in parts.dial and 'class="tool' not in parts.bullseye
    why = Rejection.MOVED.text
    row = PoseRow(pose="1", inc_deg=5.0, tf_deg=45.0, state=PoseState.OPEN, attempts=1, text=why)
    moved = parts_of(shown(last_rejection=why, poses=[row]))
    assert "".join(getattr(moved, name) for name in moved.__slots__).count(why) == 1


def test_what_the_page_says_fits_what_was_done() -> None:
    assert "Closure" not in parts_of(shown()).calibration, "a joint plan has no four poses to wait for"
    ring = PlanState(kind="balance", title="balance", method="balance", poses=4, done=1, skipped=0)
    assert "after the first four poses of an inclination" in parts_of(shown(plan=ring)).calibration
    u = UncertaintyState(
        inc_deg=[5.0, 45.0, 90.0], inc_std_deg=[0.002, 0.001, 0.001], tf_std_deg=[0.03, 0.004, 0.002],
        rms_inc_std_deg=0.0015, rms_tf_std_deg=0.0121,
    )  # fmt: skip
    result = ResultState(
        method="joint", record_id="ab" * 32, inc_std_deg=0.0015, tf_std_deg=0.0121, poses=4, retaken=0, refused=[]
    )
    done = shown(
        state=SessionState.ACCEPTED, plan=ring, result=result, uncertainty=u,
        in_force=ForceState(present="ab" * 32, before=None),
    )  # fmt: skip
    parts = parts_of(done)
    assert "after the first four" not in parts.calibration and "so far" not in parts.calibration
    assert "T ± 0.0020° to 0.0300° (at I = 5°)" in parts.result
    assert "Next:" in parts.result and "reload" in parts.result
    assert "Next:" not in parts_of(done.model_copy(update={"in_force": ForceState(present=None, before=None)})).result
    for seconds, said in ((0.4, "0 s"), (59.0, "59 s"), (125.0, "2 min"), (11_100.0, "3 h 05 min")):
        assert f"· {said}" in parts_of(shown(elapsed_s=seconds)).foot
    for reason in (*Rejection, *Refusal, *Fault):
        assert "`" not in reason.text.replace("(`confirm`)", ""), "the name of a button, not of a command"
