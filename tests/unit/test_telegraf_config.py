"""The Telegraf example against the schema of the messages and the options that Telegraf's own documentation names.

The program itself cannot be installed here: no package of Debian, PyPI or npm is it.
"""

from __future__ import annotations

import re
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


OPTIONS = {
    # by the sample configurations of these plugins, and the README of the parser (1.20 and later)
    "inputs.mqtt_consumer": {
        "servers", "topics", "topic_tag", "qos", "connection_timeout", "keepalive", "ping_timeout",
        "max_undelivered_messages", "persistent_session", "client_id", "username", "password", "tls_ca", "tls_cert",
        "tls_key", "insecure_skip_verify", "client_trace", "data_format", "topic_parsing",
    },
    "parsers.json": {
        "json_strict", "json_query", "tag_keys", "json_string_fields", "json_name_key", "json_time_key",
        "json_time_format", "json_timezone",
    },
    "inputs.mqtt_consumer.topic_parsing": {"topic", "measurement", "tags", "fields", "types"},
    "outputs.influxdb_v2": {"urls", "token", "organization", "bucket", "bucket_tag", "timeout", "content_encoding"},
    "outputs.postgresql": {"connection", "schema", "tags_as_foreign_keys", "tags_as_jsonb", "fields_as_jsonb"},
}  # fmt: skip


def test_every_option_is_one_that_telegraf_knows() -> None:
    """It ends at its start with one that it does not know. What is offered behind a # is looked at too."""
    text = (ROOT / "config/telegraf.conf").read_text()
    offered = re.sub(r"^(\s*)#(?=\S)", r"\1", text, flags=re.MULTILINE)
    for given in map(tomllib.loads, (text, offered)):
        assert set(given) == {"inputs", "outputs"}
        (consumer,) = given["inputs"]["mqtt_consumer"]
        assert consumer["data_format"] == "json"
        assert set(consumer) <= OPTIONS["inputs.mqtt_consumer"] | OPTIONS["parsers.json"]
        assert consumer["json_time_format"] in ("unix", "unix_ms", "unix_us", "unix_ns")
        for name, tables in given["outputs"].items():
            assert all(set(table) <= OPTIONS[f"outputs.{name}"] for table in tables)
    assert {"influxdb_v2", "postgresql"} == set(tomllib.loads(offered)["outputs"])


def test_tool_and_kind_are_taken_from_the_topic() -> None:
    """Where the parts of a rule are not as many as those of the topic Telegraf does not start, or takes nothing."""
    (consumer,) = tomllib.loads((ROOT / "config/telegraf.conf").read_text())["inputs"]["mqtt_consumer"]
    (rule,) = consumer["topic_parsing"]
    assert set(rule) <= OPTIONS["inputs.mqtt_consumer.topic_parsing"]
    taken = [rule[name].split("/") for name in ("topic", "measurement", "tags")]
    assert {len(parts) for parts in taken} == {3} and taken[0] == ["+"] * 3
    for topic in consumer["topics"]:
        parts = topic.split("/")
        assert len(parts) == 3
        assert parts[taken[1].index("measurement")] in ("attitude", "survey")
        assert parts[taken[2].index("tool")] == "+"
    # only one part names the measurement, and the topic itself is no tag beside
    assert taken[1].count("_") == 2 and consumer["topic_tag"] == ""


def _types(about: dict[str, Any]) -> set[str]:
    """Types of a field, or of its alternatives."""
    return {str(one.get("type", "reference")) for one in about.get("anyOf", [about])}
