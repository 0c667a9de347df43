"""The configuration of the tools' page: `highside serve --config FILE`, all of it optional.

`[mqtt]`: the broker and the prefix of the topics, as for the service; `[web]`: where the page is served; `[records]`:
which calibrations and bench sessions are shown; `[diagnosis]`: whether files may be sent for a diagnosis. Errors name
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
from highside.errors import InputError
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
    ("records", "store"),
    ("records", "sessions"),
)
"""Fields that name files; relative ones start at the directory of the configuration."""


class RecordsTable(ConfigTable):
    """What is kept, for whoever looks; nothing is written there. Relative names start at the directory of the file."""

    store: Path | None = Field(default=None, description="A calibration store; absent: no such pages.")
    sessions: Path | None = Field(default=None, description="The journals of bench sessions; absent: no such pages.")

    def check(self) -> None:
        """Raises InputError for a directory that is not there."""
        for name, path in (("store", self.store), ("sessions", self.sessions)):
            if path is not None and not path.is_dir():
                raise InputError(
                    "no such directory",
                    where=str(path),
                    field=f"records.{name}",
                    remedy="give the directory of `[store]` in the bench's file",
                )


class DiagnosisTable(ConfigTable):
    """Diagnosis of files that are sent to the page, for who has its token."""

    enabled: bool = Field(default=False, description="Whether there is such a page.")
    upload_mb: int = Field(default=64, ge=1, le=512, description="Largest recording that is taken, MB.")
    minutes: float = Field(default=30.0, gt=0, le=600, description="A diagnosis that takes longer is ended.")


class ServeFile(ConfigTable):
    """The whole file."""

    mqtt: MqttSettings = MqttSettings()
    web: WebTable = Field(default=WebTable(port=8766))
    records: RecordsTable = RecordsTable()
    diagnosis: DiagnosisTable = DiagnosisTable()


def load_serve(
    path: Path | None,
    overrides: list[str] | None = None,
    *,
    records: Path | None = None,
    sessions: Path | None = None,
    diagnose: bool = False,
) -> ServeFile:
    """Read and validate the file, or the defaults where there is none; `overrides` are `key.path=value`, `records` and
    `sessions` take the place of `[records]` store and sessions, `diagnose` that of `[diagnosis] enabled`.

    Raises InputError in one line.
    """
    tables = {} if path is None else read_toml(path)
    if path is not None:
        anchor_paths(tables, path.resolve().parent, PATHS)
    tables = merged({"web": {"port": 8766}}, tables)
    named = {name: str(value) for name, value in (("store", records), ("sessions", sessions)) if value is not None}
    if named:
        tables = merged(tables, {"records": named})
    if diagnose:
        tables = merged(tables, {"diagnosis": {"enabled": True}})
    given = parse_overrides(overrides or [])
    try:
        return ServeFile.model_validate(merged(tables, given))
    except ValidationError as error:
        raise input_error(error, "--set" if path is None else str(path), given, ServeFile) from None
