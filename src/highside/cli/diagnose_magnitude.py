"""`highside diagnose` where only the magnitude of gravity is known: `[reference] kind = "magnitude"`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.core.scene import Picture
    from highside.recording.table import Recording


def diagnose_magnitude(rows: Recording, knows: Model, seed: int) -> tuple[Diagnosis, Picture | None]:
    """Intake, still intervals, then the engine; without enough still readings the verdict is `not_testable`."""
    from dataclasses import replace

    import numpy as np

    from highside import __version__
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.engine import diagnose_magnitudes
    from highside.diagnosis.intake.checks import check
    from highside.diagnosis.magnitude.session import magnitude_session, nothing_testable

    axes = knows.tool.map
    signed = list(zip(axes.order, axes.signs, strict=True))
    found = check(rows.columns, (), signed, attitude=False)
    if found.spoiled:
        return Diagnosis("bad_data", intake=found.findings, seed=seed, version=__version__), None
    raw = rows.accel()
    accel = np.stack([sign * raw[channel] for channel, sign in signed])
    session = magnitude_session(rows.columns, accel, gravity_mps2=knows.site.site.gravity_mps2)
    if isinstance(session, str):
        return nothing_testable(session, found.findings, seed, __version__), None
    diagnosis, picture = diagnose_magnitudes(
        session, knows.forward(), knows.sensor.free, seed=seed, version=__version__
    )
    return replace(diagnosis, intake=found.findings), picture
