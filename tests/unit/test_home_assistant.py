"""What Home Assistant is told, its templates rendered with messages as they are sent."""

from __future__ import annotations

import json
import time
from typing import Any

import jinja2
import pytest

from highside.config.mqtt import MqttSettings
from highside.config.rig import HomeAssistantSettings
from highside.service.messages import LatestMessage, latest_payload
from highside.service.rig.home_assistant import discovery

VALUES = {
    "inc_deg": 12.3456, "inc_std_deg": 0.01, "tf_deg": 3.0, "tf_std_deg": 0.2, "motor_toolface_deg": 103.0,
    "azi_deg": None, "azi_std_deg": None, "g_total": float("nan"), "temp_c": 80.0,
}  # fmt: skip
SURVEY = {"inc_deg": 12.0, "motor_toolface_deg": 101.0, "accepted": False, "reasons": ["moved"], "g_error_mg": 0.2}
HEALTH = {"outbox": {"queued": 4}, "link": {"data_age_s": 0.25}, "alarms": ["link_stale"]}
WATCH = {
    "verdict": "departs",
    "advice": ["pull the tool"],
    "claims": [{"equivalence_class": ["b_x", "S_xz"]}],
    "noise_changes": [{"axis": "y", "factor": 4.0}],
}


@pytest.fixture
def reported() -> dict[str, Any]:
    _, payload = discovery("t.1", "SN 7", MqttSettings(), HomeAssistantSettings(), health_interval_s=20.0)
    return json.loads(payload)


def render(template: str, payload: Any) -> str:
    """As Home Assistant does: `value` is the text, `value_json` what it holds."""
    return jinja2.Environment().from_string(template).render(value=payload, value_json=payload)


def test_every_template_finds_its_value(reported: dict[str, Any]) -> None:
    payloads = {"latest": json.loads(latest_payload(time.time(), VALUES)), "survey": SURVEY, "health": HEALTH}
    payloads["watch"] = WATCH
    shown = {
        key: render(c["value_template"], payloads[c["state_topic"].rpartition("/")[2]])
        for key, c in reported["components"].items()
    }
    assert shown == {
        "inc": "12.3456", "inc_std": "0.01", "toolface": "103.0", "tf_std": "0.2", "azimuth": "None", "g_total": "None",
        "survey_inc": "12.0", "survey_toolface": "101.0", "survey_azimuth": "None", "survey_g_error": "0.2",
        "queued": "4", "data_age": "0.25", "survey_accepted": "OFF", "problem": "ON", "calibration_departs": "ON",
    }  # fmt: skip
    assert json.loads(render(reported["components"]["problem"]["json_attributes_template"], HEALTH)) == {
        "alarms": ["link_stale"]
    }
    assert json.loads(render(reported["components"]["calibration_departs"]["json_attributes_template"], WATCH)) == {
        "verdict": "departs",
        "advice": ["pull the tool"],
        "noise": ["y"],
        "class": [["b_x", "S_xz"]],
    }


def test_nothing_is_announced_from_the_stream_of_attitudes(reported: dict[str, Any]) -> None:
    topics = {component["state_topic"] for component in reported["components"].values()}
    assert topics == {f"highside/t.1/{name}" for name in ("latest", "survey", "health", "watch")}


def test_values_expire_and_diagnostics_are_called_so(reported: dict[str, Any]) -> None:
    components = reported["components"]
    assert components["inc"]["expire_after"] == 10
    assert components["problem"]["expire_after"] == components["queued"]["expire_after"] == 65
    assert "expire_after" not in components["survey_inc"]
    assert components["data_age"]["device_class"] == "duration"
    assert components["data_age"]["unit_of_measurement"] == "s"
    diagnostic = {key for key, c in components.items() if c.get("entity_category") == "diagnostic"}
    assert diagnostic == {"inc_std", "tf_std", "g_total", "survey_g_error", "queued", "data_age"}
    assert len({c["unique_id"] for c in components.values()}) == len(components)


def test_the_status_is_the_word_that_is_waited_for(reported: dict[str, Any]) -> None:
    assert (reported["payload_available"], reported["payload_not_available"]) == ("online", "offline")
    assert "availability_template" not in reported


def test_latest_reads_back_and_says_nothing_that_is_not_finite() -> None:
    message = LatestMessage.model_validate_json(latest_payload(1.5, VALUES))
    assert (message.t, message.inc_deg, message.g_total) == (1.5, 12.3456, None)
