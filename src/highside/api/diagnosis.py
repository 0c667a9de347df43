"""Diagnosis: where a recording departs from the simulation, what physics was left out, and how sure that is."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from highside.api.bench import ModelLike, model_of
from highside.arrays import Array
from highside.config.model import Model, as_toml
from highside.diagnosis.core.chunks import on_threads
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import Claim, DiagnosisResult, Finding, Fit, Location, Remainder, Verdict
from highside.diagnosis.law_answers import laws_of
from highside.diagnosis.recording import ACCELEROMETERS, GYROS, Request, diagnose_columns, rotates
from highside.errors import InputError
from highside.physics.effects import all_effects
from highside.physics.noise import std_of_average
from highside.physics.plan import Site
from highside.recording.files import write_folder
from highside.recording.frames import Columns, File, FrameT, take
from highside.recording.long import MANY_ROWS, LongRecording, long_recording
from highside.recording.of_another import of_another
from highside.recording.table import Recording, SummaryTable, Table
from highside.report.diagnosis_claims import claim_size
from highside.report.diagnosis_words import verdict_words
from highside.shown.card import card
from highside.shown.plot import Plot
from highside.version import __version__
from highside.words.said import said

if TYPE_CHECKING:
    from highside.diagnosis.simulation.alignment import Align
    from highside.diagnosis.table.engine import SummaryReportData

__all__ = ["Diagnosis", "diagnose", "diagnose_table", "rows_of"]

NEEDED = ("t_s", "inc_ref_deg", "tf_ref_deg", "rotor_deg", *ACCELEROMETERS, *GYROS)
"""what a row of a rotation must have to be used, where the column is there at all"""
MINUTE_S = 60.0
"""the poses of a table without times are taken to be so far apart"""
CONCLUSIVE = frozenset({"named", "named_plus", "law", "nothing_left_out"})
"""verdicts of which a model can be made: names, laws, or that none is missing"""


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and what was known before."""

    found: DiagnosisResult
    """the answer as `diagnosis.json` has it"""
    report_data: ReportData | SummaryReportData | None
    """the residuals that a report draws; None for data that could not be judged"""
    before: Model
    """the model against which it was diagnosed"""
    source: str
    """name of the recording"""
    notes: tuple[str, ...] = ()
    """what was done with the recording before"""

    @property
    def verdict(self) -> Verdict:
        """In one word: `named`, `nothing_left_out`, `unknown`, `bad_data`, ..."""
        return self.found.verdict

    @property
    def claims(self) -> tuple[Claim, ...]:
        """The effects that were left out of the model, with sizes, intervals and what they cannot be distinguished
        from."""
        return self.found.claims

    @property
    def location(self) -> tuple[Location, ...]:
        """Where the mismatch sits: channels, and the covariate that it follows."""
        return self.found.location

    @property
    def fit(self) -> Fit | None:
        """How much the claims improve the fit, on data that it was not fitted to too."""
        return self.found.fit

    @property
    def intake(self) -> tuple[Finding, ...]:
        """Faults of the data themselves."""
        return self.found.intake

    @property
    def remainder(self) -> Remainder:
        """What no claim explains."""
        return self.found.remainder

    def to_dict(self) -> dict[str, Any]:
        """What `diagnosis.json` holds: plain values; numbers that are not finite are None."""
        return self.found.to_dict()

    def html(self) -> str:
        """The report as one HTML page that needs nothing beside it; without the chart to zoom and hover in where Bokeh
        (extra `notebook`) is not installed."""
        from highside.report.diagnosis_page import page_of

        return page_of(self.found, self.report_data, self.source)

    def model(self) -> Model | None:
        """The model with the claimed effects at their fitted values; None where the verdict names nothing.

        Parameters of an effect that a claim says nothing of stay as the model has them. A value that is beyond its
        plausible range by less than its error is kept, with `implausible = true`. It is a model of the next recording:
        what set in during this one and stays (a law, a step of the zero offset) acts from the start; `claims` say since
        when it acted here.
        """
        if self.verdict not in CONCLUSIVE:
            return None
        known = self.before.forward().parameters()
        claimed = {
            claim.effect: known.get(claim.effect, {})
            | {name: p.value for name, p in claim.parameters.items()}
            | dict(all_effects()[claim.effect].lasting)
            for claim in self.claims
            if claim.law is None
        }
        made = self.before.with_effects(claimed, as_found=True) if claimed else self.before
        laws = [law.lasting() for law in laws_of(self.found)]
        return made.with_laws(laws) if laws else made

    def model_toml(self) -> str | None:
        """The file of `model`, for `diagnose` and `predict` of the next recording; None where the verdict names
        nothing."""
        model = self.model()
        return None if model is None else as_toml(model)

    def save(self, folder: File, *, report: bool = True) -> None:
        """Write `diagnosis.json` and `report.html`, or without the page, whose figures take longer than the diagnosis
        of a small recording. Raises InputError for a folder that cannot be made."""
        page = {"report.html": self.html()} if report else {}
        write_folder(Path(folder), {"diagnosis.json": json.dumps(self.to_dict(), indent=1) + "\n", **page})

    def __repr__(self) -> str:
        claims = ", ".join(claim.effect for claim in self.claims)
        return f"<Diagnosis of {self.source}: {self.verdict}{': ' if claims else ''}{claims}>"

    def __str__(self) -> str:
        """What the command `highside diagnose` shows."""
        from highside.report.diagnosis_lines import lines_of

        return "\n".join(lines_of(self.found, self.report_data))

    def _repr_html_(self) -> str:
        """What a notebook shows: the verdict and the claims."""
        rows = [[claim.effect, claim_size(claim), f"{claim.p_familywise:.2g}"] for claim in self.claims]
        faults = (f"{finding.check}: {finding.remedy}" for finding in self.intake)
        headline = f"{self.verdict} - {verdict_words(self.found)}"
        return card(["left out", "size", "p"], rows, *faults, *self.notes, title=headline)

    def plot(self) -> Plot:
        """What the model leaves of each channel over time (of an error table: over its inclinations), before and with
        the claims.

        Raises InputError where nothing could be judged.
        """
        if self.report_data is None:
            raise InputError("there are no residuals to draw", remedy=self.verdict)
        from highside.report.diagnosis_chart import misfit_chart

        return misfit_chart(self.report_data, f"Diagnosis of {self.source}: {self.verdict}")


