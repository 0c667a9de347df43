"""What is published is what the models say, also on the quick way."""

from __future__ import annotations

import json
import math
import re
import time
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.service.messages import (
    PAYLOADS,
    AttitudeMessage,
    HealthMessage,
    SurveyMessage,
    attitude_payload,
    health_payload,
    mark_historical,
    schemas,
    survey_dict,
    survey_payload,
)
from highside.service.outputs import AttitudeOutput, Azimuth, Survey, SurveyReason, SurveyVerdict

ATTITUDE = AttitudeOutput(
    t_device_s=1.0,
    t_mono=2.0,
    inc_deg=12.3456789,
    inc_std_deg=0.0123,
    tf_deg=271.5,
    tf_std_deg=0.25,
    motor_toolface_deg=281.5,
    toolface_offset_deg=10.0,
    g_total=1.00012,
    g_total_std=1e-4,
    cal_id="identity",
    zone="",
    flags=("uncalibrated",),
    n=10,
    window_s=0.1,
    temp_c=25.0,
)

degrees = st.floats(0, 360, allow_nan=False)
stds = st.one_of(st.floats(0, 200), st.sampled_from([math.inf, math.nan]))


@st.composite
def attitudes(draw: st.DrawFn) -> AttitudeOutput:
    return AttitudeOutput(
        t_device_s=0.0,
        t_mono=0.0,
        inc_deg=draw(st.floats(0, 180)),
        inc_std_deg=draw(st.floats(0, 200)),
        tf_deg=draw(degrees),
        tf_std_deg=draw(stds),
        motor_toolface_deg=draw(degrees),
        toolface_offset_deg=draw(degrees),
        g_total=draw(st.floats(0, 20)),
        g_total_std=draw(stds),
        cal_id=draw(st.text(max_size=20)),
        zone=draw(st.text(max_size=10)),
        flags=tuple(draw(st.lists(st.text(max_size=10), max_size=3))),
        n=draw(st.integers(0, 10**6)),
        window_s=0.1,
        temp_c=draw(st.one_of(st.none(), st.floats(-80, 250))),
        comp_id=draw(st.one_of(st.none(), st.text(max_size=20))),
    )


verdicts = st.builds(
    SurveyVerdict,
    accepted=st.booleans(),
    reasons=st.lists(st.sampled_from(list(SurveyReason)), unique=True).map(tuple),
    g_error_mg=st.one_of(st.floats(-1e4, 1e4), st.just(math.nan)),
    g_std_mg=st.one_of(st.floats(0, 100), st.just(math.nan)),
    shock_g=st.floats(0, 100),
)


def as_model(model: type[AttitudeMessage] | type[SurveyMessage], payload: bytes) -> dict[str, Any]:
    """The payload as the model reads it and writes it again: strict, nothing unknown, nothing lacking."""
    return model.model_validate_json(payload, strict=True).model_dump(exclude_unset=True)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    attitude=attitudes(),
    seq=st.integers(0, 2**40),
    t=st.floats(0, 4e9),
    synced=st.booleans(),
    azimuth=st.one_of(
        st.none(),
        st.builds(Azimuth, st.one_of(st.none(), degrees), st.one_of(st.none(), stds), st.just(("zero_rate",))),
    ),
)
def test_the_quick_way_writes_what_the_model_writes(
    attitude: AttitudeOutput, seq: int, t: float, synced: bool, azimuth: Azimuth | None
) -> None:
    attitude = replace(attitude, azimuth=azimuth)
    payload = attitude_payload(seq, t, t / 2, synced, attitude)
    message = AttitudeMessage.model_validate_json(payload, strict=True)
    assert json.loads(payload) == json.loads(message.model_dump_json(exclude_unset=True))
    assert list(json.loads(payload)) == [
        name for name in AttitudeMessage.model_fields if name in message.model_fields_set
    ]
    assert (message.seq, message.clock_synced, message.historical) == (seq, synced, False)
    assert message.t == pytest.approx(t, abs=1e-6)
    assert message.inc_deg == pytest.approx(attitude.inc_deg, abs=5.1e-7)
    assert message.g_total == pytest.approx(attitude.g_total, abs=5.1e-9)
    assert message.tf_deg is not None
    assert 0.0 <= message.tf_deg < 360.0
    assert math.remainder(message.tf_deg - attitude.tf_deg, 360.0) == pytest.approx(0.0, abs=5.1e-7)
    if math.isfinite(attitude.tf_std_deg):
        assert message.tf_std_deg == pytest.approx(attitude.tf_std_deg, abs=5.1e-7)
    else:
        assert message.tf_std_deg is None
    assert (message.cal_id, message.zone, tuple(message.flags)) == (attitude.cal_id, attitude.zone, attitude.flags)
    assert (message.azi_deg is None) == (azimuth is None or azimuth.azi_deg is None)
    assert message.azi_basis == (None if azimuth is None else ["zero_rate"])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(attitude=attitudes(), duration_s=st.floats(0, 1e5), g_std=st.floats(0, 1), verdict=verdicts)
