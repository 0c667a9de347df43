"""`highside run | check | schema`: the service, its configuration, and the shape of its messages."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.linux import linux_alone
from highside.cli.loading import loading
from highside.cli.options import PrintLanguage, speaking
from highside.cli.say import echo, echo_json, report_omitted
from highside.errors import InputError
from highside.words import _, told

if TYPE_CHECKING:
    from highside.config.settings import Settings

ConfigOption = Annotated[Path, typer.Option("--config", help="TOML file; see config/ for examples.")]
ToolOption = Annotated[
    str | None, typer.Option("--tool", metavar="ID", help="Of a file with [[tools]]: which of them; all if left out.")
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Override one field: key.path=value. May be repeated.")
]


def run(config: ConfigOption, overrides: SetOption = None) -> None:
    """Run the service: frames in, corrected inclination and toolface out over MQTT, day and night."""
    linux_alone("run")
    from highside.codec.registry import faults
    from highside.config.settings import load
    from highside.config.tools import has_tools
    from highside.service.app import Service
    from highside.service.interpreter import settle_interpreter
    from highside.service.logs import start_logging

    if has_tools(config):
        _run_tools(config, overrides)
        return
    settings = load(config, overrides)
    report_omitted("codec", faults())
    start_logging(settings.service.log_level)

    async def serve() -> None:
        service = Service(settings, reload=lambda: load(config, overrides))
        settle_interpreter()
        await service.run()

    _until_ended(config, serve)


def _run_tools(config: Path, overrides: list[str] | None) -> None:
    """A file with [[tools]]: one service for each, in this process."""
    from highside.codec.registry import faults
    from highside.config.tools import load_tool, load_tools, tool_ids
    from highside.service.logs import start_logging
    from highside.service.many import Tools

    settings = load_tools(config, overrides)
    report_omitted("codec", faults())
    start_logging(settings[0].service.log_level)

    async def serve() -> None:
        await Tools(settings, lambda tool: load_tool(config, overrides, tool), lambda: tool_ids(config)).run()

    _until_ended(config, serve)


def _until_ended(config: Path, serve: Callable[[], Coroutine[Any, Any, None]]) -> None:
    async def deaf_at_the_end() -> None:
        try:
            await serve()
        finally:
            # all is on disk; a late reload or an impatient second signal must not spoil the exit status
            for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT):
                signal.signal(number, signal.SIG_IGN)

    try:
        asyncio.run(deaf_at_the_end())
    except InputError as error:
        if error.where is not None:
            raise
        raise InputError(error.what, where=str(config), field=error.field, remedy=error.remedy) from None


def check(
    config: Annotated[Path, typer.Argument(help="The configuration to validate.")],
    overrides: SetOption = None,
    language: PrintLanguage = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the effective configuration as JSON.")] = False,
) -> None:
    """Validate a configuration without running it: fields, codec, secrets, calibration record, compensation.

    A bench session's file (it has a table [plan]) is judged as such, its page's token, certificate and key too.
    """
    with speaking(language):
        _check(config, overrides, as_json=as_json)


def _check(config: Path, overrides: list[str] | None, *, as_json: bool) -> None:
    with loading():
        from highside.codec.registry import faults
        from highside.config.settings import load
        from highside.config.tools import has_tools, load_tools
        from highside.reading import read_toml
    report_omitted("codec", faults())
    if "plan" in read_toml(config):
        _check_bench(config, overrides, as_json)
        return
    every = load_tools(config, overrides) if has_tools(config) else (load(config, overrides),)
    for settings in every:
        _check_tool(config, settings, quiet=as_json)
    if as_json:
        shown = [settings.model_dump_json() for settings in every]
        echo_json(f"[{','.join(shown)}]" if has_tools(config) else shown[0])


def _check_tool(config: Path, settings: Settings, *, quiet: bool) -> None:
    from highside.service.broker_client import check_secrets
    from highside.service.in_force import compensation_of

    settings.codec.build()
    check_secrets(settings.mqtt)
    cal_id = _calibration_of(settings, config)
    compensation_of(settings)
    if quiet:
        return
    echo(
        _(
            "%(file)s: good. Tool %(tool)s, link %(link)s, codec %(codec)s, calibration %(calibration)s, broker"
            " %(broker)s",
            file=config,
            tool=settings.tool.id,
            link=settings.link.kind,
            codec=settings.codec.name,
            calibration=cal_id,
            broker=f"{settings.mqtt.host}:{settings.mqtt.port}",
        )
    )
    if settings.drift.model_fields_set and settings.drift.enabled and settings.site.latitude_deg is None:
        echo(_("note: [drift] without site.latitude_deg: the Earth's rotation (15 deg/h) counts as gyro bias"))


def _check_bench(config: Path, overrides: list[str] | None, as_json: bool) -> None:
    """The file of `calibrate bench`: all that would refuse the session at its start, its limits too."""
    from highside.bench.setup import judged_by
    from highside.bench.store import BenchStore
    from highside.config.bench import load_bench
    from highside.service.broker_client import check_secrets

    settings = load_bench(config, overrides)
    settings.codec.build()
    if settings.mqtt is not None:
        check_secrets(settings.mqtt)
    settings.web.check()
    try:
        judged_by(settings)
        BenchStore.of(settings.store, settings.tool.serial)  # its signing key
    except InputError as error:
        if error.where is not None:
            raise
        raise InputError(error.what, where=str(config), field=error.field, remedy=error.remedy) from None
    if as_json:
        echo_json(settings.model_dump_json())
        return
    source = "simulated" if settings.link is None else settings.link.kind
    scheme = "http" if settings.web.tls is None else "https"
    echo(
        _(
            "%(file)s: good. A bench session: tool %(tool)s, link %(link)s, plan %(plan)s, page %(page)s",
            file=config,
            tool=settings.tool.id,
            link=source,
            plan=settings.plan.kind,
            page=f"{scheme}://{settings.web.host}:{settings.web.port}",
        )
    )
    if settings.web.warning is not None:
        echo(_("warning: %(what)s", what=told(settings.web.warning, "settings")), err=True)


def _calibration_of(settings: Settings, config: Path) -> str:
    """The calibration that would be in force. A tool that was never calibrated is reported and may run.

    Raises RecordError for one that is refused, InputError naming the field for a place where there is none.
    """
    from highside.calibration.record import RecordError, RecordReason
    from highside.service.in_force import configured_calibration
    from highside.service.known_time import known_now

    try:
        # that its age cannot be determined is a warning of the log
        return configured_calibration(settings, known_now(settings)).correction.cal_id
    except RecordError as error:
        if error.reason is not RecordReason.NONE_ACTIVE:
            raise
        note = _(
            "note: %(what)s: readings pass uncorrected; run `highside calibrate bench`, put its record in force",
            what=told(error.text, "settings"),
        )
        echo(note, err=True)
        return _("none yet")
    except InputError as error:
        calibration = settings.calibration
        field = "calibration.record" if calibration.record is not None else "calibration.store"
        if error.where == str(calibration.trusted_keys):
            field = "calibration.trusted_keys"
        what = f"{error.where}: {error.what}" if error.where is not None else error.what
        remedy = error.remedy or "fix the path"
        raise InputError(what, where=str(config), field=field, remedy=remedy) from None


def schema(
    config: Annotated[
        bool, typer.Option("--config", help="The JSON Schema of the configuration file, every codec's table in it.")
    ] = False,
    as_asyncapi: Annotated[
        bool, typer.Option("--asyncapi", help="Topics and messages as an AsyncAPI 3 document, those of a bench too.")
    ] = False,
) -> None:
    """Print the JSON Schemas of all MQTT messages as one JSON object."""
    if as_asyncapi:
        from highside.bench.mqtt import SESSION_TOPICS
        from highside.service.topics import SERVICE_TOPICS, asyncapi

        if config:
            raise InputError(
                "is for the messages, --config for the configuration", field="--asyncapi", remedy="give one"
            )
        echo_json(json.dumps(asyncapi((*SERVICE_TOPICS, *SESSION_TOPICS)), indent=2))
        return
    if config:
        from highside.codec.registry import faults
        from highside.config.tools_schema import config_schema

        report_omitted("codec", faults())
        echo_json(json.dumps(config_schema(), indent=2))
        return
    from highside.service.messages import schemas

    echo_json(json.dumps(schemas(), indent=2))
