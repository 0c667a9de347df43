"""The bench page without a browser: pictures and parts for any snapshot, tokens, the table [web]."""

from __future__ import annotations

import io
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import SecretStr

from highside.cli.bench_face import picture
from highside.config.web import WebTable
from highside.errors import InputError
from highside.session.snapshot import (
    Attitude,
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
    Snapshot,
    State,
    Stillness,
    Target,
    Uncertainty,
    VerdictRow,
    VerdictState,
    table_reads,
)
from highside.web.access import Access
from highside.web.drawings import bulls_eye, place, radius_of
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
    Attitude, inc_deg=st.floats(0, 180), tf_deg=st.one_of(MAYBE, st.floats(0, 360)), g_total=st.floats(0.5, 1.5)
)
stillnesses = st.builds(
    Stillness, value=SIZES, limit=st.just(1.0), still=st.booleans(), noise_g=MAYBE, trace=st.lists(SIZES, max_size=30),
    trace_step_s=st.just(0.5),
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
def uncertainties(draw: st.DrawFn) -> Uncertainty:
    count = draw(st.integers(0, 6))
    values = st.lists(st.floats(0, 104), min_size=count, max_size=count)
    return Uncertainty(
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
    Snapshot, seq=st.just(1), session=NAMES, tool=NAMES, serial=st.one_of(MAYBE, NAMES), state=st.sampled_from(State),
    back_to=MAYBE,
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
    assert set(STATES) == set(State)


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
    at = Attitude(inc_deg=30.0, tf_deg=200.0, g_total=1.0)
    assert table_reads(at, Target(pose="1", inc_deg=-30.0, tf_deg=20.0)) == (-30.0, 20.0)
    assert table_reads(at, Target(pose="1", inc_deg=30.0, tf_deg=20.0)) == (30.0, 200.0)
    assert table_reads(at, None) == (30.0, 200.0)


@given(snapshots, attitudes)
@settings(max_examples=60, deadline=None)
def test_terminal_and_page_show_the_same_setting_in_every_state(shown: Snapshot, at: Attitude) -> None:
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
    assert access.by_cookie(access.cookie)
    assert not access.by_token(access.cookie) and "token" not in access.cookie
    assert not access.by_header("Basic the-token-of-this-session")
    for nothing in (None, ""):
        assert not access.by_token(nothing) and not access.by_cookie(nothing) and not access.by_header(nothing)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("bench-1", False)],
)
def test_what_is_bound_to_the_loopback_answers_to_its_names_alone(host: str, loopback: bool) -> None:
    table = WebTable(host=host)
    assert table.is_loopback is loopback
    assert ("*" in table.allowed_hosts()) is not loopback
    assert WebTable(host=host, hosts=("bench.lab",)).allowed_hosts() == ["bench.lab"]


def test_a_token_comes_from_its_file_or_is_new_each_time(tmp_path: Path) -> None:
    kept = tmp_path / "token"
    kept.write_text("a token of twenty letters\n")
    assert WebTable(token_file=kept).read_token().get_secret_value() == "a token of twenty letters"
    first, second = (WebTable().read_token().get_secret_value() for _ in range(2))
    assert first != second and math.log2(64) * len(first) > 128
    kept.write_text("short")
    with pytest.raises(InputError, match="at least 16"):
        WebTable(token_file=kept).read_token()
    with pytest.raises(InputError, match=r"web\.token_file"):
        WebTable(token_file=tmp_path / "none").read_token()
