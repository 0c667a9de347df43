"""Announces the tool to Home Assistant: one retained message that describes the device and its sensors.

The format is Home Assistant's MQTT discovery of whole devices (`<prefix>/device/<id>/config`). Home Assistant records
every value it is sent, so what it is pointed at comes once a second (`latest`) or on change (`survey`, `health`), never
at the rate of the attitudes; and each sensor says for how long its value holds, so that a dead tool shows no number.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from highside.config.mqtt import MqttSettings
from highside.config.rig import HomeAssistantSettings
from highside.service.messages import OFFLINE, ONLINE
from highside.version import __version__

LATEST_EXPIRES_S = 10
"""Seconds after which a value of `latest` is no more shown: ten of them are missing then."""
HEALTH_EXPIRES_S = 30
"""The same for `health`, at least; three of its intervals and five seconds where that is more."""


class Sensor(NamedTuple):
    """One value of the device. `member` is that of the payload, in Jinja's words."""

    key: str
    name: str
    topic: str
    member: str
    unit: str | None
    icon: str
    digits: int
    diagnostic: bool = False
    device_class: str | None = None


SENSORS = (
    Sensor("inc", "Inclination", "latest", "inc_deg", "°", "mdi:angle-acute", 3),
    Sensor("inc_std", "Inclination uncertainty", "latest", "inc_std_deg", "°", "mdi:plus-minus", 4, diagnostic=True),
    Sensor("toolface", "Toolface", "latest", "motor_toolface_deg", "°", "mdi:rotate-right", 2),
    Sensor("tf_std", "Toolface uncertainty", "latest", "tf_std_deg", "°", "mdi:plus-minus", 3, diagnostic=True),
    Sensor("azimuth", "Azimuth", "latest", "azi_deg", "°", "mdi:compass", 2),
    Sensor("g_total", "Gtotal", "latest", "g_total", "g", "mdi:earth", 5, diagnostic=True),
    Sensor("survey_inc", "Survey inclination", "survey", "inc_deg", "°", "mdi:ruler-square", 3),
    Sensor("survey_toolface", "Survey toolface", "survey", "motor_toolface_deg", "°", "mdi:rotate-right", 2),
    Sensor("survey_azimuth", "Survey azimuth", "survey", "azi_deg | default(none)", "°", "mdi:compass", 2),
    Sensor("survey_g_error", "Survey Gtotal error", "survey", "g_error_mg", "mg", "mdi:scale-balance", 3, True),
    Sensor("queued", "Messages waiting", "health", "outbox.queued", None, "mdi:tray-full", 0, diagnostic=True),
    Sensor("data_age", "Age of data", "health", "link.data_age_s", "s", "mdi:timer-sand", 1, True, "duration"),
)


def _shown(sensor: Sensor) -> dict[str, Any]:
    """How a value is shown."""
    shown = {"icon": sensor.icon, "suggested_display_precision": sensor.digits, "state_class": "measurement"}
    optional = {
        "unit_of_measurement": sensor.unit,
        "device_class": sensor.device_class,
        "entity_category": "diagnostic" if sensor.diagnostic else None,
    }
    return shown | {key: value for key, value in optional.items() if value is not None}


def _binary_sensors(add: Callable[[str, str, str, str, str], dict[str, Any]], topic: Callable[[str], str]) -> None:
    """What is on or off: `add` as in `discovery`, `topic` of a name."""
    accepted = "{{ 'ON' if value_json.accepted else 'OFF' }}"
    add("survey_accepted", "Survey accepted", "survey", "binary_sensor", accepted).update(
        icon="mdi:check-decagram",
        json_attributes_topic=topic("survey"),
        json_attributes_template="{{ {'reasons': value_json.reasons} | tojson }}",
    )
    departs = "{{ 'ON' if value_json.verdict == 'departs' else 'OFF' }}"
    add("calibration_departs", "Calibration departs", "watch", "binary_sensor", departs).update(
        device_class="problem",
        json_attributes_topic=topic("watch"),
        json_attributes_template="{{ {'verdict': value_json.verdict, 'advice': value_json.advice,"
        " 'noise': value_json.noise_changes | map(attribute='axis') | list,"
        " 'class': value_json.claims | map(attribute='equivalence_class') | list} | tojson }}",
    )
    alarms = "{{ 'ON' if value_json.alarms else 'OFF' }}"
    add("problem", "Alarm", "health", "binary_sensor", alarms).update(
        device_class="problem",
        json_attributes_topic=topic("health"),
        json_attributes_template="{{ {'alarms': value_json.alarms} | tojson }}",
    )


def discovery(
    tool_id: str,
    serial: str | None,
    mqtt: MqttSettings,
    settings: HomeAssistantSettings,
    *,
    health_interval_s: float,
) -> tuple[str, bytes]:
    """Topic and payload of the announcement."""
    unique = f"highside_{tool_id}".replace(".", "_")
    expires_s = {
        "latest": LATEST_EXPIRES_S,
        "health": max(HEALTH_EXPIRES_S, math.ceil(3.0 * health_interval_s) + 5),
    }
    components: dict[str, dict[str, Any]] = {}

    def add(key: str, name: str, topic: str, platform: str, template: str) -> dict[str, Any]:
        component: dict[str, Any] = {
            "platform": platform,
            "unique_id": f"{unique}_{key}",
            "name": name,
            "state_topic": mqtt.topic(tool_id, topic),
            "value_template": template,
        }
        if topic in expires_s:
            component["expire_after"] = expires_s[topic]
        components[key] = component
        return component

    for sensor in SENSORS:
        found = add(sensor.key, sensor.name, sensor.topic, "sensor", f"{{{{ value_json.{sensor.member} }}}}")
        found |= _shown(sensor)
    _binary_sensors(add, partial(mqtt.topic, tool_id))
    device: dict[str, object] = {"identifiers": [unique], "name": f"Tool {tool_id}", "sw_version": __version__}
    if serial is not None:
        device["serial_number"] = serial
    payload = {
        "device": device,
        "origin": {"name": "highside", "sw_version": __version__},
        "availability_topic": mqtt.topic(tool_id, "status"),
        "payload_available": ONLINE.decode(),
        "payload_not_available": OFFLINE.decode(),
        "qos": 1,
        "components": components,
    }
    return f"{settings.prefix}/device/{unique}/config", json.dumps(payload, ensure_ascii=False).encode()