class DiagnoseOptions(TypedDict, total=False):
    """What may be said to `diagnose` beside the recording and the model; see there."""

    simulation: File | Columns | Table | None
    align: Align
    first_s: float | None
    last_s: float | None
    seed: int
    run_by_run: bool | None
    threads: int | None
    method: ProcedureParts


def diagnose(
    recording: File | Columns | FrameT,
    model: ModelLike | None = None,
    *,
    simulation: File | Columns | FrameT | None = None,
    align: Align = "auto",
    first_s: float | None = None,
    last_s: float | None = None,
    seed: int = 1,
    run_by_run: bool | None = None,
    threads: int | None = None,
    method: ProcedureParts = WHOLE,
) -> Diagnosis:
    """Say where a recording departs from what a model predicts, what was left out, and how sure that is.

    `recording`: a file, DataFrame, dict of arrays or Recording of N rows (`t_s` in s, `ax_g, ay_g, az_g` in g, a
    reference: `inc_ref_deg` with `tf_ref_deg` or `rotor_deg`), or a pose table. `model`: a model file, its tables or a
    `Model`: what the simulation knows; None: nothing beside the sensor. `simulation`: another program's output in the
    place of the model's prediction, with columns of the same names on times of its own; `align`: "none" where both are
    of one clock, "offset" where each has its own zero of time, "auto" by the spans. `first_s`, `last_s` cut a stretch
    out, s. The same `seed` gives the same answer; `method` leaves parts out, for studies. `run_by_run`: never hold the
    rows of a rotation (Parquet) in the memory, or always; None: from 1.5 million rows on. `threads`: runs at once.

    The verdict `bad_data` is an answer too. Raises InputError for a recording or a model that is not in order.
    """
    knows = Model() if model is None else model_of(model)
    whole = simulation is not None or first_s is not None or last_s is not None
    long = None if whole or run_by_run is False else long_rows(recording, knows, always=run_by_run is True)
    if long is None and run_by_run:
        raise InputError(
            "is no rotation with a known reference in Parquet, cut nowhere and without another program's prediction",
            field="run_by_run",
            remedy="leave it out: the rows are read into the memory",
        )
    rows, timed = (long, True) if long is not None else _rows_and_clock(recording, first_s, last_s)
    predicted = None if simulation is None else take(simulation, Recording).table
    sensor, axes = knows.sensor, knows.tool.map
    request = Request(
        columns=rows.columns,
        complete=rows.complete,
        forward=knows.forward(),
        free=sensor.free,
        site=_site(knows),
        axes=list(zip(axes.order, axes.signs, strict=True)),
        reference=knows.reference.kind if "kind" in knows.reference.model_fields_set else None,
        predicted=None if predicted is None else predicted.columns,
        align=align,
        free_of_prediction=sensor.free if "free" in sensor.model_fields_set else (),
        seed=seed,
        version=__version__,
        method=method,
        lacking=_lost(rows) if isinstance(rows, LongRecording) else (),
        timed=timed,
        where=rows.source,
        predicted_where=None if predicted is None else predicted.source or "simulation",
    )
    with on_threads(threads):
        answer = diagnose_columns(request)
    notes = (*_of_long(rows), *answer.notes) if isinstance(rows, LongRecording) else answer.notes
    return Diagnosis(answer.diagnosis, answer.report_data, knows, _name(rows), notes)


