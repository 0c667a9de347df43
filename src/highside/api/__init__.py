"""What `import highside` gives: from files, DataFrames and dicts of arrays to the numerics, and back in the same kind.

    recording     `read`, `Recording`, `import_recording` (files of other programs)
    calibration   `find_poses`, `calibrate`, `Calibration` (and `Calibration.correct`)
    simulation    `simulate`, `predict`
    diagnosis     `diagnose`, `diagnose_table`, `Diagnosis`
    learning      `confirm` (a law on another session), `new_effect` (a law as an effect of one's own)
    drift         `drift`: attitude and azimuth by gyros and gravity
    rotation      `fit_rotation`, `compensate`, `compare_rotation`: errors that repeat with the rotor angle
    watch         `watch_recording`: whether a calibration still holds, from a recording of the hole alone;
                  `analyse_surveys`: the same from the surveys that a tool kept
    survey list   `list_surveys`: surveys by depth, positions by minimum curvature, for other programs
    turntable     `fit_turntable`, `fit_self`: a bench's own encoder and axis

The commands are thin callers of these: what a command does beside is to read options, print and set the exit status. An
answer of rows comes back in the kind that came in (see `recording.frames`); results show themselves in a notebook and
have `.plot()` (extra `plot`). Errors are `InputError` (what came in is not in order: file, field, what to do) and
`Refused` (it was understood, and the answer is no), both `HighsideError`.

Each name is loaded with its module when it is first asked for (PEP 562): who reads a recording does not wait for the
certificates. `_HOMES` says where a name lives; type checkers read the imports beside it, and a test holds them equal.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from highside.api.any_file import read
    from highside.api.calibration import Calibration, CorrectedReadings, calibrate, find_poses
    from highside.api.certificate import Certificate, certify
    from highside.api.confirmation import Confirmation, confirm
    from highside.api.diagnosis import Diagnosis, diagnose, diagnose_table
    from highside.api.gyro import Drift, drift
    from highside.api.importing import ImportProposal, import_poses, import_recording, inspect_import
    from highside.api.iscwsa import ErrorModel, error_model
    from highside.api.learning import new_effect
    from highside.api.recording import Recording
    from highside.api.rotation import (
        ComparedRotation,
        CompensatedRecording,
        FitOfRotation,
        compare_rotation,
        compensate,
        fit_rotation,
    )
    from highside.api.simulation import Simulation, predict, simulate
    from highside.api.survey_list import ListedSurveys, list_surveys
    from highside.api.surveys import AnalysedSurveys, analyse_surveys
    from highside.api.turntable import SelfFit, TurntableFit, fit_self, fit_turntable
    from highside.api.watch import WatchedRecording, watch_recording
    from highside.config.model import Model
    from highside.errors import HighsideError, InputError, Refused
    from highside.reading.files import allow_bytes
    from highside.recording.table import PoseTable, Table
    from highside.rotation import Compensation
    from highside.shown.panel import PlotLine, PlotPanel
    from highside.shown.plot import Plot

__all__ = [
    "AnalysedSurveys",
    "Calibration",
    "Certificate",
    "ComparedRotation",
    "CompensatedRecording",
    "Compensation",
    "Confirmation",
    "CorrectedReadings",
    "Diagnosis",
    "Drift",
    "ErrorModel",
    "FitOfRotation",
    "HighsideError",
    "ImportProposal",
    "InputError",
    "ListedSurveys",
    "Model",
    "Plot",
    "PlotLine",
    "PlotPanel",
    "PoseTable",
    "Recording",
    "Refused",
    "SelfFit",
    "Simulation",
    "Table",
    "TurntableFit",
    "WatchedRecording",
    "allow_bytes",
    "analyse_surveys",
    "calibrate",
    "certify",
    "compare_rotation",
    "compensate",
    "confirm",
    "diagnose",
    "diagnose_table",
    "drift",
    "error_model",
    "find_poses",
    "fit_rotation",
    "fit_self",
    "fit_turntable",
    "import_poses",
    "import_recording",
    "inspect_import",
    "list_surveys",
    "new_effect",
    "predict",
    "read",
    "simulate",
    "watch_recording",
]

_HOMES = {
    "AnalysedSurveys": "highside.api.surveys",
    "Calibration": "highside.api.calibration",
    "Certificate": "highside.api.certificate",
    "ComparedRotation": "highside.api.rotation",
    "CompensatedRecording": "highside.api.rotation",
    "Compensation": "highside.rotation",
    "Confirmation": "highside.api.confirmation",
    "CorrectedReadings": "highside.api.calibration",
    "Diagnosis": "highside.api.diagnosis",
    "Drift": "highside.api.gyro",
    "ErrorModel": "highside.api.iscwsa",
    "FitOfRotation": "highside.api.rotation",
    "HighsideError": "highside.errors",
    "ImportProposal": "highside.api.importing",
    "InputError": "highside.errors",
    "ListedSurveys": "highside.api.survey_list",
    "Model": "highside.config.model",
    "Plot": "highside.shown.plot",
    "PlotLine": "highside.shown.panel",
    "PlotPanel": "highside.shown.panel",
    "PoseTable": "highside.recording.table",
    "Recording": "highside.api.recording",
    "Refused": "highside.errors",
    "SelfFit": "highside.api.turntable",
    "Simulation": "highside.api.simulation",
    "Table": "highside.recording.table",
    "TurntableFit": "highside.api.turntable",
    "WatchedRecording": "highside.api.watch",
    "allow_bytes": "highside.reading.files",
    "analyse_surveys": "highside.api.surveys",
    "calibrate": "highside.api.calibration",
    "certify": "highside.api.certificate",
    "compare_rotation": "highside.api.rotation",
    "compensate": "highside.api.rotation",
    "confirm": "highside.api.confirmation",
    "diagnose": "highside.api.diagnosis",
    "diagnose_table": "highside.api.diagnosis",
    "drift": "highside.api.gyro",
    "error_model": "highside.api.iscwsa",
    "find_poses": "highside.api.calibration",
    "fit_rotation": "highside.api.rotation",
    "fit_self": "highside.api.turntable",
    "fit_turntable": "highside.api.turntable",
    "import_poses": "highside.api.importing",
    "import_recording": "highside.api.importing",
    "inspect_import": "highside.api.importing",
    "list_surveys": "highside.api.survey_list",
    "new_effect": "highside.api.learning",
    "predict": "highside.api.simulation",
    "read": "highside.api.any_file",
    "simulate": "highside.api.simulation",
    "watch_recording": "highside.api.watch",
}
"""name: the module it lives in"""


def __getattr__(name: str) -> Any:
    """A name of the public API, from its own module. Raises AttributeError."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
