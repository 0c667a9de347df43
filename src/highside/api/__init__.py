"""What `import highside` gives: from files, DataFrames and dicts of arrays to the numerics, and back in the same kind.

    recording     `read`, `Recording`, `import_recording` (files of other programs)
    calibration   `find_poses`, `calibrate`, `Calibration` (and `Calibration.correct`)
    simulation    `simulate`, `predict`
    diagnosis     `diagnose`, `diagnose_table`, `Diagnosis`
    learning      `confirm` (a law on another session), `new_effect` (a law as an effect of one's own)
    drift         `drift`: attitude and azimuth by gyros and gravity
    rotation      `fit_rotation`, `compensate`, `compare_rotation`: errors that repeat with the rotor angle
    turntable     `fit_turntable`, `fit_self`: a bench's own encoder and axis

The commands are thin callers of these: what a command does beside is to read options, print and set the exit status. An
answer of rows comes back in the kind that came in (see `recording.frames`); results show themselves in a notebook and
have `.plot()` (extra `plot`). Errors are `InputError` (what came in is not in order: file, field, what to do) and
`Refused` (it was understood, and the answer is no), both `HighsideError`.
"""

from __future__ import annotations

from highside.api.calibration import Calibration, CorrectedReadings, calibrate, find_poses
from highside.api.confirmation import Confirmation, confirm
from highside.api.diagnosis import Diagnosis, diagnose, diagnose_table
from highside.api.gyro import Drift, drift
from highside.api.importing import import_recording
from highside.api.learning import new_effect
from highside.api.recording import read
from highside.api.rotation import CompensatedRecording, FitOfRotation, compare_rotation, compensate, fit_rotation
from highside.api.simulation import Simulation, predict, simulate
from highside.api.turntable import SelfFit, TurntableFit, fit_self, fit_turntable
from highside.config.model import Model
from highside.errors import HighsideError, InputError, Refused
from highside.reading.files import allow_bytes
from highside.recording.table import PoseTable, Recording, Table
from highside.rotation import Compensation

__all__ = [
    "Calibration",
    "CompensatedRecording",
    "Compensation",
    "Confirmation",
    "CorrectedReadings",
    "Diagnosis",
    "Drift",
    "FitOfRotation",
    "HighsideError",
    "InputError",
    "Model",
    "PoseTable",
    "Recording",
    "Refused",
    "SelfFit",
    "Simulation",
    "Table",
    "TurntableFit",
    "allow_bytes",
    "calibrate",
    "compare_rotation",
    "compensate",
    "confirm",
    "diagnose",
    "diagnose_table",
    "drift",
    "find_poses",
    "fit_rotation",
    "fit_self",
    "fit_turntable",
    "import_recording",
    "new_effect",
    "predict",
    "read",
    "simulate",
]
