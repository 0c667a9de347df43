"""`highside fleet ...`: a job on all recordings of a catalogue, and what the tools of a lot have in common."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.options import Language, PrintLanguage, speaking
from highside.cli.say import echo, echo_json

if TYPE_CHECKING:
    from highside.fleet.run import Finished

app = typer.Typer(
    name="fleet", no_args_is_help=True, help="Many recordings: on all processors or a cluster, and what they share."
)

Catalogue = Annotated[
    str,
    typer.Argument(
        metavar="CATALOGUE",
        help="CSV or Parquet with a row a recording (uri, tool, lot, model, ...), a folder, or a pattern of names.",
    ),
]
Out = Annotated[Path, typer.Option("--out", help="Folder of the results; what is there is not computed again.")]
Workers = Annotated[int | None, typer.Option("--workers", min=1, max=1024, help="Processes; one a processor.")]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="Address of a dask cluster (tcp://HOST:PORT), in place of processes.")
]
Dashboard = Annotated[
    bool | None,
    typer.Option(
        "--dashboard/--no-dashboard",
        help="Dask's page of what the processes do; unasked where it takes them more than a minute.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print as JSON.")]


@app.command("diagnose")
def diagnose_command(
    catalogue: Catalogue,
    out: Out,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model file (TOML) of recordings that name none of their own.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the calibration of thresholds.")] = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    dashboard: Dashboard = None,
    language: PrintLanguage = None,
    as_json: Json = False,
) -> None:
    """Diagnose every recording; each row keeps what pooling needs."""
    with speaking(language):
        text = "" if model is None else _model_text(model)
        _run("diagnose", catalogue, out, workers, scheduler, dashboard, as_json, model=text, seed=seed)


@app.command("solve")
def solve_command(
    catalogue: Catalogue,
    out: Out,
    method: Annotated[str, typer.Option("--method", help="As of calibrate solve.")] = "joint",
    workers: Workers = None,
    scheduler: Scheduler = None,
    dashboard: Dashboard = None,
    language: PrintLanguage = None,
    as_json: Json = False,
) -> None:
    """Solve every pose table to a calibration record."""
    with speaking(language):
        _run("solve", catalogue, out, workers, scheduler, dashboard, as_json, method=method)


@app.command("drift")
def drift_command(
    catalogue: Catalogue,
    out: Out,
    method: Annotated[str, typer.Option("--method", help="As of drift.")] = "kinematic",
    workers: Workers = None,
    scheduler: Scheduler = None,
    dashboard: Dashboard = None,
    language: PrintLanguage = None,
    as_json: Json = False,
) -> None:
    """Follow the attitude of every recording by gyros and gravity."""
    with speaking(language):
        _run("drift", catalogue, out, workers, scheduler, dashboard, as_json, method=method)


@app.command("summary")
def summary_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results of fleet diagnose.")],
    by: Annotated[
        str, typer.Option("--by", help="Column of the catalogue that makes the lots; month: of its column date.")
    ] = "lot",
    order: Annotated[
        str | None, typer.Option("--order", help="Column along which a change is looked for (a serial number, a date).")
    ] = None,
    html: Annotated[Path | None, typer.Option("--html", help="Report to write.")] = None,
    language: Language = None,
    as_json: Json = False,
) -> None:
    """Say what physics the tools of a lot share, and which tools stand out."""
    from highside.fleet.page import page_of, sentence_of
    from highside.fleet.parts import PartStore
    from highside.fleet.summary import summarise
    from highside.recording.files import write_whole

    with speaking(language):
        found = summarise(PartStore.existing(folder), by=by, order=order)
        if html is not None:
            write_whole(html, page_of(found, folder.resolve().name).encode())
        if as_json:
            echo_json(json.dumps(found.to_dict(), indent=1))
            return
        echo(sentence_of(found))
        for line in _lines_of(found.to_dict()):
            echo(line)


def _lines_of(found: dict[str, Any]) -> Iterator[str]:
    """What a lot has in common, which tools stand out, and which lots are not judged."""
    from highside.words import _, told

    either = _(" or ")
    for one in found["common"]:
        yield _(
            "lot %(lot)s: %(names)s: %(parameter)s = %(value)s +- %(std)s %(unit)s (%(tools)s tools, q = %(q)s)",
            lot=one["lot"],
            names=either.join(one["class"]),
            parameter=one["parameter"],
            value=f"{one['value']:.3g}",
            std=f"{one['std']:.2g}",
            unit=one["unit"],
            tools=one["tools"],
            q=f"{one['q']:.1g}",
        )
    for outlier in found["outliers"]:
        names = either.join(outlier["class"])
        yield _(
            "tool %(tool)s of lot %(lot)s stands out: %(names)s", tool=outlier["tool"], lot=outlier["lot"], names=names
        )
    for lot in found["not_testable"]:
        yield _("lot %(lot)s is not judged: %(why)s", lot=lot["lot"] or "-", why=told(lot["why"]))


@app.command("records")
def records_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of calibration records (a store).")],
    limit_deg: Annotated[
        float, typer.Option("--limit-deg", help="Of the direction of gravity, k = 2: at which a calibration is due.")
    ] = 0.1,
    html: Annotated[Path | None, typer.Option("--html", help="Report to write.")] = None,
    language: Language = None,
    as_json: Json = False,
) -> None:
    """Say how fast sensors wander from calibration to calibration, which departed, and when the next is due."""
    from highside.errors import InputError
    from highside.fleet.records import page_of_records, read_history, sentence_of_records, to_dict
    from highside.recording.files import write_whole
    from highside.words import _, told

    with speaking(language):
        if not 0.0 < limit_deg < 90.0:
            raise InputError(f"{limit_deg:g} is no limit", field="--limit-deg", remedy="between 0 and 90")
        if not folder.is_dir():
            raise InputError("is not a folder", where=str(folder), field="DIR", remedy="name the folder of a store")
        found, omitted = read_history(folder, limit_deg)
        if html is not None:
            write_whole(html, page_of_records(found, omitted, folder.resolve().name).encode())
        if as_json:
            echo_json(json.dumps(to_dict(found, omitted), indent=1))
            return
        echo(sentence_of_records(found))
        for tool in to_dict(found, omitted)["tools"]:
            for one in tool["departures"]:
                echo(
                    _(
                        "tool %(tool)s: %(parameter)s moved by %(change)s %(unit)s until %(at)s",
                        tool=tool["tool"],
                        parameter=one["parameter"],
                        change=f"{one['change']:.3g}",
                        unit=one["unit"],
                        at=one["at"],
                    )
                )
        for path, why in omitted.items():
            echo("  " + _("%(file)s is left out: %(why)s", file=path, why=told(why, "commands")), err=True)


def _model_text(model: Path) -> str:
    """The model file's text, checked. Raises InputError."""
    from highside.config.model import load_model
    from highside.reading import decode_text, read_document

    load_model(model)
    return decode_text(read_document(model), where=str(model), expected="TOML")


