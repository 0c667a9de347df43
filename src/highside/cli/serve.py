"""`highside serve`: every tool at a broker, in a browser."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.run import SetOption
from highside.cli.say import echo
from highside.errors import InputError

if TYPE_CHECKING:
    from highside.config.serve import ServeFile
    from highside.web.tools.server import ToolsPage


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
    users: Annotated[
        Path | None,
        typer.Option("--users", help="File of users (`highside users`): everybody signs in. [web] users."),
    ] = None,
    bench: Annotated[
        Path | None,
        typer.Option("--bench", help="Directory of session files: sessions may be begun by who has the token."),
    ] = None,
    settings_file: Annotated[
        Path | None,
        typer.Option("--settings", help="Configuration of `highside run` to show and edit; needs --users."),
    ] = None,
    overrides: SetOption = None,
) -> None:
    """Show every tool at a broker in a browser: attitude, alarms, parts, surveys, log; and, where they are named, the
    calibrations of a store and the sessions of a bench; diagnose files, begin bench sessions."""
    from highside.config.serve import load_serve
    from highside.service.broker_client import check_secrets
    from highside.service.logs import start_logging

    settings = load_serve(
        config,
        overrides,
        records=records,
        sessions=sessions,
        diagnose=diagnose,
        users=users,
        bench=bench,
        settings=settings_file,
    )
    check_secrets(settings.mqtt)
    settings.check()
    start_logging("warning")
    try:
        from highside.web.tools.server import ToolsPage
    except ModuleNotFoundError as error:
        raise InputError(f"the tools' page needs {error.name}", remedy="pip install 'highside[web]'") from None
    _warn(settings)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_until_ended(ToolsPage(settings), settings))


async def _until_ended(page: ToolsPage, settings: ServeFile) -> None:
    """Serve until somebody ends it."""
    await page.start()
    _say_rights(settings, page.link)
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


def _warn(settings: ServeFile) -> None:
    """What whoever starts it should know of a page that other machines reach."""
    if settings.web.is_loopback:
        return
    clear = "" if settings.web.is_https else ", and reads along on the way{}: give [web.tls]"
    if settings.web.users is None:
        token = ", the token too" if settings.diagnosis.enabled or settings.bench.folder is not None else ""
        text = f"whoever reaches this machine may look{clear.format(token)}"
    elif clear:
        text = "whoever listens on the way reads passwords: give [web.tls]"
    else:
        return
    echo(f"warning: [web] host = {settings.web.host!r}: {text}", err=True)


def _say_rights(settings: ServeFile, link: str) -> None:
    """The link with the token, where it opens something; people sign in instead."""
    rights = ["send files for a diagnosis"] if settings.diagnosis.enabled else []
    rights += ["begin bench sessions"] if settings.bench.folder is not None else []
    if rights and settings.web.users is None:
        echo(f"with the right to {' and to '.join(rights)}: {link}", err=True)
