"""The JSON Schema of a configuration file: of one tool, or of several (`[[tools]]`).

In a file of several tools a table may lack what the other place gives, so nothing within it is required there; that
the two together are whole is what `highside check` says.
"""

from __future__ import annotations

from typing import Any

from highside.config.settings import Settings, ToolSettings
from highside.config.tools import ENTRIES, MOST

__all__ = ["config_schema"]

_DEFS = "#/$defs/"
_PARTIAL = "Partial"


def config_schema() -> dict[str, Any]:
    """The schema, JSON Schema 2020-12: `Settings` of one tool, `Tools` of several."""
    one = Settings.model_json_schema()
    definitions: dict[str, Any] = one.pop("$defs")
    tables = {name: _partial(table) for name, table in one["properties"].items()}
    entry = {"id": ToolSettings.model_json_schema()["properties"]["id"], **tables}
    entry["id"].pop("default", None)
    several = {
        "type": "object",
        "description": "Several tools: what stands beside [[tools]] holds for all.",
        "additionalProperties": False,
        "required": [ENTRIES],
        "properties": {
            **tables,
            ENTRIES: {
                "type": "array",
                "minItems": 1,
                "maxItems": MOST,
                "items": {
                    "type": "object",
                    "description": "One tool: its name, and the tables that are its own.",
                    "additionalProperties": False,
                    "required": ["id"],
                    "properties": entry,
                },
            },
        },
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "highside configuration",
        "if": {"required": [ENTRIES]},
        "then": {"$ref": f"{_DEFS}Tools"},
        "else": {"$ref": f"{_DEFS}Settings"},
        "$defs": {
            **definitions,
            **{f"{name}{_PARTIAL}": _partial(table) for name, table in definitions.items()},
            "Settings": one,
            "Tools": several,
        },
    }


def _partial(schema: Any) -> Any:
    """The same with nothing required: of a table that leaves its kind to the other place any kind may be meant."""
    if isinstance(schema, list):
        return [_partial(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    found: dict[str, Any] = {}
    for key, value in schema.items():
        if key == "properties":
            # names of fields, none of which is a keyword
            found[key] = {name: _partial(field) for name, field in value.items()}
        elif key == "$ref":
            found[key] = f"{value}{_PARTIAL}"
        elif key == "oneOf":
            found["anyOf"] = _partial(value)
        elif key not in ("required", "discriminator"):
            found[key] = _partial(value)
    return found
