"""The MQTT topics of the service, and an AsyncAPI 3 document of these and others (`highside schema --asyncapi`).

The payloads are the models that write the messages, so that the document cannot say anything else than is sent.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, TypeAdapter
from pydantic.json_schema import models_json_schema

from highside.config.mqtt import MqttSettings
from highside.service.messages import PAYLOADS, WORDS
from highside.version import __version__

REFERENCE = "#/components/schemas/{model}"
DIALECT = "application/schema+json;version=draft-07"


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic below `<prefix>/<tool>/`."""

    name: str
    says: str
    payload: type[BaseModel] | str
    """the model of its JSON, or the pattern of its text"""
    retained: bool = False
    to_us: bool = False
    """a command: others publish it"""
    qos: int = 1
    """that of `attitude` and `survey` is `mqtt.qos`, 1 unless configured"""

    @property
    def key(self) -> str:
        """Its name where no slash may stand."""
        return self.name.replace("/", "_")


_RETAINED = {"health", "drift", "watch", "watch/history"}
_PASSING = {"latest"}


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return text[0].upper() + text[1:]


SERVICE_TOPICS: tuple[Topic, ...] = (
    *(
        Topic(
            name,
            _sentence((model.__doc__ or "").split(": ", 1)[-1]),
            model,
            retained=name in _RETAINED,
            to_us=name.endswith("/command"),
            qos=0 if name in _PASSING else 1,
        )
        for name, model in PAYLOADS.items()
    ),
    *(Topic(name, _sentence(says), pattern, retained=True) for name, pattern, says in WORDS),
)
"""What `highside run` sends and obeys."""


def asyncapi(topics: Iterable[Topic]) -> dict[str, Any]:
    """An AsyncAPI 3.0.0 document. Operations are those of the tool: it sends, or receives a command."""
    topics = list(topics)
    models = dict.fromkeys(topic.payload for topic in topics if not isinstance(topic.payload, str))
    _, definitions = models_json_schema([(model, "validation") for model in models], ref_template=REFERENCE)
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "highside",
            "version": __version__,
            "description": "What a tool says over MQTT, and what it obeys. Below `<prefix>/<tool>/`, where `prefix` is"
            " `mqtt.prefix` and `tool` is `tool.id` of its configuration.",
        },
        "defaultContentType": "application/json",
        "servers": {
            "broker": {
                "host": "{}:{}".format(*(MqttSettings.model_fields[name].default for name in ("host", "port"))),
                "protocol": "mqtt",
                "description": "`mqtt.host` and `mqtt.port`; TLS with `[mqtt.tls]`.",
            }
        },
        "channels": {topic.key: _channel(topic) for topic in topics},
        "operations": {_operation_name(topic): _operation(topic) for topic in topics},
        "components": {
            "messages": {topic.key: _message(topic) for topic in topics},
            "schemas": definitions["$defs"],
        },
    }


def _channel(topic: Topic) -> dict[str, Any]:
    return {
        "address": f"{{prefix}}/{{tool}}/{topic.name}",
        "description": topic.says,
        "parameters": {
            "prefix": {"description": "`mqtt.prefix`.", "default": MqttSettings.model_fields["prefix"].default},
            "tool": {"description": "`tool.id`."},
        },
        "messages": {topic.key: {"$ref": f"#/components/messages/{topic.key}"}},
    }


def _operation_name(topic: Topic) -> str:
    return ("receive_" if topic.to_us else "send_") + topic.key


def _operation(topic: Topic) -> dict[str, Any]:
    action: Literal["receive", "send"] = "receive" if topic.to_us else "send"
    return {
        "action": action,
        "channel": {"$ref": f"#/channels/{topic.key}"},
        "summary": topic.says,
        "messages": [{"$ref": f"#/channels/{topic.key}/messages/{topic.key}"}],
        "bindings": {"mqtt": {"qos": topic.qos, "retain": topic.retained, "bindingVersion": "0.2.0"}},
    }


def _message(topic: Topic) -> dict[str, Any]:
    if isinstance(topic.payload, str):
        text = TypeAdapter(Annotated[str, Field(pattern=topic.payload)]).json_schema()
        schema, content = text, "text/plain"
    else:
        schema, content = {"$ref": REFERENCE.format(model=topic.payload.__name__)}, "application/json"
    return {
        "name": topic.key,
        "title": topic.name,
        "contentType": content,
        "payload": {"schemaFormat": DIALECT, "schema": schema},
    }
