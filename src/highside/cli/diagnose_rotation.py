"""`highside diagnose` of a continuous rotation with a known reference: from the rows of a Recording to the engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.core.method import Method
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.engine import Picture
    from highside.diagnosis.intake.checks import Intake
    from highside.recording.table import Recording

GYRO_FREE = ("gyro_bias", "gyro_scale")
"""What is refitted beside the model's own free effects where gyros were recorded."""


def rotates(rows: Recording) -> bool:
    """Whether the reference turns in most rows: no session of stops."""
    import numpy as np

    name = "tf_ref_deg" if "tf_ref_deg" in rows.columns else "rotor_deg"
    return "pose" not in rows.columns and bool(np.mean(np.diff(rows.columns[name]) != 0) > 0.5)


def diagnose_rows(
    rows: Recording, knows: Model, signed: Sequence[tuple[int, float]], found: Intake, seed: int, method: Method
) -> tuple[Diagnosis, Picture]:
    """Diagnose row by row. `signed` says which channel, with which sign, is the tool's x, y and z."""
    import numpy as np

    from highside import __version__
    from highside.diagnosis.engine import diagnose_rotation
    from highside.diagnosis.intake.clipped import without_meaning
    from highside.diagnosis.rows.session import rotation_session
    from highside.errors import InputError

    raw = rows.accel()
    accel = np.stack([sign * raw[channel] for channel, sign in signed])
    gyro = None
    if rows.has("gx_dps", "gy_dps", "gz_dps"):
        rates = np.radians(rows.gyro())
        if np.isnan(rates).any():
            raise InputError(
                "has gaps", where=rows.source, field="gx_dps, gy_dps, gz_dps",
                remedy="leave the gyro columns out, or the rows without rates",
            )  # fmt: skip
        gyro = np.stack([sign * rates[channel] for channel, sign in signed])
    site = knows.site.site
    try:
        session = rotation_session(
            rows.columns, accel, gyro, gravity_mps2=site.gravity_mps2, latitude_rad=site.latitude_rad,
            azimuth_rad=site.azimuth_rad, left_out=without_meaning(raw, found),
        )  # fmt: skip
    except InputError as error:
        raise InputError(error.what, where=rows.source, field=error.field, remedy=error.remedy) from None
    free = knows.sensor.free
    if gyro is not None:
        free = (*free, *(name for name in GYRO_FREE if name not in free))
    return diagnose_rotation(session, knows.forward(), free, seed=seed, version=__version__, method=method)
