"""The configuration of the tools' page: `highside serve --config FILE`, all of it optional.

`[mqtt]`: the broker and the prefix of the topics, as for the service; `[web]`: where the page is served; `[records]`:
which calibrations and bench sessions are shown, and whose signatures
count; `[diagnosis]`: whether files may be sent for a diagnosis; `[bench]`: which sessions may be begun. Errors name
the field and what is allowed.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Self

from pydantic import Field, ValidationError, model_validator

from highside.config import places
from highside.config.merge import merged
from highside.config.mistakes import input_error
from highside.config.mqtt import MqttSettings
from highside.config.settings import anchor_paths, parse_overrides
from highside.config.web import WebTable
from highside.errors import InputError
from highside.reading import read_toml
from highside.reading.config_table import ConfigTable
from highside.recording.keys import read_trusted_keys

if TYPE_CHECKING:
    from highside.calibration.signature import TrustedKeys

PATHS = (
    ("mqtt", "password_file"),
    ("mqtt", "tls", "ca"),
    ("mqtt", "tls", "cert"),
    ("mqtt", "tls", "key"),
    ("web", "token_file"),
    ("web", "users"),
    ("web", "acts"),
    ("web", "certificate"),
    ("web", "tls", "certificate"),
    ("web", "tls", "key"),
    ("settings",),
    ("records", "store"),
    ("records", "sessions"),
    ("records", "trusted_keys"),
    ("bench", "folder"),
    ("bench", "state"),
)
"""Fields that name files; relative ones start at the directory of the configuration."""


class RecordsTable(ConfigTable):
    """What is kept, for whoever looks; nothing is written there. Relative names start at the directory of the file."""

    store: Path | None = Field(default=None, description="A calibration store; absent: no such pages.")
    sessions: Path | None = Field(default=None, description="The journals of bench sessions; absent: no such pages.")
    trusted_keys: Path | None = Field(
        default=None, description="Public keys: only what one of them signed is put in force at the page."
    )

    def read_trusted_keys(self) -> TrustedKeys | None:
        """Raises InputError."""
        return None if self.trusted_keys is None else read_trusted_keys(self.trusted_keys)

    def check(self) -> None:
        """Raises InputError for a directory that is not there, or keys that cannot be read."""
        self.read_trusted_keys()
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


class BenchFolderTable(ConfigTable):
    """Bench sessions begun at the page, for who has its token, or signs in and may put in force."""

    folder: Path | None = Field(
        default=None, description="Directory of session files (`calibrate bench --config`); absent: no such page."
    )
    state: Path = Field(
        default_factory=places.bench_pages, description="Where what runs is written down, for this user alone."
    )

    def check(self) -> None:
        """Raises InputError for a directory that is not there."""
        if self.folder is not None and not self.folder.is_dir():
            raise InputError(
                "no such directory", where=str(self.folder), field="bench.folder", remedy="see config/bench.toml"
            )


class ServeFile(ConfigTable):
    """The whole file."""

    mqtt: MqttSettings = MqttSettings()
    web: WebTable = Field(default=WebTable(port=8766))
    records: RecordsTable = RecordsTable()
    diagnosis: DiagnosisTable = DiagnosisTable()
    bench: BenchFolderTable = Field(default_factory=BenchFolderTable)
    settings: Path | None = Field(
        default=None, description="The configuration of `highside run`, shown and edited; needs [web] users."
    )

    @model_validator(mode="after")
    def _users_for_the_settings(self) -> Self:
        if self.settings is not None and self.web.users is None:
            raise ValueError("settings needs [web] users: only a person with a role may change a configuration")
        return self

    def check(self) -> None:
        """What can be judged before anything is served. Raises InputError for places and files that are not there."""
        self.records.check()
        self.bench.check()
        if self.settings is not None:
            read_toml(self.settings)


def load_serve(
    path: Path | None,
    overrides: list[str] | None = None,
    *,
    records: Path | None = None,
    sessions: Path | None = None,
    diagnose: bool = False,
    users: Path | None = None,
    bench: Path | None = None,
    settings: Path | None = None,
) -> ServeFile:
    """Read and validate the file, or the defaults where there is none; `overrides` are `key.path=value`, `records` and
    `sessions` take the place of `[records]` store and sessions, `diagnose` that of `[diagnosis] enabled`, `users` that
    of `[web] users`, `bench` that of `[bench] folder`, `settings` that of
    `settings`.

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
    if users is not None:
        tables = merged(tables, {"web": {"users": str(users)}})
    if bench is not None:
        tables = merged(tables, {"bench": {"folder": str(bench)}})
    if settings is not None:
        tables = merged(tables, {"settings": str(settings)})
    given = parse_overrides(overrides or [])
    try:
        return ServeFile.model_validate(merged(tables, given))
    except ValidationError as error:
        raise input_error(error, "--set" if path is None else str(path), given, ServeFile) from None
