"""The configuration of the service: one TOML file, overridden by the environment and by `--set key.path=value`.

Precedence, highest first: `--set`, environment (`HIGHSIDE__MQTT__HOST=...`, two underscores between levels), file.
Secrets come from files named in the configuration or from systemd credentials, never from these sources. Every error
names the source, the table and field, and what is allowed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from highside.calibration.rolling_bias import RollingBiasSettings
from highside.codec.registry import codecs, path_fields
from highside.config.codecs import CodecConfig
from highside.config.drift import DriftSettings
from highside.config.links import LinkConfig
from highside.config.mistakes import ENVIRONMENT_PREFIX, input_error, nearest
from highside.config.mqtt import MqttSettings
from highside.config.recorder import RecorderSettings
from highside.config.rig import (
    AcceptSettings,
    HomeAssistantSettings,
    MetricsSettings,
    SiteSettings,
    ToolfaceSettings,
    VibrationSettings,
    WitsConfig,
)
from highside.config.watch import WatchSettings
from highside.errors import InputError
from highside.reading import parse_toml, read_toml
from highside.reading.config_table import ConfigTable


class ToolSettings(ConfigTable):
    """Which tool this is."""

    id: str = Field(
        default="tool",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$",
        description="Name of the tool; part of its MQTT topics and checked against its calibration record.",
    )
    serial: str | None = Field(default=None, description="Serial number, checked against the calibration record.")
    noise_g: float | None = Field(
        default=None,
        gt=0,
        description="Standard deviation of one reading in g; estimated from the stream where absent.",
    )


class PipelineSettings(ConfigTable):
    """How readings become attitudes."""

    output_rate_hz: float = Field(
        default=10.0, gt=0, le=100, description="Attitude messages per second of device time."
    )
    averaging_s: float | None = Field(
        default=None,
        gt=0,
        le=60,
        description="Readings averaged into one attitude; where absent the output period, at most 60 s.",
    )
    g_tolerance: float = Field(
        default=0.02, gt=0, description="An attitude whose |g| differs from 1 by more is flagged `g_total`."
    )

    @property
    def window_s(self) -> float:
        return self.averaging_s or min(1.0 / self.output_rate_hz, 60.0)


class MonitorSettings(ConfigTable):
    """What makes a frame unusable or suspicious."""

    range_g: float = Field(
        default=20.0, gt=0, description="A reading beyond this is counted out of range and not used."
    )
    stuck_frames: int = Field(default=200, ge=10, description="Equal readings in a row after which an axis is stuck.")


class SurveySettings(ConfigTable):
    """When a still tool gives a survey."""

    enabled: bool = True
    still_s: float = Field(default=10.0, gt=0.5, description="Seconds of device time without motion.")
    sigma: float = Field(default=6.0, gt=1, description="A mean that departs by more of its own sigmas is motion.")
    floor_g: float = Field(default=5e-4, ge=0, le=10, description="Departures below this are never motion.")
    max_noise_g: float = Field(
        default=0.005, gt=0, le=10, description="More scatter of one reading than this is never the sensor's own."
    )
    accept: AcceptSettings = AcceptSettings()


class CalibrationSettings(ConfigTable):
    """Which calibration corrects the readings."""

    record: Path | None = Field(default=None, description="A calibration record (JSON).")
    store: Path | None = Field(default=None, description="A calibration store; its active record is used.")
    trusted_keys: Path | None = Field(
        default=None, description="Public keys, one a line: only a record signed with one of them is used."
    )
    bias_std_g: float = Field(default=2e-3, ge=0, le=10, description="Offset of an uncalibrated sensor, 1 sigma.")
    scale_std: float = Field(default=3e-3, ge=0, le=1, description="Scale error of an uncalibrated sensor, 1 sigma.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.record is not None and self.store is not None:
            raise ValueError("give either `record` or `store`, not both")
        return self


class RotationSettings(ConfigTable):
    """Errors that repeat with the rotor angle, taken off inclination, toolface and azimuth."""

    compensation: Path | None = Field(
        default=None, description="A compensation (JSON) of `rotation fit` or `rotation turntable`."
    )


class RollingBiasTable(RollingBiasSettings):
    """The rolling bias correction: the cross-axis offset of this power-up, from the circle that a turning tool
    draws."""

    apply: bool = Field(default=False, description="Take the offset off the output; else it is only reported.")


class ServiceSettings(ConfigTable):
    """The daemon itself."""

    state_dir: Path | None = Field(
        default=None,
        description="Where the outbox and the recordings live; $STATE_DIRECTORY under systemd,"
        " else the user's own (~/.local/state/highside/TOOL).",
    )
    health_interval_s: float = Field(default=5.0, gt=0.05, le=3600)
    log_level: Literal["debug", "info", "warning", "error"] = "info"


@dataclass(frozen=True, slots=True)
class _Given:
    """What `validate` was given beside the overrides."""

    tables: dict[str, Any] = field(default_factory=dict)
    """the parsed file, lowest in precedence"""
    environment: bool = True


_GIVEN: ContextVar[_Given] = ContextVar("given", default=_Given())  # noqa: B039 - nobody changes the empty one
"""Of the validation under way. The library asks the class for its sources; a class for each file would do, but to make
one takes longer than all else of a validation."""


class Settings(BaseSettings):
    """The whole file."""

    model_config = SettingsConfigDict(
        extra="forbid",
        frozen=True,
        env_prefix=ENVIRONMENT_PREFIX,
        env_nested_delimiter="__",
        nested_model_default_partial_update=False,
    )

    tool: ToolSettings = ToolSettings()
    link: LinkConfig
    codec: CodecConfig
    pipeline: PipelineSettings = PipelineSettings()
    monitor: MonitorSettings = MonitorSettings()
    survey: SurveySettings = SurveySettings()
    calibration: CalibrationSettings = CalibrationSettings()
    rotation: RotationSettings = RotationSettings()
    rolling_bias: RollingBiasTable = RollingBiasTable()
    drift: DriftSettings = DriftSettings()
    watch: WatchSettings = WatchSettings()
    mqtt: MqttSettings = MqttSettings()
    recorder: RecorderSettings = RecorderSettings()
    site: SiteSettings = SiteSettings()
    toolface: ToolfaceSettings = ToolfaceSettings()
    vibration: VibrationSettings = VibrationSettings()
    wits: tuple[WitsConfig, ...] = ()
    metrics: MetricsSettings | None = None
    home_assistant: HomeAssistantSettings | None = None
    service: ServiceSettings = ServiceSettings()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        given = _GIVEN.get()
        file = _FileSource(settings_cls, given.tables)
        return (init_settings, env_settings, file) if given.environment else (init_settings, file)

    @model_validator(mode="after")
    def _codec_fits_link(self) -> Self:
        carries = self.link.carries
        if carries is not None and carries != self.codec.carries:
            raise ValueError(
                f"link.kind {self.link.kind!r} carries {carries}, but codec.name {self.codec.name!r} decodes"
                f" {self.codec.carries}"
            )
        if self.link.kind == "simulated" and not self.codec.speaks_as_the_tool:
            raise ValueError(
                "link.kind 'simulated' speaks as the tool itself: codec.name 'tool', or 'dbc' without fields"
            )
        return self


class _FileSource(PydanticBaseSettingsSource):
    """The parsed TOML file."""

    def __init__(self, settings_cls: type[BaseSettings], tables: dict[str, Any]) -> None:
        super().__init__(settings_cls)
        self._tables = tables

    def get_field_value(self, field: Any, field_name: str) -> tuple[Any, str, bool]:
        return None, field_name, False

    def __call__(self) -> dict[str, Any]:
        return self._tables


def parse_overrides(overrides: list[str]) -> dict[str, Any]:
    """Turn `key.path=value` items into nested tables; a value that is not TOML is taken as text."""
    tables: dict[str, Any] = {}
    for item in overrides:
        path, separator, text = item.partition("=")
        keys = path.strip().split(".")
        if not separator or not all(keys):
            raise InputError("is not of the form key.path=value", where="--set", field=item)
        try:
            parsed = parse_toml(f"v = {text}")
        except InputError:
            parsed = {}
        value = parsed["v"] if set(parsed) == {"v"} else text
        table = tables
        for key in keys[:-1]:
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise InputError("sets both a value and a table below it", where="--set", field=item)
        table[keys[-1]] = value
    return tables


def load(path: Path, overrides: list[str] | None = None) -> Settings:
    """Read, merge and validate a configuration.

    Raises InputError (exit status 2) with one line naming the source, table, field and what is allowed. Relative
    paths inside the file are relative to the directory of the file.
    """
    tables = read_toml(path)
    anchor_paths(tables, path.resolve().parent)
    return validate(tables, where=str(path), overrides=overrides)


def validate(
    tables: dict[str, Any], *, where: str, overrides: list[str] | None = None, environment: bool = True
) -> Settings:
    """Validate tables as `load` does; `where` names their source in errors."""
    given = parse_overrides(overrides or [])
    for named in (tables, given):
        if "rebalance" in named and "rolling_bias" not in named:
            # as the table was called before
            named["rolling_bias"] = named.pop("rebalance")
    if environment:
        _known_environment(where)
    token = _GIVEN.set(_Given(tables, environment))
    try:
        return Settings(**given)
    except ValidationError as error:
        raise input_error(error, where, given, Settings) from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(" ".join(str(error).split()), where=where, remedy="fix the environment variable") from None
    finally:
        _GIVEN.reset(token)


def _known_environment(where: str) -> None:
    """Refuse a variable of ours that names no table: it would have no effect, and nobody would know."""
    for name in sorted(os.environ):
        if name.upper().startswith(ENVIRONMENT_PREFIX):
            table = name[len(ENVIRONMENT_PREFIX) :].lower().split("__")[0]
            if table not in Settings.model_fields:
                raise InputError(
                    "is not a known table",
                    where=f"{where} with the environment",
                    field=name,
                    remedy=nearest([table], Settings),
                )


PATH_FIELDS = {
    ("calibration", "record"),
    ("calibration", "store"),
    ("calibration", "trusted_keys"),
    ("rotation", "compensation"),
    ("link", "path"),
    ("service", "state_dir"),
    ("mqtt", "password_file"),
    ("mqtt", "tls", "ca"),
    ("mqtt", "tls", "cert"),
    ("mqtt", "tls", "key"),
    *(("codec", name) for name in path_fields(*codecs().values())),
}
"""Fields that name files; relative ones are taken from the configuration's own directory."""


def anchor_paths(tables: dict[str, Any], base: Path, fields: Iterable[tuple[str, ...]] = PATH_FIELDS) -> None:
    """Take relative file names of the `fields` from the directory `base`, in place."""
    for keys in fields:
        table: Any = tables
        for key in keys[:-1]:
            table = table.get(key) if isinstance(table, dict) else None
        if not isinstance(table, dict) or not isinstance(value := table.get(keys[-1]), str):
            continue
        if keys == ("mqtt", "password_file") and "/" not in value and "CREDENTIALS_DIRECTORY" in os.environ:
            continue  # the name of a systemd credential
        if not Path(value).is_absolute():
            table[keys[-1]] = str(base / value)
