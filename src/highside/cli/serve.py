"""`highside serve`: every tool at a broker, in a browser."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.run import SetOption
from highside.cli.say import echo
from highside.errors import InputError


def serve(
    config: Annotated[
        Path | None,
        typer.Option("--config", help="TOML file with [mqtt] and [web]; without one: the broker on this machine."),
    ] = None,
    records: Annotated[
        Path | None, typer.Option("--records", help="Calibration store (a directory) to show: [records] store.")
    ] = None,
    sessions: Annotated[
        Path | None, typer.Option("--sessions", help="Directory of bench sessions to show: [records] sessions.")
    ] = None,
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="Take recordings for a diagnosis from who has the token.")
    ] = False,
    overrides: SetOption = None,
) -> None:
    """Show every tool at a broker in a browser: attitude, alarms, parts, surveys, log; and, where they are named, the
    calibrations of a store and the sessions of a bench; diagnose files. No tool can be commanded."""
    from highside.config.serve import load_serve
    from highside.service.broker_client import check_secrets
    from highside.service.logs import start_logging

    settings = load_serve(config, overrides, records=records, sessions=sessions, diagnose=diagnose)
    check_secrets(settings.mqtt)
    settings.records.check()
    start_logging("warning")
    try:
        from highside.web.tools.server import ToolsPage
    except ModuleNotFoundError as error:
        raise InputError(f"the tools' page needs {error.name}", remedy="pip install 'highside[web]'") from None
    if not settings.web.is_loopback:
        token = ", the token too" if settings.diagnosis.enabled else ""
        clear = "" if settings.web.tls is not None else f", and reads along on the way{token}: give [web.tls]"
        echo(f"warning: [web] host = {settings.web.host!r}: whoever reaches this machine may look{clear}", err=True)

    async def until_ended() -> None:
        page = ToolsPage(settings)
        await page.start()
        if settings.diagnosis.enabled:
            echo(f"with the right to send files for a diagnosis: {page.link}", err=True)
        echo(f"tools page: {page.address}", err=True)
        ending = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            # Windows' event loop has no signal handlers: there Ctrl-C ends it by KeyboardInterrupt
            with contextlib.suppress(NotImplementedError):
                loop.add_signal_handler(number, ending.set)
        try:
            await ending.wait()
        finally:
            await page.stop()

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(until_ended())
