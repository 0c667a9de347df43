"""`highside calibrate bench`: a guided calibration session, at the terminal and for all other faces."""

from __future__ import annotations

import asyncio
import getpass
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.bench_sessions import go_on_instead, left_unfinished
from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo, echo_json
from highside.errors import InputError

if TYPE_CHECKING:
    from highside.bench.driver import BenchDriver
    from highside.cli.bench_face import PlainFace, RichFace
    from highside.config.bench import BenchFile, StoreTable
    from highside.web.server import BenchPage

ConfigOption = Annotated[Path, typer.Option("--config", help="TOML file of the session; see config/bench-*.toml.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Override one field: key.path=value. May be repeated.")
]
LOOK_S = 0.05
FAREWELLS_S = 10.0
"""Longer than any face takes to say goodbye."""


def bench(
    config: ConfigOption,
    which: Annotated[
        str | None, typer.Argument(metavar="[SESSION]", help="With --resume: which one, if not the newest.")
    ] = None,
    overrides: SetOption = None,
    web: Annotated[bool, typer.Option("--web", help="Serve the bench page as well.")] = False,
    auto: Annotated[
        bool, typer.Option("--auto", help="A simulated operator does everything ([simulated] only).")
    ] = False,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Go on with SESSION, or with the newest that has poses and has not ended (`calibrate sessions`).",
        ),
    ] = False,
    plain: Annotated[
        bool, typer.Option("--plain", help="Lines instead of a live picture, for serial consoles.")
    ] = False,
    plan_of: Annotated[
        Path | None, typer.Option("--plan-of", help="Take [plan] from this other file of a session.")
    ] = None,
    operator: Annotated[str | None, typer.Option(help="Your name, for the record.")] = None,
    effects: EffectFolders = None,
) -> None:
    """Walk through a calibration session on the bench, or one that judges a calibration.

    Exit 1: it ended without a result that was accepted, or with a verdict other than pass.
    """
    from highside.bench.driver import BenchDriver
    from highside.config.bench import load_bench
    from highside.service.logs import start_logging

    settings = load_bench(config, overrides, plan_of=plan_of)
    start_logging("warning")
    _prepare(config, settings, effects, auto=auto)
    if which is not None and not resume:
        raise InputError(f"{which!r} names a session to go on with", field="SESSION", remedy=f"--resume {which}")
    who = operator or ("simulated" if auto else getpass.getuser())
    if not resume:
        which = go_on_instead(settings, config, ask=not auto and sys.stdin.isatty() and sys.stderr.isatty())
        resume = which is not None
    # a terminal's Ctrl-C may come before there is one
    begun: list[BenchDriver] = []

    async def session() -> BenchDriver:
        driver = BenchDriver.go_on(settings, which) if resume else BenchDriver.begin(settings, operator=who)
        begun.append(driver)
        await _run(driver, auto=auto, web=web, plain=plain or not sys.stdout.isatty(), operator=who)
        return driver

    try:
        driver = asyncio.run(session())
    except KeyboardInterrupt:
        for one in begun:
            left_unfinished(one, config)
        raise
    _conclude(driver, auto=auto)


def _conclude(driver: BenchDriver, *, auto: bool) -> None:
    """Say what a session ended with. Raises typer.Exit (1) for what scripts must see."""
    from highside.bench.session.outcome import verdict_of
    from highside.bench.session.snapshot import SessionState

    verdict = None if driver.session.solved is None else verdict_of(driver.session.solved)
    if auto:
        echo_json(json.dumps(summary(driver)))
    elif driver.stored is not None:
        echo(f"record {driver.stored}")
    if driver.session.state is not SessionState.ACCEPTED or verdict not in (None, "pass"):
        raise typer.Exit(1)


def _prepare(config: Path, settings: BenchFile, effects: Sequence[Path] | None, *, auto: bool) -> None:
    """What comes before a session. Raises InputError for a bench that cannot be operated by itself as `auto` says."""
    if settings.bench.model is not None:
        take_in(effects)
    _note_sessions_elsewhere(config, settings.store)
    if auto and settings.simulated is None:
        raise InputError(
            "is not there, and only a simulated bench can be operated by itself",
            where=str(config),
            field="simulated",
            remedy="leave --auto out, or use config/bench-simulated.toml",
        )


def _note_sessions_elsewhere(config: Path, store: StoreTable) -> None:
    """Earlier versions kept sessions and records beside the configuration file: they are not lost without a word."""
    from highside.config import places

    beside = config.resolve().parent / "state"
    for field, now, default in (
        ("sessions", store.sessions, places.sessions()),
        ("directory", store.directory, places.calibrations()),
    ):
        left = places.left_behind(beside / default.name, now, f"store.{field}") if now == default else None
        if left is not None:
            echo(f"highside: {left}", err=True)


