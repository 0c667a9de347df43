"""`highside calibrate sessions`: what was begun on the bench, how far it came, and how to go on with it."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo, echo_json
from highside.printable import printable

if TYPE_CHECKING:
    from highside.bench.driver import BenchDriver
    from highside.bench.journal_file import FoundJournal
    from highside.config.bench import BenchFile

ConfigOption = Annotated[Path, typer.Option("--config", help="TOML file of the session; see config/bench-*.toml.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Override one field: key.path=value. May be repeated.")
]


def sessions(
    config: ConfigOption,
    overrides: SetOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the sessions of a tool on the bench, the newest first: plan, poses taken, and how each stands.

    An unfinished one is gone on with by `highside calibrate bench --config FILE --resume NAME`.
    """
    from highside.bench import journal_file as bench_journal
    from highside.bench.driver import kept_by
    from highside.config.bench import load_bench

    settings = load_bench(config, overrides)
    kept = kept_by(settings.store.directory)
    found = list(bench_journal.sessions(settings.store.sessions, settings.tool.id, kept))
    if as_json:
        echo_json(json.dumps([_plain(one) for one in found]))
        return
    if not found:
        echo(f"no session of tool {settings.tool.id} in {settings.store.sessions}")
        return
    width = max(len(one.name) for one in found)
    for one in found:
        begun = "" if one.t_wall_s is None else _local(one.t_wall_s)
        line = f"{one.name:<{width}}  {begun:<16}  {one.progress:<16}  {one.state:<12}  {one.plan}"
        echo(line.rstrip())


def _plain(one: FoundJournal) -> dict[str, object]:
    return {
        "session": one.name,
        "file": str(one.path),
        "plan": one.plan,
        "begun_s": one.t_wall_s,
        "done": one.done,
        "poses": one.poses,
        "state": one.state,
        "resumable": one.resumable,
    }


def go_on_instead(settings: BenchFile, config: Path, *, ask: bool) -> str | None:
    """The unfinished session to go on with instead of a new one, by its name; None: begin anew.

    Asked on a terminal; elsewhere it is only reported that there is one, and how to go on with it.
    """
    from highside.bench.driver import kept_by
    from highside.bench.journal_file import to_offer

    found = to_offer(settings.store.sessions, settings.tool.id, kept_by(settings.store.directory))
    if found is None:
        return None
    begun = "" if found.t_wall_s is None else f" of {_local(found.t_wall_s)}"
    summary = printable(f"session {found.name}{begun} ({found.plan}) has {found.progress}")
    if ask:
        return found.name if typer.confirm(f"{summary}: go on?", default=True, err=True) else None
    echo(f"{summary} and is left as it is; a new one begins. Go on with it: {_command(config, found.name)}", err=True)
    return None


def left_unfinished(driver: BenchDriver, config: Path) -> None:
    """What somebody reads who has ended the program before the session was over."""
    state, ledger = driver.session.state, driver.session.ledger
    if state.ended or driver.journal_path is None:
        return
    name = driver.session.header.session
    count = len(ledger.done)
    if not count:
        echo("\nno pose was taken: begin anew", err=True)
        return
    poses = "1 pose is" if count == 1 else f"{count} poses are"
    echo(f"\n{poses} kept. Go on: {_command(config, name)}", err=True)


def _local(t_wall_s: float) -> str:
    return f"{datetime.fromtimestamp(t_wall_s, UTC).astimezone():%Y-%m-%d %H:%M}"


def _command(config: Path, name: str) -> str:
    return printable(f"highside calibrate bench --config {config} --resume {name}")