def _site(knows: Model) -> Site:
    """Where the bench stands. Of a model that does not say, the latitude is not known (NaN), and what the Earth's
    rotation does has no direction; one that has this effect all the same stands on the equator."""
    site = knows.site.site
    unknown = knows.site.latitude_deg is None and "earth_rotation" not in knows.effects.included
    return replace(site, latitude_rad=float("nan")) if unknown else site


def long_rows(recording: object, model: ModelLike | None = None, *, always: bool = False) -> LongRecording | None:
    """The rows of a Parquet file that are too many for the memory, if it is a rotation with a known reference.

    None for anything else, which `rows_of` reads; `always`: however few the rows are. Raises InputError as that does.
    """
    if not isinstance(recording, str | os.PathLike):
        return None
    knows = Model() if model is None else model_of(model)
    if "kind" in knows.reference.model_fields_set and knows.reference.kind != "pose":
        return None
    found = long_recording(Path(recording), NEEDED, at_least=0 if always else MANY_ROWS)
    return found if found is not None and rotates(found.columns) else None


def _lost(rows: LongRecording) -> tuple[Finding, ...]:
    """What is said of rows that were left out."""
    if not rows.lost:
        return ()
    words = f"{rows.lost} of {rows.n + rows.lost} rows lack a value and are left out"
    return (Finding("missing_values", rows.lacking, 0.0, words),)


def _of_long(rows: LongRecording) -> tuple[str, ...]:
    """What is said of a recording that is not in the memory."""
    if not rows.aside:
        return (said("%(rows)s rows are more than are held in the memory: they are read run by run", rows=rows.n),)
    return (
        said(
            "%(rows)s rows are more than are held in the memory: they are read run by run; columns that were not used:"
            " %(columns)s",
            rows=rows.n,
            columns=", ".join(rows.aside),
        ),
    )


def rows_of(
    recording: File | Columns | FrameT, *, first_s: float | None = None, last_s: float | None = None
) -> Recording:
    """The rows to diagnose. A pose table becomes a recording of one row a pose, a minute apart where it has no times.

    `first_s` and `last_s` cut a stretch out of it, s. Raises InputError.
    """
    return _rows_and_clock(recording, first_s, last_s)[0]


