"""The Telegraf example against the schema of the messages (the program itself is not among what is installed)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from highside.service.messages import schemas

ROOT = Path(__file__).parents[2]


def test_the_fields_that_telegraf_takes_are_those_of_the_messages() -> None:
    (consumer,) = tomllib.loads((ROOT / "config/telegraf.conf").read_text())["inputs"]["mqtt_consumer"]
    every = schemas()
    kinds = [topic.rsplit("/", 1)[1] for topic in consumer["topics"]]
    assert kinds == ["attitude", "survey"]
    fields = {name: about for kind in kinds for name, about in every[kind]["properties"].items()}
    assert consumer["json_time_key"] in fields
    # numbers are taken as they are; whatever else there is must be named, or Telegraf leaves it out without a word
    lists = {name for name, about in fields.items() if "array" in _types(about)}
    texts = {name for name, about in fields.items() if not {"number", "integer", "array"} & _types(about)}
    assert set(consumer["json_string_fields"]) == texts | {f"{name}_*" for name in lists}
    assert consumer["persistent_session"]
    assert (consumer["client_id"], consumer["qos"]) == ("telegraf-highside", 1)


def _types(about: dict[str, Any]) -> set[str]:
    """Types of a field, or of its alternatives."""
    return {str(one.get("type", "reference")) for one in about.get("anyOf", [about])}
