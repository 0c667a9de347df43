"""The configuration of the tools' page: `highside serve --config FILE`, all of it optional.

`[mqtt]`: the broker and the prefix of the topics, as for the service; `[web]`: where the page is served. Errors name
the field and what is allowed.
"""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, ValidationError

from highside.config.merge import merged
from highside.config.mistakes import input_error
from highside.config.mqtt import MqttSettings
from highside.config.settings import anchor_paths, parse_overrides
from highside.config.web import WebTable
from highside.reading import read_toml
from highside.reading.config_table import ConfigTable

PATHS = (
    ("mqtt", "password_file"),
    ("mqtt", "tls", "ca"),
    ("mqtt", "tls", "cert"),
    ("mqtt", "tls", "key"),
    ("web", "token_file"),
    ("web", "tls", "certificate"),
    ("web", "tls", "key"),
)
"""Fields that name files; relative ones start at the directory of the configuration."""


class ServeFile(ConfigTable):
    """The whole file."""

    mqtt: MqttSettings = MqttSettings()
    web: WebTable = Field(default=WebTable(port=8766))


def load_serve(path: Path | None, overrides: list[str] | None = None) -> ServeFile:
    """Read and validate the file, or the defaults where there is none; `overrides` are `key.path=value`.

    Raises InputError in one line.
    """
    tables = {} if path is None else read_toml(path)
    if path is not None:
        anchor_paths(tables, path.resolve().parent, PATHS)
    tables.setdefault("web", {}).setdefault("port", 8766)
    given = parse_overrides(overrides or [])
    try:
        return ServeFile.model_validate(merged(tables, given))
    except ValidationError as error:
        raise input_error(error, "--set" if path is None else str(path), given, ServeFile) from None