async def _run(driver: BenchDriver, *, auto: bool, web: bool, plain: bool, operator: str) -> None:
    """The session and its faces, until it has ended."""
    from highside.cli.bench_face import PlainFace, RichFace
    from highside.service.tasks import ended

    page = await _page(driver, operator) if web else None
    face = PlainFace(driver, operator) if plain else RichFace(driver, operator)
    tasks = [asyncio.create_task(face.run())]
    if not auto:
        alone = page is None and driver.settings.mqtt is None
        tasks.append(asyncio.create_task(_typed(face, alone=alone)))
    if driver.settings.mqtt is not None:
        from highside.bench.mqtt import SessionMqtt

        at_broker = SessionMqtt(driver, driver.settings.mqtt, tool_id=driver.settings.tool.id)
        tasks.append(asyncio.create_task(at_broker.run()))
    if driver.bench is not None:
        tasks.append(asyncio.create_task(_operate(driver, commands=auto)))
    # who looks on from elsewhere may still want the report, the certificate, or the calibration in force
    stay = not auto and (page is not None or driver.settings.mqtt is not None)
    running = asyncio.create_task(driver.run(stay=stay))
    announcer = asyncio.create_task(_announce_end(driver, face, page is not None, stay))
    try:
        # the first to end is the session itself, or the fault of a face
        while not running.done():
            done, _ = await asyncio.wait({running, *tasks}, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                if task is not running:
                    tasks.remove(task)
                    await task
    except asyncio.CancelledError:
        if not (stay and driver.ended.is_set()):
            raise
    finally:
        await ended(announcer, *tasks, running, again_s=FAREWELLS_S)
        if page is not None:
            await page.stop()
    if not running.cancelled():
        await running


async def _typed(face: PlainFace | RichFace, *, alone: bool) -> None:
    """What is typed at the terminal, to the end of the input. Raises InputError where nothing can command the session:
    it would wait for ever."""
    typed = await face.typed()
    if not alone:
        return
    if not typed:
        raise InputError(
            "has ended, and nothing else commands this session",
            where="standard input",
            remedy="sit at a terminal, serve the page (--web) or name a broker ([mqtt])",
        )
    face.say("the input has ended: nothing more can be typed here; Ctrl-C ends the session, which is kept")


async def _page(driver: BenchDriver, operator: str) -> BenchPage:
    """The bench page, listening. Raises InputError where the extra is not installed or the address is taken."""
    from highside.config.certificate import load_certificate_fields

    try:
        from highside.web.server import BenchPage
    except ImportError as error:
        raise InputError(f"the bench page needs {error.name}", remedy="pip install 'highside[web]'") from None
    table = driver.settings.web
    fields = None if table.certificate is None else load_certificate_fields(table.certificate)
    page = BenchPage(driver, table, operator=operator, fields=fields)
    await page.start()
    if table.warning is not None:
        echo(f"warning: {table.warning}", err=True)
    echo(f"bench page: {page.link}", err=True)
    _show_way_to_phone(page.link_elsewhere)
    return page


def _show_way_to_phone(link: str | None) -> None:
    """Where others reach the page; a terminal shows it as a code, too."""
    if link is None:
        return
    echo(f"from a phone: {link}", err=True)
    if sys.stderr.isatty():
        from highside.web.phone import qr_text

        echo(qr_text(link), err=True)


async def _announce_end(driver: BenchDriver, face: PlainFace | RichFace, page: bool, stay: bool) -> None:
    """What stays until Ctrl-C."""
    await driver.ended.wait()
    if not stay:
        return
    what = "the bench page stays" if page else "commands at the broker are answered"
    face.say(f"the session is over; {what} until Ctrl-C")


async def _operate(driver: BenchDriver, *, commands: bool) -> None:
    """The simulated operator at the simulated bench; without `commands` only the hands that turn the table."""
    from highside.bench.setup import habits_of
    from highside.bench.simulated_operator import SimulatedOperator

    table = driver.settings.simulated
    if table is None or driver.bench is None:
        return
    person = SimulatedOperator(driver.bench, habits_of(table))
    while not driver.session.state.ended:
        for command in person.look(driver.snapshot()):
            if commands:
                await driver.command(command)
        await asyncio.sleep(max(0.005, LOOK_S * min(1.0, 10.0 / table.speed)))


def summary(driver: BenchDriver) -> dict[str, Any]:
    """The line of JSON that `--auto` ends with; errors are those against the simulated truth. A session that judges a
    calibration has its id and the verdict beside."""
    from highside.bench.session.outcome import errors_against, verdict_of

    session = driver.session
    record, solved = session.record, session.solved
    errors: tuple[float | None, float | None] = (None, None)
    if record is not None and driver.bench is not None:
        temp = session.ledger.mean_temp_c()
        offset = driver.bench.true_offset(driver.bench.bench.temp_c if temp is None else temp)
        errors = errors_against(record, driver.bench.settings.matrix, offset, temp)
    judged = session.plan.criterion
    verdict = None if solved is None or judged is None else {"verdict": verdict_of(solved), "judged": judged.record}
    return (verdict or {}) | {
        "record": None if driver.stored is None else str(driver.stored),
        "inc_error_deg": errors[0],
        "tf_error_deg": errors[1],
        "inc_std_deg": None if solved is None else solved.inc_std_deg,
        "tf_std_deg": None if solved is None else solved.tf_std_deg,
        "poses": len(session.ledger.done),
        "retaken": session.ledger.retaken,
    }
