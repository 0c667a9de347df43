"""`highside diagnose`: where a recording departs from the simulation, and what physics was left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from highside.cli.loading import loading
from highside.cli.options import Language, as_options, speaking
from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.api.diagnosis import Diagnosis
    from highside.config.model import Model
    from highside.recording.table import Recording


RecordingOption = Annotated[
    Path | None,
    typer.Argument(help="The Recording or pose table (CSV, optionally gzipped), or with --codec a wire recording."),
]
ModelOption = Annotated[
    Path | None,
    typer.Option("--model", help="Model file (TOML): what the simulation knows; nothing beside the sensor without."),
]
Summary = Annotated[
    Path | None,
    typer.Option("--summary", help="A published error table (CSV) in place of a recording."),
]
CorrectedBy = Annotated[
    str, typer.Option("--corrected-by", help="conventional3, balance-average or none: what the table comes after.")
]
Simulation = Annotated[
    Path | None, typer.Option("--simulation", help="Another program's output (CSV) as the prediction.")
]
Align = Annotated[
    Literal["none", "offset", "auto"],
    typer.Option(
        "--align",
        help="With --simulation: none, both files are of one clock; offset, each has its own zero of time; auto, "
        "one clock where the spans coincide.",
    ),
]
WriteModel = Annotated[Path | None, typer.Option("--write-model", help="Write the model with what was found (TOML).")]
Report = Annotated[
    bool, typer.Option("--report/--no-report", help="Draw report.html; without it diagnosis.json alone is written.")
]

RunByRun = Annotated[
    bool | None,
    typer.Option(
        "--run-by-run/--in-memory",
        help="Never hold the rows of a rotation (Parquet) in the memory, or always; default: from 1.5 million rows on.",
    ),
]

Called = Annotated[
    str | None, typer.Option("--called", metavar="NAME", help="What the report calls the recording; else its file.")
]

Workers = Annotated[
    int | None, typer.Option("--workers", min=1, max=256, help="Runs of rows worked on at the same time; default 2.")
]

ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="dask cluster (tcp://HOST:PORT), seeing TMPDIR, that goes through the rows of a giant rotation (Parquet).",
    ),
]


def diagnose(
    recording: RecordingOption = None,
    model: ModelOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Directory for diagnosis.json and report.html.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the calibration of thresholds.")] = 1,
    summary: Summary = None,
    corrected_by: CorrectedBy = "none",
    stations: Annotated[int, typer.Option("--stations", min=8, help="Toolfaces of a revolution, both ends.")] = 73,
    readings: Annotated[int, typer.Option("--readings", min=1, help="Readings at each station.")] = 4,
    simulation: Simulation = None,
    align: Align = "auto",
    write_model: WriteModel = None,
    codec: Annotated[str | None, typer.Option("--codec", help="Decode a wire recording first.")] = None,
    config: Annotated[Path | None, typer.Option("--config", help="TOML file with a [codec] table.")] = None,
    first_s: Annotated[float | None, typer.Option("--from", help="Only rows from this time on, s.")] = None,
    last_s: Annotated[float | None, typer.Option("--to", help="Only rows up to this time, s.")] = None,
    effects: EffectFolders = None,
    report: Report = True,
    run_by_run: RunByRun = None,
    workers: Workers = None,
    cluster: ClusterOption = None,
    called: Called = None,
    language: Language = None,
) -> None:
    """Say where a recording departs from the simulation, what was left out, and how sure that is."""
    with loading():
        from highside.api import diagnosis as api
        from highside.cli.diagnose_progress import progress_on_terminal
    out = _require_consistent(recording, out, summary, simulation, write_model, align)
    if cluster is not None:
        run_by_run = _spreadable(run_by_run, summary, effects)
    take_in(effects)
    with speaking(language):
        knows = _known(model, alone=simulation is None and summary is None)
    with progress_on_terminal() as progress:
        if summary is not None:
            with as_options("corrected_by"):
                made = api.diagnose_table(
                    summary,
                    knows,
                    corrected_by=corrected_by,
                    stations=stations,
                    readings=readings,
                    seed=seed,
                    progress=progress,
                )
        else:
            assert recording is not None
            rows: Path | Recording = recording
            if any(one is not None for one in (codec, config, first_s, last_s)):
                rows = _rows_of(recording, codec, config, first_s, last_s)
            progress(0.0, recording.name)
            with as_options(run_by_run="--run-by-run" if cluster is None else "--cluster"), _on(cluster):
                made = api.diagnose(
                    rows, knows, simulation=simulation, align=align, seed=seed, run_by_run=run_by_run, threads=workers
                )
    with speaking(language):
        _write_and_tell(made if called is None else replace(made, source=called), out, write_model, report=report)


def _spreadable(run_by_run: bool | None, summary: Path | None, effects: Sequence[Path] | None) -> bool:
    """That rows are read run by run. Raises InputError for what a cluster cannot do."""
    if summary is not None:
        raise _not_for_cluster("an error table has few rows", "--summary")
    if run_by_run is False:
        raise _not_for_cluster("rows that are held in the memory are not given out", "--in-memory")
    if effects:
        raise _not_for_cluster("its processes do not have effects of your own", "--effects")
    return True


def _not_for_cluster(why: str, option: str) -> Exception:
    from highside.errors import InputError

    return InputError(why, field="--cluster", remedy=f"leave {option} or --cluster out")


@contextmanager
def _on(cluster: str | None) -> Iterator[None]:
    """The cluster that goes through the rows, if any."""
    if cluster is None:
        yield
        return
    from highside.fleet.spread import on_cluster

    with on_cluster(cluster):
        yield


def _write_and_tell(made: Diagnosis, out: Path, write_model: Path | None, *, report: bool) -> None:
    """Write what was found, and say it; exit status 1 where the data are bad."""
    from highside.cli.kinds import MODEL_MARK
    from highside.recording.files import write_whole
    from highside.report.diagnosis_lines import lines_of
    from highside.words import _, told

    learnt = made.model_toml() if write_model is not None else None
    made.save(out, report=report)
    for note in made.notes:
        echo(told(note, "diagnosis"))
    for line in lines_of(made.found, made.report_data):
        echo(line)
    if write_model is not None:
        if learnt is not None:
            write_whole(write_model, f"{MODEL_MARK}\n{learnt}".encode())
        else:
            echo(_("%(file)s: not written, since nothing was given a name", file=write_model), err=True)
    if made.found.verdict == "bad_data":
        raise typer.Exit(1)


def _known(model: Path | None, *, alone: bool) -> Model:
    """What is known beforehand; that it is nothing is said of a recording that is compared with no other prediction."""
    from highside.config.model import Model, load_model
    from highside.words import _

    if model is not None:
        return load_model(model)
    if alone:
        echo(_("no --model: nothing is taken as known beside the sensor"), err=True)
    return Model()


def _require_consistent(
    recording: Path | None,
    out: Path | None,
    summary: Path | None,
    simulation: Path | None,
    write_model: Path | None,
    align: str,
) -> Path:
    """The directory to write to. Raises InputError for options that are missing or exclude each other."""
    from highside.errors import InputError

    if (recording is None) == (summary is None):
        raise InputError("give one of them", field="RECORDING, --summary", remedy="a recording or an error table")
    if simulation is not None and (summary is not None or write_model is not None):
        raise InputError(
            "goes with a recording alone",
            field="--simulation",
            remedy="leave --summary and --write-model out: what the other program lacks is for that program to take up",
        )
    if align != "auto" and simulation is None:
        raise InputError("goes with --simulation alone", field="--align", remedy="give the other program's output too")
    if out is None:
        raise InputError("is missing", field="--out", remedy="see highside diagnose --help")
    return out


def _rows_of(
    recording: Path, codec: str | None, config: Path | None, first_s: float | None, last_s: float | None
) -> Recording:
    """The rows wanted, decoded first where a codec is named. Raises InputError."""
    from highside.api import diagnosis as api

    rows: Path | Recording = recording
    if codec is not None or config is not None:
        from highside.cli.decode import decode_recording

        rows = decode_recording(recording, codec, config)
    with as_options(**{"first_s, last_s": "--from, --to"}):
        return api.rows_of(rows, first_s=first_s, last_s=last_s)