def _rows_and_clock(
    recording: File | Columns | FrameT, first_s: float | None, last_s: float | None
) -> tuple[Recording, bool]:
    """As `rows_of`, and whether the times of the rows were recorded."""
    table, timed = take(recording, Table).table, True
    if "ax_g" not in table.columns and table.has("ax", "ay", "az"):
        timed = table.has("t_s")
        table = _of_poses(table)
    with of_another(table.source, tables_alone=False) if table.source is not None else nullcontext():
        rows = Recording(table.columns, table.texts, table.order, table.source)
        # a text in one cell makes a column of texts: no reason to say that a sensor's column is missing
        rows.require(*(name for name in Recording.known if name in rows.texts))
    if first_s is None and last_s is None:
        return rows, timed
    t_s = rows.t_s
    keep = (t_s >= (-np.inf if first_s is None else first_s)) & (t_s <= (np.inf if last_s is None else last_s))
    if not keep.any():
        raise InputError(
            f"has no rows in that stretch; it runs from {np.nanmin(t_s):g} to {np.nanmax(t_s):g} s",
            where=rows.source,
            field="first_s, last_s",
            remedy="give times of the recording",
        )
    return rows.select(keep), timed


def _of_poses(poses: Table) -> Table:
    """A table of averages as a recording; its angles may lack, where only |g| is known."""
    mean = poses.complete("ax", "ay", "az")
    columns: dict[str, Array] = {
        "t_s": np.multiply(MINUTE_S, np.arange(poses.n, dtype=np.float64)),
        **dict(zip(("ax_g", "ay_g", "az_g"), mean, strict=True)),
        "pose": np.arange(poses.n, dtype=np.float64),
    }
    if poses.has("inc_ref_deg", "tf_ref_deg"):
        columns |= dict(zip(("inc_ref_deg", "tf_ref_deg"), poses.complete("inc_ref_deg", "tf_ref_deg"), strict=True))
    kept = ("temp_c", "direction", "t_s", "n", "std_ax", "std_ay", "std_az")
    columns |= {name: poses.columns[name] for name in kept if name in poses.columns}
    return Table(columns, source=poses.source)


def _name(table: Table | LongRecording) -> str:
    return "recording" if table.source is None else Path(table.source).name


def diagnose_table(
    table: File | Columns | FrameT,
    model: ModelLike | None = None,
    *,
    corrected_by: str = "none",
    stations: int = 73,
    readings: int = 4,
    seed: int = 1,
    progress: Callable[[float, str], None] | None = None,
) -> Diagnosis:
    """Diagnose a published error table in the place of a recording.

    `table` (a file, DataFrame or dict of arrays, one row an inclination) needs `inc_ref_deg, d_inc_mean_deg,
    d_inc_pp_deg, d_tf_mean_deg, d_tf_pp_deg`: mean and peak-to-peak of the errors of I and T over a revolution of
    `stations` toolfaces (both ends) with so many `readings` each. `model`: what is known of the instrument beforehand.
    `corrected_by`: what the table comes after ("conventional3", "balance-average" or "none"). `progress` is called with
    a share done and words. Raises InputError that names the argument or the column that is wrong.
    """
    from highside.diagnosis.table.chain import CELLS, CORRECTIONS, Procedure
    from highside.diagnosis.table.engine import diagnose_summary

    correction = next((known for known in CORRECTIONS if known == corrected_by), None)
    if correction is None:
        raise InputError(
            f"{corrected_by!r} is unknown", field="corrected_by", remedy=f"one of {', '.join(CORRECTIONS)}"
        )
    knows = Model() if model is None else model_of(model)
    read = take(table, SummaryTable).table
    inc = read.complete("inc_ref_deg")[0]
    wrong = np.flatnonzero((inc <= 0) | (inc >= 180))
    if wrong.size:
        raise InputError(
            f"{inc[wrong[0]]:g} is not between 0 and 180",
            where=read.place(int(wrong[0])),
            field="inc_ref_deg",
            remedy="at 0 and 180 deg there is no toolface",
        )
    noise = knows.sensor.noise_g
    effects = knows.effects.values()
    if "reading_noise" in effects:
        noise = float(np.mean([std_of_average(v, 1.0) for v in effects["reading_noise"].values()]))
    cells = np.column_stack([read.columns[name] for name in CELLS])
    try:
        found = diagnose_summary(
            inc,
            cells,
            Procedure(correction, stations, readings),
            knows.forward(),
            knows.sensor.free,
            noise_g=noise or None,
            seed=seed,
            version=__version__,
            progress=progress,
        )
    except InputError as error:
        raise InputError(error.what, where=read.source, field=error.field, remedy=error.remedy) from None
    return Diagnosis(found.diagnosis, found.report_data, knows, _name(read))
