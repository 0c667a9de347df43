"""`highside reproduce`: the papers' tables beside ours."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from highside.cli.say import echo, echo_json

app = typer.Typer(name="reproduce", no_args_is_help=True, help="The papers' tables beside ours.")


@app.callback()
def _group() -> None:
    """The papers' tables beside ours."""


def _make(folder: Path) -> None:
    """Make a folder if it is not there. Raises InputError."""
    from highside.errors import InputError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made a folder: {error.strerror}", where=str(folder), field="-o") from None


def _folder(output: Path | None, name: str, *, as_json: bool) -> Path | None:
    """Where page and numbers of a paper go, made if it is not there; None where JSON alone is wanted. Raises
    InputError."""
    from highside.report.plots import need_plots

    folder = output if output is not None or as_json else Path(f"reproduce-{name}")
    if folder is not None:
        need_plots()
        _make(folder)
    return folder


def _write(folder: Path, name: str, page: str, result: dict[str, Any]) -> None:
    """Write `name`.html and `name`.json into a folder."""
    from highside.recording.files import write_whole

    write_whole(folder / f"{name}.html", page.encode())
    write_whole(folder / f"{name}.json", (json.dumps(result, indent=1) + "\n").encode())


@app.command()
def balance(
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for balance.html and balance.json.")
    ] = None,
) -> None:
    """Tables 1 to 6 and figures 1 to 7 of the balance paper: what its table 1 alone predicts of the others.

    The instrument is found from table 1, as `diagnose --summary` does it, and predicts tables 2 to 6 and all figures
    with 95 % intervals; which it predicts and which not is said (about half a minute). Without --json the page and the
    numbers are written to a folder (reproduce-balance, if -o names no other).
    """
    from highside.cli.diagnose_progress import progress_on_terminal
    from highside.papers import balance_triples, published_instrument
    from highside.papers.reproduce_balance import reproduce
    from highside.papers.reproduce_balance_json import as_dict

    folder = _folder(output, "balance", as_json=as_json)
    with progress_on_terminal() as progress:
        instrument = published_instrument.find(published_instrument.published(), progress=progress)
        progress(0.95, "figures and statements")
        found = reproduce(instrument)
        result = {"schema": "highside.reproduce-balance/1"} | as_dict(found)
        if folder is not None:
            from highside.papers.reproduce_balance_page import page_of

            _write(folder, "balance", page_of(found), result)
    if as_json:
        echo_json(json.dumps(result))
        return
    echo("The published instrument, from table 1 alone")
    for line in published_instrument.in_words(instrument):
        echo(f"  {line}")
    echo("\nTables 2 to 6, not used by the fit")
    echo(f"  {published_instrument.coverage_in_words(instrument)}")
    for table, *words in published_instrument.verdicts(instrument):
        columns = zip(published_instrument.TITLES.values(), words, strict=True)
        echo(f"  {table}: " + "; ".join(f"{name} {verdict}" for name, verdict in columns))
    for line in published_instrument.outside_in_words(instrument):
        echo(f"  {line}")
    echo("\nThe mean toolface of single triples")
    for line in balance_triples.in_words(instrument.triples, instrument.found.noise_g):
        echo(f"  {line}")
    echo("\nWhere the paper's model and the measurements part")
    for statement in result["statements"]:
        echo(f"{statement['topic']}\n  the paper says   {statement['paper_says']}")
        echo(f"  its own tables   {statement['published']}\n  predicted        {statement['predicted']}")
        echo(f"  why              {statement['reason']}\n")
    echo(f"Tables and figures: {folder}/balance.html")


@app.command()
def rotation(
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for rotation.html and rotation.json.")
    ] = None,
) -> None:
    """Tables 1 to 3 and figures 5 to 10 of the rotor-angle paper in kind, from simulated rotors, and ours beside them.

    Without --json the page and the numbers are written to a folder (reproduce-rotation, if -o names no other).
    """
    from highside.papers.reproduce_rotation import as_dict, page_of, run_experiment

    folder = _folder(output, "rotation", as_json=as_json)
    experiment = run_experiment()
    result = {"schema": "highside.reproduce-rotation/1"} | as_dict(experiment)
    if folder is not None:
        page = page_of(experiment)
        _write(folder, "rotation", page, result)
    if as_json:
        echo_json(json.dumps(result))
        return
    for statement in result["statements"]:
        echo(f"{statement['topic']}\n  the paper says  {statement['paper_says']}")
        echo(f"  these rotors    {statement['ours']}\n  why             {statement['reason']}\n")
    echo(f"Tables and figures: {folder}/rotation.html")


@app.command()
def drift(
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder for drift.html and drift.json.")] = None,
) -> None:
    """The three experiments of the gravity-quaternion paper, simulated: its drifts beside those of every method.

    Filters of others (extra `rivals`) run on the same readings. Takes some minutes. Without --json the page and the
    numbers are written to a folder (reproduce-drift, if -o names no other).
    """
    from highside.papers.reproduce_drift import as_dict, run_study

    folder = _folder(output, "drift", as_json=as_json)
    study = run_study()
    result = as_dict(study)
    if folder is not None:
        from highside.papers.reproduce_drift_page import page_of

        page = page_of(study)
        _write(folder, "drift", page, result)
    if as_json:
        echo_json(json.dumps(result))
        return
    for experiment in result["experiments"]:
        paper = {
            angle: f"{pair['before']} -> {pair['after']}" if pair else "not given"
            for angle, pair in experiment["paper_deg_per_hour"].items()
        }
        echo(f"{experiment['experiment']}, deg/h (inclination, toolface, azimuth)")
        echo(f"  the paper: {paper['inc']}, {paper['tf']}, {paper['azi']}")
        echo(f"  least azimuth drift on average by theory: {experiment['azimuth_bound_deg_per_hour']:.3f}")
        for row in experiment["methods"]:
            drifts = ", ".join(f"{row[f'{angle}_deg_per_hour']:.3f}" for angle in ("inc", "tf", "azi"))
            echo(f"  {row['method']}: {drifts}")
        echo("")
    echo(f"Tables, figures and assumptions: {folder}/drift.html")