def test_a_survey_carries_its_quality(
    attitude: AttitudeOutput, duration_s: float, g_std: float, verdict: SurveyVerdict
) -> None:
    payload = survey_payload(3, 1e9, 5.0, True, Survey(attitude, duration_s, g_std, verdict))
    message = SurveyMessage.model_validate_json(payload, strict=True)
    assert json.loads(payload) == json.loads(message.model_dump_json(exclude_unset=True))
    assert message.n == attitude.n
    assert message.duration_s == pytest.approx(duration_s, abs=5.1e-4)
    assert message.g_std == pytest.approx(g_std, abs=5.1e-10)
    assert (message.temp_c is None) == (attitude.temp_c is None)
    assert (message.accepted, tuple(message.reasons)) == (verdict.accepted, verdict.reasons)
    assert (message.g_error_mg is None) == math.isnan(verdict.g_error_mg)
    assert message.shock_g == pytest.approx(verdict.shock_g, abs=5.1e-5)
    kept = survey_dict(3, 1e9, Survey(attitude, duration_s, g_std, verdict))
    assert set(SurveyMessage.model_fields) - set(kept) >= {"t_mono", "clock_synced", "historical"}
    assert kept["reasons"] == list(verdict.reasons)


def test_a_late_message_is_marked_and_otherwise_the_same() -> None:
    payload = attitude_payload(1, 1e9, 5.0, True, ATTITUDE)
    late = mark_historical(payload)
    assert as_model(AttitudeMessage, late) == as_model(AttitudeMessage, payload) | {"historical": True}
    assert mark_historical(late) == late
    assert mark_historical(b"not ours") == b"not ours"


def test_every_topic_has_a_schema() -> None:
    found = schemas()
    assert set(found) == {*PAYLOADS, "status", "instance"}
    assert re.fullmatch(found["status"]["pattern"], "online")
    assert re.fullmatch(found["instance"]["pattern"], "online 5f0c2a91")
    for name in set(found) - {"status", "instance"}:
        assert found[name]["additionalProperties"] is False
        assert json.loads(json.dumps(found[name])) == found[name]
    required = set(found["attitude"]["required"])
    assert {"seq", "t", "inc_deg", "inc_std_deg", "tf_deg", "tf_std_deg", "cal_id", "historical"} <= required
    assert "azi_deg" not in required


def test_health_reads_back() -> None:
    zero = {"produced": 2, "carried": 0, "committed": 2, "acknowledged": 1, "queued": 1, "queued_bytes": 9}
    health = HealthMessage.model_validate(
        {
            "t": 1e9,
            "clock_synced": True,
            "version": "1",
            "uptime_s": 3.0,
            "link": {"state": "open"},
            "codec": {"bytes_in": 10},
            "monitor": {"gaps": 0},
            "outbox": zero
            | {"dropped": {}, "storage_ok": True, "storage_errors": 0, "storage_error": "", "corrupt_files": 0},
            "broker": {"connected": True, "connects": 1, "failures": {}, "last_error": ""},
            "pipeline": {"attitudes": 2},
            "surveys": {"accepted": 1},
            "vibration": {},
            "toolface": {},
            "wits": [],
            "calibration": {"cal_id": "identity"},
            "rolling_bias": {},
            "reload": {},
            "balance": {"messages": True},
            "alarms": [],
        }
    )
    assert HealthMessage.model_validate_json(health_payload(health)) == health


def test_writing_an_attitude_is_quick() -> None:
    n = 5_000
    began = time.perf_counter()
    for seq in range(n):
        attitude_payload(seq, 1e9, 5.0, True, ATTITUDE)
    each = (time.perf_counter() - began) / n
    print(f"attitude_payload: {each * 1e6:.1f} us")
    assert each < 60e-6