@app.command("archive")
def archive_command(
    out: Annotated[Path, typer.Option("--out", help="Folder of the archive: KIND/DATE/*.parquet.")],
    host: Annotated[str, typer.Option("--host", help="The broker.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65_535)] = 1883,
    prefix: Annotated[str, typer.Option("--prefix", help="Topics: PREFIX/TOOL/attitude.")] = "highside",
    name: Annotated[str, typer.Option("--name", help="Client id: the broker keeps for it what comes meanwhile.")] = (
        "highside-archive"
    ),
    user: Annotated[str | None, typer.Option("--user")] = None,
    password_file: Annotated[Path | None, typer.Option("--password-file")] = None,
    ca: Annotated[Path | None, typer.Option("--ca", help="Certificates by which the broker is known (TLS).")] = None,
    every_s: Annotated[float, typer.Option("--every", min=0.1, help="Seconds of one part.")] = 60.0,
) -> None:
    """Keep the attitudes and surveys that tools publish as Parquet: each is acknowledged when it is on the disk."""
    import signal
    import threading

    from highside.config.mqtt import password_in
    from highside.fleet.archive import Archive, Broker, follow

    password = None if password_file is None else password_in(password_file, "--password-file")
    archive, ending = Archive(out), threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ending.set())
    follow(Broker(host, port, prefix, name, user, password, ca), archive, every_s, ending.is_set)
    echo(f"{out}: {archive.kept} messages kept, {archive.damaged} damaged")


def _run(
    job: str,
    catalogue: str,
    out: Path,
    workers: int | None,
    scheduler: str | None,
    dashboard: bool | None,
    as_json: bool,
    *,
    model: str = "",
    seed: int = 1,
    method: str = "",
) -> None:
    from highside.fleet.catalogue import catalogue_of
    from highside.fleet.jobs import Order
    from highside.fleet.parts import PartStore
    from highside.fleet.run import run

    entries = catalogue_of(catalogue)
    store = PartStore(out)
    with _progress(job) as progress:
        finished = run(
            entries,
            Order(job, model, seed, method),
            store,
            workers=workers,
            scheduler=scheduler,
            dashboard=dashboard,
            progress=progress,
        )
    _show(finished, out, as_json)
    if any(one.error for one in finished.outcomes):
        # the others are done; a script must see that not all are
        raise typer.Exit(1)


@contextmanager
def _progress(job: str) -> Iterator[Callable[[int, int, str], None]]:
    """Shares done, on the terminal where there is one; the address of the dashboard once."""
    from highside.cli.diagnose_progress import progress_on_terminal
    from highside.words import _

    said: list[str] = []
    with progress_on_terminal() as show:

        def report(done: int, total: int, dashboard: str) -> None:
            if dashboard and not said:
                echo(_("dashboard: %(address)s", address=dashboard), err=True)
                said.append(dashboard)
            show(done / total if total else 0.0, _("%(job)s: %(done)s of %(total)s", job=job, done=done, total=total))

        yield report


def _show(finished: Finished, out: Path, as_json: bool) -> None:
    computed = [one for one in finished.outcomes if one.computed]
    failed = [one for one in finished.outcomes if one.error]
    counts = {
        "recordings": len(finished.outcomes),
        "computed": len(computed),
        "there_already": sum(one.key is not None and not one.computed for one in finished.outcomes),
        "failed": len(failed),
    }
    if as_json:
        echo_json(json.dumps({**counts, "errors": [{"uri": one.uri, "error": one.error} for one in failed]}, indent=1))
        return
    from highside.words import _, told

    echo(
        _(
            "%(folder)s: %(recordings)s recordings, %(computed)s computed, %(there_already)s there already,"
            " %(failed)s failed",
            folder=out,
            **counts,
        )
    )
    for one in failed:
        echo(f"  {one.uri}: {told(one.error or '', 'commands')}", err=True)
