"""The table `[mqtt]`: where the broker is, how to be known to it, and what to keep while it is away."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, SecretStr, model_validator

from highside.errors import InputError
from highside.reading import SECRET_MAX, read_named
from highside.reading.config_table import ConfigTable, is_host_name

CREDENTIAL_NAME = "mqtt_password"
"""Name of the systemd credential that is used when no `password_file` is given."""


class TlsSettings(ConfigTable):
    """The table `[mqtt.tls]`; present, even if empty: the connection is encrypted and the broker's name checked."""

    ca: Path | None = Field(default=None, description="Certificates that are trusted; the system's where absent.")
    cert: Path | None = Field(default=None, description="Our own certificate (PEM).")
    key: Path | None = Field(default=None, description="The key of our own certificate (PEM).")

    @model_validator(mode="after")
    def _pair(self) -> Self:
        if (self.cert is None) != (self.key is None):
            raise ValueError("`cert` and `key` go together: give both or none")
        return self


class OutboxSettings(ConfigTable):
    """The table `[mqtt.outbox]`: what is kept on disk until the broker has it. Beyond a cap the oldest is dropped."""

    max_rows: int = Field(default=2_000_000, ge=100, description="Messages kept.")
    max_bytes: int = Field(
        default=512 * 1024 * 1024,
        ge=65_536,
        description="Bytes of payload and topic kept; a message beyond it alone is refused.",
    )
    max_age_s: float = Field(default=14 * 86_400.0, gt=0, description="Messages older than this are dropped.")
    commit_interval_s: float = Field(
        default=0.05, ge=0.005, le=5, description="Least time between two commits: what a power cut may cost."
    )


class MqttSettings(ConfigTable):
    """The whole table."""

    host: str = Field(default="127.0.0.1", min_length=1, description="Broker; for `unix` the path of its socket.")
    port: int = Field(default=1883, ge=1, le=65_535)
    transport: Literal["tcp", "unix"] = "tcp"
    tls: TlsSettings | None = None
    username: str | None = None
    password_file: Path | None = Field(
        default=None,
        description="File with the password; a bare name is looked for in $CREDENTIALS_DIRECTORY first."
        f" Where absent, the systemd credential `{CREDENTIAL_NAME}` is used if there is one.",
    )
    client_id: str | None = Field(
        default=None, pattern=r"^[A-Za-z0-9_.-]{1,64}$", description="`highside-<tool>` where absent."
    )
    keepalive_s: int = Field(default=5, ge=2, le=600, description="An idle broker that is silent for longer is gone.")
    ack_timeout_s: float = Field(
        default=4.0, gt=0.1, le=120, description="A message without PUBACK for that long ends the connection."
    )
    connect_timeout_s: float = Field(default=5.0, gt=0.1, le=60)
    reconnect_min_s: float = Field(default=0.1, gt=0, le=60)
    reconnect_max_s: float = Field(default=1.0, gt=0, le=600)
    qos: Literal[0, 1] = Field(default=1, description="1 keeps a message until the broker has acknowledged it.")
    in_flight: int = Field(default=64, ge=1, le=1000, description="Messages sent and not yet acknowledged.")
    backlog_per_s: float = Field(
        default=1000.0,
        gt=0,
        description="Historical messages sent a second; more may overrun slow subscribers, whose queue is cut.",
    )
    prefix: str = Field(
        default="highside",
        max_length=200,
        pattern=r"^[^$/#+\s\p{C}]([^#+\s\p{C}]*[^/#+\s\p{C}])?$",
        description="Topics: <prefix>/<tool>/... Brokers end a connection for control characters in a topic; those"
        " that begin with $ are their own.",
    )
    historical_after_s: float = Field(default=5.0, gt=0, description="Older messages are marked `historical`.")
    outbox: OutboxSettings = OutboxSettings()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.reconnect_max_s < self.reconnect_min_s:
            raise ValueError("`reconnect_max_s` is below `reconnect_min_s`")
        if self.transport == "tcp" and not is_host_name(self.host):
            raise ValueError("`host` is a name or an address, without spaces and without /")
        if self.transport == "unix" and self.tls is not None:
            raise ValueError("`tls` is for transport 'tcp' alone")
        if self.password_file is not None and self.username is None:
            raise ValueError("`password_file` needs a `username`")
        return self

    def topic(self, tool_id: str, name: str) -> str:
        """`<prefix>/<tool>/<name>`"""
        return f"{self.prefix}/{tool_id}/{name}"

    def read_password(self) -> SecretStr | None:
        """The password from its file or from systemd's credentials; read anew at every connect, so it may change.

        Raises `InputError` if a file that is named cannot be read.
        """
        credentials = os.environ.get("CREDENTIALS_DIRECTORY")
        path = self.password_file
        if path is None:
            if credentials is None or self.username is None or not (Path(credentials) / CREDENTIAL_NAME).is_file():
                return None
            path = Path(credentials) / CREDENTIAL_NAME
        elif credentials is not None and len(path.parts) == 1 and (Path(credentials) / path).is_file():
            path = Path(credentials) / path
        return SecretStr(password_in(path, "mqtt.password_file"))


def password_in(path: Path, field: str) -> str:
    """The password that is all that a file holds, without the line's end. Raises `InputError`."""
    try:
        text = read_named(path, field, max_bytes=SECRET_MAX).decode().strip("\r\n")
    except UnicodeDecodeError:
        raise InputError("is not UTF-8 text", where=str(path), field=field, remedy="name the right file") from None
    if not text.strip():
        raise InputError("holds no password", where=str(path), field=field, remedy="write it into the file")
    return text
