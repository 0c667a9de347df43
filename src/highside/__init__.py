"""highside: live acquisition, calibration and diagnosis for the directional sensors of a drilling tool.

What a program may use is loaded when it is first asked for, so that `import highside` costs nothing:

    import highside

    recording = highside.read("session.csv.gz")            # or a pandas, polars or Arrow table, or a dict of arrays
    poses = highside.find_poses(recording)
    calibration = highside.calibrate(poses, "joint", tool="HS-7")
    corrected = calibration.correct(recording)             # of the kind that came in, with inc_deg, tf_deg, ...

The parts, from the bottom up (which may use which stands in `pyproject.toml`, drawn in `docs/architecture.md`):

    reading       everything from outside, read with bounds
    attitude      inclination, toolface, azimuth and their covariance
    physics       the forward model and one library of effects
    calibration   methods, records, correction
    rotation      errors that repeat with the rotor angle
    gyro          azimuth and gyro bias, from gyros and gravity
    diagnosis     which physics a recording asks for that the model lacks
    watch         whether a calibration still holds, from the hole alone
    codec         bytes or CAN frames to readings
    recording     files, and tables of other libraries
    shown         results in a notebook, plots for the screen and for paper
    importing     recordings of other programs
    link          serial, SocketCAN, python-can, replay, the simulated tool
    config        what files of settings and models may say
    service       the daemon, and what is around inclination and toolface for the rig
    bench         the guided session on a bench
    report, web   pages, certificates, the bench page
    papers        the papers' tables beside ours
    api           what this module gives
    cli           the `highside` command
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from highside.version import __version__

if TYPE_CHECKING:
    from highside.api import (
        AnalysedSurveys,
        Calibration,
        Certificate,
        ComparedRotation,
        CompensatedRecording,
        Compensation,
        Confirmation,
        CorrectedReadings,
        Diagnosis,
        Drift,
        ErrorModel,
        FitOfRotation,
        HighsideError,
        ImportProposal,
        InputError,
        ListedSurveys,
        Model,
        Plot,
        PlotLine,
        PlotPanel,
        PoseTable,
        Recording,
        Refused,
        SelfFit,
        Simulation,
        Table,
        TurntableFit,
        WatchedRecording,
        allow_bytes,
        analyse_surveys,
        calibrate,
        certify,
        compare_rotation,
        compensate,
        confirm,
        diagnose,
        diagnose_table,
        drift,
        error_model,
        find_poses,
        fit_rotation,
        fit_self,
        fit_turntable,
        import_poses,
        import_recording,
        inspect_import,
        list_surveys,
        new_effect,
        predict,
        read,
        simulate,
        watch_recording,
    )

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
    "__version__",
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


def __getattr__(name: str) -> Any:
    """A name of the public API, loaded when it is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module 'highside' has no attribute {name!r}")
    value = getattr(import_module("highside.api"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
