"""Announces the tool to Home Assistant: one retained message that describes the device and its sensors.

The format is Home Assistant's MQTT discovery of whole devices (`<prefix>/device/<id>/config`).
"""

from __future__ import annotations

import json

from highside import __version__
from highside.config.mqtt import MqttSettings
from highside.config.rig import HomeAssistantSettings
from highside.service.messages import OFFLINE, ONLINE

SENSORS = (
    ("inc", "Inclination", "attitude", "{{ value_json.inc_deg }}", "°", "mdi:angle-acute", 3),
    ("inc_std", "Inclination uncertainty", "attitude", "{{ value_json.inc_std_deg }}", "°", "mdi:plus-minus", 4),
    ("toolface", "Toolface", "attitude", "{{ value_json.toolface_deg }}", "°", "mdi:rotate-right", 2),
    ("tf_std", "Toolface uncertainty", "attitude", "{{ value_json.tf_std_deg }}", "°", "mdi:plus-minus", 3),
    ("azimuth", "Azimuth", "attitude", "{{ value_json.azi_deg | default(none) }}", "°", "mdi:compass", 2),
    ("g_total", "Gtotal", "attitude", "{{ value_json.g_total }}", "g", "mdi:earth", 5),
    ("survey_inc", "Survey inclination", "survey", "{{ value_json.inc_deg }}", "°", "mdi:ruler-square", 3),
    ("survey_g_error", "Survey Gtotal error", "survey", "{{ value_json.g_error_mg }}", "mg", "mdi:scale-balance", 3),
    ("queued", "Messages waiting", "health", "{{ value_json.outbox.queued }}", None, "mdi:tray-full", 0),
    ("data_age", "Age of data", "health", "{{ value_json.link.data_age_s }}", "s", "mdi:timer-sand", 1),
)
"""id, name, last part of the topic, template of the value, unit, icon, decimals shown"""


def discovery(
    tool_id: str, serial: str | None, mqtt: MqttSettings, settings: HomeAssistantSettings
) -> tuple[str, bytes]:
    """Topic and payload of the announcement."""
    unique = f"highside_{tool_id}".replace(".", "_")
    components: dict[str, dict[str, object]] = {}
    for key, name, topic, template, unit, icon, digits in SENSORS:
        components[key] = {
            "platform": "sensor",
            "unique_id": f"{unique}_{key}",
            "name": name,
            "state_topic": mqtt.topic(tool_id, topic),
            "value_template": template,
            "icon": icon,
            "suggested_display_precision": digits,
        }
        if unit is not None:
            components[key] |= {"unit_of_measurement": unit, "state_class": "measurement"}
    components["problem"] = {
        "platform": "binary_sensor",
        "unique_id": f"{unique}_problem",
        "name": "Alarm",
        "device_class": "problem",
        "state_topic": mqtt.topic(tool_id, "health"),
        "value_template": "{{ 'ON' if value_json.alarms else 'OFF' }}",
        "json_attributes_topic": mqtt.topic(tool_id, "health"),
        "json_attributes_template": "{{ {'alarms': value_json.alarms} | tojson }}",
    }
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
