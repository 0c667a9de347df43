"""The certificate of a calibration: what was measured, how, and how far it can be trusted."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from highside.api.calibration import Calibration, read_solver_table
from highside.calibration.pose_table import solver_columns
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord, RecordError, RecordReason, to_utc
from highside.config.certificate import CertificateFields, in_language_of, load_certificate_fields
from highside.reading import read_bytes
from highside.recording.calibration_store import read_record
from highside.recording.files import write_whole
from highside.recording.frames import Columns, File, FrameT
from highside.report.certificate import certificate as sheets_of
from highside.report.certificate import number_of
from highside.report.certificate_budget import budget_at
from highside.report.certificate_conformity import verdict_lines
from highside.report.certificate_inputs import Inputs
from highside.report.certificate_photographs import of_session
from highside.report.dcc import Printed, dcc
from highside.report.document import Sheets
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot

__all__ = ["Certificate", "certify"]

SHOWN_AT_DEG = (3.0, 45.0, 90.0)
DRAWN_AT_DEG = tuple(float(inc) for inc in range(3, 91, 3))


@dataclass(frozen=True, slots=True)
class Certificate:
    """Numbered sheets: result, uncertainty budget (GUM, k = 2), as found and as left, method, poses, identity."""

    inputs: Inputs

    @property
    def verdicts(self) -> tuple[str, ...]:
        """What is said of the limits that the fields state, as found and as left."""
        return tuple(verdict_lines(self.inputs))

    def sheets(self) -> Sheets:
        """The document. Raises InputError where matplotlib (extra `plot`) is not installed."""
        return sheets_of(self.inputs)

    def save(self, path: File) -> int | None:
        """Write `.pdf` (extra `pdf`), or HTML that prints as numbered sheets; how many pages the PDF has.

        Raises InputError where what draws it is not installed, or the file cannot be written.
        """
        target = Path(path)
        if target.suffix.lower() == ".pdf":
            data, pages = self.sheets().pdf()
        else:
            data, pages = self.sheets().html().encode(), 0
        write_whole(target, data)
        return pages or None

    def dcc(self, printed: File | None = None) -> bytes:
        """The same as Digital Calibration Certificate (PTB's DCC XML 3.3.0); `printed`: a file to travel within. Raises
        InputError where the fields name no country, or that file cannot be read."""
        path = None if printed is None else Path(printed)
        kind = "text/html" if path is None or path.suffix.lower() != ".pdf" else "application/pdf"
        within = None if path is None else Printed(path.name, kind, read_bytes(path))
        return dcc(self.inputs, number_of(self.inputs), within)

    def _repr_html_(self) -> str:
        """What a notebook shows: the expanded uncertainties, and the verdicts."""
        record = self.inputs.record
        rows = [[f"{inc:g}", *(f"{u:.4f}" for u in self._expanded(inc))] for inc in SHOWN_AT_DEG]
        title = f"Certificate of record {record.id[:12]}, tool {record.tool_id}"
        return card(["I, deg", "U(I), k = 2, deg", "U(T), k = 2, deg"], rows, *self.verdicts, title=title)

    def plot(self) -> Plot:
        """The expanded uncertainties (k = 2) of I and T over the inclination, deg."""
        found = np.array([self._expanded(inc) for inc in DRAWN_AT_DEG])
        lines = (PlotLine("U(I)", found[:, 0]), PlotLine("U(T)", found[:, 1]))
        panel = PlotPanel(np.array(DRAWN_AT_DEG), lines, "inclination, deg", "U, k = 2, deg", log=True)
        return Plot(f"Certificate of record {self.inputs.record.id[:12]}", (panel,))

    def _expanded(self, inc_deg: float) -> tuple[float, float]:
        """U of I and T in deg; not a number where the calibration holds nothing."""
        budget = budget_at(self.inputs.record, self.inputs.fields, inc_deg)
        return (np.nan, np.nan) if budget is None else (float(budget.expanded[0]), float(budget.expanded[1]))


def certify(
    calibration: Calibration | CalibrationRecord | File,
    fields: CertificateFields | File | None = None,
    *,
    previous: Calibration | CalibrationRecord | File | None = None,
    as_found: PoseSet | File | Columns | FrameT | None = None,
    as_left: PoseSet | File | Columns | FrameT | None = None,
    session: File | None = None,
    language: str | None = None,
) -> Certificate:
    """The certificate of a calibration.

    `fields`: what only people know (laboratory, customer, traceability, limits, signatory), a TOML file; what is not
    stated is named as such. `previous`: the calibration in force before, for the state as found. `as_found`,
    `as_left`: poses measured before and afterwards (tables with `inc_ref_deg, tf_ref_deg, ax, ay, az`); without them
    those of the record. `session`: the journal of the session that the record follows from, for its photographs.
    `language`: "en", "de", "nb" or "es"; else that of the fields, else English. Raises InputError for what is not in
    order, Refused for a record of another tool.
    """
    record = _record(calibration)
    stated = fields if isinstance(fields, CertificateFields) else None
    if stated is None:
        stated = CertificateFields() if fields is None else load_certificate_fields(Path(fields))  # type: ignore[arg-type]
    before = None if previous is None else _record(previous)
    if before is not None and before.tool_id != record.tool_id:
        where = f"{previous}: " if isinstance(previous, str | Path) else ""
        raise RecordError(RecordReason.WRONG_TOOL, f"{where}is of tool {before.tool_id!r}, not of {record.tool_id!r}")
    if language is not None:
        stated = in_language_of(stated, language)
    poses = (_poses(as_found), _poses(as_left))
    taken = () if session is None else of_session(Path(session), record)
    return Certificate(Inputs(record, stated, to_utc(time.time()), before, *poses, taken))


def _record(given: Calibration | CalibrationRecord | File) -> CalibrationRecord:
    if isinstance(given, Calibration):
        return given.record
    return given if isinstance(given, CalibrationRecord) else read_record(Path(given))


def _poses(given: object) -> PoseSet | None:
    if given is None or isinstance(given, PoseSet):
        return given
    table = read_solver_table(given).table
    columns = solver_columns(table.columns, table.texts)
    return PoseSet.from_columns(columns, where=table.source or "pose table")  # type: ignore[arg-type]
