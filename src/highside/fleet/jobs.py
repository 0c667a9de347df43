"""What is done with one recording: the row of its result. Each job is a caller of the public API, and nothing else.

A recording that fails is a row with its error. A row has `verdict` (of a diagnosis its own, else "done", of a pose set
that a calibration refuses "refused"), `error` and `seconds`, and what belongs to its job. A job imports what it needs
when it is done: a process of a fleet does one, and takes as long to import all of them as for a hundred short sessions.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from highside.errors import HighsideError
from highside.reading import parse_toml
from highside.version import __version__

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.core.effect_scores import EffectScores
    from highside.recording.table import Recording

__all__ = ["JOBS", "Order", "empty_row", "row_of"]


@dataclass(frozen=True)
class Order:
    """What is asked of all recordings."""

    job: str
    model: str = ""
    """text of the model file"""
    seed: int = 1
    method: str = ""
    """of `solve` and `drift`"""
    version: str = __version__
    tool: str = ""
    """of a calibration record, as the catalogue names it"""
    serial: str = ""

    @property
    def key(self) -> tuple[str, ...]:
        """What determines the result besides the recording."""
        whose = (self.tool, self.serial) if self.tool or self.serial else ()
        return self.job, self.model, str(self.seed), self.method, self.version, *whose

    def model_of(self) -> Model:
        """The model. Raises InputError."""
        from highside.config.model import Model, parse_model

        return parse_model(parse_toml(self.model, where="model"), where="model") if self.model else Model()


def row_of(order: Order, path: Path) -> dict[str, Any]:
    """Do the job on one file, which is at hand; an error of the recording is in the row."""
    begun, used = time.perf_counter(), time.process_time()
    try:
        row = JOBS[order.job](order, path)
    except HighsideError as error:
        row = {"verdict": "error", "error": str(error).replace(str(path), path.name)}
    except Exception as error:  # a defect with one recording must not cost the others theirs
        row = {"verdict": "error", "error": f"internal error: {type(error).__name__}: {error}"}
    row |= {"seconds": time.perf_counter() - begun, "cpu_s": time.process_time() - used}
    return empty_row(order.job) | row


def _diagnose(order: Order, path: Path) -> dict[str, Any]:
    from highside.api.diagnosis import diagnose, rows_of
    from highside.reading.row_groups import RowGroups
    from highside.recording.long import MANY_ROWS

    groups = RowGroups.of(path)
    # what is long is not read here: the diagnosis reads it run by run
    rows = None if groups is not None and groups.rows >= MANY_ROWS else rows_of(path)
    made = diagnose(path if rows is None else rows, order.model_of(), seed=order.seed)
    found = made.to_dict()
    data = made.report_data
    scores = getattr(data, "scores", None)
    return {
        "verdict": made.verdict,
        "rows": rows.n if rows is not None else groups.rows if groups is not None else 0,
        "claims": [claim.effect for claim in made.claims],
        "diagnosis": json.dumps(found),
        "noise": json.dumps(found["noise"]),
        "temp_c": _temperature(rows, data),
        **(_score_columns(scores) if scores is not None else {}),
    }


def _temperature(rows: Recording | None, data: object) -> float | None:
    """Mean temperature, C; of a recording that was not read, by the rows that a report draws."""
    from highside.diagnosis.core.problem import ReportData

    if rows is not None:
        return float(np.nanmean(rows.columns["temp_c"])) if "temp_c" in rows.columns else None
    return float(np.mean(data.session.state.temp_c)) if isinstance(data, ReportData) else None


def _score_columns(scores: EffectScores) -> dict[str, Any]:
    """Score and information as lists: of the information the upper triangle, row by row."""
    upper = np.triu_indices(len(scores.parameters))
    return {
        "entries": list(scores.entries),
        "entry_of": list(scores.entry_of),
        "parameters": list(scores.parameters),
        "units": list(scores.units),
        "score": scores.score.tolist(),
        "information": scores.information[upper].tolist(),
        "freedom": scores.freedom,
    }


def _solve(order: Order, path: Path) -> dict[str, Any]:
    from highside.api.calibration import calibrate

    made = calibrate(path, order.method or "joint", tool=order.tool or None, serial=order.serial or None)
    rows = len(made.record.content["pose_table"]["ax"])
    verdict = "refused" if made.refused else "done"
    return {"verdict": verdict, "rows": rows, "record": made.record.to_json(), "record_id": made.record.id}


def _drift(order: Order, path: Path) -> dict[str, Any]:
    from highside.api.gyro import drift
    from highside.gyro.follow import MethodName, columns_deg

    made = drift(path, next((known for known in get_args(MethodName) if known == order.method), "kinematic"))
    last = {name: float(column[-1]) for name, column in columns_deg(made.result).items()}
    return {"verdict": "done", "rows": int(made.result.t_s.size), "basis": made.basis, "last": json.dumps(last)}


def modules_of(job: str) -> list[str]:
    """What a process of that job would import with its first recording: 0.07 s of a solution. What other packages add
    is not among it: it might begin threads, which no copy of a process has."""
    own = {
        "diagnose": ["highside.api.diagnosis", "highside.reading.row_groups", "highside.recording.long"],
        "solve": ["highside.api.calibration", "_strptime", *_all_in("highside.calibration.methods")],
        "drift": ["highside.api.gyro"],
    }[job]
    sensors = [] if job == "drift" else [*_all_in("highside.physics.effects"), "numpy.ma", "numpy.polynomial"]
    return [*own, *sensors, "encodings.utf_8_sig"]


def _all_in(package: str) -> list[str]:
    return [f"{package}.{module.name}" for module in pkgutil.iter_modules(importlib.import_module(package).__path__)]


JOBS: Mapping[str, Callable[[Order, Path], dict[str, Any]]] = {"diagnose": _diagnose, "solve": _solve, "drift": _drift}


def empty_row(job: str) -> dict[str, Any]:
    """All columns of a job's row, so that every part has the same."""
    common: dict[str, Any] = {"job": job, "verdict": "error", "error": "", "rows": 0}
    own: dict[str, dict[str, Any]] = {
        "diagnose": {
            "claims": [],
            "diagnosis": "",
            "noise": "",
            "temp_c": None,
            "entries": [],
            "entry_of": [],
            "parameters": [],
            "units": [],
            "score": [],
            "information": [],
            "freedom": None,
        },
        "solve": {"record": "", "record_id": ""},
        "drift": {"basis": "", "last": ""},
    }
    return {**common, **own[job]}
